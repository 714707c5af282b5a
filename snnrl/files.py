"""Files that are there whole or not at all, what they hold, and folders that one process owns at a time."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import math
import os
import socket
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


class FolderError(ValueError):
    """A run folder cannot be used as asked; the message is one line that names it."""


def write(path: Path, content: bytes | str, keep: Path | None = None) -> None:
    """Write a file as a whole: whenever the process or the machine stops, a reader finds the old one or the new one.

    Args:
        keep: where the old one goes; it may be there already, and nothing yet at `path`, when the process stops.

    Raises:
        OSError: it could not be written; the old one, if any, is untouched.
    """
    unfinished = path.with_name(path.name + ".unfinished")
    try:
        with unfinished.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        if keep is not None and path.exists():
            os.replace(path, keep)
        os.replace(unfinished, path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error
    sync(path.parent)


def sync(path: Path) -> None:
    """Have the disk hold what was written to a file, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """A dictionary as readable JSON; refuses NaN and infinities."""
    write(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def finite(value: float) -> float | None:
    """A number, or None for one that JSON cannot hold."""
    return float(value) if math.isfinite(value) else None


def csv_of(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table with a head as CSV; None is an empty cell."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    table.writerows(rows)
    return text.getvalue()


def npz_of(arrays: Mapping[str, Any]) -> bytes:
    """Arrays by name, compressed as NumPy's .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Own a folder as long as the context lasts; a process that dies owns nothing.

    What a dead owner was about to `write` is removed.

    Raises:
        FolderError: another process owns it.
        OSError: the folder cannot be written to.
    """
    with (folder / ".lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            raise FolderError(f"{folder}: in use by {lock.read().strip() or 'another process'}") from None
        lock.truncate(0)
        lock.write(f"process {os.getpid()} on {socket.gethostname()}")
        lock.flush()
        for unfinished in folder.glob("*.unfinished"):
            unfinished.unlink()
        yield

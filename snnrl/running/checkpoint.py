"""Checkpoints: the whole state of an unfinished run in one file, from which it goes on as if never stopped.

A folder has the newest and, should that be damaged, the one before it; from the first on, one is there at any moment.
A file is a line `snnrl checkpoint FORMAT SHA256` followed by the bytes of which that is the digest: tensors, numbers
and text as `torch.save` writes them. They are read with `weights_only=True`, which runs no code.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from snnrl.files import FolderError, write
from snnrl.schema import Config
from snnrl.simulation import Simulation

FILE, PREVIOUS = "checkpoint.pt", "checkpoint.previous.pt"
FORMAT = 1
WITHOUT_EFFECT = ("threads", "checkpoint.")  # on any result


class Damaged(FolderError):
    """A checkpoint is not what was written."""


@dataclass(frozen=True)
class Checkpoint:
    """An unfinished run.

    Attributes:
        config: what the run is made from, as `settings` gives it.
        simulation, recorder: their states.
        wall: s of wall time that it has taken so far.
    """

    config: dict[str, Any]
    simulation: dict[str, torch.Tensor]
    recorder: dict[str, Any]
    wall: float


def settings(config: Config) -> dict[str, Any]:
    """Everything that a run's results depend on, key by key."""

    def flat(values: dict[str, Any], key: str) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for name, value in values.items():
            is_table = isinstance(value, dict) and value
            result.update(flat(value, f"{key}{name}.") if is_table else {f"{key}{name}": value})
        return result

    everything = flat(asdict(config), "")
    return {key: value for key, value in everything.items() if not key.startswith(WITHOUT_EFFECT)}


def difference(theirs: dict[str, Any], ours: dict[str, Any]) -> str | None:
    """The first key in which two settings differ, with both values; None if they are the same."""
    for key in [*ours, *theirs]:
        there, here = theirs.get(key), ours.get(key)
        if there != here or (key in theirs) != (key in ours):
            return f"{key}={there} there, {key}={here} here"
    return None


def save(folder: Path, checkpoint: Checkpoint) -> None:
    """Add a checkpoint to the folder's; the newest of those becomes the one before it, which is forgotten.

    Raises:
        OSError: it could not be written; the others are untouched.
    """
    buffer = io.BytesIO()
    torch.save({**vars(checkpoint), "config": json.dumps(checkpoint.config)}, buffer)
    content = buffer.getvalue()
    head = f"snnrl checkpoint {FORMAT} {hashlib.sha256(content).hexdigest()}\n"
    write(folder / FILE, head.encode() + content, keep=folder / PREVIOUS)


def load(folder: Path, config: Config, simulation: Simulation[Any]) -> Checkpoint | None:
    """Bring a fresh simulation to the state of the folder's checkpoint; None if it has none.

    Where the newest is damaged, the one before takes its place, and a line on stderr says so.

    Raises:
        FolderError: all are damaged, or one is from a newer version, or of a run with other settings.
    """
    damages: list[str] = []
    for path in (folder / FILE, folder / PREVIOUS):
        try:
            checkpoint = _restore(path, config, simulation) if path.exists() else None
        except Damaged as damage:
            damages.append(str(damage))
            continue
        if checkpoint is not None:
            if damages:
                os.replace(path, folder / FILE)
                print(f"{damages[0]}; going on from the one before, {path.name}", file=sys.stderr)
            return checkpoint
    if damages:
        raise FolderError("; ".join(damages))
    return None


def remove(folder: Path) -> None:
    """Leave no checkpoint."""
    for name in (FILE, PREVIOUS):
        (folder / name).unlink(missing_ok=True)


def _restore(path: Path, config: Config, simulation: Simulation[Any]) -> Checkpoint:
    head, _, content = path.read_bytes().partition(b"\n")
    match = re.fullmatch(rb"snnrl checkpoint (\d+) ([0-9a-f]{64})", head)
    if not match:
        raise Damaged(f"{path}: damaged, or not a checkpoint")
    version = int(match[1])
    if version > FORMAT:
        raise FolderError(f"{path}: format {version} is newer than this version of snnrl, which reads {FORMAT}")
    if hashlib.sha256(content).hexdigest().encode() != match[2]:
        raise Damaged(f"{path}: damaged (its checksum does not fit)")
    try:
        found = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        checkpoint = Checkpoint(**{**found, "config": json.loads(found["config"])})
    except (UnpicklingError, RuntimeError, KeyError, TypeError, ValueError):
        raise FolderError(f"{path}: not written by snnrl") from None
    if differs := difference(checkpoint.config, json.loads(json.dumps(settings(config)))):
        raise FolderError(f"{path}: of another run ({differs})")
    try:
        simulation.load_state_dict(checkpoint.simulation)
    except RuntimeError:
        raise FolderError(f"{path}: written by a version of snnrl whose state differs from this one's") from None
    return checkpoint

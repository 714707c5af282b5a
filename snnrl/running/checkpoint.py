"""Checkpoints: the whole state of an unfinished run in one file, from which it goes on as if never stopped.

The file is a line `snnrl checkpoint FORMAT SHA256` followed by the bytes of which that is the digest: tensors,
numbers and text as `torch.save` writes them. They are read with `weights_only=True`, which runs no code.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from snnrl.configuration.schema import Config
from snnrl.files import FolderError, write
from snnrl.simulation import Simulation, TaskSimulation

FILE = "checkpoint.pt"
FORMAT = 1
WITHOUT_EFFECT = ("threads", "checkpoint.")  # on any result


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
    """Replace the folder's checkpoint.

    Raises:
        OSError: it could not be written; the last one is untouched.
    """
    buffer = io.BytesIO()
    torch.save({**vars(checkpoint), "config": json.dumps(checkpoint.config)}, buffer)
    content = buffer.getvalue()
    write(folder / FILE, f"snnrl checkpoint {FORMAT} {hashlib.sha256(content).hexdigest()}\n".encode() + content)


def load(folder: Path, config: Config, simulation: Simulation | TaskSimulation) -> Checkpoint | None:
    """Bring a fresh simulation to the state of the folder's checkpoint; None if it has none.

    Raises:
        FolderError: it is damaged, from a newer version, or of a run with other settings.
    """
    path = folder / FILE
    if not path.exists():
        return None
    head, _, content = path.read_bytes().partition(b"\n")
    match = re.fullmatch(rb"snnrl checkpoint (\d+) ([0-9a-f]{64})", head)
    if not match:
        raise FolderError(f"{path}: damaged, or not a checkpoint")
    version = int(match[1])
    if version > FORMAT:
        raise FolderError(f"{path}: format {version} is newer than this version of snnrl, which reads {FORMAT}")
    if hashlib.sha256(content).hexdigest().encode() != match[2]:
        raise FolderError(f"{path}: damaged (its checksum does not fit)")
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

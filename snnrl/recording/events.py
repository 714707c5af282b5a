"""A run's TensorBoard events as files and as choices; what writes them is `snnrl.recording.board`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from snnrl.files import write

ALARMS = "alarms, trials"
WITHOUT_EFFECT = ("threads", "record.", "checkpoint.")


def keep_events(folder: Path, size: int) -> None:
    """Keep the first `size` bytes of a folder's TensorBoard events, in one file that sorts before any later one.

    Killed at any point and called again, it does the same: the bytes that are kept stay in front.
    """
    files = sorted(folder.glob("events.out.tfevents.*"))
    kept = folder / "events.out.tfevents.0000000000.kept"
    if size:
        write(kept, b"".join(file.read_bytes() for file in files)[:size])
    for file in files:
        if file != kept or not size:
            file.unlink()


def choices(overrides: Iterable[str], **always: str | float) -> dict[str, str | float]:
    """What a command line has chosen that may change a result, by key, numbers as such; and what there always is."""
    chosen: dict[str, str | float] = {}
    for override in overrides:
        key, _, text = override.lstrip("+").partition("=")
        if not key.startswith(WITHOUT_EFFECT):
            try:
                chosen[key] = float(text)
            except ValueError:
                chosen[key] = text
    return {**chosen, **always}

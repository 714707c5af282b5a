"""A run's TensorBoard events as files; what writes them is `snnrl.recording.board`."""

from __future__ import annotations

from pathlib import Path

from snnrl.files import write


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

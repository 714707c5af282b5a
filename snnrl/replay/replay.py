"""One trial of a run again, with everything recorded: an animation, the spikes, and which synapse owes what to whom.

    python -m snnrl.replay RUN_FOLDER --trial 17 [--from S] [--to S] [--nwb]

A trial depends on nothing but the run's seed and its number, so it is run again from its start by the run's own
engine. What happened between --from and --to (simulated s; the first 30 s) is written to
RUN_FOLDER/replay/trial-17-FROM-TO: replay.gif (and replay.mp4 where there is ffmpeg), raster.png, credit.csv,
credit.png and spikes.npz, and with --nwb replay.nwb. See docs/replay.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from snnrl.configuration.compose import load
from snnrl.drawing import style
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.files import FolderError, npz_of, write
from snnrl.replay.nwb import write_nwb
from snnrl.replay.scenes import animate, draw_credit, draw_raster
from snnrl.replay.trial import Original, Recording, record
from snnrl.running.command import FORESEEN, explain, status
from snnrl.running.schedule import ticks_of

LENGTH = 30.0  # s that are recorded unless told otherwise


def replay(folder: Path, trial: int, start: float = 0.0, end: float | None = None, nwb: bool = False) -> None:
    """Replay a trial and write what was recorded from `start` to `end` (s), with `nwb` as NWB too.

    Raises:
        ConfigError: there is no such trial or time in the run.
        FolderError: it is no run folder, or the replay is not the run.
        OSError: something could not be written.
    """
    if not (folder / "config.yaml").is_file():
        raise FolderError(f"{folder}: no run folder (there is no config.yaml in it)")
    config = load(folder / "config.yaml")
    trials = range(config.trial_start, config.trial_start + config.trials)
    if trial not in trials:
        raise ConfigError("--trial", trial, f"the run has trials {trials[0]} to {trials[-1]}")
    if not 0 <= start < config.seconds:
        raise ConfigError("--from", start, f"must be at least 0 and less than the run's {config.seconds:g} s")
    end = min(start + LENGTH, config.seconds) if end is None else end
    if not start < end <= config.seconds:
        raise ConfigError("--to", end, f"must be more than --from={start:g} and at most the run's {config.seconds:g} s")
    original = Original(folder, trial)
    tick = config.body()[0].tick
    first, last = int(1000 * start / tick), ticks_of(config.seconds, tick)
    last = min(last, math.ceil(1000 * end / tick))
    recording = record(replace(config, trials=1, trial_start=trial), min(first, last - 1), last, original)
    to = folder / "replay" / f"trial-{trial}-{start:g}-{end:g}"
    save(recording, to)
    if nwb:
        described = f"{config.experiment.name}, {config.robot.name}, seed {config.seed}, trial {trial}"
        began = datetime.fromtimestamp((folder / "config.yaml").stat().st_mtime, UTC)
        write_nwb(recording, to / "replay.nwb", described, began)
    original.reach(recording.simulation, make_engine(config.engine, config.device, 1))
    report(recording, original, to)


def save(recording: Recording, folder: Path) -> None:
    """Write everything that a replay leaves."""
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "spikes.npz", spikes_of(recording))
    write(folder / "credit.csv", recording.credit.table())
    style.save(draw_raster(recording), folder / "raster")
    explained = draw_credit(recording)
    if explained is not None:
        style.save(explained, folder / "credit")
    animate(recording, folder)


def spikes_of(recording: Recording) -> bytes:
    """spikes.npz: `time` int64 [n] (ms since the start of the trial, ascending), `neuron` int64 [n], the names of the
    `groups` [G], the place of each group's first neuron `first` [G] and its `size` [G], the number of the `trial`,
    and `start` and `end` of the recording (ms).
    """
    groups = recording.simulation.network.groups
    return npz_of(
        {
            "time": recording.time,
            "neuron": recording.neuron,
            "groups": np.array(list(groups)),
            "first": np.array([group.start for group in groups.values()]),
            "size": np.array([group.size for group in groups.values()]),
            "trial": recording.trial,
            "start": recording.start,
            "end": recording.end,
        }
    )


def report(recording: Recording, original: Original, folder: Path) -> None:
    """Print in a few lines what was found."""
    same = f"the run's own, at {original.compared} samples" if original.compared else "not compared, no series.npz"
    causes = Counter(reward.cause for reward in recording.credit.rewards)
    said = ", ".join(f"{cause} {count}" for cause, count in causes.most_common()) or "none"
    print(f"trial {recording.trial}, {recording.start / 1000:g} to {recording.end / 1000:g} s")
    print(f"  way of the robot    {same}")
    print(f"  dopamine after      {said}")
    if not recording.credit.synapses:
        print("  credit              no synapse is plastic")
    print(f"  results             {folder}")


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("run", type=Path, metavar="RUN_FOLDER")
    made.add_argument("--trial", type=int, required=True, help="its number in the run")
    made.add_argument("--from", type=float, default=0.0, dest="start", metavar="S", help="simulated s (default 0)")
    made.add_argument("--to", type=float, dest="end", metavar="S", help="simulated s (default: 30 s later)")
    made.add_argument("--nwb", action="store_true", help='replay.nwb too; needs pip install "snnrl[nwb]"')
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    options = parser().parse_args(arguments)
    try:
        replay(options.run, options.trial, options.start, options.end, options.nwb)
    except FORESEEN as error:
        print(f"snnrl.replay: {explain(error)}", file=sys.stderr)
        sys.exit(status(error))

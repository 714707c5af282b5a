"""One trial of a run again, with everything recorded: an animation, the spikes, and which synapse owes what to whom.

    python -m snnrl.replay RUN_FOLDER --trial 17 [--from S] [--to S]

A trial depends on nothing but the run's seed and its number, so it is run again from its start by the run's own
engine. What happened between --from and --to (simulated s; the first 30 s) is written to
RUN_FOLDER/replay/trial-17-FROM-TO: replay.gif (and replay.mp4 where there is ffmpeg), raster.png, credit.csv,
credit.png and spikes.npz. See docs/replay.md.
"""

from __future__ import annotations

import argparse
import io
import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from snnrl.builder import build
from snnrl.configuration.compose import load
from snnrl.configuration.schema import FOOD, Config, ConfigError
from snnrl.engines import Engine, make_engine
from snnrl.files import FolderError, write
from snnrl.replay.credit import Credit, Ledger, cause_of
from snnrl.replay.scenes import animate, draw_credit, draw_raster
from snnrl.running.command import FORESEEN, explain, status
from snnrl.simulation import Simulation
from snnrl.thesis.runs import Run

LENGTH = 30.0  # s that are recorded unless told otherwise


@dataclass(frozen=True)
class Recording:
    """Everything in a stretch of one trial.

    Attributes:
        simulation: after its end.
        trial: its number.
        start: the first ms. tick: ms of a control tick.
        time, neuron: the spikes, int64 [n], ms since the start of the trial and place in the network.
        scenes: the world's state in each tick, K of them. touches: in each tick, int64 by kind of object, [K] each.
        poison: whether food was poison, bool [K]. wheels: what the spikes of each tick chose, int64 [K],
            -1 for a turn to the left, 0 straight ahead, 1 to the right.
        levels: dopamine after each ms (uM), [T]; empty without dopamine.
        credit: what dopamine did to the synapses.
    """

    simulation: Simulation
    trial: int
    start: int
    tick: int
    time: np.ndarray
    neuron: np.ndarray
    scenes: list[dict[str, Tensor]]
    touches: dict[str, np.ndarray]
    poison: np.ndarray
    wheels: np.ndarray
    levels: np.ndarray
    credit: Credit

    @property
    def end(self) -> int:
        return self.start + len(self.scenes) * self.tick


class Original:
    """What the run has recorded of the trial, to compare its replay with; nothing if it is not complete."""

    def __init__(self, folder: Path, trial: int) -> None:
        self.folder, self.samples, self.compared = folder, {}, 0
        if not (folder / "series.npz").exists():
            return
        series = Run(folder).series
        column = series["trials"].tolist().index(trial)
        for row, seconds in enumerate(series["time"].tolist()):
            self.samples[round(1000 * seconds)] = series["position"][row, column], series["heading"][row, column]

    def compare(self, simulation: Simulation) -> None:
        """Whether the robot is where it was, if there was a sample; its way depends on every spike before.

        Raises:
            FolderError: it is not.
        """
        now = int(simulation.network.time)
        if now not in self.samples:
            return
        position, heading = self.samples[now]
        here = (
            simulation.situation.world.position[0].float().cpu().numpy(),
            simulation.situation.world.heading[0].float().cpu().numpy(),
        )
        if not (np.array_equal(here[0], position) and here[1] == heading):
            was, found = (f"({x:.3f}, {y:.3f})" for x, y in (position.tolist(), here[0].tolist()))
            raise FolderError(
                f"{self.folder}: the replay is not the run, by another version of the code or its libraries: "
                f"at {now / 1000:g} s the robot was at {was}, now it is at {found}"
            )
        self.compared += 1

    def reach(self, simulation: Simulation, engine: Engine) -> None:
        """Where no sample lay in the recording, go on to the next one and compare."""
        while not self.compared and int(simulation.network.time) < max(self.samples, default=0):
            simulation.run(engine, 1)
            self.compare(simulation)


def record(config: Config, first: int, last: int, original: Original) -> Recording:
    """Run a trial from its start and record the ticks from `first` up to, not including, `last`.

    Raises:
        FolderError: the replay is not the run.
    """
    simulation = build(config)
    network, world, tick = simulation.network, simulation.situation.world, simulation.situation.coding.tick
    engine = make_engine(config.engine, config.device, 1)
    if first:
        simulation.run(engine, first)
    original.compare(simulation)
    follower = build(replace(config, dtype="float64", device="cpu")).network
    follower.load_state_dict(network.state_dict())
    ledger = Ledger(follower)
    names = world.kinds.names
    food = names.index(FOOD) if FOOD in names else None
    scenes, touches, poison, wheels, spikes = [], [world.touches[0].cpu().clone()], [], [], []
    raster = torch.zeros(tick, 1, network.size, dtype=torch.bool)
    for k in range(first, last):
        poison.append(bool(world.value(network.time)[food] < 0) if food is not None else False)
        motors = network.spike_count[0, simulation.situation.coding.motor_groups].clone()
        simulation.run(engine, 1, raster)
        left, right = (network.spike_count[0, simulation.situation.coding.motor_groups] - motors).tolist()
        scenes.append({key: values.cpu().clone() for key, values in world.state_dict().items()})
        touches.append(world.touches[0].cpu().clone())
        wheels.append(int(np.sign(left - right)))
        spikes.append(raster[:, 0].nonzero() + torch.tensor([k * tick, 0]))
        lately = (touches[-1] - touches[max(0, len(touches) - 3)]).tolist()
        cause = cause_of(dict(zip(names, lately, strict=True)), poison[-1])
        ledger.follow(raster, float(world.sign[0]), cause, network.synapses.weight[: len(ledger.weight)])
        original.compare(simulation)
    ledger.close()
    time, neuron = torch.cat(spikes).numpy().T
    return Recording(
        simulation,
        int(network.draws.trials[0]),
        first * tick,
        tick,
        time,
        neuron,
        scenes,
        dict(zip(names, torch.stack(touches).diff(dim=0).numpy().T, strict=True)),
        np.array(poison),
        np.array(wheels),
        np.array(ledger.levels),
        Credit(ledger, time, neuron),
    )


def replay(folder: Path, trial: int, start: float = 0.0, end: float | None = None) -> None:
    """Replay a trial and write what was recorded from `start` to `end` (s).

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
    first, last = int(1000 * start / tick), max(1, round(1000 * config.seconds / tick))
    last = min(last, math.ceil(1000 * end / tick))
    recording = record(replace(config, trials=1, trial_start=trial), min(first, last - 1), last, original)
    to = folder / "replay" / f"trial-{trial}-{start:g}-{end:g}"
    save(recording, to)
    original.reach(recording.simulation, make_engine(config.engine, config.device, 1))
    report(recording, original, to)


def save(recording: Recording, folder: Path) -> None:
    """Write everything that a replay leaves."""
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "spikes.npz", spikes_of(recording))
    write(folder / "credit.csv", recording.credit.table())
    write(folder / "raster.png", png(draw_raster(recording)))
    explained = draw_credit(recording)
    if explained is not None:
        write(folder / "credit.png", png(explained))
    animate(recording, folder)


def spikes_of(recording: Recording) -> bytes:
    """spikes.npz: `time` int64 [n] (ms since the start of the trial, ascending), `neuron` int64 [n], the names of the
    `groups` [G], the place of each group's first neuron `first` [G] and its `size` [G], the number of the `trial`,
    and `start` and `end` of the recording (ms).
    """
    groups = recording.simulation.network.groups
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        time=recording.time,
        neuron=recording.neuron,
        groups=np.array(list(groups)),
        first=np.array([group.start for group in groups.values()]),
        size=np.array([group.size for group in groups.values()]),
        trial=recording.trial,
        start=recording.start,
        end=recording.end,
    )
    return buffer.getvalue()


def png(drawn: Figure) -> bytes:
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue()


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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--trial", type=int, required=True, help="its number in the run")
    parser.add_argument("--from", type=float, default=0.0, dest="start", metavar="S", help="simulated s (default 0)")
    parser.add_argument("--to", type=float, dest="end", metavar="S", help="simulated s (default: 30 s later)")
    options = parser.parse_args(arguments)
    try:
        replay(options.run, options.trial, options.start, options.end)
    except FORESEEN as error:
        print(f"snnrl.replay: {explain(error)}", file=sys.stderr)
        sys.exit(status(error))

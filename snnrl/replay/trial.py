"""One trial run again from its start, everything in a stretch of it recorded, and compared with its run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.engines import Engine, make_engine
from snnrl.files import FolderError
from snnrl.recording.runs import Run
from snnrl.replay.credit import Credit, Ledger, cause_of
from snnrl.schema import FOOD, Config
from snnrl.simulation import Simulation


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
    network, world, tick = simulation.network, simulation.situation.world, simulation.tick
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

"""What runs with given free values come to, cell by cell of the loss."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from snnrl.body.world.geometry import escape_radius
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import Engine, make_engine
from snnrl.model.network import Network
from snnrl.recording.criteria import correct
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, Config
from snnrl.simulation import Simulation
from snnrl.thesis.box import FREE, OWN_MEAN, has, options_of
from snnrl.thesis.claims import pathways, settled, smooth
from snnrl.thesis.compare import contrast
from snnrl.thesis.loss import (
    Cells,
    Outcome,
    background_cells,
    food_cells,
    orbit_cells,
    run_cells,
    tail,
)
from snnrl.thesis.published import published

COURSE = ("food_attraction", "learning")  # of which the text says when it has learnt


def prepare(
    experiment: str, robot: str, values: Mapping[str, Any], trials: int, seed: int
) -> tuple[Simulation, Config, Engine]:
    """One cell's run at its published length, not yet begun; free values of what its world has not are left out."""
    described = compose(f"+experiment={experiment}")
    known = {key: value for key, value in options_of(values).items() if key not in FREE or has(described, key)}
    options = {"trials": trials, "seed": seed, "robot": robot, **known}
    config = compose(
        f"+experiment={experiment}",
        *(f"++{key}={value}" if key == OWN_MEAN else f"{key}={value}" for key, value in options.items()),
    )
    return build(config), config, make_engine("auto", config.device)


def simulate(
    experiment: str, robot: str, values: Mapping[str, Any], trials: int, seed: int
) -> tuple[Simulation, Config]:
    """One cell's run, ended."""
    simulation, config, engine = prepare(experiment, robot, values, trials, seed)
    simulation.run(engine, ticks_of(config.seconds, simulation.tick))
    return simulation, config


def outcome(experiment: str, robot: str, values: Mapping[str, Any], trials: int, seed: int) -> Outcome:
    """What one cell's run came to."""
    simulation, config, engine = prepare(experiment, robot, values, trials, seed)
    ticks, last, every = (
        ticks_of(seconds, simulation.tick) for seconds in (config.seconds, tail(config.seconds), config.record.every)
    )
    samples = [*range(every, ticks, every), ticks]
    food, attraction, done = {0: np.zeros(trials, np.int64)}, [], 0
    for tick in sorted({*samples, ticks - last}):
        simulation.run(engine, tick - done)
        food[tick], done = simulation.situation.world.count(FOOD).numpy().copy(), tick
        if tick in samples:
            weights = mean_weights(simulation.network)
            attraction.append(np.mean([weights[name] for name in pathways(FOOD, "attraction")], 0))
    told_apart = published()["contrast"].get(experiment, {}).get(robot)
    weights = mean_weights(simulation.network)
    containers = [weights[name] for name in pathways("container", "attraction") if name in weights]
    ours = Outcome(
        food[ticks].astype(float),
        food[ticks] - food[ticks - last],
        correct(simulation.network, config.experiment.correct).numpy(),
        contrast(weights, told_apart["factor"]) if told_apart else None,
        np.stack(containers) if containers else None,
    )
    if (experiment, robot) != COURSE or len(samples) < 2:
        return ours
    time = np.array(samples) * simulation.tick / 1000
    rate = np.diff([food[tick] for tick in (0, *samples)], axis=0) / np.diff([0.0, *time])[:, None]
    at = settled(time, np.array(attraction)), settled(time, smooth(rate, max(1, len(time) // 20)))
    return replace(ours, saturated=at[0], settled=at[1])


def mean_weights(network: Network) -> dict[str, np.ndarray]:
    """Mean weight (mV) of each projection, [B] each."""
    return {name: projection.mean_weight().numpy() for name, projection in network.projections.items()}


def escape_times(robot: str, values: Mapping[str, Any], trials: int, seed: int) -> Tensor:
    """When a robot leaves its orbit (s), nan where it does not, [B]."""
    simulation, config, engine = prepare("orbit", robot, values, trials, seed)
    times = torch.full((trials,), torch.nan, dtype=torch.float64)
    coding, world = config.body()
    limit = escape_radius(coding.slow, coding.fast, coding.tick / 1000, world.axle)
    for k in range(ticks_of(config.seconds, coding.tick)):
        simulation.run(engine, 1)
        left = (simulation.situation.world.nearest_item() > limit) | (simulation.situation.world.count(FOOD) > 0)
        times = torch.where(left & times.isnan(), (k + 1) * coding.tick / 1000, times)
    return times


def background_rate(values: Mapping[str, Any], trials: int, seed: int, seconds: float = 140.0) -> Tensor:
    """Firing of the dopaminergic neurons where there is no food to touch, without the start (Hz), [B]."""
    empty = {"world.kinds.food.count": 0, **values}
    simulation, _, engine = prepare("food_attraction", "random_walk", empty, trials, seed)
    network, tick = simulation.network, simulation.tick
    assert network.dopamine is not None
    source = network.dopamine.sources["count"]
    place = list(network.groups).index(source)
    simulation.run(engine, round(2000 / tick))
    before, start = network.spike_count[:, place].clone(), int(network.time)
    simulation.run(engine, ticks_of(seconds, tick))
    elapsed = (int(network.time) - start) / 1000
    return (network.spike_count[:, place] - before).double() / (network.groups[source].size * elapsed)


def dose(values: Mapping[str, Any], trials: int, seed: int, seconds: float = 140.0) -> Tensor:
    """What a food item releases (uM) on average over all items of a robot that learns nothing, [1]; none, [0]."""
    simulation, config, engine = prepare("food_attraction", "random_walk", values, trials, seed)
    network, tick, total = simulation.network, simulation.tick, torch.zeros(1, dtype=torch.float64)
    dopamine = network.dopamine
    assert dopamine is not None
    span = network.groups[dopamine.sources["count"]].span
    raster = torch.zeros(ticks_of(config.record.every, tick) * tick, trials, network.size, dtype=torch.bool)
    for _ in range(round(seconds / config.record.every)):
        simulation.run(engine, len(raster) // tick, raster)
        total += dopamine.released(raster[:, :, span].sum(2).double(), *dopamine.further).sum()
    items = int(simulation.situation.world.count(FOOD).sum())
    return total[: min(items, 1)] / max(items, 1)


def waits(values: Mapping[str, Any], trials: int, seed: int, seconds: float = 140.0) -> Tensor:
    """From entering a container to taking the food in it (s), of all items of benchmark robots, [n]."""
    simulation, _, engine = prepare("secondary_behaviour", "benchmark", values, trials, seed)
    world, found = simulation.situation.world, []
    entered = torch.full((trials,), torch.nan, dtype=torch.float64)
    for k in range(ticks_of(seconds, simulation.tick)):
        before = [world.count(kind).clone() for kind in ("food_container", FOOD)]
        simulation.run(engine, 1)
        enters, takes = (
            world.count(kind) > count for kind, count in zip(("food_container", FOOD), before, strict=True)
        )
        now = k * simulation.tick / 1000
        entered = torch.where(enters, now, entered)
        found.append(now - entered[takes])
    return torch.cat(found)


def cells_of(runs: Iterable[tuple[str, str]], values: Mapping[str, Any], trials: int, seed: int) -> Cells:
    """Name and distance of the published cells of some runs."""
    for experiment, robot in runs:
        yield from run_cells(experiment, robot, outcome(experiment, robot, values, trials, seed), published())


def orbits(values: Mapping[str, Any], trials: int, seed: int) -> Cells:
    """Name and distance of the cells of the orbit."""
    theirs = published()
    for robot in theirs["escaped"]["orbit"]:
        yield from orbit_cells(robot, escape_times(robot, values, trials, seed).numpy(), theirs)


def measured(values: Mapping[str, Any], trials: int, seed: int) -> Cells:
    """Name and distance of every cell of the loss."""
    theirs = published()
    yield from cells_of(runs_of(theirs), values, trials, seed)
    yield from orbits(values, theirs["escaped"]["trials"], seed)
    released, waited = (measure(values, trials, seed).numpy() for measure in (dose, waits))
    yield from food_cells(released, waited, theirs)
    yield from background_cells(background_rate(values, trials, seed).numpy(), theirs)


def runs_of(theirs: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Experiment and robot of every run with a published cell."""
    return sorted(
        {
            (experiment, robot)
            for kind in ("food", "correct", "contrast", "failed_weakly")
            for experiment, robots in theirs[kind].items()
            for robot in robots
        }
    )

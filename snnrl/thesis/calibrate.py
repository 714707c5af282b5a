"""Fit the free parameters to all published cells together: one set of values for every experiment.

    python -m snnrl.calibrate [--points 40] [--trials 16] [--study runs/calibration.db]
    python -m snnrl.calibrate --sensitivity    # change the values in conf/ one at a time
    python -m snnrl.calibrate --record NOTE    # write what the study holds into the package, for the report

The loss is that of `snnrl.thesis.loss`. The study is kept in the file; running the command again continues it, and
several at once share it.
Seeds of the fit start at 1,000,000, far from those of the runs that are reported.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import torch
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import Engine, make_engine
from snnrl.files import write_json
from snnrl.model.network import Network
from snnrl.recording.criteria import correct
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, Config
from snnrl.simulation import Simulation
from snnrl.thesis.claims import escape_rule, pathways, settled, smooth
from snnrl.thesis.compare import contrast
from snnrl.thesis.fit import CALIBRATION
from snnrl.thesis.loss import (
    UNIT,
    Cells,
    Outcome,
    background_cells,
    food_cells,
    loss,
    orbit_cells,
    run_cells,
    tail,
)
from snnrl.thesis.published import published

FIRST_SEED = 1_000_000
LAST = 2  # step of the last of the `rungs`
FEWER = 4  # of so many points one goes on to the next rung
COURSE = ("food_attraction", "learning")  # of which the text says when it has learnt
CHEAP = (COURSE, ("secondary_behaviour", "container_dopamine_learning"))  # with the orbit, what most points fail
TELLING = (  # what most of the others fail
    ("secondary_behaviour", "benchmark"),
    ("secondary_behaviour", "fixed_container_dopamine"),
    ("secondary_behaviour", "no_container_dopamine"),
    ("dual_learning", "learning"),
)


@dataclass(frozen=True)
class Free:
    """A free parameter: where it is searched, and how far the sensitivity moves it; wide ranges by their logarithm."""

    low: float
    high: float
    step: float

    def suggest(self, trial: optuna.Trial, name: str) -> float:
        return trial.suggest_float(name, self.low, self.high, log=self.high > 3 * self.low > 0)


@dataclass(frozen=True)
class Choice:
    """A free choice."""

    values: tuple[Any, ...]

    def suggest(self, trial: optuna.Trial, name: str) -> Any:
        return trial.suggest_categorical(name, self.values)


OWN_MEAN = "+network.homeostasis.per_set.container_dopamine.count_absent"  # None: as that of the other sets
FREE: Mapping[str, Free | Choice] = {
    "coding.range_gain": Free(1.0, 3.5, 0.2),
    "coding.touch_gain": Free(2.0, 6.0, 0.5),
    "coding.exploration_gain": Free(0.9, 2.2, 0.2),
    "coding.exploration_drawn": Choice(("each_ms", "each_tick")),
    "coding.gain_acts_on": Choice(("counts", "mean")),
    "network.synaptic_gain": Free(0.9, 5.0, 0.4),
    "network.dopamine.tau": Free(6.0, 40.0, 3.0),
    "network.groups.inhibitory.current": Choice((0.0, 4.5)),  # silent below 3.85
    "network.groups.dopaminergic.noise": Free(0.0, 0.29, 0.1),
    "network.groups.dopaminergic.kick_rate": Free(0.0, 0.45, 0.2),
    "network.plasticity.simultaneous": Choice(("potentiates", "depresses")),
    "network.plasticity.potentiation_from": Choice(("departure", "arrival")),
    "network.homeostasis.count_absent": Choice((True, False)),
    OWN_MEAN: Choice((None, False)),
    "world.ranges.food.measured_to": Choice(("border", "centre")),
    "world.ranges.container.measured_to": Choice(("border", "centre")),
    "world.kinds.food_container.avoids": Choice(("[]", "[robot]", "[robot,containers]")),
    "world.kinds.food_container.contains": Choice(("centre", "whole")),
    "world.overlap": Choice(("stays", "nearest")),
}
KICK = {"network.groups.dopaminergic.kick": 25.0}  # fires a neuron that rests
ARRIVAL = ("network.plasticity.potentiation_from", "arrival")
# What has come near in other searches, over the values in conf/.
STARTS: tuple[Mapping[str, Any], ...] = (
    {},
    {"network.plasticity.simultaneous": "depresses"},
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.6,
        "network.dopamine.tau": 15.0,
        "coding.exploration_gain": 1.45,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.6,
        "network.dopamine.tau": 18.0,
        "coding.exploration_gain": 1.66,
        "coding.range_gain": 2.07,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.4,
        "network.dopamine.tau": 20.0,
        "coding.exploration_gain": 1.3,
        "coding.range_gain": 1.53,
        "coding.touch_gain": 4.67,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 3.2,
        "network.dopamine.tau": 12.0,
        "coding.exploration_gain": 1.2,
        "coding.range_gain": 1.6,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.8,
        "network.dopamine.tau": 15.0,
        "coding.exploration_gain": 1.3,
        "coding.range_gain": 3.0,
        "coding.touch_gain": 4.17,
    },
    {
        "network.synaptic_gain": 1.75,
        "network.dopamine.tau": 8.0,
        "coding.range_gain": 1.75,
        "coding.touch_gain": 3.0,
    },
    {
        "network.synaptic_gain": 1.0,
        "network.dopamine.tau": 6.0,
        "network.groups.dopaminergic.noise": 0.0,
        "network.groups.dopaminergic.kick_rate": 0.4,
        "coding.touch_gain": 3.0,
    },
)


def value_of(config: Any, name: str) -> Any:
    """The value of a key of a configuration; None where it has no such key."""
    found = config
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else getattr(found, key, None)
    return found


def has(config: Config, name: str) -> bool:
    """Whether a free value has a place in a configuration."""
    if name == OWN_MEAN:
        return "container_dopamine" in config.network.homeostasis.sets
    return value_of(config, name) is not None


def present() -> dict[str, Any]:
    """The free parameters as they are in conf/."""
    config = compose("+experiment=dual_learning")
    found = {name: value_of(config, name) for name in FREE}
    return {name: f"[{','.join(value)}]" if isinstance(value, list) else value for name, value in found.items()}


def options_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Free values as overrides; what counts from a spike's arrival depresses in the ms of its departure."""
    found = {**KICK, **values} if values.get("network.groups.dopaminergic.kick_rate") else dict(values)
    if found.get(OWN_MEAN, 0) is None:
        del found[OWN_MEAN]
    if found.get(ARRIVAL[0]) == ARRIVAL[1]:
        found["network.plasticity.simultaneous"] = "depresses"
    return found


def prepare(
    experiment: str, robot: str, values: Mapping[str, Any], trials: int, seed: int
) -> tuple[Simulation, Config, Engine]:
    """One cell's run at its published length, not yet begun; free values of what its world has not are left out."""
    described = compose(f"+experiment={experiment}")
    known = {key: value for key, value in options_of(values).items() if key not in FREE or has(described, key)}
    options = {"trials": trials, "seed": seed, "robot": robot, **known}
    config = compose(f"+experiment={experiment}", *(f"{key}={value}" for key, value in options.items()))
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
    limit = escape_rule(coding.slow, coding.fast, coding.tick, world.axle)
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
            for kind in ("food", "correct", "contrast", "failed_strong")
            for experiment, robots in theirs[kind].items()
            for robot in robots
        }
    )


def rungs(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[dict[str, float]]:
    """What a point is judged by, each time by more: what is cheap and what tells most, by few trials; then all."""
    few = max(2, trials // 3)
    found = dict([*orbits(values, few, seed), *cells_of(CHEAP, values, few, seed)])
    yield found
    yield {**found, **dict(cells_of(TELLING, values, few, seed))}
    yield dict(measured(values, trials, seed))


def search(study: optuna.Study, points: int, trials: int) -> None:
    """Add points to the study, STARTS first; of each FEWER that come to a rung, the best goes on to the next."""
    study.sampler = optuna.samplers.TPESampler(
        seed=FIRST_SEED + len(study.trials), multivariate=True, constant_liar=True
    )
    study.pruner = optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=FEWER)
    if not study.trials:
        for start in STARTS:
            study.enqueue_trial({**present(), **start})

    def objective(trial: optuna.Trial) -> float:
        values = {name: free.suggest(trial, name) for name, free in FREE.items()}
        trial.set_user_attr("trials", trials)
        found: dict[str, float] = {}
        for step, found in enumerate(rungs(values, trials, FIRST_SEED + trial.number)):
            trial.set_user_attr("distances", found)
            trial.report(loss(found), FEWER**step)
            if step < LAST and trial.should_prune():
                raise optuna.TrialPruned
        return loss(found)

    study.optimize(objective, n_trials=points)


def neighbours(values: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Every change of one value: a step down and up where that is searched too, or another choice."""
    result: list[tuple[str, Any]] = []
    for name, free in FREE.items():
        if isinstance(free, Free):
            around = (round(values[name] - free.step, 6), round(values[name] + free.step, 6))
            result += [(name, value) for value in around if free.low <= value <= free.high]
        else:
            result += [(name, value) for value in free.values if value != values[name]]
    return result


def vary(study: optuna.Study, trials: int) -> None:
    """Evaluate the values in conf/ and all their neighbours, on the same seed; what is there already is kept."""
    values = present()
    changes: list[tuple[str, Any]] = [("", None), *neighbours(values)]
    done = {tuple(trial.user_attrs["change"]) for trial in study.get_trials() if "distances" in trial.user_attrs}
    for change in changes:
        if change in done:
            continue
        name, value = change
        found = dict(measured({**values, **({name: value} if name else {})}, trials, FIRST_SEED - 1))
        attributes = {"change": list(change), "distances": found, "trials": trials}
        study.add_trial(optuna.trial.create_trial(value=loss(found), user_attrs=attributes))
        print(f"{loss(found):.2f}  {name or 'conf/'} {'' if value is None else value}")


def record(fit: optuna.Study, sensitivity: optuna.Study, note: str) -> dict[str, Any]:
    """What the report shows of both studies, and what there is to say of them."""
    finished = fit.get_trials(states=[optuna.trial.TrialState.COMPLETE])
    return {
        "values": present(),
        "note": note,
        "unit": UNIT,
        "first_seed": FIRST_SEED,
        "given_up": len(fit.get_trials(states=[optuna.trial.TrialState.PRUNED])),
        "trials": sorted({trial.user_attrs["trials"] for trial in finished}),
        "history": [{"number": trial.number, "loss": trial.value, "values": trial.params} for trial in finished],
        "sensitivity": [
            {"loss": trial.value, **trial.user_attrs} for trial in sensitivity.get_trials() if trial.user_attrs
        ],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=40, help="points to add to the study")
    parser.add_argument("--trials", type=int, default=16, help="trials a cell and point")
    parser.add_argument("--study", type=Path, default=Path("runs/calibration.db"))
    parser.add_argument("--sensitivity", action="store_true", help="vary the values in conf/ one at a time instead")
    parser.add_argument(
        "--record", metavar="NOTE", help=f"write the studies, and a note, to {CALIBRATION.name} instead"
    )
    arguments = parser.parse_args()
    arguments.study.parent.mkdir(parents=True, exist_ok=True)
    fit, sensitivity = (
        optuna.create_study(storage=f"sqlite:///{arguments.study}", study_name=name, load_if_exists=True)
        for name in ("calibration by rungs", "sensitivity by published spreads")
    )
    if arguments.record is not None:
        write_json(CALIBRATION, record(fit, sensitivity, arguments.record))
    elif arguments.sensitivity:
        vary(sensitivity, arguments.trials)
    else:
        search(fit, arguments.points, arguments.trials)
        print(f"best of {len(fit.trials)}: {fit.best_value:.2f}")
        for name, value in fit.best_params.items():
            print(f"  {name}: {value}")
        for name, value in sorted(fit.best_trial.user_attrs["distances"].items()):
            print(f"  {value:+6.1f}  {name}")

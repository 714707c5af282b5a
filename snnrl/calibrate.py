"""Fit the free parameters to all published cells together: one set of values for every experiment.

    python -m snnrl.calibrate [--points 40] [--trials 16] [--study runs/calibration.db]

The study is kept in the file; running the command again continues it. Seeds of the fit start at 1,000,000,
far from those of the runs that are reported.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import optuna
import torch
import yaml
from torch import Tensor

from snnrl.analysis import PUBLISHED
from snnrl.analysis.criteria import correct
from snnrl.builder import build
from snnrl.config import compose
from snnrl.engines import make_engine
from snnrl.loop import Simulation

FIRST_SEED = 1_000_000
FREE: Mapping[str, Callable[[optuna.Trial, str], Any]] = {
    "coding.range_gain": lambda trial, name: trial.suggest_float(name, 0.8, 2.5),
    "coding.touch_gain": lambda trial, name: trial.suggest_float(name, 1.5, 4.0),
    "network.synaptic_gain": lambda trial, name: trial.suggest_float(name, 2.0, 6.0),
    "network.dopamine.tau": lambda trial, name: trial.suggest_float(name, 10.0, 60.0, log=True),
    "network.groups.dopaminergic.noise": lambda trial, name: trial.suggest_float(name, 0.24, 0.32),
    "world.ranges.food.measured_to": lambda trial, name: trial.suggest_categorical(name, ["border", "centre"]),
    "network.homeostasis.count_absent": lambda trial, name: trial.suggest_categorical(name, [True, False]),
}
CONTAINERS = "world.ranges.container.measured_to"  # exists only in worlds with containers


def present() -> dict[str, Any]:
    """The free parameters as they are in conf/."""
    config = compose("+experiment=dual_learning")

    def value(name: str) -> Any:
        found: Any = config
        for key in name.split("."):
            found = found[key] if isinstance(found, dict) else getattr(found, key)
        return found

    return {name: value(name) for name in (*FREE, CONTAINERS)}


def simulate(experiment: str, robot: str, values: Mapping[str, Any], trials: int, seed: int) -> tuple[Simulation, Any]:
    """One cell's run at its published length."""
    options = {"trials": trials, "seed": seed, "robot": robot, **values}
    if experiment.startswith("food"):
        options.pop(CONTAINERS, None)
    config = compose(f"+experiment={experiment}", *(f"{key}={value}" for key, value in options.items()))
    simulation = build(config)
    make_engine("auto", config.device).run(simulation, round(1000 * config.seconds / simulation.coding.tick))
    return simulation, config


def fraction_distance(ours: Tensor, published: float, trials: int) -> float:
    """Difference of two fractions in standard errors, each shrunk by two successes and two failures."""
    n = len(ours)
    p, q = (float(ours.sum()) + 2) / (n + 4), (published * trials + 2) / (trials + 4)
    return (p - q) / math.sqrt(p * (1 - p) / (n + 4) + q * (1 - q) / (trials + 4))


def mean_distance(ours: Tensor, published: Mapping[str, float], trials: int) -> float:
    """Difference of two means in standard errors of the difference."""
    variance = float(ours.var()) / len(ours) + published["sd"] ** 2 / trials
    return (float(ours.mean()) - published["mean"]) / math.sqrt(variance)


def contrast(simulation: Simulation, factor: float) -> Tensor:
    """Whether the food container's touch excites dopamine more than `factor` times the empty one's, bool [B]."""
    food, empty = (
        simulation.network.projections[f"{kind}_container_touch_to_dopaminergic"].mean_weight()
        for kind in ("food", "empty")
    )
    return food > factor * empty


def distances(values: Mapping[str, Any], trials: int, seed: int) -> dict[str, float]:
    """Signed distance of every published cell, in its units of uncertainty."""
    published = yaml.safe_load(PUBLISHED.read_text())
    count = published["trials"]
    pairs = {
        (experiment, robot)
        for kind in ("food", "correct", "contrast")
        for experiment, robots in published[kind].items()
        for robot in robots
    }
    result = {}
    for experiment, robot in sorted(pairs):
        simulation, config = simulate(experiment, robot, values, trials, seed)
        name = f"{experiment}/{robot}"
        if cell := published["food"].get(experiment, {}).get(robot):
            result[f"{name}/food"] = mean_distance(simulation.world.touches[:, 0].double(), cell, count)
        if (cell := published["correct"].get(experiment, {}).get(robot)) is not None:
            learnt = correct(simulation.network, config.experiment.correct)
            result[f"{name}/correct"] = fraction_distance(learnt, cell, count)
        if cell := published["contrast"].get(experiment, {}).get(robot):
            clear = contrast(simulation, cell["factor"])
            result[f"{name}/contrast"] = fraction_distance(clear, cell["fraction"], count)
    return result


def loss(found: Mapping[str, float]) -> float:
    """Root mean square distance, each limited to 10 so that no single cell decides alone."""
    return math.sqrt(sum(min(abs(value), 10.0) ** 2 for value in found.values()) / len(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=40, help="points to add to the study")
    parser.add_argument("--trials", type=int, default=16, help="trials a cell and point")
    parser.add_argument("--study", type=Path, default=Path("runs/calibration.db"))
    arguments = parser.parse_args()
    arguments.study.parent.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{arguments.study}",
        study_name="calibration",
        load_if_exists=True,
    )
    study.sampler = optuna.samplers.TPESampler(seed=FIRST_SEED + len(study.trials), multivariate=True)

    if not study.trials:
        study.enqueue_trial(present())

    def objective(trial: optuna.Trial) -> float:
        values = {name: suggest(trial, name) for name, suggest in FREE.items()}
        values[CONTAINERS] = trial.suggest_categorical(CONTAINERS, ["border", "centre"])
        found = distances(values, arguments.trials, FIRST_SEED + trial.number)
        for name, value in found.items():
            trial.set_user_attr(name, value)
        return loss(found)

    study.optimize(objective, n_trials=arguments.points)
    print(f"best of {len(study.trials)}: {study.best_value:.2f}")
    for name, value in study.best_params.items():
        print(f"  {name}: {value}")
    for name, value in sorted(study.best_trial.user_attrs.items()):
        print(f"  {value:+6.1f}  {name}")


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()

"""Search the parameters of STDP for the most food (thesis 3.7), by Optuna.

    python -m snnrl.search [--points 40] [--trials 15] [--study runs/stdp_search.db]

The study is kept in the file; running the command again continues it. The values in conf/ are its first point.
The plain grid over the same parameters is part of `python -m snnrl.reproduce`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import optuna
import torch

from snnrl.configuration.compose import compose
from snnrl.schema import FOOD
from snnrl.thesis.calibrate import FIRST_SEED
from snnrl.thesis.fit import FACTORS, PLANES
from snnrl.thesis.measuring import simulate
from snnrl.thesis.verdicts import p_greater

NAMES = [name for plane in PLANES for name in plane]


def search(study: optuna.Study, points: int, trials: int, options: Mapping[str, Any] | None = None) -> None:
    """Add points to the study, each between the extremes of the grid, on a logarithmic scale.

    `options` are further overrides of the configuration.
    """
    rule = compose("+experiment=stdp_search").network.plasticity
    centre = {name: float(getattr(rule, name)) for name in NAMES}
    study.sampler = optuna.samplers.TPESampler(seed=FIRST_SEED + len(study.trials), multivariate=True)
    if not study.trials:
        study.enqueue_trial(centre)

    def objective(trial: optuna.Trial) -> float:
        values = {
            f"network.plasticity.{name}": trial.suggest_float(
                name, FACTORS[0] * centre[name], FACTORS[-1] * centre[name], log=True
            )
            for name in NAMES
        } | dict(options or {})
        simulation, _ = simulate("stdp_search", "learning", values, trials, FIRST_SEED + trial.number)
        food = simulation.situation.world.count(FOOD).double()
        trial.set_user_attr("food", food.tolist())
        return float(food.mean())

    study.optimize(objective, n_trials=points)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--points", type=int, default=40, help="points to add to the study")
    made.add_argument("--trials", type=int, default=15, help="trials a point")
    made.add_argument("--study", type=Path, default=Path("runs/stdp_search.db"))
    return made


@torch.no_grad()
def main() -> None:
    arguments = parser().parse_args()
    arguments.study.parent.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{arguments.study}", study_name="stdp_search", direction="maximize", load_if_exists=True
    )
    search(study, arguments.points, arguments.trials)
    best, first = study.best_trial, study.trials[0]
    print(f"best of {len(study.trials)}: {best.value:.1f} items, {best.params}")
    p = p_greater(best.user_attrs["food"], first.user_attrs["food"])
    print(f"the values in conf/: {first.value:.1f} items; one-sided Welch test against the best: p = {p:.3f}")

"""Distances to the published cells, in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import optuna
import pytest
import torch
import yaml
from helpers import compose_config

from snnrl.builder import build
from snnrl.thesis import calibrate
from snnrl.thesis.calibrate import FREE, contrast, fraction_distance, loss, mean_distance, neighbours, present
from snnrl.thesis.published import PUBLISHED
from snnrl.thesis.search import search


def test_a_difference_of_means_in_standard_errors() -> None:
    ours = torch.tensor([10.0, 14.0, 12.0, 16.0], dtype=torch.float64)  # mean 13, variance 20 / 3
    error = math.sqrt(20 / 3 / 4 + 5.0**2 / 50)
    assert mean_distance(ours, {"mean": 11.0, "sd": 5.0}, 50) == pytest.approx(2.0 / error)


def test_a_difference_of_fractions_in_standard_errors() -> None:
    ours = torch.tensor([True] * 6 + [False] * 2)
    p, q = 8 / 12, 27 / 54
    error = math.sqrt(p * (1 - p) / 12 + q * (1 - q) / 54)
    assert fraction_distance(ours, 0.5, 50) == pytest.approx((p - q) / error)
    assert abs(fraction_distance(torch.ones(50, dtype=torch.bool), 1.0, 50)) < 1e-12


def test_no_cell_decides_alone() -> None:
    assert loss({"a": 3.0, "b": -4.0}) == pytest.approx(math.sqrt(12.5))
    assert loss({"a": 0.0, "b": -1000.0}) == pytest.approx(math.sqrt(50))


def test_the_study_starts_from_the_values_in_conf() -> None:
    values = present()
    assert set(values) == set(FREE)
    coding = compose_config("+experiment=food_attraction").coding
    assert coding is not None
    assert values["coding.range_gain"] == coding.range_gain


def test_every_published_cell_is_an_experiment_with_that_robot() -> None:
    published = yaml.safe_load(PUBLISHED.read_text())
    for kind in ("food", "correct", "contrast"):
        for experiment, robots in published[kind].items():
            config = compose_config(f"+experiment={experiment}")
            assert set(robots) <= set(config.experiment.robots)
            assert config.trials == published["trials"]
            if kind == "correct":
                assert config.experiment.correct


def test_contrast_of_the_two_container_touches() -> None:
    run = build(compose_config("+experiment=secondary_stimulus", "trials=2"))
    for kind, weights in (("food", (2.0, 2.0)), ("empty", (0.4, 0.6))):
        projection = run.network.projections[f"{kind}_container_touch_to_dopaminergic"]
        for trial, weight in enumerate(weights):
            mine = projection.trial == trial
            projection.weight[mine] = weight * 800 / int(mine.sum())
    assert contrast(run, 4.0).tolist() == [True, False]
    assert contrast(run, 1.0).tolist() == [True, True]


def test_neighbours_change_one_value_each() -> None:
    values = present()
    changes = neighbours(values)
    assert len(changes) == len(set(changes)) == 2 * 5 + 2 + 3
    assert all(value != values[name] for name, value in changes)


def test_a_bad_point_is_given_up_early(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, str]] = []

    def measured(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[tuple[str, float]]:
        number = seed - calibrate.FIRST_SEED
        for cell in ("a", "b", "c"):
            seen.append((number, cell))
            yield cell, 1.0 if number < 6 else 9.0

    monkeypatch.setattr(calibrate, "measured", measured)
    study = optuna.create_study()
    calibrate.search(study, 7, trials=5)
    assert [cell for number, cell in seen if number == 5] == ["a", "b", "c"]
    assert [cell for number, cell in seen if number == 6] == ["a"]
    assert study.trials[0].params == present()
    made = calibrate.record(study, optuna.create_study(), "a note")
    assert (len(made["history"]), made["given_up"], made["trials"]) == (6, 1, [5])
    assert study.best_trial.user_attrs["distances"] == {"a": 1.0, "b": 1.0, "c": 1.0}


def test_an_interrupted_search_continues(tmp_path: Path) -> None:
    def study() -> optuna.Study:
        storage = f"sqlite:///{tmp_path / 'search.db'}"
        return optuna.create_study(storage=storage, study_name="s", direction="maximize", load_if_exists=True)

    options = {"seconds": 3.5}
    search(study(), 2, 2, options)
    search(study(), 1, 2, options)
    found = study().trials
    assert [trial.number for trial in found] == [0, 1, 2]
    assert found[0].params == {"potentiation": 0.1, "depression": 0.15, "tau_plus": 20.0, "tau_minus": 110.0}
    assert all(trial.value == sum(trial.user_attrs["food"]) / 2 for trial in found)

"""The calibration's loss, in closed form, and that it cannot be had by a wide spread or few trials."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from snnrl.thesis.loss import (
    FARTHEST,
    Outcome,
    background_cells,
    food_cells,
    fraction_distance,
    loss,
    mean_distance,
    orbit_cells,
    run_cells,
    spread_distance,
    tail,
    time_distance,
)
from snnrl.thesis.published import published

BENCHMARK = ("secondary_behaviour", "benchmark")
STUCK = 200.0  # items of a robot that is trapped


def test_a_mean_is_measured_in_published_spreads() -> None:
    ours = np.array([10.0, 14.0, 12.0, 16.0])
    assert mean_distance(ours, {"mean": 11.0, "sd": 5.0}) == pytest.approx(2.0 / 5.0)
    assert mean_distance(np.repeat(ours, 100), {"mean": 11.0, "sd": 5.0}) == pytest.approx(2.0 / 5.0)
    assert mean_distance(3 * (ours - 13) + 13, {"mean": 11.0, "sd": 5.0}) == pytest.approx(2.0 / 5.0)
    assert mean_distance(ours, {"mean": 10.0}) == pytest.approx(3.0)  # in tenths of the mean
    assert mean_distance(np.array([]), {"mean": 10.0}) == FARTHEST


def test_a_spread_is_measured_by_its_ratio() -> None:
    ours = np.array([10.0, 14.0, 12.0, 16.0])  # variance 20 / 3
    assert spread_distance(ours, {"mean": 0.0, "sd": 5.0}) == pytest.approx(math.log(math.sqrt(20 / 3) / 5))
    doubled = spread_distance(2 * ours, {"sd": 5.0}) - spread_distance(ours, {"sd": 5.0})
    assert doubled == pytest.approx(math.log(2))
    assert spread_distance(np.full(3, 7.0), {"sd": 5.0}) == -FARTHEST


def test_a_fraction_is_measured_in_tenths_whatever_the_number_of_trials() -> None:
    for n in (1, 50):
        assert fraction_distance(np.repeat([True, True, True, False], n), 0.5) == pytest.approx(2.5)
    assert fraction_distance(np.array([True]), 1.0) == 0.0


def test_a_trial_is_trapped_without_food_in_its_last_300_s_or_30_percent() -> None:
    assert [tail(seconds) for seconds in (500.0, 1000.0, 2000.0)] == [150.0, 300.0, 300.0]
    ours = Outcome(np.full(8, 800.0), np.array([0, 1, 50, 0, 60, 70, 80, 90]), np.ones(8, bool))
    assert dict(run_cells(*BENCHMARK, ours, published()))["secondary_behaviour/benchmark/trapped"] == pytest.approx(2.5)


def test_orbit_and_background() -> None:
    found = dict(orbit_cells("learning", np.array([5.1, 6.12, np.nan, np.nan]), published()))
    assert found == {"orbit/learning/escaped": pytest.approx(-5.0), "orbit/learning/time": pytest.approx(1.0)}
    assert dict(orbit_cells("learning", np.full(3, np.nan), published()))["orbit/learning/time"] == FARTHEST
    assert dict(background_cells(np.array([0.4, 0.5]), published()))["background rate"] == pytest.approx(1.0)


def test_a_time_that_is_about_so_many_s_is_measured_by_its_ratio() -> None:
    assert time_distance(np.array([50.0, 150.0, np.nan]), 100.0) == 0.0
    assert time_distance(np.array([400.0]), 100.0) == pytest.approx(2.0)
    assert time_distance(np.array([25.0]), 100.0) == pytest.approx(-2.0)
    assert time_distance(np.full(2, np.nan), 100.0) == FARTHEST
    ours = Outcome(np.ones(2), np.ones(2), np.ones(2, bool), saturated=np.full(2, 50.0), settled=np.full(2, 800.0))
    found = dict(run_cells("food_attraction", "learning", ours, published()))
    assert found["food_attraction/learning/weights saturated"] == pytest.approx(-1.0)
    assert found["food_attraction/learning/attraction settled"] == pytest.approx(2.0)


def test_a_failure_is_weak_where_a_side_does_not_attract() -> None:
    """One of four; and each of them counts as much whether others fail or not."""
    learnt = np.array([True, False, False, False])
    attraction = np.array([[0.1, 3.0, 0.4, 0.6], [0.1, 0.6, 3.0, 0.51]])
    cell = "secondary_behaviour/fixed_container_dopamine/failed weakly"

    def of(learnt: np.ndarray) -> float:
        ours = Outcome(np.ones(4), np.ones(4), learnt, attraction=attraction)
        return dict(run_cells("secondary_behaviour", "fixed_container_dopamine", ours, published()))[cell]

    assert of(learnt) == pytest.approx(0.25 / 0.1)
    assert of(np.array([True, True, False, True])) == pytest.approx(0.25 / 0.1)
    assert of(np.ones(4, bool)) == 0.0


def test_dose_and_the_wait_for_food_are_measured_in_tenths() -> None:
    found = dict(food_cells(np.array([0.108]), np.array([0.7, 1.06]), published()))
    assert found == {"dose": pytest.approx(-1.0), "entering to food": pytest.approx(1.0)}
    assert dict(food_cells(np.zeros(0), np.zeros(0), published())) == {"dose": FARTHEST, "entering to food": FARTHEST}


def test_no_cell_decides_alone() -> None:
    assert loss({"a": 3.0, "b": -4.0}) == pytest.approx(math.sqrt(12.5))
    assert loss({"a": 0.0, "b": -1000.0}) == pytest.approx(math.sqrt(50))


def of(food: np.ndarray) -> Outcome:
    """Of benchmark robots, of which those with little food are trapped."""
    return Outcome(food, np.where(food > STUCK, 100, 0), np.ones(len(food), bool))


def of_benchmark(food: np.ndarray, theirs: dict[str, Any]) -> float:
    return loss(dict(run_cells(*BENCHMARK, of(food), theirs)))


@pytest.mark.parametrize("mean", [770.0, 785.0, 808.4])
@pytest.mark.parametrize("trapped", [1, 3, 8])
def test_trapped_robots_never_improve_the_loss(mean: float, trapped: int) -> None:
    """Sixteen robots around a mean, with the published spread, and the same with some of them trapped."""
    theirs = published()
    free = mean + 21.5 * np.tile([-1.0, 1.0], 8)
    caught = free.copy()
    caught[:trapped] = STUCK
    assert of_benchmark(caught, theirs) > of_benchmark(free, theirs) + 0.1

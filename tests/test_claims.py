"""The measures behind the explanations, on hand-made runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import compose_config

from snnrl.analysis import claims
from snnrl.analysis.compare import compare, contrast
from snnrl.analysis.fit import best_region, describe, grid_points, point_name, point_of
from snnrl.analysis.methods import coincidence, pair_eligibility, sensor_encoding
from snnrl.analysis.runs import Run
from snnrl.engines import make_engine


def hand_made(**parts: Any) -> Run:
    """A run whose parts are given instead of read from files."""
    run = Run(Path("nowhere"))
    run.__dict__.update(parts)
    return run


def orbiting(distance: list[list[float]], food: list[list[float]]) -> Run:
    shape = np.array(distance).T
    config = {"coding": {"slow": 25.0, "fast": 31.2, "tick": 70}, "world": {"axle": 1.0}}
    time = 0.07 * np.arange(1, len(shape) + 1)
    series = {"time": time, "nearest_item": shape, "collection_rate": np.array(food).T}
    return hand_made(config=config, series={**series, "trials": np.arange(shape.shape[1])})


def test_a_robot_has_escaped_when_it_is_two_radii_away_or_has_eaten() -> None:
    far = 2 * 4.568 + 0.01
    run = orbiting(
        [[4.6, 4.6, far, 3.0], [4.6, 4.6, 4.6, 9.0], [4.6, 4.6, 4.6, 4.6]], [[0, 0, 0, 14], [0] * 4, [0, 14, 0, 0]]
    )
    assert claims.escapes(run)[[0, 2]] == pytest.approx([0.21, 0.14])
    assert np.isnan(claims.escapes(run)[1])
    assert claims.first_food(run)[[0, 2]] == pytest.approx([0.28, 0.14])


def weights(left: np.ndarray, right: np.ndarray) -> dict[str, np.ndarray]:
    """From both sensors to both motors alike, [1, 3, n_post] each."""
    rows = {side: np.repeat(values[None, None], 3, 1) for side, values in (("left", left), ("right", right))}
    return {f"{side}_food_to_{motor}_motor": rows[side] for side in rows for motor in ("left", "right")}


def test_differentiation_is_one_for_exclusive_neurons_and_zero_for_impartial_ones() -> None:
    exclusive = weights(np.array([4.0, 0.0]), np.array([0.0, 4.0]))
    impartial = weights(np.array([2.0, 1.0]), np.array([2.0, 1.0]))
    between = weights(np.array([3.0, 0.05]), np.array([1.0, 0.05]))  # the second neuron has too little weight
    assert claims.differentiation(exclusive) == pytest.approx([1.0])
    assert claims.differentiation(impartial) == pytest.approx([0.0])
    assert claims.differentiation(between) == pytest.approx([0.5])


def test_shuffled_weights_are_the_same_weights_on_the_same_synapses() -> None:
    torch.manual_seed(0)
    values = torch.rand(3, 10, 8).numpy()
    values[torch.rand(3, 10, 8).numpy() < 0.2] = np.nan
    dealt = claims.shuffled({"a": values}, 0)["a"]
    assert (np.isnan(dealt) == np.isnan(values)).all()
    for trial in range(3):
        there = ~np.isnan(values[trial])
        assert sorted(dealt[trial][there]) == sorted(values[trial][there])
        assert (dealt[trial][there] != values[trial][there]).any()


def test_settling_time_and_smoothing() -> None:
    time = np.arange(1.0, 9.0)
    rise = np.array([0, 2, 4, 8, 9.5, 10, 10, 10.5])[:, None]  # mean of the last half: 10
    assert claims.settled(time, rise) == pytest.approx([5.0])
    assert claims.smooth(np.array([1.0, 3.0, 5.0, 7.0]), 2) == pytest.approx([1.0, 2.0, 4.0, 6.0])


def test_rate_of_a_span_counts_what_was_collected_in_it() -> None:
    run = hand_made(
        series={"time": np.array([10.0, 20.0, 30.0, 35.0]), "collection_rate": np.array([[1.0], [2.0], [3.0], [4.0]])}
    )
    assert run.rate(10, 30) == pytest.approx([2.5])
    assert run.rate(20, 35) == pytest.approx([(30 + 20) / 15])


def test_published_cells_are_compared_with_the_run_of_that_name() -> None:
    food = np.full(50, 269.0) + np.tile([-16.0, 16.0], 25)
    runs = {"food_attraction/random_walk": hand_made(trials={"food": food, "correct": np.zeros(50)})}
    cells = {cell.quantity: cell for cell in compare(runs)}
    assert set(cells) == {"food", "learnt"}
    assert cells["food"].verdict == cells["learnt"].verdict == "equivalent"
    assert cells["food"].difference.value == pytest.approx(0.0)
    shifted = {"food_attraction/random_walk": hand_made(trials={"food": food + 30, "correct": np.ones(50)})}
    assert [cell.verdict for cell in compare(shifted)] == ["differs", "differs"]


def test_contrast_is_a_ratio_by_trial() -> None:
    names = ("food_container_touch_to_dopaminergic", "empty_container_touch_to_dopaminergic")
    run = hand_made(trials=dict(zip(names, (np.array([0.4, 0.4, 0.0]), np.array([0.09, 0.11, 0.0])), strict=True)))
    assert contrast(run, 4.0).tolist() == [True, False, False]


def test_the_best_region_holds_what_the_best_cannot_be_told_from() -> None:
    noise = np.tile([-1.0, 1.0], 10)
    found = {"a": 100 + 10 * noise, "b": 97 + 10 * noise, "c": 60 + 10 * noise}
    assert best_region(found) == ("a", ["a", "b"])


def test_points_of_the_grid_are_found_by_name() -> None:
    centre = compose_config("+experiment=stdp_search").network.plasticity
    points = grid_points(centre)
    assert len(points) == 50
    assert {"potentiation": 0.1, "depression": 0.15} in points
    assert [point_of(point_name(point)) for point in points] == points
    assert describe(point_name(points[0])) == "potentiation=0.025, depression=0.0375"


def test_one_pair_leaves_the_eligibility_of_the_rule() -> None:
    trace = pair_eligibility(compose_config("+experiment=food_attraction", "trials=1", "dtype=float64"), end=100)
    assert not trace[:32].any()
    times = np.arange(32, 100)
    assert trace[32:] == pytest.approx(0.1 * np.exp(-2 / 20) * np.exp(-(times - 32) / 476))


def test_more_sensor_neurons_fire_the_larger_the_value() -> None:
    values, raster = sensor_encoding(compose_config("+experiment=food_attraction", "robot=random_walk", "trials=1"))
    assert raster.shape == (len(values), 20)
    assert not raster[values < 0.05].any()
    assert raster[values > 0.9].sum() > raster[(values > 0.45) & (values < 0.55)].sum() > 0


def test_a_coincidence_is_a_pair_of_spikes_of_joined_neurons() -> None:
    config = compose_config("+experiment=secondary_stimulus", "robot=no_burst_threshold", "trials=1", "seconds=300")
    found = coincidence(config, make_engine("fused", "cpu"), "empty_container", False, 140, 280)
    assert found is not None
    assert len(found.pre) == len(found.weight) == 420
    assert found.pre[found.at]
    later = np.flatnonzero(found.post[found.at + 1 : found.at + 21])
    assert len(later)
    after = found.at + 1 + later[0]
    assert found.eligibility[after] > found.eligibility[after - 1]

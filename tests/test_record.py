"""What a run keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import compose_config, make_world, place

from snnrl.recording.runs import Run
from snnrl.running.job import perform

EVERY = ("record.every=0.7", "record.tensorboard=false", "trials=2")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    perform(compose_config("+experiment=food_attraction", "seconds=14", *EVERY), folder)
    return Run(folder)


def test_sampling_begins_where_it_is_told(run: Run, tmp_path: Path) -> None:
    assert run.time == pytest.approx(0.7 * np.arange(1, 21))
    perform(compose_config("+experiment=food_attraction", "seconds=14", "record.start=10.5", *EVERY), tmp_path)
    late = Run(tmp_path)
    assert late.time == pytest.approx([10.5, 11.2, 11.9, 12.6, 13.3, 14.0])
    for key in ("weight", "eligibility", "position", "heading", "nearest_item"):
        np.testing.assert_array_equal(late.series[key], run.series[key][14:])
    assert late.series["collection_rate"][0] * 10.5 == pytest.approx(run.series["collection_rate"][:15].sum(0) * 0.7)


def test_final_weights_are_those_of_the_table(run: Run) -> None:
    assert set(run.weights) == set(run.series["projections"])
    for name, weights in run.weights.items():
        assert np.nansum(weights, (1, 2)) / weights[0].size == pytest.approx(run.trials[name], rel=1e-4, abs=1e-6)
    reward = run.weights["food_touch_to_dopaminergic"]
    assert np.nanmin(reward) == np.nanmax(reward) == 3.0
    assert np.isnan(reward).mean() == pytest.approx(0.9, abs=0.03)


def test_the_robot_moves_as_far_as_its_wheels_turn(run: Run) -> None:
    step = np.diff(run.series["position"], axis=0)
    step -= 100.0 * np.round(step / 100.0)
    assert np.linalg.norm(step, axis=2).max() <= 0.7 * 28.1 + 1e-3


def test_distance_to_the_nearest_item_is_over_the_edge_of_the_torus() -> None:
    world = make_world(free_items=2, side=100.0)
    place(world, (1.0, 50.0), items=((97.0, 53.0), (30.0, 50.0)))
    assert world.nearest_item().tolist() == pytest.approx([5.0])
    assert make_world().nearest_item().tolist() == [float("inf")]

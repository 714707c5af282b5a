"""What the builder makes of a description."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import compose_config

from snnrl.configuration.builder import build
from snnrl.running.job import perform
from snnrl.simulation import Simulation

TRIALS = 200


@pytest.fixture(scope="module")
def run() -> Simulation:
    return build(compose_config("+experiment=dual_learning", f"trials={TRIALS}"))


@pytest.mark.parametrize(
    ("name", "probability"),
    [("left_food_to_left_motor", 0.85), ("food_touch_to_dopaminergic", 0.1), ("inhibitory_to_left_food", 0.1)],
)
def test_pairs_are_joined_with_the_given_probability(run: Simulation, name: str, probability: float) -> None:
    projection = run.network.projections[name]
    pairs = projection.shape[0] * projection.shape[1] * projection.shape[2]
    error = (probability * (1 - probability) / pairs) ** 0.5
    assert abs(len(projection.weight) / pairs - probability) < 4 * error


def test_every_trial_has_its_own_graph_neurons_and_world(run: Simulation) -> None:
    joined = torch.zeros(TRIALS, 20, 20, dtype=torch.bool)
    projection = run.network.projections["left_food_to_left_motor"]
    joined[projection.trial, projection.pre_index, projection.post_index] = True
    for values in (
        joined.flatten(1).double(),
        run.network.groups["left_motor"].get_buffer("c"),
        run.situation.world.places.flatten(1),
    ):
        assert len(values.unique(dim=0)) == TRIALS


def test_weights_and_neurons_are_drawn_from_their_ranges(run: Simulation) -> None:
    inhibition = run.network.projections["inhibitory_to_left_motor"].weight
    assert -3.0 <= float(inhibition.min()) < -2.9
    assert -0.1 < float(inhibition.max()) <= 0.0
    assert float(inhibition.mean()) == pytest.approx(-1.5, abs=0.05)
    group = run.network.groups["dopaminergic"]
    squared = (group.get_buffer("c") + 65.0) / 15.0
    torch.testing.assert_close(group.get_buffer("d"), 8.0 - 6.0 * squared)
    assert float(squared.sqrt().mean()) == pytest.approx(0.5, abs=0.02)  # r is uniform in [0, 1)


def test_a_projection_is_offered_as_a_sparse_matrix(run: Simulation) -> None:
    projection = run.network.projections["inhibitory_to_left_food"]
    matrix = projection.matrix()
    assert matrix.is_sparse
    assert matrix.shape == (TRIALS, 20, 20)
    dense = matrix.to_dense()
    torch.testing.assert_close(dense[projection.trial, projection.pre_index, projection.post_index], projection.weight)
    assert int((dense != 0).sum()) == int((projection.weight != 0).sum())
    torch.testing.assert_close(dense.double().mean((1, 2)), projection.mean_weight())
    matrix.values().zero_()
    assert (projection.weight != 0).any()


def test_robots_differ_as_described() -> None:
    expected = {
        "no_container_dopamine": {"food_container_touch_to_dopaminergic": (0.0, False)},
        "container_dopamine_learning": {"food_container_touch_to_dopaminergic": (0.0, True)},
        "fixed_container_dopamine": {"food_container_touch_to_dopaminergic": (4.0, False)},
        "benchmark": {
            "left_container_to_right_motor": (4.0, False),
            "left_container_to_left_motor": (0.0, False),
            "food_touch_to_dopaminergic": (3.0, False),
        },
    }
    for robot, projections in expected.items():
        network = build(compose_config("+experiment=secondary_behaviour", f"robot={robot}", "trials=1")).network
        for name, (weight, plastic) in projections.items():
            assert network.projections[name].plastic is plastic
            assert network.projections[name].weight.unique().tolist() == [weight]
        assert network.projections["left_food_to_right_motor"].weight.unique().tolist() == [4.0]


@pytest.mark.parametrize("robot", ["container_dopamine_learning", "no_container_dopamine", "fixed_container_dopamine"])
def test_a_food_taxis_that_is_given_keeps_its_weights_and_the_rest_learns_alike(robot: str, tmp_path: Path) -> None:
    """The same synapses as where it learns; only which of them are plastic differs."""
    options = ("+experiment=secondary_behaviour", f"robot={robot}", "trials=2", "seconds=20")
    usual = build(compose_config(*options)).network
    config = compose_config(*options, "network=food_taxis_given")
    given = build(config).network
    for name, projection in usual.projections.items():
        other = given.projections[name]
        assert torch.equal(other.matrix().to_dense(), projection.matrix().to_dense())
        assert other.plastic is (projection.plastic and not projection.role.startswith(("food_attr", "food_avoid")))
    assert "food_taxis" not in given.homeostasis
    assert given.homeostasis["container_taxis"] == usual.homeostasis["container_taxis"]
    perform(config, tmp_path)
    with np.load(tmp_path / "series.npz") as series:
        names = list(series["projections"])
        fixed = series["weight"][..., names.index("left_food_to_right_motor")]
    assert (fixed == fixed[0]).all()

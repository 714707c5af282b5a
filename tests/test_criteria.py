"""When a trial counts as correct, on hand-made weights."""

from __future__ import annotations

import pytest
from helpers import compose_config

from snnrl.configuration.builder import build
from snnrl.model.network import Network
from snnrl.recording.criteria import correct, taxis_learnt

# mean weights of left to right, right to left (attraction), left to left, right to right (avoidance), mV
CASES = {
    "strong and clear": ((2.0, 2.0, 0.5, 0.5), True, True),
    "nothing learnt": ((0.0, 0.0, 0.0, 0.0), False, False),
    "clear but weak": ((0.49, 0.49, 0.1, 0.1), False, False),
    "strong but not ten per cent ahead": ((2.0, 2.0, 1.9, 1.9), False, False),
    "just ahead": ((2.0, 2.0, 1.8, 1.8), True, True),
    "on average, but one side is weak": ((2.0, 0.4, 0.1, 0.1), True, False),
    "on average, but one side avoids": ((3.0, 1.0, 0.5, 1.5), True, False),
    "avoidance": ((0.5, 0.5, 2.0, 2.0), False, False),
}
PROJECTIONS = ("left_{}_to_right", "right_{}_to_left", "left_{}_to_left", "right_{}_to_right")


@pytest.fixture(scope="module")
def network() -> Network:
    return build(compose_config("+experiment=dual_learning", "trials=2")).network


def set_means(network: Network, taxis: str, means: tuple[float, ...], trial: int) -> None:
    """Give the synapses of one trial the weights whose mean, absent ones counted as zeros, is `means`."""
    for name, mean in zip(PROJECTIONS, means, strict=True):
        projection = network.projections[f"{name.format(taxis)}_motor"]
        mine = projection.trial == trial
        projection.weight[mine] = mean * 400 / int(mine.sum())


@pytest.mark.parametrize("taxis", ["food", "container"])
@pytest.mark.parametrize(("means", "together", "each_side"), CASES.values(), ids=CASES)
def test_rules(network: Network, taxis: str, means: tuple[float, ...], together: bool, each_side: bool) -> None:
    set_means(network, taxis, means, 0)
    set_means(network, taxis, CASES["nothing learnt"][0], 1)
    assert taxis_learnt(network, taxis, "together").tolist() == [together, False]
    assert taxis_learnt(network, taxis, "each_side").tolist() == [each_side, False]


def test_all_taxes_that_are_asked_for_must_be_learnt(network: Network) -> None:
    for trial in (0, 1):
        set_means(network, "food", CASES["strong and clear"][0], trial)
    set_means(network, "container", CASES["strong and clear"][0], 0)
    set_means(network, "container", CASES["avoidance"][0], 1)
    assert correct(network, {"food": "together"}).tolist() == [True, True]
    assert correct(network, {"food": "together", "container": "each_side"}).tolist() == [True, False]

"""Dampening of sets whose mean weight is too high, in every engine."""

from __future__ import annotations

import math

import oracle
import pytest
import torch
from helpers import (
    ENGINES,
    SURE,
    ends_of,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    make_simulation,
    projections_of,
    run,
    run_each,
    silence,
    spikes_of,
)
from torch import Tensor

from snnrl.errors import ConfigError
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.network import Network

NONE = math.nan  # a pair that is not joined


def still_network(weights: dict[str, list[list[float]]], sets: dict[str, Homeostasis], trials: int = 1) -> Network:
    """Plastic projections of 2 x 2 pairs, named as the weights; nothing fires, so only dampening acts."""
    groups = [
        make_group("pre", 2, trials),
        make_group("post", 2, trials),
        make_group("dopaminergic", 1, trials),
    ]
    projections = [
        make_projection(name, "pre", "post", torch.tensor([rows] * trials, dtype=torch.float64))
        for name, rows in weights.items()
    ]
    return make_network(groups, projections, make_dopamine(trials), sets)


def weights_of(network: Network, name: str) -> list[float]:
    (weights,) = (p.weight.tolist() for p in projections_of(network) if p.name == name)
    return list(weights)


def one_set(*names: str, count_absent: bool = True, limit: float = 2.0, step: float = 0.1) -> Homeostasis:
    return Homeostasis(names, limit, step, count_absent)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("mean", "lowered"), [(1.9, 0.0), (2.0 - 1e-6, 0.0), (2.0, 0.0), (2.0 + 1e-6, 0.1), (2.05, 0.1)]
)
def test_only_a_mean_above_the_limit_is_lowered_by_exactly_the_step(mean: float, lowered: float, engine: str) -> None:
    spread = [0.5, -0.25, 1.0, -1.25]  # adds up to nothing, exactly
    rows = [[mean + spread[0], mean + spread[1]], [mean + spread[2], mean + spread[3]]]
    network = still_network({"p": rows}, {"s": one_set("p")})
    run(engine, network, silence(network, 1))
    expected = [mean + offset - lowered for offset in spread]
    assert weights_of(network, "p") == pytest.approx(expected, abs=1e-12)
    run(engine, network, silence(network, 205))
    assert weights_of(network, "p") == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("steps", [1, 2, 5, 9, 10, 11, 150])
def test_acts_once_a_ms_until_the_mean_is_low_enough(steps: int, engine: str) -> None:
    """From a mean of 2.95 with steps of 0.1 it takes ten."""
    network = still_network({"p": [[3.95, 2.95], [2.95, 1.95]]}, {"s": one_set("p")})
    run(engine, network, silence(network, steps))
    lowered = 0.1 * min(steps, 10)
    assert weights_of(network, "p") == pytest.approx([3.95 - lowered, 2.95 - lowered, 2.95 - lowered, 1.95 - lowered])


@pytest.mark.parametrize("engine", ENGINES)
def test_no_weight_falls_below_zero(engine: str) -> None:
    network = still_network({"p": [[4.0, 4.0], [0.05, 0.0]]}, {"s": one_set("p")})
    run(engine, network, silence(network, 1))
    assert weights_of(network, "p") == pytest.approx([3.9, 3.9, 0.0, 0.0], abs=1e-12)
    assert min(weights_of(network, "p")) == 0.0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("count_absent", "lowered"), [(True, 0.0), (False, 0.1)])
def test_absent_synapses_count_as_zeros_or_not_at_all(count_absent: bool, lowered: float, engine: str) -> None:
    """Three synapses of 2.05 mV in four pairs: a mean of 1.54 or of 2.05."""
    network = still_network({"p": [[2.05, NONE], [2.05, 2.05]]}, {"s": one_set("p", count_absent=count_absent)})
    run(engine, network, silence(network, 3))
    assert weights_of(network, "p") == pytest.approx([2.05 - lowered] * 3, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_mean_is_over_all_projections_of_the_set(engine: str) -> None:
    """3.9 and 0.05 average below 2, 3.9 and 0.15 above it."""
    for low, lowered in ((0.05, 0.0), (0.15, 0.1)):
        network = still_network({"p": [[3.9] * 2] * 2, "q": [[low] * 2] * 2}, {"s": one_set("p", "q")})
        run(engine, network, silence(network, 1))
        assert weights_of(network, "p") == pytest.approx([3.9 - lowered] * 4, abs=1e-12)
        assert weights_of(network, "q") == pytest.approx([low - lowered] * 4, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_sets_are_independent_and_the_rest_is_untouched(engine: str) -> None:
    weights = {
        "free": [[3.5] * 2] * 2,
        "high": [[3.0] * 2] * 2,
        "low": [[1.0] * 2] * 2,
        "over": [[2.5] * 2] * 2,
    }
    sets = {
        "first": one_set("low"),
        "second": one_set("high"),
        "third": one_set("over", limit=2.45, step=0.25),
    }
    network = still_network(weights, sets)
    run(engine, network, silence(network, 1))
    for name, expected in {"free": 3.5, "high": 2.9, "low": 1.0, "over": 2.25}.items():
        assert weights_of(network, name) == pytest.approx([expected] * 4, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_trials_are_independent(engine: str) -> None:
    network = still_network({"p": [[2.05] * 2] * 2}, {"s": one_set("p")}, trials=3)
    weight = network.synapses.weight
    weight[4:8] = 1.99
    run(engine, network, silence(network, 4))
    assert weight.tolist() == pytest.approx([1.95] * 4 + [1.99] * 4 + [1.95] * 4, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_each_set_has_its_own_mean_limit_and_step(engine: str) -> None:
    """Half of the pairs are joined, all weights are 3 mV: 1.5 mV over all pairs, 3 mV over existing synapses."""
    rows = [[3.0, NONE], [NONE, 3.0]]
    sets = {
        "pairs": one_set("p"),
        "synapses": one_set("q", count_absent=False),
        "own limit": one_set("r", limit=1.4, step=0.25),
    }
    network = still_network({"p": rows, "q": rows, "r": rows}, sets)
    run(engine, network, silence(network, 1))
    for name, expected in {"p": 3.0, "q": 2.9, "r": 2.75}.items():
        assert weights_of(network, name) == pytest.approx([expected] * 2, abs=1e-12)


def test_what_a_set_does_not_say_holds_for_all() -> None:
    own = (
        "+network.homeostasis.per_set.container_dopamine={count_absent: false, limit: 1.5}",
        "+network.homeostasis.per_set.container_taxis={step: 0.2}",
    )
    network = make_simulation("+experiment=dual_learning", "trials=1", "network.homeostasis.count_absent=true", *own)
    found = {name: (s.limit, s.step, s.count_absent) for name, s in network.network.homeostasis.items()}
    assert found == {
        "food_taxis": (2.0, 0.1, True),
        "container_taxis": (2.0, 0.2, True),
        "container_dopamine": (1.5, 0.1, False),
    }


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("nowhere={limit: 1}", r"per_set=nowhere: must be one of food_taxis"),
        ("food_taxis={limit: -1}", r"per_set\.food_taxis\.limit=-1.*: must be at least 0"),
        ("food_taxis={most: 1}", r"per_set\.food_taxis\.most=1: no such key"),
    ],
)
def test_a_set_that_is_not_there_or_makes_no_sense_is_refused(given: str, message: str) -> None:
    with pytest.raises(ConfigError, match=rf"network\.homeostasis\.{message}"):
        make_simulation("+experiment=food_attraction", "trials=1", f"+network.homeostasis.per_set.{given}")


def rising_network(count_absent: bool, baseline: float) -> Network:
    """Two trials whose weights rise all the time, so that both sets are dampened often."""
    generator = torch.Generator().manual_seed(1)

    def weight(*shape: int) -> Tensor:
        value = 2.0 * torch.rand(shape, generator=generator, dtype=torch.float64)
        value[torch.rand(shape, generator=generator) < 0.3] = torch.nan
        return value

    groups = [make_group("a", 5, 2), make_group("b", 3, 2), make_group("dopaminergic", 2, 2)]
    projections = [
        make_projection("a to b", "a", "b", weight(2, 5, 3)),
        make_projection("b to a", "b", "a", weight(2, 3, 5)),
        make_projection("a to a", "a", "a", weight(2, 5, 5)),
        make_projection("b to b", "b", "b", weight(2, 3, 3)),
    ]
    sets = {
        "across": one_set("a to b", "b to a", count_absent=count_absent),
        "within": one_set("a to a", count_absent=count_absent, limit=1.2, step=0.03),
    }
    return make_network(groups, projections, make_dopamine(2, baseline=baseline), sets, gain=0.0)


def random_spikes(network: Network, steps: int, together: bool) -> Tensor:
    """Injected current that makes neurons fire together (potentiation) or each on its own (depression)."""
    generator = torch.Generator().manual_seed(2)
    shape = (steps, 2, network.size)
    if together:
        moments = torch.rand(steps, 2, 1, generator=generator) < 0.03
        return SURE * (moments & (torch.rand(shape, generator=generator) < 0.8)).double()
    return SURE * (torch.rand(shape, generator=generator) < 0.02).double()


rising = pytest.mark.parametrize(("baseline", "together"), [(0.03, True), (-0.03, False)])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("count_absent", [True, False])
@rising
def test_a_long_run_of_frequent_dampening_follows_the_oracle(
    baseline: float, together: bool, count_absent: bool, engine: str
) -> None:
    network = rising_network(count_absent, baseline)
    steps = 1503
    start = network.synapses.weight.tolist()
    injected = random_spikes(network, steps, together)
    raster = run(engine, network, injected)
    fired = {(b, n): set(spikes_of(raster, n, b)) for b in range(2) for n in range(network.size)}
    starts = {"a": 0, "b": 5}
    synapses: dict[tuple[str, int], list[tuple[oracle.Synapse, set[int], set[int]]]] = {}
    at = 0
    for projection in projections_of(network):
        for b, i, j in ends_of(projection):
            pre, post = (starts[group] for group in (projection.pre, projection.post))
            member = (oracle.Synapse(start[at]), fired[b, pre + i], fired[b, post + j])
            synapses.setdefault((projection.name, b), []).append(member)
            at += 1
    acted = {"across": 0, "within": 0}
    for t in range(steps):
        for members in synapses.values():
            for one, pre_spikes, post_spikes in members:
                one.step(t, t in pre_spikes, t in post_spikes, baseline)
        for name, item in network.homeostasis.items():
            for b in range(2):
                joined = [one for p in item.projections for one, _, _ in synapses[p, b]]
                pairs = {"across": 30, "within": 25}[name] if count_absent else len(joined)
                acted[name] += oracle.dampen(joined, pairs, item.limit, item.step)
    assert min(acted.values()) > 20
    expected = [one.weight for members in synapses.values() for one, _, _ in members]
    assert network.synapses.weight.tolist() == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("count_absent", [True, False])
@rising
def test_engines_agree_ms_by_ms_while_dampening_is_frequent(
    baseline: float, together: bool, count_absent: bool
) -> None:
    seen = []
    for engine in ENGINES:
        network = rising_network(count_absent, baseline)
        injected = random_spikes(network, 700, together)
        _, (weight,) = run_each(engine, network, injected, network.synapses.weight)
        seen.append(weight)
    assert torch.allclose(seen[0], seen[1], rtol=0, atol=1e-9)
    assert int((seen[0].diff(dim=0) < -0.02).any(1).sum()) > 10

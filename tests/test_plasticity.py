"""Eligibility, weights and delays of hand-made spikes against closed forms and oracles, in every engine."""

from __future__ import annotations

import math
from dataclasses import replace

import oracle
import pytest
import torch
from helpers import (
    ENGINES,
    EXCITATORY,
    RULE,
    SURE,
    ends_of,
    forced,
    group_of,
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
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity

STEPS = 257  # more than two blocks of the fused engine, and not a multiple
PATTERNS: dict[str, tuple[list[int], list[int]]] = {
    "pre before post": ([20], [27]),
    "post before pre": ([27], [20]),
    "same millisecond": ([20], [20]),
    "post never fired": ([20, 60, 130], []),
    "pre never fired": ([], [20, 60, 130]),
    "neither fired": ([], []),
    "nearest pre only": ([20, 30, 38], [40]),
    "nearest post only": ([40], [20, 30, 38]),
    "one pre, several posts": ([20], [25, 45, 65]),
    "one post, several pres": ([25, 45, 65], [20]),
    "both ways": ([20, 60, 100, 140], [30, 50, 110, 139]),
    "same millisecond after both": ([20, 70], [40, 70]),
    "over the edge of a block": ([99, 200], [100, 199]),
    "in the first and the last ms": ([0, 256], [1, 255]),
}


def pair(baseline: float, weight: float = 2.0, delay: int = 1, gain: float = 1.0, rule: Plasticity = RULE) -> Network:
    """One plastic synapse, and a dopaminergic neuron that stays silent."""
    groups = [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)]
    weights = torch.full((1, 1, 1), weight, dtype=torch.float64)
    synapse = make_projection("plastic", "pre", "post", weights, delay=delay, rule=rule)
    return make_network(groups, [synapse], make_dopamine(baseline=baseline), gain=gain)


def follow(
    engine: str, network: Network, pre: list[int], post: list[int], steps: int = STEPS
) -> tuple[list[float], list[float]]:
    """Eligibility and weight after every ms; the neurons fire exactly when they are told to."""
    (synapse,) = projections_of(network)
    injected = forced(network, steps, {("pre", 0): pre, ("post", 0): post})
    raster, (eligibility, weight) = run_each(engine, network, injected, synapse.eligibility, synapse.weight)
    assert spikes_of(raster, 0) == sorted(pre)
    assert spikes_of(raster, 1) == sorted(post)
    return eligibility[:, 0].tolist(), weight[:, 0].tolist()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("baseline", [0.004, -0.004, 0.0])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_eligibility_and_weight_are_the_oracles_in_every_ms(pattern: str, baseline: float, engine: str) -> None:
    pre, post = PATTERNS[pattern]
    eligibility, weight = follow(engine, pair(baseline), pre, post)
    expected = oracle.synapse(pre, post, [baseline] * STEPS, 2.0)
    assert eligibility == pytest.approx(expected[0], abs=1e-9)
    assert weight == pytest.approx(expected[1], abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_one_call_gives_what_calls_of_one_ms_give(pattern: str, engine: str) -> None:
    pre, post = PATTERNS[pattern]
    eligibility, weight = follow(engine, pair(0.004), pre, post)
    whole = pair(0.004)
    run(engine, whole, forced(whole, STEPS, {("pre", 0): pre, ("post", 0): post}))
    assert float(whole.synapses.eligibility) == pytest.approx(eligibility[-1], abs=1e-9)
    assert float(whole.synapses.weight) == pytest.approx(weight[-1], abs=1e-9)


def from_arrival(delay: int) -> Plasticity:
    """As the builder makes it for a projection of that delay."""
    return replace(RULE, simultaneous="depresses", travel=delay)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("elapsed", [0, 1, 2, 3, 4, 25])
def test_closed_form_of_potentiation_from_the_arrival(elapsed: int, delay: int, engine: str) -> None:
    """e = 0.1 exp(-(elapsed - delay) / 20) where the spike has arrived; two of one ms depress by 0.15."""
    network = pair(0.0, delay=delay, gain=0.0, rule=from_arrival(delay))
    eligibility, _ = follow(engine, network, [40], [40 + elapsed], 80)
    expected = 0.1 * math.exp(-(elapsed - delay) / 20) if elapsed >= delay else -0.15 if elapsed == 0 else 0.0
    assert eligibility[40 + elapsed] == pytest.approx(expected, abs=1e-12)
    assert eligibility[-1] == pytest.approx(expected * math.exp(-(39 - elapsed) / 476), abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("delay", [1, 7])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_pairs_that_potentiate_from_the_arrival_follow_the_oracle(pattern: str, delay: int, engine: str) -> None:
    pre, post = PATTERNS[pattern]
    network = pair(0.004, delay=delay, gain=0.0, rule=from_arrival(delay))
    eligibility, weight = follow(engine, network, pre, post)
    expected = oracle.synapse(pre, post, [0.004] * STEPS, 2.0, depresses=True, travel=delay)
    assert eligibility == pytest.approx(expected[0], abs=1e-9)
    assert weight == pytest.approx(expected[1], abs=1e-9)


def test_a_projection_potentiates_from_its_own_arrival() -> None:
    rule = ("network.plasticity.simultaneous=depresses", "network.plasticity.potentiation_from=arrival")
    options = ("+experiment=dual_learning", "trials=1", "network.synapses.anticipation.delay=4")
    network = make_simulation(*options, *rule).network
    travels = {p.name: p.rule.travel for p in projections_of(network) if p.rule is not None}
    assert len(travels) == 10
    assert all(travel == (4 if name.endswith("dopaminergic") else 1) for name, travel in travels.items())
    network = make_simulation(*options, rule[0]).network
    assert {p.rule.travel for p in projections_of(network) if p.rule is not None} == {0}
    with pytest.raises(ConfigError, match=r"network\.plasticity\.simultaneous=potentiates: must be depresses with"):
        make_simulation(*options, rule[1], "network.plasticity.simultaneous=potentiates")
    with pytest.raises(ValueError, match="must be depresses"):
        replace(RULE, travel=1)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("elapsed", [0, 1, 19, 120])
def test_closed_form_of_potentiation(elapsed: int, engine: str) -> None:
    """e(t) = 0.1 exp(-elapsed / 20) exp(-(t - t_post) / 476); w(t) sums it times dopamine from t_post on."""
    last = 20 + elapsed
    eligibility, weight = follow(engine, pair(0.004), [20], [last])
    fading = math.exp(-1 / 476)
    for t in range(STEPS):
        jump = 0.1 * math.exp(-elapsed / 20) if t >= last else 0.0
        risen = 0.004 * jump * (1 - fading ** (t - last + 1)) / (1 - fading)
        assert eligibility[t] == pytest.approx(jump * fading ** (t - last), abs=1e-9)
        assert weight[t] == pytest.approx(2.0 + risen, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("elapsed", [1, 19, 120])
def test_closed_form_of_depression(elapsed: int, engine: str) -> None:
    """e(t) = -0.15 exp(-elapsed / 110) exp(-(t - t_pre) / 476)."""
    eligibility, _ = follow(engine, pair(0.004), [20 + elapsed], [20])
    for t in range(STEPS):
        jump = -0.15 * math.exp(-elapsed / 110) if t >= 20 + elapsed else 0.0
        assert eligibility[t] == pytest.approx(jump * math.exp(-(t - 20 - elapsed) / 476), abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("baseline", [0.4, -0.4])
def test_weight_is_clipped_in_every_ms_and_leaves_the_bound_when_driven_back(baseline: float, engine: str) -> None:
    """Potentiation drives the weight into one bound, depression at 150 ms brings it back at once."""
    pre, post = [20, 150], [21, 149]
    network, whole = pair(baseline, gain=0.0), pair(baseline, gain=0.0)
    eligibility, weight = follow(engine, network, pre, post)
    expected = oracle.synapse(pre, post, [baseline] * STEPS, 2.0)
    assert weight == pytest.approx(expected[1], abs=1e-9)
    bound, reached = (4.0, max(weight)) if baseline > 0 else (0.0, min(weight))
    assert reached == bound
    assert weight[140] == bound
    assert eligibility[148] > 0 > eligibility[150]
    assert abs(weight[150] - bound) == pytest.approx(abs(eligibility[150] * baseline), abs=1e-9)
    assert (weight[-1] < 3.0) if baseline > 0 else (weight[-1] > 1.0)
    run(engine, whole, forced(whole, STEPS, {("pre", 0): pre, ("post", 0): post}))
    assert float(whole.synapses.weight) == pytest.approx(weight[-1], abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("start", "clipped"), [(0.05, False), (2.0, True), (0.2, True)])
def test_weight_turns_back_when_dopamine_changes_its_sign(start: float, clipped: bool, engine: str) -> None:
    """The clip is that of every ms: nothing of the push against the bound is remembered."""
    each, whole = (pair(-0.02, weight=3.8, gain=0.0) for _ in range(2))
    for network in (each, whole):
        assert network.dopamine is not None
        network.dopamine.level.fill_(start)
    _, weight = follow(engine, each, [5], [6])
    levels = [-0.02 + (start + 0.02) * math.exp(-(t + 1) / 25) for t in range(STEPS)]
    expected = oracle.synapse([5], [6], levels, 3.8)[1]
    assert (max(weight) == 4.0) is clipped
    assert max(weight) > max(3.83, weight[-1] + 0.1)
    assert weight == pytest.approx(expected, abs=1e-9)
    run(engine, whole, forced(whole, STEPS, {("pre", 0): [5], ("post", 0): [6]}))
    assert float(whole.synapses.weight) == pytest.approx(expected[-1], abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_fixed_synapses_have_no_eligibility_and_keep_their_weight(engine: str) -> None:
    groups = [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)]
    weight = torch.full((1, 1, 1), 5.5, dtype=torch.float64)  # beyond what a plastic one could have
    fixed = make_projection("fixed", "pre", "post", weight, plastic=False)
    network = make_network(groups, [fixed], make_dopamine(baseline=1.0))
    run(engine, network, forced(network, 60, {("pre", 0): [20, 40], ("post", 0): [22, 38]}))
    assert fixed.weight.tolist() == [5.5]
    assert fixed.eligibility.tolist() == [0.0]


@pytest.mark.parametrize("engine", ENGINES)
def test_without_dopamine_nothing_is_learnt(engine: str) -> None:
    groups = [make_group("pre", 1), make_group("post", 1)]
    plastic = make_projection("plastic", "pre", "post", torch.full((1, 1, 1), 2.0, dtype=torch.float64))
    network = make_network(groups, [plastic])
    run(engine, network, forced(network, 60, {("pre", 0): [20], ("post", 0): [22]}))
    assert plastic.weight.tolist() == [2.0]


def sparse(generator: torch.Generator, *shape: int) -> Tensor:
    """Weights in [0, 4) with about a third of the pairs (and one whole row) not joined."""
    weight = 4.0 * torch.rand(shape, generator=generator, dtype=torch.float64)
    weight[torch.rand(shape, generator=generator) < 0.35] = torch.nan
    weight[0, 1] = torch.nan
    return weight


def busy_network(gain: float) -> Network:
    """Two trials of 3 + 5 + 9 neurons; plastic both ways, onto itself, and fixed ones between them."""
    generator = torch.Generator().manual_seed(5)
    groups = [make_group("a", 3, 2), make_group("dopaminergic", 9, 2), make_group("b", 5, 2)]
    projections = [
        make_projection("a to b", "a", "b", sparse(generator, 2, 3, 5), delay=2),
        make_projection("fixed", "b", "dopaminergic", sparse(generator, 2, 5, 9), plastic=False, delay=3),
        make_projection("b to a", "b", "a", sparse(generator, 2, 5, 3)),
        make_projection("b to b", "b", "b", sparse(generator, 2, 5, 5), delay=7),
    ]
    return make_network(groups, projections, make_dopamine(2), gain=gain)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_every_synapse_of_a_busy_network_follows_the_oracles(gain: float, engine: str) -> None:
    """Random spikes and dopamine bursts; spike times are read from the raster."""
    generator = torch.Generator().manual_seed(6)
    each, whole = busy_network(gain), busy_network(gain)
    steps = 350
    driven = torch.rand(steps, 2, each.size, generator=generator) < 0.03
    bursts = torch.rand(steps, 2, 1, generator=generator) < 0.05
    driven[:, :, 3:12] |= bursts & (torch.rand(steps, 2, 9, generator=generator) < 0.8)
    injected = SURE * driven.double()
    projections = projections_of(each)
    weights = [p.weight.tolist() for p in projections]
    watched = [p.weight for p in projections] + [p.eligibility for p in projections]
    raster, seen = run_each(engine, each, injected, *watched)
    levels = []
    for trial in range(2):
        counts = raster[:, trial, 3:12].sum(1).tolist()
        assert sum(count > 5 for count in counts) > 3
        levels.append(oracle.dopamine(counts))
    checked = 0
    for p, projection in enumerate(projections):
        if not projection.plastic:
            assert torch.equal(seen[p][-1], seen[p][0])
            continue
        pre, post = (group_of(each, name).start for name in (projection.pre, projection.post))
        for s, (trial, i, j) in enumerate(ends_of(projection)):
            eligibility, weight = oracle.synapse(
                spikes_of(raster, pre + i, trial),
                spikes_of(raster, post + j, trial),
                levels[trial],
                weights[p][s],
            )
            assert seen[p][:, s].tolist() == pytest.approx(weight, abs=1e-9)
            assert seen[p + 4][:, s].tolist() == pytest.approx(eligibility, abs=1e-9)
            checked += 1
    assert checked > 40
    if gain == 0.0:  # otherwise rounding, amplified by the spikes, would end in other spikes
        assert torch.equal(run(engine, whole, injected), raster)
        assert torch.allclose(whole.synapses.weight, each.synapses.weight, rtol=0, atol=1e-9)
        assert torch.allclose(whole.synapses.eligibility, each.synapses.eligibility, rtol=0, atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("delay", [1, 2, 7])
def test_a_spike_arrives_exactly_delay_ms_later(delay: int, engine: str) -> None:
    network = pair(0.0, weight=2.5, delay=delay, gain=SURE / 2.5)
    times = [0, 20, 41, 100, 199]
    raster = run(engine, network, forced(network, STEPS, {("pre", 0): times}))
    assert spikes_of(raster, 1) == [t + delay for t in times]


@pytest.mark.parametrize("engine", ENGINES)
def test_delays_of_several_projections_do_not_mix(engine: str) -> None:
    """One neuron reaches three others after 1, 2 and 7 ms, a fourth after 2 and after 7 ms."""
    names = {"one": 1, "two": 2, "seven": 7}
    groups = [make_group("pre", 2), *(make_group(name, 1) for name in names), make_group("both", 1)]
    strong = torch.tensor([[[SURE], [torch.nan]]], dtype=torch.float64)
    projections = [
        make_projection(f"to {name}", "pre", name, strong, plastic=False, delay=d) for name, d in names.items()
    ]
    projections += [make_projection(f"both {d}", "pre", "both", strong, plastic=False, delay=d) for d in (7, 2)]
    network = make_network(groups, projections)
    times = [3, 20, 48, 99, 150]
    raster = run(engine, network, forced(network, STEPS, {("pre", 0): times, ("pre", 1): [70]}))
    for neuron, delay in enumerate(names.values(), 2):
        assert spikes_of(raster, neuron) == [t + delay for t in times]
    assert spikes_of(raster, 5) == sorted([t + 2 for t in times] + [t + 7 for t in times])


@pytest.mark.parametrize("engine", ENGINES)
def test_inputs_of_one_ms_add_up_times_the_gain(engine: str) -> None:
    """Spikes of 1.5, -0.25 and 2 mV arrive together; the target is an oracle with their sum."""
    groups = [make_group("pre", 3), make_group("post", 1)]
    weight = torch.tensor([[[1.5], [-0.25], [2.0]]], dtype=torch.float64)
    network = make_network(groups, [make_projection("p", "pre", "post", weight, False, 4)], gain=2.5)
    injected = forced(network, 40, {("pre", i): [10] for i in range(3)})
    machine = run_each(engine, network, injected, network.neurons.v)
    _, trace = oracle.izhikevich([2.5 * 3.25 if t == 14 else 0.0 for t in range(40)], *EXCITATORY)
    assert machine[1][0][:, 0, 3].tolist() == pytest.approx(trace, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_spike_leaves_with_the_weight_of_its_own_ms(engine: str) -> None:
    """Step 7 comes after steps 3 to 6: the pair that a spike completes already counts for it."""
    network = pair(10.0, weight=0.0, gain=1.0)
    injected = forced(network, 30, {("pre", 0): [20], ("post", 0): [20]})
    _, (pending,) = run_each(engine, network, injected, network.pending)
    assert float(pending[20, 0, 0, 1]) == pytest.approx(10.0 * 0.1, abs=1e-9)
    assert pending[21:, 0, 0, 1].tolist() == [0.0] * 9


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("steps", [1, 99, 100, 101])
def test_time_goes_on_where_it_stopped(steps: int, engine: str) -> None:
    network = pair(0.0)
    run(engine, network, silence(network, steps))
    run(engine, network, silence(network, 3))
    assert int(network.time) == steps + 3

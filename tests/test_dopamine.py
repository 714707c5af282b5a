"""The level of dopamine: delay, burst threshold, sign and decay, in every engine."""

from __future__ import annotations

import math
from typing import Any

import oracle
import pytest
import torch
from helpers import ENGINES, SURE, forced, make_dopamine, make_group, make_network, run, run_each, silence

from snnrl.model.network import Network

BASELINE, RELEASE = -0.0004, 0.0035


def close(level: float) -> Any:
    return pytest.approx(level, rel=1e-12, abs=1e-15)


def make(trials: int = 1, delay: int = 5, threshold: int = 5, tau: float = 25.0) -> Network:
    groups = [make_group("others", 3, trials), make_group("dopaminergic", 9, trials)]
    dopamine = make_dopamine(trials, delay=delay, threshold=threshold, tau=tau)
    return make_network(groups, dopamine=dopamine)


def levels(engine: str, network: Network, injected: torch.Tensor) -> list[float]:
    assert network.dopamine is not None
    _, (level,) = run_each(engine, network, injected, network.dopamine.level)
    return level[:, 0].tolist()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("delay", [1, 2, 5, 13])
def test_release_comes_exactly_delay_ms_after_the_burst_and_decays(delay: int, engine: str) -> None:
    network = make(delay=delay)
    injected = forced(network, 40, {("dopaminergic", i): [10] for i in range(8)})
    found = levels(engine, network, injected)
    assert found[: 10 + delay] == [close(BASELINE)] * (10 + delay)
    for t in range(10 + delay, 40):
        released = 8 * RELEASE * math.exp(-(t - 10 - delay) / 25.0)
        assert found[t] == close(BASELINE + released)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("burst", "released"), [(1, 0.0), (5, 0.0), (6, 6 * RELEASE), (9, 9 * RELEASE)])
def test_only_more_than_five_spikes_of_one_ms_release(burst: int, released: float, engine: str) -> None:
    network = make()
    injected = forced(network, 16, {("dopaminergic", i): [10] for i in range(burst)})
    assert levels(engine, network, injected)[15] == close(BASELINE + released)


@pytest.mark.parametrize("engine", ENGINES)
def test_without_a_threshold_one_spike_releases(engine: str) -> None:
    network = make(threshold=0)
    injected = forced(network, 16, {("dopaminergic", 4): [10]})
    assert levels(engine, network, injected)[15] == close(BASELINE + RELEASE)


@pytest.mark.parametrize("engine", ENGINES)
def test_spikes_of_neighbouring_ms_are_not_one_burst(engine: str) -> None:
    network = make()
    injected = forced(network, 30, {("dopaminergic", i): [10 if i < 4 else 11] for i in range(8)})
    assert levels(engine, network, injected) == [close(BASELINE)] * 30


@pytest.mark.parametrize("engine", ENGINES)
def test_other_groups_release_nothing(engine: str) -> None:
    network = make(threshold=0)
    injected = forced(network, 30, {("others", i): [10] for i in range(3)})
    assert levels(engine, network, injected) == [close(BASELINE)] * 30


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("tau", [5.0, 25.0, 200.0])
def test_decays_to_the_baseline_from_either_side(tau: float, engine: str) -> None:
    network = make(trials=2, tau=tau)
    assert network.dopamine is not None
    network.dopamine.level.copy_(torch.tensor([0.05, -0.03], dtype=torch.float64))
    run(engine, network, silence(network, 137))
    for found, start in zip(network.dopamine.level.tolist(), (0.05, -0.03), strict=True):
        assert found == close(BASELINE + (start - BASELINE) * math.exp(-137 / tau))


@pytest.mark.parametrize("engine", ENGINES)
def test_sign_acts_on_the_release_of_its_trial_only(engine: str) -> None:
    network = make(trials=3)
    assert network.dopamine is not None
    injected = forced(network, 16, {("dopaminergic", i): [10] for i in range(7)}, trial=0)
    injected[:, 1] = injected[:, 0]
    run(engine, network, injected, torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    expected = [BASELINE + 7 * RELEASE, BASELINE - 7 * RELEASE, BASELINE]
    assert network.dopamine.level.tolist() == [close(level) for level in expected]


@pytest.mark.parametrize("engine", ENGINES)
def test_sign_is_that_of_the_release_not_of_the_burst(engine: str) -> None:
    network = make()
    assert network.dopamine is not None
    injected = forced(network, 16, {("dopaminergic", i): [10] for i in range(7)})
    plus, minus = torch.ones(1, dtype=torch.float64), -torch.ones(1, dtype=torch.float64)
    run(engine, network, injected[:13], plus)
    run(engine, network, injected[13:], minus)
    assert float(network.dopamine.level) == close(BASELINE - 7 * RELEASE)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("delay", "threshold"), [(1, 3), (5, 5), (7, 2)])
def test_many_bursts_follow_the_oracle(delay: int, threshold: int, engine: str) -> None:
    network, whole = (make(delay=delay, threshold=threshold) for _ in range(2))
    assert whole.dopamine is not None
    generator = torch.Generator().manual_seed(3)
    injected = silence(network, 333)
    chosen = torch.rand(333, 9, generator=generator) < 0.5 * torch.rand(333, 1, generator=generator)
    injected[:, 0, 3:] = SURE * chosen
    assert network.dopamine is not None
    raster, (level,) = run_each(engine, network, injected, network.dopamine.level)
    counts = raster[:, 0, 3:].sum(1).tolist()
    assert sum(count > threshold for count in counts) > 5
    assert sum(0 < count <= threshold for count in counts) > 5
    expected = oracle.dopamine(counts, delay=delay, threshold=threshold)
    assert level[:, 0].tolist() == [close(value) for value in expected]
    run(engine, whole, injected)
    assert float(whole.dopamine.level) == close(expected[-1])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_total_is_the_sum_of_every_ms_level_in_any_parts(engine: str, dtype: torch.dtype) -> None:
    network, whole = make(trials=2).to(dtype), make(trials=2).to(dtype)
    assert network.dopamine is not None
    assert whole.dopamine is not None
    injected = silence(network, 250)
    injected[30::60, 1] = SURE
    _, (level,) = run_each(engine, network, injected, network.dopamine.level)
    run(engine, whole, injected)
    assert level[:, 1].max() > RELEASE
    assert network.dopamine.total.dtype == torch.float64
    assert torch.equal(network.dopamine.total, whole.dopamine.total)
    assert network.dopamine.total.tolist() == pytest.approx(level.double().sum(0).tolist(), rel=1e-12)

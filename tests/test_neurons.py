"""Izhikevich neurons against the scalar oracle, in every engine."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import oracle
import pytest
import torch
from helpers import ENGINES, EXCITATORY, INHIBITORY, make_group, make_network, run, silence, spikes_of

from snnrl.model.draws import Draws, stream

STEPS = 700
CURRENTS: dict[str, Callable[[int], float]] = {
    "none": lambda t: 0.0,
    "below onset": lambda t: 3.7,
    "just above onset": lambda t: 3.85,
    "moderate": lambda t: 6.0,
    "strong": lambda t: 10.0,
    "very strong": lambda t: 20.0,
    "inhibiting": lambda t: -5.0,
    "ramp": lambda t: 0.02 * t,
    "wave": lambda t: 5.0 + 6.0 * math.sin(t / 17.0),
    "pulses": lambda t: 45.0 if t % 37 == 5 else 0.0,
    "switched": lambda t: 12.0 if t // 90 % 2 else -3.0,
}
NEURONS = {
    "excitatory": EXCITATORY,
    "excitatory bursting": (0.02, 0.2, -50.0, 2.0),  # r = 1
    "inhibitory": INHIBITORY,
    "inhibitory half": (0.1, 0.2, -61.25, 6.5),  # r = 1/2
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", NEURONS)
def test_spike_times_are_the_oracles(kind: str, engine: str) -> None:
    network = make_network([make_group("cells", len(CURRENTS), parameters=NEURONS[kind])])
    injected = silence(network, STEPS)
    for i, current in enumerate(CURRENTS.values()):
        injected[:, 0, i] = torch.tensor([current(t) for t in range(STEPS)])
    raster = run(engine, network, injected)
    fired = 0
    for i, name in enumerate(CURRENTS):
        spikes, trace = oracle.izhikevich(injected[:, 0, i].tolist(), *NEURONS[kind])
        assert spikes_of(raster, i) == spikes, name
        assert float(network.neurons.v[0, i]) == pytest.approx(trace[-1], abs=1e-6), name
        assert int(network.neurons.last_spike[0, i]) == (spikes[-1] if spikes else -(1 << 40)), name
        fired += len(spikes)
    assert fired > 100
    assert network.spike_count.tolist() == [[fired]]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("size", [1, 15, 16, 17, 33])
def test_any_number_of_neurons_and_trials(size: int, engine: str) -> None:
    """Sizes that fill no vector register, and trials that must not touch their neighbours."""
    network = make_network([make_group("a", size, 3), make_group("b", 2, 3, INHIBITORY)])
    injected = silence(network, 120)
    injected[:, 1, :size] = 9.0
    raster = run(engine, network, injected)
    spikes, _ = oracle.izhikevich([9.0] * 120, *EXCITATORY)
    assert all(spikes_of(raster, i, trial=1) == spikes for i in range(size))
    assert int(raster.sum()) == size * len(spikes)
    assert network.spike_count.tolist() == [[0, 0], [size * len(spikes), 0], [0, 0]]
    last = torch.full((3, size + 2), -(1 << 40))
    last[1, :size] = spikes[-1]
    assert torch.equal(network.neurons.last_spike, last)


@pytest.mark.parametrize("engine", ENGINES)
def test_onset_of_firing_lies_between_3_75_and_3_8(engine: str) -> None:
    """Model page, dopaminergic background; a first spike from the initial state does not count."""
    network = make_network([make_group("cells", 3)])
    injected = silence(network, 2000)
    injected[:, 0] = torch.tensor([3.65, 3.75, 3.8], dtype=torch.float64)
    raster = run(engine, network, injected)
    assert [bool(n) for n in raster[100:].any(0)[0]] == [False, False, True]


@pytest.mark.parametrize("engine", ENGINES)
def test_background_current_acts_like_an_injected_one(engine: str) -> None:
    """Groups on both sides get none of it."""
    groups = [make_group("before", 3), make_group("driven", 2, current=7.5), make_group("after", 4)]
    network = make_network(groups)
    raster = run(engine, network, silence(network, 300))
    spikes, _ = oracle.izhikevich([7.5] * 300, *EXCITATORY)
    assert spikes
    assert [spikes_of(raster, i) for i in range(9)] == [[]] * 3 + [spikes] * 2 + [[]] * 4


@pytest.mark.parametrize("engine", ENGINES)
def test_noise_is_uniform_round_the_background_and_new_every_ms(engine: str) -> None:
    network = make_network([make_group("quiet", 3), make_group("noisy", 5, 1, EXCITATORY, 5.0, 3.5)], seed=8)
    uniform = Draws(8, torch.arange(1)).uniform(stream("background", "noisy"), torch.arange(400), 5)[:, 0]
    raster = run(engine, network, silence(network, 400))
    for i in range(5):
        currents = [5.0 + 3.5 * (2.0 * x - 1.0) for x in uniform[:, i].tolist()]
        spikes, _ = oracle.izhikevich(currents, *EXCITATORY)
        assert len(spikes) > 3
        assert spikes_of(raster, 3 + i) == spikes
    assert not raster[:, 0, :3].any()


MIXTURES: dict[str, dict[str, Any]] = {  # of a background current of 5
    "gaussian": {"gaussian": 2.5},
    "kicks": {"kick": 30.0, "kick_rate": 25.0},
    "uniform and gaussian": {"noise": 2.0, "gaussian": 1.5},
    "all": {"noise": 2.0, "gaussian": 1.5, "kick": 20.0, "kick_rate": 15.0},
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mixture", MIXTURES)
def test_a_mixed_background_is_the_sum_of_its_parts(mixture: str, engine: str) -> None:
    given, steps, size = {"noise": 0.0, "gaussian": 0.0, "kick": 0.0, "kick_rate": 0.0, **MIXTURES[mixture]}, 400, 5
    groups = [make_group("quiet", 3), make_group("noisy", size, 1, EXCITATORY, 5.0, **given), make_group("other", 18)]
    network = make_network([*groups, make_group("late", 2, 1, EXCITATORY, 4.0, gaussian=2.0)], seed=8)
    draws, times = Draws(8, torch.arange(1)), torch.arange(steps)
    uniform = draws.uniform(stream("background", "noisy"), times, size)[:, 0]
    bits = draws.bits(stream("gaussian", "noisy"), times, 4 * size)[:, 0]
    total = torch.zeros(steps, size)
    for k in range(4):
        for shift in (0, 8, 16):
            total += (bits[:, k * size : (k + 1) * size] >> shift) % 256
    kicks = draws.bits(stream("kicks", "noisy"), times, size)[:, 0] < given["kick_rate"] / 1000 * 2**24
    raster = run(engine, network, silence(network, steps))
    for i in range(size):
        currents = [
            5.0
            + given["noise"] * (2.0 * x - 1.0)
            + given["gaussian"] * (z - 1530) / math.sqrt(65535)
            + k * given["kick"]
            for x, z, k in zip(uniform[:, i].tolist(), total[:, i].tolist(), kicks[:, i].tolist(), strict=True)
        ]
        spikes, _ = oracle.izhikevich(currents, *EXCITATORY)
        assert len(spikes) > 3
        assert spikes_of(raster, 3 + i) == spikes
    assert int(kicks.sum()) == pytest.approx(given["kick_rate"] / 1000 * steps * size, abs=25)
    assert not raster[:, 0, :3].any()
    assert not raster[:, 0, 8:26].any()
    assert raster[:, 0, 26:].any()


@pytest.mark.parametrize("engine", ENGINES)
def test_kicks_come_at_their_rate_and_fire_neurons_at_rest(engine: str) -> None:
    """0.4 Hz of single spikes; a constant current of 3.65 alone fires nobody."""
    groups = [make_group("kicked", 40, 8, current=3.65, kick=30.0, kick_rate=0.4), make_group("still", 3, 8)]
    network = make_network(groups, seed=2)
    run(engine, network, silence(network, 100))  # a first spike comes from the initial state
    before = int(network.spike_count[:, 0].sum())
    run(engine, network, silence(network, 10_000))
    expected = 0.4 * 10 * 40 * 8
    assert int(network.spike_count[:, 0].sum()) - before == pytest.approx(expected, abs=5 * math.sqrt(expected))
    assert int(network.spike_count[:, 1].sum()) == 0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("cut", [1, 3, 100, 150])
def test_noise_does_not_depend_on_how_a_run_is_cut(cut: int, engine: str) -> None:
    mixed = MIXTURES["all"]
    whole, parts = (make_network([make_group("noisy", 5, 2, EXCITATORY, 5.0, **mixed)]) for _ in range(2))
    injected = silence(whole, 307)
    raster = run(engine, whole, injected)
    pieces = torch.cat([run(engine, parts, piece) for piece in injected.split(cut)])
    assert torch.equal(pieces, raster)
    assert torch.equal(parts.neurons.v, whole.neurons.v)

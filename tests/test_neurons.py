"""Izhikevich neurons against the scalar oracle, in every engine."""

from __future__ import annotations

import math
from collections.abc import Callable

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


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("cut", [1, 3, 100, 150])
def test_noise_does_not_depend_on_how_a_run_is_cut(cut: int, engine: str) -> None:
    whole, parts = (make_network([make_group("noisy", 5, 2, EXCITATORY, 5.0, 3.5)]) for _ in range(2))
    injected = silence(whole, 307)
    raster = run(engine, whole, injected)
    pieces = torch.cat([run(engine, parts, piece) for piece in injected.split(cut)])
    assert torch.equal(pieces, raster)
    assert torch.equal(parts.neurons.v, whole.neurons.v)

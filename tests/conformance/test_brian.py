"""Both engines against Brian2: equal spikes; eligibility, dopamine and weights equal to 1e-9 over 10 s."""

from __future__ import annotations

import copy
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from helpers import ENGINES, forced, make_dopamine, make_group, make_network, make_projection
from torch import Tensor

from snnrl.configuration.builder import build_network
from snnrl.engines import make_engine
from snnrl.model.draws import Draws
from snnrl.model.network import Network
from snnrl.schema import (
    GroupConfig,
    HomeostasisConfig,
    ModulatorConfig,
    NetworkConfig,
    NeuronConfig,
    PlasticityConfig,
    ProjectionConfig,
    SynapseConfig,
)

if find_spec("brian2") is None:
    pytest.skip("Brian2 is not installed: pip install 'snnrl[peers]'", allow_module_level=True)
from brian_peer import Course, simulate
from recording import food_only

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
STEPS = 10_000


def ours(engine: str, network: Network, injected: Tensor, every: int) -> Course:
    """What `simulate` returns, from one of our engines and a copy of the network."""
    network, machine = copy.deepcopy(network), make_engine(engine, "cpu", 1)
    assert network.dopamine is not None
    raster = torch.zeros(injected.shape, dtype=torch.bool)
    table, samples = network.synapses, []
    for part in range(0, len(injected), every):
        span = slice(part, part + every)
        machine.run_network(network, injected[span], None, raster[span])
        values = table.eligibility[: table.plastic], table.weight[: table.plastic], network.dopamine.level
        samples.append([value.clone() for value in values])
    eligibility, weight, level = (torch.stack(values).numpy() for values in zip(*samples, strict=True))
    return Course(raster[:, 0].nonzero().numpy(), eligibility, weight, level)


def assert_same(actual: Course, expected: Course) -> None:
    np.testing.assert_array_equal(actual.spikes, expected.spikes)
    for key in ("eligibility", "weight", "level"):
        np.testing.assert_allclose(getattr(actual, key), getattr(expected, key), rtol=0, atol=1e-9)


def single_synapses() -> tuple[Network, Tensor]:
    """Ten pairs of neurons, one synapse each, driven to fire at random, some pairs often in the same ms."""
    pairs = 10
    random = np.random.default_rng(4)
    weight = torch.full((1, pairs, pairs), torch.nan, dtype=torch.float64)
    weight[0].fill_diagonal_(2.0)
    network = make_network(
        [make_group("pre", pairs), make_group("post", pairs), make_group("dopaminergic", 10)],
        [make_projection("plastic", "pre", "post", weight)],
        make_dopamine(tau=40.0, release=0.004, threshold=6),
        gain=0.1,
    )
    spikes: dict[tuple[str, int], list[int]] = {}
    for k in range(pairs):
        times = random.choice(STEPS, (2, 20 * (k + 1)), replace=False)
        times[1, : 2 * k] = times[0, : 2 * k]
        spikes |= {("pre", k): times[0].tolist(), ("post", k): times[1].tolist()}
    bursts = random.choice(STEPS, 30, replace=False)
    for k in range(10):  # of 3 to 10 spikes
        spikes["dopaminergic", k] = bursts[: 3 * (10 - k) + 3].tolist()
    return network, forced(network, STEPS, spikes)


def food_only_brain() -> tuple[Network, Tensor]:
    """A robot's brain whose homeostatic set is full at times."""
    options = ["+robot.weights.food_attraction=2", "+robot.weights.food_avoidance=2", "network.homeostasis.limit=1.6"]
    return food_only(1, STEPS, *options)


def random_network() -> tuple[Network, Tensor]:
    """Fixed and plastic synapses of all delays from 1 to 20 ms, loops, noise, two homeostatic sets."""
    delays = range(1, 21)
    kinds = {f"plastic{k}": SynapseConfig(0.3, weight=0.5, spread=1.5, plastic=True, delay=k) for k in delays}
    kinds |= {f"fixed{k}": SynapseConfig(0.2, weight=0.5, spread=1.0, delay=k) for k in delays}
    kinds["inhibition"] = SynapseConfig(0.3, weight=-2.0, spread=2.0, delay=2)
    names = [("first", "second"), ("second", "second"), ("second", "third"), ("third", "first")]
    config = NetworkConfig(
        neurons={
            "regular": NeuronConfig(a=0.02, b=0.2, c=-65.0, d=8.0, d_spread=-1.0, v=-65.0),
            "fast": NeuronConfig(a=0.1, b=0.2, c=-65.0, d=2.0, c_spread=5.0, v=-70.0),
        },
        synapses=kinds,
        groups={
            "first": GroupConfig(11, "regular", current=2.0, noise=5.0),
            "second": GroupConfig(13, "regular", noise=6.0),
            "third": GroupConfig(7, "fast", current=1.0, noise=3.0),
        },
        projections={
            **{
                f"{kind}{k}": ProjectionConfig(*names[k % len(names)], f"{kind}{k}", role=f"{kind}{k % 2}")
                for kind in ("plastic", "fixed")
                for k in delays
                if kind == "fixed" or names[k % len(names)][0] != "third"
            },
            "inhibition": ProjectionConfig("third", "second", "inhibition"),
        },
        synaptic_gain=1.3,
        plasticity=PlasticityConfig(0.1, 0.12, 15.0, 60.0, 300.0, 2.5),
        dopamine=ModulatorConfig("second", baseline=-0.002, tau=30.0, release=0.01, delay=4, threshold=1),
        homeostasis=HomeostasisConfig({"odd": ["plastic1"], "even": ["plastic0"]}, 0.6, 0.05, count_absent=False),
    )
    network = build_network(config, Draws(9, torch.arange(1)), torch.float64)
    generator = torch.Generator().manual_seed(2)
    return network, 4.0 * torch.rand(STEPS, 1, network.size, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize(("case", "every"), [(single_synapses, 1), (food_only_brain, 100), (random_network, 100)])
def test_engines_agree_with_brian2(case: Callable[[], tuple[Network, Tensor]], every: int) -> None:
    network, injected = case()
    expected = simulate(network, injected, every)
    weights = expected.weight
    assert len(expected.spikes) > 2000
    assert np.ptp(weights, axis=0).max() > 0.5
    assert (np.diff(expected.level[:, 0]) > 0).any()
    assert_peer_can_follow(network, expected.spikes)
    for engine in ENGINES:
        assert_same(ours(engine, network, injected, every), expected)


def assert_peer_can_follow(network: Network, spikes: np.ndarray) -> None:
    """No spike leaves a plastic synapse while another is still on its way there (docs/conformance.md)."""
    table = network.synapses
    for neuron in table.pre[: table.plastic].unique().tolist():
        longest = table.delay[: table.plastic][table.pre[: table.plastic] == neuron].max()
        assert np.diff(spikes[spikes[:, 1] == neuron, 0]).min(initial=STEPS) >= longest


def test_the_comparison_sees_one_ms_of_delay() -> None:
    network, injected = single_synapses()
    network.modulators["dopamine"] = make_dopamine(tau=40.0, release=0.004, threshold=6)
    expected = simulate(network, injected[:1000], 1)
    network.modulators["dopamine"] = make_dopamine(tau=40.0, release=0.004, threshold=6, delay=6)
    with pytest.raises(AssertionError):
        assert_same(ours("fused", network, injected[:1000], 1), expected)

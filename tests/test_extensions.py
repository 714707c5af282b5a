"""Mechanisms of a user's own, and several modulators, on both engines: the same spikes, and closed forms."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
import torch
from helpers import (
    ENGINES,
    EXCITATORY,
    RULE,
    forced,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    run,
    run_each,
    spikes_of,
)
from torch import Tensor

from snnrl.configuration.builder import build_network
from snnrl.engines import make_engine
from snnrl.model.draws import Draws
from snnrl.model.elementary import exp
from snnrl.model.modulators import Modulator
from snnrl.model.network import Network
from snnrl.model.neurons import NeuronModel
from snnrl.model.plasticity import Plasticity, additive
from snnrl.schema import (
    ConfigError,
    GroupConfig,
    HomeostasisConfig,
    ModulatorConfig,
    NetworkConfig,
    NeuronConfig,
    PlasticityConfig,
    ProjectionConfig,
    SynapseConfig,
)


def leaky(
    v: Tensor, held: Tensor, current: Tensor, tau: Tensor, rest: Tensor, threshold: Tensor, pause: Tensor
) -> tuple[Tensor, ...]:
    """Leaky integrate-and-fire that stays at rest for `pause` ms after a spike."""
    free = held <= 0.0
    v = torch.where(free, v + (rest - v + current) / tau, rest)
    fired = v >= threshold
    return torch.where(fired, rest, v), torch.where(fired, pause, held - 1.0), fired


def late(elapsed: Tensor, potentiation: float, delay: float) -> Tensor:
    """A window that begins some ms after the presynaptic spike."""
    return torch.where(elapsed >= delay, potentiation * exp((delay - elapsed) / 9.0), 0.0)


def soft(weight: Tensor, change: Tensor, weight_max: float) -> Tensor:
    return weight + change * torch.where(change > 0.0, weight_max - weight, weight) / weight_max


def multiplied(weight: Tensor, change: Tensor) -> Tensor:
    """In proportion to the weight."""
    return weight * (1.0 + torch.clamp(change, -0.5, 0.5))


@additive
def approaching(weight: Tensor, change: Tensor, weight_max: float) -> Tensor:
    """Towards a bound by an exponential, so that changes add up."""
    share = exp_small(-torch.abs(change) / weight_max)
    return torch.where(change > 0.0, weight_max - (weight_max - weight) * share, weight * share)


def exp_small(x: Tensor) -> Tensor:
    return torch.exp(x)


def scaled_by(weight: Tensor, change: Tensor, factor: float) -> Tensor:
    return weight + factor * change


def scaled(first: Tensor, scale: float) -> Tensor:
    return scale * first


def difference(first: Tensor, second: Tensor, scale: float) -> Tensor:
    return scale * (first - second)


RULES: dict[str, dict[str, Any]] = {
    "hard": {},
    "soft": {"weight_rule": soft},
    "multiplied": {"weight_rule": multiplied},
    "approaching": {"weight_rule": approaching},
    "late": {"at_post": late, "values": {"delay": 4.0}},
    "signed": {"weight_min": -1.0},
    "depresses": {"simultaneous": "depresses", "weight_rule": soft},
}


def network_of(rule: str, seed: int = 2, trials: int = 3, dtype: torch.dtype = torch.float64) -> Network:
    """Two neuron models, dense and sparse projections, two rules, and three modulators of every kind of source."""
    config = NetworkConfig(
        neurons={
            "regular": NeuronConfig(a=0.02, b=0.2, c=-65.0, d=8.0, c_spread=15.0, d_spread=-6.0, v=-65.0),
            "leaky": NeuronConfig(
                model=leaky,
                v=-65.0,
                parameters={"tau": 12.0, "rest": -65.0, "threshold": -50.0, "pause": 2.0},
                spreads={"tau": 9.0, "threshold": 3.0},
            ),
        },
        synapses={
            "dense": SynapseConfig(probability=0.6, weight=0.5, spread=1.5, plastic=True, delay=2),
            "sparse": SynapseConfig(
                probability=0.1,
                weight=0.5,
                spread=1.5,
                plastic=True,
                rule="other",
                listens={"pain": -0.7, "dopamine": 1.0},
            ),
            "mixed": SynapseConfig(probability=0.5, weight=0.4, plastic=True, listens={"surprise": 1.0}),
            "fixed": SynapseConfig(probability=0.4, weight=4.0, spread=2.0, delay=5),
        },
        groups={
            "in": GroupConfig(19, "regular", 3.0, 6.0),
            "middle": GroupConfig(23, "leaky", 14.0, 8.0),
            "out": GroupConfig(9, "regular", 2.0, 5.0),
        },
        projections={
            "a": ProjectionConfig("in", "middle", "dense", "forward"),
            "b": ProjectionConfig("middle", "out", "sparse", "forward"),
            "c": ProjectionConfig("middle", "in", "mixed", "back"),
            "d": ProjectionConfig("out", "in", "fixed"),
        },
        synaptic_gain=1.3,
        plasticity=PlasticityConfig(0.1, 0.12, 20.0, 30.0, 300.0, 2.5, **RULES[rule]),
        rules={"other": PlasticityConfig(0.05, 0.08, 11.0, 25.0, 90.0, 3.0)},
        dopamine=ModulatorConfig("in", baseline=-0.002, tau=40.0, release=0.004, delay=3, threshold=1),
        modulators={
            "pain": ModulatorConfig("out", 0.001, 15.0, -0.003, 4, 0, signed=False, reward=0.5),
            "surprise": ModulatorConfig(
                None, 0.0, 60.0, delay=2, released=difference, sources={"first": "middle", "second": "in"},
                values={"scale": 0.01}, smoothing=25.0, reward=0.0,
            ),
        },
        homeostasis=HomeostasisConfig({"forward": ["forward"], "back": ["back"]}, 0.9, 0.05, True),
    )  # fmt: skip
    return build_network(config, Draws(seed, torch.arange(4, 4 + trials)), dtype)


def state_of(network: Network) -> dict[str, Tensor]:
    return {key: value.double() for key, value in network.state_dict().items()}


@pytest.mark.filterwarnings("ignore:engine=fused")
@pytest.mark.parametrize("rule", RULES)
def test_engines_agree_on_every_spike(rule: str) -> None:
    first = network_of(rule)
    second = copy.deepcopy(first)
    steps = 700
    reward = torch.zeros(steps, 3, dtype=torch.float64)
    reward[100::70, 1] = 0.02
    sign = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    rasters = []
    for engine, network in zip(ENGINES, (first, second), strict=True):
        raster = torch.zeros(steps, 3, network.size, dtype=torch.bool)
        injected = torch.zeros(steps, 3, network.size, dtype=torch.float64)
        make_engine(engine, "cpu", 2).run_network(network, injected, sign, raster, reward)
        rasters.append(raster)
    assert all(rasters[0][:, :, group.span].sum() > 50 for group in first.groups.values())
    assert torch.equal(*rasters)
    expected = state_of(first)
    for key, value in state_of(second).items():
        within = 1e-6 if key.endswith((".v", ".u", ".held")) else 1e-9  # each spike multiplies rounding by about ten
        assert torch.allclose(value, expected[key], rtol=1e-8, atol=within), key
    before = state_of(network_of(rule))
    for name in ("a", "b", "c"):
        key = f"projections.{name}.weight"
        assert (expected[key] - before[key]).abs().mean() > 1e-3, name


@pytest.mark.filterwarnings("ignore:engine=fused")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rule", ["soft", "approaching"])
def test_a_trial_is_the_same_in_any_company(rule: str, engine: str) -> None:
    whole, alone = network_of(rule, trials=3), network_of(rule, trials=1)
    raster, own = (run(engine, n, torch.zeros(300, n.trials, n.size, dtype=torch.float64)) for n in (whole, alone))
    assert torch.equal(raster[:, :1], own)
    for name, projection in alone.projections.items():
        count = len(projection.weight)
        assert torch.equal(whole.projections[name].weight[:count], projection.weight)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_leaky_neuron_pauses_as_told(engine: str) -> None:
    """v - rest = 20 (1 - (1 - 1/10)^n) reaches 15 in the 14th ms, then three ms at rest."""
    config = NetworkConfig(
        neurons={
            "leaky": NeuronConfig(
                model=leaky, v=-65.0, parameters={"tau": 10.0, "rest": -65.0, "threshold": -50.0, "pause": 3.0}
            )
        },
        groups={"one": GroupConfig(1, "leaky")},
        synaptic_gain=1.0,
        plasticity=PlasticityConfig(0.1, 0.15, 20.0, 110.0, 476.0, 4.0),
    )
    network = build_network(config, Draws(0, torch.arange(1)), torch.float64)
    raster = run(engine, network, torch.full((200, 1, 1), 20.0, dtype=torch.float64))
    assert spikes_of(raster, 0)[:4] == [13, 30, 47, 64]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_synapse_follows_the_sum_of_what_it_listens_to(engine: str) -> None:
    """Two constant levels, 0.5 and 0.2, with factors 1 and -2: together 0.1."""
    groups = [make_group("pre", 1), make_group("post", 1)]
    synapse = make_projection("plastic", "pre", "post", torch.full((1, 1, 1), 2.0, dtype=torch.float64))
    synapse.listens = {"one": 1.0, "two": -2.0}
    modulators = [
        Modulator(name, {}, 1, level, 50.0, 1, {"release": 0.0, "threshold": 0.0}, torch.float64, "cpu")
        for name, level in (("one", 0.5), ("two", 0.2))
    ]
    network = Network(groups, [synapse], Draws(0, torch.arange(1)), 0.0, modulators)
    injected = forced(network, 60, {("pre", 0): [10], ("post", 0): [15]})
    _, (weight,) = run_each(engine, network, injected, synapse.weight)
    fading, jump = math.exp(-1 / 476), 0.1 * math.exp(-5 / 20)
    for t in range(60):
        risen = 0.1 * jump * (1 - fading ** (t - 14)) / (1 - fading) if t >= 15 else 0.0
        assert float(weight[t]) == pytest.approx(2.0 + risen, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_without_a_modulator_that_it_listens_to_a_synapse_does_not_learn(engine: str) -> None:
    groups = [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)]
    synapse = make_projection("plastic", "pre", "post", torch.full((1, 1, 1), 2.0, dtype=torch.float64))
    synapse.listens = {"another": 1.0}
    network = make_network(groups, [synapse], make_dopamine(baseline=0.5))
    run(engine, network, forced(network, 60, {("pre", 0): [10], ("post", 0): [15]}))
    assert synapse.weight.tolist() == [2.0]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_smoothed_source_is_its_running_mean(engine: str) -> None:
    groups = [make_group("source", 4)]
    modulator = Modulator(
        "m", {"first": "source"}, 1, 0.0, 30.0, 2, {"scale": 0.5}, torch.float64, "cpu", released=scaled, smoothing=10.0
    )
    network = Network(groups, [], Draws(0, torch.arange(1)), 1.0, [modulator])
    injected = forced(network, 80, {("source", i): [5, 6 + i] for i in range(3)})
    raster, (level,) = run_each(engine, network, injected, modulator.level)
    counts = raster[:, 0].sum(1).tolist()
    rate, expected = 0.0, 0.0
    for t in range(80):
        rate = math.exp(-1 / 10) * rate + (1 - math.exp(-1 / 10)) * (counts[t - 2] if t >= 2 else 0)
        expected = expected * math.exp(-1 / 30) + 0.5 * rate
        assert float(level[t]) == pytest.approx(expected, rel=1e-9, abs=1e-15)
    assert expected > 0


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_exchanged_between_two_runs_counts(engine: str) -> None:
    """Rules, modulators, sets, gains and background may be others after a run, on an engine that has run it before."""
    machine = make_engine(engine, "cpu", 1)

    def fresh() -> Network:
        groups = [make_group("pre", 2, current=3.0), make_group("post", 2), make_group("dopaminergic", 1)]
        weight = torch.full((1, 2, 2), 1.9, dtype=torch.float64)
        return make_network(groups, [make_projection("p", "pre", "post", weight)], make_dopamine(baseline=0.01))

    changes = {
        "rule": lambda n: setattr(n.projections["p"], "rule", Plasticity(0.3, 0.1, 20.0, 110.0, 476.0, 4.0)),
        "baseline": lambda n: setattr(n.modulators["dopamine"], "baseline", -0.02),
        "tau": lambda n: setattr(n.modulators["dopamine"], "tau", 3.0),
        "gain": lambda n: setattr(n, "synaptic_gain", 5.0),
        "current": lambda n: setattr(n.groups["pre"], "current", 9.0),
        "listens": lambda n: setattr(n.projections["p"], "listens", {"dopamine": -1.0}),
    }
    for name, change in changes.items():
        network = fresh()
        injected = forced(network, 120, {("pre", i): [10, 50, 90 + i] for i in range(2)} | {("post", 0): [14, 57]})
        machine.run_network(network, injected)
        other = fresh()
        other.load_state_dict(network.state_dict())
        network.modulators["dopamine"].level.fill_(0.02)
        other.modulators["dopamine"].level.fill_(0.02)
        change(network)
        change(other)
        unchanged = copy.deepcopy(network)
        machine.run_network(network, injected)
        make_engine(engine, "cpu", 1).run_network(other, injected)
        assert torch.equal(network.synapses.weight, other.synapses.weight), name
        assert torch.equal(network.neurons.v, other.neurons.v), name
        same = fresh()
        same.load_state_dict(unchanged.state_dict())
        machine.run_network(same, injected)
        differs = not torch.equal(same.synapses.weight, network.synapses.weight)
        assert differs or not torch.equal(same.neurons.v, network.neurons.v), name


def test_a_rule_that_does_not_add_up_is_said_once_to_cost(recwarn: pytest.WarningsRecorder) -> None:
    def costly(weight: Tensor, change: Tensor) -> Tensor:
        return weight + change

    rule = Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, weight_rule=costly)
    for _ in range(2):
        groups = [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)]
        weight = torch.full((1, 1, 1), 2.0, dtype=torch.float64)
        network = make_network(groups, [make_projection("p", "pre", "post", weight, rule=rule)], make_dopamine())
        run("fused", network, torch.zeros(3, 1, 3, dtype=torch.float64))
    lines = [str(warning.message) for warning in recwarn if "costly" in str(warning.message)]
    assert len(lines) == 1
    assert "updated in every ms" in lines[0]


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"neurons": {"x": NeuronConfig(0.02, 0.2, -65.0, v=-65.0)}}, r"network\.neurons\.x\.d=None: must be given"),
        (
            {"neurons": {"x": NeuronConfig(model=leaky, v=-65.0, parameters={"tau": 1.0})}},
            r"network\.neurons\.x\.parameters\.rest=None: must be given",
        ),
        (
            {"neurons": {"x": NeuronConfig(model="nothing.py:f", v=0.0)}},
            r"x\.model=nothing\.py:f: .* cannot be imported",
        ),
        ({"neurons": {"x": NeuronConfig(model="math:nothing", v=0.0)}}, r"x\.model=math:nothing: math has no function"),
        (
            {"neurons": {"x": NeuronConfig(model="nothing", v=0.0)}},
            r"x\.model=nothing: must be one of izhikevich, time_cell, or FILE",
        ),
        ({"rule": {"weight_rule": scaled_by}}, r"network\.plasticity=\.\.\.: scaled_by: no value is called factor"),
        ({"rule": {"at_pre": "steep"}}, r"network\.plasticity\.at_pre=steep: must be one of depress, or FILE"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(part: dict[str, Any], message: str) -> None:
    neurons = part.get("neurons", {"x": NeuronConfig(*EXCITATORY, v=-65.0)})
    config = NetworkConfig(
        neurons=neurons,
        synapses={"s": SynapseConfig(probability=1.0, plastic=True)},
        groups={"g": GroupConfig(1, "x")},
        projections={"p": ProjectionConfig("g", "g", "s")},
        synaptic_gain=1.0,
        plasticity=PlasticityConfig(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, **part.get("rule", {})),
    )
    with pytest.raises(ConfigError, match=message):
        build_network(config, Draws(0, torch.arange(1)))


def test_models_and_windows_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"must be NAME\(v, \.\.\., current, \.\.\.\)"):
        NeuronModel(lambda u, current: (u, u > 0))
    with pytest.raises(ValueError, match="no value is called delay"):
        Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, at_post=late)
    with pytest.raises(ValueError, match="does not fade"):
        Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, at_post=lambda elapsed: elapsed * 0.0 + 1.0)
    with pytest.raises(ValueError, match="not finite"):
        Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, at_post=lambda elapsed: 1.0 / elapsed)
    assert RULE.adds_up

"""From descriptions to state: a `NetworkConfig` to a `Network`, a `Config` to a `Simulation`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from snnrl.body.coding import Coding
from snnrl.body.robot import Robot
from snnrl.body.world import World
from snnrl.configuration import footprint, parts
from snnrl.configuration.checks import UNTAUGHT, check, check_network, torch_device
from snnrl.configuration.functions import function
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws, stream
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.modulators import Modulator, burst, deviation
from snnrl.model.network import Network
from snnrl.model.neurons import NeuronGroup
from snnrl.model.plasticity import Plasticity, depress, hard_bounds, potentiate, potentiate_later
from snnrl.model.synapses import Projection
from snnrl.schema import (
    CodingConfig,
    Config,
    GroupConfig,
    HomeostasisConfig,
    ModulatorConfig,
    NetworkConfig,
    NeuronConfig,
    PlasticityConfig,
    ProjectionConfig,
    RobotConfig,
    StimuliConfig,
    SynapseConfig,
    TaskConfig,
    WorldConfig,
    check_bounds,
)
from snnrl.simulation import Simulation
from snnrl.tasks.coincidences import Coincidence
from snnrl.tasks.rewards import Reward
from snnrl.tasks.stimuli import Stimuli
from snnrl.tasks.task import Task

DTYPES = {"float32": torch.float32, "float64": torch.float64}


def build(config: Config) -> Simulation[Any]:
    """The whole closed loop of a robot, or of a task.

    Raises:
        ConfigError: names the first value that is out of bounds or contradicts another.
    """
    check(config)
    footprint.check(footprint.of_run(config))
    draws = _draws(config)
    network = build_network(config.network, draws, DTYPES[config.dtype], config.robot)
    if config.task is not None:
        return Simulation(network, _task(config.task, network))
    coding, world = config.body()
    return Simulation(network, Robot(build_coding(coding, network), build_world(world, coding, draws)))


def _draws(config: Config) -> Draws:
    first = config.trial_start
    return Draws(config.seed, torch.arange(first, first + config.trials, device=torch_device(config.device)))


def build_network(
    config: NetworkConfig,
    draws: Draws,
    dtype: torch.dtype = torch.float32,
    robot: RobotConfig = UNTAUGHT,
    kind: type[Network] = Network,
) -> Network:
    """A network (of that kind) for the trials of `draws`, each with its own graph and neuron parameters.

    Raises:
        ConfigError: names the first value that is out of bounds or contradicts another.
    """
    check_bounds(config, "network.")
    check_network(config, robot)
    footprint.check(footprint.of_network(config, len(draws.trials)))
    groups = [_group(name, group, config.neurons[group.neuron], draws, dtype) for name, group in config.groups.items()]
    rules = {name: _plasticity(parts.rule_key(name), rule) for name, rule in parts.rules(config).items()}
    projections = [
        _projection(name, projection, config, robot, draws, dtype, rules)
        for name, projection in config.projections.items()
    ]
    return kind(
        groups,
        projections,
        draws,
        config.synaptic_gain,
        [_modulator(name, modulator, draws, dtype) for name, modulator in parts.modulators(config).items()],
        {} if config.homeostasis is None else _homeostasis(config.homeostasis, projections),
    )


def _plasticity(key: str, config: PlasticityConfig) -> Plasticity:
    functions = {
        name: function(f"{key}.{name}", getattr(config, name), {own.__name__: own for own in owns})
        for name, owns in (
            ("at_post", (potentiate, potentiate_later)),
            ("at_pre", (depress,)),
            ("weight_rule", (hard_bounds,)),
        )
    }
    given = {name: value for name, value in vars(config).items() if name != "potentiation_from"}
    try:
        return Plasticity(**{**given, "values": dict(config.values), **functions})
    except ValueError as error:
        raise ConfigError(key, "...", str(error)) from error


def _modulator(name: str, config: ModulatorConfig, draws: Draws, dtype: torch.dtype) -> Modulator:
    key = parts.modulator_key(name)
    released = function(f"{key}.released", config.released, {"burst": burst, "deviation": deviation})
    sources = {"count": config.source} if config.source is not None else dict(config.sources)
    values = {"release": config.release, "threshold": float(config.threshold), **config.values}
    try:
        return Modulator(
            name,
            sources,
            len(draws.trials),
            config.baseline,
            config.tau,
            config.delay,
            values,
            dtype,
            draws.trials.device,
            released,
            config.smoothing,
            config.signed,
            config.reward,
        )
    except ValueError as error:
        raise ConfigError(f"{key}.values", "...", str(error)) from error


def _homeostasis(config: HomeostasisConfig, projections: list[Projection]) -> dict[str, Homeostasis]:
    """The sets that have plastic projections in them."""
    members = {
        name: tuple(p.name for p in projections if p.plastic and p.role in roles) for name, roles in config.sets.items()
    }
    return {
        name: Homeostasis(names, **vars(parts.homeostatic_set(config, name)))
        for name, names in members.items()
        if names
    }


def _group(name: str, config: GroupConfig, neuron: NeuronConfig, draws: Draws, dtype: torch.dtype) -> NeuronGroup:
    squared = draws.at_start(stream("neurons", name), config.size) ** 2
    parameters = {
        key: (value + spread * squared).to(dtype) for key, (value, spread) in parts.neuron_parameters(neuron).items()
    }
    model = parts.neuron_model(f"network.neurons.{config.neuron}", neuron)
    background = config.current, config.noise, config.gaussian, config.kick, config.kick_rate
    return NeuronGroup(name, model, parameters, neuron.v, *background)


def _projection(
    name: str,
    config: ProjectionConfig,
    network: NetworkConfig,
    robot: RobotConfig,
    draws: Draws,
    dtype: torch.dtype,
    rules: Mapping[str, Plasticity],
) -> Projection:
    kind: SynapseConfig = network.synapses[config.synapse]
    shape = (len(draws.trials), network.groups[config.pre].size, network.groups[config.post].size)
    pairs = shape[1] * shape[2]
    drawn = draws.at_start(stream("connections", name), pairs).view(shape)
    if kind.fan_out is not None:
        connected = _smallest(drawn, kind.fan_out)
    else:
        assert kind.probability is not None
        connected = drawn < kind.probability
    rule = rules[kind.rule]
    if parts.rules(network)[kind.rule].potentiation_from == "arrival":
        rule = replace(rule, travel=kind.delay)
    weight = kind.weight + kind.spread * draws.at_start(stream("weights", name), pairs)
    if config.role in robot.weights:
        weight = torch.full_like(weight, robot.weights[config.role])
    return Projection(
        name,
        config.pre,
        config.post,
        connected,
        weight.view(shape).to(dtype),
        rule if kind.plastic and robot.learning and config.role not in robot.fixed else None,
        kind.delay,
        config.role,
        dict(kind.listens) or None,
    )


def _smallest(drawn: Tensor, count: int) -> Tensor:
    """Which values are among the `count` smallest of their row (the last dimension), bool of the same shape."""
    chosen = torch.zeros_like(drawn, dtype=torch.bool)
    return chosen.scatter_(-1, drawn.argsort(dim=-1, stable=True)[..., :count], True)


def _task(config: TaskConfig, network: Network) -> Task:
    coincidence, reward = config.coincidence, config.reward
    return Task(
        config.tick,
        Reward(reward.amount, reward.shortest, reward.longest, config.tick, network.draws.trials),
        None if config.stimuli is None else _stimuli(config.stimuli, network),
        None
        if coincidence is None
        else Coincidence(network, coincidence.projection, coincidence.window, coincidence.weight),
    )


def _stimuli(config: StimuliConfig, network: Network) -> Stimuli:
    spans = [network.groups[name].span for name in config.groups]
    neurons = torch.cat([torch.arange(span.start, span.stop, device=network.device) for span in spans])
    drawn = network.draws.at_start(stream("stimulated"), config.count * len(neurons))
    order = drawn.view(network.trials, config.count, len(neurons)).argsort(dim=-1, stable=True)
    return Stimuli(
        neurons[order[..., : config.size]].sort(-1).values,
        config.current,
        config.shortest,
        config.longest,
        config.window,
        config.rewarded,
    )


def build_coding(config: CodingConfig, network: Network) -> Coding:
    """What joins the network to the world's sensors and wheels."""
    return Coding(network, config)


def build_world(config: WorldConfig, coding: CodingConfig, draws: Draws, kind: type[World] = World) -> World:
    """The world (of that kind) of the trials of `draws`, for robots with that tick and those wheel speeds."""
    world = kind(draws, config, coding.tick)
    if config.orbiting:
        world.start_orbiting(coding.slow, coding.fast)
    return world

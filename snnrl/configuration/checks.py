"""Whether a description makes sense: names that exist, values that fit together, a machine that can run it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import nn

from snnrl.body.world.kinds import AVOIDED
from snnrl.configuration.parts import (
    modulator_key,
    modulators,
    neuron_model,
    neuron_parameters,
    rule_key,
    rules,
    weight_bounds,
)
from snnrl.errors import ConfigError
from snnrl.model.synapses import DOPAMINE
from snnrl.schema import (
    CodingConfig,
    Config,
    NetworkConfig,
    NeuronConfig,
    RobotConfig,
    StimuliConfig,
    SynapseConfig,
    WorldConfig,
    bounds_of,
    check_bounds,
)

UNTAUGHT = RobotConfig(name="untaught")
RESERVED = frozenset(dir(nn.ModuleDict()))


def check(config: Config) -> None:
    """Check all values of a run; raises ConfigError at the first that is out of bounds or contradicts another."""
    check_bounds(config)
    if config.task is None:
        check_robot(config)
    else:
        check_task(config)


def torch_device(name: str) -> torch.device:
    """A device by its torch name, or a ConfigError if there is none such on this machine."""
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError("device", name, "must be cpu or cuda (or cuda:N)") from None
    if device.type not in ("cpu", "cuda"):
        raise ConfigError("device", name, "must be cpu or cuda (or cuda:N)")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise ConfigError("device", name, f"this machine has {torch.cuda.device_count()} CUDA devices")
    return device


def _one_of(key: str, value: str, names: Iterable[str]) -> None:
    names = list(names)
    if value not in names:
        raise ConfigError(key, value, f"must be one of {', '.join(names)}")


def _module_name(key: str, name: str) -> None:
    if not name.isprintable() or not name or "." in name or name in RESERVED:
        raise ConfigError(
            key, name, "cannot be a name; it must be printable, without dots, and no attribute of a module"
        )


def check_network(config: NetworkConfig, robot: RobotConfig = UNTAUGHT) -> None:
    """Names that must exist, weights that must fit; raises ConfigError."""
    _check_groups(config)
    _check_projections(config)
    _check_modulators(config)
    roles = sorted({projection.role for projection in config.projections.values()} - {""})
    _check_sets(config, roles)
    _check_teaching(config, robot, roles)


def _check_groups(config: NetworkConfig) -> None:
    for name, group in config.groups.items():
        _module_name("network.groups", name)
        _one_of(f"network.groups.{name}.neuron", group.neuron, config.neurons)
    for name, neuron in config.neurons.items():
        _check_neuron(f"network.neurons.{name}", neuron)
    if not config.groups:
        raise ConfigError("network.groups", "{}", "a network needs at least one group")


def _check_neuron(key: str, config: NeuronConfig) -> None:
    """The parameters of its model must be there, and no others."""
    needed, given = neuron_model(key, config).parameters, neuron_parameters(config)
    for name in needed:
        if name not in given:
            where = name if name in vars(config) else f"parameters.{name}"
            raise ConfigError(f"{key}.{where}", None, f"must be given; {config.model} has {', '.join(needed)}")
    for name in (*given, *config.spreads):
        if name not in needed:
            raise ConfigError(f"{key}.parameters", name, f"{config.model} has {', '.join(needed)}")


def _check_projections(config: NetworkConfig) -> None:
    for name, projection in config.projections.items():
        key = f"network.projections.{name}"
        _module_name("network.projections", name)
        _one_of(f"{key}.pre", projection.pre, config.groups)
        _one_of(f"{key}.post", projection.post, config.groups)
        _one_of(f"{key}.synapse", projection.synapse, config.synapses)
    for name, rule in rules(config).items():
        if rule.potentiation_from == "arrival" and rule.simultaneous != "depresses":
            allowed = "must be depresses with potentiation_from=arrival, before which nothing potentiates"
            raise ConfigError(f"{rule_key(name)}.simultaneous", rule.simultaneous, allowed)
    for name, kind in config.synapses.items():
        _check_synapses(f"network.synapses.{name}", kind, config)
    for name, projection in config.projections.items():
        fan_out, targets = config.synapses[projection.synapse].fan_out, config.groups[projection.post].size
        if fan_out is not None and fan_out > targets:
            allowed = f"must be at most {targets}, the size of {projection.post} (in {name})"
            raise ConfigError(f"network.synapses.{projection.synapse}.fan_out", fan_out, allowed)


def _check_synapses(key: str, kind: SynapseConfig, config: NetworkConfig) -> None:
    if (kind.probability is None) == (kind.fan_out is None):
        raise ConfigError(f"{key}.probability", kind.probability, "either probability or fan_out must be given")
    _one_of(f"{key}.rule", kind.rule, rules(config))
    for listened in kind.listens:
        _one_of(f"{key}.listens", listened, modulators(config))
    least, largest = weight_bounds(config, kind)
    if kind.plastic and not all(least <= w <= largest for w in (kind.weight, kind.weight + kind.spread)):
        reach, allowed = f"{kind.weight:g} to {kind.weight + kind.spread:g}", f"[{least:g}, {largest:g}]"
        raise ConfigError(f"{key}.weight", reach, f"plastic weights are in {allowed}")


def _check_modulators(config: NetworkConfig) -> None:
    if DOPAMINE in config.modulators:
        raise ConfigError("network.modulators", DOPAMINE, "is given as network.dopamine")
    for name, modulator in modulators(config).items():
        _module_name("network.modulators", name)
        for source in [modulator.source] if modulator.source is not None else modulator.sources.values():
            _one_of(f"{modulator_key(name)}.source", source, config.groups)


def _check_sets(config: NetworkConfig, roles: list[str]) -> None:
    """A role belongs to at most one homeostatic set."""
    used: dict[str, str] = {}
    if config.homeostasis is None:
        return
    for name in config.homeostasis.per_set:
        _one_of("network.homeostasis.per_set", name, config.homeostasis.sets)
    for name, members in config.homeostasis.sets.items():
        for role in members:
            key = f"network.homeostasis.sets.{name}"
            _one_of(key, role, roles)
            if used.setdefault(role, name) != name:
                raise ConfigError(key, role, f"already belongs to the set {used[role]}")


def _check_teaching(config: NetworkConfig, robot: RobotConfig, roles: list[str]) -> None:
    """What a robot is given in place of what it would learn must be possible to learn."""
    for role, weight in robot.weights.items():
        _one_of("robot.weights", role, roles)
        for kind in (config.synapses[p.synapse] for p in config.projections.values() if p.role == role):
            least, largest = weight_bounds(config, kind)
            if not least <= weight <= largest:
                raise ConfigError(f"robot.weights.{role}", weight, f"must be in [{least:g}, {largest:g}]")
    for role in robot.fixed:
        _one_of("robot.fixed", role, roles)


def check_robot(config: Config) -> None:
    """Values that are each allowed but do not fit together; raises ConfigError."""
    coding, world = config.body()
    _one_of("robot", config.robot.name, config.experiment.robots)
    check_network(config.network, config.robot)
    groups = config.network.groups
    _one_of("coding.motors.left", coding.motors.left, groups)
    _one_of("coding.motors.right", coding.motors.right, groups)
    if coding.slow > coding.fast:
        raise ConfigError("coding.slow", coding.slow, f"must be at most coding.fast={coding.fast:g}")
    _check_pulses(coding)
    motors = {coding.motors.left, coding.motors.right}
    for name, sensor in coding.ranges.items():
        _one_of(f"coding.ranges.{name}", name, world.ranges)
        for side in ("left", "right"):
            key, group = f"coding.ranges.{name}.{side}", getattr(sensor, side)
            _one_of(key, group, groups)
            if not any(p.pre == group and p.post in motors for p in config.network.projections.values()):
                raise ConfigError(key, group, "must have a projection to a motor group")
    for name, group in coding.touches.items():
        _one_of("coding.touches", name, world.kinds)
        _one_of(f"coding.touches.{name}", group, groups)
    _check_world(world, coding)
    roles = {projection.role for projection in config.network.projections.values()}
    for taxis, rule in config.experiment.correct.items():
        _one_of(f"experiment.correct.{taxis}", rule, ("together", "each_side"))
        if not {f"{taxis}_attraction", f"{taxis}_avoidance"} <= roles:
            allowed = "needs projections with the roles NAME_attraction and NAME_avoidance"
            raise ConfigError("experiment.correct", taxis, allowed)


def _check_pulses(coding: CodingConfig) -> None:
    """A gain of the mean must leave a mean whose distribution has a table."""
    largest = bounds_of(CodingConfig, "range_mean")["most"]
    for name in ("range", "touch") if coding.gain_acts_on == "mean" else ():
        mean, gain = getattr(coding, f"{name}_mean"), getattr(coding, f"{name}_gain")
        if gain * mean > largest:
            allowed = f"times coding.{name}_mean={mean:g} must be at most {largest:g}"
            raise ConfigError(f"coding.{name}_gain", gain, allowed)


def _check_world(world: WorldConfig, coding: CodingConfig) -> None:
    if not world.kinds:
        raise ConfigError("world.kinds", "{}", "a world needs at least one kind of object")
    for name, kind in world.kinds.items():
        for key, value in (("holds", kind.holds), *(("opens", other) for other in kind.opens)):
            if value:
                _one_of(f"world.kinds.{name}.{key}", value, world.kinds)
        if kind.holds and kind.touched != "entered":
            raise ConfigError(f"world.kinds.{name}.holds", kind.holds, "needs touched=entered")
        if kind.holds and world.kinds[kind.holds].touched != "taken":
            raise ConfigError(f"world.kinds.{name}.holds", kind.holds, "must be a kind with touched=taken")
        if kind.contains == "whole" and not kind.holds:
            raise ConfigError(f"world.kinds.{name}.contains", kind.contains, "needs holds")
        if kind.contains == "whole" and kind.radius <= world.kinds[kind.holds].radius:
            allowed = f"must be greater than {world.kinds[kind.holds].radius:g}, the radius of {kind.holds} in it"
            raise ConfigError(f"world.kinds.{name}.radius", kind.radius, allowed)
        for avoided in kind.avoids:
            _one_of(f"world.kinds.{name}.avoids", avoided, ("robot", *AVOIDED))
        if kind.sign == 0:
            raise ConfigError(f"world.kinds.{name}.sign", 0, "must be 1 or -1")
        for key in ("poison_from", "turns_every", "absent_from"):
            if getattr(kind, key) is not None and kind.touched != "taken":
                raise ConfigError(f"world.kinds.{name}.{key}", getattr(kind, key), "needs touched=taken")
        if kind.absent_until is not None and (kind.absent_from is None or kind.absent_until <= kind.absent_from):
            raise ConfigError(f"world.kinds.{name}.absent_until", kind.absent_until, "must be later than absent_from")
    _check_obstacles(world, coding)
    first = next((kind for kind in world.kinds.values() if kind.count), None)
    if world.orbiting and not (first and first.touched == "taken" and coding.slow < coding.fast):
        raise ConfigError("world.orbiting", True, "needs a first kind that is taken, and coding.slow < coding.fast")
    for name, eye in world.ranges.items():
        _one_of("world.ranges", name, coding.ranges)
        for seen in eye.sees or [name]:
            _one_of(f"world.ranges.{name}.sees", seen, world.kinds)
            needed = 2 * (eye.reach + world.kinds[seen].radius)
            if world.side < needed:
                allowed = f"must be at least {needed:g}, twice what the {name} sensor sees"
                raise ConfigError("world.side", world.side, allowed)


def _check_obstacles(world: WorldConfig, coding: CodingConfig) -> None:
    """What stops the robot must be seen coming on the torus, and must leave a place for whatever avoids it."""
    way = 0.5 * (coding.slow + coding.fast) * coding.tick / 1000.0  # in a tick
    largest = 0.5 * world.side - way
    obstacles = {name: kind for name, kind in world.kinds.items() if kind.touched == "stops" and kind.count}
    avoiding = {name: kind for name, kind in world.kinds.items() if "obstacles" in kind.avoids and kind.count}
    for name, kind in obstacles.items():
        if kind.radius >= largest:
            allowed = f"must be less than {largest:g}, half of world.side less the way of a tick"
            raise ConfigError(f"world.kinds.{name}.radius", kind.radius, allowed)
        for other, thing in avoiding.items():
            most = math.ceil(world.side**2 / (math.pi * (kind.radius + thing.radius) ** 2)) - (name != other)
            if kind.count > most:
                allowed = f"must be at most {most}, if there is to be a place for {other} apart from them"
                raise ConfigError(f"world.kinds.{name}.count", kind.count, allowed)


def check_task(config: Config) -> None:
    """The same for a task in place of coding and world; raises ConfigError."""
    task, network = config.task, config.network
    for key in ("coding", "world"):
        if getattr(config, key) is not None:
            raise ConfigError(key, "...", "must be null where there is a task")
    if task is None:
        raise ConfigError("task", None, "must be given")
    _one_of("robot", config.robot.name, config.experiment.robots)
    check_network(network, config.robot)
    if config.experiment.correct:
        raise ConfigError("experiment.correct", config.experiment.correct, "is for robots, not for tasks")
    if not modulators(network):
        raise ConfigError("network.dopamine", None, "must be given for a task, whose reward is dopamine")
    if task.stimuli is None and task.coincidence is None:
        raise ConfigError("task.stimuli", None, "a task needs stimuli or a coincidence")
    if task.reward.shortest > task.reward.longest:
        allowed = f"must be at most task.reward.longest={task.reward.longest}"
        raise ConfigError("task.reward.shortest", task.reward.shortest, allowed)
    if task.stimuli is not None:
        _check_stimuli(task.stimuli, network)
    if task.coincidence is not None:
        plastic = [name for name, p in network.projections.items() if network.synapses[p.synapse].plastic]
        _one_of("task.coincidence.projection", task.coincidence.projection, plastic)
        _, largest = weight_bounds(network, network.synapses[network.projections[task.coincidence.projection].synapse])
        if task.coincidence.weight > largest:
            allowed = f"must be in [0, {largest:g}]"
            raise ConfigError("task.coincidence.weight", task.coincidence.weight, allowed)
        if task.reward.shortest < task.tick:
            allowed = f"must be at least task.tick={task.tick}, after which a coincidence is noticed"
            raise ConfigError("task.reward.shortest", task.reward.shortest, allowed)


def _check_stimuli(stimuli: StimuliConfig, network: NetworkConfig) -> None:
    for name in stimuli.groups:
        _one_of("task.stimuli.groups", name, network.groups)
    neurons = sum(network.groups[name].size for name in set(stimuli.groups))
    if len(set(stimuli.groups)) < len(stimuli.groups) or not stimuli.groups:
        raise ConfigError("task.stimuli.groups", stimuli.groups, "must name groups, each once")
    if stimuli.size > neurons:
        raise ConfigError("task.stimuli.size", stimuli.size, f"must be at most {neurons}, the neurons of its groups")
    if stimuli.shortest > stimuli.longest:
        allowed = f"must be at most task.stimuli.longest={stimuli.longest}"
        raise ConfigError("task.stimuli.shortest", stimuli.shortest, allowed)
    if stimuli.window >= stimuli.shortest:
        allowed = f"must be less than task.stimuli.shortest={stimuli.shortest}"
        raise ConfigError("task.stimuli.window", stimuli.window, allowed)
    if stimuli.rewarded >= stimuli.count:
        raise ConfigError("task.stimuli.rewarded", stimuli.rewarded, f"must be less than count={stimuli.count}")

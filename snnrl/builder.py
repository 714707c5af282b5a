"""From descriptions to state: a `NetworkConfig` to a `Network`, a `Config` to a `Simulation`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from snnrl.body.coding import Coding
from snnrl.body.robot import Robot
from snnrl.body.world import World
from snnrl.configuration import footprint
from snnrl.configuration.functions import function
from snnrl.configuration.schema import (
    CodingConfig,
    Config,
    ConfigError,
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
from snnrl.model.draws import Draws, stream
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.modulators import Modulator, burst
from snnrl.model.network import Network
from snnrl.model.neurons import IZHIKEVICH, NeuronGroup, NeuronModel
from snnrl.model.plasticity import Plasticity, depress, hard_bounds, potentiate
from snnrl.model.synapses import DOPAMINE, Projection
from snnrl.simulation import Simulation
from snnrl.tasks.task import Coincidence, Reward, Stimuli, Task

UNTAUGHT = RobotConfig(name="untaught")
RESERVED = frozenset(dir(nn.ModuleDict()))
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


def check(config: Config) -> None:
    """Check all values of a run; raises ConfigError at the first that is out of bounds or contradicts another."""
    check_bounds(config)
    if config.task is None:
        check_robot(config)
    else:
        check_task(config)


def _draws(config: Config) -> Draws:
    first = config.trial_start
    return Draws(config.seed, torch.arange(first, first + config.trials, device=torch_device(config.device)))


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
    rules = {name: _plasticity(_rule_key(name), rule) for name, rule in rule_configs(config).items()}
    projections = [
        _projection(name, projection, config, robot, draws, dtype, rules)
        for name, projection in config.projections.items()
    ]
    return kind(
        groups,
        projections,
        draws,
        config.synaptic_gain,
        [_modulator(name, modulator, draws, dtype) for name, modulator in modulator_configs(config).items()],
        {} if config.homeostasis is None else _homeostasis(config.homeostasis, projections),
    )


def rule_configs(config: NetworkConfig) -> dict[str, PlasticityConfig]:
    """The plasticity rules by name; the one without a name is that of whoever names none."""
    return {"": config.plasticity, **config.rules}


def _rule_key(name: str) -> str:
    return f"network.rules.{name}" if name else "network.plasticity"


def _plasticity(key: str, config: PlasticityConfig) -> Plasticity:
    functions = {
        name: function(f"{key}.{name}", getattr(config, name), {own.__name__: own for own in owns})
        for name, owns in (("at_post", (potentiate,)), ("at_pre", (depress,)), ("weight_rule", (hard_bounds,)))
    }
    try:
        return Plasticity(**{**vars(config), "values": dict(config.values), **functions})
    except ValueError as error:
        raise ConfigError(key, "...", str(error)) from error


def modulator_configs(config: NetworkConfig) -> dict[str, ModulatorConfig]:
    """All modulators by name, dopamine first."""
    return ({} if config.dopamine is None else {DOPAMINE: config.dopamine}) | config.modulators


def _modulator_key(name: str) -> str:
    return "network.dopamine" if name == DOPAMINE else f"network.modulators.{name}"


def _modulator(name: str, config: ModulatorConfig, draws: Draws, dtype: torch.dtype) -> Modulator:
    key = _modulator_key(name)
    released = function(f"{key}.released", config.released, {"burst": burst})
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
        name: Homeostasis(names, config.limit, config.step, config.count_absent)
        for name, names in members.items()
        if names
    }


def neuron_model(key: str, config: NeuronConfig) -> NeuronModel:
    """The model that a configuration names; raises ConfigError."""
    found = function(f"{key}.model", config.model, {"izhikevich": IZHIKEVICH})
    try:
        return found if isinstance(found, NeuronModel) else NeuronModel(found)
    except ValueError as error:
        raise ConfigError(f"{key}.model", config.model, str(error)) from error


def neuron_parameters(config: NeuronConfig) -> dict[str, tuple[float, float]]:
    """Value and spread of each parameter that is given."""
    own = {name: (getattr(config, name), getattr(config, f"{name}_spread", 0.0)) for name in "abcd"}
    given = {name: (value, config.spreads.get(name, 0.0)) for name, value in config.parameters.items()}
    return {name: pair for name, pair in {**own, **given}.items() if pair[0] is not None}


def _group(name: str, config: GroupConfig, neuron: NeuronConfig, draws: Draws, dtype: torch.dtype) -> NeuronGroup:
    squared = draws.at_start(stream("neurons", name), config.size) ** 2
    parameters = {
        key: (value + spread * squared).to(dtype) for key, (value, spread) in neuron_parameters(neuron).items()
    }
    model = neuron_model(f"network.neurons.{config.neuron}", neuron)
    return NeuronGroup(name, model, parameters, neuron.v, config.current, config.noise)


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
    weight = kind.weight + kind.spread * draws.at_start(stream("weights", name), pairs)
    if config.role in robot.weights:
        weight = torch.full_like(weight, robot.weights[config.role])
    return Projection(
        name,
        config.pre,
        config.post,
        connected,
        weight.view(shape).to(dtype),
        rules[kind.rule] if kind.plastic and robot.learning and config.role not in robot.fixed else None,
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


def _one_of(key: str, value: str, names: object) -> None:
    if value not in list(names):  # type: ignore[call-overload]
        raise ConfigError(key, value, f"must be one of {', '.join(names)}")  # type: ignore[arg-type]


def _module_name(key: str, name: str) -> None:
    if not name.isprintable() or not name or "." in name or name in RESERVED:
        raise ConfigError(
            key, name, "cannot be a name; it must be printable, without dots, and no attribute of a module"
        )


def check_network(config: NetworkConfig, robot: RobotConfig = UNTAUGHT) -> None:
    """Names that must exist, weights that must fit; raises ConfigError."""
    for name, group in config.groups.items():
        _module_name("network.groups", name)
        _one_of(f"network.groups.{name}.neuron", group.neuron, config.neurons)
    for name, neuron in config.neurons.items():
        _check_neuron(f"network.neurons.{name}", neuron)
    if not config.groups:
        raise ConfigError("network.groups", "{}", "a network needs at least one group")
    for name, projection in config.projections.items():
        key = f"network.projections.{name}"
        _module_name("network.projections", name)
        _one_of(f"{key}.pre", projection.pre, config.groups)
        _one_of(f"{key}.post", projection.post, config.groups)
        _one_of(f"{key}.synapse", projection.synapse, config.synapses)
    for name, kind in config.synapses.items():
        if (kind.probability is None) == (kind.fan_out is None):
            key, value = f"network.synapses.{name}.probability", kind.probability
            raise ConfigError(key, value, "either probability or fan_out must be given")
        _one_of(f"network.synapses.{name}.rule", kind.rule, rule_configs(config))
        for listened in kind.listens:
            _one_of(f"network.synapses.{name}.listens", listened, modulator_configs(config))
        least, largest = _bounds(config, kind)
        if kind.plastic and not all(least <= w <= largest for w in (kind.weight, kind.weight + kind.spread)):
            reach, allowed = f"{kind.weight:g} to {kind.weight + kind.spread:g}", f"[{least:g}, {largest:g}]"
            raise ConfigError(f"network.synapses.{name}.weight", reach, f"plastic weights are in {allowed}")
    for name, projection in config.projections.items():
        fan_out, targets = config.synapses[projection.synapse].fan_out, config.groups[projection.post].size
        if fan_out is not None and fan_out > targets:
            allowed = f"must be at most {targets}, the size of {projection.post} (in {name})"
            raise ConfigError(f"network.synapses.{projection.synapse}.fan_out", fan_out, allowed)
    if DOPAMINE in config.modulators:
        raise ConfigError("network.modulators", DOPAMINE, "is given as network.dopamine")
    for called, modulator in modulator_configs(config).items():
        _module_name("network.modulators", called)
        for source in [modulator.source] if modulator.source is not None else modulator.sources.values():
            _one_of(f"{_modulator_key(called)}.source", source, config.groups)
    roles = sorted({projection.role for projection in config.projections.values()} - {""})
    used: dict[str, str] = {}
    for name, members in ({} if config.homeostasis is None else config.homeostasis.sets).items():
        for role in members:
            key = f"network.homeostasis.sets.{name}"
            _one_of(key, role, roles)
            if used.setdefault(role, name) != name:
                raise ConfigError(key, role, f"already belongs to the set {used[role]}")
    for role, weight in robot.weights.items():
        _one_of("robot.weights", role, roles)
        for kind in (config.synapses[p.synapse] for p in config.projections.values() if p.role == role):
            least, largest = _bounds(config, kind)
            if not least <= weight <= largest:
                raise ConfigError(f"robot.weights.{role}", weight, f"must be in [{least:g}, {largest:g}]")
    for role in robot.fixed:
        _one_of("robot.fixed", role, roles)


def _bounds(config: NetworkConfig, kind: SynapseConfig) -> tuple[float, float]:
    """Of the weights of a kind of synapse, if it is plastic."""
    rule = rule_configs(config)[kind.rule]
    return rule.weight_min, rule.weight_max


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
        if kind.sign == 0:
            raise ConfigError(f"world.kinds.{name}.sign", 0, "must be 1 or -1")
        if kind.poison_from is not None and kind.touched != "taken":
            raise ConfigError(f"world.kinds.{name}.poison_from", kind.poison_from, "needs touched=taken")
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
    if not modulator_configs(network):
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
        _, largest = _bounds(network, network.synapses[network.projections[task.coincidence.projection].synapse])
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

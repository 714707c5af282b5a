"""From descriptions to state: a `NetworkConfig` to a `Network`, a `Config` to a `Simulation`."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from snnrl import memory
from snnrl.coding import Coding, Pulse
from snnrl.homeostasis import Homeostasis
from snnrl.loop import Simulation
from snnrl.modulators import Dopamine
from snnrl.network import Network
from snnrl.neurons import NeuronGroup
from snnrl.random import Draws, stream
from snnrl.schema import (
    CodingConfig,
    Config,
    ConfigError,
    DopamineConfig,
    GroupConfig,
    HomeostasisConfig,
    NetworkConfig,
    NeuronConfig,
    ProjectionConfig,
    RobotConfig,
    SynapseConfig,
    WorldConfig,
    check_bounds,
)
from snnrl.synapses import Plasticity, Projection
from snnrl.world import TOUCHES, RangeSensor, World

UNTAUGHT = RobotConfig(name="untaught")
RESERVED = frozenset(dir(nn.ModuleDict()))
DTYPES = {"float32": torch.float32, "float64": torch.float64}


def build(config: Config) -> Simulation:
    """The whole closed loop of a run.

    Raises:
        ConfigError: names the first value that is out of bounds or contradicts another.
    """
    check(config)
    memory.check(memory.of_run(config))
    device = torch_device(config.device)
    trials = torch.arange(config.trial_start, config.trial_start + config.trials, device=device)
    draws = Draws(config.seed, trials)
    network = build_network(config.network, draws, DTYPES[config.dtype], config.robot)
    coding = build_coding(config.coding, network)
    return Simulation(network, coding, build_world(config.world, config.coding, draws))


def check(config: Config) -> None:
    """Check all values of a run; raises ConfigError at the first that is out of bounds or contradicts another."""
    check_bounds(config)
    check_contradictions(config)


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
    memory.check(memory.of_network(config, len(draws.trials)))
    groups = [_group(name, group, config.neurons[group.neuron], draws, dtype) for name, group in config.groups.items()]
    projections = [
        _projection(name, projection, config, robot, draws, dtype) for name, projection in config.projections.items()
    ]
    rule = config.plasticity
    return kind(
        groups,
        projections,
        draws,
        config.synaptic_gain,
        Plasticity(
            rule.potentiation, rule.depression, rule.tau_plus, rule.tau_minus, rule.tau_eligibility, rule.weight_max
        ),
        None if config.dopamine is None else _dopamine(config.dopamine, draws, dtype),
        {} if config.homeostasis is None else _homeostasis(config.homeostasis, projections),
    )


def _dopamine(config: DopamineConfig, draws: Draws, dtype: torch.dtype) -> Dopamine:
    return Dopamine(
        config.source,
        len(draws.trials),
        config.baseline,
        config.tau,
        config.release,
        config.delay,
        config.threshold,
        dtype,
        draws.trials.device,
    )


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


def _group(name: str, config: GroupConfig, neuron: NeuronConfig, draws: Draws, dtype: torch.dtype) -> NeuronGroup:
    squared = draws.at_start(stream("neurons", name), config.size) ** 2

    def parameter(value: float, spread: float = 0.0) -> Tensor:
        return (value + spread * squared).to(dtype)

    return NeuronGroup(
        name,
        parameter(neuron.a),
        parameter(neuron.b),
        parameter(neuron.c, neuron.c_spread),
        parameter(neuron.d, neuron.d_spread),
        neuron.v,
        config.current,
        config.noise,
    )


def _projection(
    name: str,
    config: ProjectionConfig,
    network: NetworkConfig,
    robot: RobotConfig,
    draws: Draws,
    dtype: torch.dtype,
) -> Projection:
    kind: SynapseConfig = network.synapses[config.synapse]
    shape = (len(draws.trials), network.groups[config.pre].size, network.groups[config.post].size)
    pairs = shape[1] * shape[2]
    connected = draws.at_start(stream("connections", name), pairs) < kind.probability
    weight = kind.weight + kind.spread * draws.at_start(stream("weights", name), pairs)
    if config.role in robot.weights:
        weight = torch.full_like(weight, robot.weights[config.role])
    return Projection(
        name,
        config.pre,
        config.post,
        connected.view(shape),
        weight.view(shape).to(dtype),
        kind.plastic and robot.learning and config.role not in robot.fixed,
        kind.delay,
        config.role,
    )


def build_coding(config: CodingConfig, network: Network) -> Coding:
    """What joins the network to the world's sensors and wheels."""
    return Coding(
        network,
        {name: (pair.left, pair.right) for name, pair in config.ranges.items()},
        config.touches,
        (config.motors.left, config.motors.right),
        Pulse(config.range_mean, config.range_gain),
        Pulse(config.touch_mean, config.touch_gain),
        config.exploration,
        config.slow,
        config.fast,
        config.tick,
    )


def build_world(config: WorldConfig, coding: CodingConfig, draws: Draws, kind: type[World] = World) -> World:
    """The world (of that kind) of the trials of `draws`, for robots with that tick and those wheel speeds."""
    world = kind(
        draws,
        config.side,
        config.free_items,
        config.food_containers,
        config.empty_containers,
        config.item_radius,
        config.container_radius,
        config.axle,
        config.container_speed,
        {k: RangeSensor(v.reach, v.measured_to == "border") for k, v in config.ranges.items()},
        coding.tick,
        None if config.poison_from is None else round(1000 * config.poison_from),
    )
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
    if not config.groups:
        raise ConfigError("network.groups", "{}", "a network needs at least one group")
    for name, projection in config.projections.items():
        key = f"network.projections.{name}"
        _module_name("network.projections", name)
        _one_of(f"{key}.pre", projection.pre, config.groups)
        _one_of(f"{key}.post", projection.post, config.groups)
        _one_of(f"{key}.synapse", projection.synapse, config.synapses)
    for name, kind in config.synapses.items():
        largest = config.plasticity.weight_max
        if kind.plastic and not (0 <= kind.weight <= largest and 0 <= kind.weight + kind.spread <= largest):
            reach = f"{kind.weight:g} to {kind.weight + kind.spread:g}"
            raise ConfigError(f"network.synapses.{name}.weight", reach, f"plastic weights are in [0, {largest:g}]")
    if config.dopamine is not None:
        _one_of("network.dopamine.source", config.dopamine.source, config.groups)
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
        if not 0 <= weight <= config.plasticity.weight_max:
            allowed = f"must be in [0, {config.plasticity.weight_max:g}]"
            raise ConfigError(f"robot.weights.{role}", weight, allowed)
    for role in robot.fixed:
        _one_of("robot.fixed", role, roles)


def check_contradictions(config: Config) -> None:
    """Values that are each allowed but do not fit together; raises ConfigError."""
    _one_of("robot", config.robot.name, config.experiment.robots)
    check_network(config.network, config.robot)
    groups, coding, world = config.network.groups, config.coding, config.world
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
        _one_of("coding.touches", name, TOUCHES)
        _one_of(f"coding.touches.{name}", group, groups)
    if world.orbiting and not (world.free_items and coding.slow < coding.fast):
        raise ConfigError("world.orbiting", True, "needs world.free_items of at least 1 and coding.slow < coding.fast")
    for name, eye in world.ranges.items():
        _one_of("world.ranges", name, ("food", "container"))
        _one_of("world.ranges", name, coding.ranges)
        radius = world.item_radius if name == "food" else world.container_radius
        needed = 2 * (eye.reach + radius)
        if world.side < needed:
            allowed = f"must be at least {needed:g}, twice what the {name} sensor sees"
            raise ConfigError("world.side", world.side, allowed)
    roles = {projection.role for projection in config.network.projections.values()}
    for taxis, rule in config.experiment.correct.items():
        _one_of(f"experiment.correct.{taxis}", rule, ("together", "each_side"))
        if not {f"{taxis}_attraction", f"{taxis}_avoidance"} <= roles:
            allowed = "needs projections with the roles NAME_attraction and NAME_avoidance"
            raise ConfigError("experiment.correct", taxis, allowed)

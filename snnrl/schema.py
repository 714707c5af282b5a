"""What a configuration may hold: keys, types and bounds. Values live in conf/.

The dataclasses serve Hydra as its schema and library users as descriptions for `snnrl.configuration.builder`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, get_args, get_origin, get_type_hints

from omegaconf import MISSING

from snnrl.errors import ConfigError

MOVED = {  # keys of earlier versions, and where they are now
    "world.free_items": "world.kinds.food.count",
    "world.food_containers": "world.kinds.food_container.count",
    "world.empty_containers": "world.kinds.empty_container.count",
    "world.item_radius": "world.kinds.food.radius",
    "world.container_radius": "world.kinds.food_container.radius and world.kinds.empty_container.radius",
    "world.container_speed": "world.kinds.food_container.speed and world.kinds.empty_container.speed",
    "world.poison_from": "world.kinds.food.poison_from",
}
FOOD = "food"  # the kind of object whose touches are a robot's score


def number(
    default: Any = MISSING,
    least: float | None = None,
    most: float | None = None,
    above: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:
    """A field with bounds: least <= value <= most, value > above, or one of the choices."""
    return field(default=default, metadata={"least": least, "most": most, "above": above, "choices": choices})


def places() -> Any:
    """A field that is a list of whole numbers, or null unless given."""
    return field(default=None, metadata={"of": int})


def table() -> Any:
    """A field that is a dictionary, empty unless given."""
    return field(default_factory=dict)


@dataclass
class NeuronConfig:
    """A neuron model and its parameters: each is value + spread * r^2 with r uniform in [0, 1) per neuron.

    `model` is izhikevich, whose parameters are a, b, c + c_spread r^2, d + d_spread r^2, or a function of your own
    (see `snnrl.model.neurons.NeuronModel`) as FILE.py:NAME or MODULE:NAME, whose are `parameters` and `spreads`.
    """

    a: float | None = None
    b: float | None = None
    c: float | None = None
    d: float | None = None
    c_spread: float = 0.0
    d_spread: float = 0.0
    v: float = MISSING  # initial potential, mV
    model: Any = "izhikevich"
    parameters: dict[str, float] = table()
    spreads: dict[str, float] = table()


@dataclass
class SynapseConfig:
    """A kind of synapse: which pairs are joined, weight + spread * uniform (mV), delay (ms).

    Pairs are joined either each with a `probability`, or so that every presynaptic neuron has `fan_out`
    different targets, drawn uniformly. What is plastic learns by `network.plasticity`, or by that of `network.rules`
    which `rule` names, from dopamine, or from the modulators in `listens`, each with a factor on its level.
    """

    probability: float | None = number(None, least=0.0, most=1.0)
    weight: float = 0.0
    spread: float = 0.0
    plastic: bool = False
    delay: int = number(1, least=1, most=1000)
    fan_out: int | None = number(None, least=1)
    rule: str = ""
    listens: dict[str, float] = table()


@dataclass
class GroupConfig:
    """A population and its background: a constant current, and what is drawn for each neuron and ms and added to it.

    noise: half width of a uniform current. gaussian: standard deviation of a Gaussian one.
    kick, kick_rate: a current that comes in single ms, and how often (Hz).
    """

    size: int = number(least=1, most=1_000_000)
    neuron: str = MISSING
    current: float = 0.0
    noise: float = number(0.0, least=0.0)
    gaussian: float = number(0.0, least=0.0)
    kick: float = 0.0
    kick_rate: float = number(0.0, least=0.0, most=1000.0)


@dataclass
class ProjectionConfig:
    """Synapses of one kind from one group to another."""

    pre: str = MISSING
    post: str = MISSING
    synapse: str = MISSING
    role: str = ""


@dataclass
class PlasticityConfig:
    """See `snnrl.model.plasticity.Plasticity`; functions of your own are given as FILE.py:NAME or MODULE:NAME.

    potentiation_from: whether a pair potentiates by the ms since the presynaptic spike's departure or its arrival,
    which is its synapse's delay later.
    """

    potentiation: float = number(least=0.0)
    depression: float = number(least=0.0)
    tau_plus: float = number(above=0.0)
    tau_minus: float = number(above=0.0)
    tau_eligibility: float = number(above=0.0)
    weight_max: float = MISSING
    simultaneous: str = number("potentiates", choices=("potentiates", "depresses"))
    potentiation_from: str = number("departure", choices=("departure", "arrival"))
    weight_min: float = 0.0
    at_post: Any = "potentiate"
    at_pre: Any = "depress"
    weight_rule: Any = "hard_bounds"
    values: dict[str, float] = table()


@dataclass
class ModulatorConfig:
    """See `snnrl.model.modulators.Modulator`.

    `source` is the group whose bursts release it, null for none. With a function of your own in `released`, as
    FILE.py:NAME or MODULE:NAME, `sources` gives it the groups that its first arguments count, and `values` the rest.
    """

    source: str | None = None
    baseline: float = MISSING
    tau: float = number(above=0.0)
    release: float = 0.0
    delay: int = number(1, least=1, most=1000)
    threshold: int = number(0, least=0, most=2**31)
    released: Any = "burst"
    sources: dict[str, str] = table()
    values: dict[str, float] = table()
    smoothing: float = number(0.0, least=0.0)
    signed: bool = True
    reward: float = 1.0


@dataclass
class SetConfig:
    """What is different in one homeostatic set; the rest is that of all."""

    limit: float | None = number(None, least=0.0)
    step: float | None = number(None, least=0.0)
    count_absent: bool | None = None


@dataclass
class HomeostasisConfig:
    """See `snnrl.model.homeostasis.Homeostasis`; a set is all plastic projections with one of its roles.

    Limit, step and count_absent are those of all sets, but where `per_set` gives a set its own.
    """

    sets: dict[str, list[str]] = table()
    limit: float = number(least=0.0)
    step: float = number(least=0.0)
    count_absent: bool = True
    per_set: dict[str, SetConfig] = table()


@dataclass
class NetworkConfig:
    """A whole network; any number of groups, projections, rules and modulators, with or without homeostasis."""

    neurons: dict[str, NeuronConfig] = table()
    synapses: dict[str, SynapseConfig] = table()
    groups: dict[str, GroupConfig] = table()
    projections: dict[str, ProjectionConfig] = table()
    synaptic_gain: float = number(least=0.0)
    plasticity: PlasticityConfig = field(default_factory=PlasticityConfig)
    rules: dict[str, PlasticityConfig] = table()
    dopamine: ModulatorConfig | None = None
    modulators: dict[str, ModulatorConfig] = table()  # further ones
    homeostasis: HomeostasisConfig | None = None


@dataclass
class PairConfig:
    """The left and the right group of a pair of range sensors, or of the motors."""

    left: str = MISSING
    right: str = MISSING


@dataclass
class CodingConfig:
    """See `snnrl.body.coding.Coding`: times in ms, speeds in cm/s. `touches` names a group for each sensor.

    gain_acts_on: whether pulses of the sensors are gain * Poisson(mean) ("counts") or Poisson(gain * mean) ("mean").
    exploration_drawn: whether the exploring motor's neurons get a new current in every ms of a tick, or keep one.
    """

    tick: int = number(least=1, most=10_000)
    range_mean: float = number(above=0.0, most=600.0)
    range_gain: float = number(least=0.0)
    touch_mean: float = number(above=0.0, most=600.0)
    touch_gain: float = number(least=0.0)
    gain_acts_on: str = number("counts", choices=("counts", "mean"))
    exploration: float = number(above=0.0, most=600.0)
    exploration_gain: float = number(1.0, least=0.0)
    exploration_drawn: str = number("each_ms", choices=("each_ms", "each_tick"))
    slow: float = number(least=0.0)
    fast: float = number(above=0.0)
    motors: PairConfig = field(default_factory=PairConfig)
    ranges: dict[str, PairConfig] = table()
    touches: dict[str, str] = table()


@dataclass
class SensorConfig:
    """How far a range sensor sees (cm), whether to an object's border or centre, and which kinds (that of its name)."""

    reach: float = number(above=0.0)
    measured_to: str = number("border", choices=("border", "centre"))
    sees: list[str] = field(default_factory=list)


@dataclass
class KindConfig:
    """A kind of object: discs of a radius (cm), `count` of them, each of which may hold one thing more of another kind.

    touched: what happens when the robot touches one: it is taken, and reappears elsewhere, or it is entered.
    holds: the kind of the thing that each of them holds. contains: whether the centre of that lies within, or all of
    it. hides: whether what it holds is sensed and touched from inside of it only, and nothing else from there.
    speed: factor on the robot's speed inside. opens: kinds that can only be entered after one of these was touched,
    until what they hold is taken.
    avoids: where none of them lies at the start or lands when moved, as far as the world's `attempts` reach: on the
    robot, or (containers) where it would overlap something that is entered.
    sign: 1, or -1 where what touching releases lowers a modulator (poison); poison_from: time (s) at which it turns;
    turns_every: s from one turn to the next; the first, unless poison_from says when, is so long after the start.
    """

    count: int = number(0, least=0, most=100_000)
    radius: float = number(above=0.0)
    touched: str = number("taken", choices=("taken", "entered"))
    holds: str = ""
    contains: str = number("centre", choices=("centre", "whole"))
    hides: bool = True
    speed: float = number(1.0, above=0.0)
    opens: list[str] = field(default_factory=list)
    avoids: list[str] = field(default_factory=list)
    sign: int = number(1, least=-1, most=1)
    poison_from: float | None = number(None, least=0.0, most=1e9)
    turns_every: float | None = number(None, least=0.001, most=1e9)


@dataclass
class WorldConfig:
    """See `snnrl.body.world.World`; lengths in cm.

    overlap: where things that are entered overlap, the robot stays in the one it is in, or is in that with the nearest
    centre. attempts: how many places are drawn, at most, for what avoids something; it lands on the last.
    """

    side: float = number(above=0.0)
    axle: float = number(above=0.0)
    kinds: dict[str, KindConfig] = table()
    ranges: dict[str, SensorConfig] = table()
    overlap: str = number("stays", choices=("stays", "nearest"))
    attempts: int = number(20, least=1, most=1000)
    orbiting: bool = False  # robots start on an orbit round the first object

    @property
    def poison_from(self) -> float | None:
        """When food turns to poison (s); None where it does not."""
        return self.kinds[FOOD].poison_from if FOOD in self.kinds else None


@dataclass
class StimuliConfig:
    """See `snnrl.tasks.stimuli.Stimuli`; `size` neurons of `groups` are drawn for each, times in ms."""

    groups: list[str] = MISSING
    count: int = number(least=1, most=100_000)
    size: int = number(least=1)
    current: float = MISSING
    shortest: int = number(least=1, most=1_000_000)
    longest: int = number(least=1, most=1_000_000)
    window: int = number(least=1, most=1_000_000)
    rewarded: int = number(least=0)


@dataclass
class CoincidenceConfig:
    """See `snnrl.tasks.coincidences.Coincidence`; a synapse of the projection is drawn, and starts at `weight` (mV)."""

    projection: str = MISSING
    window: int = number(least=1, most=1_000_000)
    weight: float = number(least=0.0)


@dataclass
class RewardConfig:
    """See `snnrl.tasks.rewards.Reward`; amount in uM, delays in ms."""

    amount: float = MISSING
    shortest: int = number(least=0, most=1_000_000)
    longest: int = number(least=0, most=1_000_000)


@dataclass
class TaskConfig:
    """See `snnrl.tasks.task.Task`; the network runs for `tick` ms at a time."""

    tick: int = number(least=1, most=10_000)
    reward: RewardConfig = field(default_factory=RewardConfig)
    stimuli: StimuliConfig | None = None
    coincidence: CoincidenceConfig | None = None


@dataclass
class RobotConfig:
    """What distinguishes a robot: initial weights by role (mV), and which roles do not learn."""

    name: str = MISSING
    learning: bool = True
    weights: dict[str, float] = table()
    fixed: list[str] = field(default_factory=list)


@dataclass
class ExperimentConfig:
    """What an experiment is called, which robots it is for, and which taxes make a trial correct.

    `correct` gives each taxis its rule in `snnrl.recording.criteria`: together or each_side.
    """

    name: str = MISSING
    robots: list[str] = MISSING
    correct: dict[str, str] = table()


@dataclass
class AlarmsConfig:
    """Thresholds of `snnrl.recording.alarms.Alarms`; null is never."""

    silent: float | None = number(None, above=0.0)  # s
    saturated: float | None = number(None, least=0.0, most=1.0)  # share of the plastic weights
    synchronised: float | None = number(None, least=-1.0, most=1.0)  # correlation
    synchronised_above: float = number(0.0, least=0.0)  # mV, both mean weights
    synchronised_lead: float = number(1.0, least=0.0)  # of attraction over avoidance, with which all is well
    synchronised_over: float = number(0.0, least=0.0)  # s that the correlation is over


@dataclass
class MonitorConfig:
    """See `snnrl.recording.monitors.Monitor`; `every` in ms, null is all of them."""

    of: str = MISSING
    quantities: list[str] = MISSING
    neurons: list[int] | None = places()
    pre: list[int] | None = places()
    post: list[int] | None = places()
    trials: list[int] | None = places()
    every: int = number(1, least=1, most=2**31)


@dataclass
class RecordConfig:
    """What is kept of a run, all in simulated s: `every` so many from `start` on the series are sampled.

    `tensorboard` says whether events are written, `histograms` and `pictures` how often those of the weights
    and of the first trial are; 0 is never. `alarms` are checked at every sample. `monitors` keep single neurons,
    synapses and modulators besides.
    """

    every: float = number(above=0.0)
    start: float = number(0.0, least=0.0)
    tensorboard: bool = True
    histograms: float = number(0.0, least=0.0)
    pictures: float = number(0.0, least=0.0)
    alarms: AlarmsConfig = field(default_factory=AlarmsConfig)
    monitors: dict[str, MonitorConfig] = table()


@dataclass
class CheckpointConfig:
    """How often (simulated s) an unfinished run is saved; 0 or null is never."""

    every: float | None = number(None, least=0.0)


@dataclass
class Config:
    """Everything a run is made from: a network with either coding and world (a robot) or a task."""

    experiment: ExperimentConfig = field(default_factory=ExperimentConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    coding: CodingConfig | None = None
    world: WorldConfig | None = None
    task: TaskConfig | None = None
    record: RecordConfig = field(default_factory=RecordConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)
    trials: int = number(least=1, most=10_000_000)
    trial_start: int = number(0, least=0, most=2**31)
    seconds: float = number(above=0.0, most=1e9)
    seed: int = number(0, least=0, most=2**63 - 1)
    engine: str = number("auto", choices=("auto", "reference", "fused", "cuda"))
    device: str = "cpu"
    dtype: str = number("float32", choices=("float32", "float64"))
    threads: int = number(0, least=0, most=4096)  # 0 is one per processor

    def body(self) -> tuple[CodingConfig, WorldConfig]:
        """Coding and world of a robot.

        Raises:
            ConfigError: this is a task, which has none.
        """
        for name in ("coding", "world"):
            if getattr(self, name) is None:
                raise ConfigError(name, None, "must be given where there is no task")
        assert self.coding is not None
        assert self.world is not None
        return self.coding, self.world


@dataclass
class BraitenbergConfig:
    """See `snnrl.agents.agents.Braitenberg`."""

    exploration: float = number(least=0.0, most=1.0)


@dataclass
class QLearningConfig:
    """See `snnrl.agents.agents.QLearning`."""

    bins: int = number(least=1, most=100)
    rate: float = number(above=0.0, most=1.0)
    discount: float = number(least=0.0, most=1.0)
    exploration: float = number(least=0.0, most=1.0)


@dataclass
class SarsaLambdaConfig(QLearningConfig):
    """See `snnrl.agents.agents.SarsaLambda`."""

    trace: float = number(least=0.0, most=1.0)


@dataclass
class ReinforceConfig:
    """See `snnrl.agents.agents.Reinforce`."""

    bins: int = number(least=1, most=100)
    rate: float = number(above=0.0)
    discount: float = number(least=0.0, most=1.0)


@dataclass
class BaselinesConfig:
    """A comparison of agents: each task is what one would give to `snnrl.run`.

    `trials` and `seconds` are those of each task unless given.
    """

    tasks: dict[str, list[str]] = table()
    agents: list[str] = MISSING
    braitenberg: BraitenbergConfig = field(default_factory=BraitenbergConfig)
    q_learning: QLearningConfig = field(default_factory=QLearningConfig)
    sarsa_lambda: SarsaLambdaConfig = field(default_factory=SarsaLambdaConfig)
    reinforce: ReinforceConfig = field(default_factory=ReinforceConfig)
    trials: int | None = number(None, least=1, most=10_000_000)
    seconds: float | None = number(None, above=0.0, most=1e9)
    seed: int = number(0, least=0, most=2**63 - 1)
    samples: int = number(least=1, most=1_000_000)  # points in time of each task's series


def no_such_key(key: str, known: Iterable[str]) -> str:
    """What to say of a key that is not among those known."""
    return f"is now {MOVED[key]}" if key in MOVED else f"no such key; allowed here: {', '.join(known)}"


def bounds_of(config: Any, name: str) -> Mapping[str, Any]:
    """The bounds of a dataclass's field."""
    return next(item.metadata for item in dataclasses.fields(config) if item.name == name)


def check_bounds(config: Any, key: str = "") -> None:
    """Check every value of a dataclass, recursively, against the bounds of its field.

    Raises:
        ConfigError: at the first value that is missing, not finite or out of bounds, or that no field is for
            (Hydra's + adds keys to anything).
    """
    known = [item.name for item in dataclasses.fields(config)]
    for name, value in vars(config).items():
        if name not in known:
            raise ConfigError(f"{key}{name}", value, no_such_key(f"{key}{name}", known))
    hints = get_type_hints(type(config))
    for item in dataclasses.fields(config):
        value, name = getattr(config, item.name), f"{key}{item.name}"
        container = get_origin(hints[item.name])
        if container in (dict, list) and not isinstance(value, container) and value != MISSING:
            raise ConfigError(name, value, f"must be a {'table' if container is dict else 'list'}")
        for part in (hints[item.name], *get_args(hints[item.name])):
            if dataclasses.is_dataclass(part):
                _check_nodes(name, value, part)
        if dataclasses.is_dataclass(value):
            check_bounds(value, f"{name}.")
        elif isinstance(value, dict):
            for part, inner in value.items():
                if dataclasses.is_dataclass(inner):
                    check_bounds(inner, f"{name}.{part}.")
                else:
                    _check(f"{name}.{part}", inner, {})
        else:
            _check(name, value, item.metadata)


def _check_nodes(name: str, value: Any, kind: Any) -> None:
    """A reference (${...}) may have put anything where a dataclass, or a dictionary of them, belongs."""
    nodes = value if isinstance(value, dict) else {} if value is None else {"": value}
    for part, node in nodes.items():
        if not isinstance(node, kind):
            allowed = ", ".join(item.name for item in dataclasses.fields(kind))
            raise ConfigError(f"{name}.{part}".rstrip("."), node, f"must hold {allowed}")


def _check(name: str, value: Any, bounds: Any) -> None:
    if isinstance(value, str) and value == MISSING:
        raise ConfigError(name, value, "a value must be given")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(name, value, "must be a finite number")
    if (choices := bounds.get("choices")) and value not in choices:
        raise ConfigError(name, value, f"must be one of {', '.join(choices)}")
    if isinstance(value, dict):
        raise ConfigError(name, value, "must be a single value")
    if isinstance(value, list) and not all(isinstance(part, bounds.get("of", str)) for part in value):
        raise ConfigError(name, value, f"must be a list of {'whole numbers' if 'of' in bounds else 'names'}")
    if value is None or isinstance(value, (str, list)):
        return
    limits = [
        (f"greater than {bounds['above']:g}", value > bounds["above"]) if bounds.get("above") is not None else None,
        (f"at least {bounds['least']:g}", value >= bounds["least"]) if bounds.get("least") is not None else None,
        (f"at most {bounds['most']:g}", value <= bounds["most"]) if bounds.get("most") is not None else None,
    ]
    if not all(limit[1] for limit in limits if limit):
        raise ConfigError(name, value, "must be " + " and ".join(limit[0] for limit in limits if limit))

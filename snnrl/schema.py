"""What a configuration may hold: keys, types and bounds. Values live in conf/.

The dataclasses serve Hydra as its schema and library users as descriptions for `snnrl.configuration.builder`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from operator import ge, gt, le
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
LIMITS = {"above": ("greater than", gt), "least": ("at least", ge), "most": ("at most", le)}  # of a value, its bound
FOOD = "food"  # the kind of object whose touches are a robot's score


def key(
    meaning: str,
    unit: str = "",
    default: Any = MISSING,
    *,
    least: float | None = None,
    most: float | None = None,
    above: float | None = None,
    choices: tuple[str, ...] | None = None,
    of: type = str,
) -> Any:
    """A field: what it means, in which unit, and its bounds.

    Args:
        default: a value, or the type whose empty instance it is; MISSING where `conf/` must give one.
        least, most, above, choices: least <= value <= most, value > above, or one of the choices.
        of: of what a list is.
    """
    limits = {"least": least, "most": most, "above": above, "choices": choices, "of": of}
    about = {"meaning": meaning, "unit": unit, **limits}
    if isinstance(default, type):
        return field(default_factory=default, metadata=about)
    return field(default=default, metadata=about)


@dataclass
class NeuronConfig:
    """A neuron model and its parameters: each is value + spread * r^2 with r uniform in [0, 1) per neuron.

    `model` is izhikevich, whose parameters are a, b, c + c_spread r^2, d + d_spread r^2, or one whose are `parameters`
    and `spreads`: time_cell, or a function of your own (see `snnrl.model.neurons.NeuronModel`) as FILE.py:NAME or
    MODULE:NAME.
    """

    a: float | None = key("rate of the recovery u", "1/ms", None)
    b: float | None = key("coupling of u to the potential", "current/mV", None)
    c: float | None = key("reset of the potential after a spike", "mV", None)
    d: float | None = key("jump of u after a spike", "current", None)
    c_spread: float = key("of c over the neurons", "mV", 0.0)
    d_spread: float = key("of d over the neurons", "current", 0.0)
    v: float = key("potential at the start", "mV")
    model: Any = key(
        "izhikevich, time_cell, or a function of your own as FILE.py:NAME or MODULE:NAME", default="izhikevich"
    )
    parameters: dict[str, float] = key("values of an own model's parameters", default=dict)
    spreads: dict[str, float] = key("their spreads over the neurons", default=dict)


@dataclass
class SynapseConfig:
    """A kind of synapse: which pairs are joined, weight + spread * uniform, delay.

    Pairs are joined either each with a `probability`, or so that every presynaptic neuron has `fan_out`
    different targets, drawn uniformly. What is plastic learns by `network.plasticity`, or by that of `network.rules`
    which `rule` names, from dopamine, or from the modulators in `listens`, each with a factor on its level.
    """

    probability: float | None = key("of a synapse from one neuron to another", "", None, least=0.0, most=1.0)
    weight: float = key("at the start", "mV", 0.0)
    spread: float = key("added to the weight, times a number uniform in [0, 1)", "mV", 0.0)
    plastic: bool = key("whether it learns", default=False)
    delay: int = key("from a spike to its arrival", "ms", 1, least=1, most=1000)
    fan_out: int | None = key("targets of each presynaptic neuron, in place of a probability", "", None, least=1)
    rule: str = key("the one of network.rules by which it learns; empty for network.plasticity", default="")
    listens: dict[str, float] = key("modulators that it learns from, and a factor on the level of each", default=dict)


@dataclass
class GroupConfig:
    """A population and its background: a constant current, and what is drawn for each neuron and ms and added to it."""

    size: int = key("number of neurons", least=1, most=1_000_000)
    neuron: str = key("the one of network.neurons that they are")
    current: float = key("constant background", "current", 0.0)
    noise: float = key("half width of a uniform background", "current", 0.0, least=0.0)
    gaussian: float = key("standard deviation of a Gaussian background", "current", 0.0, least=0.0)
    kick: float = key("background that comes in single ms", "current", 0.0)
    kick_rate: float = key("how often it comes", "Hz", 0.0, least=0.0, most=1000.0)


@dataclass
class ProjectionConfig:
    """Synapses of one kind from one group to another."""

    pre: str = key("group that sends")
    post: str = key("group that receives")
    synapse: str = key("the one of network.synapses that they are")
    role: str = key("by which robots, criteria and homeostasis name it", default="")


@dataclass
class PlasticityConfig:
    """See `snnrl.model.plasticity.Plasticity`; functions of your own are given as FILE.py:NAME or MODULE:NAME."""

    potentiation: float = key("of eligibility, by a pair at no distance", "mV/(uM ms)", least=0.0)
    depression: float = key("of eligibility, by a pair at no distance", "mV/(uM ms)", least=0.0)
    tau_plus: float = key("width of the window that potentiates", "ms", above=0.0)
    tau_minus: float = key("width of the window that depresses", "ms", above=0.0)
    tau_eligibility: float = key("decay of eligibility", "ms", above=0.0)
    weight_max: float = key("upper bound of the weights", "mV")
    simultaneous: str = key("what two spikes of one ms do", default="potentiates", choices=("potentiates", "depresses"))
    potentiation_from: str = key(
        "from when on a presynaptic spike potentiates: its departure, or its arrival a delay later",
        default="departure",
        choices=("departure", "arrival"),
    )
    weight_min: float = key("lower bound of the weights", "mV", 0.0)
    at_post: Any = key(
        "what a pair adds at its postsynaptic spike: potentiate, or potentiate_later, most at tau_plus",
        default="potentiate",
    )
    at_pre: Any = key("what a pair adds at its presynaptic spike", default="depress")
    weight_rule: Any = key("how eligibility times dopamine changes a weight", default="hard_bounds")
    values: dict[str, float] = key("of further arguments of such functions", default=dict)


@dataclass
class ModulatorConfig:
    """See `snnrl.model.modulators.Modulator`.

    With a function of your own in `released`, as FILE.py:NAME or MODULE:NAME, `sources` gives it the groups that its
    first arguments count, and `values` the rest.
    """

    source: str | None = key("group whose bursts release it; null for none", default=None)
    baseline: float = key("level without release; below 0 it is hunger", "uM")
    tau: float = key("decay of the level to its baseline", "ms", above=0.0)
    release: float = key("by each spike of a burst", "uM", 0.0)
    delay: int = key("from a burst to its release", "ms", 1, least=1, most=1000)
    threshold: int = key("spikes in one ms; it is a burst if there are more", "spikes", 0, least=0, most=2**31)
    released: Any = key(
        "how much is released: burst, or deviation, by all spikes less `tonic` ones per ms of values", default="burst"
    )
    sources: dict[str, str] = key("groups that an own function counts, by the names of its arguments", default=dict)
    values: dict[str, float] = key("of its further arguments", default=dict)
    smoothing: float = key("decay of a mean over the spikes that it counts; 0 is none", "ms", 0.0, least=0.0)
    signed: bool = key("whether poison makes a release lower the level", default=True)
    reward: float = key("factor on the reward of a task", default=1.0)


@dataclass
class SetConfig:
    """What is different in one homeostatic set; the rest is that of all."""

    limit: float | None = key("see network.homeostasis.limit", "mV", None, least=0.0)
    step: float | None = key("see network.homeostasis.step", "mV", None, least=0.0)
    count_absent: bool | None = key("see network.homeostasis.count_absent", default=None)


@dataclass
class HomeostasisConfig:
    """See `snnrl.model.homeostasis.Homeostasis`; a set is all plastic projections with one of its roles."""

    sets: dict[str, list[str]] = key("the roles in each set", default=dict)
    limit: float = key("of a set's mean weight", "mV", least=0.0)
    step: float = key("by which all weights of a set above its limit are lowered", "mV", least=0.0)
    count_absent: bool = key("whether pairs without a synapse count as zeros in the mean", default=True)
    per_set: dict[str, SetConfig] = key("what is a set's own", default=dict)


@dataclass
class NetworkConfig:
    """A whole network; any number of groups, projections, rules and modulators, with or without homeostasis."""

    neurons: dict[str, NeuronConfig] = key("neuron models", default=dict)
    synapses: dict[str, SynapseConfig] = key("kinds of synapses", default=dict)
    groups: dict[str, GroupConfig] = key("populations of neurons", default=dict)
    projections: dict[str, ProjectionConfig] = key("from group to group", default=dict)
    synaptic_gain: float = key("current of a spike for each mV of weight", "current/mV", least=0.0)
    plasticity: PlasticityConfig = key("how plastic synapses learn", default=PlasticityConfig)
    rules: dict[str, PlasticityConfig] = key("further ways to learn", default=dict)
    dopamine: ModulatorConfig | None = key("the modulator that all plastic synapses listen to", default=None)
    modulators: dict[str, ModulatorConfig] = key("further modulators", default=dict)
    homeostasis: HomeostasisConfig | None = key("competition within sets of projections", default=None)


@dataclass
class PairConfig:
    """The left and the right group of a pair of range sensors, or of the motors."""

    left: str = key("group on the left")
    right: str = key("group on the right")


@dataclass
class CodingConfig:
    """See `snnrl.body.coding.Coding`."""

    tick: int = key("between two actions of the body", "ms", least=1, most=10_000)
    range_mean: float = key("Poisson mean of the pulse of a range sensor that answers with 1", above=0.0, most=600.0)
    range_gain: float = key("of range pulses", "current", least=0.0)
    range_current: float = key("in every ms, of a range sensor that answers with 1", "current", 0.0, least=0.0)
    touch_mean: float = key("Poisson mean of a touch sensor's pulse", above=0.0, most=600.0)
    touch_gain: float = key("of touch pulses", "current", least=0.0)
    gain_acts_on: str = key(
        "pulses are gain * Poisson(mean), or Poisson(gain * mean)", default="counts", choices=("counts", "mean")
    )
    exploration: float = key(
        "Poisson mean of what each neuron of one motor group gets in every ms", above=0.0, most=600.0
    )
    exploration_gain: float = key("of exploration", "current", 1.0, least=0.0)
    exploration_drawn: str = key(
        "whether exploring neurons get a new current in every ms of a tick, or keep one",
        default="each_ms",
        choices=("each_ms", "each_tick"),
    )
    wheels: str = key(
        "whether the motor with more spikes has the fast wheel, or each is as fast as its share of the spikes",
        default="winner",
        choices=("winner", "share"),
    )
    slow: float = key("speed of the slow wheel", "cm/s", least=0.0)
    fast: float = key("speed of the fast wheel", "cm/s", above=0.0)
    motors: PairConfig = key("the groups that move the wheels", default=PairConfig)
    ranges: dict[str, PairConfig] = key("groups of each range sensor", default=dict)
    touches: dict[str, str] = key("group of each touch sensor, by the kind that is touched", default=dict)


@dataclass
class SensorConfig:
    """How far a range sensor sees, to what of an object, and which kinds."""

    reach: float = key("how far it sees", "cm", above=0.0)
    measured_to: str = key("of an object", default="border", choices=("border", "centre"))
    sees: list[str] = key("kinds of objects; empty for the one of its own name", default=list)
    answers: str = key(
        "whether of left and right only the one with the nearer object answers, or both",
        default="nearer",
        choices=("nearer", "both"),
    )


@dataclass
class KindConfig:
    """A kind of object: discs, each of which may hold one thing more of another kind."""

    count: int = key("how many there are, besides those that others hold", "", 0, least=0, most=100_000)
    radius: float = key("of each", "cm", above=0.0)
    touched: str = key(
        "what happens to one that is touched: taken, it reappears elsewhere; or it is entered; or it stops the robot",
        default="taken",
        choices=("taken", "entered", "stops"),
    )
    holds: str = key("kind of the thing that each of them holds", default="")
    contains: str = key(
        "whether the centre of that lies within, or all of it", default="centre", choices=("centre", "whole")
    )
    hides: bool = key(
        "whether what it holds is sensed and touched from inside only, and nothing else from there", default=True
    )
    speed: float = key("factor on the robot's speed inside", "", 1.0, above=0.0)
    opens: list[str] = key(
        "kinds that can only be entered after one of these was touched, until what they hold is taken", default=list
    )
    avoids: list[str] = key(
        "where none of them lands, as far as world.attempts reach: on the robot, on containers, or on obstacles",
        default=list,
    )
    sign: int = key("1, or -1 where what touching releases lowers a modulator (poison)", "", 1, least=-1, most=1)
    poison_from: float | None = key("when the sign turns; null for never", "s", None, least=0.0, most=1e9)
    turns_every: float | None = key(
        "from one turn of the sign to the next, the first at poison_from, or so long after the start",
        "s",
        None,
        least=0.001,
        most=1e9,
    )
    absent_from: float | None = key(
        "from when on none is there to be sensed or taken; null for never", "s", None, least=0.0, most=1e9
    )
    absent_until: float | None = key("when all are there again; null for never", "s", None, least=0.0, most=1e9)


@dataclass
class WorldConfig:
    """See `snnrl.body.world.World`."""

    side: float = key("of the torus", "cm", above=0.0)
    axle: float = key("distance of the wheels", "cm", above=0.0)
    kinds: dict[str, KindConfig] = key("kinds of objects", default=dict)
    ranges: dict[str, SensorConfig] = key("range sensors", default=dict)
    overlap: str = key(
        "where things that are entered overlap, the robot stays in its own, or is in that with the nearest centre",
        default="stays",
        choices=("stays", "nearest"),
    )
    attempts: int = key(
        "places drawn, at most, for what avoids something; it lands on the last", "", 20, least=1, most=1000
    )
    orbiting: bool = key("whether robots start on an orbit round the first object", default=False)

    @property
    def poison_from(self) -> float | None:
        """When food turns to poison (s); None where it does not."""
        return self.kinds[FOOD].poison_from if FOOD in self.kinds else None


@dataclass
class StimuliConfig:
    """See `snnrl.tasks.stimuli.Stimuli`."""

    groups: list[str] = key("of whose neurons the stimuli are drawn")
    count: int = key("number of stimuli", least=1, most=100_000)
    size: int = key("neurons of each", least=1)
    current: float = key("of a stimulus's pulse", "current")
    shortest: int = key("interval between two stimuli", "ms", least=1, most=1_000_000)
    longest: int = key("interval between two stimuli", "ms", least=1, most=1_000_000)
    window: int = key("after a stimulus, in which spikes are its response", "ms", least=1, most=1_000_000)
    rewarded: int = key("number of the stimulus that earns rewards", least=0)


@dataclass
class CoincidenceConfig:
    """See `snnrl.tasks.coincidences.Coincidence`; the synapse that is watched is drawn."""

    projection: str = key("one of whose synapses is watched")
    window: int = key("from a presynaptic spike to the postsynaptic one", "ms", least=1, most=1_000_000)
    weight: float = key("of that synapse at the start", "mV", least=0.0)


@dataclass
class RewardConfig:
    """See `snnrl.tasks.rewards.Reward`."""

    amount: float = key("dopamine of a reward", "uM")
    shortest: int = key("delay of a reward", "ms", least=0, most=1_000_000)
    longest: int = key("delay of a reward", "ms", least=0, most=1_000_000)


@dataclass
class TaskConfig:
    """See `snnrl.tasks.task.Task`."""

    tick: int = key("for which the network runs at a time", "ms", least=1, most=10_000)
    reward: RewardConfig = key("what it earns", default=RewardConfig)
    stimuli: StimuliConfig | None = key("sets of neurons that are made to fire together", default=None)
    coincidence: CoincidenceConfig | None = key("a synapse whose spikes are rewarded", default=None)


@dataclass
class RobotConfig:
    """What distinguishes a robot."""

    name: str = key("by which experiments and tables name it")
    learning: bool = key("whether anything is plastic", default=True)
    weights: dict[str, float] = key("at the start, by role; in mV", default=dict)
    fixed: list[str] = key("roles that do not learn", default=list)


@dataclass
class ExperimentConfig:
    """What an experiment is called, which robots it is for, and which taxes make a trial correct."""

    name: str = key("by which folders and tables name it")
    robots: list[str] = key("names of those that it is for")
    correct: dict[str, str] = key("the criterion of each taxis: together or each_side", default=dict)


@dataclass
class AlarmsConfig:
    """Thresholds of `snnrl.recording.alarms.Alarms`; null is never."""

    silent: float | None = key("for which a motor group has not fired", "s", None, above=0.0)
    saturated: float | None = key("share of plastic weights at the upper bound", "", None, least=0.0, most=1.0)
    synchronised: float | None = key("correlation of attraction and avoidance", "", None, least=-1.0, most=1.0)
    synchronised_above: float = key("mean weight that both must exceed", "mV", 0.0, least=0.0)
    synchronised_lead: float = key("factor of attraction over avoidance with which all is well", "", 1.0, least=0.0)
    synchronised_over: float = key("that the correlation is over", "s", 0.0, least=0.0)


@dataclass
class MonitorConfig:
    """See `snnrl.recording.monitors.Monitor`."""

    of: str = key("group, projection or modulator that is watched")
    quantities: list[str] = key("what is seen of it, as v and spikes, weight and eligibility, or level")
    neurons: list[int] | None = key("of a group; null for all", default=None, of=int)
    pre: list[int] | None = key("neurons from which a projection's synapses come; null for all", default=None, of=int)
    post: list[int] | None = key("neurons to which they go; null for all", default=None, of=int)
    trials: list[int] | None = key("their numbers; null for all", default=None, of=int)
    every: int = key("between two looks", "ms", 1, least=1, most=2**31)


@dataclass
class RecordConfig:
    """What is kept of a run, all in simulated s."""

    every: float = key("between two samples of the series", "s", above=0.0)
    start: float = key("from when on there are samples", "s", 0.0, least=0.0)
    tensorboard: bool = key("whether events are written", default=True)
    loggers: list[str] = key("further ones: mlflow, or one of your own as FILE.py:NAME or MODULE:NAME", default=list)
    histograms: float = key("between two histograms of the weights; 0 is never", "s", 0.0, least=0.0)
    pictures: float = key("between two pictures of the first trial; 0 is never", "s", 0.0, least=0.0)
    alarms: AlarmsConfig = key("checked at every sample", default=AlarmsConfig)
    monitors: dict[str, MonitorConfig] = key("of single neurons, synapses and modulators", default=dict)


@dataclass
class CheckpointConfig:
    """How often an unfinished run is saved."""

    every: float | None = key("simulated, between two checkpoints; 0 or null is never", "s", None, least=0.0)


@dataclass
class Config:
    """Everything a run is made from: a network with either coding and world (a robot) or a task."""

    experiment: ExperimentConfig = key("what the run is for", default=ExperimentConfig)
    robot: RobotConfig = key("what distinguishes the robot", default=RobotConfig)
    network: NetworkConfig = key("the brain", default=NetworkConfig)
    coding: CodingConfig | None = key("between world and network", default=None)
    world: WorldConfig | None = key("where the robot lives", default=None)
    task: TaskConfig | None = key("in place of coding and world", default=None)
    record: RecordConfig = key("what is kept", default=RecordConfig)
    checkpoint: CheckpointConfig = key("how an unfinished run is saved", default=CheckpointConfig)
    trials: int = key("independent robots, each with its own graph and world", least=1, most=10_000_000)
    trial_start: int = key("number of the first trial", "", 0, least=0, most=2**31)
    seconds: float = key("simulated, of each trial", "s", above=0.0, most=1e9)
    seed: int = key("of all random numbers, with the trial's number", "", 0, least=0, most=2**63 - 1)
    engine: str = key("what advances time", default="auto", choices=("auto", "reference", "fused", "cuda"))
    device: str = key("of torch: cpu, cuda or cuda:N", default="cpu")
    dtype: str = key("of the network's state", default="float32", choices=("float32", "float64"))
    threads: int = key("of the engine; 0 is one per processor", "", 0, least=0, most=4096)

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

    exploration: float = key("share of ticks with a choice at random", least=0.0, most=1.0)


@dataclass
class QLearningConfig:
    """See `snnrl.agents.agents.QLearning`."""

    bins: int = key("into which a sensor's value is divided", least=1, most=100)
    rate: float = key("of learning", above=0.0, most=1.0)
    discount: float = key("of a later reward, for each tick", least=0.0, most=1.0)
    exploration: float = key("share of ticks with a choice at random", least=0.0, most=1.0)


@dataclass
class SarsaLambdaConfig(QLearningConfig):
    """See `snnrl.agents.agents.SarsaLambda`."""

    trace: float = key("decay of the eligibility trace (lambda)", least=0.0, most=1.0)


@dataclass
class ReinforceConfig:
    """See `snnrl.agents.agents.Reinforce`."""

    bins: int = key("into which a sensor's value is divided", least=1, most=100)
    rate: float = key("of learning", above=0.0)
    discount: float = key("of the credit of earlier choices, for each tick", least=0.0, most=1.0)
    shared: bool = key("whether all trials learn together, as one agent in many worlds", default=False)


@dataclass
class BaselinesConfig:
    """A comparison of agents: each task is what one would give to `snnrl.run`."""

    tasks: dict[str, list[str]] = key("what is given to `snnrl run` for each", default=dict)
    agents: list[str] = key("names of those that are compared")
    braitenberg: BraitenbergConfig = key("a vehicle with fixed wires", default=BraitenbergConfig)
    q_learning: QLearningConfig = key("a table of values", default=QLearningConfig)
    sarsa_lambda: SarsaLambdaConfig = key("a table of values with traces", default=SarsaLambdaConfig)
    reinforce: ReinforceConfig = key("a table of preferences", default=ReinforceConfig)
    trials: int | None = key("of each task; null for its own", "", None, least=1, most=10_000_000)
    seconds: float | None = key("simulated, of each trial; null for the task's own", "s", None, above=0.0, most=1e9)
    seed: int = key("of all random numbers, with the trial's number", "", 0, least=0, most=2**63 - 1)
    samples: int = key("points in time of each task's series", least=1, most=1_000_000)


def no_such_key(key: str, known: Iterable[str]) -> str:
    """What to say of a key that is not among those known."""
    return f"is now {MOVED[key]}" if key in MOVED else f"no such key; allowed here: {', '.join(known)}"


def bounds_of(config: Any, name: str) -> Mapping[str, Any]:
    """The bounds of a dataclass's field."""
    return next(item.metadata for item in dataclasses.fields(config) if item.name == name)


def allowed(bounds: Mapping[str, Any]) -> str:
    """What a field's bounds allow, in words; nothing where it has none."""
    if bounds.get("choices"):
        return f"one of {', '.join(bounds['choices'])}"
    return " and ".join(
        f"{text} {bounds[kind]:g}" for kind, (text, _) in LIMITS.items() if bounds.get(kind) is not None
    )


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
        raise ConfigError(name, value, f"must be {allowed(bounds)}")
    if isinstance(value, dict):
        raise ConfigError(name, value, "must be a single value")
    if isinstance(value, list) and not all(isinstance(part, bounds.get("of") or str) for part in value):
        raise ConfigError(name, value, f"must be a list of {'whole numbers' if bounds.get('of') is int else 'names'}")
    if value is None or isinstance(value, (str, list)):
        return
    if not all(holds(value, bounds[kind]) for kind, (_, holds) in LIMITS.items() if bounds.get(kind) is not None):
        raise ConfigError(name, value, f"must be {allowed(bounds)}")

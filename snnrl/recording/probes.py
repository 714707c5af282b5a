"""Probes: what is read of a simulation at every sample. One more is one function, and one entry in a list below."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from snnrl.body.robot import Robot
from snnrl.model.synapses import DOPAMINE, Projection, means
from snnrl.schema import FOOD
from snnrl.simulation import Simulation
from snnrl.tasks.task import Task

WEIGHT, ELIGIBILITY = "weight, mV", "eligibility, mV per uM ms"  # tags of the probes of those names


@dataclass(frozen=True)
class Moment:
    """A simulation at a sample.

    Attributes:
        simulation: as it is now.
        change: what `counts` gave, less what it gave at the sample before.
    """

    simulation: Simulation[Any]
    change: Mapping[str, Tensor]

    @property
    def ms(self) -> int:
        """Since the sample before."""
        return int(self.change["ms"])

    @property
    def world(self) -> Any:
        """Of a robot."""
        return self.simulation.situation.world


def any_network(simulation: Simulation[Any]) -> bool:
    return True


def is_robot(simulation: Simulation[Any]) -> bool:
    return isinstance(simulation.situation, Robot)


def robot_has_dopamine(simulation: Simulation[Any]) -> bool:
    return is_robot(simulation) and simulation.network.dopamine is not None


def is_task(simulation: Simulation[Any]) -> bool:
    return isinstance(simulation.situation, Task)


def task_has_dopamine(simulation: Simulation[Any]) -> bool:
    return is_task(simulation) and simulation.network.dopamine is not None


def has_coincidence(simulation: Simulation[Any]) -> bool:
    return is_task(simulation) and simulation.situation.coincidence is not None


def has_stimuli(simulation: Simulation[Any]) -> bool:
    return is_task(simulation) and simulation.situation.stimuli is not None


@dataclass(frozen=True)
class Probe:
    """What is read, and how it is told of.

    Attributes:
        name: of its array in series.npz, whose first dimension are the T samples.
        read: its values at a moment.
        dims: what these values are along, in order: trials, groups, projections with a role, stimuli, or x and y.
        unit: of these values.
        of: which simulations it applies to.
        between: whether they are of the time since the sample before, so that there are none at the start.
        tag: what loggers call their mean over trials; "" where it is not shown.
        parts: names of their last dimension, which follow the tag; None for one value a trial.
        spread: whether loggers are shown their quantiles over trials too.
        metric: whether they are what the run has come to so far, by which it is compared with others.
        series: whether every sample of them is kept.
        told: how a line of progress tells their mean; "" where it does not.
        note: what else is to be known of them.
    """

    name: str
    read: Callable[[Moment], Tensor]
    dims: tuple[str, ...]
    unit: str
    of: Callable[[Simulation[Any]], bool] = any_network
    between: bool = False
    tag: str = ""
    parts: Callable[[Simulation[Any]], list[str]] | None = None
    spread: bool = False
    metric: bool = False
    series: bool = True
    told: str = ""
    note: str = ""

    def tags(self, simulation: Simulation[Any]) -> list[str]:
        """One for each of the last dimension."""
        if self.parts is None:
            return [self.tag] if self.tag else []
        return [f"{self.tag}/{readable(part)}" for part in self.parts(simulation)]


def readable(name: str) -> str:
    """A name of the configuration as it is shown."""
    return name.replace("_", " ")


def counts(simulation: Simulation[Any]) -> dict[str, Tensor]:
    """What only ever grows: ms, spikes by group, the sum of dopamine's level over all ms, and a robot's food."""
    network, situation = simulation.network, simulation.situation
    found = {"ms": network.time, "spikes": network.spike_count}
    if isinstance(situation, Robot):
        found["food"] = situation.world.count(FOOD)
    if network.dopamine is not None:
        found["dopamine"] = network.dopamine.total
    return {key: values.cpu().clone() for key, values in found.items()}


def groups(simulation: Simulation[Any]) -> list[str]:
    return list(simulation.network.groups)


def followed(simulation: Simulation[Any]) -> list[Projection]:
    """The projections that have a role."""
    return [projection for projection in simulation.network.projections.values() if projection.role]


def names(simulation: Simulation[Any]) -> list[str]:
    return [projection.name for projection in followed(simulation)]


def time(moment: Moment) -> Tensor:
    return torch.tensor(moment.simulation.seconds)


def firing_rate(moment: Moment) -> Tensor:
    sizes = torch.tensor([group.size for group in moment.simulation.network.groups.values()])
    return moment.change["spikes"] / (sizes * (moment.ms / 1000.0))


def weight(moment: Moment) -> Tensor:
    return _of_each(moment, "weight")


def eligibility(moment: Moment) -> Tensor:
    return _of_each(moment, "eligibility")


def _of_each(moment: Moment, values: str) -> Tensor:
    projections = followed(moment.simulation)
    if not projections:
        return torch.zeros(moment.simulation.trials, 0)
    return means(projections, [getattr(projection, values) for projection in projections]).float().T


def mean_dopamine(moment: Moment) -> Tensor:
    return (moment.change["dopamine"] / moment.ms).float()


def food(simulation: Simulation[Any]) -> Tensor:
    """Items that each robot has taken since the start, int64 [B]."""
    return simulation.situation.world.count(FOOD)


def collection_rate(moment: Moment) -> Tensor:
    return moment.change["food"] / (moment.ms / 1000.0)


def position(moment: Moment) -> Tensor:
    return moment.world.position.float()


def heading(moment: Moment) -> Tensor:
    return moment.world.heading.float()


def nearest_item(moment: Moment) -> Tensor:
    return moment.world.nearest_item().float()


def rewards(moment: Moment) -> Tensor:
    return moment.simulation.situation.reward.given


def dopamine(moment: Moment) -> Tensor:
    return moment.simulation.network.modulators[DOPAMINE].level


def other_weights(simulation: Simulation[Any]) -> list[Tensor]:
    """Plastic weights of each trial but that of the synapse that a task watches, B tensors."""
    network, coincidence = simulation.network, simulation.situation.coincidence
    table = network.synapses
    use = torch.ones(table.plastic, dtype=torch.bool, device=network.device)
    if coincidence is not None and int(coincidence.synapse.max()) < table.plastic:
        use[coincidence.synapse] = False
    values, trial = table.weight[: table.plastic], table.trial[: table.plastic]
    return [values[use & (trial == k)] for k in range(network.trials)]


def mean_weight(moment: Moment) -> Tensor:
    return _of_others(moment, torch.mean)


def max_weight(moment: Moment) -> Tensor:
    return _of_others(moment, torch.amax)


def _of_others(moment: Moment, function: Callable[[Tensor], Tensor]) -> Tensor:
    found = other_weights(moment.simulation)
    return torch.stack([function(values) if len(values) else values.new_tensor(torch.nan) for values in found])


def chosen_weight(moment: Moment) -> Tensor:
    return moment.simulation.network.synapses.weight[moment.simulation.situation.coincidence.synapse]


def coincidences(moment: Moment) -> Tensor:
    return moment.simulation.situation.coincidence.count


def presented(moment: Moment) -> Tensor:
    return moment.simulation.situation.stimuli.presented


def response(moment: Moment) -> Tensor:
    return moment.simulation.situation.stimuli.response


EACH, BY_GROUP, BY_PROJECTION, BY_STIMULUS = (
    *(("trial",), ("trial", "group")),
    *(("trial", "projection"), ("trial", "stimulus")),
)
ZEROS, SUM = "absent synapses as zeros", "sum since the start"

PROBES = (
    Probe("time", time, (), "s"),
    Probe(
        "collection_rate",
        collection_rate,
        EACH,
        "items/s",
        of=is_robot,
        between=True,
        tag="behaviour/collection rate, items per s",
        spread=True,
        told="{:.2f} food/s",
    ),
    Probe("firing_rate", firing_rate, BY_GROUP, "Hz", between=True, tag="firing rate, Hz", parts=groups),
    Probe("weight", weight, BY_PROJECTION, "mV", of=is_robot, tag=WEIGHT, parts=names, note=ZEROS),
    Probe(
        "eligibility",
        eligibility,
        BY_PROJECTION,
        "mV/(uM ms)",
        of=is_robot,
        tag=ELIGIBILITY,
        parts=names,
        note=ZEROS,
    ),
    Probe("position", position, ("trial", "axis"), "cm", of=is_robot),
    Probe("heading", heading, EACH, "rad", of=is_robot),
    Probe("nearest_item", nearest_item, EACH, "cm", of=is_robot, note="distance from the robot"),
    Probe("dopamine", mean_dopamine, EACH, "uM", of=robot_has_dopamine, between=True, tag="dopamine/mean level, uM"),
    Probe(
        "food",
        lambda moment: food(moment.simulation),
        EACH,
        "items",
        of=is_robot,
        tag="behaviour/food, items",
        metric=True,
        series=False,
    ),
    Probe("rewards", rewards, EACH, "", of=is_task, tag="task/rewards", metric=True, told="{:.1f} rewards", note=SUM),
    Probe("dopamine", dopamine, EACH, "uM", of=task_has_dopamine, tag="task/dopamine, uM"),
    Probe(
        "mean_weight",
        mean_weight,
        EACH,
        "mV",
        of=is_task,
        tag="task/mean weight, mV",
        spread=True,
        metric=True,
        note="plastic, not watched",
    ),
    Probe(
        "chosen_weight",
        chosen_weight,
        EACH,
        "mV",
        of=has_coincidence,
        tag="task/weight of the watched synapse, mV",
        spread=True,
        metric=True,
        note="watched",
    ),
    Probe(
        "max_weight",
        max_weight,
        EACH,
        "mV",
        of=has_coincidence,
        tag="task/largest weight of the others, mV",
        note="not watched",
    ),
    Probe("coincidences", coincidences, EACH, "", of=has_coincidence, tag="task/coincidences", note=SUM),
    Probe("presented", presented, BY_STIMULUS, "", of=has_stimuli, note=SUM),
    Probe("response", response, BY_STIMULUS, "spikes", of=has_stimuli, note=SUM),
)


def probes_of(simulation: Simulation[Any]) -> list[Probe]:
    """Those that apply to a simulation."""
    return [probe for probe in PROBES if probe.of(simulation)]

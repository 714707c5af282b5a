"""The box that the calibration searches: free values, where they may lie, and points that came near elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from snnrl.configuration.compose import compose
from snnrl.schema import Config


@dataclass(frozen=True)
class Free:
    """A free parameter: where it is searched, and how far the sensitivity moves it; wide ranges by their logarithm."""

    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Choice:
    """A free choice."""

    values: tuple[Any, ...]


OWN_MEAN = "network.homeostasis.per_set.container_dopamine.count_absent"  # None: as that of the other sets
FREE: Mapping[str, Free | Choice] = {
    "coding.range_gain": Free(1.0, 3.5, 0.2),
    "coding.touch_gain": Free(2.0, 6.0, 0.5),
    "coding.exploration_gain": Free(0.9, 2.2, 0.2),
    "coding.exploration_drawn": Choice(("each_ms", "each_tick")),
    "coding.gain_acts_on": Choice(("counts", "mean")),
    "network.synaptic_gain": Free(0.9, 9.0, 0.4),
    "network.dopamine.tau": Free(6.0, 40.0, 3.0),
    "network.groups.inhibitory.current": Choice((0.0, 4.5)),  # silent below 3.85
    "network.groups.dopaminergic.noise": Free(0.0, 0.29, 0.1),
    "network.groups.dopaminergic.kick_rate": Free(0.0, 0.45, 0.2),
    "network.plasticity.simultaneous": Choice(("potentiates", "depresses")),
    "network.plasticity.potentiation_from": Choice(("departure", "arrival")),
    "network.homeostasis.count_absent": Choice((True, False)),
    OWN_MEAN: Choice((None, False)),
    "world.ranges.food.measured_to": Choice(("border", "centre")),
    "world.ranges.container.measured_to": Choice(("border", "centre")),
    "world.kinds.food_container.avoids": Choice(("[]", "[robot]", "[robot,containers]")),
    "world.kinds.food_container.contains": Choice(("centre", "whole")),
    "world.overlap": Choice(("stays", "nearest")),
}
KICK = {"network.groups.dopaminergic.kick": 25.0}  # fires a neuron that rests
ARRIVAL = ("network.plasticity.potentiation_from", "arrival")
# What has come near in other searches, over the values in conf/.
STARTS: tuple[Mapping[str, Any], ...] = (
    {},
    {
        "network.plasticity.simultaneous": "potentiates",
        "network.synaptic_gain": 2.8,
        "network.dopamine.tau": 28.0,
        "coding.exploration_gain": 1.0,
        "coding.range_gain": 2.0,
        "coding.touch_gain": 4.0,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.6,
        "network.dopamine.tau": 15.0,
        "coding.exploration_gain": 1.45,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.6,
        "network.dopamine.tau": 18.0,
        "coding.exploration_gain": 1.66,
        "coding.range_gain": 2.07,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.4,
        "network.dopamine.tau": 20.0,
        "coding.exploration_gain": 1.3,
        "coding.range_gain": 1.53,
        "coding.touch_gain": 4.67,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 3.2,
        "network.dopamine.tau": 12.0,
        "coding.exploration_gain": 1.2,
        "coding.range_gain": 1.6,
        "coding.touch_gain": 4.17,
    },
    {
        "network.plasticity.simultaneous": "depresses",
        "network.homeostasis.count_absent": True,
        "network.synaptic_gain": 2.8,
        "network.dopamine.tau": 15.0,
        "coding.exploration_gain": 1.3,
        "coding.range_gain": 3.0,
        "coding.touch_gain": 4.17,
    },
    {
        "network.synaptic_gain": 1.75,
        "network.dopamine.tau": 8.0,
        "coding.range_gain": 1.75,
        "coding.touch_gain": 3.0,
    },
    {
        "network.synaptic_gain": 1.0,
        "network.dopamine.tau": 6.0,
        "network.groups.dopaminergic.noise": 0.0,
        "network.groups.dopaminergic.kick_rate": 0.4,
        "coding.touch_gain": 3.0,
    },
)


def value_of(config: Any, name: str) -> Any:
    """The value of a key of a configuration; None where it has no such key."""
    found = config
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else getattr(found, key, None)
    return found


def has(config: Config, name: str) -> bool:
    """Whether a free value has a place in a configuration."""
    if name == OWN_MEAN:
        return "container_dopamine" in (value_of(config, "network.homeostasis.sets") or {})
    return value_of(config, name) is not None


def present() -> dict[str, Any]:
    """The free parameters as they are in conf/."""
    config = compose("+experiment=dual_learning")
    found = {name: value_of(config, name) for name in FREE}
    return {name: f"[{','.join(value)}]" if isinstance(value, list) else value for name, value in found.items()}


def options_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Free values as overrides; what counts from a spike's arrival depresses in the ms of its departure."""
    found = {**KICK, **values} if values.get("network.groups.dopaminergic.kick_rate") else dict(values)
    if found.get(OWN_MEAN, 0) is None:
        del found[OWN_MEAN]
    if found.get(ARRIVAL[0]) == ARRIVAL[1]:
        found["network.plasticity.simultaneous"] = "depresses"
    return found

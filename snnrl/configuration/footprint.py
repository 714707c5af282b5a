"""How much memory a description takes, before any of it is taken."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping

from snnrl.configuration.parts import modulator_key, modulators
from snnrl.errors import ConfigError
from snnrl.model.draws import BELL_DRAWS
from snnrl.schema import Config, NetworkConfig, ProjectionConfig

# Bytes, measured as the growth of the process and rounded up; tests/test_fuzzer.py holds them against it.
PAIR = 200  # of a projection's neurons, while the projection is drawn
SYNAPSE = 160  # for good, with what the fused engine keeps beside it
NEURON = 260
OBJECT = 600  # of the world, while places are drawn
CURRENT = 60  # a neuron and ms of what drives the reference engine for a tick
VALUE = 8
WINDOW = 2400  # a ms of an STDP window's time constant, which the fused engine tabulates


def available() -> int:
    """Bytes of memory that this machine has; where it does not say, 8 GiB."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 8 << 30


def check(parts: Mapping[str, float]) -> None:
    """Raises ConfigError, naming the largest part, if the parts (bytes by key) exceed what is available."""
    total, limit = math.fsum(parts.values()), available()
    if total > limit:
        key = max(parts, key=lambda name: parts[name])
        size = f"{total / 2**30:.3g} GiB of memory in all"
        raise ConfigError(
            key, f"{parts[key] / 2**30:.3g} GiB", f"needs {size}, must be at most {limit / 2**30:.3g} GiB"
        )


def _joined(config: NetworkConfig, projection: ProjectionConfig) -> float:
    """The part of a projection's pairs that have a synapse."""
    kind = config.synapses[projection.synapse]
    if kind.fan_out is not None:
        return kind.fan_out / config.groups[projection.post].size
    assert kind.probability is not None
    return kind.probability


def of_network(config: NetworkConfig, trials: int) -> dict[str, float]:
    """Estimated bytes by key."""
    groups = config.groups
    pairs = {
        name: float(trials) * groups[item.pre].size * groups[item.post].size
        for name, item in config.projections.items()
    }
    parts = {
        f"network.projections.{name}": pairs[name] * SYNAPSE * _joined(config, item)
        for name, item in config.projections.items()
    }
    if pairs:
        largest = max(pairs, key=lambda name: pairs[name])
        parts[f"network.projections.{largest}"] += pairs[largest] * PAIR
    slots = max((config.synapses[item.synapse].delay for item in config.projections.values()), default=1)
    for name, group in groups.items():
        parts[f"network.groups.{name}.size"] = float(trials) * group.size * (NEURON + slots * VALUE)
    for name, modulator in modulators(config).items():
        sources = 1 if modulator.source is not None else len(modulator.sources)
        parts[f"{modulator_key(name)}.delay"] = float(trials) * sources * modulator.delay * VALUE
    for key in ("tau_plus", "tau_minus"):
        parts[f"network.plasticity.{key}"] = WINDOW * getattr(config.plasticity, key)
    return parts


def of_run(config: Config) -> dict[str, float]:
    """Estimated bytes by key: the network, the world, a tick's currents and what is recorded."""
    network, trials = config.network, config.trials
    drawn = sum(group.size * (1 + BELL_DRAWS * bool(group.gaussian)) for group in network.groups.values())
    followed = sum(bool(projection.role) for projection in network.projections.values())
    tick = config.coding.tick if config.coding is not None else config.task.tick if config.task is not None else 1
    samples = config.seconds / max(min(config.record.every, config.seconds), tick / 1000.0)
    parts = {
        **of_network(network, trials),
        "record.every": samples * trials * VALUE * (6 + len(network.groups) + 2 * followed),
    }
    if config.engine == "reference" or config.task is not None:
        parts["task.tick" if config.task is not None else "coding.tick"] = float(trials) * tick * drawn * CURRENT
    if config.world is not None:
        tried = config.world.attempts if any(kind.avoids for kind in config.world.kinds.values()) else 1
        for name, kind in config.world.kinds.items():
            parts[f"world.kinds.{name}.count"] = float(trials) * kind.count * OBJECT * (tried + bool(kind.holds))
    return parts

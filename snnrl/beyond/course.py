"""What agents with and without neurons touch in the same world as time goes on, counted in spans of equal length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view

from snnrl.agents.baselines import agent_robot
from snnrl.body.world import World
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import make_engine
from snnrl.intervals import student
from snnrl.model.network import Network
from snnrl.model.synapses import Projection
from snnrl.schema import BaselinesConfig, Config


@dataclass(frozen=True)
class Course:
    """Touches of one agent in one world.

    Attributes:
        agent: a robot of the experiment, or an agent without neurons.
        every: length of a span, s.
        touches: int64 [T, B], by kind: how often each trial touched one in each span.
        signs: [T], by kind: what that was worth.
        weights: [B], mV, by role: the mean weight of the synapses with that role at the end; none of agents without.
    """

    agent: str
    every: float
    touches: dict[str, np.ndarray]
    signs: dict[str, np.ndarray]
    weights: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def time(self) -> np.ndarray:
        """Of the ends of the spans, [T], s."""
        return self.every * np.arange(1, len(next(iter(self.signs.values()))) + 1)

    def rate(self, *kinds: str) -> np.ndarray:
        """Reward from some kinds of items, each by its sign at the time, [T, B], 1/s."""
        return np.asarray(sum(self.signs[kind][:, None] * self.touches[kind] for kind in kinds) / self.every)


def follow(agent: str, every: float, options: BaselinesConfig, *overrides: str) -> Course:
    """Run a robot, or the agent without neurons of that name, and count what it touches every so many s.

    A touch belongs to the span in which its tick begins. `options` are those of agents without neurons, `overrides`
    those of the configuration.
    """
    config = compose(*overrides)
    network: Network | None = None
    if agent in config.experiment.robots:
        world, advance, network = _spiking(compose(*overrides, f"robot={agent}"))
    else:
        world, advance = agent_robot(config, agent, options)
    tick = config.body()[0].tick  # ms
    spans = range(round(config.seconds / every) + 1)
    marks = [-(-round(1000 * every * k) // tick) for k in spans]
    counts, values = [world.touches.numpy().copy()], []
    for first, last in pairwise(marks):
        values.append(world.value(torch.tensor(first * tick)).numpy())
        advance(last - first)
        counts.append(world.touches.numpy().copy())
    touches, signs = np.diff(np.array(counts), axis=0), np.array(values)
    names = world.kinds.names
    return Course(
        agent,
        every,
        {kind: touches[..., k] for k, kind in enumerate(names)},
        {kind: signs[:, k] for k, kind in enumerate(names)},
        {} if network is None else _weights(network),
    )


def _spiking(config: Config) -> tuple[World, Callable[[int], None], Network]:
    """The world of a robot, what runs it for so many ticks, and its network."""
    simulation = build(config)
    engine = make_engine(config.engine, config.device, config.threads)
    return simulation.situation.world, lambda ticks: simulation.run(engine, ticks), simulation.network


def _weights(network: Network) -> dict[str, np.ndarray]:
    found: dict[str, list[Projection]] = {}
    for projection in network.projections.values():
        found.setdefault(projection.role, []).append(projection)
    weights = {}
    for role, projections in found.items():
        trial, weight = (torch.cat([getattr(p, key) for p in projections]) for key in ("trial", "weight"))
        total = torch.bincount(trial, weight.double(), network.trials)
        weights[role] = (total / torch.bincount(trial, minlength=network.trials)).numpy()
    return weights


def first_time(rate: np.ndarray, every: float, window: int, wanted: float) -> np.ndarray:
    """When the mean over a window has first been what is wanted; s from the start, [...], nan where never.

    Args:
        rate: [..., T], in spans of `every` s.
        window: spans.
    """
    there = sliding_window_view(rate, window, axis=-1).mean(-1) >= wanted
    return np.where(there.any(-1), every * (there.argmax(-1) + window), np.nan)


def interval(values: np.ndarray, digits: int) -> str:
    """The mean of an array [B] over trials and its interval, as a cell of a table."""
    low, high = student(values)
    return f"{values.mean():.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"

"""Scalar float64 oracles of the model, one object at a time; equations as in the thesis, no torch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


def izhikevich(
    currents: Sequence[float], a: float, b: float, c: float, d: float, v: float = -65.0
) -> tuple[list[int], list[float]]:
    """Spike times (ms) and the membrane potential after every ms of one neuron that starts at u = b v.

    Every spike multiplies a rounding error by about ten, so the sum is taken in the package's order.
    """
    u, spikes, trace = b * v, [], []
    for t, current in enumerate(currents):
        for _ in range(2):
            v += 0.5 * (0.04 * v * v + 5.0 * v + 140.0 - u + current)
        u += a * (b * v - u)
        if v >= 30:
            spikes.append(t)
            v = c
            u += d
        trace.append(v)
    return spikes, trace


@dataclass
class Synapse:
    """One plastic synapse; the defaults are the thesis's."""

    weight: float
    potentiation: float = 0.1
    depression: float = 0.15
    tau_plus: float = 20.0
    tau_minus: float = 110.0
    tau_eligibility: float = 476.0
    weight_max: float = 4.0
    depresses: bool = False  # what two spikes of one ms do
    travel: int = 0  # ms until a presynaptic spike arrives, from where on it potentiates
    eligibility: float = 0.0
    last_pre: int | None = None
    last_post: int | None = None

    def step(self, t: int, pre: bool, post: bool, dopamine: float) -> None:
        self.eligibility *= math.exp(-1 / self.tau_eligibility)
        earlier = self.last_pre
        if pre:
            self.last_pre = t
        if post:
            partner = earlier if self.depresses else self.last_pre
            if partner is not None and partner + self.travel <= t:
                self.eligibility += self.potentiation * math.exp((partner + self.travel - t) / self.tau_plus)
            self.last_post = t
        if pre and (self.depresses or not post) and self.last_post is not None:
            self.eligibility -= self.depression * math.exp((self.last_post - t) / self.tau_minus)
        self.weight = min(max(self.weight + self.eligibility * dopamine, 0.0), self.weight_max)


def synapse(
    pre: Sequence[int], post: Sequence[int], dopamine: Sequence[float], weight: float, **rule: Any
) -> tuple[list[float], list[float]]:
    """Eligibility and weight after every ms, from both neurons' spike times and the dopamine of every ms."""
    one, eligibilities, weights = Synapse(weight, **rule), [], []
    for t, level in enumerate(dopamine):
        one.step(t, t in pre, t in post, level)
        eligibilities.append(one.eligibility)
        weights.append(one.weight)
    return eligibilities, weights


def dopamine(
    spikes: Sequence[int],
    baseline: float = -0.0004,
    tau: float = 25.0,
    release: float = 0.0035,
    delay: int = 5,
    threshold: int = 5,
    signs: Sequence[float] | None = None,
) -> list[float]:
    """Level (uM) after every ms, from how many dopaminergic neurons fired in it."""
    level, levels = baseline, []
    for t in range(len(spikes)):
        level = baseline + (level - baseline) * math.exp(-1 / tau)
        burst = spikes[t - delay] if t >= delay else 0
        if burst > threshold:
            level += (1.0 if signs is None else signs[t]) * release * burst
        levels.append(level)
    return levels


def dampen(synapses: Sequence[Synapse], pairs: int, limit: float, step: float) -> bool:
    """One ms of homeostasis of a set whose mean is over `pairs`; whether it had to act."""
    over = math.fsum(one.weight for one in synapses) / pairs > limit
    if over:
        for one in synapses:
            one.weight = max(one.weight - step, 0.0)
    return over

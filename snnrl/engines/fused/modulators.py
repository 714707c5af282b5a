"""Step 3 of `Network.step`: the modulators."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.layout import (
    BASELINE,
    DECAY,
    DELAYED,
    FADING,
    FURTHER,
    RELEASED,
    REWARD,
    RING,
    SIGNED,
    SMOOTHED,
    SOURCES,
    SOURCES_END,
    Functions,
)
from snnrl.model.modulators import mean_rate, relax


@placeholder
def release(which, rate, first, values, at):
    """What a modulator's sources release (uM), from `rate` from `first` and further arguments from `at` on."""


def fill_modulators(t, s, w, trial):
    """Lay out the modulators of a trial."""
    for m in range(t.modulators.shape[0]):
        w.level[m], w.total[m] = s.level[m][trial], s.total[m][trial]
        first, delay = t.modulators[m, SOURCES], t.modulators[m, DELAYED]
        for k in range(t.modulators[m, SOURCES_END] - first):
            w.rate[first + k] = s.rate[m][trial, k]
            for slot in range(delay):
                w.released[t.modulators[m, RING] + k * delay + slot] = s.released[m][trial, k, slot]


def empty_modulators(t, s, w, trial):
    """Put the modulators of a trial back where they were."""
    for m in range(t.modulators.shape[0]):
        s.level[m][trial], s.total[m][trial] = w.level[m], w.total[m]
        first, delay = t.modulators[m, SOURCES], t.modulators[m, DELAYED]
        for k in range(t.modulators[m, SOURCES_END] - first):
            s.rate[m][trial, k] = w.rate[first + k]
            for slot in range(delay):
                s.released[m][trial, k, slot] = w.released[t.modulators[m, RING] + k * delay + slot]


def spikes_of(w, g):
    """How many of a group fired in this ms, if any neuron did."""
    return w.first[g + 1] - w.first[g]


def step_modulators(t, w, now, found, sign, reward):
    """One ms of every modulator; `sign` and `reward` as in `Modulator.step`, of the trial."""
    for m in range(t.modulators.shape[0]):
        step_modulator(t, w, m, now, sign, reward)
        note_spikes(t, w, m, now, found)


def step_modulator(t, w, m, now, sign, reward):
    """The level, by the spikes that arrive in this ms."""
    level = relax(w.level[m], t.modulator_values[m, BASELINE], t.modulator_values[m, DECAY])
    first, last = t.modulators[m, SOURCES], t.modulators[m, SOURCES_END]
    if last > first:
        slot = ring_slot(t, m, now)
        for k in range(first, last):
            before = w.rate[k]
            w.rate[k] = w.released[slot]  # as a real number
            if t.modulators[m, SMOOTHED]:
                w.rate[k] = mean_rate(before, w.rate[k], t.modulator_values[m, FADING])
            slot += t.modulators[m, DELAYED]
        amount = release(t.modulators[m, RELEASED], w.rate, first, t.further, t.modulators[m, FURTHER])
        level += sign * amount if t.modulators[m, SIGNED] else amount
    level += t.modulator_values[m, REWARD] * reward
    w.level[m] = level
    w.total[m] += level


def note_spikes(t, w, m, now, found):
    """This ms's spikes will have arrived once the delay is over; they take the place of those that have."""
    slot = ring_slot(t, m, now)
    for k in range(t.modulators[m, SOURCES], t.modulators[m, SOURCES_END]):
        w.released[slot] = spikes_of(w, t.sources[k]) if found else 0
        slot += t.modulators[m, DELAYED]


def ring_slot(t, m, now):
    """Where in `released` this ms of a modulator's first source is."""
    delay = t.modulators[m, DELAYED]
    return t.modulators[m, RING] + (now % delay if delay > 1 else 0)


def signal_of(t, w, signal):
    """The sum of modulators that a synapse listens to."""
    level = t.signals[signal, 0] * w.level[0]
    for m in range(1, t.signals.shape[1]):
        if t.signals[signal, m] != 0.0:
            level += t.signals[signal, m] * w.level[m]
    return level


def releasing(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `release` and the names in it stand for in a network whose modulators are released so."""
    lines, names = [], {}
    for k, (function, sources, further) in enumerate(functions.releases):
        names[f"release_{k}"] = function
        given = [f"rate[first + {i}]" for i in range(sources)] + [f"values[at + {i}]" for i in range(further)]
        lines += [f"    if which == {k}:", f"        return release_{k}({', '.join(given)})"]
    body = "\n".join([*lines, "    return rate[first]"])
    return {"release": spelled("release", "which, rate, first, values, at", body, {}), **names}

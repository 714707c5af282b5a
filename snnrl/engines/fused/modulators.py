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
    SIGNED,
    SMOOTHED,
    SOURCES,
    SOURCES_END,
    Functions,
)
from snnrl.model.modulators import mean_rate, relax


@placeholder
def release(which, rate, trial, values, at):
    """What a modulator's sources release (uM), from `rate` [B, K] and further arguments from `at` on."""


def step_modulators(t, s, w, trial, now, found, sign, reward):
    """One ms of every modulator of a trial; `sign` and `reward` as in `Modulator.step`, of the trial."""
    for m in range(t.modulators.shape[0]):
        level = relax(s.level[m][trial], t.modulator_values[m, BASELINE], t.modulator_values[m, DECAY])
        first, last = t.modulators[m, SOURCES], t.modulators[m, SOURCES_END]
        if last > first:
            slot = now % t.modulators[m, DELAYED]
            for k in range(last - first):
                g = t.sources[first + k]
                spikes = w.first[g + 1] - w.first[g] if found else 0
                rate = s.rate[m][trial, k]
                s.rate[m][trial, k] = s.released[m][trial, k, slot]  # as a real number
                s.released[m][trial, k, slot] = spikes
                if t.modulators[m, SMOOTHED]:
                    s.rate[m][trial, k] = mean_rate(rate, s.rate[m][trial, k], t.modulator_values[m, FADING])
            amount = release(t.modulators[m, RELEASED], s.rate[m], trial, t.further, t.modulators[m, FURTHER])
            level += sign * amount if t.modulators[m, SIGNED] else amount
        level += t.modulator_values[m, REWARD] * reward
        s.level[m][trial] = level
        s.total[m][trial] += level


def releasing(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `release` and the names in it stand for in a network whose modulators are released so."""
    lines, names = [], {}
    for k, (function, sources, further) in enumerate(functions.releases):
        names[f"release_{k}"] = function
        given = [f"rate[trial, {i}]" for i in range(sources)] + [f"values[at + {i}]" for i in range(further)]
        lines += [f"    if which == {k}:", f"        return release_{k}({', '.join(given)})"]
    body = "\n".join([*lines, "    return rate[trial, 0]"])
    return {"release": spelled("release", "which, rate, trial, values, at", body, {}), **names}

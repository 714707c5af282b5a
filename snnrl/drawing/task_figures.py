"""Figures of tasks, drawn from their series (see `snnrl.recording.probes`)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from snnrl.drawing import charts, style
from snnrl.drawing.palette import OTHER, PALE, PUBLISHED, REWARDED
from snnrl.drawing.style import above, figure, legend, styled
from snnrl.tasks.responses import Series, mean_response, quarters


@styled
def draw_reinforcement(series: Series) -> Figure:
    """The watched synapse of the first trial against all others: weights over time, and their distribution.

    Also draws the watched synapses of the other trials, thin.
    """
    drawn, (left, right) = figure(1, 2, width=9.6, height=3.8)
    time, chosen = series["time"], series["chosen_weight"]
    left.plot(time, series["max_weight"][:, 0], color=PALE, label="largest other")
    for weight in chosen[:, 1:].T:
        left.plot(time, weight, color=REWARDED, alpha=0.3, linewidth=0.9, label="reinforced synapse, other trials")
    left.plot(time, chosen[:, 0], color=REWARDED, linewidth=2, label="reinforced synapse")
    left.plot(time, series["mean_weight"][:, 0], color=OTHER, linewidth=2, label="mean of the others")
    given = np.diff(series["rewards"][:, 0], prepend=0) > 0
    charts.rewards(left, time, given, "reward", color=REWARDED, alpha=0.15)
    left.set(xlabel=style.TIME, ylabel=style.WEIGHT, ylim=(0, None))
    legend(left, **above(2))
    edges, count = series["edges"], series["histogram"][0]
    right.stairs(count, edges, fill=True, color=OTHER, alpha=0.8, label=f"{count.sum():,} other synapses")
    right.axvline(chosen[-1, 0], color=REWARDED, linewidth=2, label="reinforced synapse")
    right.set_yscale("log")
    right.set_ylim(bottom=0.7)
    right.set(xlabel=f"Weight after {time[-1]:,.0f} s (mV)", ylabel="Count (synapses)")
    legend(right, **above(2))
    return drawn


@styled
def draw_conditioning(series: Series, rewarded: int, window: int) -> Figure:
    """Responses of the first trial: to every stimulus before and after learning, and over time."""
    drawn, (left, right) = figure(1, 2, width=9.6, height=3.8)
    others = np.arange(series["presented"].shape[2]) != rewarded
    first, last = (response[0] for response in quarters(series))
    left.scatter(first[others], last[others], s=16, color=OTHER, alpha=0.7, label="never rewarded")
    left.scatter(first[rewarded], last[rewarded], s=70, color=REWARDED, label="followed by reward", zorder=3)
    top = 1.08 * np.nanmax(np.concatenate([first, last, [1.0]]))
    left.plot([0, top], [0, top], color=PUBLISHED, linewidth=0.8, linestyle="--", label="unchanged")
    response = f"(spikes in {window} ms)"
    left.set(xlim=(0, top), ylim=(0, top), xlabel=f"Response, first quarter {response}")
    left.set(ylabel=f"Response, last quarter {response}")
    legend(left, **above(3))
    edges = np.unique(np.linspace(0, len(series["time"]) - 1, 25).astype(int))
    spans = list(pairwise(edges))
    middle = np.array([0.5 * (series["time"][low] + series["time"][high]) for low, high in spans])
    over_time = np.array([mean_response(series, low, high)[0] for low, high in spans])
    shown = ~np.isnan(over_time[:, rewarded])
    with np.errstate(all="ignore"):
        right.plot(middle, np.nanmax(over_time[:, others], 1), color=PALE, label="strongest other")
    right.plot(middle[shown], over_time[shown, rewarded], "o-", ms=4, color=REWARDED, label="followed by reward")
    right.plot(middle, np.nanmean(over_time[:, others], 1), color=OTHER, linewidth=2, label="mean of the others")
    right.set(xlabel=style.TIME, ylabel=f"Response {response}", ylim=(0, None))
    legend(right, **above(3))
    return drawn

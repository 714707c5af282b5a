"""Figures of tasks, drawn from their series (see `snnrl.recording.probes`) as PNG files in memory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snnrl.drawing.style import png
from snnrl.tasks.responses import Series, mean_response, quarters

CHOSEN, REST, EXTREME = "#c0392b", "#34495e", "#95a5a6"


def draw_reinforcement(series: Series) -> bytes:
    """The watched synapse of the first trial against all others: weights over time, and their distribution.

    Also draws the watched synapses of the other trials, thin.
    """
    figure, (left, right) = _panels()
    time = series["time"]
    left.plot(time, series["max_weight"][:, 0], color=EXTREME, label="largest other")
    for k, weight in enumerate(series["chosen_weight"][:, 1:].T):
        left.plot(time, weight, color=CHOSEN, alpha=0.3, linewidth=0.9, label=None if k else "that of other trials")
    left.plot(time, series["chosen_weight"][:, 0], color=CHOSEN, linewidth=2, label="reinforced synapse")
    left.plot(time, series["mean_weight"][:, 0], color=REST, linewidth=2, label="mean of the others")
    earned = np.diff(series["rewards"][:, 0]) > 0
    left.plot(time[1:][earned], np.full(earned.sum(), -0.12), "|", color=CHOSEN, markersize=5, label="reward")
    left.set(xlabel="time, s", ylabel="weight, mV", title="A synapse whose spikes are rewarded seconds later")
    left.legend(loc="center right", frameon=False)
    edges, count = series["edges"], series["histogram"][0]
    right.stairs(count, edges, fill=True, color=REST, alpha=0.8, label=f"{count.sum():,} other synapses")
    right.axvline(series["chosen_weight"][-1, 0], color=CHOSEN, linewidth=2, label="reinforced synapse")
    right.set_yscale("log")
    right.set_ylim(bottom=0.7)
    right.set(xlabel="weight, mV", ylabel="synapses", title=f"At the end, after {time[-1]:,.0f} s")
    right.legend(loc="upper center", frameon=False)
    return png(figure)


def draw_conditioning(series: Series, rewarded: int, window: int) -> bytes:
    """Responses of the first trial: to every stimulus before and after learning, and over time."""
    figure, (left, right) = _panels()
    others = np.arange(series["presented"].shape[2]) != rewarded
    first, last = (response[0] for response in quarters(series))
    left.scatter(first[others], last[others], s=16, color=REST, alpha=0.7, label="never rewarded")
    left.scatter(first[rewarded], last[rewarded], s=70, color=CHOSEN, label="followed by reward", zorder=3)
    top = 1.08 * np.nanmax(np.concatenate([first, last, [1.0]]))
    left.plot([0, top], [0, top], color=EXTREME, linewidth=0.8, linestyle="--")
    left.set(xlim=(0, top), ylim=(0, top), title="Response to each of the stimuli")
    left.set(xlabel=f"first quarter, spikes in {window} ms", ylabel=f"last quarter, spikes in {window} ms")
    left.legend(loc="lower right", frameon=False)
    edges = np.unique(np.linspace(0, len(series["time"]) - 1, 25).astype(int))
    spans = list(pairwise(edges))
    middle = [0.5 * (series["time"][low] + series["time"][high]) for low, high in spans]
    over_time = np.array([mean_response(series, low, high)[0] for low, high in spans])
    shown = ~np.isnan(over_time[:, rewarded])
    with np.errstate(all="ignore"):
        right.plot(middle, np.nanmax(over_time[:, others], 1), color=EXTREME, label="strongest other")
    right.plot(
        np.array(middle)[shown], over_time[shown, rewarded], "o-", ms=4, color=CHOSEN, label="followed by reward"
    )
    right.plot(middle, np.nanmean(over_time[:, others], 1), color=REST, linewidth=2, label="mean of the others")
    right.set(xlabel="time, s", ylabel=f"spikes in {window} ms", title="Over time", ylim=(0, None))
    right.legend(loc="upper left", frameon=False)
    return png(figure)


def _panels() -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(11, 4.2), dpi=130, layout="constrained")
    axes = list(figure.subplots(1, 2))
    for one in axes:
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes

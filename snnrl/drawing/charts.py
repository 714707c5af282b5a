"""The kinds of chart that notebooks, the report, replays and TensorBoard share, of arrays on given axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from snnrl.drawing import style
from snnrl.drawing.palette import CYCLE, FOOD, GROUPS, INK, NO_SYNAPSE
from snnrl.drawing.style import band, spoken


def learning_curve(axis: Axes, time: np.ndarray, rate: np.ndarray, colour: str, label: str) -> None:
    """Items per s, [T, B], as a band."""
    band(axis, time, rate, colour, label)
    axis.set(xlabel=style.TIME, ylabel=style.RATE, xlim=(0, time[-1]), ylim=(0, None))


def courses(axis: Axes, time: np.ndarray, values: Mapping[str, np.ndarray], label: str, **styles: Any) -> None:
    """A line for each part, by its name: [T] of one trial, or a band of [T, B], from where all are known.

    Args:
        styles: of a name, what its line has in place of the next colour.
    """
    for k, (name, part) in enumerate(values.items()):
        options = {"color": CYCLE[k % len(CYCLE)], **styles.get(name, {})}
        part = part[:, None] if part.ndim == 1 else part
        known = np.isfinite(part).all(1)
        band(axis, time[known], part[known], options.pop("color"), options.pop("label", spoken(name)), **options)
    axis.set(xlabel=style.TIME, ylabel=label, xlim=(time[0], time[-1]))


def rewards(axis: Axes, time: np.ndarray, taken: np.ndarray, label: str = "food", **options: Any) -> None:
    """When a trial was rewarded, from edge to edge: between the sample that tells of it and the one before.

    Args:
        taken: bool [T], whether there was a reward since the sample before.
    """
    edges = np.concatenate([[max(0.0, 2 * time[0] - time[1])], time])
    spans = [(edges[k], edges[k + 1] - edges[k]) for k in np.flatnonzero(taken)]
    look = {"color": FOOD, "alpha": 0.6, "linewidth": 0.8, "zorder": 0, **options}
    if spans:
        axis.broken_barh(spans, (0, 1), transform=axis.get_xaxis_transform(), label=label, **look)


def raster(axis: Axes, time: np.ndarray, neuron: np.ndarray, groups: Mapping[str, slice] | None = None) -> None:
    """Spikes, at the times (s) [n] of neurons [n]; each group, if there are any, in a colour and with its name."""
    if groups is None:
        axis.plot(time, neuron, "|", color=INK, markersize=4, label="spike")
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set(xlabel=style.TIME, ylabel="Neuron")
        return
    for k, span in enumerate(groups.values()):
        of = (neuron >= span.start) & (neuron < span.stop)
        axis.plot(time[of], neuron[of], "|", color=GROUPS[k % len(GROUPS)], markersize=2.0, markeredgewidth=0.6)
        axis.axhline(span.start - 0.5, color="#cccccc", linewidth=0.6)
    names = [f"{spoken(name)} ({span.stop - span.start})" for name, span in groups.items()]
    axis.set_yticks([(span.start + span.stop - 1) / 2 for span in groups.values()], names)
    axis.set(xlabel=style.TIME, ylabel="Group (neurons)", ylim=(max(s.stop for s in groups.values()) - 0.5, -0.5))
    axis.tick_params(axis="y", length=0)
    axis.grid(False)


def weight_matrix(
    axis: Axes, matrix: np.ndarray, pre: Mapping[str, int], post: Mapping[str, int], most: float | None = None
) -> None:
    """Every weight (mV), [post, pre], nan where there is no synapse, with the sizes of the groups that they join.

    Args:
        most: what is black; None is the largest weight.
    """
    axis.set_facecolor(NO_SYNAPSE)
    shown = axis.imshow(matrix, cmap="Greys", vmin=min(0.0, _least(matrix)), vmax=most, interpolation="nearest")
    axis.figure.colorbar(shown, ax=axis, label=style.WEIGHT, shrink=0.8)
    axis.grid(visible=False)
    for sizes, line, ticks in ((pre, axis.axvline, axis.set_xticks), (post, axis.axhline, axis.set_yticks)):
        ends = np.cumsum(list(sizes.values()))
        for end in ends[:-1]:
            line(end - 0.5, color=CYCLE[0], linewidth=1.0)
        ticks(ends - np.array(list(sizes.values())) / 2 - 0.5, _wrapped(sizes))
    axis.tick_params(length=0)
    axis.set(xlabel="Presynaptic neurons", ylabel="Postsynaptic neurons")
    if np.isnan(matrix).any():
        empty = Patch(facecolor=NO_SYNAPSE, edgecolor="#cccccc", label="no synapse")
        axis.legend(handles=[empty], **style.above(1))


def _least(matrix: np.ndarray) -> float:
    return float(np.nanmin(matrix)) if np.isfinite(matrix).any() else 0.0


def _wrapped(sizes: Mapping[str, int]) -> Sequence[str]:
    return [f"{spoken(name)} ({size})".replace(" ", "\n") for name, size in sizes.items()]


def path(axis: Axes, position: np.ndarray, side: float, colour: str, label: str = "path") -> None:
    """Where a robot has been, [T, 2] (cm), on a torus, at whose edges the line is broken."""
    over = np.flatnonzero((np.abs(np.diff(position, axis=0)) > side / 2).any(1)) + 1
    axis.plot(*np.insert(position.astype(float), over, np.nan, axis=0).T, color=colour, linewidth=0.8, label=label)
    torus(axis, side)


def torus(axis: Axes, side: float) -> None:
    axis.grid(visible=False)
    axis.set(xlabel=style.X, ylabel=style.Y, xlim=(0, side), ylim=(0, side), aspect="equal")

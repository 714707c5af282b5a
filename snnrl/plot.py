"""Figures for a notebook: each function draws one thing of a run's dataset (`snnrl.load`) or a monitor's, and returns
matplotlib's axes.

    data = snnrl.load("runs/food_attraction/learning/DATE_TIME")
    snnrl.plot.learning_curve(data)

All take `axis`, to draw on axes that are there; without, they make a figure by pyplot, which a notebook shows. Bands
are the 95 % interval of the mean over trials and, paler, their standard deviation. `save` writes a figure as PNG and
SVG.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, cast

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snnrl.drawing import charts, style
from snnrl.drawing.palette import CYCLE, of_robot
from snnrl.drawing.style import legend, spoken, styled
from snnrl.errors import ConfigError

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

SYMBOLS = {"v": "Membrane potential", "u": "Recovery", "level": "Level"}  # of a monitor's quantities, in words


P = ParamSpec("P")


def _shown(draw: Callable[P, Axes]) -> Callable[P, Axes]:
    """In the house style, by a backend that is ready before: what a notebook's sets up would end with the style."""

    @functools.wraps(draw)
    def within(*arguments: P.args, **options: P.kwargs) -> Axes:
        pyplot.draw_if_interactive()
        return styled(draw)(*arguments, **options)

    return within


@_shown
def learning_curve(data: Dataset, axis: Axes | None = None) -> Axes:
    """Items that a robot collects per s, in its colour.

    Args:
        data: of a robot's run; `collection_rate` along time and trial.
    """
    axis, values = _axes(axis), _variable(data, "collection_rate").transpose("time", "trial").values
    robot, known = str(data.attrs.get("robot", "learning")), np.isfinite(values).all(1)
    charts.learning_curve(axis, data.time.values[known], values[known], of_robot(robot), spoken(robot))
    legend(axis)
    return axis


@_shown
def rates(data: Dataset, groups: Sequence[str] | None = None, axis: Axes | None = None) -> Axes:
    """Firing rates of groups (all if None)."""
    return _courses(data, "firing_rate", "group", groups, style.FIRING, axis)


@_shown
def weights(data: Dataset, projections: Sequence[str] | None = None, axis: Axes | None = None) -> Axes:
    """Mean weights of projections with a role (all if None), absent synapses as zeros."""
    return _courses(data, "weight", "projection", projections, style.MEAN_WEIGHT, axis)


@_shown
def eligibility(
    data: Dataset, projections: Sequence[str] | None = None, trial: int | None = None, axis: Axes | None = None
) -> Axes:
    """Mean eligibility of projections with a role (all if None) in one trial, and when it took food.

    Args:
        trial: its number; None is the first.
    """
    one = _trial(data, trial)
    axis = _courses(one, "eligibility", "projection", projections, style.MEAN_ELIGIBILITY, axis)
    if "collection_rate" in one:
        charts.rewards(axis, one.time.values, one.collection_rate.values > 0)
    axis.set_title(_told(one))
    legend(axis)
    return axis


@_shown
def weight_matrix(data: Dataset, projection: str, trial: int | None = None, axis: Axes | None = None) -> Axes:
    """Every weight of a projection at the end, from presynaptic (across) to postsynaptic neurons.

    Args:
        trial: its number; None is the first.
    """
    axis, kept = _axes(axis, 4.0), _trial(_variable(data, f"weight_{projection}"), trial)
    pre, post = ({str(dim).rpartition("_")[0]: size} for dim, size in kept.sizes.items())
    charts.weight_matrix(axis, kept.values.T, pre, post)
    axis.set_title(_told(kept), loc="right")
    return axis


@_shown
def path(data: Dataset, trial: int | None = None, side: float | None = None, axis: Axes | None = None) -> Axes:
    """Where a robot has been, at the samples of its run.

    Args:
        trial: its number; None is the first.
        side: of the torus (cm), at whose edges the line is broken; None is as far as it goes.
    """
    axis, kept = _axes(axis, 4.0), _trial(_variable(data, "position"), trial)
    position, colour = kept.transpose("time", "axis").values, of_robot(str(data.attrs.get("robot", "learning")))
    charts.path(axis, position, float(position.max()) if side is None else side, colour)
    axis.plot(*position[-1], "o", color=colour, label=f"after {float(data.time[-1]):g} s")
    axis.set_title(_told(kept))
    legend(axis, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return axis


@_shown
def raster(data: Dataset, trial: int | None = None, axis: Axes | None = None) -> Axes:
    """Spikes that a monitor has seen, of one trial (the first if None).

    Args:
        data: a monitor's, `monitor.dataset()` or `snnrl.load(run, monitor=...)`.
    """
    axis, times = _axes(axis), _variable(data, "spike_time")
    number = int(data.trial[0]) if trial is None else trial
    mine = data.spike_trial.values == number
    charts.raster(axis, times.values[mine], data.spike_neuron.values[mine])
    axis.set_title(f"{spoken(data.attrs.get('of', ''))}, trial {number}")
    return axis


@_shown
def trace(data: Dataset, quantity: str = "v", trial: int | None = None, axis: Axes | None = None) -> Axes:
    """A quantity of each neuron that a monitor has seen (its potential, by default), or of a modulator, in a trial."""
    axis, kept = _axes(axis), _variable(data, quantity)
    chosen = _trial(kept, trial).transpose("time", ...)
    if chosen.ndim > 2:
        raise ConfigError("quantity", quantity, f"is of pairs of neurons; choose one with .sel, {chosen.dims[1:]}")
    for k, column in enumerate(chosen.values.reshape(len(data.time), -1).T):
        label = f"neuron {int(data.neuron[k])}" if "neuron" in chosen.dims else None
        axis.plot(data.time.values, column, color=CYCLE[k % len(CYCLE)], label=label, linewidth=0.9)
    what = SYMBOLS.get(quantity, quantity) if quantity != "level" else str(data.attrs.get("of", "level"))
    axis.set(xlabel=style.TIME, ylabel=style.quantity(what, kept.attrs.get("units", "")), title=_told(chosen))
    if "neuron" in chosen.dims:
        legend(axis)
    return axis


def save(axis: Axes, path: str | Path, dpi: float = 150) -> None:
    """Write the figure that some axes are in as PATH.png and PATH.svg."""
    style.save(cast(Figure, axis.figure), Path(path), dpi)


def _courses(data: Dataset, name: str, dim: str, chosen: Sequence[str] | None, label: str, axis: Axes | None) -> Axes:
    """A line or a band for each of the chosen parts."""
    axis, kept = _axes(axis), _variable(data, name)
    there = [str(part) for part in data[dim].values]
    parts = there if chosen is None else list(chosen)
    for part in parts:
        if part not in there:
            raise ConfigError(dim, part, f"must be among {', '.join(there)}")
    values = {part: kept.sel({dim: part}).transpose("time", ...).values for part in parts}
    charts.courses(axis, data.time.values, values, label)
    legend(axis)
    return axis


def _trial(kept: Any, number: int | None) -> Any:
    """One trial of a dataset or of a variable: that of the number, or the first."""
    return kept.isel(trial=0) if number is None else kept.sel(trial=number)


def _told(kept: Any) -> str:
    return f"trial {int(kept.trial)}"


def _axes(axis: Axes | None, height: float = 3.2) -> Axes:
    return pyplot.subplots(figsize=(6.4, height))[1] if axis is None else axis


def _variable(data: Dataset, name: str) -> DataArray:
    if name not in data:
        raise ConfigError("data", name, f"is not in it; there are {', '.join(map(str, data.data_vars))}")
    return data[name]

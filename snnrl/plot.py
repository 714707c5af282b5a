"""Figures for a notebook: each function draws one thing of a run's dataset (`snnrl.load`) or a monitor's, and returns
matplotlib's axes.

    data = snnrl.load("runs/food_attraction/learning/DATE_TIME")
    snnrl.plot.learning_curve(data)

All take `axis`, to draw on axes that are there; without, they make a figure. Bands are the 95 % interval of the mean
over trials and, paler, their standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from snnrl.drawing.palette import OTHER
from snnrl.drawing.style import ROBOTS, band, figure, robot_name
from snnrl.errors import ConfigError

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

CYCLE = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#8C6D1F", "#000000")  # of Okabe and Ito


def learning_curve(data: Dataset, axis: Axes | None = None) -> Axes:
    """Items that a robot collects per s, in its colour.

    Args:
        data: of a robot's run; `collection_rate` along time and trial.
    """
    axis, values = _axes(axis), _of(data, "collection_rate")
    robot = str(data.attrs.get("robot", "learning"))
    band(axis, data.time.values[1:], values[1:], ROBOTS.get(robot, OTHER), robot_name(robot))
    axis.set(xlabel="Time (s)", ylabel="Collection rate (items/s)", ylim=(0, None))
    axis.legend()
    return axis


def rates(data: Dataset, groups: Sequence[str] | None = None, axis: Axes | None = None) -> Axes:
    """Firing rates of groups (all if None)."""
    return _lines(data, "firing_rate", "group", groups, "Firing rate (Hz)", axis)


def weights(data: Dataset, projections: Sequence[str] | None = None, axis: Axes | None = None) -> Axes:
    """Mean weights of projections with a role (all if None), absent synapses as zeros."""
    return _lines(data, "weight", "projection", projections, "Mean weight (mV)", axis)


def eligibility(data: Dataset, projections: Sequence[str] | None = None, axis: Axes | None = None) -> Axes:
    """Mean eligibility of projections with a role (all if None); a tick below where the first trial took food."""
    axis = _lines(data, "eligibility", "projection", projections, "Mean eligibility (mV/(µM ms))", axis)
    if "collection_rate" in data:
        taken = data.collection_rate.isel(trial=0).values > 0
        axis.plot(data.time.values[taken], np.zeros(taken.sum()), "|", color="black", clip_on=False, label="food")
        axis.lines[-1].set_transform(axis.get_xaxis_transform())
        axis.legend()
    return axis


def weight_matrix(data: Dataset, projection: str, trial: int | None = None, axis: Axes | None = None) -> Axes:
    """Every weight of a projection at the end, from presynaptic (across) to postsynaptic neurons; white: no synapse.

    Args:
        trial: its number; None is the first.
    """
    axis, kept = _axes(axis, 4.0), _variable(data, f"weight_{projection}")
    chosen = kept.isel(trial=0) if trial is None else kept.sel(trial=trial)
    drawn = axis.imshow(chosen.values.T, cmap="cividis", origin="lower", interpolation="nearest")
    axis.figure.colorbar(drawn, ax=axis, label="Weight (mV)")
    axis.grid(visible=False)
    pre, post = (str(dim).rpartition("_")[0].replace("_", " ") for dim in chosen.dims)
    axis.set(xlabel=f"Neuron of {pre}", ylabel=f"Neuron of {post}", title=f"trial {int(chosen.trial)}")
    return axis


def path(data: Dataset, trial: int | None = None, side: float | None = None, axis: Axes | None = None) -> Axes:
    """Where a robot has been, at the samples of its run.

    Args:
        trial: its number; None is the first.
        side: of the torus (cm), at whose edges the line is broken; None is as far as it goes.
    """
    axis, kept = _axes(axis, 4.0), _variable(data, "position")
    x, y = (kept.isel(trial=0) if trial is None else kept.sel(trial=trial)).transpose("axis", "time").values
    side = float(max(x.max(), y.max())) if side is None else side
    over = (np.abs(np.diff(x)) > side / 2) | (np.abs(np.diff(y)) > side / 2)
    at = np.flatnonzero(over) + 1
    axis.plot(np.insert(x, at, np.nan), np.insert(y, at, np.nan), color=ROBOTS["learning"], linewidth=0.8)
    axis.plot(x[-1:], y[-1:], "o", color=ROBOTS["learning"], label=f"after {float(data.time[-1]):g} s")
    axis.set(xlabel="x (cm)", ylabel="y (cm)", xlim=(0, side), ylim=(0, side), aspect="equal")
    axis.legend()
    return axis


def raster(data: Dataset, trial: int | None = None, axis: Axes | None = None) -> Axes:
    """Spikes that a monitor has seen, of one trial (the first if None).

    Args:
        data: a monitor's, `monitor.dataset()` or `snnrl.load(run, monitor=...)`.
    """
    axis, times = _axes(axis), _variable(data, "spike_time")
    number = int(data.trial[0]) if trial is None else trial
    mine = data.spike_trial.values == number
    axis.plot(times.values[mine], data.spike_neuron.values[mine], "|", color="black", markersize=4)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set(xlabel="Time (s)", ylabel="Neuron", title=f"{data.attrs.get('of', '')}, trial {number}".replace("_", " "))
    return axis


def trace(data: Dataset, quantity: str = "v", trial: int | None = None, axis: Axes | None = None) -> Axes:
    """A quantity of each neuron that a monitor has seen (its potential, by default), or of a modulator, in a trial."""
    axis, kept = _axes(axis), _variable(data, quantity)
    chosen = (kept.isel(trial=0) if trial is None else kept.sel(trial=trial)).transpose("time", ...)
    if chosen.ndim > 2:
        raise ConfigError("quantity", quantity, f"is of pairs of neurons; choose one with .sel, {chosen.dims[1:]}")
    for k, column in enumerate(chosen.values.reshape(len(data.time), -1).T):
        label = f"neuron {int(data.neuron[k])}" if "neuron" in chosen.dims else None
        axis.plot(data.time.values, column, color=CYCLE[k % len(CYCLE)], label=label, linewidth=0.9)
    axis.set(xlabel="Time (s)", ylabel=f"{quantity} ({kept.attrs.get('units', '')})".replace("uM", "µM"))
    if "neuron" in chosen.dims:
        axis.legend()
    return axis


def _lines(data: Dataset, name: str, dim: str, chosen: Sequence[str] | None, label: str, axis: Axes | None) -> Axes:
    """A band for each of the chosen parts."""
    axis, kept = _axes(axis), _variable(data, name)
    there = [str(part) for part in data[dim].values]
    for k, part in enumerate(there if chosen is None else chosen):
        if part not in there:
            raise ConfigError(dim, part, f"must be among {', '.join(there)}")
        values = kept.sel({dim: part}).transpose("time", "trial").values
        begun = np.isfinite(values).all(1)
        band(axis, data.time.values[begun], values[begun], CYCLE[k % len(CYCLE)], part.replace("_", " "))
    axis.set(xlabel="Time (s)", ylabel=label)
    axis.legend()
    return axis


def _axes(axis: Axes | None, height: float = 3.2) -> Axes:
    return figure(height=height)[1] if axis is None else axis


def _variable(data: Dataset, name: str) -> DataArray:
    if name not in data:
        raise ConfigError("data", name, f"is not in it; there are {', '.join(map(str, data.data_vars))}")
    return data[name]


def _of(data: Dataset, name: str) -> Any:
    return _variable(data, name).transpose("time", "trial").values

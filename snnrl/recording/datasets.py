"""What was recorded as xarray's datasets: named dimensions, their coordinates, and the unit of every variable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from snnrl.recording.probes import PROBES
from snnrl.recording.runs import Run

if TYPE_CHECKING:
    from xarray import Dataset

UNITS: Mapping[str, str] = {"v": "mV", "weight": "mV", "eligibility": "mV/(uM ms)", "level": "uM"}
SPIKE = ("spike_time", "spike_trial", "spike_neuron")
OF_A_TASK = {"edges": (("edge",), "mV"), "histogram": (("trial", "bin"), "synapses")}  # see `Kept.end_of_task`


def dataset(*arguments: Any, **options: Any) -> Dataset:
    """xarray's; ImportError in one line where it is not installed."""
    try:
        from xarray import Dataset
    except ImportError:
        raise ImportError('datasets need pip install "snnrl[data]"') from None
    return Dataset(*arguments, **options)


def variable(dims: Sequence[str], values: np.ndarray, units: str, **more: str) -> tuple[Any, ...]:
    """A variable as a `Dataset` takes it; what is empty is left out."""
    return tuple(dims), values, {key: text for key, text in {"units": units, **more}.items() if text}


def of_run(run: Run) -> Dataset:
    """The series of a complete run, and, where they were kept, its weights at the end.

    Dimensions: `time` (s), `trial` (its number), `group`, `projection` (those with a role), `axis` (x, y), `stimulus`.
    The weights of projection NAME at the end are `weight_NAME`, along `trial`, `PRE_pre` and `POST_post`, the neurons
    of its two groups; nan where there is no synapse. What is of the time between two samples is nan at one that is the
    start.
    """
    series, projections = run.series, run.config["network"]["projections"]
    time = np.round(series["time"].astype(float), 3)
    variables: dict[str, Any] = {}
    for probe in PROBES:
        if probe.dims and probe.name in series and probe.series:
            values = _from_start(series[probe.name], len(time))
            variables[probe.name] = variable(("time", *probe.dims), values, probe.unit, comment=probe.note)
    for name, (dims, unit) in OF_A_TASK.items():
        if name in series:
            variables[name] = variable(dims, series[name], unit)
    coordinates = {
        "time": variable(("time",), time, "s"),
        "trial": series["trials"],
        "group": series["groups"],
        "projection": series.get("projections", np.array([], "<U1")),
    }
    if "position" in series:
        coordinates["axis"] = np.array(["x", "y"])
    for name, weights in run.weights.items():
        ends = f"{projections[name]['pre']}_pre", f"{projections[name]['post']}_post"
        variables[f"weight_{name}"] = variable(("trial", *ends), weights, "mV")
        coordinates |= {end: np.arange(size) for end, size in zip(ends, weights.shape[1:], strict=True)}
    told = {key: run.summary[key] for key in ("experiment", "robot", "seed", "engine", "dtype")}
    return dataset(variables, coordinates, told)


def _from_start(values: np.ndarray, samples: int) -> np.ndarray:
    """Values with nan for the samples that they lack at the start."""
    missing = np.full((samples - len(values), *values.shape[1:]), np.nan)
    return np.concatenate([missing, values]) if len(missing) else values


def of_monitor(seen: Mapping[str, np.ndarray]) -> Dataset:
    """What a monitor has seen, from its `arrays`.

    Dimensions: `time` (s), `trial`, and `neuron`, or `pre` and `post`. Each spike, along `spike`, has a `spike_time`
    (s), a `spike_trial` and a `spike_neuron`.
    """
    axes = {"trials": "trial", "neurons": "neuron", "pre": "pre", "post": "post"}
    dims = ("time", *(axes[key] for key in seen if key in axes))
    coordinates: dict[str, Any] = {axes[key]: values for key, values in seen.items() if key in axes}
    coordinates["time"] = variable(("time",), seen["time"] / 1000.0, "s")
    variables: dict[str, Any] = {}
    for key, values in seen.items():
        if key == "spikes":
            columns = values[:, 0] / 1000.0, values[:, 1], values[:, 2]
            pairs = zip(SPIKE, columns, ("s", "", ""), strict=True)
            variables |= {name: variable(("spike",), column, unit) for name, column, unit in pairs}
        elif key not in (*axes, "time", "of"):
            variables[key] = variable(dims, values, UNITS.get(key, ""))
    return dataset(variables, coordinates, {"of": str(seen["of"])})

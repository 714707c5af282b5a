"""Figures of datasets: what is drawn, of which trial, with which units."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import matplotlib as mpl
import numpy as np
import pytest
from labels import faults
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from xarray import Dataset

from snnrl import plot
from snnrl.drawing.palette import ROBOTS
from snnrl.drawing.style import INTERVAL, SPREAD, figure
from snnrl.errors import ConfigError

mpl.use("Agg")
mpl.rcParams["figure.max_open_warning"] = 0
TIME = np.array([0.0, 10.0, 20.0])


@pytest.fixture
def run() -> Dataset:
    """Three trials of a robot, numbered from 7 on; rates of the time between two samples lack the first."""
    rate = np.array([[np.nan] * 3, [1.0, 2.0, 3.0], [0.0, 4.0, 8.0]])
    by_projection = np.stack([rate, 10 * rate], 2)
    variables = {
        "collection_rate": (("time", "trial"), rate),
        "firing_rate": (("time", "trial", "group"), by_projection),
        "weight": (("time", "trial", "projection"), by_projection),
        "eligibility": (("time", "trial", "projection"), by_projection),
        "position": (("time", "trial", "axis"), np.array([[[1, 5]] * 3, [[99, 6]] * 3, [[98, 7]] * 3], float)),
        "weight_a_to_b": (("trial", "a_pre", "b_post"), np.arange(18.0).reshape(3, 2, 3)),
    }
    coordinates = {"time": TIME, "trial": [7, 8, 9], "group": ["g", "h"], "projection": ["a_to_b", "c_to_d"]}
    return Dataset(variables, {**coordinates, "axis": ["x", "y"]}, {"robot": "benchmark"})


@pytest.fixture
def monitor() -> Dataset:
    spikes = {"spike_time": [0.1, 0.2, 0.3], "spike_trial": [7, 8, 7], "spike_neuron": [0, 3, 3]}
    variables = {name: ("spike", np.array(values)) for name, values in spikes.items()}
    v = (("time", "trial", "neuron"), np.arange(12.0).reshape(3, 2, 2), {"units": "mV"})
    return Dataset({**variables, "v": v}, {"time": TIME, "trial": [7, 8], "neuron": [0, 3]}, {"of": "left_motor"})


def told(axis: Axes) -> tuple[str, str]:
    return axis.get_xlabel(), axis.get_ylabel()


def test_a_learning_curve_is_the_mean_over_trials_in_the_robots_colour(run: Dataset) -> None:
    axis = plot.learning_curve(run)
    np.testing.assert_array_equal(axis.lines[0].get_xydata(), [[10, 2], [20, 4]])
    assert axis.lines[0].get_color() == ROBOTS["benchmark"]
    assert told(axis) == ("Time (s)", "Collection rate (items/s)")
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["benchmark", INTERVAL, SPREAD]


def test_lines_are_of_the_chosen_parts(run: Dataset) -> None:
    axis = plot.weights(run, ["c_to_d"])
    np.testing.assert_array_equal(axis.lines[0].get_xydata(), [[10, 20], [20, 40]])
    assert told(axis) == ("Time (s)", "Mean weight (mV)")
    assert len(plot.rates(run).lines) == 2
    with pytest.raises(ConfigError, match="group=k: must be among g, h"):
        plot.rates(run, ["k"])


def test_rewards_are_where_the_first_trial_took_food(run: Dataset) -> None:
    axis = plot.eligibility(run, ["a_to_b"])
    np.testing.assert_array_equal(axis.lines[0].get_xydata(), [[10, 1], [20, 0]])
    (spans,) = (collection.get_paths() for collection in axis.collections if collection.get_label() == "food")
    assert [tuple(np.unique(np.asarray(span.vertices)[:, 0])) for span in spans] == [(0.0, 10.0)]
    assert told(axis)[1] == "Mean eligibility (mV/(µM ms))"


def test_a_weight_matrix_has_presynaptic_neurons_across(run: Dataset) -> None:
    axis = plot.weight_matrix(run, "a_to_b", 8)
    np.testing.assert_array_equal(axis.images[0].get_array(), [[6, 9], [7, 10], [8, 11]])
    names = axis.get_xticklabels(), axis.get_yticklabels()
    assert [[text.get_text() for text in texts] for texts in names] == [["a\n(2)"], ["b\n(3)"]]
    assert plot.weight_matrix(run, "a_to_b").get_title("right") == "trial 7"


def test_a_path_is_broken_at_the_edges_of_the_torus(run: Dataset) -> None:
    x = plot.path(run, side=100.0).lines[0].get_xdata()
    np.testing.assert_array_equal(x, [1, np.nan, 99, 98])


def test_spikes_and_traces_are_of_one_trial(monitor: Dataset) -> None:
    axis = plot.raster(monitor)
    np.testing.assert_array_equal(axis.lines[0].get_xydata(), [[0.1, 0], [0.3, 3]])
    assert axis.get_title("left") == "left motor, trial 7"
    axis = plot.trace(monitor, "v", 8)
    np.testing.assert_array_equal([line.get_ydata() for line in axis.lines], [[2, 6, 10], [3, 7, 11]])
    assert told(axis) == ("Time (s)", "Membrane potential (mV)")


def test_what_is_not_there_is_said(run: Dataset, monitor: Dataset) -> None:
    with pytest.raises(ConfigError, match="data=spike_time: is not in it; there are collection_rate, "):
        plot.raster(run)
    with pytest.raises(ConfigError, match="data=collection_rate: is not in it"):
        plot.learning_curve(monitor)


def test_it_draws_on_the_axes_that_it_is_given(run: Dataset) -> None:
    axis = figure()[1]
    assert plot.learning_curve(run, axis) is axis


def test_all_axes_keep_the_convention(run: Dataset, monitor: Dataset) -> None:
    drawn = [plot.learning_curve(run), plot.rates(run), plot.weights(run), plot.eligibility(run), plot.path(run)]
    drawn += [plot.weight_matrix(run, "a_to_b"), plot.raster(monitor), plot.trace(monitor)]
    assert [faults(cast(Figure, axis.figure)) for axis in drawn] == [[]] * len(drawn)


def test_a_figure_is_saved_as_bitmap_and_vector(run: Dataset, tmp_path: Path) -> None:
    plot.save(plot.learning_curve(run), tmp_path / "curve")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curve.png", "curve.svg"]

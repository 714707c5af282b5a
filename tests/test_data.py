"""Runs and sweeps as datasets and tables."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SMALL_STIMULI, SMALL_TASK, compose_config

import snnrl
from snnrl.files import FolderError
from snnrl.recording.runs import Run
from snnrl.running.job import perform
from snnrl.schema import ConfigError

pytest.importorskip("xarray", reason="xarray is not installed")
pytest.importorskip("pandas", reason="pandas is not installed")


def perform_in(folder: Path, *overrides: str, experiment: str = "food_attraction") -> Path:
    folder.mkdir(parents=True)
    named = [f"+experiment={experiment}", *overrides]
    perform(compose_config("seconds=2.8", "record.tensorboard=false", "threads=1", *named), folder, named)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep over dopamine's delay, one value of it in two shards; and a run with monitors."""
    place = tmp_path_factory.mktemp("runs")
    options = ("record.every=0.7", "trials=1")
    perform_in(place / "sweep" / "0", *options, "trial_start=8", "network.dopamine.delay=5")
    perform_in(place / "sweep" / "1", *options, "trial_start=7", "network.dopamine.delay=5")
    perform_in(place / "sweep" / "2", *options, "trial_start=7", "network.dopamine.delay=9", "record.every=1.4")
    motors = "{of: left_motor, quantities: [v, spikes], neurons: [3, 0], every: 70}"
    perform_in(place / "watched", "trials=2", "record.every=0.7", f"+record.monitors.motors={motors}")
    return place


def test_a_run_is_a_dataset_with_units(runs: Path) -> None:
    run, data = Run(runs / "watched"), snnrl.load(runs / "watched")
    assert data.time.values == pytest.approx([0.7, 1.4, 2.1, 2.8], abs=1e-9)
    assert data.time.units == "s"
    assert data.trial.values.tolist() == [0, 1]
    name = "left_food_to_right_motor"
    np.testing.assert_array_equal(data.weight.sel(projection=name), run.of_projection("weight", name))
    np.testing.assert_array_equal(data.firing_rate.sel(group="left_motor"), run.firing_rate("left_motor"))
    np.testing.assert_array_equal(data.position.sel(axis="y", trial=1), run.series["position"][:, 1, 1])
    matrix = data[f"weight_{name}"]
    assert matrix.dims == ("trial", "left_food_pre", "right_motor_post")
    np.testing.assert_array_equal(matrix, run.weights[name])
    assert all("units" in variable.attrs for variable in data.data_vars.values())
    units = {"weight": "mV", "firing_rate": "Hz", "position": "cm", "heading": "rad", "dopamine": "uM"}
    assert {key: data[key].units for key in units} == units
    assert data.attrs["experiment"] == "food_attraction"
    assert set(data.data_vars) == {*run.series, *(f"weight_{key}" for key in run.weights)} - set(data.coords) - {
        *("trials", "groups", "projections"),
    }


def test_what_a_monitor_of_a_run_has_seen_is_what_the_monitor_has(runs: Path) -> None:
    simulation = snnrl.build(compose_config("+experiment=food_attraction", "trials=2"))
    monitor = snnrl.record(simulation.network, "left_motor", ["v", "spikes"], neurons=[3, 0], every=70)
    snnrl.run_simulation(simulation, 2.8, [monitor])
    seen = snnrl.load(runs / "watched", monitor="motors")
    assert seen.identical(monitor.dataset())
    assert seen.v.dims == ("time", "trial", "neuron")
    assert seen.v.units == "mV"
    assert seen.time.values[:2].tolist() == [0.07, 0.14]
    np.testing.assert_array_equal(seen.v.sel(neuron=0, trial=1), monitor["v"][:, 1, 1])
    np.testing.assert_array_equal(seen.spike_time, monitor["spikes"][:, 0] / 1000.0)
    assert seen.attrs["of"] == "left_motor"


def test_a_task_is_a_dataset_too(tmp_path: Path) -> None:
    options = ("trials=2", "record.every=1", *SMALL_TASK)
    reward = perform_in(tmp_path / "reward", *options, experiment="distal_reward")
    data, run = snnrl.load(reward), Run(reward)
    assert data.time.values.tolist() == [0.0, 1.0, 2.0, 2.8]
    np.testing.assert_array_equal(data.rewards, run.series["rewards"])
    assert data.firing_rate.isel(time=0).isnull().all()
    np.testing.assert_array_equal(data.firing_rate[1:], run.series["firing_rate"])
    assert data.histogram.dims == ("trial", "bin")
    stimuli = perform_in(tmp_path / "stimuli", *options, *SMALL_STIMULI, experiment="classical_conditioning")
    assert snnrl.load(stimuli).response.dims == ("time", "trial", "stimulus")


def test_a_sweep_has_a_dimension_of_runs(runs: Path) -> None:
    data = snnrl.load(runs / "sweep")
    assert data["network.dopamine.delay"].values.tolist() == [5, 9]
    assert data.robot.values.tolist() == ["learning", "learning"]
    assert data.trial.values.tolist() == [7, 8]
    first, other = (Run(runs / "sweep" / name).of_projection("weight", "left_food_to_left_motor") for name in "12")
    weight = data.weight.sel(projection="left_food_to_left_motor", trial=7)
    np.testing.assert_array_equal(weight.isel(run=0), first[:, 0])
    np.testing.assert_array_equal(weight.isel(run=1).dropna("time"), other[:, 0])
    assert data.collection_rate.isel(run=1).sel(trial=8).isnull().all()


def test_a_table_has_a_column_for_each_swept_key(runs: Path) -> None:
    table = snnrl.table(runs / "sweep")
    assert table["network.dopamine.delay"].tolist() == [5, 9]
    assert table["trials"].tolist() == [2, 1]
    each = snnrl.table(runs / "sweep", trials=True)
    assert list(zip(each["network.dopamine.delay"], each["trial"], strict=True)) == [(5, 7), (5, 8), (9, 7)]
    assert each["food"].groupby(each["network.dopamine.delay"]).mean().tolist() == table["food_mean"].tolist()
    assert len(snnrl.table(runs / "watched")) == 1


def test_what_is_not_there_is_refused_in_one_line(runs: Path, tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="no run in it"):
        snnrl.load(tmp_path)
    with pytest.raises(ConfigError, match=r"^monitor=sensors: .*watched has motors$"):
        snnrl.load(runs / "watched", monitor="sensors")
    with pytest.raises(ConfigError, match=r"^monitor=motors: is of one run, and .*sweep is none$"):
        snnrl.load(runs / "sweep", monitor="motors")
    perform_in(tmp_path / "a", "trials=1", "record.every=1.4")
    perform_in(tmp_path / "b", "trials=1", "record.every=1.4")
    for read in (snnrl.load, snnrl.table, lambda folder: snnrl.table(folder, trials=True)):
        with pytest.raises(FolderError, match="repeats"):
            read(tmp_path)


def test_runs_that_are_not_complete_are_named(runs: Path, tmp_path: Path) -> None:
    perform_in(tmp_path / "a", "trials=1", "record.every=1.4")
    begun = tmp_path / "b"
    begun.mkdir()
    (begun / "config.yaml").write_bytes((tmp_path / "a" / "config.yaml").read_bytes())
    text = (tmp_path / "a" / "summary.json").read_text()
    (begun / "summary.json").write_text(text.replace('"complete": true', '"complete": false'))
    with pytest.raises(FolderError, match="b: the run is not complete"):
        snnrl.load(begun)
    for read in (snnrl.load, snnrl.table):
        with pytest.warns(UserWarning, match="b: left out, the run is not complete"):
            read(tmp_path)


@pytest.mark.parametrize(("library", "read"), [("xarray", snnrl.load), ("pandas", snnrl.table)])
def test_without_the_library_it_says_what_to_install(
    library: str, read: Any, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = builtins.__import__

    def missing(name: str, *arguments: Any, **options: Any) -> Any:
        if name == library:
            raise ImportError(name)
        return there(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ImportError, match=r'need.? pip install "snnrl\[data\]"'):
        read(runs / "watched")

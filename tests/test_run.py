"""The command line, as a user runs it."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers import called
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


def run(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return called("snnrl.run", folder, *arguments, **environment)


def test_a_run_leaves_everything_it_promises(tmp_path: Path) -> None:
    done = run(tmp_path, "+experiment=food_attraction", "trials=3", "trial_start=4", "seconds=30", "hydra.run.dir=here")
    assert done.returncode == 0, done.stderr
    assert "30 of 30 s" in done.stderr
    assert "x real time" in done.stderr
    folder = tmp_path / "here"
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["experiment"], summary["robot"], summary["engine"]) == ("food_attraction", "learning", "fused")
    assert (summary["trials"], summary["seed"], summary["device"]) == (3, 0, "cpu")
    assert summary["seconds"] == pytest.approx(30, abs=0.035)  # whole ticks
    assert set(summary["mean_weight"]) >= {"left_food_to_right_motor", "inhibitory_to_dopaminergic"}
    assert {"python", "snnrl", "torch", "numpy", "numba"} <= set(summary["versions"])
    assert summary["trial_ms_per_s"] == pytest.approx(3000 * summary["seconds"] / summary["wall_s"])

    rows = list(csv.DictReader((folder / "trials.csv").open()))
    assert [row["trial"] for row in rows] == ["4", "5", "6"]
    food = [int(row["food"]) for row in rows]
    assert np.mean(food) == pytest.approx(summary["results"]["food_mean"])
    assert np.std(food, ddof=1) == pytest.approx(summary["results"]["food_sd"])
    assert np.mean([int(row["correct"]) for row in rows]) == pytest.approx(summary["results"]["correct_fraction"])

    series = np.load(folder / "series.npz")
    spans = np.diff(series["time"], prepend=0.0)
    assert series["collection_rate"].shape == (len(spans), 3)
    np.testing.assert_allclose((series["collection_rate"] * spans[:, None]).sum(0), food, rtol=1e-4)
    names = series["projections"].tolist()
    last = series["weight"][-1, :, names.index("left_food_to_right_motor")]
    np.testing.assert_allclose(last, [float(row["left_food_to_right_motor"]) for row in rows], rtol=1e-4)
    assert series["firing_rate"].shape == (len(spans), 3, len(series["groups"]))

    events = EventAccumulator(str(folder)).Reload()
    tags = events.Tags()["scalars"]
    assert "behaviour/collection rate, items per s" in tags
    assert "dopamine/mean level, uM" in tags
    assert "weight, mV/left food to right motor" in tags
    assert "firing rate, Hz/left motor" in tags
    values = [event.value for event in events.Scalars("behaviour/collection rate, items per s")]
    np.testing.assert_allclose(values, series["collection_rate"].mean(1), rtol=1e-5)
    assert "benchmark" not in (folder / "config.yaml").read_text()


def test_the_same_command_gives_the_same_trials(tmp_path: Path) -> None:
    tables = []
    for name, threads in (("a", 1), ("b", 2)):
        options = [f"hydra.run.dir={name}", f"threads={threads}", "record.tensorboard=false"]
        done = run(tmp_path, "+experiment=food_attraction", "trials=2", "seconds=7", *options)
        assert done.returncode == 0, done.stderr
        tables.append((tmp_path / name / "trials.csv").read_text())
    assert tables[0] == tables[1]
    assert not list(tmp_path.rglob("events*"))


def test_reference_engine_from_the_command_line(tmp_path: Path) -> None:
    done = run(tmp_path, "+experiment=food_attraction", "trials=1", "seconds=0.7", "engine=reference", "dtype=float64")
    assert done.returncode == 0, done.stderr
    (summary,) = tmp_path.rglob("summary.json")
    assert json.loads(summary.read_text())["engine"] == "reference"


def test_multirun_makes_a_folder_a_job(tmp_path: Path) -> None:
    options = ["trials=1", "seconds=0.7", "hydra.sweep.dir=sweep"]
    done = run(tmp_path, "-m", "+experiment=dual_learning", "robot=random_walk,benchmark,learning", *options)
    assert done.returncode == 0, done.stderr
    robots = {json.loads(path.read_text())["robot"] for path in (tmp_path / "sweep").glob("*/summary.json")}
    assert robots == {"random_walk", "benchmark", "learning"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "experiment: must be given as experiment=NAME, NAME one of avoidance, baselines, "),
        (["+experiment=odd"], "experiment=odd: must be one of "),
        (
            ["+experiment=food_attraction", "robot=odd"],
            "robot=odd: must be one of background, benchmark, container",
        ),
        (["+experiment=food_attraction", "robot=benchmark"], "robot=benchmark: must be one of learning, random_walk"),
        (["+experiment=food_attraction", "trails=3"], "trails=3: no such key; allowed here: experiment, robot"),
        (["+experiment=food_attraction", "trials=many"], "trials=many: must be a whole number"),
        (["+experiment=food_attraction", "network.dopamine.tau=-1"], "network.dopamine.tau=-1.0: must be greater"),
        (["+experiment=food_attraction", "network.synapses.taxis.odd=1"], "network.synapses.taxis.odd=1: no such key"),
        (["+experiment=food_attraction", "trials=0"], "trials=0: must be at least 1"),
        (["+experiment=food_attraction", "seconds=${nowhere}"], "seconds=${nowhere}: Interpolation key 'nowhere' not"),
        (["+experiment=food_attraction", "hydra.run.dir=${nowhere}"], "hydra.run.dir: Interpolation key 'nowhere' not"),
        (["+experiment=food_attraction", "hydra.launcher=3"], "hydra.launcher=3: must be chosen with hydra/launcher="),
        (["+experiment=food_attraction", "~robot"], "robot.name=???: a value must be given"),
        (["+experiment=food_attraction", "--odd"], "unrecognized arguments: --odd; options go before or after"),
        (["--experimental-rerun=run.pickle"], "--experimental-rerun: is not supported"),
        (
            ["+experiment=food_attraction", "trials=1,2"],
            "trials=1,2: several values need -m (a sweep) or [...]",
        ),
    ],
)
def test_bad_input_gets_one_line_and_leaves_no_folder(tmp_path: Path, arguments: list[str], message: str) -> None:
    done = run(tmp_path, *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_traceback_is_there_for_the_asking(tmp_path: Path) -> None:
    done = run(tmp_path, "+experiment=food_attraction", "trials=0", HYDRA_FULL_ERROR="1")
    assert done.returncode != 0
    assert "Traceback" in done.stderr


def test_a_misspelt_key_in_a_file_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "mine" / "experiment"
    folder.mkdir(parents=True)
    text = "# @package _global_\nexperiment: {name: own, robots: [learning]}\ntrails: 3\n"
    (folder / "own.yaml").write_text(text)
    done = run(tmp_path, "--config-dir=mine", "+experiment=own")
    assert done.returncode == 2
    assert "trails" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_users_own_experiment_runs(tmp_path: Path) -> None:
    folder = tmp_path / "mine" / "experiment"
    folder.mkdir(parents=True)
    text = "# @package _global_\nexperiment: {name: own, robots: [learning]}\ntrials: 1\nseconds: 0.7\n"
    (folder / "own.yaml").write_text(text)
    done = run(tmp_path, "--config-dir=mine", "+experiment=own")
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "runs" / "own" / "learning").glob("*/summary.json"))) == 1

"""Sweeps over processes: failures are reported, the rest finishes, and a second start does what is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from snnrl.configuration.compose import load
from snnrl.running.jobs import share

SWEEP = ["-m", "+experiment=food_attraction", "trials=1", "seconds=2"]
REASON = "network.dopamine.delay=0: must be at least 1 and at most 1000"


def sweep(place: Path, delays: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-m",
            "snnrl.run",
            *SWEEP,
            f"network.dopamine.delay={delays}",
            "hydra.sweep.dir=sweep",
            *options,
        ],
        cwd=place,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def finished(place: Path) -> dict[str, int]:
    return {path.parent.name: path.stat().st_mtime_ns for path in place.glob("sweep/*/trials.csv")}


def test_a_sweep_over_processes_and_over_again_on_another_launcher(tmp_path: Path) -> None:
    pytest.importorskip("joblib")
    pytest.importorskip("submitit")
    done = sweep(tmp_path, "5,0", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert done.returncode == 1
    assert f"job 1 (+experiment=food_attraction trials=1 seconds=2 network.dopamine.delay=0): {REASON}" in done.stderr
    assert done.stderr.splitlines()[-1].endswith("hydra.sweep.dir=sweep does only what is missing")
    assert "Traceback" not in done.stderr
    first = finished(tmp_path)
    assert set(first) == {"0_food_attraction_learning"}

    done = sweep(tmp_path, "5,0,6", "hydra/launcher=submitit_local", "hydra.launcher.cpus_per_task=1")
    assert done.returncode == 1
    assert REASON in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    again = finished(tmp_path)
    assert set(again) == {"0_food_attraction_learning", "2_food_attraction_learning"}
    assert again["0_food_attraction_learning"] == first["0_food_attraction_learning"]


def test_a_sweep_over_projections_that_are_added(tmp_path: Path) -> None:
    pytest.importorskip("joblib")
    ends = "pre: left_food, post: left_motor"
    added = f"+network.projections.x={{{ends}, synapse: taxis}},{{{ends}, synapse: reward}}"
    done = sweep(tmp_path, "5", added, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert done.returncode == 0, done.stderr
    configs = [load(path) for path in sorted(tmp_path.glob("sweep/*/config.yaml"))]
    assert [config.network.projections["x"].synapse for config in configs] == ["taxis", "reward"]


def test_joblib_divides_the_processors() -> None:
    joblib = pytest.importorskip("joblib")
    shares = joblib.Parallel(n_jobs=2)(joblib.delayed(os.getenv)("OMP_NUM_THREADS") for _ in range(2))
    assert shares == [str(max(1, joblib.cpu_count() // 2))] * 2


@pytest.mark.parametrize(
    ("launcher", "variable", "threads"),
    [
        ({}, None, 0),
        ({}, "3", 3),
        ({}, "many", 0),
        ({"cpus_per_task": None}, "3", 3),
        ({"cpus_per_task": 5}, "3", 5),
    ],
)
def test_a_job_takes_the_threads_that_its_launcher_gives_it(
    monkeypatch: pytest.MonkeyPatch, launcher: dict[str, int], variable: str | None, threads: int
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", variable)
    given = OmegaConf.create(launcher)
    assert isinstance(given, DictConfig)
    assert share(given) == threads

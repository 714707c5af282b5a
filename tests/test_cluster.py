"""Sweeps on a Dask cluster: a worker dies half-way, and nothing is lost or different."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from cluster import Outcome, compare

from snnrl.configuration.compose import load

pytest.importorskip("distributed")
JOBS = 40


def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    found = compare(tmp_path, JOBS, 2.1)
    assert found == Outcome(JOBS, found.before, missing=0, differing=0), (tmp_path / "cluster.log").read_text()
    assert JOBS // 2 <= found.before < JOBS


def test_a_cluster_of_its_own_and_a_job_that_fails(tmp_path: Path) -> None:
    words = ["-m", "+experiment=food_attraction", "trials=1", "seconds=0.7", "network.dopamine.delay=5,0,6"]
    options = ["hydra/launcher=dask", "hydra.launcher.workers=2", "hydra.sweep.dir=sweep"]
    command = [sys.executable, "-m", "snnrl.run", *words, *options]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 1
    assert "job 1 " in done.stderr.splitlines()[-1]
    assert "network.dopamine.delay=0: must be at least 1" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    configs = [load(path.parent / "config.yaml") for path in sorted(tmp_path.glob("sweep/*/trials.csv"))]
    assert [config.network.dopamine and config.network.dopamine.delay for config in configs] == [5, 6]

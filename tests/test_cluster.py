"""Sweeps on a Dask cluster: a worker dies half-way, and nothing is lost or different."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from cluster import Outcome, compare
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf

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


def test_a_worker_keeps_no_configuration_of_a_job_that_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All results of a sweep are kept until its last job is done, and configurations are large."""
    sweep = OmegaConf.create({"hydra": {"job": {"name": "run"}}})
    context: Any = SimpleNamespace(config_loader=SimpleNamespace(load_sweep_config=lambda config, overrides: sweep))
    done = JobReturn(overrides=["seed=3"], cfg=sweep, hydra_cfg=sweep, status=JobStatus.COMPLETED, _return_value=5)
    snnrl_dask: Any = importlib.import_module("hydra_plugins.snnrl_dask")
    monkeypatch.setattr(snnrl_dask, "run_job", lambda *_: done)
    for name in ("HydraConfig", "Singleton"):
        monkeypatch.setattr(snnrl_dask, name, Mock())
    monkeypatch.chdir(tmp_path)
    ended = snnrl_dask.perform(context, Mock(), sweep, {}, str(tmp_path), 7, ["seed=3"])
    assert (ended.cfg, ended.hydra_cfg, ended.return_value) == (None, None, 5)
    assert sweep.hydra.job.num == 7


def test_what_jobs_share_is_sent_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And as bytes: a job changes what it is made of, and a worker could not pass that on to another one."""
    snnrl_dask: Any = importlib.import_module("hydra_plugins.snnrl_dask")
    sent: list[tuple[Any, ...]] = []

    def submit(function: Any, *words: Any, pure: bool) -> Mock:
        sent.append(words)
        future = Mock(result=lambda: len(sent))
        future.exception.return_value = None
        return future

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(snnrl_dask, "configure_log", Mock())
    launcher = snnrl_dask.DaskLauncher(2, None, None, 1)
    config = OmegaConf.create({"hydra": {"hydra_logging": {}, "verbose": False, "sweep": {"dir": "sweep"}}})
    launcher.setup(hydra_context=None, task_function=str, config=config)
    monkeypatch.setattr(launcher, "_client", lambda stack: Mock(submit=submit))
    launcher.launch([["seed=3"], ["seed=4"]], 5)
    shared, *jobs = sent
    assert [type(word) for word in shared] == [bytes]
    assert [words[1:] for words in jobs] == [(5, ["seed=3"]), (6, ["seed=4"])]
    assert jobs[0][0] is jobs[1][0]

"""What docs/slurm.md tells to do on a cluster. Where there is no Slurm, `tools/slurm.sh` makes one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

SHARDS = Path(__file__).parents[1] / "examples" / "shards.sh"
RUN = ("+experiment=food_attraction", "record.tensorboard=false")
SHORT = (*RUN, "seconds=2.1")
HERE = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
ON_SLURM = pytest.mark.skipif(
    shutil.which("sinfo") is None or subprocess.run(["sinfo"], capture_output=True, check=False).returncode != 0,
    reason="no Slurm answers; tools/slurm.sh makes one",
)


def told(place: Path, *words: str, **environment: str) -> str:
    """What a command says, which must succeed."""
    given = {**os.environ, "PATH": HERE, **environment}
    done = subprocess.run(words, cwd=place, env=given, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < end, "nothing has come of it"
        time.sleep(0.2)


def rows(folder: Path) -> list[str]:
    return (folder / "trials.csv").read_text().splitlines()[1:]


def whole(place: Path, *words: str) -> list[str]:
    """The trials of one run."""
    told(place, "python", "-m", "snnrl.run", *words, "threads=1", "hydra.run.dir=whole")
    return rows(place / "whole")


def test_shards_of_an_array_are_the_trials_of_one_run(tmp_path: Path) -> None:
    for number in range(2):
        job = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_CPUS_PER_TASK": "1"}
        told(tmp_path, "sh", str(SHARDS), "2", "shards", *SHORT, **job)
    assert rows(tmp_path / "shards" / "0") + rows(tmp_path / "shards" / "1") == whole(tmp_path, *SHORT, "trials=4")


def is_over(job: str) -> bool:
    return job not in subprocess.run(["squeue", "--noheader", "--format=%A"], capture_output=True, text=True).stdout


@ON_SLURM
def test_an_array_that_is_stopped_before_its_limit_and_submitted_again(tmp_path: Path) -> None:
    long = ("seconds=6", "engine=reference")  # some seconds
    words = ("2", "shards", *RUN, *long)
    submit = ("sbatch", "--parsable", "--array=0-1", str(SHARDS), *words)
    job = told(tmp_path, *submit).strip()
    until(lambda: len(list(tmp_path.glob("shards/*/config.yaml"))) == 2)
    time.sleep(1)
    told(tmp_path, "scancel", "--batch", "--signal=TERM", job)
    until(lambda: is_over(job))
    assert len(list(tmp_path.glob("shards/*/checkpoint.pt"))) == 2
    again = told(tmp_path, *submit).strip()
    until(lambda: is_over(again))
    alone = whole(tmp_path, *RUN, "trials=4", *long)
    assert rows(tmp_path / "shards" / "0") + rows(tmp_path / "shards" / "1") == alone


@ON_SLURM
def test_a_sweep_through_submitit(tmp_path: Path) -> None:
    launcher = ("hydra/launcher=submitit_slurm", "hydra.launcher.cpus_per_task=1", "hydra.launcher.timeout_min=10")
    words = (*SHORT, "trials=1", "seed=0,1,2", *launcher, "hydra.sweep.dir=sweep")
    told(tmp_path, "python", "-m", "snnrl.run", "-m", *words)
    assert len(list(tmp_path.glob("sweep/*/trials.csv"))) == 3


@ON_SLURM
def test_a_sweep_on_workers_that_slurm_has_started(tmp_path: Path) -> None:
    file = tmp_path / "dask.json"
    address = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file))
    with subprocess.Popen([str(Path(sys.executable).with_name("dask")), "scheduler", *address]) as scheduler:
        try:
            until(file.exists)
            work = f"exec dask worker --scheduler-file {file} --nthreads 1 --no-nanny --no-dashboard"
            told(tmp_path, "sbatch", "--array=0-1", "--cpus-per-task=1", "--time=10", "--wrap", work)
            launcher = ("hydra/launcher=dask", f"hydra.launcher.scheduler_file={file}")
            words = (*SHORT, "trials=1", "seed=range(0,6)", *launcher, "hydra.sweep.dir=sweep")
            told(tmp_path, "python", "-m", "snnrl.run", "-m", *words)
        finally:
            scheduler.kill()
    assert len(list(tmp_path.glob("sweep/*/trials.csv"))) == 6

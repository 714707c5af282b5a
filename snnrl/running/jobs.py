"""A run as a Hydra job, alone or of a sweep, or one that is gone on with; and what it came to, in a few lines."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from snnrl.configuration.compose import load, plain
from snnrl.errors import ConfigError
from snnrl.files import FolderError
from snnrl.running.command import JobFailed, Passed, discard, explain
from snnrl.running.job import perform
from snnrl.running.signals import Interrupted


def job(composed: DictConfig) -> float:
    """One Hydra job; returns its score, so that a sweeper can optimise it."""
    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    overrides = OmegaConf.to_container(settings.overrides.task, resolve=False)
    assert isinstance(overrides, list)
    try:
        summary = perform(plain(composed), folder, overrides, share(settings.launcher))
    except Exception as error:
        if isinstance(error, ConfigError):
            discard(folder)
        if settings.mode == RunMode.RUN or isinstance(error, Interrupted):
            raise Passed(error) from error
        failure = f"job {settings.job.num} ({' '.join(overrides)}): {explain(error)}"
        print(f"snnrl.run: {failure}", file=sys.stderr)
        again = f"the same command with hydra.sweep.dir={settings.sweep.dir} does only what is missing"
        raise JobFailed(f"{failure}; {again}") from error
    report(summary, folder)
    return score(summary)


def share(launcher: DictConfig) -> int:
    """Threads for a job that was not told how many: what its launcher gives it, else 0, one per processor."""
    told = str(launcher.get("cpus_per_task") or os.environ.get("OMP_NUM_THREADS", ""))  # joblib sets the latter
    return int(told) if told.isdigit() else 0


def resume(folder: Path) -> None:
    """Go on with the run in a folder."""
    if not (folder / "config.yaml").is_file():
        raise FolderError(f"resume={folder}: no run folder (there is no config.yaml in it)")
    report(perform(load(folder / "config.yaml"), folder), folder)


def score(summary: dict[str, Any]) -> float:
    """Mean food of a robot, mean number of rewards of a task."""
    results = summary["results"]
    return float(results.get("food_mean", results.get("rewards", math.nan)))


def report(summary: dict[str, Any], folder: Path) -> None:
    """Print the result of a run in a few lines."""
    print(f"{summary['experiment']}, {summary['robot']}: {summary['trials']} trials x {summary['seconds']:.0f} s")
    results = dict(summary["results"])
    if "food_mean" in results:
        mean, sd, learnt = (results.pop(key) for key in ("food_mean", "food_sd", "correct_fraction"))
        print(f"  food collected   {mean:.1f}{'' if sd is None else f' (SD {sd:.1f})'}")
        if learnt is not None:
            print(f"  learnt           {learnt:.0%} of trials")
    for key, value in results.items():
        print(f"  {key.replace('_', ' '):<16} {value:.4g}")
    print(f"  took             {summary['wall_s']:.1f} s, {summary['trial_ms_per_s'] / 1e6:.2f} million trial-ms/s")
    print(f"  results          {folder}")

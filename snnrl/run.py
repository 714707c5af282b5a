"""The main job: compose, build, simulate, record, summarise.

python -m snnrl.run +experiment=NAME [robot=NAME] [trials=N] [seconds=S] [seed=K] [engine=...] [device=...]
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from snnrl.analysis.criteria import correct
from snnrl.builder import build, build_task
from snnrl.config import conf_dir, plain
from snnrl.engines import Engine, make_engine
from snnrl.loop import Simulation, TaskSimulation
from snnrl.record import Recorder, write, write_json
from snnrl.record_task import TaskRecorder
from snnrl.schema import Config, ConfigError


class Progress:
    """One line about a run: on a terminal it is redrawn, in a log it is repeated at every tenth."""

    def __init__(self, name: str, trials: int, seconds: float) -> None:
        self.name, self.trials, self.seconds = name, trials, seconds
        self.started = self.shown = time.perf_counter()
        self.tenth = 0
        self.redraws = sys.stderr.isatty()

    def show(self, done: float, state: str) -> None:
        """`done` simulated seconds of each trial; `state` is what they came to."""
        now = time.perf_counter()
        part = min(done / self.seconds, 1.0)
        due = now - self.shown > 0.2 or part == 1.0 if self.redraws else part * 10 >= self.tenth + 1
        if not due:
            return
        self.shown, self.tenth = now, int(part * 10)
        wall = now - self.started
        speed = self.trials * done / wall
        left = wall * (1.0 - part) / part
        line = (
            f"{self.name}  {part:4.0%}  {done:.0f} of {self.seconds:.0f} s  {state}  "
            f"{speed / 1000.0:.2f} million trial-ms/s, {speed:,.0f} x real time  {left:.0f} s left"
        )
        end = "\r" if self.redraws and part < 1.0 else "\n"
        print(f"{line:<{shutil.get_terminal_size().columns - 1}}" if self.redraws else line, end=end, file=sys.stderr)


def simulate(config: Config, simulation: Simulation, engine: Engine, folder: Path) -> dict[str, Any]:
    """Run a built simulation to its end; writes its results to `folder` and returns the summary."""
    tick = simulation.coding.tick
    ticks = max(1, round(1000 * config.seconds / tick))
    every = max(1, round(1000 * config.record.every / tick))
    recorder = Recorder(simulation, folder if config.record.tensorboard else None)
    progress = Progress(f"{config.experiment.name} {config.robot.name}", config.trials, config.seconds)
    started = time.perf_counter()
    for done in range(0, ticks, every):
        engine.run(simulation, min(every, ticks - done))
        rate = recorder.sample()
        progress.show(int(simulation.network.time) / 1000.0, f"{rate:.2f} food/s")
    wall = time.perf_counter() - started
    rules = config.experiment.correct
    learnt = correct(simulation.network, rules) if rules else None
    recorder.save(folder, learnt)
    food = simulation.world.touches[:, 0].double()
    summary = {
        "experiment": config.experiment.name,
        "robot": config.robot.name,
        "trials": config.trials,
        "trial_start": config.trial_start,
        "seconds": ticks * tick / 1000.0,
        "seed": config.seed,
        "engine": engine.name,
        "device": config.device,
        "dtype": config.dtype,
        "food_mean": float(food.mean()),
        "food_sd": float(food.std()) if config.trials > 1 else None,
        "correct_fraction": None if learnt is None else float(learnt.double().mean()),
        "mean_weight": {p.name: float(p.mean_weight().mean()) for p in simulation.network.projections.values()},
        "wall_s": wall,
        "trial_ms_per_s": config.trials * ticks * tick / wall,
        "versions": versions(),
    }
    write_json(folder / "summary.json", summary)
    return summary


class _Refused(BaseException):
    """Carries a ConfigError past Hydra, which would print lines of its own about it."""


def job(composed: DictConfig) -> float:
    """One Hydra job; returns the mean food collected, so that a sweeper can optimise it."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    try:
        config = plain(composed)
        simulation = build(config) if config.task is None else build_task(config)
        engine = make_engine(config.engine, config.device, config.threads)
    except ConfigError as error:
        discard(folder)
        if HydraConfig.get().mode == RunMode.RUN:
            raise _Refused from error
        raise
    if config.threads:
        torch.set_num_threads(config.threads)
    write(folder / "config.yaml", OmegaConf.to_yaml(composed, resolve=True))
    if isinstance(simulation, TaskSimulation):
        return simulate_task(config, simulation, engine, folder)
    summary = simulate(config, simulation, engine, folder)
    report(summary, folder)
    return float(summary["food_mean"])


def report(summary: dict[str, Any], folder: Path) -> None:
    """Print the result of a run in a few lines."""
    spread = "" if summary["food_sd"] is None else f" (SD {summary['food_sd']:.1f})"
    learnt = summary["correct_fraction"]
    print(f"{summary['experiment']}, {summary['robot']}: {summary['trials']} trials x {summary['seconds']:.0f} s")
    print(f"  food collected   {summary['food_mean']:.1f}{spread}")
    if learnt is not None:
        print(f"  learnt           {learnt:.0%} of trials")
    print(f"  took             {summary['wall_s']:.1f} s, {summary['trial_ms_per_s'] / 1e6:.2f} million trial-ms/s")
    print(f"  results          {folder}")


def simulate_task(config: Config, simulation: TaskSimulation, engine: Engine, folder: Path) -> float:
    """Run a built task to its end, write its results to `folder` and print them; returns the mean of rewards."""
    if engine.name == "fused":
        torch.set_num_threads(1)  # what is left to torch is small; more threads only wait for each other
    tick = simulation.task.tick
    ticks = max(1, round(1000 * config.seconds / tick))
    every = max(1, round(1000 * config.record.every / tick))
    recorder = TaskRecorder(simulation, folder if config.record.tensorboard else None)
    progress = Progress(f"{config.experiment.name} {config.robot.name}", config.trials, config.seconds)
    started = time.perf_counter()
    for done in range(0, ticks, every):
        simulation.run(engine.run_network, min(every, ticks - done))
        recorder.sample()
        rewards = float(simulation.task.reward.given.double().mean())
        progress.show(int(simulation.network.time) / 1000.0, f"{rewards:.1f} rewards")
    wall = time.perf_counter() - started
    results = recorder.save(folder)
    summary = {
        "experiment": config.experiment.name,
        "robot": config.robot.name,
        "trials": config.trials,
        "trial_start": config.trial_start,
        "seconds": ticks * tick / 1000.0,
        "seed": config.seed,
        "engine": engine.name,
        "device": config.device,
        "dtype": config.dtype,
        **results,
        "wall_s": wall,
        "trial_ms_per_s": config.trials * ticks * tick / wall,
        "versions": versions(),
    }
    write_json(folder / "summary.json", summary)
    print(f"{config.experiment.name}, {config.robot.name}: {config.trials} trials x {summary['seconds']:.0f} s")
    for key, value in results.items():
        print(f"  {key.replace('_', ' '):<16} {value:.4g}")
    print(f"  took             {wall:.1f} s")
    print(f"  results          {folder}")
    return results["rewards"]


def versions() -> dict[str, str]:
    """Of what a run depends on."""
    packages = ("snnrl", "torch", "numpy", "numba", "hydra-core")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def discard(folder: Path) -> None:
    """Remove the run folder that Hydra has just made, and folders above it in here that are left empty."""
    shutil.rmtree(folder / ".hydra", ignore_errors=True)
    for empty in (folder, *folder.parents):
        if (Path.cwd() not in empty.parents and empty != folder) or any(empty.iterdir()):
            return
        empty.rmdir()


def explain(error: BaseException | None) -> str:
    """A configuration error in one line: key, value, what is allowed."""
    cause = error
    while cause is not None:
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            if "experiment.name" in str(cause) or cause.full_key == "experiment.name":
                names = sorted(path.stem for path in Path(conf_dir(), "experiment").glob("*.yaml"))
                return f"experiment: must be given as +experiment=NAME, NAME one of {', '.join(names)}"
            text = str(cause).splitlines()[0]
            if is_dataclass(cause.object_type) and ("not in" in text or "not a" in text):
                allowed = ", ".join(field.name for field in fields(cause.object_type))
                return f"{cause.full_key}: no such key; allowed here: {allowed}"
            return f"{cause.full_key}: {text}"
        cause = cause.__cause__
    text, _, _ = str(error).partition("Config search path")
    return " ".join(text.split())


def main() -> None:
    """Run the command line; on bad input one clear line and exit status 2 (all of it with HYDRA_FULL_ERROR=1)."""
    wants_traceback = os.environ.get("HYDRA_FULL_ERROR") == "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then hands its errors on instead of printing them
    try:
        hydra.main(version_base="1.3", config_path=conf_dir(), config_name="config")(job)()
    except (ConfigError, HydraException, OmegaConfBaseException, _Refused) as error:
        if wants_traceback:
            raise
        print(f"snnrl.run: {explain(error.__cause__ if isinstance(error, _Refused) else error)}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()

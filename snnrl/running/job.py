"""One run in its folder: build, simulate, record, summarise; stopped at any moment, it goes on from its checkpoint.

A run folder belongs to one configuration. Until the run is complete it holds `config.yaml`, TensorBoard events
and checkpoints, once there are some; what stopped it is in `summary.json`. Complete, it holds the results,
and `summary.json`, written last, says so.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from snnrl.configuration import footprint
from snnrl.configuration.builder import build
from snnrl.configuration.compose import dump, load
from snnrl.engines import Engine, make_engine
from snnrl.engines.watched import WatchedEngine
from snnrl.extras import lacks
from snnrl.files import FolderError, finite, owned, write, write_json
from snnrl.recording.kept import kept_of
from snnrl.recording.logger import About, Logger
from snnrl.recording.monitors import Monitor, monitors_of
from snnrl.recording.recorder import Recorder
from snnrl.recording.shown import choices
from snnrl.running import checkpoint
from snnrl.running.beside import Beside
from snnrl.running.checkpoint import Checkpoint, difference, settings
from snnrl.running.loggers import loggers_of
from snnrl.running.progress import Progress
from snnrl.running.schedule import Due, Schedule
from snnrl.running.signals import Interrupted, Pace, Signals
from snnrl.schema import Config
from snnrl.simulation import Simulation


def perform(config: Config, folder: Path, overrides: Sequence[str] = (), threads: int = 0) -> dict[str, Any]:
    """Begin the run in a folder, or go on with it, or find it complete; returns its summary.

    Args:
        config: of the run.
        folder: exists; is made the run's own.
        overrides: how the command line named the run, for the summary.
        threads: for a configuration that leaves them open; 0 is one per processor.

    Raises:
        ConfigError: names the first value that is out of bounds or contradicts another.
        FolderError: another process works in the folder, it holds a run with other settings, or its checkpoint
            cannot be used; it is left as it was.
        Interrupted: SIGINT or SIGTERM came; the state is saved.
        OSError: something could not be written; what was saved before is as it was.
    """
    simulation = build(config)
    monitors, loggers = _monitors(config, simulation), loggers_of(config.record)
    engine = _engine(config, threads, monitors)
    with owned(folder), Signals() as signals:
        if _is_complete(folder, config):
            return read_summary(folder)
        saved = checkpoint.load(folder, config, simulation)
        _begin(folder, config, overrides)
        try:
            for _ in simulate(config, simulation, engine, folder, saved, signals, monitors, loggers):
                pass
        except (Exception, KeyboardInterrupt) as error:
            with suppress(OSError):
                mark_incomplete(folder, error)
            raise
    if signals.received:
        raise Interrupted(signals.received, f"{folder}: complete when {signals.received.name} came")
    return read_summary(folder)


def _monitors(config: Config, simulation: Simulation[Any]) -> list[Monitor]:
    """What the configuration wants to have watched; raises ConfigError for what is not there, or too much."""
    monitors, ms = monitors_of(simulation.network, config.record.monitors), 1000 * config.seconds
    footprint.check({f"record.monitors.{monitor.name}.every": monitor.size(ms) for monitor in monitors})
    return monitors


def _engine(config: Config, threads: int, monitors: Sequence[Monitor]) -> Engine:
    """The engine of a run, seen by its monitors, with its threads and torch's; `threads` where they are left open."""
    threads = config.threads or threads
    engine = make_engine(config.engine, config.device, threads)
    if engine.name == "fused":
        torch.set_num_threads(1)  # what is left to torch is small; more threads only wait for each other
    elif threads:
        torch.set_num_threads(threads)
    return WatchedEngine(engine, monitors) if monitors else engine


def _is_complete(folder: Path, config: Config) -> bool:
    """Whether the run in a folder is; raises FolderError if it is another one."""
    if not (folder / "config.yaml").exists():
        return False
    if differs := difference(settings(load(folder / "config.yaml")), settings(config)):
        raise FolderError(f"{folder}: holds another run ({differs})")
    if not read_summary(folder)["complete"]:
        return False
    checkpoint.remove(folder)  # which its process may not have come to
    return True


def _begin(folder: Path, config: Config, overrides: Sequence[str]) -> None:
    """Have a folder say which run it is for."""
    if not (folder / "config.yaml").exists():
        write_json(folder / "summary.json", {"complete": False, **description(config), "overrides": list(overrides)})
        write(folder / "config.yaml", dump(config))


def read_summary(folder: Path) -> dict[str, Any]:
    """What summary.json holds.

    Raises:
        FolderError: there is none, or it is none.
    """
    try:
        summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
        return {**summary, "complete": bool(summary["complete"])}
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        raise FolderError(f"{folder}: summary.json is missing or not that of a run") from None


def mark_incomplete(folder: Path, error: BaseException) -> None:
    """Say in summary.json why the run ended."""
    summary = read_summary(folder)
    if not summary["complete"]:
        write_json(folder / "summary.json", {**summary, "stopped": str(error) or type(error).__name__})


def description(config: Config) -> dict[str, Any]:
    """What a summary says of a run before it has run."""
    return {
        "experiment": config.experiment.name,
        "robot": config.robot.name,
        "trials": config.trials,
        "trial_start": config.trial_start,
        "seconds": config.seconds,
        "seed": config.seed,
        "engine": config.engine,
        "device": config.device,
        "dtype": config.dtype,
    }


def simulate(
    config: Config,
    simulation: Simulation[Any],
    engine: Engine,
    folder: Path,
    saved: Checkpoint | None,
    signals: Signals,
    monitors: Sequence[Monitor] = (),
    loggers: Mapping[str, Logger] | None = None,
) -> Iterator[float]:
    """Run a simulation from where it is to its end, and write its results to `folder`.

    Time is advanced here and nowhere else: as far as the next thing that is due, or less, so that a signal is noticed.
    Yields the simulated s that are done, after each part.
    """
    config, left_out = what_can_be_shown(config, bool(loggers))
    beside = Beside(simulation)
    overrides, kept = read_summary(folder)["overrides"], kept_of(beside.copy, config.experiment.correct)
    schedule = Schedule(config, simulation.tick, kept.watched and bool(loggers))
    about = About(folder, config.experiment.name, choices(settings(config), overrides))
    wall, past = (saved.wall, saved.recorder) if saved else (0.0, None)
    recorder = Recorder(beside.copy, kept, config.record, about, past, monitors, loggers)
    progress = Progress(f"{about.name} {config.robot.name}", config.trials, config.seconds, wall)
    for line in left_out:
        progress.say(line)
    with progress.preparing() as compiling:
        engine.prepare(simulation.network, simulation.situation, compiling)
    done, pace = int(simulation.network.time) // simulation.tick, Pace()
    with progress.running(simulation.seconds), beside:
        while done < schedule.end:
            ticks = min(pace.ticks, schedule.left(done))
            raster = recorder.film.raster(ticks) if schedule.filmed(done) else None
            with pace:
                simulation.run(engine, ticks, raster)
            done += ticks
            due = schedule.due(done)
            beside.begin(partial(_record, recorder, raster, due, progress))
            if due.checkpoint or signals.received:
                beside.wait()
                state = Checkpoint(settings(config), simulation.state_dict(), recorder.state_dict(), progress.wall)
                checkpoint.save(folder, state)
            if signals.received:
                at = f"at {simulation.seconds:g} of {config.seconds:g} s"
                raise Interrupted(signals.received, f"stopped by {signals.received.name} {at}")
            yield simulation.seconds
        beside.wait()
    wall = progress.wall
    results, alarms = recorder.save()
    write_json(folder / "summary.json", _summary(config, simulation, engine, overrides, results, alarms, wall))
    checkpoint.remove(folder)


def what_can_be_shown(config: Config, logged: bool) -> tuple[Config, list[str]]:
    """The configuration without the pictures that nothing here can draw, and a line about all that is left out.

    Args:
        logged: whether there are loggers, to which pictures would go.
    """
    lines = []
    if config.record.tensorboard and (line := lacks("dashboards")):
        lines.append(f"record.tensorboard=true: no events are written, which {line}")
    if logged and find_spec("PIL") is None:
        lines.append("record.pictures: none are drawn, which needs pip install pillow")
        config = replace(config, record=replace(config.record, pictures=0.0))
    if config.task is not None and (line := lacks("figures")):
        lines.append(f"no figure is drawn, which {line}")
    return config, lines


def _record(recorder: Recorder, raster: Tensor | None, due: Due, progress: Progress) -> None:
    """All that is due but a checkpoint, in its order; `raster` says who has fired since the last time, if filmed."""
    if raster is None:
        recorder.film.forget()
    else:
        recorder.film.keep(raster)
    if due.point:
        recorder.point()
    if due.sample:
        for line in recorder.sample(due.scalars):
            progress.say(line)
        progress.show(recorder.simulation.seconds, recorder.told)
    if due.histograms:
        recorder.histograms()
    if due.picture:
        recorder.picture()


def _summary(
    config: Config,
    simulation: Simulation[Any],
    engine: Engine,
    overrides: Sequence[str],
    results: dict[str, float | None],
    alarms: dict[str, Any],
    wall: float,
) -> dict[str, Any]:
    """What summary.json holds of a complete run."""
    seconds = simulation.seconds
    return {
        **description(config),
        "overrides": overrides,
        "complete": True,
        "seconds": seconds,
        "engine": engine.name,
        "results": results,
        "mean_weight": {p.name: finite(float(p.mean_weight().mean())) for p in simulation.network.projections.values()},
        "alarms": alarms,
        "wall_s": wall,
        "trial_ms_per_s": config.trials * 1000.0 * seconds / wall,
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("snnrl", "torch", "numpy", "numba", "hydra-core")},
        },
    }

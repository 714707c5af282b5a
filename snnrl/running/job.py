"""One run in its folder: build, simulate, record, summarise; stopped at any moment, it goes on from its checkpoint.

A run folder belongs to one configuration. Until the run is complete it holds `config.yaml`, TensorBoard events
and checkpoints, once there are some; what stopped it is in `summary.json`. Complete, it holds the results,
and `summary.json`, written last, says so.
"""

from __future__ import annotations

import json
import platform
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Any

import torch

from snnrl.configuration.builder import build
from snnrl.configuration.compose import dump, load
from snnrl.configuration.schema import Config
from snnrl.engines import Engine, make_engine
from snnrl.files import FolderError, finite, owned, write, write_json
from snnrl.recording.board import choices
from snnrl.recording.criteria import correct
from snnrl.recording.recorder import Recorder, keep_events, ticks_of
from snnrl.recording.task_recorder import TaskRecorder
from snnrl.running import checkpoint
from snnrl.running.checkpoint import Checkpoint, difference, settings
from snnrl.simulation import Simulation
from snnrl.tasks.task import Task

SLICE = 0.5  # s of wall time between two looks for a signal


class Interrupted(Exception):
    """The run was told to stop by a signal, and has saved its state.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int, message: str) -> None:
        super().__init__(number, message)
        self.number, self.message = number, message

    def __str__(self) -> str:
        return self.message


class Signals:
    """Remembers SIGINT or SIGTERM while the context lasts; a second one has its usual effect."""

    received: signal.Signals | None = None

    def __enter__(self) -> Signals:
        self._usual = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._usual[number] = signal.signal(number, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        for number, usual in self._usual.items():
            signal.signal(number, usual)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self.received = signal.Signals(number)
        self.__exit__()


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
        self._print(line, "\r" if self.redraws and part < 1.0 else "\n")

    def say(self, line: str) -> None:
        """A line that stays."""
        self._print(f"{self.name}  {line}", "\n")

    def _print(self, line: str, end: str) -> None:
        print(f"{line:<{shutil.get_terminal_size().columns - 1}}" if self.redraws else line, end=end, file=sys.stderr)


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
    threads = config.threads or threads
    engine = make_engine(config.engine, config.device, threads)
    if engine.name == "fused":
        torch.set_num_threads(1)  # what is left to torch is small; more threads only wait for each other
    elif threads:
        torch.set_num_threads(threads)
    with owned(folder), Signals() as signals:
        begun = (folder / "config.yaml").exists()
        if begun:
            if differs := difference(settings(load(folder / "config.yaml")), settings(config)):
                raise FolderError(f"{folder}: holds another run ({differs})")
            if read_summary(folder)["complete"]:
                checkpoint.remove(folder)  # which its process may not have come to
                return read_summary(folder)
        saved = checkpoint.load(folder, config, simulation)
        if begun:
            keep_events(folder, saved.recorder["events"] if saved else 0)
        else:
            write_json(
                folder / "summary.json", {"complete": False, **description(config), "overrides": list(overrides)}
            )
            write(folder / "config.yaml", dump(config))
        try:
            for _ in simulate(config, simulation, engine, folder, saved, signals):
                pass
        except (Exception, KeyboardInterrupt) as error:
            with suppress(OSError):
                mark_incomplete(folder, error)
            raise
    if signals.received:
        raise Interrupted(signals.received, f"{folder}: complete when {signals.received.name} came")
    return read_summary(folder)


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
) -> Iterator[float]:
    """Run a simulation from where it is to its end, and write its results to `folder`.

    Yields the simulated s that are done, after each part.
    """
    tick = simulation.tick
    ticks, sampled, saves = (
        ticks_of(seconds, tick) for seconds in (config.seconds, config.record.every, config.checkpoint.every)
    )
    overrides = read_summary(folder)["overrides"]
    rules = config.experiment.correct
    begun = saved.recorder if saved else None
    recorder: Recorder | TaskRecorder
    if isinstance(simulation.situation, Task):
        recorder = TaskRecorder(simulation, folder, config.record.tensorboard, begun)
    else:
        learnt = partial(correct, simulation.network, rules) if rules else None
        named = choices(overrides, experiment=config.experiment.name, robot=config.robot.name, seed=config.seed)
        recorder = Recorder(simulation, config.record, ticks, folder, learnt, named, begun)
    progress = Progress(f"{config.experiment.name} {config.robot.name}", config.trials, config.seconds)
    progress.started -= saved.wall if saved else 0.0
    first = round(1000 * config.record.start / tick)
    done, pace = int(simulation.network.time) // tick, 1
    while done < ticks:
        part = min(
            pace,
            recorder.most(done),
            sampled - (done - first) % sampled,
            *(n - done % n for n in (ticks, saves) if n),
        )
        began = time.perf_counter()
        recorder.advance(engine, done, part)
        done += part
        pace = pace * 2 if time.perf_counter() - began < SLICE else max(1, pace // 2)
        if (done >= first and (done - first) % sampled == 0) or done == ticks:
            state, alarms = recorder.sample()
            for line in alarms:
                progress.say(line)
            progress.show(done * tick / 1000.0, state)
        recorder.show(done)
        if signals.received or (saves and done % saves == 0):
            wall = time.perf_counter() - progress.started
            checkpoint.save(folder, Checkpoint(settings(config), simulation.state_dict(), recorder.state_dict(), wall))
        if signals.received:
            at = f"at {done * tick / 1000.0:g} of {config.seconds:g} s"
            raise Interrupted(signals.received, f"stopped by {signals.received.name} {at}")
        yield done * tick / 1000.0
    wall = time.perf_counter() - progress.started
    results, alarmed = recorder.save()
    summary = {
        **description(config),
        "overrides": overrides,
        "complete": True,
        "seconds": ticks * tick / 1000.0,
        "engine": engine.name,
        "results": results,
        "mean_weight": {p.name: finite(float(p.mean_weight().mean())) for p in simulation.network.projections.values()},
        "alarms": alarmed,
        "wall_s": wall,
        "trial_ms_per_s": config.trials * ticks * tick / wall,
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("snnrl", "torch", "numpy", "numba", "hydra-core")},
        },
    }
    write_json(folder / "summary.json", summary)
    checkpoint.remove(folder)

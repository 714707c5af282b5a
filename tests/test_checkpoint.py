"""A run that is stopped at any moment and goes on is the run that was never stopped."""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import shutil
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers import SMALL_TASK, compose_config
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from snnrl import files, run
from snnrl.engines.fused import FusedEngine
from snnrl.files import FolderError, owned, write
from snnrl.recording import board as board_file
from snnrl.running import checkpoint, job
from snnrl.running.command import status
from snnrl.running.job import perform
from snnrl.running.signals import Interrupted
from snnrl.schema import Config

OVERRIDES = ("+experiment=food_attraction", "trials=2", "seconds=21", "record.every=5", "threads=1", "seed=3")
SHOWN = ("record.histograms=4", "record.pictures=15")
WALL = ("wall_s", "trial_ms_per_s")


class Killed(BaseException):
    """Ends a run as SIGKILL would: nothing tidies up behind it."""


def make(*overrides: str) -> Config:
    return compose_config(*OVERRIDES, *SHOWN, "checkpoint.every=3", *overrides)


def new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}


def summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


def board(folder: Path) -> dict[str, list[tuple[int, Any]]]:
    """All that TensorBoard could show."""
    limits = {"scalars": 0, "images": 0, "histograms": 0, "tensors": 0}
    events = EventAccumulator(str(folder), limits).Reload()
    read = {
        "scalars": lambda tag: [(event.step, event.value) for event in events.Scalars(tag)],
        "images": lambda tag: [(event.step, event.encoded_image_string) for event in events.Images(tag)],
        "histograms": lambda tag: [(event.step, event.histogram_value) for event in events.Histograms(tag)],
        "tensors": lambda tag: [(event.step, event.tensor_proto) for event in events.Tensors(tag)],
    }
    return {tag: values(tag) for kind, values in read.items() for tag in events.Tags()[kind]}


def results(folder: Path) -> dict[str, Any]:
    """All that a complete run leaves, less wall times."""
    left = contents(folder)
    events = [name for name in left if "tfevents" in name]
    known = {key: value for key, value in summary(folder).items() if key not in WALL}
    rest = {name: left[name] for name in left if name not in events and name not in ("summary.json", "config.yaml")}
    return {**rest, "summary": known, "board": board(folder)}


def kill_at(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, call: int, after: bool = True) -> None:
    """Kill the run at a call of a function: when it has returned, or before it does anything."""
    usual: Callable[..., Any] = getattr(module, name)
    calls = []

    def wrapped(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == call and not after:
            raise Killed
        result = usual(*arguments)
        if len(calls) == call:
            raise Killed
        return result

    monkeypatch.setattr(module, name, wrapped)


def kill(folder: Path, config: Config, *where: Any, **options: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        kill_at(patch, *where, **options)
        with pytest.raises(Killed):
            perform(config, folder)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Results of a run without interruption and without checkpoints."""
    folder = tmp_path_factory.mktemp("whole")
    perform(compose_config(*OVERRIDES, *SHOWN), folder)
    return results(folder)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was killed after its fourth checkpoint, at 12 of 21 s."""
    folder = tmp_path_factory.mktemp("stopped")
    kill(folder, make(), checkpoint, "save", 4)
    return folder


@pytest.mark.parametrize(
    ("module", "name", "call", "after"),
    [
        (FusedEngine, "run", 2, True),  # before the first checkpoint
        (checkpoint, "save", 2, True),  # at 6 s, between two samples
        (os, "replace", 4, False),  # the second checkpoint is written, the first still in its place
        (os, "replace", 4, True),  # the first is out of the way, the second not yet in place
        (os, "replace", 7, True),  # the third is in place, the folder not yet synced
        (files, "sync", 9, False),
        (job.Recorder, "sample", 3, True),  # events on the disk that are after the last checkpoint
        (job.Recorder, "save", 1, True),  # series.npz and trials.csv are there, summary.json is not complete
    ],
)
def test_killed_anywhere_it_ends_the_same(
    tmp_path: Path, whole: dict[str, Any], module: Any, name: str, call: int, after: bool
) -> None:
    folder = new(tmp_path / "run")
    kill(folder, make(), module, name, call, after=after)
    assert not summary(folder)["complete"]
    perform(make(), folder)
    assert results(folder) == whole


def test_killed_again_and_again_it_ends_the_same(tmp_path: Path, whole: dict[str, Any], stopped: Path) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    kill(folder, make(), job.Recorder, "sample", 1)
    kill(folder, make(), checkpoint, "save", 1)
    kill(folder, make(), board_file, "keep_events", 1)
    perform(make("threads=2"), folder)
    assert results(folder) == whole


def test_a_task_that_is_killed_ends_the_same(tmp_path: Path) -> None:
    options = ["+experiment=distal_reward", *SMALL_TASK, "trials=2", "seconds=5", "record.every=1.5", "threads=1"]
    perform(compose_config(*options), new(tmp_path / "whole"))
    for call, name in enumerate(("first", "second"), 1):
        config = compose_config(*options, "checkpoint.every=1")
        folder = new(tmp_path / name)
        kill(folder, config, checkpoint, "save", 2 * call)
        perform(config, folder)
        assert results(folder) == results(tmp_path / "whole")


def test_wall_time_is_that_of_all_parts(tmp_path: Path, stopped: Path) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    config = make()
    saved = checkpoint.load(folder, config, job.build(config))
    assert saved is not None
    assert saved.wall > 0
    assert perform(config, folder)["wall_s"] > saved.wall


def test_without_an_interval_there_is_no_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kill_at(monkeypatch, checkpoint, "save", 1)
    for every in ("0", "null"):
        perform(make(f"checkpoint.every={every}", "seconds=7"), new(tmp_path / every))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_the_state_and_says_so(
    tmp_path: Path, whole: dict[str, Any], monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    usual = signal.getsignal(number)
    folder = new(tmp_path / "run")
    config = make("checkpoint.every=0")

    def slow(self: FusedEngine, network: Any, situation: Any, ticks: int, raster: Any = None) -> None:
        FusedEngine.run(self, network, situation, ticks, raster)
        if int(network.time) > 8000:
            signal.raise_signal(number)

    class Signalled(FusedEngine):
        run = slow

    with monkeypatch.context() as patch:
        patch.setattr(job, "make_engine", lambda *_: Signalled(1))
        with pytest.raises(Interrupted) as caught:
            perform(config, folder)
    assert status(caught.value) == 128 + number
    assert signal.getsignal(number) is usual
    said = summary(folder)
    assert not said["complete"]
    assert number.name in said["stopped"]
    assert (folder / checkpoint.FILE).exists()
    perform(config, folder)
    assert results(folder) == whole


def forged(head: bytes, content: bytes) -> bytes:
    return head + b" " + hashlib.sha256(content).hexdigest().encode() + b"\n" + content


class Malice:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("executed",)


def hostile(_: bytes) -> bytes:
    buffer = io.BytesIO()
    torch.save({"config": Malice()}, buffer)
    return forged(b"snnrl checkpoint 1", buffer.getvalue())


def flipped(good: bytes) -> bytes:
    middle = len(good) // 2
    return good[:middle] + bytes([good[middle] ^ 1]) + good[middle + 1 :]


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda good: good.replace(b"checkpoint 1", b"checkpoint 2", 1), "format 2 is newer"),
        (lambda good: forged(b"snnrl checkpoint 1", pickle.dumps({"wall": 1.0}, protocol=2)), "not written by snnrl"),
        (hostile, "not written by snnrl"),
    ],
)
def test_a_bad_checkpoint_is_refused_and_nothing_is_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stopped: Path, harm: Callable[[bytes], bytes], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    path = folder / checkpoint.FILE
    path.write_bytes(harm(path.read_bytes()))
    before = contents(folder)
    with pytest.raises(FolderError) as caught:
        perform(make(), folder)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert contents(folder) == before
    assert [child.name for child in tmp_path.iterdir()] == ["run"]


DAMAGES = [
    (lambda good: b"", "damaged, or not a checkpoint"),
    (lambda good: good[:50], "damaged, or not a checkpoint"),
    (lambda good: good[:-1], "damaged (its checksum does not fit)"),
    (flipped, "damaged (its checksum does not fit)"),
]


def harm_files(folder: Path, harm: Callable[[bytes], bytes], *names: str) -> None:
    for name in names:
        (folder / name).write_bytes(harm((folder / name).read_bytes()))


@pytest.mark.parametrize(("harm", "message"), DAMAGES)
def test_from_a_damaged_checkpoint_a_run_goes_on_with_the_one_before(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    whole: dict[str, Any],
    stopped: Path,
    harm: Callable[[bytes], bytes],
    message: str,
) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    harm_files(folder, harm, checkpoint.FILE)
    kill(folder, make(), job.Recorder, "sample", 1)  # it has begun again where the third checkpoint was, at 9 s
    line = f"{folder / checkpoint.FILE}: {message}; going on from the one before, {checkpoint.PREVIOUS}"
    assert line in capsys.readouterr().err.splitlines()
    saved = checkpoint.load(folder, make(), simulation := job.build(make()))
    assert saved is not None
    assert int(simulation.network.time) == pytest.approx(9000, abs=35)
    perform(make(), folder)
    assert "damaged" not in capsys.readouterr().err
    assert results(folder) == whole


@pytest.mark.parametrize(("harm", "message"), DAMAGES)
def test_when_all_checkpoints_are_damaged_nothing_is_changed(
    tmp_path: Path, stopped: Path, harm: Callable[[bytes], bytes], message: str
) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    harm_files(folder, harm, checkpoint.FILE, checkpoint.PREVIOUS)
    before = contents(folder)
    with pytest.raises(FolderError) as caught:
        perform(make(), folder)
    both = [f"{folder / name}: {message}" for name in (checkpoint.FILE, checkpoint.PREVIOUS)]
    assert str(caught.value) == "; ".join(both)
    assert contents(folder) == before


def test_one_before_that_cannot_be_used_is_refused(tmp_path: Path, stopped: Path) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    harm_files(folder, flipped, checkpoint.FILE)
    harm_files(folder, hostile, checkpoint.PREVIOUS)
    before = contents(folder)
    with pytest.raises(FolderError, match=rf"{checkpoint.PREVIOUS}: not written by snnrl"):
        perform(make(), folder)
    assert contents(folder) == before


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("call", range(1, 8))
def test_killed_at_any_step_of_saving_a_good_checkpoint_is_there(tmp_path: Path, call: int, after: bool) -> None:
    """Four checkpoints are saved, in seven steps; then the newest that is there is damaged."""
    config = make()
    simulation = job.build(config)

    def save_all() -> None:
        for number in (1.0, 2.0, 3.0, 4.0):
            state = checkpoint.Checkpoint(checkpoint.settings(config), simulation.state_dict(), {}, number)
            checkpoint.save(tmp_path, state)

    def restored() -> float:
        saved = checkpoint.load(tmp_path, config, simulation)
        return 0.0 if saved is None else saved.wall

    with pytest.MonkeyPatch.context() as patch:
        kill_at(patch, os, "replace", call, after=after)
        with pytest.raises(Killed):
            save_all()
    done = (call + after) // 2  # of the checkpoints, whose last steps are 1, 3, 5 and 7
    assert restored() == done
    if (tmp_path / checkpoint.FILE).exists() and (tmp_path / checkpoint.PREVIOUS).exists():
        harm_files(tmp_path, flipped, checkpoint.FILE)
        assert restored() == done - 1


def test_a_complete_run_leaves_no_checkpoint(tmp_path: Path, stopped: Path) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "run"))
    assert {checkpoint.FILE, checkpoint.PREVIOUS} <= set(contents(folder))
    kill(folder, make(), checkpoint, "remove", 1, after=False)
    assert summary(folder)["complete"]
    assert {checkpoint.FILE, checkpoint.PREVIOUS} <= set(contents(folder))
    perform(make(), folder)
    assert not {checkpoint.FILE, checkpoint.PREVIOUS} & set(contents(folder))


def test_another_runs_checkpoint_is_refused(tmp_path: Path, stopped: Path) -> None:
    folder = new(tmp_path / "run")
    other = make("network.dopamine.delay=6")
    kill(folder, other, checkpoint, "save", 1)
    shutil.copy(stopped / checkpoint.FILE, folder)
    before = contents(folder)
    with pytest.raises(FolderError, match=r"of another run \(network.dopamine.delay=5 there, .*=6 here\)"):
        perform(other, folder)
    assert contents(folder) == before


def test_a_folder_belongs_to_one_configuration(stopped: Path) -> None:
    before = contents(stopped)
    with pytest.raises(FolderError, match=r"holds another run \(trials=2 there, trials=3 here\)"):
        perform(make("trials=3"), stopped)
    assert contents(stopped) == before


def test_a_complete_run_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = make("seconds=1")
    first = perform(config, tmp_path)
    before = contents(tmp_path)
    kill_at(monkeypatch, FusedEngine, "run", 1, after=False)
    assert perform(config, tmp_path) == first
    assert contents(tmp_path) == before


def test_a_folder_has_one_owner_at_a_time(tmp_path: Path) -> None:
    with owned(tmp_path):
        with pytest.raises(FolderError, match=f"in use by process {os.getpid()} on "), owned(tmp_path):
            pass
        with pytest.raises(FolderError, match="in use"):
            perform(make(), tmp_path)
    with owned(tmp_path):
        pass


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write(path, "old")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=f"No space left on device: '{path}'"):
        write(path, "new")
    assert contents(tmp_path) == {"file": b"old"}


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["resume=run"], 0, ""),
        (["resume=nowhere"], 2, "snnrl.run: resume=nowhere: no run folder (there is no config.yaml in it)"),
        (["resume=run", "seed=4"], 2, "snnrl.run: resume=run: goes alone, its config.yaml says the rest"),
    ],
)
def test_resume_from_the_command_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    whole: dict[str, Any],
    stopped: Path,
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    shutil.copytree(stopped, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.setattr(sys, "argv", ["snnrl.run", *arguments])
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    if code:
        with pytest.raises(SystemExit) as caught:
            run.main()
        assert caught.value.code == code
        assert capsys.readouterr().err.strip() == message
    else:
        run.main()
        assert "food collected" in capsys.readouterr().out
        assert results(tmp_path / "run") == whole

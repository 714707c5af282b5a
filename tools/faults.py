"""Do to runs what happens to them in the end, many times, and count how they took it.

    python tools/faults.py [--times 100] [--only kill damage ...] [--seed 0] [--folder DIR]

Every case starts the command line in a process of its own (forked, so that a start is cheap) and compares what
it leaves with an undisturbed run: series.npz and trials.csv byte by byte, summary.json but for wall times, and
the TensorBoard scalars in their order. Exit status 1 if any case went wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import make_engine
from snnrl.run import main as command
from snnrl.running import checkpoint

RUN = ["+experiment=food_attraction", "trials=2", "seconds=60", "threads=1", "record.every=3", "checkpoint.every=1"]
WALL = ("wall_s", "trial_ms_per_s")
CHECKPOINTS = (checkpoint.FILE, checkpoint.PREVIOUS)


@dataclass(frozen=True)
class Ended:
    """How a process ended: its exit status (negative: killed by that signal) and what it said on stderr."""

    status: int
    errors: str

    def refused(self, status: int) -> bool:
        """Whether it ended with this status and one line."""
        return self.status == status and len(self.errors.strip().splitlines()) == 1


class Started:
    """The command line in a forked process; its clock is set `late` by so many seconds."""

    def __init__(self, place: Path, *arguments: str, late: float = 0.0) -> None:
        self.log = place / "stderr"
        self.began = time.monotonic()
        self.pid = os.fork()
        if self.pid == 0:
            os._exit(self._child(place, list(arguments), late))

    def _child(self, place: Path, arguments: list[str], late: float) -> int:
        os.chdir(place)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        sys.argv = ["snnrl.run", *arguments]
        now = time.time
        time.time = lambda: now() + late
        try:
            command()
        except SystemExit as stop:
            return int(stop.code or 0)
        except BaseException:
            traceback.print_exc()
            return 70
        return 0

    def send(self, number: int) -> None:
        os.kill(self.pid, number)

    def wait(self) -> Ended:
        _, status = os.waitpid(self.pid, 0)
        lines = self.log.read_text().splitlines()
        said = [line for line in lines if "food/s" not in line]
        return Ended(os.waitstatus_to_exitcode(status), "\n".join(said))


def run(place: Path, *arguments: str, late: float = 0.0) -> Ended:
    return Started(place, *arguments, late=late).wait()


def until(condition: Callable[[], bool], patience: float = 60.0) -> None:
    """Wait for something that another process does."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the run did not get there")
        time.sleep(0.001)


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Step and value of every TensorBoard scalar, as TensorBoard reads them."""
    events = EventAccumulator(str(folder)).Reload()
    return {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def summary(folder: Path) -> dict[str, object]:
    found = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in found.items() if key not in WALL}


def is_saved(folder: Path) -> bool:
    """Whether a checkpoint is in it."""
    return any((folder / name).exists() for name in CHECKPOINTS)


class Faults:
    """The faults, each a method that does one case and says how it went: a word to count, "WRONG ..." if badly."""

    def __init__(self, place: Path, seed: int) -> None:
        self.place, self.random = place, random.Random(seed)
        self.count = 0
        self.whole = place / "undisturbed"
        began = time.monotonic()
        ended = run(place, *RUN, "hydra.run.dir=undisturbed")
        self.length = time.monotonic() - began
        assert ended.status == 0, ended.errors
        self.running = float(json.loads((self.whole / "summary.json").read_text())["wall_s"])
        self.stopped = self._folder()
        begun = self._start(self.stopped)
        until(lambda: all((self.stopped / name).exists() for name in CHECKPOINTS))
        begun.send(signal.SIGKILL)
        begun.wait()
        assert is_saved(self.stopped)

    def _folder(self) -> Path:
        self.count += 1
        return self.place / f"{self.count:05d}"

    def _start(self, folder: Path, late: float = 0.0) -> Started:
        return Started(self.place, *RUN, f"hydra.run.dir={folder}", late=late)

    def _begin(self, folder: Path, late: float = 0.0) -> Started:
        """Start a run and wait for a checkpoint; it is then stopped where it is, to go on with SIGCONT."""
        started = self._start(folder, late)
        until((folder / checkpoint.FILE).exists)
        started.send(signal.SIGSTOP)
        return started

    def _copy(self) -> Path:
        """A run that was killed after two checkpoints, or while a third was being saved."""
        return Path(shutil.copytree(self.stopped, self._folder()))

    def _resume(self, folder: Path, word: str) -> str:
        ended = run(self.place, f"resume={folder}")
        if ended.status != 0:
            return f"WRONG {word}: {ended.errors}"
        return self._judge(folder, word)

    def _judge(self, folder: Path, word: str) -> str:
        for file in ("series.npz", "trials.csv"):
            if (folder / file).read_bytes() != (self.whole / file).read_bytes():
                return f"WRONG {word}: {file} differs"
        if summary(folder) != summary(self.whole):
            return f"WRONG {word}: summary.json differs"
        if scalars(folder) != scalars(self.whole):
            return f"WRONG {word}: TensorBoard scalars differ"
        if is_saved(folder) or list(folder.glob("*.unfinished")):
            return f"WRONG {word}: something is left over"
        shutil.rmtree(folder)
        return word

    def kill(self) -> str:
        """kill -9 at a random moment, twice where there is time for it; then resume."""
        folder = self._folder()
        started = self._start(folder)
        if self.random.random() < 0.9:
            until((folder / "config.yaml").exists)
        time.sleep(self.random.uniform(0.0, self.running))
        started.send(signal.SIGKILL)
        started.wait()
        if not (folder / "config.yaml").exists():
            shutil.rmtree(folder, ignore_errors=True)
            return "killed before the run began"
        if summary(folder)["complete"]:
            return self._judge(folder, "killed when complete")
        word = "killed with a checkpoint" if is_saved(folder) else "killed without a checkpoint"
        started = Started(self.place, f"resume={folder}")
        time.sleep(self.random.uniform(0.0, self.length))
        started.send(signal.SIGKILL)
        started.wait()
        return self._resume(folder, word)

    def damage(self) -> str:
        """From a damaged checkpoint it goes on with the one before.

        Where both are damaged, or one is newer or foreign, it is refused and nothing is changed.
        """
        folder = self._copy()
        kind = self.random.choice(["truncated", "bit-flipped", "both damaged", "newer", "foreign"])
        saved = [folder / name for name in CHECKPOINTS if (folder / name).exists()]
        if kind == "foreign":
            config = folder / "config.yaml"
            config.write_text(config.read_text().replace("seed: 0", f"seed: {self.random.randrange(1, 1000)}"))
        for path in saved if kind == "both damaged" else saved[:1]:
            path.write_bytes(self._spoilt(path.read_bytes(), kind))
        if kind in ("truncated", "bit-flipped") and len(saved) > 1:
            ended = run(self.place, f"resume={folder}")
            if not ended.refused(0) or "going on from the one before" not in ended.errors:
                return f"WRONG {kind}: {ended}"
            return self._judge(folder, f"{kind} gone on from the one before")
        before = contents(folder)
        ended = run(self.place, f"resume={folder}")
        after = contents(folder)
        after[str(folder / ".lock")] = before[str(folder / ".lock")]
        if not ended.refused(2) or str(folder) not in ended.errors or before != after:
            return f"WRONG {kind}: {ended}"
        shutil.rmtree(folder)
        return f"{kind} refused"

    def _spoilt(self, good: bytes, kind: str) -> bytes:
        """A checkpoint that has suffered; a flipped bit is not in its format's number, which no checksum covers."""
        if kind == "both damaged":
            kind = self.random.choice(["truncated", "bit-flipped"])
        if kind == "truncated":
            return good[: self.random.randrange(len(good))]
        if kind == "bit-flipped":
            flipped = bytearray(good)
            flipped[self.random.randrange(good.index(b"1 ") + 1, len(good))] ^= 1 << self.random.randrange(8)
            return bytes(flipped)
        return good.replace(b"checkpoint 1 ", b"checkpoint 2 ", 1) if kind == "newer" else good

    def stop(self) -> str:
        """SIGINT and SIGTERM at a random moment of the run."""
        folder = self._folder()
        number = self.random.choice([signal.SIGINT, signal.SIGTERM])
        started = self._begin(folder)
        started.send(signal.SIGCONT)
        time.sleep(self.random.uniform(0.0, 0.3))
        started.send(number)
        ended = started.wait()
        if ended.status == 0 or not ended.refused(128 + number):
            return f"WRONG {number.name}: {ended}"
        said = summary(folder)
        if not said["complete"] and not ((folder / checkpoint.FILE).exists() and number.name in str(said["stopped"])):
            return f"WRONG {number.name}: no checkpoint, or not marked incomplete"
        return self._resume(folder, number.name)

    def full(self) -> str:
        """A disk that fills up at a random size; with room again, the run is resumed."""
        folder = self._folder()
        with small_disk(self.place, kilobytes=self.random.randrange(20, 1200)) as disk:
            ended = run(self.place, *RUN, f"hydra.run.dir={disk}/run")
            if ended.status == 0:
                return "had room"
            if not ended.refused(1) or "No space left" not in ended.errors:
                return f"WRONG: {ended}"
            shutil.copytree(disk / "run", folder)
        if not (folder / "config.yaml").exists():
            shutil.rmtree(folder)
            return "full before the run began"
        return self._resume(folder, "full after a checkpoint" if is_saved(folder) else "full before a checkpoint")

    def readonly(self) -> str:
        """A run begun or resumed in a folder that cannot be written to."""
        with small_disk(self.place, kilobytes=8000) as disk:
            shutil.copytree(self.stopped, disk / "run")
            before = contents(disk)
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
            tries = [run(self.place, f"resume={disk}/run")]
            tries += [run(self.place, *RUN, f"hydra.run.dir={disk}/{name}") for name in ("run", "new")]
            if any(not ended.refused(1) or "Read-only" not in ended.errors for ended in tries):
                return f"WRONG: {tries}"
            return "refused three times" if contents(disk) == before else "WRONG: changed"

    def shared(self) -> str:
        """Two runs in one folder: the second is refused, the first goes on."""
        folder = self._folder()
        first = self._begin(folder)
        tries = [
            run(self.place, *RUN, f"hydra.run.dir={folder}"),
            run(self.place, f"resume={folder}"),
        ]
        first.send(signal.SIGCONT)
        if first.wait().status != 0 or any(not ended.refused(2) or "in use" not in ended.errors for ended in tries):
            return f"WRONG: {tries}"
        return self._judge(folder, "second refused")

    def sweep(self) -> str:
        """A sweep with a job that cannot run, killed at a random moment and given again until nothing is missing."""
        folder = self._folder()
        arguments = ["-m", *RUN, "seed=0,1", "network.dopamine.delay=5,0", f"hydra.sweep.dir={folder}"]
        started = Started(self.place, *arguments)
        time.sleep(self.random.uniform(0.5, 2.0) * self.length)
        started.send(signal.SIGKILL)
        started.wait()
        complete = {path: path.stat().st_mtime_ns for path in folder.glob("*/trials.csv")}
        ended = run(self.place, *arguments)
        if (
            ended.status != 1 or ended.errors.count("network.dopamine.delay=0: must be at least 1") != 3
        ):  # each, and the first again
            return f"WRONG: {ended}"
        if "Traceback" in ended.errors or any(path.stat().st_mtime_ns != then for path, then in complete.items()):
            return f"WRONG: a traceback, or a complete job was run again: {ended}"
        jobs = sorted(folder.glob("*/trials.csv"))
        if len(jobs) != 2 or (jobs[0].read_bytes() != (self.whole / "trials.csv").read_bytes()):
            return f"WRONG: {jobs}"
        shutil.rmtree(folder)
        return f"{len(complete)} of 2 jobs kept"

    def clock(self) -> str:
        """A clock that jumps by up to ten years between a run and its resumption."""
        folder = self._folder()
        years = 365 * 86400.0
        begun = self._begin(folder, late=self.random.uniform(-10, 10) * years)
        begun.send(signal.SIGKILL)
        begun.wait()
        late = self.random.uniform(-10, 10) * years
        ended = run(self.place, f"resume={folder}", late=late)
        return f"WRONG: {ended}" if ended.status else self._judge(folder, "back" if late < 0 else "ahead")


ALL = ("kill", "damage", "stop", "full", "readonly", "shared", "sweep", "clock")
NEED_ROOT = ("full", "readonly")  # to mount a small disk


@contextmanager
def small_disk(place: Path, kilobytes: int) -> Iterator[Path]:
    """A tmpfs of that size."""
    disk = Path(tempfile.mkdtemp(prefix="disk", dir=place))
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(disk)], check=True)
    try:
        yield disk
    finally:
        subprocess.run(["umount", str(disk)], check=True)
        disk.rmdir()


def can_mount() -> bool:
    """Whether this process may mount a tmpfs: root, and not in a container that forbids it."""
    with tempfile.TemporaryDirectory() as place:
        try:
            with small_disk(Path(place), 100):
                return True
        except (OSError, subprocess.CalledProcessError):
            return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100, help="cases a fault")
    parser.add_argument("--only", nargs="+", choices=ALL, default=ALL)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="where to work; default is a temporary folder")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    build(compose(*RUN)).run(make_engine("fused", "cpu", 1), 1)  # children inherit what is compiled
    wrong = 0
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        faults = Faults(Path(folder), arguments.seed)
        for name in arguments.only:
            if name in NEED_ROOT and not can_mount():
                print(f"{name:9} skipped: a small disk cannot be mounted here", flush=True)
                continue
            counts = Counter(getattr(faults, name)() for _ in range(arguments.times))
            bad = {word: count for word, count in counts.items() if word.startswith("WRONG")}
            wrong += sum(bad.values())
            words = ", ".join(f"{count} {word}" for word, count in sorted(counts.items()))
            print(f"{name:9} {arguments.times - sum(bad.values())} of {arguments.times} right: {words}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

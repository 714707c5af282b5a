"""A sweep on a cluster of two worker processes, of which one is killed half-way, against the same sweep done serially.

    python tools/cluster.py [--jobs 1000] [--seconds 7] [--folder DIR]

What each job leaves is compared byte by byte: series.npz, trials.csv, weights.npz, and summary.json but for wall times.
Exit status 1 if a job is missing or differs.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

WORKERS = 2
FILES = ("series.npz", "trials.csv", "weights.npz")
WALL = ("wall_s", "trial_ms_per_s")
PATIENCE = 900.0  # s without anything new; Hydra composes all jobs first


@dataclass(frozen=True)
class Outcome:
    """Of the jobs on the cluster: how many were done when a worker was killed, are missing at the end, or differ."""

    jobs: int
    before: int
    missing: int
    differing: int


def sweep(place: Path, name: str, jobs: int, seconds: float, *options: str) -> subprocess.Popen[bytes]:
    """A sweep over seeds into the folder NAME, as its own process; what it says is in NAME.log."""
    chosen = ["+experiment=food_attraction", "trials=1", f"seconds={seconds}", f"seed=range(0,{jobs})", "threads=1"]
    words = ["-m", *chosen, "record.tensorboard=false", f"hydra.sweep.dir={name}", *options]
    with (place / f"{name}.log").open("wb") as log:
        return subprocess.Popen([sys.executable, "-m", "snnrl.run", *words], cwd=place, stdout=log, stderr=log)


def finished(place: Path, name: str) -> set[str]:
    """The folders of the jobs that are complete, by name."""
    summaries = list((place / name).glob("*/summary.json"))
    return {path.parent.name for path in summaries if json.loads(path.read_text())["complete"]}


def wait(condition: Callable[[], bool], progress: Callable[[], object] = lambda: None) -> None:
    """Until something holds.

    Raises:
        TimeoutError: it does not, and `progress` has been the same for too long.
    """
    last, since = progress(), time.monotonic()
    while not condition():
        if (now := progress()) != last:
            last, since = now, time.monotonic()
        if time.monotonic() - since > PATIENCE:
            raise TimeoutError("nothing has happened for too long")
        time.sleep(0.1)


@contextmanager
def cluster(place: Path, file: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A scheduler, and its workers, which nobody starts again."""

    def start(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], "--scheduler-file", str(file), *words[1:]]
        return subprocess.Popen([*command, "--no-dashboard"], cwd=place, stdout=log, stderr=log)

    with (place / "cluster.log").open("wb") as log:
        processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0")]
        try:
            wait(file.exists)
            processes += [start("worker", "--nthreads", "1", "--no-nanny") for _ in range(WORKERS)]
            yield processes[1:]
        finally:
            for process in processes:
                process.kill()
                process.wait()


def kept(folder: Path) -> dict[str, object]:
    """All that a job has come to, but for wall times."""
    summary = json.loads((folder / "summary.json").read_text())
    files = {name: (folder / name).read_bytes() for name in FILES}
    return {**files, "summary": {key: value for key, value in summary.items() if key not in WALL}}


def compare(place: Path, jobs: int, seconds: float) -> Outcome:
    """Do the sweep twice, and say what the cluster has lost."""
    file = place / "scheduler.json"
    with cluster(place, file) as workers:
        on_cluster = sweep(
            place, "cluster", jobs, seconds, "hydra/launcher=dask", f"hydra.launcher.scheduler_file={file}"
        )
        done = partial(finished, place, "cluster")
        wait(lambda: len(done()) >= jobs // 2 or on_cluster.poll() is not None, done)
        before = len(done())
        workers[0].send_signal(signal.SIGKILL)
        wait(lambda: on_cluster.poll() is not None, done)
    serial = sweep(place, "serial", jobs, seconds)
    wait(lambda: serial.poll() is not None, partial(finished, place, "serial"))
    names = finished(place, "serial")
    assert len(names) == jobs, (place / "serial.log").read_text()
    both = names & finished(place, "cluster")
    differing = [name for name in both if kept(place / "serial" / name) != kept(place / "cluster" / name)]
    return Outcome(jobs, before, len(names - both), len(differing))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=7.0, help="simulated, of each job")
    parser.add_argument("--folder", type=Path, help="where all is kept; otherwise it is removed at the end")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as parent:
        place = arguments.folder or Path(parent)
        place.mkdir(parents=True, exist_ok=True)
        found = compare(place, arguments.jobs, arguments.seconds)
    print(f"{found.jobs} jobs, one of {WORKERS} workers killed when {found.before} were done:", end=" ")
    print(f"{found.missing} lost, {found.differing} differ from the serial sweep")
    sys.exit(bool(found.missing or found.differing))


if __name__ == "__main__":
    main()

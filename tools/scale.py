"""Time and memory of whole runs as they grow: more trials, more hours, more synapses a trial.

    python tools/scale.py [--trials 100,1000,10000] [--hours 1,3,10] [--synapses 1360,10000,100000] [--small]
                          [--markdown docs/scale.md]

Every size is a run of `snnrl.running.job` with the default recording, in a process of its own that has loaded its
compiled
kernels before the clock starts. Checked are: time and memory grow at most `TIME` and `MEMORY` times as fast as the
size, a run's peak of memory does not depend on its length (`LEAK`), and TensorBoard events stay below `EVENTS` a
simulated hour. Exit status 1 if a check fails. The plot is written beside the Markdown, as a PNG.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing.palette import ATTRACTION
from snnrl.drawing.style import PUBLISHED, figure, legend, save, styled
from snnrl.engines import make_engine
from snnrl.files import write
from snnrl.running.job import perform

TIME = 1.5  # time may grow by so much more than the size
MEMORY = 1.5  # and so may memory beyond that of the start
SLACK = 0.5, 16.0  # s and MB by which a small size may be off
PICTURES = 15  # of a run of hours, whatever its length
LEAK = 16.0  # MB; ten hours of samples and of the allocator's habits
EVENTS = 4.0  # MB of TensorBoard events a simulated hour
PLASTIC = 4 * 0.85  # synapses between the sensors and the motors, for each pair of places in their groups
MB = 1e6
USUAL: dict[str, Any] = {
    "trials": [100, 1000, 10_000],
    "hours": [1.0, 3.0, 10.0],
    "synapses": [1360, 10_000, 100_000],
    "seconds": 20.0,
}
SMALL: dict[str, Any] = {"trials": [2, 8], "hours": [0.01, 0.02], "synapses": [1360, 5000], "seconds": 0.7}


@dataclass(frozen=True)
class Size:
    """One run: the food-only robot with sensor and motor groups of so many neurons."""

    axis: str
    value: float
    trials: int
    seconds: float
    group: int = 20

    def overrides(self) -> list[str]:
        """The run as its command line; a larger brain's neurons get the same current as a small one's."""
        groups = [f"{side}_{kind}" for side in ("left", "right") for kind in ("food", "motor")]
        share = 20.0 / self.group
        gain = compose("+experiment=food_attraction").network.synaptic_gain
        larger = [
            *(f"network.groups.{name}.size={self.group}" for name in groups),
            f"network.synaptic_gain={gain * share}",
            f"network.synapses.reward.weight={3.0 / share}",
            f"network.synapses.inhibition.weight={-3.0 / share}",
            f"network.synapses.inhibition.spread={3.0 / share}",
        ]
        run = ["+experiment=food_attraction", f"trials={self.trials}", f"seconds={self.seconds}"]
        pictures = [f"record.pictures={self.seconds / PICTURES}"] if self.axis == "hours" else []
        return run + pictures + (larger if self.group != 20 else [])


@dataclass(frozen=True)
class Cost:
    """What a run cost: s, and MB of memory at the start and at the peak, of events, plastic synapses a trial."""

    size: Size
    build: float
    wall: float
    start: float
    peak: float
    events: float
    synapses: float


def memory(key: str) -> float:
    """VmRSS or VmHWM of this process, MB; unlike getrusage's, its peak knows nothing of the parent's."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{key}:"):
            return int(line.split()[1]) * 1024 / MB
    raise OSError(f"/proc/self/status: no {key}")


def load_kernels(threads: int) -> None:
    """Compile them, if that is still to be done."""
    build(compose("+experiment=food_attraction", "trials=1")).run(make_engine("fused", "cpu", threads), 1)


def measure(size: Size, threads: int) -> Cost:
    """Run it in a fresh process."""
    given = json.dumps({**asdict(size), "threads": threads})
    command = [sys.executable, __file__, "--child", given]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{size}: {done.stderr}")
    return Cost(size, **json.loads(done.stdout.splitlines()[-1]))


def child(given: str) -> None:
    """Run one size in this process, and print its cost as the last line."""
    values = json.loads(given)
    threads = values.pop("threads")
    size = Size(**values)
    load_kernels(threads)
    config = compose(*size.overrides(), f"threads={threads}")
    start = memory("VmRSS")
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        summary = perform(config, Path(folder))
        whole = time.perf_counter() - began
        events = sum(path.stat().st_size for path in Path(folder).glob("events.out.tfevents.*"))
        peak = memory("VmHWM")
        with np.load(Path(folder) / "weights.npz") as weights:
            joined = sum(int((~np.isnan(weights[name])).sum()) for name in weights if "motor" in name)
    cost = {
        "build": whole - summary["wall_s"],
        "wall": summary["wall_s"],
        "start": start,
        "peak": peak,
        "events": events / MB,
        "synapses": joined / size.trials,
    }
    print(json.dumps(cost))


def sizes(trials: Sequence[int], hours: Sequence[float], synapses: Sequence[int], seconds: float) -> list[Size]:
    """All runs, axis by axis, in rising order; `seconds` is how long those that grow in trials are."""
    return [
        *(Size("trials", count, count, seconds) for count in sorted(trials)),
        *(Size("hours", count, 2, 3600.0 * count) for count in sorted(hours)),
        *(Size("synapses", count, 4, 15.0 * seconds, _group(count)) for count in sorted(synapses)),
    ]


def _group(synapses: int) -> int:
    return math.ceil(math.sqrt(round(synapses / PLASTIC)))


def checks(costs: Sequence[Cost]) -> list[tuple[bool, str]]:
    """Whether each demand is met, and in words what was found."""
    found = []
    for small, large in pairwise(costs):
        axis = small.size.axis
        if axis != large.size.axis:
            continue
        ratio = large.size.value / small.size.value
        step = f"{axis} {small.size.value:g} to {large.size.value:g}"
        most = TIME * ratio * small.wall + SLACK[0]
        found.append((large.wall <= most, f"{step}: {large.wall:.3g} s, at most {most:.3g} s"))
        if axis != "hours":
            most = MEMORY * ratio * (small.peak - small.start) + SLACK[1]
            grown = large.peak - large.start
            found.append((grown <= most, f"{step}: {grown:.0f} MB more than at the start, at most {most:.0f} MB"))
    lasting = [cost for cost in costs if cost.size.axis == "hours"]
    if lasting:
        first, last = lasting[0], lasting[-1]
        grown = last.peak - first.peak
        hours = f"{last.size.value:g} h instead of {first.size.value:g} h"
        found.append((grown <= LEAK, f"{hours}: {grown:.1f} MB more at the peak, at most {LEAK:g} MB"))
        most = EVENTS * max(last.size.value, 1.0)
        found.append(
            (last.events <= most, f"{last.size.value:g} h: {last.events:.2f} MB of events, at most {most:g} MB")
        )
    return found


HEAD = (
    "| grows | trials | simulated, s | plastic synapses a trial | build, s | run, s | trial-ms/s | at the start, MB | "
    "peak, MB | events, MB |\n|---|---|---|---|---|---|---|---|---|---|"
)


def line(cost: Cost) -> str:
    """A row of the table."""
    size = cost.size
    speed = 1000.0 * size.trials * size.seconds / cost.wall
    return (
        f"| {size.axis} | {size.trials:,} | {size.seconds:,g} | {cost.synapses:,.0f} | {cost.build:.2f} | "
        f"{cost.wall:.2f} | {speed:,.0f} | {cost.start:.0f} | {cost.peak:.0f} | {cost.events:.2f} |"
    )


@styled
def draw(costs: Sequence[Cost], path: Path) -> None:
    """Time and memory against size; the dashed line is proportional and ends in the last point."""
    axes = list(dict.fromkeys(cost.size.axis for cost in costs))
    names = {"trials": "Trials", "hours": "Simulated time (h)", "synapses": "Plastic synapses of a trial"}
    drawn, panels = figure(2, len(axes), width=2.6 * len(axes), height=4.2, squeeze=False, sharey="row")
    for column, axis in enumerate(axes):
        chosen = [cost for cost in costs if cost.size.axis == axis]
        size = np.array([cost.size.value for cost in chosen])
        for row, (values, label) in enumerate(
            [([cost.wall for cost in chosen], "Run (s)"), ([cost.peak for cost in chosen], "Peak memory (MB)")]
        ):
            panel = panels[row][column]
            panel.loglog(size, values, "o-", color=ATTRACTION, label="measured")
            if row == 0 or axis != "hours":
                panel.plot(size, values[-1] * size / size[-1], label="in proportion to the last", **PUBLISHED)
            panel.set_xlabel(names[axis] if row else "")
            panel.set_ylabel("" if column else label)
    legend(drawn, loc="outside lower center", ncols=2)
    save(drawn, path.with_suffix(""), 130)


def document(costs: Sequence[Cost], found: Sequence[tuple[bool, str]], command: str, picture: str) -> str:
    """The whole page."""
    return "\n".join(
        [
            "# Scale on one machine",
            "",
            f"`{command}` wrote this page on {os.cpu_count()} processors ({platform.machine()}), "
            f"Python {platform.python_version()}.",
            "",
            "Each line is a whole run of the food-attraction experiment (`python -m snnrl.run`) with its default "
            "recording, in a fresh process. *Build* makes the network and the world, *run* simulates, records and "
            "writes; *at the start* is the resident memory once the kernels are loaded. For more synapses the sensor "
            f"and motor groups are larger. Runs of hours draw {PICTURES} pictures each, whatever their length.",
            "",
            HEAD,
            *map(line, costs),
            "",
            f"![time and peak memory by size; dashed: proportional]({picture})",
            "",
            f"Checks: time and memory grow at most {TIME:g} and {MEMORY:g} times as fast as the size (give or take "
            f"{SLACK[0]:g} s and {SLACK[1]:g} MB).",
            "",
            *(f"- {'holds' if holds else '**fails**'}: {words}" for holds, words in found),
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=whole, help="numbers of trials, with commas between")
    parser.add_argument("--hours", type=real, help="simulated hours of two trials")
    parser.add_argument("--synapses", type=whole, help="plastic synapses a trial, of four trials")
    parser.add_argument("--seconds", type=float, help="simulated, where trials grow; 15 times that where synapses do")
    parser.add_argument("--threads", type=int, default=0, help="0 is one per processor")
    parser.add_argument("--small", action="store_true", help="sizes that take seconds, unless given")
    parser.add_argument("--markdown", type=Path, help="file to write the table to, and its plot beside it")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child)
        return 0
    default = SMALL if arguments.small else USUAL
    chosen = {key: getattr(arguments, key) or value for key, value in default.items()}
    load_kernels(arguments.threads)  # so that no run's peak is that of the compiler
    print(HEAD)
    costs = []
    for size in sizes(**chosen):
        costs.append(measure(size, arguments.threads))
        print(line(costs[-1]), flush=True)
    found = checks(costs)
    for holds, words in found:
        print(f"{'holds' if holds else 'FAILS'}  {words}")
    if arguments.markdown:
        picture = arguments.markdown.with_suffix(".png")
        draw(costs, picture)
        command = " ".join(["python tools/scale.py", *sys.argv[1:]])
        write(arguments.markdown, document(costs, found, command, picture.name))
    return 0 if all(holds for holds, _ in found) else 1


def whole(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def real(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


if __name__ == "__main__":
    sys.exit(main())

"""The whole thesis from one command: every experiment at its published size, and a report beside the published numbers.

    python -m snnrl.reproduce [--quick] [--only EXPERIMENT] [--seed K] [--results FOLDER]

Runs are kept in runs/thesis/data and found again by content: configuration, seed, code and library versions. An
interrupted reproduction continues with the first run that is missing. The report is written to
runs/thesis/TIME/report.html, report.md and report.json, and in small form to --results.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from snnrl.configuration.compose import compose
from snnrl.errors import ConfigError
from snnrl.recording.runs import Run
from snnrl.running.job import perform, read_summary
from snnrl.schema import Config
from snnrl.thesis import dampening
from snnrl.thesis.claims import FIVE_ROBOTS
from snnrl.thesis.compare import compare, enough
from snnrl.thesis.fit import FACTORS, grid_points, point_name
from snnrl.thesis.report import Provenance, write_report

DATA = Path("runs/thesis/data")
ROBOTS = {
    "orbit": ("learning_disabled", "learning", "positive_baseline"),
    "food_attraction": ("random_walk", "learning", "no_hunger"),
    "food_poison": ("random_walk", "learning"),
    "secondary_stimulus": ("learning", "no_burst_threshold"),
    "secondary_behaviour": FIVE_ROBOTS,
    "dual_learning": ("random_walk", "benchmark", "learning"),
}
QUICK_TRIALS, QUICK = 3, 0.04  # trials, and the part of the published seconds, in a quick reproduction
QUICK_ORBIT = 0.5  # orbits are short as they are


@dataclass(frozen=True)
class Planned:
    """One run of the plan: its name in the report, and the command line's overrides."""

    name: str
    experiment: str
    overrides: tuple[str, ...]


def plan(seed: int, quick: bool, only: str | None = None) -> list[Planned]:
    """All runs, those of the tables first."""
    chosen = {name: robots for name, robots in ROBOTS.items() if only in (None, name)}
    result = []
    for experiment, robots in chosen.items():
        sizes = _quick_sizes(experiment) if quick else ()
        for robot in robots:
            name = f"{experiment}/{robot}"
            result.append(Planned(name, experiment, (*_chosen(name, seed), *sizes)))
    closeups = (run for run in _closeups(seed, QUICK if quick else 1.0) if only in (None, run.experiment))
    searched = _grid(seed, quick) if only in (None, "stdp_search") else []
    return [*result, *closeups, *searched]


def _chosen(name: str, seed: int) -> tuple[str, ...]:
    return f"robot={name.partition('/')[2]}", f"seed={seed}"


def _closeups(seed: int, part: float) -> list[Planned]:
    """What is drawn tick by tick, some of it for this part of its full time."""
    close = (f"seed={seed}", "record.every=0.07")
    one = (*close, "trials=1")
    switch = part * (compose("+experiment=food_poison").body()[1].poison_from or 0.0)
    around = (f"seconds={switch + 15:g}", f"record.start={switch - 10:g}", f"world.kinds.food.poison_from={switch:g}")
    return [
        Planned(
            "random_walk", "food_attraction", (*one, "robot=random_walk", "world.kinds.food.count=0", "seconds=30")
        ),
        Planned("first_eligibility", "food_attraction", (*one, "seconds=30")),
        Planned("single_trial", "food_attraction", (*one, f"seconds={500 * part:g}")),
        Planned("dampening", dampening.EXPERIMENT, (*close, *dampening.overrides())),
        Planned("poison_switch", "food_poison", (*one, *around)),
    ]


def _grid(seed: int, quick: bool) -> list[Planned]:
    """The plain grid over the parameters of STDP."""
    sizes = _quick_sizes("stdp_search") if quick else ()
    centre = compose("+experiment=stdp_search").network.plasticity
    return [
        Planned(
            point_name(point),
            "stdp_search",
            (f"seed={seed}", *sizes, *(f"network.plasticity.{key}={value:g}" for key, value in point.items())),
        )
        for point in grid_points(centre, (0.5, 1.0) if quick else FACTORS)
    ]


def _quick_sizes(experiment: str) -> tuple[str, ...]:
    seconds = compose(f"+experiment={experiment}").seconds
    if experiment == "orbit":
        return (f"trials={QUICK_TRIALS}", f"seconds={seconds * QUICK_ORBIT:g}")
    sizes = (f"trials={QUICK_TRIALS}", f"seconds={seconds * QUICK:g}", "record.every=1.0")
    return (*sizes, f"world.kinds.food.poison_from={seconds * QUICK / 2:g}") if experiment == "food_poison" else sizes


def code_version() -> str:
    """A digest of the sources that a run's results depend on: all of the package but what looks at finished runs."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if not name.startswith(("thesis/", "command/", "reproduce.py", "calibrate.py", "search.py")):
            digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def content(config: Config) -> dict[str, Any]:
    """All that decides the result of a run."""
    return {
        "config": {key: value for key, value in dataclasses.asdict(config).items() if key != "threads"},
        "code": code_version(),
        "versions": {name: version(name) for name in ("torch", "numpy", "numba")},
    }


def obtain(planned: Planned, say: Any = print) -> tuple[Run, bool]:
    """The run, found by content or else run now; and whether it was found."""
    config = compose(f"+experiment={planned.experiment}", "record.tensorboard=false", *planned.overrides)
    wanted = content(config)
    digest = hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()[:12]
    folder = DATA / f"{planned.name.replace('/', '-').replace(',', '-')}-{digest}"
    found = (folder / "config.yaml").exists() and read_summary(folder)["complete"]
    if found:
        say(f"{planned.name}: found, same configuration, seed, code and versions: {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    perform(config, folder)
    return Run(folder), found


def obtain_enough(runs: Mapping[str, Run], seed: int) -> dict[str, Run]:
    """The runs that have too few trials for a verdict, once more with as many as it needs."""
    return {
        name: obtain(Planned(name, name.partition("/")[0], (*_chosen(name, seed), f"trials={trials}")))[0]
        for name, trials in enough(compare(runs)).items()
    }


def machine() -> str:
    """Processor and how many of them this process may use."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        named = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = named[0] if named else model
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {count} processors"


def reproduce(seed: int, quick: bool, only: str | None = None) -> Path:
    """Run what is missing and write the report; returns its folder."""
    started = time.perf_counter()
    runs: dict[str, Run] = {}
    found = 0
    for planned in plan(seed, quick, only):
        runs[planned.name], reused = obtain(planned)
        found += reused
    more = {} if quick else obtain_enough(runs, seed)
    all_runs = [*runs.values(), *more.values()]
    folder = Path("runs/thesis") / time.strftime("%Y-%m-%d_%H-%M-%S")
    provenance = Provenance(
        seed=seed,
        code=code_version(),
        versions={name: version(name) for name in ("snnrl", "torch", "numpy", "numba", "scipy", "matplotlib")},
        python=platform.python_version(),
        machine=machine(),
        quick=quick,
        simulated_s=sum(run.summary["trials"] * run.summary["seconds"] for run in all_runs),
        running_s=sum(run.summary["wall_s"] for run in all_runs),
        found=found,
    )
    write_report(folder, runs, more, provenance, started)
    return folder


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--quick", action="store_true", help="everything at small size, in under two minutes")
    experiments = (*ROBOTS, "stdp_search")
    made.add_argument("--only", choices=experiments, metavar="EXPERIMENT", help=f"one of {', '.join(experiments)}")
    made.add_argument("--seed", type=int, default=0, help="of all runs (default 0)")
    made.add_argument("--results", type=Path, help="folder for the report in small form: Markdown, JSON, figures")
    return made


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    options = parser().parse_args(arguments)
    try:
        folder = reproduce(options.seed, options.quick, options.only)
    except ConfigError as error:
        print(f"snnrl.reproduce: {error}", file=sys.stderr)
        sys.exit(2)
    if options.results:
        options.results.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "report.md", options.results / "README.md")
        shutil.copy(folder / "report.json", options.results / "report.json")
        bitmaps = shutil.ignore_patterns("*.svg")
        shutil.copytree(folder / "figures", options.results / "figures", ignore=bitmaps, dirs_exist_ok=True)
    print(f"report: {folder / 'report.html'}")

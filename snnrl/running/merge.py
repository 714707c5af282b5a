"""Merge shards and sweeps into one table: a row for each experiment, robot and set of overrides.

    python -m snnrl.collect RUNS... [-o table.csv | -o table.parquet]

RUNS are run folders, or folders that hold some (a sweep, or all of runs/). Runs that differ only in which trials
they simulate are shards of one row. Intervals are 95 %: Student's t for the mean of the food collected, Wilson's
for the fraction of trials that learnt.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from snnrl.configuration.compose import load
from snnrl.configuration.schema import ConfigError
from snnrl.files import FolderError, write
from snnrl.running.checkpoint import difference, settings
from snnrl.running.job import read_summary

LEVEL = 0.95
OF_A_SHARD = ("trials", "trial_start")
WITHOUT_EFFECT = ("threads", "checkpoint.", "record.")  # on the trials
COLUMNS = (
    "experiment",
    "robot",
    "overrides",
    "seconds",
    "trials",
    "food_mean",
    "food_sd",
    "food_low",
    "food_high",
    "correct",
    "correct_low",
    "correct_high",
)


@dataclass(frozen=True)
class Run:
    """A complete run: its folder, what its trials depend on, and per trial the food and whether it learnt."""

    folder: Path
    experiment: str
    robot: str
    overrides: str
    seconds: float
    settings: dict[str, Any]
    food: dict[int, int]
    correct: dict[int, bool]


def run_folders(paths: Iterable[Path]) -> list[Path]:
    """The run folders among and below some folders; plain files among them are passed over.

    Raises:
        FolderError: a folder holds none.
    """
    found: dict[Path, None] = {}
    for path in (path for path in paths if not path.is_file()):
        inside = sorted(file.parent for file in path.rglob("summary.json"))
        if not inside:
            raise FolderError(f"{path}: no run in it")
        found.update(dict.fromkeys(folder.resolve() for folder in inside))
    return list(found)


def read(folder: Path) -> Run | None:
    """The run in a folder; None if it is not complete.

    Raises:
        FolderError: its files are damaged, or do not belong together.
    """
    summary = read_summary(folder)
    if not summary["complete"]:
        return None
    try:
        everything = settings(load(folder / "config.yaml"))
        rows = list(csv.DictReader((folder / "trials.csv").open()))
        food = {int(row["trial"]): int(row["food"]) for row in rows}
        correct = {int(row["trial"]): row["correct"] == "1" for row in rows if row["correct"]}
    except (OSError, ConfigError, KeyError, ValueError, TypeError) as error:
        raise FolderError(f"{folder}: cannot be read ({error})") from error
    start, count = everything["trial_start"], everything["trials"]
    if [int(row["trial"]) for row in rows] != list(range(start, start + count)):
        raise FolderError(f"{folder}: trials.csv does not hold the trials {start} to {start + count - 1}")
    named = ("+experiment", "experiment", "robot", *OF_A_SHARD)
    overrides = " ".join(
        text
        for text in sorted(summary["overrides"])
        if not text.lstrip("+").startswith(WITHOUT_EFFECT) and text.partition("=")[0] not in named
    )
    kept = {k: v for k, v in everything.items() if k not in OF_A_SHARD and not k.startswith(WITHOUT_EFFECT)}
    return Run(folder, summary["experiment"], summary["robot"], overrides, summary["seconds"], kept, food, correct)


def merge(runs: Sequence[Run]) -> dict[str, Any]:
    """One row from the shards of one cell.

    Raises:
        FolderError: two of them simulate the same trial, or differ in more than their trials.
    """
    first = runs[0]
    owner: dict[int, Path] = {}
    for run in runs:
        if differs := difference(run.settings, first.settings):
            raise FolderError(f"{run.folder}: contradicts {first.folder} ({differs})")
        for trial in run.food:
            if trial in owner:
                raise FolderError(f"{run.folder}: overlaps with {owner[trial]} (trial {trial})")
            owner[trial] = run.folder
    food = np.array([count for run in runs for count in run.food.values()], dtype=float)
    correct = [learnt for run in runs for learnt in run.correct.values()]
    low, high = mean_interval(food)
    at_least, at_most = fraction_interval(correct)
    return {
        "experiment": first.experiment,
        "robot": first.robot,
        "overrides": first.overrides,
        "seconds": first.seconds,
        "trials": len(food),
        "food_mean": float(food.mean()),
        "food_sd": float(food.std(ddof=1)) if len(food) > 1 else None,
        "food_low": low,
        "food_high": high,
        "correct": sum(correct) / len(correct) if correct else None,
        "correct_low": at_least,
        "correct_high": at_most,
    }


def mean_interval(values: np.ndarray) -> tuple[float | None, float | None]:
    """Student's t interval of the mean; none for a single value."""
    if len(values) < 2:
        return None, None
    half = float(stats.t.ppf(0.5 + LEVEL / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))
    return float(values.mean()) - half, float(values.mean()) + half


def fraction_interval(outcomes: Sequence[bool]) -> tuple[float | None, float | None]:
    """Wilson's interval of the fraction of true outcomes; none for no outcome."""
    if not outcomes:
        return None, None
    interval = stats.binomtest(sum(outcomes), len(outcomes)).proportion_ci(LEVEL, method="wilson")
    return float(interval.low), float(interval.high)


def collect(paths: Iterable[Path]) -> tuple[list[dict[str, Any]], list[Path]]:
    """The table of all runs in some folders, and the folders of runs that are not complete.

    Raises:
        FolderError: names a folder that holds no run, is damaged, or overlaps with or contradicts another.
    """
    cells: dict[tuple[str, str, str], list[Run]] = {}
    incomplete = []
    for folder in run_folders(paths):
        run = read(folder)
        if run is None:
            incomplete.append(folder)
        else:
            cells.setdefault((run.experiment, run.robot, run.overrides), []).append(run)
    return [merge(cells[cell]) for cell in sorted(cells)], incomplete


def save(table: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the table as CSV, or as Parquet if the file is called so."""
    if path.suffix == ".parquet":
        write(path, as_parquet(table))
    else:
        write(path, as_csv(table))


def as_csv(table: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    rows = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    rows.writeheader()
    rows.writerows(table)
    return text.getvalue()


def as_parquet(table: Sequence[dict[str, Any]]) -> bytes:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise FolderError('-o NAME.parquet: needs pip install "snnrl[parquet]"') from None
    kinds = {"experiment": pyarrow.string(), "robot": pyarrow.string(), "overrides": pyarrow.string()}
    kinds["trials"] = pyarrow.int64()
    schema = pyarrow.schema([(name, kinds.get(name, pyarrow.float64())) for name in COLUMNS])
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(table), schema=schema), buffer)
    return buffer.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="a .csv or .parquet file; otherwise CSV is printed")
    arguments = parser.parse_args()
    try:
        table, incomplete = collect(arguments.runs)
        for folder in incomplete:
            print(f"snnrl.collect: {folder}: left out, the run is not complete", file=sys.stderr)
        if arguments.output is None:
            print(as_csv(table), end="")
        else:
            save(table, arguments.output)
    except (FolderError, OSError) as error:
        print(f"snnrl.collect: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2 if isinstance(error, FolderError) else 1)

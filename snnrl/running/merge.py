"""Merge shards and sweeps into one table: a row for each experiment, robot and choice of settings.

    python -m snnrl.collect RUNS... [--latest] [-o table.csv | -o table.parquet]

RUNS are run folders, or folders that hold some (a sweep, or all of runs/). Runs that differ only in which trials
they simulate are shards of one row. What was set on the command line has a column, and so has what differs between
runs of one experiment and robot. Intervals are 95 %: Student's t for the mean of the food collected, or of the
rewards of a task, Wilson's for the fraction of trials that learnt.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from snnrl.configuration.compose import load
from snnrl.errors import ConfigError
from snnrl.files import FolderError, csv_of, finite, write
from snnrl.intervals import student, wilson
from snnrl.running.checkpoint import difference, settings
from snnrl.running.job import read_summary

OF_A_SHARD = ("trials", "trial_start")
WITHOUT_EFFECT = ("threads", "checkpoint.", "record.")  # on the trials
NAMED = ("experiment", "robot", "experiment.name", "robot.name", "seconds")  # by columns that there always are
SCORES = ("food", "rewards")  # of a robot, of a task


@dataclass(frozen=True)
class Shard:
    """A complete run, as a part of a row.

    Attributes:
        seconds: simulated, of each trial.
        settings: what its trials depend on.
        chosen: what its command line set, by key; a file of a group by the group's.
        score: which of SCORES it has, and `values` those of its trials.
        correct: which trials have learnt, where something says so.
        ended: s since the epoch.
    """

    folder: Path
    experiment: str
    robot: str
    seconds: float
    settings: dict[str, Any]
    chosen: dict[str, Any]
    score: str
    values: dict[int, float]
    correct: dict[int, bool]
    ended: float


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


def read(folder: Path) -> Shard | None:
    """The run in a folder; None if it is not complete.

    Raises:
        FolderError: its files are damaged, or do not belong together.
    """
    summary = read_summary(folder)
    if not summary["complete"]:
        return None
    try:
        config = load(folder / "config.yaml")
        score = "food" if config.task is None else "rewards"
        rows = list(csv.DictReader((folder / "trials.csv").open()))
        values = {int(row["trial"]): float(row[score]) for row in rows}
        correct = {int(row["trial"]): row["correct"] == "1" for row in rows if row.get("correct")}
        ended = (folder / "summary.json").stat().st_mtime
        known = {key: value for key, value in settings(config).items() if not _is_left_out(key)}
        names = summary["experiment"], summary["robot"], float(summary["seconds"])
        chosen = choices(summary["overrides"], known)
    except (OSError, ConfigError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise FolderError(f"{folder}: cannot be read ({error})") from error
    trials = range(config.trial_start, config.trial_start + config.trials)
    if [int(row["trial"]) for row in rows] != list(trials):
        raise FolderError(f"{folder}: trials.csv does not hold the trials {trials[0]} to {trials[-1]}")
    return Shard(folder, *names, known, chosen, score, values, correct, ended)


def _is_left_out(key: str) -> bool:
    return key in OF_A_SHARD or key.startswith(WITHOUT_EFFECT)


def choices(overrides: Iterable[str], settings: dict[str, Any]) -> dict[str, Any]:
    """What a command line has set, by key: the settings themselves, or the name of a file of settings."""
    chosen: dict[str, Any] = {}
    for override in overrides:
        key, _, text = override.lstrip("+~").partition("=")
        if key in NAMED or _is_left_out(key):
            continue
        inside = [name for name in settings if name.startswith(f"{key}.")]
        if text.startswith("{"):
            chosen |= {name: settings[name] for name in inside}
        elif key in settings or inside:
            chosen[key] = settings.get(key, text)
    return chosen


def columns(runs: Sequence[Shard]) -> list[str]:
    """The keys that runs were given, or in which those of one experiment and robot differ."""
    found = {key for run in runs for key in run.chosen}
    for alike in _grouped(runs, lambda run: (run.experiment, run.robot)):
        inside = tuple(f"{key}." for run in alike for key in run.chosen)  # a file has one column
        keys = {key for run in alike for key in run.settings if not key.startswith(inside)}
        found |= {key for key in keys if len({str(run.settings.get(key)) for run in alike}) > 1}
    return sorted(found - set(NAMED))


def _grouped(runs: Iterable[Shard], key: Callable[[Shard], Hashable]) -> list[list[Shard]]:
    groups: dict[Hashable, list[Shard]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return list(groups.values())


def owners(runs: Sequence[Shard], latest: bool = False) -> dict[int, Shard]:
    """Which of the shards of one cell each trial is taken from.

    Args:
        latest: whether the newest run that has a trial counts where more than one has it.

    Raises:
        FolderError: two of them have the same trial, and which of them counts is not said.
    """
    owner: dict[int, Shard] = {}
    for run in sorted(runs, key=lambda run: run.ended):
        for trial in run.values:
            if trial in owner and not latest:
                other = owner[trial].folder
                raise FolderError(f"{run.folder}: repeats {other} (trial {trial}); with --latest the newer counts")
            owner[trial] = run
    return owner


def merge(runs: Sequence[Shard], latest: bool) -> dict[str, Any]:
    """What the table says of the shards of one cell, but for its settings; see `owners`."""
    owner = owners(runs, latest)
    values = np.array([owner[trial].values[trial] for trial in sorted(owner)])
    correct = [run.correct[trial] for trial, run in owner.items() if trial in run.correct]
    score, fraction = runs[0].score, sum(correct) / len(correct) if correct else None
    low, high = map(finite, student(values))
    at_least, at_most = (None, None) if fraction is None else wilson(fraction, len(correct))
    return {
        "seconds": runs[0].seconds,
        "trials": len(values),
        f"{score}_mean": float(values.mean()),
        f"{score}_sd": float(values.std(ddof=1)) if len(values) > 1 else None,
        f"{score}_low": low,
        f"{score}_high": high,
        "correct": fraction,
        "correct_low": at_least,
        "correct_high": at_most,
    }


def collect(paths: Iterable[Path], latest: bool = False) -> tuple[list[dict[str, Any]], list[Path]]:
    """The table of all runs in some folders, and the folders of runs that are not complete.

    All its rows have the same columns; what a run does not have is None.

    Args:
        latest: see `owners`.

    Raises:
        FolderError: as `cells`, or a run repeats another.
    """
    found, incomplete = cells(paths)
    rows = [{**named, **merge(runs, latest)} for named, runs in found]
    scores = [f"{score}_{part}" for score in SCORES for part in ("mean", "sd", "low", "high")]
    names = list(found[0][0]) if found else ["experiment", "robot"]
    wanted = (*names, "seconds", "trials", *scores, "correct", "correct_low", "correct_high")
    there = [name for name in wanted if name not in scores or any(name in row for row in rows)]
    return [{name: row.get(name) for name in there} for row in rows], incomplete


def cells(paths: Iterable[Path]) -> tuple[list[tuple[dict[str, Any], list[Shard]]], list[Path]]:
    """The complete runs in some folders, those of the same settings together, and the folders of the others.

    Each cell comes with its names: experiment, robot and choice of settings, by the same keys for all.

    Raises:
        FolderError: names a folder that holds no run, is damaged, or differs from another in what has no name: in what
            a file held that both have chosen.
    """
    read_in = {folder: read(folder) for folder in run_folders(paths)}
    runs = [run for run in read_in.values() if run is not None]
    keys = columns(runs)
    tables = {key for key in keys for run in runs for name in run.settings if name.startswith(f"{key}.")}

    def chosen(run: Shard, key: str) -> Any:
        value = run.chosen.get(key, run.settings.get(key))
        return "null" if value is None and key in tables and key in run.settings else value

    found, told = [], dict[str, Shard]()
    for cell in _grouped(runs, lambda run: (run.experiment, run.robot, json.dumps(run.settings, sort_keys=True))):
        merged = {key: next((v for run in cell if (v := chosen(run, key)) is not None), None) for key in keys}
        first = cell[0]
        other = told.setdefault(str((first.experiment, first.robot, first.seconds, merged)), first)
        if differs := difference(first.settings, other.settings):
            raise FolderError(f"{first.folder}: contradicts {other.folder} ({differs})")
        found.append(({"experiment": first.experiment, "robot": first.robot, **merged}, cell))
    found.sort(key=lambda cell: [cell[0]["experiment"], cell[0]["robot"], *(_order(cell[0][key]) for key in keys)])
    return found, [folder for folder, run in read_in.items() if run is None]


def _order(value: Any) -> tuple[bool, float, str]:
    """Numbers by their size, before all else by its text."""
    is_number = isinstance(value, (int, float))
    return not is_number, value if is_number else 0.0, str(value)


def save(table: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the table as CSV, or as Parquet if the file is called so."""
    if path.suffix == ".parquet":
        write(path, as_parquet(table))
    else:
        write(path, as_csv(table))


def as_csv(table: Sequence[dict[str, Any]]) -> str:
    return csv_of(list(table[0]), [list(row.values()) for row in table]) if table else ""


def as_parquet(table: Sequence[dict[str, Any]]) -> bytes:
    """Columns of whole numbers, of numbers, of truth values, or else of text."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise FolderError('-o NAME.parquet: needs pip install "snnrl[parquet]"') from None
    arrays = {}
    for name in table[0] if table else ():
        values = [row[name] for row in table]
        types = {type(value) for value in values if value is not None}
        if types and not (types <= {int, float} or types == {bool}):
            values = [None if value is None else str(value) for value in values]
        arrays[name] = pyarrow.array(values, None if types else pyarrow.float64())
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(arrays), buffer)
    return buffer.getvalue()


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("runs", nargs="+", type=Path)
    made.add_argument("--latest", action="store_true", help="of runs that repeat a trial, the newest counts")
    made.add_argument("-o", "--output", type=Path, help="a .csv or .parquet file; otherwise CSV is printed")
    return made


def main() -> None:
    arguments = parser().parse_args()
    try:
        table, incomplete = collect(arguments.runs, arguments.latest)
        for folder in incomplete:
            print(f"snnrl.collect: {folder}: left out, the run is not complete", file=sys.stderr)
        if arguments.output is None:
            print(as_csv(table), end="")
        else:
            save(table, arguments.output)
    except (FolderError, OSError) as error:
        print(f"snnrl.collect: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2 if isinstance(error, FolderError) else 1)

"""Results as data: runs and sweeps as xarray's datasets, and as tables of pandas."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from snnrl.errors import ConfigError
from snnrl.files import FolderError
from snnrl.recording.datasets import of_monitor, of_run
from snnrl.recording.runs import Run
from snnrl.running.job import read_summary
from snnrl.running.merge import Shard, cells, collect, owners

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


def load(folder: str | Path, monitor: str | None = None) -> Dataset:
    """A run, or all runs below a folder, as a dataset; see `snnrl.recording.datasets.of_run`.

    Several runs are along `run`, which has the coordinates `experiment`, `robot` and each key that was swept; shards
    are one run. What one of them does not have is nan.

    Args:
        monitor: what a monitor of that name in the run has seen, in place of the series; see `of_monitor` there.

    Raises:
        FolderError: there is no complete run, or runs that do not go together (see `snnrl.running.merge.cells`).
        ConfigError: there is no such monitor.
        ImportError: xarray is not installed.
    """
    folder = Path(folder)
    if not (folder / "config.yaml").is_file():
        if monitor is not None:
            raise ConfigError("monitor", monitor, f"is of one run, and {folder} is none")
        return _sweep(folder)
    if not read_summary(folder)["complete"]:
        raise FolderError(f"{folder}: the run is not complete")
    run = Run(folder)
    if monitor is None:
        return of_run(run)
    if monitor not in run.monitors:
        raise ConfigError("monitor", monitor, f"{folder} has {', '.join(run.monitors) or 'none'}")
    return of_monitor(run.monitors[monitor])


def _sweep(folder: Path) -> Dataset:
    found = _complete(folder)
    if not found:
        raise FolderError(f"{folder}: no complete run in it")
    parts = [[of_run(Run(shard.folder)) for shard in _in_order(shards)] for _, shards in found]
    import xarray  # which `of_run` has found

    def joined(datasets: Sequence[Dataset], dim: str) -> Dataset:
        return xarray.concat(datasets, dim, data_vars="all", join="outer", combine_attrs="drop_conflicts")

    runs = [joined(shards, "trial") if len(shards) > 1 else shards[0] for shards in parts]
    keys = {key: ("run", _column([named[key] for named, _ in found])) for key in found[0][0]}
    return joined(runs, "run").assign_coords(keys)


def _complete(folder: Path) -> list[tuple[dict[str, Any], list[Shard]]]:
    """The complete runs below a folder by what they are; warns of the others."""
    found, incomplete = cells([folder])
    _warn(incomplete)
    return found


def _warn(incomplete: Sequence[Path]) -> None:
    for left_out in incomplete:
        warnings.warn(f"{left_out}: left out, the run is not complete", stacklevel=4)


def _in_order(shards: Sequence[Shard]) -> list[Shard]:
    """By their trials, no two of which are the same; raises FolderError."""
    owner = owners(shards)
    return list({owner[trial].folder: owner[trial] for trial in sorted(owner)}.values())


def _column(values: Sequence[Any]) -> np.ndarray:
    """Of numbers, truth values or text, or of anything."""
    alike = len({type(value) for value in values}) == 1
    column = np.empty(len(values), object)
    column[:] = values
    return np.array(values) if alike and isinstance(values[0], (bool, int, float, str)) else column


def table(folder: str | Path, trials: bool = False) -> DataFrame:
    """All runs below a folder, or the one in it: a row each, with a column for each key that was swept.

    The columns are those of `python -m snnrl.collect`; shards are one row.

    Args:
        trials: whether to have a row for each trial instead, with the columns of trials.csv.

    Raises:
        FolderError: see `snnrl.running.merge.collect`.
        ImportError: pandas is not installed.
    """
    try:
        from pandas import DataFrame, concat
    except ImportError:
        raise ImportError('snnrl.table: needs pip install "snnrl[data]"') from None
    if not trials:
        rows, incomplete = collect([Path(folder)])
        _warn(incomplete)
        return DataFrame(rows)
    parts = []
    for named, shards in _complete(Path(folder)):
        for shard in _in_order(shards):
            frame = DataFrame(Run(shard.folder).trials).astype({"trial": int})
            parts.append(DataFrame({key: [value] * len(frame) for key, value in named.items()}).join(frame))
    return concat(parts, ignore_index=True) if parts else DataFrame()

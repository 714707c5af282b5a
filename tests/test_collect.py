"""Shards are the whole, and one table holds them all."""

from __future__ import annotations

import csv
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import compose_config

from snnrl.files import FolderError
from snnrl.running import merge
from snnrl.running.job import perform
from snnrl.running.merge import fraction_interval, mean_interval


def shard(folder: Path, start: int, count: int, *overrides: str) -> Path:
    """A run of some trials, as its command line would leave it."""
    folder.mkdir(parents=True)
    named = ["+experiment=food_attraction", f"trials={count}", f"trial_start={start}", "seconds=20", *overrides]
    unseen = ("record.tensorboard=false", "threads=1")
    perform(compose_config(*named, *unseen), folder, named)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of five trials; the same trials in two shards; the second shard with another value."""
    place = tmp_path_factory.mktemp("runs")
    shard(place / "whole", 4, 5)
    shard(place / "shards" / "second", 6, 3)
    shard(place / "shards" / "first", 4, 2)
    shard(place / "other", 6, 3, "network.dopamine.delay=6")
    return place


def rows(path: Path) -> list[list[str]]:
    return list(csv.reader(path.open()))


def test_shards_give_the_trials_of_one_big_run(runs: Path) -> None:
    whole, first, second = runs / "whole", runs / "shards" / "first", runs / "shards" / "second"
    assert rows(whole / "trials.csv") == rows(first / "trials.csv") + rows(second / "trials.csv")[1:]
    series, *parts = (np.load(folder / "series.npz") for folder in (whole, first, second))
    assert set(series) == {"projections", "groups", "time", "trials", "collection_rate", "firing_rate", "dopamine"} | {
        "position",
        "heading",
        "nearest_item",
        "weight",
        "eligibility",
    }
    for key in ("projections", "groups", "time"):
        assert all(np.array_equal(series[key], part[key]) for part in parts)
    assert np.array_equal(series["trials"], np.concatenate([part["trials"] for part in parts]))
    for key in ("collection_rate", "firing_rate", "weight", "eligibility", "dopamine"):
        assert np.array_equal(series[key], np.concatenate([part[key] for part in parts], 1)), key


def test_a_row_for_each_cell(runs: Path) -> None:
    table, incomplete = merge.collect([runs / "shards", runs / "other"])
    assert incomplete == []
    assert [row["overrides"] for row in table] == ["network.dopamine.delay=6 seconds=20", "seconds=20"]
    assert [row["trials"] for row in table] == [3, 5]
    (whole,), _ = merge.collect([runs / "whole"])
    assert table[1] == whole
    food = [int(row[1]) for row in rows(runs / "whole" / "trials.csv")[1:]]
    assert (whole["experiment"], whole["robot"]) == ("food_attraction", "learning")
    assert whole["food_mean"] == pytest.approx(np.mean(food))
    assert whole["food_sd"] == pytest.approx(np.std(food, ddof=1))
    assert 0 <= whole["correct_low"] <= whole["correct"] <= whole["correct_high"] <= 1


def test_intervals_in_closed_form() -> None:
    low, high = mean_interval(np.array([10.0, 12.0, 14.0]))
    half = 4.302653 * 2.0 / math.sqrt(3)  # Student's t, two degrees of freedom
    assert (low, high) == pytest.approx((12.0 - half, 12.0 + half))
    z, n, p = 1.959964, 50, 0.9
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert fraction_interval([True] * 45 + [False] * 5) == pytest.approx((middle - half, middle + half))
    assert mean_interval(np.array([3.0])) == fraction_interval([]) == (None, None)


def test_overlapping_shards_are_refused(runs: Path) -> None:
    with pytest.raises(FolderError, match=r"whole: overlaps with .*second \(trial 6\)"):
        merge.collect([runs / "shards" / "second", runs / "whole"])


def test_a_folder_named_twice_counts_once(runs: Path) -> None:
    (row,), _ = merge.collect([runs / "shards", runs / "shards" / "first"])
    assert row["trials"] == 5


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("config.yaml", "delay: 5", "delay: 7", "contradicts .*network.dopamine.delay=7 there, .*=5 here"),
        ("trials.csv", "\n5,", "\n8,", "trials.csv does not hold the trials 4 to 5"),
        ("summary.json", '"complete"', '"done"', "summary.json is missing or not that of a run"),
        ("config.yaml", "trials: 2", "trials: [", "cannot be read"),
    ],
)
def test_shards_that_do_not_fit_are_refused(
    tmp_path: Path, runs: Path, file: str, old: str, new: str, message: str
) -> None:
    place = Path(shutil.copytree(runs / "shards", tmp_path / "shards"))
    edit(place / "first" / file, old, new)
    with pytest.raises(FolderError, match=message):
        merge.collect([place / "second", place / "first"])


def command(monkeypatch: pytest.MonkeyPatch, *arguments: Any) -> None:
    monkeypatch.setattr(sys, "argv", ["snnrl.collect", *map(str, arguments)])
    merge.main()


def test_the_table_as_csv_and_parquet(
    tmp_path: Path, runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, runs / "shards", runs / "other")
    printed = capsys.readouterr().out
    command(monkeypatch, runs / "shards", runs / "other", "-o", tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text() == printed
    assert printed.startswith("experiment,robot,overrides,")
    assert len(printed.splitlines()) == 3
    pytest.importorskip("pyarrow")
    import pyarrow.parquet

    command(monkeypatch, runs / "shards", runs / "other", "-o", tmp_path / "table.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "table.parquet").to_pylist()
    assert table == merge.collect([runs / "shards", runs / "other"])[0]


def test_what_is_left_out_or_wrong_is_said_in_a_line(
    tmp_path: Path, runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = Path(shutil.copytree(runs / "shards", tmp_path / "shards"))
    edit(place / "first" / "summary.json", '"complete": true', '"complete": false')
    command(monkeypatch, place)
    output = capsys.readouterr()
    assert output.err == f"snnrl.collect: {place / 'first'}: left out, the run is not complete\n"
    assert ",20.02,3," in output.out
    with pytest.raises(SystemExit) as caught:
        command(monkeypatch, tmp_path / "nowhere")
    assert caught.value.code == 2
    assert capsys.readouterr().err == f"snnrl.collect: {tmp_path / 'nowhere'}: no run in it\n"

"""Shards are the whole, and one table holds them all."""

from __future__ import annotations

import csv
import os
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

FOOD, REWARDS, CORRECT = (
    *([f"{score}_{part}" for part in ("mean", "sd", "low", "high")] for score in ("food", "rewards")),
    ["correct", "correct_low", "correct_high"],
)


def shard(folder: Path, start: int, count: int, *overrides: str, experiment: str = "food_attraction") -> Path:
    """A run of some trials, as its command line would leave it."""
    folder.mkdir(parents=True)
    named = [f"+experiment={experiment}", f"trials={count}", f"trial_start={start}", *overrides]
    unseen = ("record.tensorboard=false", "record.every=1", "threads=1")
    perform(compose_config("seconds=20", *named, *unseen), folder, named)
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


@pytest.fixture(scope="module")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of a small task of the same trials, in which there are many rewards."""
    place = tmp_path_factory.mktemp("tasks")
    sizes = ("network.groups.excitatory.size=80", "network.groups.inhibitory.size=20", "seconds=4")
    fan_out = [f"network.synapses.{name}={{fan_out: 20}}" for name in ("to_excitatory", "to_inhibitory", "inhibition")]
    reward = ("task.coincidence.window=900", "task.reward.shortest=100", "task.reward.longest=200")
    for seed in (3, 20):
        shard(place / f"{seed}", 2, 2, *sizes, *fan_out, *reward, f"seed={seed}", experiment="distal_reward")
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
    assert [row["network.dopamine.delay"] for row in table] == [5, 6]
    assert [row["trials"] for row in table] == [5, 3]
    (whole,), _ = merge.collect([runs / "whole"])
    assert list(whole) == ["experiment", "robot", "seconds", "trials", *FOOD, *CORRECT]
    assert {key: value for key, value in table[0].items() if key != "network.dopamine.delay"} == whole
    food = [int(row[1]) for row in rows(runs / "whole" / "trials.csv")[1:]]
    assert (whole["experiment"], whole["robot"]) == ("food_attraction", "learning")
    assert whole["food_mean"] == pytest.approx(np.mean(food))
    assert whole["food_sd"] == pytest.approx(np.std(food, ddof=1))
    assert 0 <= whole["correct_low"] <= whole["correct"] <= whole["correct_high"] <= 1


def test_a_task_has_its_rewards(runs: Path, tasks: Path) -> None:
    table, _ = merge.collect([tasks])
    assert list(table[0])[:2] == ["experiment", "robot"]
    assert list(table[0])[-9:] == ["seconds", "trials", *REWARDS, *CORRECT]
    assert [row["seed"] for row in table] == [3, 20]
    for row in table:
        rewards = [float(line[1]) for line in rows(tasks / f"{row['seed']}" / "trials.csv")[1:]]
        assert row["rewards_mean"] == np.mean(rewards) > 0
        assert row["rewards_sd"] == pytest.approx(np.std(rewards, ddof=1))
        assert row["correct"] is None
    both, _ = merge.collect([tasks, runs / "whole"])
    assert list(both[0])[-13:] == ["seconds", "trials", *FOOD, *REWARDS, *CORRECT]
    assert [row["experiment"] for row in both] == ["distal_reward", "distal_reward", "food_attraction"]
    assert [row["food_mean"] is None for row in both] == [True, True, False]
    assert [row["rewards_mean"] is None for row in both] == [False, False, True]


def test_a_column_for_what_was_chosen_and_what_differs() -> None:
    def run(robot: str, settings: dict[str, Any], *overrides: str) -> merge.Shard:
        everything = {"network.dopamine.tau": 25.0, "seed": 0, "world.side": 300.0, "world.axle": 1.0, **settings}
        known = {key: value for key, value in everything.items() if value is not ...}
        chosen = merge.choices(overrides, known)
        return merge.Shard(Path(), "food_attraction", robot, 20.0, known, chosen, "food", {0: 1.0}, {}, 0.0)

    plain, other, learning = run("walk", {}), run("walk", {"seed": 1}), run("learning", {"network.dopamine.tau": 9.0})
    assert merge.columns([plain]) == merge.columns([plain, plain]) == []
    assert merge.columns([plain, other]) == ["seed"]
    assert merge.columns([plain, learning]) == []  # the robot's own
    assert merge.columns([run("walk", {}, "+experiment=x", "robot=walk", "trials=3", "record.every=2", "seed=0")]) == [
        "seed"
    ]
    small = run("walk", {"world.side": 90.0, "world.axle": 2.0}, "world=small", "seed=0")
    assert small.chosen == {"world": "small", "seed": 0}
    assert merge.columns([plain, small]) == ["seed", "world"]
    table = run("walk", {"network.projections.x.pre": "a"}, "+network.projections.x={pre: a}")
    assert merge.columns([table]) == ["network.projections.x.pre"]
    without = run("walk", {"world": None, "world.side": ..., "world.axle": ...}, "~world")
    assert merge.columns([plain, without]) == ["world"]


def test_repeats_are_refused_or_the_newest_counts(tmp_path: Path, runs: Path) -> None:
    first = Path(shutil.copytree(runs / "shards" / "second", tmp_path / "z"))
    again = Path(shutil.copytree(first, tmp_path / "again"))
    edit(again / "trials.csv", "\n6,", "\n6,1000,0,0,0,")  # as no run would leave it: tells which one counts
    for folder, ended in ((first, 2000), (again, 1000)):
        os.utime(folder / "summary.json", (ended, ended))
    with pytest.raises(FolderError, match=r"z: repeats .*again \(trial 6\); with --latest the newer counts"):
        merge.collect([tmp_path])
    assert merge.collect([tmp_path], latest=True) == merge.collect([first])
    os.utime(again / "summary.json", (3000, 3000))
    (row,), _ = merge.collect([tmp_path], latest=True)
    assert row["food_mean"] > 300


def test_a_part_that_is_left_out_is_told_from_one_that_is_there(tmp_path: Path) -> None:
    shard(tmp_path / "with", 0, 1, "seconds=1")
    shard(tmp_path / "without", 0, 1, "seconds=1", "network.homeostasis=null")
    table, _ = merge.collect([tmp_path])
    assert [list(row)[:3] for row in table] == [["experiment", "robot", "network.homeostasis"]] * 2
    assert {row["network.homeostasis"] for row in table} == {None, "null"}


def test_what_is_not_told_apart_is_refused(tmp_path: Path) -> None:
    first, second = (shard(tmp_path / name, 0, 1, "world=food_only", "seconds=1") for name in "ab")
    edit(second / "config.yaml", "side: 100.0", "side: 400.0")  # as if conf/world/food_only.yaml had been changed
    with pytest.raises(FolderError, match=r"b: contradicts .*/a \(world.side=400.0 there, world.side=100.0 here\)"):
        merge.collect([first, second])


def test_a_part_that_is_repeated_counts_once(runs: Path) -> None:
    with pytest.raises(FolderError, match=r"second: repeats .*whole \(trial 6\)"):
        merge.collect([runs / "shards" / "second", runs / "whole"])
    assert merge.collect([runs / "shards" / "second", runs / "whole"], latest=True) == merge.collect([runs / "whole"])


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
        ("trials.csv", "\n5,", "\n8,", "trials.csv does not hold the trials 4 to 5"),
        ("summary.json", '"complete"', '"done"', "summary.json is missing or not that of a run"),
        ("config.yaml", "trials: 2", "trials: [", "cannot be read"),
    ],
)
def test_damaged_shards_are_refused(tmp_path: Path, runs: Path, file: str, old: str, new: str, message: str) -> None:
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
    assert printed.startswith("experiment,robot,network.dopamine.delay,seconds,trials,food_mean,")
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
    command(monkeypatch, place / "first")
    assert capsys.readouterr().out == ""
    with pytest.raises(SystemExit) as caught:
        command(monkeypatch, runs / "shards", runs / "whole")
    assert caught.value.code == 2
    assert "; with --latest the newer counts\n" in capsys.readouterr().err
    command(monkeypatch, runs / "shards", runs / "whole", "--latest")
    assert ",20.02,5," in capsys.readouterr().out
    with pytest.raises(SystemExit) as caught:
        command(monkeypatch, tmp_path / "nowhere")
    assert caught.value.code == 2
    assert capsys.readouterr().err == f"snnrl.collect: {tmp_path / 'nowhere'}: no run in it\n"

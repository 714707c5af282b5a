"""The command `snnrl`: help, keys, completion, and an experiment of one's own."""

from __future__ import annotations

import dataclasses
import io
import os
import subprocess
import sys
import tomllib
from argparse import Namespace
from importlib import import_module
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from helpers import called

from snnrl.command.choices import experiments
from snnrl.command.complete import complete
from snnrl.command.keys import keys_of, plainly
from snnrl.command.main import COMMANDS
from snnrl.command.new import begin
from snnrl.command.run import find_keys
from snnrl.configuration.compose import compose, conf_dir, outline
from snnrl.errors import ConfigError
from snnrl.files import FolderError
from snnrl.running.progress import Progress
from snnrl.schema import BaselinesConfig, Config

ROOT = Path(__file__).parents[1]


def snnrl(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return called("snnrl.command.main", folder, *words, **environment)


def lines(done: subprocess.CompletedProcess[str]) -> list[str]:
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_package_has_the_command() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    module, _, function = project["scripts"]["snnrl"].partition(":")
    assert callable(getattr(import_module(module), function))


def test_help_lists_every_command(tmp_path: Path) -> None:
    told = lines(snnrl(tmp_path, "--help"))
    for name, (line, module, _) in COMMANDS.items():
        assert any(text.split() == [name, *line.split()] for text in told), name
        assert callable(import_module(module).main)
    for name in ("collect", "replay", "reproduce", "bench", "new"):
        assert lines(snnrl(tmp_path, name, "--help"))[0].startswith(f"usage: snnrl {name} ")


def test_an_unknown_command_is_refused(tmp_path: Path) -> None:
    done = snnrl(tmp_path, "rnu")
    assert done.returncode == 2
    assert "invalid choice: 'rnu'" in done.stderr


def test_the_help_of_run_says_what_each_experiment_is_for(tmp_path: Path) -> None:
    begin(tmp_path / "mine")
    told = "\n".join(lines(snnrl(tmp_path, "run", "--help", "--config-dir", "mine")))
    names = [*(path.stem for path in Path(conf_dir(), "experiment").glob("*.yaml")), "baselines", "mine"]
    listed = told.partition("experiments:")[2].partition("robots,")[0].splitlines()
    for name in names:
        (line,) = [line for line in listed if line.split()[:1] == [name]]
        assert len(line.split()) > 4, name
    assert set(experiments(str(tmp_path / "mine"))) == set(names)


def nodes(kind: Any) -> set[Any]:
    """A dataclass of the schema and all that are in it."""
    hints = get_type_hints(kind)
    inner = {part for hint in hints.values() for part in (hint, *get_args(hint)) if dataclasses.is_dataclass(part)}
    return {kind, *(node for part in inner for node in nodes(part))}


def test_every_key_has_a_meaning() -> None:
    fields = [(node, item) for node in nodes(Config) | nodes(BaselinesConfig) for item in dataclasses.fields(node)]
    assert len(fields) > 120
    for node, item in fields:
        assert item.metadata.get("meaning"), (node, item.name)
        assert item.metadata["unit"] in {
            "", "1/ms", "current/mV", "mV", "current", "ms", "Hz", "mV/(uM ms)", "uM", "spikes", "cm/s", "cm", "s"
        }  # fmt: skip


def test_keys_are_those_of_the_schema_and_of_what_is_composed() -> None:
    listed = {key.path: key for key in keys_of(Config, outline(), named=False)}
    assert str(listed["network.dopamine.tau"]).splitlines()[1] == (
        "    ms; greater than 0; decay of the level to its baseline"
    )
    assert listed["network.dopamine.tau"].value == compose("experiment=orbit").network.dopamine.tau  # type: ignore[union-attr]
    assert listed["network.groups.NAME.size"].value == "???"
    assert listed["network.rules.NAME.tau_plus"].unit == "ms"
    assert listed["engine"].choices == ("auto", "reference", "fused", "cuda")
    assert "task.stimuli.window" in listed
    named = {key.path: key.value for key in keys_of(Config, outline("experiment=food_poison"), named=True)}
    assert named["network.groups.left_food.size"] == 20
    assert named["network.synapses.taxis.delay"] == 1
    assert named["world.kinds.food.poison_from"] == 1000.0
    assert not any("NAME" in path for path in named if path.startswith("network.groups"))


def test_values_are_written_as_they_are_given() -> None:
    overrides = [
        f"{key.path}={plainly(key.value)}"
        for key in keys_of(Config, outline("experiment=dual_learning"), named=True)
        if key.path.startswith(("world.", "coding.", "record.", "robot.", "trials", "seconds"))
        and "$" not in plainly(key.value)
    ]
    assert len(overrides) > 50
    assert compose("experiment=dual_learning", *overrides) == compose("experiment=dual_learning")


def test_keys_are_found_by_a_part_of_their_name(tmp_path: Path) -> None:
    told = lines(snnrl(tmp_path, "run", "--keys", "dopamine.tau"))
    assert told[0].startswith("network.dopamine.tau=")
    assert len(told) == 2
    assert {key.path for key in find_keys("taxis.delay", [])} == {"network.synapses.taxis.delay"}
    assert {key.path for key in find_keys("q_learning.", ["experiment=baselines"])} == {
        f"q_learning.{name}" for name in ("bins", "rate", "discount", "exploration")
    }
    done = snnrl(tmp_path, "run", "--keys", "tua")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "snnrl run: --keys=tua: no key has this in its name\n"


def completed(words: str, prefix: str, folder: str | None = None) -> list[str]:
    return complete(prefix, Namespace(overrides=words.split(), config_dir=folder))


def test_words_are_completed(tmp_path: Path) -> None:
    begin(tmp_path / "mine")
    assert "experiment=orbit" in completed("", "experiment=o")
    assert "+experiment=orbit" in completed("", "+experiment=")
    assert "experiment=mine" in completed("", "experiment=", str(tmp_path / "mine"))
    assert "robot=random_walk" in completed("experiment=orbit", "robot=")
    assert completed("", "engine=") == [f"engine={name}" for name in ("auto", "reference", "fused", "cuda")]
    assert completed("", "record.tensorboard=") == ["record.tensorboard=true", "record.tensorboard=false"]
    assert completed("", "network.dopamine.t") == ["network.dopamine.tau=", "network.dopamine.threshold="]
    assert {"network.", "network=", "seconds="} <= set(completed("", ""))
    assert completed("", "network.synapses.ta") == [
        f"network.synapses.taxis.{name}="
        for name in ("delay", "fan_out", "listens", "plastic", "probability", "rule", "spread", "weight")
    ]
    assert completed("trails=3", "trial") == ["trial_start=", "trials="]  # what is wrong hinders nothing
    assert completed("", "seconds=") == []


def test_a_shell_gets_completions_without_torch(tmp_path: Path) -> None:
    line = "snnrl run experiment=food_"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_COMP_WORDBREAKS": " =",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "offered"),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    trace = "import sys; sys.modules['torch'] = None; from snnrl.command.main import main; main()"
    subprocess.run([sys.executable, "-c", trace], env={**os.environ, **asked}, timeout=300, check=False)
    assert (tmp_path / "offered").read_text().split() == ["food_attraction", "food_poison"]


def test_a_new_experiment_runs(tmp_path: Path) -> None:
    file, command = lines(snnrl(tmp_path, "new", "mine"))
    assert file == "mine/experiment/mine.yaml"
    program, *words = command.split()
    assert program == "snnrl"
    done = snnrl(tmp_path, *words, "trials=2", "seconds=1", "hydra.run.dir=out")
    assert lines(done)[0] == "mine, learning: 2 trials x 1 s"
    assert (tmp_path / "out" / "trials.csv").is_file()
    again = snnrl(tmp_path, "new", "mine")
    assert (again.returncode, again.stderr) == (2, "snnrl new: mine/experiment/mine.yaml: is there already\n")


@pytest.mark.parametrize("name", ["3rd", "my-own", "ä"])
def test_a_new_experiment_needs_a_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="must be a letter, then letters, digits and _"):
        begin(tmp_path / name)
    assert not (tmp_path / name).exists()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    file = begin(tmp_path / "mine")
    file.write_text("mine")
    with pytest.raises(FolderError, match="is there already"):
        begin(tmp_path / "mine")
    assert file.read_text() == "mine"


def test_a_sweep_is_a_run_for_every_value(tmp_path: Path) -> None:
    words = ("experiment=orbit", "seed=0,1", "trials=1", "seconds=0.5", "hydra.sweep.dir=all")
    assert lines(snnrl(tmp_path, "sweep", *words))
    assert len(list(tmp_path.glob("all/*/trials.csv"))) == 2
    table = lines(snnrl(tmp_path, "collect", "all"))
    assert [row.split(",")[:2] for row in table[1:]] == [["orbit", "learning"]] * 2


def test_speed_is_measured(tmp_path: Path) -> None:
    sizes = ("--trials", "2", "--threads", "1", "--seconds", "0.7", "--warm-up", "0.7", "--repeats", "1")
    told = lines(snnrl(tmp_path, "bench", *sizes))
    assert [line.split()[:2] for line in told] == [["food_only", "fused"], ["food_container", "fused"]]
    assert all(float(line.split()[2]) > 0 for line in told)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_redrawn_on_a_terminal_and_a_line_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "120")
    progress = Progress("a run", 5, 10.0)
    with progress.running(0.0):
        progress.say("something happened")
        progress.show(10.0, lambda: "all is well")
    drawn = terminal.getvalue().split("\r")
    assert "a run  something happened\n" in "".join(drawn)
    assert drawn[-1].startswith("a run  100%")
    assert "10 of 10 s, all is well" in drawn[-1]
    assert drawn[-1].endswith("\n")


def test_a_log_has_a_line_for_every_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress("a run", 5, 10.0)
    with progress.running(0.0):
        for done in range(1, 41):
            progress.show(done / 4, lambda: "well")
    told = capsys.readouterr().err.splitlines()
    assert [line.split()[2] for line in told] == [f"{10 * k}%" for k in range(1, 11)]


def test_compiling_is_told_apart(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    progress = Progress("a run", 1, 10.0)
    with progress.preparing() as compiling:
        compiling()
        now[0] += 7.0
    assert capsys.readouterr().err.splitlines() == ["a run  compiling, once", "a run  compiled in 7.0 s"]
    assert progress.wall == 0.0

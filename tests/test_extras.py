"""The core works without what is installed only where it is asked for, and a line says what is missing."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from test_layers import distribution

from snnrl.extras import EXTRAS

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
OPTIONAL = sorted({*(name for names in EXTRAS.values() for name in names), "pyarrow"})
COMMANDS = {
    "collect": "statistics",
    "replay": "figures",
    "reproduce": "thesis",
    "calibrate": "calibration",
    "search": "calibration",
}


def without_extras(folder: Path, program: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Python in which nothing optional can be imported."""
    blocked = f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL})); {program}"
    return subprocess.run(
        [sys.executable, "-c", blocked, *words], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )


def installed_by(extra: str) -> set[str]:
    """Distributions, those of the extras within it, too."""
    found = set()
    for requirement in PROJECT["optional-dependencies"][extra]:
        if within := re.match(r"snnrl\[(.*)\]", requirement):
            found |= {name for other in within[1].split(",") for name in installed_by(other)}
        else:
            found.add(distribution(requirement))
    return found


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_is_what_the_project_installs_for_it(extra: str) -> None:
    owners = packages_distributions()
    assert {distribution(owners[name][0]) for name in EXTRAS[extra]} == installed_by(extra)
    assert installed_by(extra) <= installed_by("all")


def test_the_core_runs_without_extras_and_says_what_is_left_out(tmp_path: Path) -> None:
    run = "from snnrl.command.main import main; main()"
    words = ("run", "experiment=food_attraction", "trials=1", "seconds=0.7", "engine=reference", "hydra.run.dir=out")
    done = without_extras(tmp_path, run, *words)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "trials.csv").is_file()
    assert not list(tmp_path.rglob("events*"))
    assert done.stderr.splitlines()[0] == (
        "food_attraction learning  record.tensorboard=true: no events are written, which "
        'needs tensorboard, matplotlib, PIL, scipy: pip install "snnrl[dashboards]"'
    )


def test_a_command_without_its_extra_ends_in_one_line(tmp_path: Path) -> None:
    program = """
from snnrl.command.main import main
for name in sys.argv[1:]:
    sys.argv = ["snnrl", name]
    try:
        main()
    except SystemExit as end:
        print(name, end.code)
"""
    done = without_extras(tmp_path, program, *COMMANDS)
    assert done.stdout.splitlines() == [f"{name} 2" for name in COMMANDS], done.stderr
    for line, (name, extra) in zip(done.stderr.splitlines(), COMMANDS.items(), strict=True):
        assert re.fullmatch(rf'snnrl {name}: needs [\w, ]+: pip install "snnrl\[{extra}\]"', line)


def test_environments_without_gymnasium_say_so(tmp_path: Path) -> None:
    done = without_extras(tmp_path, "import snnrl.environments")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        'ImportError: snnrl.environments: needs gymnasium: pip install "snnrl[environments]"'
    )

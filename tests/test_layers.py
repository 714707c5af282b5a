"""Who may import what."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import snnrl

PACKAGE = Path(snnrl.__file__).parent


def imports() -> dict[str, set[str]]:
    """Modules that each file of the package imports, by its path."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module)
        found[str(path.relative_to(PACKAGE))] = names
    return found


def importers(module: str) -> set[str]:
    return {path for path, names in imports().items() if any(n == module or n.startswith(f"{module}.") for n in names)}


def test_only_the_entry_points_and_the_configuration_know_hydra_and_optuna() -> None:
    configuration = {f"configuration/{name}.py" for name in ("compose", "loader", "refusals")}
    commands = {"running/command.py", "run.py", "agents/baselines.py"}
    assert importers("hydra") == configuration | commands
    assert importers("optuna") == {"thesis/calibrate.py", "thesis/search.py"}
    assert importers("omegaconf") == configuration | commands | {"configuration/schema.py"}


def test_only_the_board_and_the_task_recorder_know_tensorboard() -> None:
    assert importers("torch.utils.tensorboard") | importers("tensorboard") == {
        "recording/board.py",
        "recording/task_recorder.py",
    }


def test_what_records_knows_nothing_of_the_analysis() -> None:
    assert not any(path.startswith(("recording/", "drawing/")) for path in importers("snnrl.thesis"))


def test_only_the_fused_engine_knows_numba() -> None:
    assert all(path.startswith("engines/fused/") for path in importers("numba"))


def test_only_the_environments_know_gymnasium() -> None:
    assert importers("gymnasium") == {"agents/environments.py"}
    assert importers("stable_baselines3") == set()


def test_network_and_world_know_nothing_of_each_other() -> None:
    world = {name for path, names in imports().items() if path.startswith("body/world/") for name in names}
    assert {name for name in world if name.startswith("snnrl")} <= {
        "snnrl.configuration.schema",
        "snnrl.model.draws",
        "snnrl.model.elementary",
        "snnrl.body.world.kinds",
        "snnrl.body.world.geometry",
        "snnrl.body.world.sensors",
        "snnrl.body.world.world",
    }
    network = set().union(*(imports()[f"model/{name}.py"] for name in ("network", "neurons", "synapses", "modulators")))
    assert not any(name.startswith(("snnrl.body.world", "snnrl.body.coding", "snnrl.simulation")) for name in network)


def test_a_task_knows_only_the_network_and_its_random_numbers() -> None:
    known = {name for name in imports()["tasks/task.py"] if name.startswith("snnrl")}
    assert known == {"snnrl.model.network", "snnrl.model.draws"}


def test_nothing_in_the_package_depends_on_tools_or_tests() -> None:
    assert importers("tools") == importers("tests") == set()


def test_no_global_random_numbers() -> None:
    assert importers("random") == importers("numpy.random") == set()
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        for forbidden in ("np.random", "torch.rand", "manual_seed"):
            assert forbidden not in text, (path, forbidden)


def distribution(requirement: str) -> str:
    """Of a requirement, or a distribution's own name: the name as registries compare it."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\[<>=!~; ]", requirement)[0]).lower()


def test_what_is_imported_is_declared_and_the_other_way_round() -> None:
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    modules = {name.partition(".")[0] for names in imports().values() for name in names} - {"snnrl"}
    owners = packages_distributions()
    imported = {distribution(owners[name][0]) for name in modules - sys.stdlib_module_names}
    declared = set(map(distribution, project["dependencies"]))
    extras = {
        distribution(name) for kind in ("calibration", "parquet") for name in project["optional-dependencies"][kind]
    }
    assert imported == declared | extras
    assert not declared & extras

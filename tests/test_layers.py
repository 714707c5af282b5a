"""Who may import what: the rooms of the package, and what each may know."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import snnrl
from snnrl.extras import EXTRAS

PACKAGE = Path(snnrl.__file__).parent
LONGEST = 50  # lines of a function

# Each room and file at the top, lowest first, and what it may import of the others; commands may import anything.
MAY_IMPORT = {
    "errors": "",
    "extras": "",
    "schema": "errors",
    "files": "",
    "intervals": "",
    "model": "",
    "body": "schema model",
    "tasks": "model",
    "engines": "errors model body",
    "simulation": "model engines",
    "configuration": "errors schema model body tasks simulation",
    "drawing": "schema files intervals model body tasks",
    "recording": "errors schema extras files model body tasks engines simulation drawing",
    "running": "errors schema extras files intervals engines simulation configuration recording",
    "agents": "errors schema files intervals model body engines configuration drawing running",
    "replay": "errors schema extras files model engines simulation configuration drawing recording running",
    "beyond": "errors schema files intervals model body engines simulation configuration drawing recording running "
    "agents",
    "data": "errors files recording running",
    "plot": "errors drawing",
    "thesis": "errors schema files intervals model body engines simulation configuration drawing recording running",
}
COMMANDS = {"command", "run", "reproduce", "calibrate", "search", "collect", "environments"}


def module_of(path: Path) -> str:
    """Dotted, as it is imported."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(tree: ast.AST) -> set[str]:
    """All modules that a file imports, wherever it does, for types too."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in MODULES else node.module for name in inside}
    return names


IMPORTS = {module: imported(ast.parse(path.read_text())) for module, path in MODULES.items()}
OWN = {module: {name for name in names if name in MODULES} for module, names in IMPORTS.items()}


def room(module: str) -> str:
    """The part of the package that a module is in; "" for the package itself."""
    return f"{module}.".split(".")[1]


BETWEEN: dict[str, set[str]] = {}  # of each room, the others that it imports
for importing, others in OWN.items():
    BETWEEN.setdefault(room(importing), set()).update({room(other) for other in others} - {room(importing)})


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Names that lead from one to the next and back to the first; none if there are no such."""
    left = dict(graph)
    while left:
        free = [name for name, others in left.items() if not (others - {name}) & left.keys()]
        if not free:
            way = [next(iter(left))]
            while way[-1] not in way[:-1]:
                way.append(next(name for name in sorted(left[way[-1]]) if name in left and name != way[-1]))
            return way[way.index(way[-1]) :]
        for name in free:
            del left[name]
    return []


def imports() -> dict[str, set[str]]:
    """What each file of the package imports, by its path."""
    return {str(path.relative_to(PACKAGE)): IMPORTS[module] for module, path in MODULES.items()}


def importers(module: str) -> set[str]:
    return {path for path, names in imports().items() if any(n == module or n.startswith(f"{module}.") for n in names)}


def test_every_room_is_in_the_table_and_knows_only_what_it_may() -> None:
    assert BETWEEN.keys() == MAY_IMPORT.keys() | COMMANDS | {""}
    for module, others in OWN.items():
        if room(module) in MAY_IMPORT:
            allowed = {room(module), *MAY_IMPORT[room(module)].split()}
            assert {room(other) for other in others} <= allowed, module


def test_the_table_is_in_order_and_allows_nothing_that_is_not_used() -> None:
    lower: set[str] = set()
    for name, allowed in MAY_IMPORT.items():
        assert set(allowed.split()) <= lower, name
        lower.add(name)
        assert BETWEEN[name] == set(allowed.split()), name


def test_rooms_are_few_and_each_says_what_belongs_in_it() -> None:
    rooms = [path.parent for path in PACKAGE.rglob("__init__.py")]
    assert len([path for path in rooms if path.parent == PACKAGE]) <= 13
    for path in rooms:
        assert len(ast.get_docstring(ast.parse((path / "__init__.py").read_text())) or "") > 60, path


def test_nothing_is_imported_in_a_circle() -> None:
    assert circle(OWN) == []
    assert circle(BETWEEN) == []


def test_circles_are_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circle({"a": {"a"}}) == []
    assert circle({"x": {"a"}, "a": {"b"}, "b": {"c"}, "c": {"a"}}) == ["a", "b", "c", "a"]


def test_no_module_is_called_like_one_of_the_standard_library() -> None:
    names = {name for module in MODULES for name in module.split(".")}
    assert not names & sys.stdlib_module_names


def test_no_function_is_longer_than_a_page() -> None:
    for module, path in MODULES.items():
        if module.startswith("snnrl.engines.fused"):
            continue  # kernels
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.end_lineno is not None
                assert node.end_lineno - node.lineno < LONGEST, (module, node.name)


def test_only_the_entry_points_and_the_configuration_know_hydra_and_optuna() -> None:
    configuration = {f"configuration/{name}.py" for name in ("compose", "loader", "refusals")}
    commands = {"running/command.py", "running/jobs.py", "agents/baselines.py"}
    assert importers("hydra") == configuration | commands
    assert importers("optuna") == {"thesis/calibrate.py", "thesis/search.py"}
    assert importers("omegaconf") == configuration | commands | {"schema.py"}


def test_only_the_board_knows_tensorboard() -> None:
    assert importers("torch.utils.tensorboard") | importers("tensorboard") == {"recording/board.py"}


def test_only_one_logger_knows_mlflow() -> None:
    assert importers("mlflow") == {"recording/tracking.py"}


def test_only_the_compiled_engines_know_numba() -> None:
    assert all(path.startswith(("engines/fused/", "engines/cuda/")) for path in importers("numba"))


def test_only_the_environments_know_gymnasium() -> None:
    assert importers("gymnasium") == {"agents/environments.py"}
    assert importers("stable_baselines3") == set()


def test_only_the_window_knows_pygame() -> None:
    assert importers("pygame") == {"agents/window.py"}


def test_a_world_knows_nothing_of_a_network() -> None:
    world = {name for path, names in imports().items() if path.startswith("body/world/") for name in names}
    own = {name for name in world if name.startswith("snnrl") and not name.startswith("snnrl.body.world")}
    assert own <= {"snnrl.schema", "snnrl.model.draws", "snnrl.model.elementary"}


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
    kinds = (*EXTRAS, "data", "nwb", "parquet", "render")
    extras = {distribution(name) for kind in kinds for name in project["optional-dependencies"][kind]} - {"snnrl"}
    assert imported == declared | extras
    assert not declared & extras

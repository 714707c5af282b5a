"""What the documents show works, and what they name exists. docs/README.md says how code blocks are marked."""

from __future__ import annotations

import dataclasses
import importlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import matplotlib as mpl
import pytest
import yaml

from snnrl.schema import Config

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
RUNNABLE = [path for path in DOCUMENTS if path.parent == ROOT / "docs"]
BLOCK = re.compile(r"^```(\w+) ?(.*)\n((?:.*\n)*?)```$", re.MULTILINE)
PARTS = [
    key for key, kind in get_type_hints(Config).items() if any(map(dataclasses.is_dataclass, (kind, *get_args(kind))))
]


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path) -> list[tuple[str, str, str]]:
    """Language, mark and text of each code block that a test is to do something with."""
    found = [match.groups() for match in BLOCK.finditer(path.read_text())]
    return [(kind, mark, text) for kind, mark, text in found if mark or kind == "python"]


def commands(text: str, arguments: str) -> list[str]:
    """The lines of a shell block without their comments, with the arguments appended where a run begins."""
    lines = [line.partition("  #")[0].strip() for line in text.replace("\\\n", "").splitlines()]
    return [f"{line} {arguments}" if "experiment=" in line else line for line in lines if line]


@pytest.mark.parametrize("path", [path for path in RUNNABLE if blocks(path)], ids=name)
def test_code_blocks_work(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    mpl.use("Agg")
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    names = {"__name__": "__main__"}
    for kind, mark, text in blocks(path):
        if kind == "yaml" or (kind == "python" and mark):
            Path(mark).parent.mkdir(parents=True, exist_ok=True)
            Path(mark).write_text(text)
        elif kind == "python":
            exec(compile(text, name(path), "exec"), names)
        else:
            assert kind == "sh"
            assert mark.split()[0] == "run", mark
            for command in commands(text, mark.removeprefix("run")):
                done = subprocess.run(
                    ["bash", "-c", command], env={**os.environ, "PATH": programs}, capture_output=True, text=True
                )
                assert done.returncode == 0, (command, done.stderr)


def test_the_tutorial_shows_the_picture_that_it_makes() -> None:
    text = (ROOT / "docs" / "tutorial.md").read_text()
    assert 'plot.save(rate, "truffles"' in text
    assert "(images/truffles.png)" in text
    assert (ROOT / "docs" / "images" / "truffles.png").stat().st_size < 100_000


def anchors(text: str) -> set[str]:
    """Of the headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        aim = (path.parent / file).resolve() if file else path
        assert aim.exists(), target
        if anchor:
            assert anchor in anchors(aim.read_text()), target


def test_the_index_lists_every_document() -> None:
    index = (ROOT / "docs" / "README.md").read_text()
    for path in [*RUNNABLE, *(ROOT / "docs" / "beyond").glob("*.md")]:
        name = path.relative_to(ROOT / "docs").as_posix()
        assert name == "README.md" or f"({name})" in index, name
    assert "(docs/README.md)" in (ROOT / "README.md").read_text()


def named(text: str) -> list[str]:
    """What is between single backticks, outside of code blocks."""
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", BLOCK.sub("", text))


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_files_modules_and_keys_that_are_named_exist(path: Path) -> None:
    for word in named(path.read_text()):
        if re.fullmatch(r"(snnrl|conf|tests|tools|examples)/[\w./]*", word):
            assert (ROOT / word).exists(), word
        elif re.fullmatch(r"snnrl(\.\w+)+", word):
            assert is_there(word), word
        elif match := re.fullmatch(rf"((?:{'|'.join(PARTS)})(?:\.\w+)+)(=.*)?", word):
            assert is_key(Config, match[1].split(".")), word
        elif module := re.match(r"python -m (snnrl\.\w+)", word):
            assert is_there(module[1]), word


def is_there(dotted: str) -> bool:
    """Whether there is a module of that name, or an attribute of one."""
    module, _, attribute = dotted.rpartition(".")
    try:
        importlib.import_module(dotted)
    except ModuleNotFoundError:
        return hasattr(importlib.import_module(module), attribute)
    return True


def is_key(kind: Any, keys: list[str]) -> bool:
    """Whether a configuration can have a value under these keys; a table may have any names."""
    if not keys:
        return True
    if get_origin(kind) is dict:
        return is_key(get_args(kind)[1], keys[1:])
    nodes = [part for part in (kind, *get_args(kind)) if dataclasses.is_dataclass(part)]
    return any(keys[0] in (hints := get_type_hints(node)) and is_key(hints[keys[0]], keys[1:]) for node in nodes)


def test_keys_that_do_not_exist_are_found() -> None:
    assert is_key(Config, ["network", "synapses", "taxis", "delay"])
    assert is_key(Config, ["network", "dopamine", "tau"])
    assert not is_key(Config, ["network", "dopamine", "tua"])
    assert not is_key(Config, ["network", "synapses", "taxis", "late"])
    assert not is_key(Config, ["trials", "more"])
    assert {"network", "world", "coding"} <= set(PARTS)
    assert "trials" not in PARTS
    assert is_there("snnrl.recording.criteria.correct")
    assert not is_there("snnrl.recording.criteria.wrong")


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert citation["version"] == project["version"]
    assert {"cff-version", "title", "message", "authors"} <= set(citation)
    assert [reference["year"] for reference in citation["references"]] == [2012, 2003, 2007]
    assert project["version"] in (ROOT / "CHANGELOG.md").read_text()

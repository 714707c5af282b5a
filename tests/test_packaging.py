"""The wheel is complete."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import snnrl

ROOT = Path(__file__).parents[1]


def test_the_wheel_carries_the_configuration_and_runs_from_any_folder(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    built = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert built.returncode == 0, built.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    packed = {path.name for path in (tmp_path / "installed" / "snnrl" / "conf" / "experiment").iterdir()}
    assert packed == {path.name for path in (ROOT / "conf" / "experiment").iterdir()}
    assert (tmp_path / "installed" / "snnrl" / "py.typed").is_file()
    assert (tmp_path / "installed" / "hydra_plugins" / "snnrl_dask.py").is_file()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run = [sys.executable, "-P", "-m", "snnrl.run", "+experiment=dual_learning", "trials=1", "seconds=0.7"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "installed")}
    done = subprocess.run(
        [*run, "engine=reference", "hydra.run.dir=out"],
        cwd=elsewhere,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (elsewhere / "out" / "summary.json").is_file()


def test_the_version_is_the_projects() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert snnrl.__version__ == project["version"]

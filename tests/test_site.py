"""The documents as a site: every page, link and anchor, and the reference from docstrings."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import snnrl

ROOT = Path(__file__).parents[1]


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "api" / "index.html").read_text()
    for name in set(snnrl.__all__) - {"__version__", "plot", "schema"}:
        assert f".{name}" in reference, name
    assert "snnrl.schema.NetworkConfig" in reference
    assert "snnrl.plot.raster" in reference
    tutorial = (tmp_path / "tutorial" / "index.html").read_text()
    assert "```" not in tutorial

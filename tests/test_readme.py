"""What the README shows works."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_verdicts_are_those_of_the_report() -> None:
    cells = json.loads((ROOT / "docs" / "results" / "report.json").read_text())["cells"]
    keys = ("experiment", "robot", "quantity", "verdict")
    reported = Counter(tuple(cell[key].replace("_", " ") for key in keys) for cell in cells)
    rows = [[part.strip() for part in line.split("|")[1:-1]] for line in README.splitlines() if line.startswith("| ")]
    told = Counter((row[0], row[1], row[2].removesuffix(", s"), row[5]) for row in rows if len(row) == 6)
    assert told - Counter([("experiment", "robot", "", "verdict")]) == reported
    count = Counter(cell["verdict"] for cell in cells)
    assert (
        f"{count['equivalent']} equivalent, {count['inconclusive']} inconclusive, {count['differs']} differ "
        f"of {len(cells)} published cells"
    ) in README


def test_the_library_example_runs_as_printed(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(example.splitlines()) <= 20
    done = subprocess.run(
        [sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "size=(100, 20, 40)" in done.stdout

"""Every fault of the harness, once."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_runs_survive_every_fault() -> None:
    done = subprocess.run(
        [sys.executable, "tools/faults.py", "--times", "1"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert {line.split()[0] for line in lines} == {
        *("kill", "damage", "stop", "full", "readonly", "shared", "sweep", "clock")
    }
    assert all(re.search("1 of 1 right|skipped: a small disk cannot be mounted", line) for line in lines)

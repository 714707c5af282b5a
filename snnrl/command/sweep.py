"""`snnrl sweep`: `snnrl run -m`."""

from __future__ import annotations

import sys

from snnrl.command import run

parser = run.parser


def main() -> None:
    """Run an experiment for every combination of values."""
    sys.argv.insert(1, "-m")
    run.main()

"""What is installed only where it is asked for, `pip install "snnrl[EXTRA]"`, and one line where it is missing."""

from __future__ import annotations

import sys
from importlib.util import find_spec

EXTRAS = {  # what pyproject.toml installs for each, as it is imported
    "dashboards": ("tensorboard", "matplotlib", "PIL", "scipy"),
    "mlflow": ("mlflow", "matplotlib", "PIL", "scipy"),
    "figures": ("matplotlib", "PIL", "scipy"),
    "statistics": ("scipy",),
    "environments": ("gymnasium",),
    "thesis": ("jinja2", "matplotlib", "PIL", "scipy"),
    "calibration": ("optuna", "jinja2", "matplotlib", "PIL", "scipy"),
}


def lacks(extra: str) -> str:
    """What to do about an extra of which something is not installed; "" where all is."""
    missing = [name for name in EXTRAS[extra] if find_spec(name) is None]
    return f'needs {", ".join(missing)}: pip install "snnrl[{extra}]"' if missing else ""


def demand(program: str, extra: str) -> None:
    """End the program with one line, and the status for bad input, where an extra is missing."""
    if line := lacks(extra):
        print(f"{program}: {line}", file=sys.stderr)
        sys.exit(2)

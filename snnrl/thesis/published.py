"""The thesis's numbers, for the comparison and the calibration alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

PUBLISHED = Path(__file__).with_name("published.yaml")


def published() -> dict[str, Any]:
    """See published.yaml."""
    return dict(yaml.safe_load(PUBLISHED.read_text()))

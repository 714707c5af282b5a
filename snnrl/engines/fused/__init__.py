"""The fused engine: the whole closed loop compiled for the CPU, threads over trials."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from numba.core import config as numba_config

config: Any = numba_config


def _cache_dir() -> str:
    """Where compiled code is kept: a folder a version of these sources.

    Numba alone would notice a change of the file that holds a cached function, but not of the files
    that it calls into.
    """
    sources = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return str(Path(config.CACHE_DIR or home / "snnrl") / digest)


_user_cache_dir = config.CACHE_DIR
config.CACHE_DIR = _cache_dir()
try:
    from snnrl.engines.fused.engine import FusedEngine
finally:
    config.CACHE_DIR = _user_cache_dir

__all__ = ["FusedEngine"]

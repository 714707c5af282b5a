"""Functions that a configuration names: the package's own, and those of a user's file or module."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from snnrl.errors import ConfigError


def function(key: str, name: Any, own: Mapping[str, Any]) -> Any:
    """What a name stands for: one of our own, or NAME in FILE.py:NAME or MODULE:NAME; a function stands for itself.

    Raises:
        ConfigError: there is no such thing.
    """
    if not isinstance(name, str):
        return name
    if name in own:
        return own[name]
    place, colon, attribute = name.rpartition(":")
    if not colon or not place:
        raise ConfigError(key, name, f"must be one of {', '.join(own)}, or FILE.py:NAME or MODULE:NAME")
    found = getattr(_module(key, name, place), attribute, None)
    if not isinstance(found, Callable):  # type: ignore[arg-type]
        raise ConfigError(key, name, f"{place} has no function {attribute}")
    return found


def _module(key: str, name: str, place: str) -> ModuleType:
    try:
        if not place.endswith(".py"):
            return importlib.import_module(place)
        path = Path(place).resolve()
        unique = f"snnrl_user {path}"
        if unique not in sys.modules:
            spec = importlib.util.spec_from_file_location(unique, path)
            assert spec is not None
            assert spec.loader is not None
            sys.modules[unique] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(sys.modules[unique])
        return sys.modules[unique]
    except Exception as error:
        sys.modules.pop(place, None)
        raise ConfigError(key, name, f"{place} cannot be imported ({type(error).__name__}: {error})") from error

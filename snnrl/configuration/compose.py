"""Hydra's side of a configuration: where conf/ is, the schema it knows, and plain dataclasses out of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

from snnrl.configuration.loader import guarded
from snnrl.configuration.refusals import Refusal, misfit, reason, unreadable
from snnrl.errors import ConfigError
from snnrl.schema import BaselinesConfig, Config

ConfigStore.instance().store(name="schema", node=Config)
ConfigStore.instance().store(name="baselines_schema", node=BaselinesConfig)


def conf_dir() -> str:
    """The folder of configurations: inside an installed package, beside the package in a checkout."""
    here = Path(__file__).resolve().parents[1]
    installed = here / "conf"
    return str(installed if installed.is_dir() else here.parent / "conf")


def compose(*overrides: str) -> Config:
    """The configuration that the command line `python -m snnrl.run OVERRIDES` would get; also inside a Hydra job."""
    config = _composed("config", overrides)
    assert isinstance(config, Config)
    return config


def compose_baselines(*overrides: str) -> BaselinesConfig:
    """The same of `python -m snnrl.run +experiment=baselines OVERRIDES`: the options of agents without neurons."""
    options = _composed("baselines", overrides)
    assert isinstance(options, BaselinesConfig)
    return options


def _composed(name: str, overrides: Sequence[str]) -> Any:
    running = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with guarded(), hydra.initialize_config_dir(conf_dir(), version_base="1.3"):
            return plain(hydra.compose(name, overrides=list(overrides)))
    finally:
        GlobalHydra.instance().hydra = running


def outline(*overrides: str, config: str = "config", folder: str | None = None) -> dict[str, Any]:
    """What a command line would compose, as plain values that need not be complete: "???" is missing, ${...} refers.

    Args:
        config: name of the configuration that it is.
        folder: of further files, as `--config-dir` gives it.

    Raises:
        ConfigError: it cannot be composed.
    """
    further = [f"hydra.searchpath=[file://{Path(folder).resolve()}]"] if folder else []
    with guarded(), hydra.initialize_config_dir(conf_dir(), version_base="1.3"):
        composed = hydra.compose(config, overrides=[*further, *overrides])
    found = OmegaConf.to_container(composed, resolve=False)
    assert isinstance(found, dict)
    return {str(name): value for name, value in found.items()}


def load(path: Path) -> Config:
    """The configuration that a run folder's config.yaml holds.

    Raises:
        ConfigError: it cannot be read as one.
        OSError: there is no such file.
    """
    try:
        saved = OmegaConf.load(path)
    except (YAMLError, OmegaConfBaseException, UnicodeDecodeError, RecursionError, OSError) as error:
        if isinstance(error, OSError) and error.errno:
            raise
        raise unreadable(error, path) from error
    if found := misfit(Config, OmegaConf.to_container(saved, resolve=False)):
        raise Refusal(f"{path}: {found}")
    try:
        config: Config = plain(OmegaConf.merge(OmegaConf.structured(Config), saved))  # type: ignore[arg-type]
    except OmegaConfBaseException as error:
        raise Refusal(f"{path}: {reason(error)}") from error
    return config


def dump(config: Config) -> str:
    """A configuration as the text that `load` reads."""
    return OmegaConf.to_yaml(OmegaConf.structured(config))


def plain(config: DictConfig) -> Any:
    """The composed configuration as dataclasses: what its schema in the ConfigStore is.

    Raises:
        ConfigError: where a value has no meaning as it stands (a dangling reference, a missing value).
    """
    try:
        return OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        key, node = error.full_key or "configuration", error.child_node
        if isinstance(error, MissingMandatoryValue):
            raise ConfigError(key, MISSING, "a value must be given") from error
        raise ConfigError(key, "?" if node is None else node._value(), str(error).splitlines()[0]) from error

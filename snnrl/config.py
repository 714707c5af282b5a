"""Hydra's side of a configuration: where conf/ is, the schema it knows, and plain dataclasses out of it."""

from __future__ import annotations

from pathlib import Path

import hydra
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from snnrl.schema import Config, ConfigError

ConfigStore.instance().store(name="schema", node=Config)


def conf_dir() -> str:
    """The folder of configurations: inside an installed package, beside the package in a checkout."""
    here = Path(__file__).resolve().parent
    installed = here / "conf"
    return str(installed if installed.is_dir() else here.parent / "conf")


def compose(*overrides: str) -> Config:
    """The configuration that the command line `python -m snnrl.run OVERRIDES` would get."""
    with hydra.initialize_config_dir(conf_dir(), version_base="1.3"):
        return plain(hydra.compose("config", overrides=list(overrides)))


def plain(config: DictConfig) -> Config:
    """The composed configuration as dataclasses.

    Raises:
        ConfigError: where a value has no meaning as it stands (a dangling reference, a missing value).
    """
    try:
        result = OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        message = str(error).splitlines()[0]
        raise ConfigError(error.full_key or "config", "?", message) from error
    assert isinstance(result, Config)
    return result

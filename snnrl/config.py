"""Hydra's side of a configuration: where conf/ is, the schema it knows, and plain dataclasses out of it."""

from __future__ import annotations

from pathlib import Path

import hydra
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

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


def load(path: Path) -> Config:
    """The configuration that a run folder's config.yaml holds.

    Raises:
        ConfigError: it cannot be read as one.
        OSError: there is no such file.
    """
    try:
        saved = OmegaConf.load(path)
        return plain(OmegaConf.merge(OmegaConf.structured(Config), saved))  # type: ignore[arg-type]
    except (OmegaConfBaseException, YAMLError, UnicodeDecodeError) as error:
        raise ConfigError("config", path, " ".join(str(error).split())) from error


def dump(config: Config) -> str:
    """A configuration as the text that `load` reads."""
    return OmegaConf.to_yaml(OmegaConf.structured(config))


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

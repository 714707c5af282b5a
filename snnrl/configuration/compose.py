"""Hydra's side of a configuration: where conf/ is, the schema it knows, and plain dataclasses out of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

import hydra
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from snnrl.configuration.schema import BaselinesConfig, Config, ConfigError

ConfigStore.instance().store(name="schema", node=Config)
ConfigStore.instance().store(name="baselines_schema", node=BaselinesConfig)
# what the names that make objects may begin with
ALLOWED: dict[Any, tuple[str, ...]] = {
    "_target_": ("hydra._internal.core_plugins.", "hydra_plugins."),
    "class": ("logging.",),
    "()": ("colorlog.",),
}


def conf_dir() -> str:
    """The folder of configurations: inside an installed package, beside the package in a checkout."""
    here = Path(__file__).resolve().parents[1]
    installed = here / "conf"
    return str(installed if installed.is_dir() else here.parent / "conf")


@contextmanager
def guarded() -> Iterator[None]:
    """While this lasts, what Hydra composes is checked before Hydra acts on it.

    Raises:
        ConfigError: where a choice leaves the folder of its group, or an object is to be made that is
            neither Hydra's own nor of one of its plugins.
    """
    load = ConfigLoaderImpl.load_configuration

    def checked(self: ConfigLoaderImpl, *args: Any, **kwargs: Any) -> DictConfig:
        try:
            config = load(self, *args, **kwargs)
        except RecursionError:
            raise ConfigError("configuration", "...", "is nested too deeply") from None
        for group, choice in config.hydra.runtime.choices.items():
            if choice is not None and (".." in PurePath(choice).parts or PurePath(choice).is_absolute()):
                raise ConfigError(group, choice, "must be a name inside the folder of configurations")
        _check_objects(OmegaConf.to_container(config.hydra, resolve=False), "hydra")
        return config

    ConfigLoaderImpl.load_configuration = checked  # type: ignore[method-assign]
    try:
        yield
    finally:
        ConfigLoaderImpl.load_configuration = load  # type: ignore[method-assign]


def _check_objects(node: Any, key: str) -> None:
    """`_target_` is Hydra's way to name a callable; `()` and `class` are those of its logging."""
    parts = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, value in parts:
        path = f"{key}.{name}"
        if name in ALLOWED and not str(value).startswith(ALLOWED[name]):
            raise ConfigError(path, value, f"must begin with {' or '.join(ALLOWED[name]) or 'nothing: not allowed'}")
        _check_objects(value, path)


def compose(*overrides: str) -> Config:
    """The configuration that the command line `python -m snnrl.run OVERRIDES` would get; also inside a Hydra job."""
    running = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with guarded(), hydra.initialize_config_dir(conf_dir(), version_base="1.3"):
            config = plain(hydra.compose("config", overrides=list(overrides)))
    finally:
        GlobalHydra.instance().hydra = running
    assert isinstance(config, Config)
    return config


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


def plain(config: DictConfig) -> Any:
    """The composed configuration as dataclasses: what its schema in the ConfigStore is.

    Raises:
        ConfigError: where a value has no meaning as it stands (a dangling reference, a missing value).
    """
    try:
        return OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        message = str(error).splitlines()[0]
        raise ConfigError(error.full_key or "config", "?", message) from error

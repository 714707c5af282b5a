"""Hydra's loader of configurations, made to refuse in one line, and to let nothing in from outside."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import PurePath
from typing import Any, get_args, get_origin, get_type_hints

import hydra._internal.hydra as made
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import CachingConfigRepository
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from snnrl.configuration.refusals import OVERRIDE, Refusal, misfit, nested, reason, unreadable, without_none
from snnrl.errors import ConfigError
from snnrl.schema import BaselinesConfig, Config

SCHEMAS = {"config": Config, "baselines": BaselinesConfig}
# what the names that make objects may begin with
ALLOWED: dict[Any, tuple[str, ...]] = {
    "_target_": ("hydra._internal.core_plugins.", "hydra_plugins."),
    "class": ("logging.",),
    "()": ("colorlog.",),
}


@contextmanager
def guarded() -> Iterator[None]:
    """While this lasts, Hydra's configurations are loaded by `Loader`."""
    usual = made.ConfigLoaderImpl
    vars(made)["ConfigLoaderImpl"] = Loader
    try:
        yield
    finally:
        vars(made)["ConfigLoaderImpl"] = usual


class Loader(ConfigLoaderImpl):
    """Loads a configuration, or raises ConfigError for whatever is wrong with the command line or a file.

    Wrong is also a choice that leaves the folder of its group, and an object to be made that is neither Hydra's own
    nor of one of its plugins. A loader travels with its class to the processes of a sweep.
    """

    def load_configuration(
        self, config_name: str | None, overrides: list[str], *args: Any, **kwargs: Any
    ) -> DictConfig:
        kind = SCHEMAS.get(config_name or "", Config)
        try:
            config: DictConfig = super().load_configuration(config_name, overrides, *args, **kwargs)
        except RecursionError:
            raise ConfigError("configuration", "...", "is nested too deeply") from None
        except YAMLError as error:
            raise unreadable(error, config_name) from error
        except ConfigError:
            raise
        except (HydraException, OmegaConfBaseException, ValueError, OverflowError) as error:
            raise self._refusal(error, kind, overrides) from error
        for group, choice in config.hydra.runtime.choices.items():
            if choice is not None and (".." in PurePath(choice).parts or PurePath(choice).is_absolute()):
                raise ConfigError(group, choice, "must be a name inside the folder of configurations")
        for name in ("launcher", "sweeper"):
            if not isinstance(config.hydra[name], DictConfig):
                raise ConfigError(f"hydra.{name}", config.hydra[name], f"must be chosen with hydra/{name}=NAME")
        _check_objects(OmegaConf.to_container(config.hydra, resolve=False), "hydra")
        return config

    def _load_single_config(self, default: Any, repo: Any) -> Any:
        self.latest = default.config_path, super()._load_single_config(default, repo)
        return self.latest[1]

    def _refusal(self, error: Exception, kind: Any, overrides: list[str]) -> ConfigError:
        """By the file or the override that does not fit the schema, if there is one; else by what Hydra says."""
        if "raised while composing config" in str(error):
            path, loaded = self.latest
            if found := misfit(kind, OmegaConf.to_container(loaded.config, resolve=False)):
                return Refusal(f"{path}.yaml: {found}")
        elif not isinstance(error, (OverrideParseException, MissingConfigException)):
            for override in OverridesParser.create().parse_overrides(overrides):
                if not (override.is_sweep_override() or override.is_delete() or self._chooses(override, kind)) and (
                    found := misfit(kind, nested(override.key_or_group, override.value()))
                ):
                    return found
        return Refusal(reason(error, kind))

    def _chooses(self, override: Override, kind: Any) -> bool:
        """Whether this chooses one of the files of a group, in a place that the schema has."""
        key = override.key_or_group
        in_place = "/" in key or misfit(kind, nested(key, {})) is None
        return in_place and isinstance(override.value(), str) and self.repository.group_exists(key)

    def _parse_overrides_and_create_caching_repo(
        self, config_name: str | None, overrides: list[str]
    ) -> tuple[list[Override], CachingConfigRepository]:
        parsed, files = super()._parse_overrides_and_create_caching_repo(config_name, overrides)
        for override in parsed:
            key, value, is_group = override.key_or_group, override.value(), files.group_exists(override.key_or_group)
            if key == "experiment" and override.type == OverrideType.CHANGE and not isinstance(value, dict):
                override.type = OverrideType.ADD  # the one group without a default, which nobody need know
            if not key:
                raise Refusal(f"{override.input_line}: {OVERRIDE}")
            if override.is_sweep_override():
                continue
            if is_group and override.is_delete() and not isinstance(value, str | None):
                raise Refusal(f"{override.input_line}: must be ~{key}")
            if is_group and not override.is_delete() and not isinstance(value, (str, list, dict)):
                options = ", ".join(files.get_group_options(key))
                raise ConfigError(key, value, f"must be one of {options}; ~{key} leaves it out")
            if override.is_add() or override.is_force_add():
                _make_room(override, SCHEMAS.get(config_name or "", Config))
        return parsed, Files(files)


class Files(CachingConfigRepository):
    """The files of a configuration; one that cannot be read is named."""

    def load_config(self, config_path: str) -> Any:
        try:
            return super().load_config(config_path)
        except (YAMLError, ValueError, OSError) as error:
            raise unreadable(error, f"{config_path}.yaml") from error


def _make_room(override: Override, kind: Any) -> None:
    """Let what is added to a table of a schema be merged into the table, which then gives it its type."""
    names = override.key_or_group.split(".")
    for depth, name in enumerate(names):
        kind, _ = without_none(kind)
        if get_origin(kind) is dict and is_dataclass(get_args(kind)[1]):
            override.key_or_group, override._value = ".".join(names[:depth]), nested(names[depth:], override.value())
            return
        kind = get_type_hints(kind).get(name) if is_dataclass(kind) else None


def _check_objects(node: Any, key: str) -> None:
    """`_target_` is Hydra's way to name a callable; `()` and `class` are those of its logging."""
    parts = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, value in parts:
        path = f"{key}.{name}"
        if name in ALLOWED and not str(value).startswith(ALLOWED[name]):
            raise ConfigError(path, value, f"must begin with {' or '.join(ALLOWED[name]) or 'nothing: not allowed'}")
        _check_objects(value, path)

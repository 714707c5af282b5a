"""What a word on the command line may become: parts and their files, and keys with their values."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from snnrl.command.choices import described, experiments
from snnrl.command.keys import Key, keys_of
from snnrl.configuration.compose import conf_dir, outline
from snnrl.errors import ConfigError
from snnrl.schema import Config


def complete(prefix: str, parsed_args: Namespace, **asked: Any) -> list[str]:
    """All words that this one may become, for `argcomplete`: a key as far as its next dot, or its values."""
    folder, given = parsed_args.config_dir, list(parsed_args.overrides or [])
    bare = prefix.lstrip("+~")
    sign = prefix.removesuffix(bare)
    name, equals = bare.partition("=")[:2]
    keys = {key.path: key for key in known(given, folder)}
    if equals:
        return [f"{sign}{name}={value}" for value in values_of(name, keys, folder)]
    groups = [place.name for place in Path(conf_dir()).iterdir() if place.is_dir()]
    return [f"{sign}{word}" for word in next_part({*groups, *keys}, name)]


def known(given: list[str], folder: str | None) -> list[Key]:
    """The keys of what is composed so far; of a configuration without an experiment where that cannot be."""
    try:
        values = outline(*given, folder=folder)
    except ConfigError:
        values = outline()
    return list(keys_of(Config, values, named=True))


def values_of(name: str, keys: dict[str, Key], folder: str | None) -> list[str]:
    """What can be chosen for a key: the files of a part, or what the schema names."""
    if name == "experiment":
        return list(experiments(folder))
    return list(described(name, folder)) or list(keys[name].choices if name in keys else ())


def next_part(paths: Iterable[str], start: str) -> list[str]:
    """The paths that begin so, each as far as its next dot; beyond where all agree."""
    rest = [path[len(start) :].partition(".") for path in paths if path.startswith(start)]
    found = sorted({f"{start}{head}{dot or '='}" for head, dot, _ in rest})
    return next_part(paths, found[0]) if len(found) == 1 and found[0].endswith(".") else found

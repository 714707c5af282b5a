"""What is wrong with a command line, or with a file of a configuration, in one line: what, and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import is_dataclass
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from hydra.conf import HydraConf
from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf import MISSING, BooleanNode, FloatNode, IntegerNode, StringNode
from omegaconf.errors import OmegaConfBaseException, ValidationError
from yaml import MarkedYAMLError

from snnrl.errors import ConfigError
from snnrl.schema import Config, no_such_key

SCALARS: dict[Any, tuple[Any, str]] = {
    bool: (BooleanNode, "true or false"),
    int: (IntegerNode, "a whole number"),
    float: (FloatNode, "a number"),
    str: (StringNode, "a name"),
}
OVERRIDE = "must be KEY=VALUE, +KEY=VALUE or ~KEY, with all brackets and quotes closed"
HYDRA = (  # what it says, and what that means
    (r"Error parsing override '(.*?)' (Unknown function .*|\w+ while evaluating .*) See https.*", r"\1: \2"),
    (r"Could not override '(.*)'\. To append to your config use (.*)", r"\1: is not there; to add it write \2"),
    (r"(\S*) appears more than once in .* defaults list", r"\1: is chosen already; to choose another write \1=NAME"),
    (r"Error merging override ~(.*)", r"~\1: cannot be left out"),
    (r"Could not delete from config\. '(.*)' does not exist\.", r"~\1: there is no such key"),
    (r"Could not delete '(.*)'\. No match in the defaults list", r"~\1: is not chosen"),
    (r"Could not append to config\. An item is already at '(.*)'\..*", r"+\1: is there already, write \1=VALUE"),
    (r"Ambiguous value for argument '(.*)' 1\. .*", r"\1: several values need -m (a sweep) or [...] (a list)"),
    (r"Sweep parameters '(.*)' requires --multirun", r"\1: needs -m (a sweep)"),
)


class Refusal(ConfigError):
    """A `ConfigError` whose line does not begin with one key and its value."""

    def __init__(self, line: str) -> None:
        ValueError.__init__(self, line)


def without_none(kind: Any) -> tuple[Any, bool]:
    """A type less its `| None`, and whether it had one."""
    parts = [part for part in get_args(kind) if part is not NoneType]
    optional = NoneType in get_args(kind)
    return (parts[0] if optional and len(parts) == 1 else kind), optional


def required(kind: Any) -> str:
    """What a value of a type of the schema must be."""
    kind, optional = without_none(kind)
    if is_dataclass(kind):
        text = f"must hold {', '.join(get_type_hints(kind))}"
    elif get_origin(kind) is dict:
        part = required(get_args(kind)[1]).removeprefix("must ")
        text = f"must be a table {{NAME: ...}}, each of which must {part}"
    elif get_origin(kind) is list:
        text = "must be a list [...]"
    else:
        text = f"must be {SCALARS[kind][1]}" if kind in SCALARS else "must be of another type"
    return f"{text}, or null" if optional else text


def misfit(kind: Any, value: Any, key: str = "") -> ConfigError | None:
    """The first place where a plain value is not of a type of the schema; None if it is.

    Missing values (???) and references (${...}) are of any type.

    Args:
        kind: a dataclass, dict, list or scalar type; of any other everything is.
        value: made of dictionaries, lists, numbers and text.
        key: of the value; "" is the whole configuration, which may have Hydra's own in it.
    """
    wrong = ConfigError(key or "configuration", value, required(kind))
    kind, optional = without_none(kind)
    if (value is None and optional) or (isinstance(value, str) and (value == MISSING or "${" in value)):
        return None
    origin = get_origin(kind)
    if is_dataclass(kind) or origin is dict:
        return _misfit_inside(kind, value, key) if isinstance(value, dict) else wrong
    if origin is list and isinstance(value, list):
        return next(filter(None, (misfit(get_args(kind)[0], part, key) for part in value)), None)
    try:
        if kind in SCALARS:
            SCALARS[kind][0](value, is_optional=False)
    except (ValidationError, OverflowError):
        return wrong
    return wrong if origin is list else None


def _misfit_inside(kind: Any, table: dict[Any, Any], key: str) -> ConfigError | None:
    hints = get_type_hints(kind) if is_dataclass(kind) else dict.fromkeys(table, get_args(kind)[1])
    for name, part in table.items():
        inner = f"{key}.{name}" if key else name
        if not isinstance(name, str):
            return ConfigError(key, name, "cannot be a name; in quotes it can")
        if inner != "hydra" and name not in hints:
            return ConfigError(inner, part, no_such_key(inner, hints))
        if found := misfit(HydraConf if inner == "hydra" else hints[name], part, inner):
            return found
    return None


def nested(key: str | Sequence[str], value: Any) -> Any:
    """A value under a key (a.b.c), or under its names, as dictionaries inside each other."""
    for name in reversed(key.split(".") if isinstance(key, str) else key):
        value = {name: value}
    return value


def unreadable(error: Exception, name: object) -> Refusal:
    """For a file of that name that is no YAML, or not what a configuration is; names line and column."""
    if isinstance(error, MarkedYAMLError) and (mark := error.problem_mark or error.context_mark):
        place = f"{mark.name}, line {mark.line + 1}, column {mark.column + 1}"
        return Refusal(f"{place}: {error.problem or error.context}")
    return Refusal(f"{name}: cannot be read ({' '.join(str(error).split())})")


def reason(error: BaseException, kind: Any = Config) -> str:
    """What Hydra or OmegaConf has to say about a configuration with that schema."""
    text, _, _ = " ".join(str(error).split()).partition(" Config search path:")
    for said, meant in HYDRA:
        if re.fullmatch(said, text):
            return re.sub(said, meant, text)
    if isinstance(error, OverrideParseException):
        return f"{error.override.strip() or repr(error.override)}: {OVERRIDE}"
    if isinstance(error, OmegaConfBaseException):
        return _of_key(error, kind)
    if isinstance(error, MissingConfigException) and error.options:
        group = text.partition("Available options in '")[2].partition("'")[0]
        chosen = str(error.missing_cfg_file).removeprefix(f"{group}/")
        return f"{group}={chosen}: must be one of {', '.join(error.options)}"
    file = re.match(r"In '(.*?)': ", text)
    place, inner = f"{file[1]}.yaml: " if file else "", error.__cause__ or error.__context__
    return f"{place}{_of_key(inner, kind)}" if isinstance(inner, OmegaConfBaseException) else text


def _of_key(error: OmegaConfBaseException, kind: Any) -> str:
    line = (str(error).splitlines() or [type(error).__name__])[0]
    if missing := re.search(r"Missing mandatory value: (\S+)", line):
        return f"{missing[1]}={MISSING}: a value must be given"
    if not error.full_key:
        return line
    found = misfit(kind, nested(error.full_key, "..." if error.value is None else error.value))
    return str(found) if found else f"{error.full_key}: {line}"

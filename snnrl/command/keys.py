"""The keys of a configuration: what each means, its unit, what is allowed, and what it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

from snnrl.configuration.refusals import required, without_none
from snnrl.schema import allowed

NAME = "NAME"  # stands for any name in a table


@dataclass(frozen=True)
class Key:
    """One value of a configuration.

    Attributes:
        path: with dots.
        value: as it is composed; "???" where an experiment, or whoever adds to a table, must give it.
        allowed: type and bounds, in words.
        choices: the values that it can have, if they have names.
    """

    path: str
    value: Any
    unit: str
    allowed: str
    meaning: str
    choices: tuple[str, ...]

    def __str__(self) -> str:
        about = "; ".join(part for part in (self.unit, self.allowed, self.meaning) if part)
        return f"{self.path}={plainly(self.value)}\n    {about}"


def plainly(value: Any) -> str:
    """A value as the command line takes it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return f"[{','.join(map(plainly, value))}]"
    if isinstance(value, dict):
        return f"{{{','.join(f'{name}:{plainly(part)}' for name, part in value.items())}}}"
    return str(value)


def keys_of(kind: Any, values: Mapping[str, Any], named: bool, path: str = "") -> Iterator[Key]:
    """All keys of a dataclass of the schema, in its order.

    Args:
        values: of the dataclass, nested like it; what is left out is as the schema has it.
        named: whether the names in tables are those of the values, or NAME for any.
    """
    hints = get_type_hints(kind)
    for item in fields(kind):
        inner, _ = without_none(hints[item.name])
        here, value = f"{path}{item.name}", values.get(item.name, default_of(item))
        if is_dataclass(inner):
            yield from keys_of(inner, value if isinstance(value, dict) else {}, named, f"{here}.")
        elif get_origin(inner) is dict and is_dataclass(part := get_args(inner)[1]):
            for name, row in value.items() if named and isinstance(value, dict) else [(NAME, {})]:
                yield from keys_of(part, row if isinstance(row, dict) else {}, named, f"{here}.{name}.")
        else:
            about = item.metadata
            bounds = allowed(about) or required(hints[item.name]).removeprefix("must ").removeprefix("be ")
            choices = ("true", "false") if inner is bool else about["choices"] or ()
            yield Key(here, value, about["unit"], bounds, about["meaning"], choices)


def default_of(item: Field[Any]) -> Any:
    """What a field of the schema is where nothing gives it."""
    return item.default if item.default_factory is MISSING else item.default_factory()

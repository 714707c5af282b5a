"""How a mechanism that is written for tensors is compiled for numbers.

A mechanism is a pure elementwise function: `torch.where(fired, c, v)` and arithmetic on what it is given. On tensors
it is what it says. Here the same function is compiled by numba, in the network's precision: the functions of torch
that it may use are given a meaning for numbers, and its constants are those of torch's arithmetic, which takes a
Python number in the precision of the tensor beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
import torch
from numba import njit
from numba.extending import overload

NUMBERS = (float, np.floating)


@overload(torch.where)
def _where(condition, one, other):
    return lambda condition, one, other: one if condition else other


@overload(torch.minimum)
def _minimum(one, other):
    return lambda one, other: one if one < other else other


@overload(torch.maximum)
def _maximum(one, other):
    return lambda one, other: one if one > other else other


@overload(torch.clamp)
def _clamp(value, min, max):
    return lambda value, min, max: max if value > max else min if value < min else value


@overload(torch.sign)
def _sign(value):
    real = value
    return lambda value: real((value > 0) - (value < 0))


@overload(torch.remainder)
def _remainder(value, divisor):
    return lambda value, divisor: value % divisor


@overload(torch.logical_not)
def _logical_not(value):
    return lambda value: not value


def _give_meaning(function: Any, meaning: Any) -> None:
    overload(function)(lambda value: lambda value: meaning(value))


for _name in ("exp", "log", "sqrt", "sin", "cos", "tanh", "floor"):
    _give_meaning(getattr(torch, _name), getattr(math, _name))
_give_meaning(torch.abs, abs)

_known: dict[tuple[Callable[..., Any], Any], Any] = {}


def compiled(function: Callable[..., Any], real: Any = np.float64) -> Any:
    """A mechanism as a compiled function of numbers of the type `real`, with the functions that it calls.

    The same function and type give the same object.
    """
    if (function, real) not in _known:
        assert isinstance(function, FunctionType), function
        code = function.__code__
        constants = tuple(real(value) if isinstance(value, NUMBERS) else value for value in code.co_consts)
        names = {name: function.__globals__[name] for name in code.co_names if name in function.__globals__}
        found = {name: _as_seen(value, real) for name, value in names.items()} | {"__name__": function.__module__}
        same = FunctionType(code.replace(co_consts=constants), found, function.__name__, None, function.__closure__)
        _known[function, real] = njit(same, forceinline=True)
    return _known[function, real]


def _as_seen(value: Any, real: Any) -> Any:
    """What a name outside of a compiled function stands for inside of it."""
    if isinstance(value, NUMBERS):
        return real(value)
    return compiled(value, real) if isinstance(value, FunctionType) else value

"""How what is written for tensors, and kernels in plain Python, are compiled for a GPU.

As in `snnrl.engines.fused.compiler`, a mechanism's constants are those of torch's arithmetic, names stand for what a
network says, and a module with a PRECISION of its own is compiled in that one. In the code of a mechanism, `torch` is
`snnrl.engines.cuda.scalars`. In numba's simulator (NUMBA_ENABLE_CUDASIM=1) the same functions run as Python, on
numbers of NumPy.
"""

from __future__ import annotations

import dis
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
import torch
from numba import cuda, types

from snnrl.engines.cuda import scalars
from snnrl.engines.fused.compiler import NUMBERS, placeholder, settings
from snnrl.errors import ConfigError

SIMULATED = bool(settings.ENABLE_CUDASIM)
BLOCKS = 8  # that have room on a multiprocessor at least
WARP = 1 if SIMULATED else 32  # threads that can add up without waiting
jit: Any = cuda.jit
KNOWN = {name: value for name, value in vars(scalars).items() if isinstance(value, FunctionType)}
_UNKNOWN = object()


@placeholder
def barrier():
    """All threads of a block wait for each other."""


@placeholder
def anywhere(flag):
    """All threads of a block wait for each other; returns whether the flag of any is set."""


@placeholder
def count(array, index):
    """Add one to a whole number in an array, whatever other threads do."""


@placeholder
def mark(array, index, bit):
    """Set a bit of a whole number in an array, whatever other threads do."""


@placeholder
def lowest(word):
    """The number of the lowest bit that is set."""


@placeholder
def sum_of_warp(value):
    """The sum of what all threads of a warp have, for the first of them; its order is always the same."""


@placeholder
def real(number):
    """A number in the network's precision."""


def _wait():
    cuda.syncthreads()


def _anywhere(flag):
    return cuda.syncthreads_or(np.int32(flag)) != 0


def _count(array, index):
    cuda.atomic.add(array, index, 1)


def _mark(array, index, bit):
    cuda.atomic.or_(array, index, bit)


def _lowest(word):
    return cuda.ffs(word) - 1


def _sum_of_warp(value):
    value += cuda.shfl_down_sync(0xFFFFFFFF, value, 16)
    value += cuda.shfl_down_sync(0xFFFFFFFF, value, 8)
    value += cuda.shfl_down_sync(0xFFFFFFFF, value, 4)
    value += cuda.shfl_down_sync(0xFFFFFFFF, value, 2)
    return value + cuda.shfl_down_sync(0xFFFFFFFF, value, 1)


def _wait_simulated():
    threading.current_thread().syncthreads()


def _anywhere_simulated(flag):
    return threading.current_thread().syncthreads_or(flag) != 0


def _count_simulated(array, index):
    with _counting:
        array[index] += 1


def _mark_simulated(array, index, bit):
    with _counting:
        array[index] |= bit


def _lowest_simulated(word):
    return (int(word) & -int(word)).bit_length() - 1


def _sum_of_warp_simulated(value):
    return value


_counting = threading.Lock()
_ON_DEVICE = {
    "barrier": _wait,
    "anywhere": _anywhere,
    "count": _count,
    "mark": _mark,
    "lowest": _lowest,
    "sum_of_warp": _sum_of_warp,
}
_SIMULATED = {
    "barrier": _wait_simulated,
    "anywhere": _anywhere_simulated,
    "count": _count_simulated,
    "mark": _mark_simulated,
    "lowest": _lowest_simulated,
    "sum_of_warp": _sum_of_warp_simulated,
}


@contextmanager
def compiling() -> Iterator[None]:
    """How what is first called inside is compiled, for which numba-cuda has no options.

    A product and a sum stay two operations, as they are in torch: NVVM can do it. And no index is counted from an end,
    which would have to be asked of every one.
    """
    if SIMULATED:
        yield
        return
    from numba.cuda.cudadrv import nvvm
    from numba.cuda.np import arrayobj

    compile_ir, fix_integer_index = nvvm.compile_ir, arrayobj.fix_integer_index
    nvvm.compile_ir, arrayobj.fix_integer_index = partial(compile_ir, fma=False), _from_the_start
    try:
        yield
    finally:
        nvvm.compile_ir, arrayobj.fix_integer_index = compile_ir, fix_integer_index


def _from_the_start(context: Any, builder: Any, kind: Any, index: Any, size: Any) -> Any:
    """An index as numba-cuda works with it."""
    return context.cast(builder, index, kind, types.intp if kind.signed else types.uintp)


class Program:
    """Functions compiled together.

    Args:
        real: type of the real numbers, np.float32 or np.float64.
        names: what names stand for that kernels use and that no module says: mechanisms, compiled as well, and
            numbers.
    """

    def __init__(self, real: Any, names: Mapping[str, Any]) -> None:
        self.real = real
        self.names = {**names, "real": real, **(_SIMULATED if SIMULATED else _ON_DEVICE)}
        self._known: dict[tuple[Callable[..., Any], Any], Any] = {}
        self._kernels: dict[Callable[..., Any], Any] = {}

    def kernel(self, function: Callable[..., Any], threads: int) -> Any:
        """A kernel, to be launched with blocks of so many threads at most."""
        if function not in self._kernels:
            self._kernels[function] = self._kernel(function, threads)
        return self._kernels[function]

    def _kernel(self, function: Callable[..., Any], threads: int) -> Any:
        if SIMULATED:
            return jit(self.seen(function, self.real))
        # linking optimises again, and would fuse (see `compiling`); as a decorator with arguments `jit` forgets `lto`
        return jit(self.seen(function, self.real), lto=False, launch_bounds=(threads, BLOCKS))

    def seen(self, function: Any, real: Any) -> FunctionType:
        """A function whose names and constants mean what they do in compiled code.

        Raises:
            ConfigError: it uses a function of torch that has no meaning there.
        """
        assert isinstance(function, FunctionType), function
        code = function.__code__
        constants = code.co_consts
        if not SIMULATED:  # where a Python number takes the precision of NumPy's beside it by itself
            constants = tuple(real(value) if isinstance(value, NUMBERS) else value for value in constants)
        found = {name: self._as_seen(name, function, real) for name in _globals(code)}
        scope = {name: value for name, value in found.items() if value is not _UNKNOWN}
        scope["__name__"] = __name__
        return FunctionType(code.replace(co_consts=constants), scope, function.__name__, None, function.__closure__)

    def _compile(self, function: FunctionType, real: Any) -> Any:
        real = np.float64 if function.__globals__.get("PRECISION") == torch.float64 else real
        if (function, real) not in self._known:
            found = self.seen(function, real)
            self._known[function, real] = found if SIMULATED else jit(device=True, forceinline=True)(found)
        return self._known[function, real]

    def _as_seen(self, name: str, function: FunctionType, real: Any) -> Any:
        """What a name outside of a compiled function stands for inside of it."""
        value = self.names.get(name, function.__globals__.get(name, _UNKNOWN))
        assert not hasattr(value, "placeholder"), f"{function.__name__}: {name} stands for nothing"
        if value is torch:
            return self._torch(function, real)
        if value is math and SIMULATED:
            return np  # whose numbers keep their precision, and do not raise
        if isinstance(value, NUMBERS) and not SIMULATED:
            return real(value)
        if isinstance(value, FunctionType):
            return self._compile(value, real)
        return value

    def _torch(self, function: FunctionType, real: Any) -> ModuleType:
        """The functions of torch that a function uses."""
        found = ModuleType("torch")
        for name in _attributes(function.__code__, "torch"):
            if name in KNOWN:
                setattr(found, name, self._compile(KNOWN[name], real))
            else:
                message = f"cannot run {function.__name__}, which uses torch.{name}; use engine=reference"
                raise ConfigError("engine", "cuda", message)
        return found


def _instructions(code: CodeType) -> list[dis.Instruction]:
    """Of a function and of functions within it."""
    inner = [found for value in code.co_consts if isinstance(value, CodeType) for found in _instructions(value)]
    return [*dis.get_instructions(code), *inner]


def _globals(code: CodeType) -> list[str]:
    """What a function looks up outside."""
    return list(dict.fromkeys(found.argval for found in _instructions(code) if found.opname == "LOAD_GLOBAL"))


def _attributes(code: CodeType, name: str) -> list[str]:
    """What a function takes from a global of that name."""
    pairs = pairwise(_instructions(code))
    return list(dict.fromkeys(b.argval for a, b in pairs if (a.opname, a.argval) == ("LOAD_GLOBAL", name)))

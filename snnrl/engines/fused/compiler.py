"""How what is written for tensors, and kernels in plain Python, are compiled.

A mechanism is a pure elementwise function: `torch.where(fired, c, v)` and arithmetic on what it is given. On tensors
it is what it says. Here the same function is compiled by numba, for numbers or for vectors of them, in the network's
precision: the functions of torch that it may use are given a meaning, and its constants are those of torch's
arithmetic, which takes a Python number in the precision of the tensor beside it.

A kernel is a plain function. Where a network says which mechanism is meant, it calls one by the name of a
`placeholder`; `Program` says what the names stand for, and compiles the kernel for just these.

A module with a PRECISION (torch.float64) of its own is compiled in that one.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import operator
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
import torch
from llvmlite.binding import Linkage
from numba import njit, types
from numba._dynfunc import make_function
from numba.core import config as numba_config
from numba.core.caching import FunctionCache
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering
from numba.extending import overload

from snnrl.engines.fused import references, vectors
from snnrl.engines.fused.references import refer
from snnrl.engines.fused.vectors import VectorType, lanewise, select

NUMBERS = (float, np.floating)
settings: Any = numba_config


class _Sparing:
    """numba's code generator, with which what is a part of a kernel is only tidied: the kernel is optimised as a whole.

    Loops unrolled in each part, as numba has it, make a third more code to compile, and nothing faster.
    """

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def _function_pass_manager(self, *module: Any) -> Any:
        return self._codegen._function_pass_manager(*module, opt=2)


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Leaves it to the kernel that a function becomes a part of to optimise it and to make machine code of it."""

    _name = "snnrl_part_lowering"

    def run_pass(self, state: Any) -> bool:
        library = state.library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
        library.enable_object_caching()
        library._codegen = _Sparing(library._codegen)
        library._optimize_final_module = lambda: None
        library._finalize_final_module = lambda: setattr(library, "_finalized", True)
        state.flags.no_compile = True
        super().run_pass(state)
        if not state.flags.forceinline:
            library._final_module.get_function(state.cr.fndesc.mangled_name).add_function_attribute("noinline")
        lowered = state.cr  # its function cannot be called from Python: there is no code behind it
        nothing = make_function(lowered.fndesc.lookup_module(), "part", "", 0, lowered.env, (library,))
        state.targetctx.insert_user_function(nothing, lowered.fndesc, [library])
        state.cr = lowered._replace(cfunc=nothing)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):
    """Keeps a kernel's parts to itself.

    A part's symbol says what it is called and how many functions its process had compiled before. Of two kernels from
    two processes, read from the disk into a third, parts that are not the same may have one symbol, and where it can be
    seen outside of a kernel the linker takes one of them for both.
    """

    _name = "snnrl_kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        library = state.library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
        library.enable_object_caching()
        optimise = library._optimize_final_module

        def hide_and_optimise() -> None:
            for function in library._final_module.functions:
                if not function.is_declaration and function.linkage == Linkage.linkonce_odr:
                    function.linkage = Linkage.internal
            optimise()

        library._optimize_final_module = hide_and_optimise
        return super().run_pass(state)


def _lowered_by(lowering: type[NativeLowering]) -> type[CompilerBase]:
    """numba's compiler with a lowering of our own."""

    class Compiler(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [(lowering if kind is NativeLowering else kind, name) for kind, name in passes.passes]
            passes.finalize()
            return [passes]

    return Compiler


OPTIONS: Any = {"error_model": "numpy", "_nrt": False}
PART = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _lowered_by(_PartLowering)}
KERNEL: Any = {"nogil": True, "no_cfunc_wrapper": True, "pipeline_class": _lowered_by(_KernelLowering)}


def placeholder(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function that a `Program` puts another in the place of."""
    function.placeholder = True  # type: ignore[attr-defined]
    return function


def rare(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a kernel that is seldom called: it is not copied into its callers."""
    function.rare = True  # type: ignore[attr-defined]
    return function


@overload(torch.where)
def _where(condition, one, other):
    if isinstance(condition, VectorType):
        return lambda condition, one, other: select(condition, one, other)
    return lambda condition, one, other: one if condition else other


@overload(torch.minimum)
def _minimum(one, other):
    return lambda one, other: torch.where(one < other, one, other)


@overload(torch.maximum)
def _maximum(one, other):
    return lambda one, other: torch.where(one > other, one, other)


@overload(torch.clamp)
def _clamp(value, min, max):
    return lambda value, min, max: torch.where(value > max, max, torch.where(value < min, min, value))


@overload(torch.sign)
def _sign(value):
    return lambda value: torch.where(value > 0.0, 1.0, torch.where(value < 0.0, -1.0, 0.0))


@overload(torch.remainder)
def _remainder(value, divisor):
    return lambda value, divisor: value % divisor


@overload(torch.logical_not)
def _logical_not(value):
    if isinstance(value, VectorType):
        return lambda value: select(value, False, True)
    return lambda value: not value


@overload(operator.invert)
def _invert(value):
    if isinstance(value, VectorType) and value.element == types.boolean:
        return lambda value: select(value, False, True)
    return None


def _give_meaning(function: Any, number: Any, name: str) -> None:
    """A function of torch of one argument: what it is for a number, and what LLVM calls it."""

    def meaning(value):
        if isinstance(value, VectorType):
            return lambda value: lanewise(name, value)
        return lambda value: number(value)

    overload(function)(meaning)


for _name in ("exp", "log", "sqrt", "sin", "cos", "tanh", "floor"):
    _give_meaning(getattr(torch, _name), getattr(math, _name), _name)
_give_meaning(torch.abs, abs, "fabs")


class Program:
    """Functions compiled together.

    Args:
        real: type of the real numbers, np.float32 or np.float64.
        names: what names stand for that kernels use and that no module says: mechanisms, compiled as well.

    The same function gives the same object.
    """

    def __init__(self, real: Any, names: Mapping[str, Callable[..., Any]]) -> None:
        self.real, self.names = real, dict(names)
        self._known: dict[tuple[Callable[..., Any], Any], Any] = {}

    def kernel(self, function: Callable[..., Any]) -> Any:
        """A function to be called from Python, compiled when it is first called and kept on the disk.

        What it is given as a named tuple, it and all that it calls see by reference.
        """
        names, key = inspect.signature(function).parameters, f"{self._digest(function, set())}_{self.real.__name__}"
        body = f"    return kernel({', '.join(f'refer({name})' for name in names)})"
        scope = {"kernel": self._compile(function, self.real, PART), "refer": refer}
        # what is seen of a kernel outside of it has a name that no other kernel has
        compiled = njit(**OPTIONS, **KERNEL)(spelled(f"{function.__name__}_{key}", ", ".join(names), body, scope))
        compiled._cache = _Kept(function, key)
        return compiled

    def _compile(self, function: Callable[..., Any], real: Any, options: Mapping[str, Any]) -> Any:
        real = np.float64 if function.__globals__.get("PRECISION") == torch.float64 else real
        if (function, real) not in self._known:
            assert isinstance(function, FunctionType), function
            code = function.__code__
            found = {name: self._as_seen(name, function, real) for name in _names(code)}
            scope = {name: value for name, value in found.items() if value is not _UNKNOWN}
            outside = [*scope.items(), *(("", cell.cell_contents) for cell in function.__closure__ or ())]
            key = code, real, *options.items(), *((name, _identity(value)) for name, value in outside)
            if key not in _PARTS:
                constants = tuple(real(value) if isinstance(value, NUMBERS) else value for value in code.co_consts)
                scope["__name__"] = __name__  # a module that is there when the compiled code is read from the disk
                code = code.replace(co_consts=constants)
                same = FunctionType(code, scope, function.__name__, None, function.__closure__)
                _PARTS[key] = njit(**{**OPTIONS, **options})(same)
            self._known[function, real] = _PARTS[key]
        return self._known[function, real]

    def _as_seen(self, name: str, function: FunctionType, real: Any) -> Any:
        """What a name outside of a compiled function stands for inside of it."""
        value = self.names.get(name, function.__globals__.get(name, _UNKNOWN))
        assert not hasattr(value, "placeholder"), f"{function.__name__}: {name} stands for nothing"
        if isinstance(value, NUMBERS):
            return real(value)
        if isinstance(value, FunctionType):
            return self._compile(value, real, {**PART, "forceinline": not hasattr(value, "rare")})
        return value

    def _digest(self, function: Any, seen: set[Any]) -> str:
        """Of everything that a compiled function depends on."""
        if function in seen:
            return function.__name__
        seen.add(function)
        code = function.__code__
        parts = [code.co_code.hex(), *(repr(value) for value in code.co_consts if not isinstance(value, CodeType))]
        for name in _names(code):
            value = self.names.get(name, function.__globals__.get(name))
            if isinstance(value, FunctionType):
                parts.append(f"{name}: {self._digest(value, seen)}")
            elif not isinstance(value, ModuleType):
                parts.append(f"{name}: {value!r}" if isinstance(value, (int, float, tuple)) else name)
        parts.append(_TOOLS)
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()


_UNKNOWN = object()
_PARTS: dict[tuple[Any, ...], Any] = {}  # of all programs, which have most in common: by code and what it sees outside
_TOOLS = hashlib.sha256(
    b"".join([numba.__version__.encode(), llvmlite.__version__.encode()])
    + b"".join(Path(str(path)).read_bytes() for path in (__file__, references.__file__, vectors.__file__))
).hexdigest()


def _identity(value: Any) -> Any:
    """What tells apart two values that compiled functions see; those in `_PARTS` live as long as these do."""
    return repr(value) if isinstance(value, NUMBERS) else id(value)


def _names(code: CodeType) -> list[str]:
    """What a function's code, and that of functions within it, may look up outside."""
    inner = [name for value in code.co_consts if isinstance(value, CodeType) for name in _names(value)]
    return list(dict.fromkeys([*code.co_names, *inner]))


class _Kept(FunctionCache):
    """Compiled code on the disk, in ~/.cache/snnrl or numba's own folder, under a key that says what was compiled.

    `missing` is called when the disk has none.
    """

    missing: Callable[[], None] | None = None

    def __init__(self, function: Any, key: str) -> None:
        self._key = key
        chosen = settings.CACHE_DIR
        settings.CACHE_DIR = chosen or str(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "snnrl")
        try:
            super().__init__(function)
        finally:
            settings.CACHE_DIR = chosen

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        if found is None and self.missing is not None:
            self.missing()
        return found

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self._key


@contextmanager
def announced(kernel: Any, compiling: Callable[[], None]) -> Iterator[None]:
    """Have `compiling` called before a kernel of a `Program` is compiled in the context; not if it has been earlier."""
    kernel._cache.missing = compiling
    try:
        yield
    finally:
        kernel._cache.missing = None


def spelled(name: str, arguments: str, body: str, scope: Mapping[str, Any]) -> Callable[..., Any]:
    """A function from its source, for where the number of a call's arguments is known only now."""
    found: dict[str, Any] = {}
    exec(f"def {name}({arguments}):\n{body}", {**scope, "__name__": __name__}, found)
    return found[name]

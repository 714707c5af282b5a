"""Vectors of numbers for numba: a mechanism compiled for them works on LANES neurons or synapses at once.

LLVM is given the vectors as such, so that how wide they are does not depend on what its optimiser makes of a loop,
and no result on how wide the processor's registers are. `x + y`, `x < y`, `torch.where(x < y, x, y)` and what else
mechanisms are written in work lane by lane; a number beside a vector stands for LANES of it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, register_model

LANE_BITS = 4
LANES = 1 << LANE_BITS
DRAWN = 8  # lanes of the 64-bit numbers that random numbers are made of

INDEX = ir.IntType(32)


class VectorType(types.Type):
    """So many numbers of one type."""

    def __init__(self, element: types.Type, lanes: int) -> None:
        self.element, self.lanes = element, lanes
        super().__init__(name=f"Vector({element}, {lanes})")


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: VectorType) -> None:
        one = ir.IntType(1) if fe_type.element == types.boolean else dmm.lookup(fe_type.element).get_value_type()
        super().__init__(dmm, fe_type, ir.VectorType(one, fe_type.lanes))


def vector_among(kinds: Any) -> VectorType | None:
    """The type of the vectors among some arguments; None if there are none."""
    return next((kind for kind in kinds if isinstance(kind, VectorType)), None)


def spread(context: Any, builder: Any, value: Any, kind: types.Type, like: VectorType) -> Any:
    """A value as a vector: itself, or a number in every lane."""
    if isinstance(kind, VectorType):
        return value
    number = context.cast(builder, value, kind, like.element)
    if like.element == types.boolean:
        number = builder.trunc(number, ir.IntType(1))
    whole = ir.VectorType(number.type, like.lanes)
    first = builder.insert_element(ir.Constant(whole, ir.Undefined), number, ir.Constant(INDEX, 0))
    order = ir.Constant(ir.VectorType(INDEX, like.lanes), [0] * like.lanes)
    return builder.shuffle_vector(first, ir.Constant(whole, ir.Undefined), order)


def _operator(function: Any, result: Callable[[VectorType], VectorType], emit: Callable[..., Any]) -> None:
    """Give an operator of two arguments a meaning for vectors."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args, kws):
            like = vector_among(args)
            if like is None or len(args) != 2:
                return None
            if all(arg == like or isinstance(arg, (types.Number, types.Boolean)) for arg in args):
                return signature(result(like), *args)
            return None

    def lower(context, builder, sig, args):
        like = vector_among(sig.args)
        left, right = (spread(context, builder, arg, kind, like) for arg, kind in zip(args, sig.args, strict=True))
        return emit(builder, left, right, isinstance(like.element, types.Float))

    for pair in ((VectorType, VectorType), (VectorType, types.Any), (types.Any, VectorType)):
        lower_builtin(function, *pair)(lower)


def _same(like: VectorType) -> VectorType:
    return like


def _truth(like: VectorType) -> VectorType:
    return VectorType(types.boolean, like.lanes)


def _arithmetic(real: str, whole: str) -> Callable[..., Any]:
    return lambda builder, left, right, is_real: getattr(builder, real if is_real else whole)(left, right)


def _comparison(sign: str) -> Callable[..., Any]:
    def emit(builder, left, right, is_real):
        if is_real:
            return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, left, right)
        return builder.icmp_signed(sign, left, right)

    return emit


def _whole(name: str) -> Callable[..., Any]:
    return lambda builder, left, right, is_real: getattr(builder, name)(left, right)


for _function, _names in {
    operator.add: ("fadd", "add"),
    operator.sub: ("fsub", "sub"),
    operator.mul: ("fmul", "mul"),
    operator.truediv: ("fdiv", "sdiv"),
}.items():
    _operator(_function, _same, _arithmetic(*_names))
for _function, _sign in {
    operator.lt: "<",
    operator.le: "<=",
    operator.gt: ">",
    operator.ge: ">=",
    operator.eq: "==",
    operator.ne: "!=",
}.items():
    _operator(_function, _truth, _comparison(_sign))
for _function, _name in {
    operator.and_: "and_",
    operator.or_: "or_",
    operator.xor: "xor",
    operator.lshift: "shl",
    operator.rshift: "ashr",
}.items():
    _operator(_function, _same, _whole(_name))


@infer_global(operator.neg)
class _NegativeTyping(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], args[0]) if isinstance(args[0], VectorType) else None


@lower_builtin(operator.neg, VectorType)
def _negative(context, builder, sig, args):
    is_real = isinstance(sig.args[0].element, types.Float)
    return builder.fneg(args[0]) if is_real else builder.neg(args[0])


@intrinsic
def select(typingctx, condition, one, other):
    """One or the other, lane by lane; each a vector or a number."""
    like = vector_among((one, other)) or VectorType(one, condition.lanes)

    def codegen(context, builder, sig, args):
        first, second = (spread(context, builder, args[k], sig.args[k], like) for k in (1, 2))
        return builder.select(args[0], first, second)

    return like(condition, one, other), codegen


@intrinsic(prefer_literal=True)
def lanewise(typingctx, name, value):
    """LLVM's function of that name (llvm.NAME) of a vector."""

    def codegen(context, builder, sig, args):
        kind = context.get_value_type(value)
        called = f"llvm.{name.literal_value}.v{value.lanes}f{value.element.bitwidth}"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), called)
        return builder.call(function, [args[1]])

    return value(name, value), codegen


def _place(context: Any, builder: Any, sig: Any, args: Any, lanes: int) -> Any:
    """Where in its first argument, an array, a vector begins, at the second argument."""
    array = context.make_array(sig.args[0])(context, builder, args[0])
    kind = ir.VectorType(context.get_data_type(sig.args[0].dtype), lanes)
    return builder.bitcast(builder.gep(array.data, [args[1]]), kind.as_pointer())


def _loading(typingctx, array, at, lanes):
    kind = VectorType(array.dtype, lanes)

    def codegen(context, builder, sig, args):
        value = builder.load(_place(context, builder, sig, args, lanes))
        value.align = array.dtype.bitwidth // 8
        return value

    return kind(array, types.int64), codegen


@intrinsic
def load(typingctx, array, at):
    """LANES numbers of a flat array from `at` on."""
    return _loading(typingctx, array, at, LANES)


@intrinsic
def load_drawn(typingctx, array, at):
    """DRAWN numbers of a flat array from `at` on."""
    return _loading(typingctx, array, at, DRAWN)


@intrinsic
def store(typingctx, array, at, value):
    """Put a vector into a flat array from `at` on."""

    def codegen(context, builder, sig, args):
        written = builder.store(args[2], _place(context, builder, sig, args, value.lanes))
        written.align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.int64, value), codegen


@intrinsic
def take(typingctx, array, at):
    """The number of a flat array at a place that is not counted from the end."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.load(builder.gep(data, [args[1]]))

    return array.dtype(array, types.int64), codegen


@intrinsic
def put(typingctx, array, at, value):
    """Let a flat array have a number at a place that is not counted from the end."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        builder.store(args[2], builder.gep(data, [args[1]]))
        return context.get_dummy_value()

    return types.void(array, types.int64, array.dtype), codegen


@intrinsic
def gather(typingctx, array, at):
    """The numbers of a flat array at the places in a vector, none of them counted from the end."""
    kind = VectorType(array.dtype, at.lanes)

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        number = context.get_value_type(array.dtype)
        pointers = ir.VectorType(data.type, at.lanes)
        first = spread(context, builder, builder.ptrtoint(data, ir.IntType(64)), types.int64, at)
        size = spread(context, builder, ir.Constant(ir.IntType(64), array.dtype.bitwidth // 8), types.int64, at)
        places = builder.inttoptr(builder.add(first, builder.mul(args[1], size)), pointers)
        whole, truth = ir.VectorType(number, at.lanes), ir.VectorType(ir.IntType(1), at.lanes)
        called = f"llvm.masked.gather.v{at.lanes}f{array.dtype.bitwidth}.v{at.lanes}p0"
        types_ = ir.FunctionType(whole, [pointers, INDEX, truth, whole])
        function = cgutils.get_or_insert_function(builder.module, types_, called)
        every = ir.Constant(truth, [1] * at.lanes)
        given = [places, ir.Constant(INDEX, array.dtype.bitwidth // 8), every, ir.Constant(whole, ir.Undefined)]
        return builder.call(function, given)

    return kind(array, at), codegen


@intrinsic(prefer_literal=True)
def counting(typingctx, start, lanes):
    """start, start + 1, ... as so many 64-bit whole numbers."""
    kind = VectorType(types.int64, lanes.literal_value)

    def codegen(context, builder, sig, args):
        first = spread(context, builder, args[0], sig.args[0], kind)
        return builder.add(first, ir.Constant(ir.VectorType(ir.IntType(64), kind.lanes), list(range(kind.lanes))))

    return kind(start, lanes), codegen


@intrinsic
def as_real(typingctx, value, like):
    """A vector of whole numbers below 2^31 as reals of the type of `like`, a number or an array."""
    kind = VectorType(like.dtype if isinstance(like, types.Array) else like, value.lanes)

    def codegen(context, builder, sig, args):
        return builder.sitofp(_narrow(builder, args[0], value), context.get_value_type(kind))

    return kind(value, like), codegen


def _narrow(builder: Any, value: Any, kind: Any) -> Any:
    """Whole numbers in 32 bits each."""
    if kind.element.bitwidth == 32:
        return value
    return builder.trunc(value, ir.VectorType(ir.IntType(32), kind.lanes))


@intrinsic
def joined(typingctx, first, second):
    """Two vectors of whole numbers below 2^31 as one of int32."""
    kind = VectorType(types.int32, 2 * first.lanes)

    def codegen(context, builder, sig, args):
        parts = [_narrow(builder, value, first) for value in args]
        order = ir.Constant(ir.VectorType(INDEX, kind.lanes), list(range(kind.lanes)))
        return builder.shuffle_vector(*parts, order)

    return kind(first, second), codegen


@intrinsic(prefer_literal=True)
def half(typingctx, value, which):
    """The first (0) or the second (1) half of a vector."""
    kind = VectorType(value.element, value.lanes // 2)

    def codegen(context, builder, sig, args):
        first = which.literal_value * kind.lanes
        return _lanes(builder, args[0], first, kind.lanes)

    return kind(value, which), codegen


def _lanes(builder: Any, value: Any, first: int, lanes: int) -> Any:
    """So many lanes from the first on."""
    order = ir.Constant(ir.VectorType(INDEX, lanes), list(range(first, first + lanes)))
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), order)


@intrinsic
def as_double(typingctx, value):
    """A vector of reals as float64."""
    kind = VectorType(types.float64, value.lanes)

    def codegen(context, builder, sig, args):
        return args[0] if value == kind else builder.fpext(args[0], context.get_value_type(kind))

    return kind(value), codegen


@intrinsic
def mask_bits(typingctx, mask):
    """A vector of truth values as the bits of a number, the first lane the lowest."""

    def codegen(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.lanes)), ir.IntType(64))

    return types.int64(mask), codegen


@intrinsic
def bits_mask(typingctx, bits):
    """LANES truth values from the lowest bits of a number."""
    kind = VectorType(types.boolean, LANES)

    def codegen(context, builder, sig, args):
        return builder.bitcast(builder.trunc(args[0], ir.IntType(LANES)), context.get_value_type(kind))

    return kind(types.int64), codegen


@intrinsic
def lowest_bit(typingctx, bits):
    """Place of the lowest bit of a number that is not 0."""

    def codegen(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


@intrinsic
def across(typingctx, value):
    """Sum of a vector's lanes, by halves: always in the same order."""

    def codegen(context, builder, sig, args):
        total, lanes = args[0], value.lanes
        while lanes > 1:
            lanes //= 2
            low, high = (_lanes(builder, total, first, lanes) for first in (0, lanes))
            total = builder.fadd(low, high)
        return builder.extract_element(total, ir.Constant(INDEX, 0))

    return value.element(value), codegen

"""Named tuples by reference, for numba: a pointer, where as a value each array is seven arguments of every call.

A kernel has some hundred arrays, and its functions hand all of them on: by value, that took much of the time in which
it was compiled.
"""

from __future__ import annotations

import hashlib
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, register_model


class Reference(types.Type):
    """Where a named tuple is. It has the same fields."""

    def __init__(self, of: Any) -> None:
        self.of = of
        super().__init__(name=f"Reference({hashlib.sha256(str(of).encode()).hexdigest()[:16]})")


@register_model(Reference)
class ReferenceModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Reference) -> None:
        super().__init__(dmm, fe_type, dmm.lookup(fe_type.of).get_value_type().as_pointer())


@intrinsic
def refer(typingctx, value):
    """A reference to a named tuple, to be handed to a function that is not inlined; any other value as it is."""
    if not isinstance(value, types.BaseNamedTuple):
        return value(value), lambda context, builder, sig, args: args[0]
    return Reference(value)(value), lambda context, builder, sig, args: cgutils.alloca_once_value(builder, args[0])


@infer_getattr
class ReferenceFields(AttributeTemplate):
    key = Reference

    def generic_resolve(self, value, attr):
        return value.of.types[value.of.fields.index(attr)] if attr in value.of.fields else None


@lower_getattr_generic(Reference)
def field_of(context, builder, kind, value, attr):
    found = builder.load(cgutils.gep_inbounds(builder, value, 0, kind.of.fields.index(attr)))
    # it does not change; who wrote it is outside of the function, so that it need not be read again after each store
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found

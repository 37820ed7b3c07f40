"""Arrays inside another array, without counting references: a few instructions each.

A slice that is reshaped costs 50 ns and NumPy's bookkeeping at every step, and a kernel with twenty
arrays for arguments costs its caller 2 µs; so a step's arrays lie in one of floats and one of
integers, which the caller keeps.
"""

from __future__ import annotations

from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

_intrinsic: Any = intrinsic  # what it makes is called without the first argument


def _view(base: Any, first: Any, *shape: Any) -> tuple[Any, Any]:
    """Signature and code of a view of ``shape`` into ``base`` (N,), from ``first`` on."""
    result = types.Array(base.dtype, len(shape), "C")

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = context.get_value_type(types.intp)
        size = context.get_abi_sizeof(context.get_data_type(base.dtype))
        whole = make_array(base)(context, builder, given[0])
        place = context.cast(builder, given[1], signature.args[1], types.intp)
        lengths = [
            context.cast(builder, length, kind, types.intp)
            for length, kind in zip(given[2:], signature.args[2:], strict=True)
        ]
        strides = [word(size)]
        for length in reversed(lengths[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        view = make_array(result)(context, builder)
        populate_array(
            view,
            data=cgutils.gep(builder, whole.data, place),
            shape=cgutils.pack_array(builder, lengths),
            strides=cgutils.pack_array(builder, strides),
            itemsize=word(size),
            meminfo=None,
        )
        return view._getvalue()

    return result(base, first, *shape), code


@_intrinsic
def vector(typing: Any, base: Any, first: Any, n: Any) -> tuple[Any, Any]:
    """``base[first : first + n]``."""
    return _view(base, first, n)


@_intrinsic
def matrix(typing: Any, base: Any, first: Any, rows: Any, columns: Any) -> tuple[Any, Any]:
    """The same of ``rows · columns`` entries, row by row."""
    return _view(base, first, rows, columns)


@_intrinsic
def stack(
    typing: Any, base: Any, first: Any, count: Any, rows: Any, columns: Any
) -> tuple[Any, Any]:
    """The same of ``count`` matrices."""
    return _view(base, first, count, rows, columns)


@_intrinsic
def at_address(typing: Any, address: Any, n: Any) -> tuple[Any, Any]:
    """The ``n`` floats at an address, which their owner has to keep there."""
    result = types.Array(types.float64, 1, "C")

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = context.get_value_type(types.intp)
        size = word(context.get_abi_sizeof(context.get_data_type(types.float64)))
        count = context.cast(builder, given[1], signature.args[1], types.intp)
        view = make_array(result)(context, builder)
        populate_array(
            view,
            data=builder.inttoptr(given[0], context.get_data_type(types.float64).as_pointer()),
            shape=cgutils.pack_array(builder, [count]),
            strides=cgutils.pack_array(builder, [size]),
            itemsize=size,
            meminfo=None,
        )
        return view._getvalue()

    return result(address, n), code

"""Named arrays inside one array of floats and one of integers, each declared in one line.

Calling a kernel with twenty array arguments costs 2 µs, and a ``NamedTuple`` of fifty arrays would
be four hundred arguments and dominate the compilation time of a step. So everything that a step
reads and writes lies in two arrays that the caller keeps. The integers begin with a table: offset
and shape of each field. In Python a record is the ``NamedTuple`` of views, in a kernel two
addresses; ``s.A`` reads the table.
"""

from __future__ import annotations

import math
import typing
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.core import cgutils, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model
from numba.np.arrayobj import make_array, populate_array

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
_ENTRY = 4
"""Entries of the table for a field: its offset, and up to three lengths."""
_extend: Any = register_model  # numba's decorators and their results are untyped
_attributes: Any = infer_getattr
_code_of_attributes: Any = lower_getattr_generic
_intrinsic: Any = intrinsic


class Layout(NamedTuple):
    """Offsets of a record's fields for given sizes."""

    table: Integers
    floats: int
    """Number of its floats."""
    integers: int
    """Number of its integers, the table among them."""


class RecordType:
    """The declaration of a record, a ``NamedTuple`` whose annotations are its fields.

    For example::

        class Pair(NamedTuple):
            x: Annotated[Floats, "n"]
            A: Annotated[Floats, "m", "n"]
            active: Annotated[Integers, "2 * n"]

    Shapes are expressions in the fields of another ``NamedTuple`` of integers, the sizes. A field
    may also be a ``NamedTuple`` of floats.

    Attributes:
        kind: The ``NamedTuple``.
        head: Number of entries of its table.
        type: Its numba type.
    """

    def __init__(self, kind: Any) -> None:
        """Read the declaration."""
        self.kind = kind
        self._shapes: dict[str, Any] = {}
        fields: dict[str, Any] = {}
        for name, hint in typing.get_type_hints(kind, include_extras=True).items():
            shape: list[Any]
            if hasattr(hint, "_fields"):  # a NamedTuple of floats
                shape = [len(hint._fields)]
                fields[name] = types.NamedUniTuple(types.float64, shape[0], hint)
            else:
                array, *shape = typing.get_args(hint)
                dtype = types.float64 if array == Floats else types.int64
                fields[name] = types.Array(dtype, len(shape), "C")
            self._shapes[name] = compile(f"({', '.join(map(str, shape))},)", name, "eval")
        self.type: _NumbaRecord = _NumbaRecord(f"{kind.__module__}.{kind.__qualname__}", fields)
        self.head: int = _ENTRY * len(fields)
        self.layout = lru_cache(maxsize=256)(self._layout)

    def _layout(self, size: Any) -> Layout:
        table, ends = np.zeros((len(self._shapes), _ENTRY), dtype=np.int64), [0, self.head]
        for entry, (name, kind) in zip(table, self.type.fields.items(), strict=True):
            shape, which = eval(self._shapes[name], size._asdict()), kind.dtype != types.float64
            entry[0], entry[1 : 1 + len(shape)] = ends[which], shape
            ends[which] += math.prod(shape)
        return Layout(table.ravel(), *ends)

    def allocate(self, size: Any) -> tuple[Floats, Integers]:
        """Allocate the two arrays, zeros, with the table."""
        layout = self.layout(size)
        floats, integers = np.zeros(layout.floats), np.zeros(layout.integers, dtype=np.int64)
        integers[: self.head] = layout.table
        return floats, integers

    def arrays(
        self, floats: Floats, integers: Integers, span: tuple[str, str] | None = None
    ) -> Any:
        """The ``NamedTuple`` of views; of a ``span`` of floats, from a field to another, if given.

        Then ``floats`` are those of the span alone, and the other fields are ``None``.
        """
        names = list(self.type.fields)
        views = dict[str, Any].fromkeys(names)
        table = integers[: self.head].reshape(-1, _ENTRY)
        first, last = (names.index(name) for name in span or (names[0], names[-1]))
        for name, entry in zip(names[first : last + 1], table[first : last + 1], strict=True):
            kind = self.type.fields[name]
            base: Any = floats if kind.dtype == types.float64 else integers
            at, *shape = entry[: 1 + getattr(kind, "ndim", 1)].tolist()
            at -= 0 if span is None else int(table[first, 0])
            views[name] = base[at : at + math.prod(shape)].reshape(shape)
        return self.kind(**views)

    def span(self, size: Any, first: str, last: str) -> slice:
        """Where a span is among the floats."""
        table, names = self.layout(size).table.reshape(-1, _ENTRY), list(self.type.fields)
        start, end = table[names.index(first)], table[names.index(last)]
        ndim = getattr(self.type.fields[last], "ndim", 1)
        return slice(int(start[0]), int(end[0]) + math.prod(end[1 : 1 + ndim].tolist()))


class _NumbaRecord(types.Type):
    """numba type of a record.

    Attributes:
        fields: Their types.
    """

    def __init__(self, name: str, fields: dict[str, Any]) -> None:
        super().__init__(name)
        self.fields = fields


@_extend(_NumbaRecord)
class _RecordModel(models.StructModel):
    """The two addresses."""

    def __init__(self, manager: Any, kind: Any) -> None:
        members = [
            ("floats", types.CPointer(types.float64)),
            ("integers", types.CPointer(types.int64)),
        ]
        super().__init__(manager, kind, members)


@_attributes
class _Fields(AttributeTemplate):
    """The type of ``record.field``."""

    key = _NumbaRecord

    def generic_resolve(self, record: Any, name: str) -> Any:  # type: ignore[override]
        return record.fields.get(name)


@_code_of_attributes(_NumbaRecord)
def _field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    """The code of ``record.field``."""
    record = cgutils.create_struct_proxy(kind)(context, builder, value)
    entry, result = _ENTRY * list(kind.fields).index(name), kind.fields[name]

    def number(place: int) -> Any:
        found = builder.load(cgutils.gep(builder, record.integers, entry + place))
        # The table does not change while a kernel runs: let loops load its entries once.
        found.set_metadata("invariant.load", builder.module.add_metadata([]))
        return found

    is_float = result.dtype == types.float64
    data = cgutils.gep(builder, record.floats if is_float else record.integers, number(0))
    if isinstance(result, types.NamedUniTuple):
        numbers = [builder.load(cgutils.gep(builder, data, i)) for i in range(result.count)]
        return context.make_tuple(builder, result, numbers)
    return view_at(context, builder, result, data, [number(1 + i) for i in range(result.ndim)])


def view_at(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """An array of type ``kind`` at an address; it does not own the memory."""
    word = context.get_value_type(types.intp)
    size = word(kind.dtype.bitwidth // 8)
    strides = [size]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    found = make_array(kind)(context, builder)
    populate_array(
        found, data=data, shape=cgutils.pack_array(builder, lengths),
        strides=cgutils.pack_array(builder, strides), itemsize=size, meminfo=None,
    )  # fmt: skip
    return found._getvalue()


def reader(record: RecordType) -> Any:
    """Make ``read(floats, integers)``, which returns the record in two arrays, or addresses."""

    def read(typing: Any, floats: Any, integers: Any) -> tuple[Any, Any]:
        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            made = cgutils.create_struct_proxy(record.type)(context, builder)
            made.floats, made.integers = (
                make_array(kind)(context, builder, memory).data
                if isinstance(kind, types.Array)
                else builder.inttoptr(memory, context.get_data_type(entries).as_pointer())
                for memory, kind, entries in zip(
                    given, signature.args, (types.float64, types.int64), strict=True
                )
            )
            return made._getvalue()

        return record.type(floats, integers), code

    return _intrinsic(read)


@_intrinsic
def at_address(typing: Any, address: Any, n: Any) -> tuple[Any, Any]:
    """The ``n`` floats at an address; their owner has to keep them alive."""
    result = types.Array(types.float64, 1, "C")

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = builder.inttoptr(given[0], context.get_data_type(types.float64).as_pointer())
        length = context.cast(builder, given[1], signature.args[1], types.intp)
        return view_at(context, builder, result, data, [length])

    return result(address, n), code

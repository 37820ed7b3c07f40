"""Named arrays inside one array of floats and one of integers, each declared in one line.

Calling a kernel with twenty array arguments costs 2 µs, reshaping a slice 50 ns. So everything that
a step reads and writes lies in two arrays that the caller keeps. A record is a ``NamedTuple`` whose
annotations declare the fields in these arrays, one after the other::

    class Pair(NamedTuple):
        x: Annotated[Floats, "n"]
        A: Annotated[Floats, "m", "n"]
        active: Annotated[Integers, "2 * n"]

Shapes are expressions in the fields of another ``NamedTuple`` of integers, the sizes. A field may
also be a ``NamedTuple`` of floats, or another record, with sizes of its own where it is annotated
with them: ``Annotated[Pair, {"n": "n - 1"}]``.

In Python a record is the ``NamedTuple`` of views. In a kernel it is three addresses: those of the
floats, the integers, and a table with offset and shape of each field, at the head of the integers.
``w.A`` reads the table. So a record is three arguments of a kernel. A ``NamedTuple`` of fifty
arrays would be four hundred, and dominate the compilation time of a step.
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


class Offsets(NamedTuple):
    """Offsets of a record's fields for given sizes."""

    table: Integers
    floats: int
    """Number of its floats."""
    integers: int


class RecordType:
    """The declaration of a record.

    Attributes:
        kind: The ``NamedTuple``.
        head: Number of entries of its table.
        type: Its numba type.
    """

    def __init__(self, kind: type, sizes: type, *inside: RecordType) -> None:
        """Read the declaration of ``kind``, with shapes in the fields of ``sizes``.

        ``inside``: the records that are its fields.
        """
        self.kind: Any = kind
        self._inside: dict[str, RecordType] = {}
        self._others: dict[str, dict[str, Any]] = {}
        self._shapes: dict[str, Any] = {}
        fields: dict[str, Any] = {}
        records = {record.kind: record for record in inside}
        for name, hint in typing.get_type_hints(kind, include_extras=True).items():
            of, *other = typing.get_args(hint) or (hint,)
            if of in records:
                self._inside[name], fields[name] = records[of], records[of].type
                changed = dict[str, str](*other)
                self._others[name] = {k: compile(v, k, "eval") for k, v in changed.items()}
                continue
            shape: list[Any]
            if hasattr(hint, "_fields"):  # a NamedTuple of floats
                shape = [len(hint._fields)]
                fields[name] = types.NamedUniTuple(types.float64, shape[0], hint)
            else:
                array, *shape = typing.get_args(hint)
                dtype = types.float64 if array == Floats else types.int64
                fields[name] = types.Array(dtype, len(shape), "C")
            lengths = ", ".join(map(str, shape))
            self._shapes[name] = compile(f"({lengths},)", name, "eval")
        self.type: _NumbaRecord = _NumbaRecord(f"{kind.__module__}.{kind.__qualname__}", fields)
        self.head: int = _ENTRY * len(fields) + sum(r.head for r in self._inside.values())
        self.layout = lru_cache(maxsize=256)(self._offsets)

    def _offsets(self, size: Any, floats: int = 0, integers: int = 0) -> Offsets:
        """The layout of a record that begins at these entries of the two arrays."""
        known, below, at = {"max": max} | size._asdict(), list[Integers](), 0
        own = np.zeros((len(self.type.fields), _ENTRY), dtype=np.int64)
        at = own.size
        for entry, (name, kind) in zip(own, self.type.fields.items(), strict=True):
            if name in self._inside:
                other = {k: eval(code, known) for k, code in self._others[name].items()}
                table, floats, integers = self._inside[name].layout(
                    size._replace(**other), floats, integers
                )
                entry[0] = at
                at += len(table)
                below.append(table)
                continue
            shape = eval(self._shapes[name], known)
            entry[1 : 1 + len(shape)] = shape
            if kind.dtype == types.float64:
                entry[0] = floats
                floats += math.prod(shape)
            else:
                entry[0] = integers
                integers += math.prod(shape)
        return Offsets(np.concatenate([own.ravel(), *below]), floats, integers)

    def allocate(self, size: Any) -> tuple[Floats, Integers]:
        """Allocate the two arrays, zeros; the integers begin with the table."""
        found = self.layout(size, 0, self.head)
        floats, integers = np.zeros(found.floats), np.zeros(found.integers, dtype=np.int64)
        self.resize(integers, size)
        return floats, integers

    def resize(self, integers: Integers, size: Any) -> None:
        """Write the table for other sizes, for which the two arrays must be long enough."""
        integers[: self.head] = self.layout(size, 0, self.head).table

    def arrays(self, floats: Floats, integers: Integers, table: Integers, last: str = "") -> Any:
        """The ``NamedTuple`` of views; up to field ``last`` if the arrays end there."""
        fields = self.type.fields
        views = dict[str, Any].fromkeys(fields)
        entries = table[: _ENTRY * len(fields)].reshape(-1, _ENTRY)
        for (name, kind), entry in zip(fields.items(), entries, strict=True):
            if name in self._inside:
                views[name] = self._inside[name].arrays(floats, integers, table[entry[0] :])
            else:
                base: Any = floats if kind.dtype == types.float64 else integers
                first, *shape = entry[: 1 + getattr(kind, "ndim", 1)].tolist()
                views[name] = base[first : first + math.prod(shape)].reshape(shape)
            if name == last:
                break
        return self.kind(**views)

    def end(self, size: Any, last: str) -> int:
        """Number of floats up to and including field ``last``."""
        first, *shape = self.layout(size).table[_ENTRY * list(self.type.fields).index(last) :][:4]
        ndim = getattr(self.type.fields[last], "ndim", 1)
        return int(first) + math.prod(map(int, shape[:ndim]))


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
    """The three addresses."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(
            manager, kind,
            [("floats", types.CPointer(types.float64)), ("integers", types.CPointer(types.int64)),
             ("table", types.CPointer(types.int64))],
        )  # fmt: skip


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
        found = builder.load(cgutils.gep(builder, record.table, entry + place))
        # The table does not change while a kernel runs: let loops load its entries once.
        found.set_metadata("invariant.load", builder.module.add_metadata([]))
        return found

    if isinstance(result, _NumbaRecord):
        inside = cgutils.create_struct_proxy(result)(context, builder)
        inside.floats, inside.integers = record.floats, record.integers
        inside.table = cgutils.gep(builder, record.table, number(0))
        return inside._getvalue()
    is_float = result.dtype == types.float64
    data = cgutils.gep(builder, record.floats if is_float else record.integers, number(0))
    if isinstance(result, types.NamedUniTuple):
        numbers = [builder.load(cgutils.gep(builder, data, i)) for i in range(result.count)]
        return context.make_tuple(builder, result, numbers)
    return view_at(context, builder, result, data, [number(1 + i) for i in range(result.ndim)])


def view_at(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """An array of type ``kind`` at an address; it does not own the memory."""
    word = context.get_value_type(types.intp)
    size = word(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides = [size]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    found = make_array(kind)(context, builder)
    populate_array(
        found,
        data=data,
        shape=cgutils.pack_array(builder, lengths),
        strides=cgutils.pack_array(builder, strides),
        itemsize=size,
        meminfo=None,
    )
    return found._getvalue()


def reader(record: RecordType) -> Any:
    """Make ``read(floats, integers, table)`` for kernels: the record in the two arrays.

    It cannot be called from Python; the table is usually the integers themselves.
    """

    def read(typing: Any, floats: Any, integers: Any, table: Any) -> tuple[Any, Any]:
        def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            made = cgutils.create_struct_proxy(record.type)(context, builder)
            for name, array, kind in zip(
                ("floats", "integers", "table"), given, signature.args, strict=True
            ):
                setattr(made, name, make_array(kind)(context, builder, array).data)
            return made._getvalue()

        return record.type(floats, integers, table), code

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

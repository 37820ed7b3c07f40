"""Named arrays inside one array of floats and one of integers, each declared in one line.

A kernel with twenty arrays for arguments costs its caller 2 µs, and a slice that is reshaped 50 ns;
so what a step reads and writes lies in two arrays that the caller keeps. A record is a
``NamedTuple`` whose annotations say what lies there, one after the other::

    class Pair(NamedTuple):
        x: Annotated[Floats, "n"]
        A: Annotated[Floats, "m", "n"]
        active: Annotated[Integers, "2 * n"]

Shapes are expressions in the fields of another ``NamedTuple`` of integers, the sizes. From this one
declaration come the views in a kernel (:func:`reader`), those in Python (:meth:`Record.arrays`) and
how long the two arrays are (:meth:`Record.lengths`).
"""

from __future__ import annotations

import math
import typing
from functools import lru_cache
from types import CodeType
from typing import Any

import numpy as np
import numpy.typing as npt

from qp_twist.fast.compiling import plain
from qp_twist.fast.views import matrix, stack, vector

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Entry = tuple[bool, int, tuple[int, ...]]
"""Whether a field lies among the floats, its first entry there, and its shape."""
_VIEWS = {1: "vector", 2: "matrix", 3: "stack"}


class Record:
    """What a declaration says.

    Attributes:
        kind: The ``NamedTuple`` that is declared.
        shapes: Of each field, as expressions in the sizes.
    """

    def __init__(self, kind: type, sizes: type) -> None:
        """Read the declaration of ``kind``, with shapes in the fields of ``sizes``."""
        self.kind: Any = kind
        self.sizes: tuple[str, ...] = sizes._fields  # type: ignore[attr-defined]
        self.shapes: dict[str, tuple[str, ...]] = {}
        self._floats: dict[str, bool] = {}
        self._scalars: dict[str, type] = {}
        hints = typing.get_type_hints(kind, include_extras=True)
        for name, hint in hints.items():
            if hasattr(hint, "_fields"):  # a NamedTuple of floats
                self._scalars[name], self._floats[name] = hint, True
                self.shapes[name] = (str(len(hint._fields)),)
                continue
            array, *shape = typing.get_args(hint)
            self._floats[name] = array == Floats
            self.shapes[name] = tuple(str(length) for length in shape)
        self._code: dict[str, list[CodeType]] = {
            name: [compile(length, name, "eval") for length in shape]
            for name, shape in self.shapes.items()
        }
        self.places = lru_cache(maxsize=256)(self._places)

    def _places(self, size: Any) -> tuple[dict[str, Entry], tuple[int, int]]:
        """Where each field lies, and how many floats and integers there are in all."""
        found, ends = dict[str, Entry](), [0, 0]
        for name, code in self._code.items():
            shape = tuple(eval(length, {"max": max}, size._asdict()) for length in code)
            which = 0 if self._floats[name] else 1
            found[name] = self._floats[name], ends[which], shape
            ends[which] += math.prod(shape)
        return found, (ends[0], ends[1])

    def lengths(self, size: Any) -> tuple[int, int]:
        """How many floats and integers the record has."""
        _, lengths = self.places(size)
        return lengths

    def end(self, size: Any, last: str) -> int:
        """How many floats the record has up to and with field ``last``."""
        found, _ = self.places(size)
        _, first, shape = found[last]
        return first + math.prod(shape)

    def arrays(self, floats: Floats, integers: Integers, size: Any, last: str = "") -> Any:
        """The views as a record; only up to field ``last`` where the arrays end there."""
        found, _ = self.places(size)
        views = dict[str, Any].fromkeys(found)
        for name, (is_float, first, shape) in found.items():
            base: Any = floats if is_float else integers
            views[name] = base[first : first + math.prod(shape)].reshape(shape)
            if name == last:
                break
        return self.kind(**views)


def reader(record: Record) -> Any:
    """The same for kernels: ``read(floats, first, integers, first_integer, size)``.

    Returns the record and the entries behind it, of the floats and of the integers. It is written
    out field by field, since the entries of a ``NamedTuple`` have different types.
    """
    names: dict[str, Any] = {
        "kind": record.kind, "vector": vector, "matrix": matrix, "stack": stack,
    }  # fmt: skip
    lines = ["def read(floats, i, integers, j, size):"]
    lines += [f"    {name} = size.{name}" for name in record.sizes]
    for name, shape in record.shapes.items():
        base, at = ("floats", "i") if record._floats[name] else ("integers", "j")
        lines += [f"    s{k} = {length}" for k, length in enumerate(shape)]
        lengths = ", ".join(f"s{k}" for k in range(len(shape)))
        made = f"{_VIEWS[len(shape)]}({base}, {at}, {lengths})"
        if name in record._scalars:
            kind = record._scalars[name]
            names[f"kind_{name}"] = kind
            entries = ", ".join(f"floats[i + {k}]" for k in range(len(kind._fields)))  # type: ignore[attr-defined]
            made = f"kind_{name}({entries})"
        lines.append(f"    view_{name} = {made}")
        lines.append(f"    {at} += " + " * ".join(f"s{k}" for k in range(len(shape))))
    made = ", ".join(f"view_{name}" for name in record.shapes)
    lines.append(f"    return kind({made}), i, j")
    exec("\n".join(lines), names)
    return plain(names["read"])

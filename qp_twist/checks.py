"""Checks of arguments: each returns a valid value or raises a clear message."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import operator
from collections.abc import Callable, Iterable
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from qp_twist.errors import InvalidInput

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


def clause(sentence: object) -> str:
    """A sentence without its full stop, to be continued, or closed by another sentence."""
    return str(sentence).strip().removesuffix(".")


def finite_array(
    name: str,
    value: npt.ArrayLike,
    shape: tuple[int | None, ...],
    *,
    error: type[InvalidInput] = InvalidInput,
) -> Array:
    """A float copy of ``value`` with the given shape (``None``: any length) and finite entries."""
    array = float_array(name, value, error=error)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(w is not None and g != w for g, w in zip(array.shape, shape, strict=True))
    ):
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise error(f"expected an array of shape {expected}, got {array.shape}.", key=name)
    if np.count_nonzero(np.isfinite(array)) < array.size:
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        index = where[0] if len(where) == 1 else where
        raise error(
            f"entry {index} is {array[where]}; all entries must be finite numbers.", key=name
        )
    return array


def float_array(
    name: str, value: npt.ArrayLike, *, error: type[InvalidInput] = InvalidInput
) -> Array:
    """A float copy of ``value``, infinite entries and NaN included; texts and bools are refused."""
    try:
        given = np.asarray(value)
        if given.dtype.kind in "iufO":
            return np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    shown = repr(value)
    raise error(
        f"expected numbers, got {shown if len(shown) < 60 else shown[:57] + '…'}.", key=name
    )


_FLOAT = np.dtype(np.float64)  # comparing with np.float64 converts it each time


def are_floats(values: Any, n: int) -> bool:
    """Whether these are an array of n floats; a tenth of the time of full checks."""
    return type(values) is np.ndarray and values.dtype == _FLOAT and values.shape == (n,)


def are_rows(rows: Any, ends: Any, n: int) -> bool:
    """Whether these are arrays of floats (k, n) and (k,), likewise."""
    return (
        type(rows) is type(ends) is np.ndarray
        and rows.dtype == _FLOAT
        and ends.dtype == _FLOAT
        and ends.ndim == 1
        and rows.shape == (len(ends), n)
    )


def largest(values: Array) -> float:
    """max |values|; 0 for no values, NaN if any is. ``argmax`` takes half the time of ``max``."""
    sizes = np.abs(values)
    return float(sizes.item(sizes.argmax())) if sizes.size else 0.0


def within(name: str, array: Array, most: float) -> Array:
    """``array`` if no entry exceeds ``most``, beyond which others are lost in rounding."""
    size = largest(array)
    if not size <= most:
        raise InvalidInput(
            f"an entry of size {size:.3g} is too large to compute with; entries up to "
            f"{most:g} are taken. Check the units.",
            key=name,
        )
    return array


def instance(name: str, value: object, kind: type) -> None:
    """Refuse a ``value`` that is not of the type expected."""
    if not isinstance(value, kind):
        raise InvalidInput(f"expected a {kind.__name__}, got {type(value).__name__}.", key=name)


def path_of(name: str, value: object) -> Path:
    """A path; refused is what is none."""
    if not isinstance(value, (str, PathLike)):
        raise InvalidInput(f"expected the path of a file, got {value!r}.", key=name)
    return Path(value)


_Class = TypeVar("_Class", bound=type)


def all_arguments(hint: str) -> Callable[[_Class], _Class]:
    """A decorator of a class: arguments that are missing or unknown are refused, with a hint."""

    def decorated(cls: _Class) -> _Class:
        made, signature = cls.__init__, inspect.signature(cls)  # type: ignore[misc]

        @functools.wraps(made)
        def init(self: object, *args: Any, **kwargs: Any) -> None:
            try:
                signature.bind(*args, **kwargs)
            except TypeError as error:
                raise InvalidInput(f"{cls.__name__}(…): {error}; {hint}.") from None
            made(self, *args, **kwargs)

        cls.__init__ = init  # type: ignore[misc]
        return cls

    return decorated


def rotation_matrix(name: str, value: npt.ArrayLike) -> Array:
    """``value`` as a rotation matrix (3, 3); refuses what is not orthonormal to 1e-6."""
    matrix = finite_array(name, value, (3, 3))
    if np.abs(matrix.T @ matrix - np.eye(3)).max() > 1e-6 or np.linalg.det(matrix) < 0.0:
        raise InvalidInput("expected a rotation matrix (RᵀR = 1, determinant 1).", key=name)
    return matrix


def unit_vector(name: str, value: npt.ArrayLike) -> Array:
    """``value`` (3,) scaled to length one; refuses a vector too short to have a direction."""
    vector = finite_array(name, value, (3,))
    # Scale first: the norm of a very long or very short vector over- or underflows.
    largest = float(np.abs(vector).max())
    if largest < 1e-12:
        raise InvalidInput(
            f"{vector.tolist()} has no direction; give a vector that is not zero.", key=name
        )
    vector /= largest
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def number(
    name: str,
    value: float,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> float:
    """``value`` as a finite float in the stated range."""
    result = value
    if type(value) is not float or not math.isfinite(value):  # seldom, and not at every step
        array = float_array(name, value)
        if array.shape != ():
            raise InvalidInput(
                f"expected a single number, got an array of shape {array.shape}.", key=name
            )
        if not np.isfinite(array):
            raise InvalidInput(f"expected a finite number, got {repr(value)[:60]}.", key=name)
        result = float(array)
    if above is not None and not result > above:
        raise InvalidInput(f"expected a number above {above:g}, got {result:g}.", key=name)
    if at_least is not None and not result >= at_least:
        raise InvalidInput(f"expected a number of at least {at_least:g}, got {result:g}.", key=name)
    if at_most is not None and not result <= at_most:
        raise InvalidInput(f"expected a number of at most {at_most:g}, got {result:g}.", key=name)
    return result


def whole_number(name: str, value: int, *, at_least: int, at_most: int | None = None) -> int:
    """``value`` as an int in the stated range; bools and floats are refused."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise InvalidInput(f"expected a whole number, got {value!r}.", key=name)
    number(name, int(value), at_least=at_least, at_most=at_most)
    return int(value)


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> str:
    """``value`` if it is one of ``allowed``."""
    if not isinstance(value, str) or value not in allowed:
        raise InvalidInput(f"expected one of {', '.join(allowed)}; got {value!r}.", key=name)
    return value


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``"; did you mean 'deburring'?"``, or ``"."`` where no known name is near."""
    close = difflib.get_close_matches(name, list(dict.fromkeys(known)), n=2)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else "."


_Method = TypeVar("_Method", bound=Callable[..., None])


def refusing_unknown_names(init: _Method) -> _Method:
    """An ``__init__`` that refuses unknown keywords and suggests similar ones."""
    known = inspect.signature(init).parameters

    @functools.wraps(init)
    def checked_init(self: Any, *args: Any, **options: Any) -> None:
        for name in options.keys() - known:
            hint = did_you_mean(name, known)
            if isinstance(getattr(type(self), name, None), property):
                hint = f"; it is an attribute: set it afterwards, by ….{name} = {options[name]!r}"
            raise TypeError(f"{type(self).__name__}: there is no argument {name!r}{hint}")
        init(self, *args, **options)

    return cast(_Method, checked_init)


def read_only(array: Array) -> Array:
    """The same array, made read-only."""
    array.setflags(write=False)
    return array


class _Checked:
    """A property whose getter is implemented in C, for attributes read at every step."""

    def __init__(self, check: Callable[[Any, str, Any], Any]) -> None:
        self._check = check

    def __set_name__(self, owner: type, name: str) -> None:
        kept, check = f"_{name}", self._check

        def assign(instance: Any, value: Any) -> None:
            setattr(instance, kept, check(instance, name, value))

        setattr(owner, name, property(operator.attrgetter(kept), assign))


def checked(check: Callable[[Any, str, Any], Any]) -> Any:
    """An attribute that stores ``check(instance, name, value)`` of assigned values."""
    return _Checked(check)


class _Changes:
    """What tells a compiled step that nothing has been assigned since the last one."""

    __slots__ = ("latest",)

    def __init__(self) -> None:
        self.latest = object()


changes = _Changes()
"""Its ``latest`` is another object after each assignment to anything that is revised. (A number,
incremented by two threads at once, could be one that a step has seen before.)"""


def revise(changed: Any) -> None:
    """Count an assignment to an object, by which compiled steps notice it."""
    kept = changed.__dict__
    kept["revision"] = kept.get("revision", 0) + 1
    changes.latest = object()


class Revised:
    """Counts the assignments of its attributes, by which a compiled step notices a change.

    Attributes whose names begin with an underscore do not count.
    """

    revision: int

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name[0] != "_":
            revise(self)

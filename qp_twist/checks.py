"""Checks of arguments: each returns a clean value or raises a sentence."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.errors import InvalidInput

Array = npt.NDArray[np.float64]


def finite_array(
    name: str,
    value: npt.ArrayLike,
    shape: tuple[int | None, ...],
    *,
    error: type[InvalidInput] = InvalidInput,
) -> Array:
    """A float copy of ``value`` with the given shape (``None``: any length) and finite entries."""
    array = _as_floats(name, value, error)
    wrong = array.ndim != len(shape) or any(
        want is not None and got != want for got, want in zip(array.shape, shape, strict=True)
    )
    if wrong:
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise error(f"{name}: expected an array of shape {expected}, got {array.shape}.")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        index = where[0] if len(where) == 1 else where
        raise error(f"{name}: entry {index} is {array[where]}; all entries must be finite numbers.")
    return array


def _as_floats(name: str, value: npt.ArrayLike, error: type[InvalidInput]) -> Array:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise error(f"{name}: expected numbers, got {value!r}.") from None


def unit_vector(name: str, value: npt.ArrayLike) -> Array:
    """``value`` (3,) scaled to length one; refuses a vector too short to have a direction."""
    vector = finite_array(name, value, (3,))
    # Scale first: the norm of a very long or very short vector over- or underflows.
    largest = float(np.abs(vector).max())
    if largest < 1e-12:
        raise InvalidInput(
            f"{name}: {vector.tolist()} has no direction; give a vector that is not zero."
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
    result = float(finite_array(name, value, ()))
    if above is not None and not result > above:
        raise InvalidInput(f"{name}: expected a number above {above:g}, got {result:g}.")
    if at_least is not None and not result >= at_least:
        raise InvalidInput(f"{name}: expected a number of at least {at_least:g}, got {result:g}.")
    if at_most is not None and not result <= at_most:
        raise InvalidInput(f"{name}: expected a number of at most {at_most:g}, got {result:g}.")
    return result


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> str:
    """``value`` if it is one of ``allowed``."""
    if value not in allowed:
        raise InvalidInput(f"{name}: expected one of {', '.join(allowed)}; got {value!r}.")
    return value

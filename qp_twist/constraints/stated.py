"""Numbers of a limit that its user may replace."""

from __future__ import annotations

from typing import Any

import numpy as np

from qp_twist.checks import Array, checked, float_array, read_only
from qp_twist.errors import InvalidInput


def stated() -> Any:
    """An attribute that holds an array, one number a degree of freedom.

    Another array is assigned as a whole; it cannot be written into. Each assignment counts up the
    limit's ``revision``, so that a step which has laid the numbers out sees that they are others.
    """
    return checked(_taken)


def _taken(limit: Any, name: str, value: Any) -> Array:
    """A copy of another one, infinite entries included."""
    array, before = float_array(name, value), getattr(limit, f"_{name}", None)
    if before is not None and array.shape != before.shape:
        raise InvalidInput(f"{name}: expected an array of shape {before.shape}, got {array.shape}.")
    if np.isnan(array).any():
        raise InvalidInput(f"{name}: entries must be numbers or infinite, not NaN.")
    limit.revision = getattr(limit, "revision", 0) + 1
    return read_only(array)

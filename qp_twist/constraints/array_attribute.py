"""Arrays of a limit that its user may replace."""

from __future__ import annotations

from typing import Any

import numpy as np

from qp_twist.checks import Array, checked, float_array, read_only
from qp_twist.errors import InvalidInput


def array_attribute() -> Any:
    """An attribute that holds an array, (nv,).

    The array is read-only; assign another one to change it. Each assignment increments the limit's
    ``revision``, by which a compiled step notices the change.
    """
    return checked(_copied)


def _copied(limit: Any, name: str, value: Any) -> Array:
    """Check and copy an assigned array; entries may be infinite."""
    array, before = float_array(name, value), getattr(limit, f"_{name}", None)
    if before is not None and array.shape != before.shape:
        raise InvalidInput(f"{name}: expected an array of shape {before.shape}, got {array.shape}.")
    if np.isnan(array).any():
        raise InvalidInput(f"{name}: entries must be numbers or infinite, not NaN.")
    limit.revision = getattr(limit, "revision", 0) + 1
    return read_only(array)

"""Numbers of a limit that its user may replace."""

from __future__ import annotations

from typing import Any

import numpy as np

from qp_twist.checks import Array, float_array
from qp_twist.errors import InvalidInput


class Stated:
    """An attribute that holds an array, one number a degree of freedom.

    Another array is assigned as a whole; it cannot be written into. Each assignment counts up the
    limit's ``revision``, so that a step which has laid the numbers out sees that they are others.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        """Where the array is kept."""
        self._name, self._kept = name, f"_{name}"

    def __get__(self, limit: Any, owner: type | None = None) -> Array:
        """The array."""
        if limit is None:
            return self  # type: ignore[return-value]  # of the class
        array: Array = getattr(limit, self._kept)
        return array

    def __set__(self, limit: Any, value: Any) -> None:
        """A copy of another one, infinite entries included."""
        array = float_array(self._name, value)
        before = getattr(limit, self._kept, None)
        if before is not None and array.shape != before.shape:
            raise InvalidInput(
                f"{self._name}: expected an array of shape {before.shape}, got {array.shape}."
            )
        if np.isnan(array).any():
            raise InvalidInput(f"{self._name}: entries must be numbers or infinite, not NaN.")
        array.flags.writeable = False
        setattr(limit, self._kept, array)
        limit.revision = getattr(limit, "revision", 0) + 1

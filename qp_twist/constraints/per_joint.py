"""Convert limits by joint name, or one for all joints, to an array."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, float_array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges


def per_joint(
    name: str, value: Mapping[str, float] | npt.ArrayLike | None, ranges: JointRanges
) -> Array:
    """Limits by degree of freedom, (nv,); ∞ without a limit.

    Args:
        name: Name of the value in messages.
        value: By joint name (a ball or free joint's counts for each of its degrees of freedom), a
            number for all, an array (nv,), or ``None`` for no limits. Entries are above 0, ``inf``
            included.
        ranges: Joint ranges of the model.

    Raises:
        InvalidInput: If there is no such joint, or a shape or a sign is wrong.
    """
    nv = len(ranges.names)
    limits = np.full(nv, np.inf)
    if isinstance(value, Mapping):
        for joint, limit in value.items():
            dofs = [dof for dof in range(nv) if ranges.names[dof] == joint]
            if not dofs:
                raise InvalidInput(
                    f"{name}.{joint}: the model has no joint of that name; it has "
                    f"{', '.join(dict.fromkeys(ranges.names))}."
                )
            limits[dofs] = _checked(f"{name}.{joint}", limit, ())
    elif value is not None:
        limits[:] = _checked(name, value, (nv,))
    return limits


def _checked(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    limits = float_array(name, value)
    if limits.shape not in ((), shape):
        raise InvalidInput(
            f"{name}: expected a number{f' or {shape[0]} of them' if shape else ''}, got an array "
            f"of shape {limits.shape}."
        )
    if not (limits > 0.0).all():
        raise InvalidInput(f"{name}: expected numbers above 0, got {limits.tolist()}.")
    return limits

"""Task rows T J and T Δt."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector

ProjectorLike = TwistProjector | npt.ArrayLike

RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""


def projector_matrix(name: str, projector: ProjectorLike | None) -> Array:
    """T as a 6 × 6 matrix in world axes; the identity if ``None``."""
    if projector is None:
        return np.eye(6)
    if isinstance(projector, TwistProjector):
        if projector.frame != "world":
            raise InvalidInput(
                f"{name}: this projector is fixed to the {projector.frame} frame; pass "
                "projector.resolved(body=R, target=R_d), which is in world axes."
            )
        return projector.matrix
    return finite_array(name, projector, (6, 6))


def task_rows(
    jacobian: npt.ArrayLike, projector: ProjectorLike | None, twist: npt.ArrayLike
) -> tuple[Array, Array]:
    """A and b of the task A Δθ = b.

    With a projector A = T J (6, n) and b = TΔt (6,); without one any rows A = J (m, n), b = Δt
    (m,).

    Raises:
        InvalidInput: If a shape is wrong, an entry is not finite, or T is not in world axes.
    """
    rows = None if projector is None else 6
    j = finite_array("jacobian", jacobian, (rows, None))
    dt = finite_array("twist", twist, (j.shape[0],))
    if projector is None:
        return j, dt
    t = projector_matrix("projector", projector)
    return t @ j, t @ dt

"""Poses and Jacobians of many configurations."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.following.batch.arrays import shared
from qp_twist.kinematics import SerialChain


class Kinematics(NamedTuple):
    """A frame at K configurations."""

    rotations: Array
    """Rotations to the world, (K, 3, 3)."""
    positions: Array
    """Positions of its origin, m, (K, 3)."""
    jacobians: Array
    """World-aligned Jacobians, rows (linear, angular), (K, 6, nv)."""


def kinematics(
    model: mujoco.MjModel,
    frame_name: str | int,
    frame_type: str,
    q: npt.ArrayLike,
    *,
    threads: int | None = None,
) -> Kinematics:
    """Poses and Jacobians of a frame, as MuJoCo's, for many configurations.

    Args:
        model: A robot whose frame is moved by hinges and slides.
        frame_name: Name or id of the frame.
        frame_type: ``"body"``, ``"geom"`` or ``"site"``.
        q: Configurations, rad or m, (K, nq).
        threads: Number of threads; all cores by default.

    Raises:
        InvalidInput: If an array has the wrong shape or is not finite, or a ball or free joint
            moves the frame.
        mink.InvalidFrame: If the model has no such frame.
    """
    from qp_twist.kernel.arm_kernel import poses_and_jacobians
    from qp_twist.kinematics.compiled_rows import arm_of

    arm = arm_of(SerialChain.of(model, frame_name, frame_type))
    given = np.ascontiguousarray(finite_array("q", q, (None, model.nq)))
    poses, jacobians = np.zeros((len(given), 12)), np.zeros((len(given), 6, model.nv))
    shared(
        len(given),
        lambda part: poses_and_jacobians(arm, given[part], poses[part], jacobians[part]),
        threads,
    )
    return Kinematics(poses[:, :9].reshape(-1, 3, 3), poses[:, 9:], jacobians)

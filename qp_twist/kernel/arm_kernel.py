"""Pose and Jacobian of a frame at the end of a chain of hinges and slides, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.compiling import entry, plain


class Arm(NamedTuple):
    """A serial chain in arrays: each joint turns about, or slides along, its frame's z axis."""

    frames: npt.NDArray[np.float64]
    """Transform from the previous joint's frame (for the first: the world) to the joint's frame at
    its reference position: rotation, row by row (9), and origin, m (3); (S, 12)."""
    tip: npt.NDArray[np.float64]
    """The same from the last joint's frame to the controlled one, (12,)."""
    reference: npt.NDArray[np.float64]
    """Reference position of each joint, rad or m, (S,)."""
    qpos: npt.NDArray[np.int64]
    """Index of each joint's coordinate in q, (S,)."""
    dofs: npt.NDArray[np.int64]
    """Index of each joint's column in the Jacobian, (S,)."""
    slides: npt.NDArray[np.int64]
    """1 for a slide, 0 for a hinge, (S,)."""


@plain
def pose_and_jacobian(arm, q, pose, J):
    """Write R (9) and p (3) of the frame to ``pose``, and its joints' columns to J (6, nv).

    World axes, rows (linear, angular), as MuJoCo's; the columns of other joints are not changed.
    """
    a, b, c, d, e, f, g, h, i = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    x, y, z = 0.0, 0.0, 0.0
    count = arm.qpos.shape[0]
    for joint in range(count + 1):
        F = arm.frames[joint] if joint < count else arm.tip
        x += a * F[9] + b * F[10] + c * F[11]
        y += d * F[9] + e * F[10] + f * F[11]
        z += g * F[9] + h * F[10] + i * F[11]
        a, b, c = (
            a * F[0] + b * F[3] + c * F[6],
            a * F[1] + b * F[4] + c * F[7],
            a * F[2] + b * F[5] + c * F[8],
        )
        d, e, f = (
            d * F[0] + e * F[3] + f * F[6],
            d * F[1] + e * F[4] + f * F[7],
            d * F[2] + e * F[5] + f * F[8],
        )
        g, h, i = (
            g * F[0] + h * F[3] + i * F[6],
            g * F[1] + h * F[4] + i * F[7],
            g * F[2] + h * F[5] + i * F[8],
        )
        if joint == count:
            break
        dof = arm.dofs[joint]
        # The axis, and a point on it, until the frame's origin is known.
        J[0, dof], J[1, dof], J[2, dof] = x, y, z
        J[3, dof], J[4, dof], J[5, dof] = c, f, i
        travel = q[arm.qpos[joint]] - arm.reference[joint]
        if arm.slides[joint]:
            x += travel * c
            y += travel * f
            z += travel * i
        else:
            cos, sin = math.cos(travel), math.sin(travel)
            a, b = cos * a + sin * b, cos * b - sin * a
            d, e = cos * d + sin * e, cos * e - sin * d
            g, h = cos * g + sin * h, cos * h - sin * g
    pose[0], pose[1], pose[2], pose[3], pose[4], pose[5] = a, b, c, d, e, f
    pose[6], pose[7], pose[8], pose[9], pose[10], pose[11] = g, h, i, x, y, z
    for joint in range(count):
        dof = arm.dofs[joint]
        u, v, w = J[3, dof], J[4, dof], J[5, dof]
        if arm.slides[joint]:
            J[0, dof], J[1, dof], J[2, dof] = u, v, w
            J[3, dof], J[4, dof], J[5, dof] = 0.0, 0.0, 0.0
        else:
            rx, ry, rz = x - J[0, dof], y - J[1, dof], z - J[2, dof]
            J[0, dof], J[1, dof], J[2, dof] = v * rz - w * ry, w * rx - u * rz, u * ry - v * rx


@entry
def poses_and_jacobians(arm, q, poses, jacobians):
    """:func:`pose_and_jacobian` for each row of q (K, nq): poses (K, 12), jacobians (K, 6, nv)."""
    for k in range(len(q)):
        pose_and_jacobian(arm, q[k], poses[k], jacobians[k])

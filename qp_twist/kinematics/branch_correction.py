"""Newton's method on all branches of six hinges, on the model's own kinematics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.kernel import arm_kernel
from qp_twist.kinematics.compiled_rows import arm_of
from qp_twist.kinematics.serial_chain import SerialChain

BRANCHES = 16
"""Solutions of six hinges at most."""
_CLOSED, _ROUNDING = 1e-9, 1e-12
"""Largest error of a solution; error at which it is no longer corrected; m and rad."""
_STEPS, _LONGEST, _DAMPING = 16, 0.1, 1e-15
"""Newton steps at most, their longest, rad, and what keeps a singular one finite."""
_ALIKE = 1e-5
"""Solutions of which no joint differs by more are one, rad: where the Jacobian is
nearly singular they are apart by rounding."""


def corrected(
    chain: SerialChain, moving: Sequence[int], q: Array, rotations: Array, positions: Array
) -> Array:
    """Solutions (K, B, nv) of K poses, each once, from candidates q (K, C, nv) near them.

    Newton's method moves six joints until the pose is met to 1e-12 m and rad. It serves models
    whose angles are rounded, and roots that nearly coincide.

    Args:
        chain: The joints up to the frame.
        moving: Indices of the six hinges in nv that are corrected; the others stay.
        q: The candidates, rad or m; rows of NaN are none. It is overwritten.
        rotations: Of the chain's frame to the world, (K, 3, 3).
        positions: Of its origin in the world, m, (K, 3).

    Returns:
        The solutions first, then rows of NaN; B is C, or 16 if that is less.
    """
    pose, branch = np.nonzero(np.isfinite(q).all(axis=2))
    arm, at, left = arm_of(chain), q[pose, branch], np.arange(len(pose))
    error = np.full(len(pose), np.inf)
    for _ in range(_STEPS):
        poses, jacobians = np.empty((len(left), 12)), np.zeros((len(left), 6, chain.nv))
        arm_kernel.poses_and_jacobians(arm, at[left], poses, jacobians)
        turn = rotations[pose[left]] @ poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)
        about = 0.5 * (turn - turn.swapaxes(1, 2))[:, [2, 0, 1], [1, 2, 0]]  # axis · sin(angle)
        missed = np.concatenate([positions[pose[left]] - poses[:, 9:], about], axis=1)
        error[left] = np.abs(missed).max(axis=1)
        again = error[left] > _ROUNDING
        left, rows = left[again], jacobians[again][:, :, list(moving)]
        if not len(left):
            break
        normal = rows @ rows.swapaxes(1, 2) + _DAMPING * np.eye(6)
        step = rows.swapaxes(1, 2) @ np.linalg.solve(normal, missed[again, :, None])
        at[left[:, None], list(moving)] += np.clip(step[..., 0], -_LONGEST, _LONGEST)
    q[pose, branch] = np.where((error < _CLOSED)[:, None], at, np.nan)
    found = _packed(q)
    for shift in range(1, found.shape[1]):
        apart = np.remainder(found[:, shift:] - found[:, :-shift] + np.pi, 2.0 * np.pi) - np.pi
        found[:, shift:][np.abs(apart).max(axis=2) < _ALIKE] = np.nan
    return _packed(found, min(q.shape[1], BRANCHES))


def _packed(q: Array, count: int | None = None) -> Array:
    """The solutions among q (K, C, nv) first, in ``count`` columns or all that are needed."""
    none = np.isnan(q[:, :, 0])
    most = int((~none).sum(axis=1).max(initial=0)) if count is None else count
    columns = np.argsort(none, axis=1, kind="stable")[:, :most, None]
    packed = np.full((len(q), most, q.shape[2]), np.nan)
    packed[:, : columns.shape[1]] = np.take_along_axis(q, columns, axis=1)
    return packed

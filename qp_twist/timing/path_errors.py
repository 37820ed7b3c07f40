"""How far a joint motion is from a path: at its waypoints and between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices
from qp_twist.geometry import TwistProjector, many_twist_errors
from qp_twist.kinematics.frame import frame_id
from qp_twist.path import PathTask
from qp_twist.timing.joint_motion import JointMotion

SAMPLES = 8
"""Points at which the way from a row or waypoint to the next is looked at, without its ends."""
_SHORT = 1e-12


@dataclass(frozen=True, eq=False)
class PathErrors:
    """Task errors of a motion, in the rows of the task only.

    Attributes:
        position: At the waypoints, m, (N,).
        axis: At the waypoints, rad, (N,).
        position_between: Largest between a waypoint and the next, m, (N − 1,).
        axis_between: Likewise, rad, (N − 1,).
        rate: Fastest progress between a waypoint and the next, in shares of that way per second,
            beyond what errors within a slack can make of it, (N − 1,); 1/s.
    """

    position: Array
    axis: Array
    position_between: Array
    axis_between: Array
    rate: Array


def path_errors(
    path_task: PathTask,
    motion: JointMotion,
    times: Array | None = None,
    samples: int = SAMPLES,
    slack: tuple[float, float] = (0.0, 0.0),
) -> PathErrors:
    r"""Measure a motion against the waypoints and against the way from each to the next.

    Between two waypoints the path is the straight line of their positions and the shortest rotation
    of their orientations, both in the same proportion λ ∈ [0, 1]. What counts is the distance from
    that way, not from where the feed would be: a pose is measured against the λ at which the linear
    task error is least (the angular one where the positions do not differ).

    The rows are those of the projector that is in force at both waypoints; where it changes, of the
    one with fewer rows.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom of the task's robot.
        times: When the motion is at each waypoint, s, (N,), never decreasing; its rows' times if
            ``None``, which then are as many as the waypoints.
        samples: Points looked at from each waypoint, and each row between waypoints, to the next.
        slack: Errors along the path that are no progress, m and rad.
    """
    when = motion.times if times is None else times
    count = len(when)
    targets = path_task.waypoints[:count]
    R_d = np.array([w.rotation().as_matrix() for w in targets])
    p_d = np.array([w.translation() for w in targets])
    in_force = path_task.in_force[:count]
    R, p = poses_of(path_task, motion.at(when).q)
    position, axis = _at(R, p, R_d, p_d, in_force)
    at, k = _looked_at(motion.times, when, samples)
    (R_0, p_0), (R, p) = (R, p), poses_of(path_task, motion.at(at).q)
    between = tuple(
        after if after.rank <= before.rank else before
        for before, after in itertools.pairwise(in_force)
    )
    rows = [between[i] for i in k]
    lam = _nearest(R, p, (R_d[k], p_d[k]), (R_d[k + 1], p_d[k + 1]), rows)
    turn = Rotation.from_matrix(R_d[1:] @ R_d[:-1].transpose(0, 2, 1)).as_rotvec()
    R_on = Rotation.from_rotvec(lam[:, None] * turn[k]).as_matrix() @ R_d[k]
    p_on = p_d[k] + lam[:, None] * (p_d[k + 1] - p_d[k])
    linear, angular = _at(R, p, R_on, p_on, rows)
    position_between, axis_between = np.zeros(count - 1), np.zeros(count - 1)
    np.maximum.at(position_between, k, linear)
    np.maximum.at(axis_between, k, angular)
    ends = [
        _nearest(R_0[side], p_0[side], (R_d[:-1], p_d[:-1]), (R_d[1:], p_d[1:]), between)
        for side in (slice(None, -1), slice(1, None))
    ]
    pieces = np.arange(count - 1)
    rate = _rate(
        np.concatenate([k, pieces, pieces]),
        np.concatenate([at, when[:-1], when[1:]]),
        np.concatenate([lam, *ends]),
        _within(task_errors(R_d[:-1], p_d[:-1], R_d[1:], p_d[1:], between), slack),
    )
    return PathErrors(position, axis, position_between, axis_between, rate)


def _within(way: Array, slack: tuple[float, float]) -> Array:
    """The share of each way (N − 1, 6) that errors at both ends of a stretch can be, (N − 1,)."""
    linear, angular = np.linalg.norm(way[:, :3], axis=1), np.linalg.norm(way[:, 3:], axis=1)
    moves = linear**2 > _SHORT  # as _nearest decides
    error, length = np.where(moves, slack[0], slack[1]), np.where(moves, linear, angular)
    within: Array = 2.0 * error / np.maximum(length, _SHORT)
    return within


def _rate(piece: Indices, at: Array, lam: Array, within: Array) -> Array:
    """Largest |dλ/dt| of each piece, 1/s, from λ (K,) at times (K,) in pieces (K,).

    Of each Δλ that of its piece's errors, ``within`` (N − 1,), is taken off; where two times are
    the same there is no rate.
    """
    order = np.lexsort((at, piece))
    piece, at, lam = piece[order], at[order], lam[order]
    took = np.diff(at)
    same = (piece[1:] == piece[:-1]) & (took > 0.0)
    here = piece[1:][same]
    moved = np.maximum(np.abs(np.diff(lam)[same]) - within[here], 0.0)
    rate = np.zeros(len(within))
    np.maximum.at(rate, here, moved / took[same])
    return rate


def _looked_at(rows: Array, when: Array, samples: int) -> tuple[Array, Indices]:
    """Times between waypoints, s, (K,), and the index of the waypoint before each, (K,).

    All rows that are no waypoints, however many lie between two, and points between them: a motion
    may leave the path from one row to the next.
    """
    rows = rows[(rows > when[0]) & (rows < when[-1])]
    knots = np.union1d(when, rows)
    shares = np.arange(1, samples + 1) / (samples + 1)
    between = (knots[:-1, None] + np.diff(knots)[:, None] * shares).ravel()
    at = np.concatenate([between, np.setdiff1d(rows, when)])
    before = np.clip(np.searchsorted(when, at, side="right") - 1, 0, len(when) - 2)
    return at, before


def poses_of(path_task: PathTask, q: Array) -> tuple[Array, Array]:
    """Rotations (K, 3, 3) and positions (K, 3) of the task's frame for joints q (K, nv)."""
    model = path_task.model
    data = mujoco.MjData(model)
    index = frame_id(model, path_task.frame_name, path_task.frame_type)
    rotation = getattr(data, mink.FRAME_TO_XMAT_ATTR[path_task.frame_type])[index]
    origin = getattr(data, mink.FRAME_TO_POS_ATTR[path_task.frame_type])[index]
    R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        R[k], p[k] = rotation.reshape(3, 3), origin
    return R, p


def task_errors(
    R: Array,
    p: Array,
    R_d: Array,
    p_d: Array,
    rows: Sequence[TwistProjector],
) -> Array:
    """Δt (K, 6) of K poses against K targets, each in the rows of its own projector."""
    errors = np.zeros((len(p), 6))
    ids = np.array([id(projector) for projector in rows])
    for projector in {id(t): t for t in rows}.values():
        here = ids == id(projector)
        errors[here] = many_twist_errors(R[here], p[here], R_d[here], p_d[here], projector)[1]
    return errors


def _at(
    R: Array,
    p: Array,
    R_d: Array,
    p_d: Array,
    rows: Sequence[TwistProjector],
) -> tuple[Array, Array]:
    errors = task_errors(R, p, R_d, p_d, rows)
    return np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)


def _nearest(
    R: Array,
    p: Array,
    before: tuple[Array, Array],
    after: tuple[Array, Array],
    rows: Sequence[TwistProjector],
) -> Array:
    """λ (K,) of the point nearest to each pose on the way from one target to the next."""
    e0 = task_errors(R, p, *before, rows)
    e1 = task_errors(R, p, *after, rows)
    lam = np.full(len(p), 0.5)
    decided = np.zeros(len(p), dtype=bool)
    for part in (slice(0, 3), slice(3, 6)):
        way = e1[:, part] - e0[:, part]
        square = np.einsum("ki,ki->k", way, way)
        here = ~decided & (square > _SHORT)
        lam[here] = -np.einsum("ki,ki->k", e0[here, part], way[here]) / square[here]
        decided |= here
    clipped: Array = np.clip(lam, 0.0, 1.0)
    return clipped

"""The path of a trajectory rounded within the tolerances of a check."""

from __future__ import annotations

import numpy as np
import qpsolvers
from scipy import sparse

from qp_twist.checks import Array, Mask
from qp_twist.following import Trajectory
from qp_twist.geometry import distinct_projectors
from qp_twist.referee import CORNER, task_errors, turns_of

_SHARE = 0.4
"""Of a tolerance that is used at rows. Between them the curve of the joints is farther off: with a
half it used up to 0.96 of the tolerances on a seam (``timing_seam``), with this 0.81."""
_DAMPING = 1e-9
"""Of what leaves the path as smooth as it is, such as rows that no piece of it depends on."""


def smooth_at(trajectory: Trajectory) -> Mask:
    """At which rows but the ends the path has no corner, (N − 2,)."""
    return turns_of(trajectory.path.positions) < CORNER


def differences(feed: Array, moves: Mask) -> list[sparse.csr_matrix]:
    """From N rows to speeds on the pieces, from these to accelerations at rows, to jerks.

    ``feed`` (N − 1,) is the time of each piece, s; on joint moves (``moves``) nothing changes.
    """
    h = np.where(moves | (feed <= 0.0), np.inf, feed)
    spans = h, 0.5 * (h[1:] + h[:-1]), h[1:-1]
    return [
        sparse.diags([-1.0 / of, 1.0 / of], [0, 1], shape=(len(of), len(of) + 1), format="csr")
        for of in spans
    ]


def rounding(trajectory: Trajectory, held: Mask) -> Array:
    r"""Twists by which the targets of rows are moved onto a smoother path, m and rad, (N, 6).

    Between waypoints a path is straight, and its velocity jumps at each of them. Joints whose rows
    are exactly on it would need accelerations that the path does not mean. Of the targets
    :math:`\mathbf x_k`, moved by :math:`\boldsymbol\delta_k` in the rows of the task,

    .. math::

        \min_{\boldsymbol\delta} \sum_k h_k\,\|\mathbf x_k''' + \boldsymbol\delta_k'''\|^2,
        \qquad |\mathbf U_k^T\boldsymbol\delta_k| \le 0.4\,\varepsilon,

    with derivatives by the time at the feed, in units of the tolerances ε. Corners stay where they
    are, and the path beside them does not count; so do both ends and the rows ``held`` (N,).
    """
    task, path, feed = trajectory.path_task, trajectory.path, trajectory.feed
    assert feed is not None
    tolerances, (R, p), count = task.tolerances, (path.rotations, path.positions), len(path.s)
    basis, room = np.zeros((count, 6, 6)), np.zeros((count, 6))
    for number, projector in enumerate((found := distinct_projectors(path.projectors))[0]):
        at, split = found[1] == number, projector.linear.rank
        basis[at, :, : projector.rank] = projector.in_world(R[at], R[at]).basis
        room[at, :split] = tolerances.position / max(split, 1) ** 0.5
        room[at, split : projector.rank] = tolerances.axis / max(projector.angular.rank, 1) ** 0.5
    smooth = smooth_at(trajectory)
    room[held | ~np.concatenate([[False], smooth, [False]])] = 0.0
    to_speeds, to_accelerations, to_jerks = differences(feed, path.moves)
    steps = task_errors(R[:-1], p[:-1], R[1:], p[1:], path.projectors[1:])
    speeds = sparse.diags(1.0 / np.where(feed > 0.0, feed, np.inf)) @ steps
    counts = (smooth[1:] & smooth[:-1]) * feed[1:-1] ** 0.5 * np.median(feed) ** 3
    units = sparse.kron(
        sparse.diags(counts),
        np.diag(np.repeat([1.0 / tolerances.position, 1.0 / tolerances.axis], 3)),
    )
    jerks = units @ (to_jerks @ to_accelerations @ speeds).ravel()
    pointers = np.arange(count + 1)
    into = sparse.bsr_matrix((basis * (_SHARE * room)[:, None], pointers[:-1], pointers))
    A = units @ sparse.kron(to_jerks @ to_accelerations @ to_speeds, sparse.identity(6)) @ into
    most = np.ones(6 * count)
    program = qpsolvers.Problem(
        (A.T @ A + _DAMPING * sparse.identity(6 * count)).tocsc(), A.T @ jerks, lb=-most, ub=most
    )
    solution = qpsolvers.solve_problem(program, solver="clarabel")
    if not solution.found or solution.x is None:
        return np.zeros((count, 6))
    moved: Array = (into @ np.clip(solution.x, -most, most)).reshape(count, 6)
    return moved

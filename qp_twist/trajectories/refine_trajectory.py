"""Insert rows between waypoints where the motion would leave the path."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, Indices, Mask, instance
from qp_twist.following import Trajectory
from qp_twist.following.sampling import ROOM
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import JointMotion, sampled_errors

_ROUNDS = 12
_MORE = 0.25
"""A piece is refined only if its error exceeds that of its rows by this share."""
_INSIDE = 1e-9
"""Violation of a limit that is rounding, rad or m."""


def refine_trajectory(
    trajectory: Trajectory,
    *,
    position_tolerance: float | None = None,
    axis_tolerance_deg: float | None = None,
) -> Trajectory:
    """Insert rows until linear interpolation of the joints keeps the path.

    A method meets the waypoints; between two of them the path error grows with the joints'
    displacement, above all in the null space. There another row is inserted, at half the
    displacement: the mean of the joint positions, corrected by least-norm steps within the limits.
    This is repeated until every piece stays within half the tolerances, also for hard bands.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`.
        position_tolerance: Largest linear task error between rows, m; ``None``: that of a check.
        axis_tolerance_deg: Largest angular task error there, degrees; ``None``: likewise.

    Returns:
        A trajectory with further rows, each with its parameter ``s`` of the path and its share of
        the time; the same trajectory if none was inserted. A piece is unchanged if its row cannot
        be corrected, or a waypoint was missed anyway.
    """
    instance("refine_trajectory(trajectory)", trajectory, Trajectory)
    tolerances = trajectory.path_task.tolerances.stated(position_tolerance, axis_tolerance_deg)
    met = tolerances.met(trajectory.position_error, trajectory.axis_error)
    pieces = np.flatnonzero(met[:-1] & met[1:])
    for _ in range(_ROUNDS):
        if not len(pieces):
            break
        motion = JointMotion(np.arange(len(trajectory.q), dtype=np.float64), trajectory.q)
        errors, units = sampled_errors(trajectory.path_task, motion, trajectory.s, pieces)
        at, between = np.maximum(errors[:, 0], errors[:, -1]), errors[:, 1:-1].max(axis=1)
        limits = tolerances.of(units)
        # What is outside at its rows is not mended by further ones.
        strays = (at <= limits) & (between > np.maximum(ROOM * limits, at + _MORE * limits))
        asked = pieces[strays.any(axis=1)]
        trajectory, divided = with_rows_between(trajectory, asked, np.full(len(asked), 0.5))
        first = divided + np.arange(len(divided))
        pieces = np.sort(np.concatenate([first, first + 1]))
    return trajectory


def with_rows_between(
    trajectory: Trajectory, pieces: Indices, shares: Array
) -> tuple[Trajectory, Indices]:
    """The trajectory with another row in pieces (K,), ascending, at shares (K,) of them.

    Also returns those of the pieces that have got a row: not all joint positions can be corrected
    onto the path. Piece k is bounded by rows k and k + 1.
    """
    if not len(pieces):
        return trajectory, pieces
    task, q, s = trajectory.path_task, trajectory.q, trajectory.s
    begin, end = q[pieces], q[pieces + 1]
    rows = begin + shares[:, None] * (end - begin)
    between = s[pieces] + shares * (s[pieces + 1] - s[pieces])
    path = PathRows(task, between)
    found = trajectory.path.moves[pieces].copy()
    on_path = np.flatnonzero(~found)
    # Where the rows beside it are outside a range, a row may be, too.
    ranges = JointRanges.of(task.model)
    lower, upper = np.minimum(begin, end), np.maximum(begin, end)
    box = np.minimum(ranges.lower, lower)[on_path], np.maximum(ranges.upper, upper)[on_path]
    rows[on_path], found[on_path] = _corrected(path, rows[on_path], on_path, box)
    pieces, shares, rows, between = pieces[found], shares[found], rows[found], between[found]
    if not len(pieces):
        return trajectory, pieces
    durations = trajectory.durations
    if durations is not None:
        times = divided_times(durations[1:], pieces, shares)
        durations = np.concatenate([durations[:1], times])
    return trajectory.with_rows(pieces + 1, rows, between, durations), pieces


def divided_times(times: Array, pieces: Indices, shares: Array) -> Array:
    """Times of the pieces (N − 1,) after those (K,) were divided at ``shares``, s, (N − 1 + K,)."""
    rest = times.copy()
    rest[pieces] *= 1.0 - shares
    found: Array = np.insert(rest, pieces, shares * times[pieces])
    return found


def _corrected(
    path: PathRows, q: Array, at: Indices, box: tuple[Array, Array]
) -> tuple[Array, Mask]:
    """Rows (K, nv) corrected onto points of the path, inside a box (K, nv), and which of them are.

    What cannot be brought inside bands and constraints is corrected onto the path alone, as a start
    is; the check of the motion says so.
    """
    rows, inside = path.correct_inside(q, at)
    out = np.flatnonzero(~inside)
    rows[out], inside[out] = path.correct(q[out], at[out])
    left = np.flatnonzero(inside & (np.abs(np.clip(rows, *box) - rows) > _INSIDE).any(axis=1))
    within = (bound[left] for bound in box)
    rows[left], inside[left] = path.correct_within(rows[left], at[left], *within)
    return rows, inside

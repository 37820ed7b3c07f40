"""Insert rows between waypoints where the motion would leave the path."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array, Indices, instance, number
from qp_twist.control import Status
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.following.stretches import frame_at
from qp_twist.paths import PathTask, twist_task
from qp_twist.planning.starts import corrected_start
from qp_twist.referee import JointMotion, Known, path_errors

_ROUNDS = 12
_ROOM = 0.5
"""Share of the tolerances for linear pieces, which leaves a reserve for smooth ones."""
_HELD = 1e-5
"""By how much the rows beside may be too near where a row between them keeps its distance, m."""
_MORE = 0.25
"""A piece is refined only if its error exceeds that of its rows by this share."""


def refine_trajectory(
    trajectory: Trajectory, *, position_tolerance: float = 1e-4, axis_tolerance_deg: float = 0.05
) -> Trajectory:
    """Insert rows until linear interpolation of the joints keeps the path.

    A method meets the waypoints. Between two of them the joints are interpolated linearly, and the
    path error grows with their displacement, above all in the null space: with a large gain of the
    secondary by millimetres. Between such waypoints another is inserted, at half the displacement
    in position and orientation; the mean of the joint positions is corrected onto it by least-norm
    steps within the limits. This is repeated until every piece stays within half the tolerances,
    also for hard tolerance bands.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`.
        position_tolerance: Largest linear task error between rows, m.
        axis_tolerance_deg: Largest angular task error there, degrees.

    Returns:
        A trajectory whose ``path_task`` includes the inserted waypoints, each with its share of the
        time; the same trajectory if none was inserted. A piece is unchanged if its row cannot be
        corrected, or a waypoint was missed anyway.
    """
    instance("refine_trajectory(trajectory)", trajectory, Trajectory)
    position = number("position_tolerance", position_tolerance, above=0.0)
    axis = np.radians(number("axis_tolerance_deg", axis_tolerance_deg, above=0.0))
    met = (trajectory.position_error <= position) & (trajectory.axis_error <= axis)
    stuck = np.zeros(len(met), dtype=bool)  # rows after which nothing can be inserted
    known: Known | None = None
    for _ in range(_ROUNDS):
        task = trajectory.path_task
        if len(met) < 2:
            break
        motion = JointMotion(np.arange(len(met), dtype=np.float64), trajectory.q)
        within = _ROOM * position, _ROOM * axis
        errors = path_errors(task, motion, tolerances=within, known=known)
        strays = _strays(errors.position, errors.position_between, position)
        strays |= _strays(errors.axis, errors.axis_between, axis)
        for band, unit in enumerate(errors.band_units):
            tolerance = position if unit == "m" else axis
            at = errors.bands[:, band]
            # What is outside at its rows is not mended by further ones.
            inside = np.maximum(at[:-1], at[1:]) <= tolerance
            strays |= inside & _strays(at, errors.bands_between[:, band], tolerance)
        asked = np.flatnonzero(strays & met[:-1] & met[1:] & ~stuck[:-1])
        trajectory, pieces = with_rows_between(trajectory, asked, np.full(len(asked), 0.5))
        stuck[np.setdiff1d(asked, pieces)] = True
        if not len(pieces):
            break
        after = pieces + 1
        met, stuck = np.insert(met, after, True), np.insert(stuck, after, False)
        known = Known(errors, shared_pieces(np.arange(len(errors.rate)), pieces))
    return trajectory


def _strays(at: Array, between: Array, tolerance: float) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Pieces whose error is too large, and larger than that of their rows."""
    ends = np.maximum(at[:-1], at[1:])
    return between > np.maximum(_ROOM * tolerance, ends + _MORE * tolerance)


def with_rows_between(
    trajectory: Trajectory, pieces: Indices, shares: Array
) -> tuple[Trajectory, Indices]:
    """The trajectory and its task with another row in some pieces.

    Args:
        trajectory: Its rows k and k + 1 bound piece k.
        pieces: Pieces in ascending order, each at most once, (K,).
        shares: Where the row is in its piece, 0 at the begin and 1 at the end, (K,).

    Returns:
        The trajectory, and those of the pieces that have got a row: not all joint positions can be
        corrected onto the path.
    """
    task, rows, found = trajectory.path_task, [], []
    for index, (k, share) in enumerate(zip(pieces.tolist(), shares.tolist(), strict=True)):
        try:
            rows.append(_row_at(task, trajectory.q, k, share))
            found.append(index)
        except InvalidInput:
            continue
    if found:
        trajectory = _with_rows(trajectory, pieces[found].tolist(), shares[found].tolist(), rows)
    return trajectory, pieces[found]


def shared_pieces(which: Indices, pieces: Indices) -> Indices:
    """Numbers of the pieces after some were divided by a row: −1 for both parts, (N − 1 + K,).

    Args:
        which: Number of each piece before, (N − 1,).
        pieces: Pieces in ascending order, each at most once, (K,).
    """
    kept = which.copy()
    kept[pieces] = -1
    found: Indices = np.insert(kept, pieces, -1)
    return found


def divided_times(times: Array, pieces: Indices, shares: Array) -> Array:
    """Times of the pieces, (N − 1 + K,), after some were divided by a row.

    Args:
        times: Of the pieces before, s, (N − 1,).
        pieces: Pieces in ascending order, each at most once, (K,).
        shares: Where the row is in its piece, 0 at the begin and 1 at the end, (K,).
    """
    rest = times.copy()
    rest[pieces] *= 1.0 - shares
    found: Array = np.insert(rest, pieces, shares * times[pieces])
    return found


def _row_at(task: PathTask, q: Array, k: int, share: float) -> Array:
    """Joint positions between rows k and k + 1; on a path corrected onto the pose between them."""
    if k + 1 in task.joint_moves:
        row: Array = q[k] + share * (q[k + 1] - q[k])
        return row
    before, after = task.in_force[k : k + 2]
    rows = twist_task(task, after if after.rank <= before.rank else before)
    start = q[k] + share * (q[k + 1] - q[k])
    pose = _pose_at(task.waypoints, k, share)
    task = dataclasses.replace(task, start=start)
    if not all(constraint.inside(q[k : k + 2], _HELD).all() for constraint in task.clearances):
        task = task.without_clearance()  # steps could go on and on away from what touches
    return corrected_start(
        task,
        pose,
        holds_limits=True,
        task=rows,
    )


def _pose_at(waypoints: Sequence[mink.SE3], k: int, share: float) -> mink.SE3:
    before, after = waypoints[k : k + 2]
    turn = (after.rotation() @ before.rotation().inverse()).log()
    begin, end = before.translation(), after.translation()
    return mink.SE3.from_rotation_and_translation(
        (mink.SO3.exp(share * turn) @ before.rotation()).normalize(), begin + share * (end - begin)
    )


def _with_rows(
    trajectory: Trajectory, pieces: list[int], shares: list[float], rows: list[Array]
) -> Trajectory:
    """The trajectory and its task with a row in each of the pieces, in ascending order."""
    task = _with_waypoints(trajectory.path_task, pieces, shares, rows)
    after = np.array(pieces) + 1
    measured = [
        _measured(task, k + 1 + shift, q)
        for shift, (k, q) in enumerate(zip(pieces, rows, strict=True))
    ]
    changes: dict[str, Any] = {
        "path_task": task,
        "q": np.insert(trajectory.q, after, rows, axis=0),
        "scale": np.insert(trajectory.scale, after, 1.0),
        "iterations": np.insert(trajectory.iterations, after, 0),
        "durations": _split(trajectory.durations, pieces, shares),
    }
    for name, column in zip(
        ("position_error", "axis_error", "sigma_min", "band_excess"),
        np.transpose(measured),
        strict=True,
    ):
        changes[name] = np.insert(getattr(trajectory, name), after, column)
    binding, statuses = list(trajectory.binding), list(trajectory.statuses)
    for k in reversed(pieces):
        binding.insert(k + 1, ())
        statuses.insert(k + 1, Status.SOLVED)
    return dataclasses.replace(
        trajectory, binding=tuple(binding), statuses=tuple(statuses), **changes
    )


def _with_waypoints(
    task: PathTask, pieces: list[int], shares: list[float], rows: list[Array]
) -> PathTask:
    waypoints = list(task.waypoints)
    flipped = None if task.flipped_waypoints is None else list(task.flipped_waypoints)
    for k, share, q in zip(reversed(pieces), reversed(shares), reversed(rows), strict=True):
        via = frame_at(task, q) if k + 1 in task.joint_moves else None
        for poses in (waypoints, flipped):
            if poses is not None:
                poses.insert(k + 1, via or _pose_at(poses, k, share))
    segments = []
    for segment in task.segments:
        # A waypoint inserted where the projector changes has the fewer rows of the two.
        first, last = segment.first, segment.first + segment.blend
        fewer = task.in_force[first].rank <= task.in_force[first - 1].rank
        begin = sum(k + 1 < first or (k + 1 == first and not fewer) for k in pieces)
        inside = sum(first <= k + 1 < last for k in pieces)  # of a blend, whose rows are fewer
        segments.append(
            dataclasses.replace(segment, first=first + begin, blend=segment.blend + inside)
        )
    return dataclasses.replace(
        task,
        waypoints=tuple(waypoints),
        flipped_waypoints=None if flipped is None else tuple(flipped),
        durations=_split(task.durations, pieces, shares),
        segments=tuple(segments),
        joint_moves=_divided_moves(task.joint_moves, pieces),
        # As in resampling: a point between two has the line of the one before.
        lines=None
        if task.lines is None
        else np.insert(task.lines, np.array(pieces) + 1, task.lines[pieces]),
    )


def _divided_moves(joint_moves: tuple[int, ...], pieces: list[int]) -> tuple[int, ...]:
    """Joint moves after a row was inserted in each of the pieces."""
    found = []
    for k in joint_moves:
        shift = sum(piece < k for piece in pieces)
        found += [k + shift - 1, k + shift] if k - 1 in pieces else [k + shift]
    return tuple(found)


def _split(durations: Array | None, pieces: list[int], shares: list[float]) -> Array | None:
    """Durations with those of the divided pieces divided."""
    if durations is None:
        return None
    times = divided_times(durations[1:], np.array(pieces), np.array(shares))
    return np.concatenate([durations[:1], times])


def _measured(task: PathTask, index: int, q: Array) -> tuple[float, float, float, float]:
    """Position error, axis error, σ_min and band excess of a row, as :func:`follow` has them."""
    rows = twist_task(task, task.in_force[index])
    rows.set_target(task.waypoints[index])
    configuration = mink.Configuration(task.model, q)
    state = rows.state(configuration)
    sigma = np.linalg.svd(state.basis.T @ state.jacobian, compute_uv=False)
    return (
        float(np.linalg.norm(state.error[:3])),
        float(np.linalg.norm(state.error[3:])),
        float(sigma[-1]) if len(sigma) else 0.0,
        float(rows.band_excess(configuration).max(initial=0.0)) if rows.bands else 0.0,
    )

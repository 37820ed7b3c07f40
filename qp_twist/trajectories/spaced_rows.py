"""Rows that a controller interpolates: no two closer in time than its interpolation period."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.geometry import rotation_vector
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.paths import PathTask
from qp_twist.trajectories.timed_path import TimedPath

_SHARE = 0.2
"""Share of the tolerances by which the tool may be moved where a row is left out. Rows between
waypoints and rounded corners use half of them; digits that are cut off, a twentieth (six angles of
0.5e-4° at 1 m are 5 µm)."""
_BESIDE = 0.005
"""Share of a period from which on a point beside a row counts as one between rows."""
_ROUNDING = 1e-9
"""Rounding of times that are added and subtracted, s."""


class Spaced(NamedTuple):
    """Rows in the distance of a period, how many were left out, how many moves take longer.

    And the times of the planned motion at which the points are, s, and how many of these are no
    rows.
    """

    rows: TimedPath
    left_out: int
    longer: int
    at: Array
    moved: int


def until_whole(rows: TimedPath, tick: float) -> TimedPath:
    """The same motion, slower by so little that from rest to rest it takes whole ticks, s.

    A last move that alone ends later would not be the end of the planned ramp to rest.
    """
    assert rows.times is not None
    rates, changes, durations = rows.velocities, rows.accelerations, np.diff(rows.times)
    rests = np.isin(np.arange(len(rows.q)), [0, len(rows.q) - 1])
    if rates is not None:
        rests |= ~rates.any(axis=1)
    ends = np.flatnonzero(rests)
    seconds = np.diff(rows.times[ends])
    slower = tick * np.ceil((seconds - _ROUNDING) / tick) / seconds
    by = np.repeat(slower, np.diff(ends))
    of = np.append(by, 1.0)[:, None]  # at rests nothing changes
    return replace(
        rows, times=rows.times[0] + np.append(0.0, np.cumsum(by * durations)),
        velocities=None if rates is None else rates / of,
        accelerations=None if changes is None else changes / of**2,
    )  # fmt: skip


def spaced(
    rows: TimedPath,
    period: float,
    tick: float,
    path_task: PathTask | None,
    held: Mask | None = None,
) -> Spaced:
    """Points of the motion no closer to each other than a period, s, as straight joint moves.

    A row is left out if the tool passes within a fifth of the task's tolerances of where it was. A
    point is then less than a tick behind a row, whole ticks after the one before: where the planned
    motion is at the printed times, since times that are rounded change accelerations and jerks.
    Without a task all rows are points. A move that remains too short takes a period: slower, on the
    same path.

    Args:
        rows: With times.
        period: Of the controller, s.
        tick: What times of the program are multiples of, s.
        path_task: The task, whose tool and tolerances count.
        held: Rows that are not left out, (N,).
    """
    held = np.zeros(len(rows.q), dtype=bool) if held is None else held
    assert rows.times is not None
    at = rows.times
    if path_task is not None:
        at = _points(rows, period, tick, path_task, held)
    durations = np.diff(at)
    least = np.maximum(durations, period)
    longer = int((least > durations + _ROUNDING).sum())
    after = np.searchsorted(rows.times, at + _ROUNDING) - 1
    moved = int((at - rows.times[after] > _BESIDE * period).sum())
    if not longer and np.array_equal(at, rows.times):
        return Spaced(rows, 0, 0, at, 0)
    times = rows.times[0] + np.append(0.0, np.cumsum(least))
    found = replace(rows, q=rows.at(at).q, times=times, velocities=None, accelerations=None)
    return Spaced(found, len(rows.q) - len(at), longer, at, moved)


def _points(rows: TimedPath, period: float, tick: float, path_task: PathTask, held: Mask) -> Array:
    """The times of the points, from the first row on each as soon as a period after the last."""
    motion = rows.of_joints(JointRanges.of(path_task.model).names).motion
    times, tolerances = motion.times, path_task.tolerances
    chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
    rotations, origins = chain.poses(motion.q)

    def stays(begin: float, end: float) -> bool:
        """Whether the tool passes all rows between two points."""
        inner = (times > begin + _ROUNDING) & (times < end - _ROUNDING)
        if held[inner].any():
            return False
        q = motion.at(np.array([begin, end])).q
        ends = chain.poses(q)[1]
        way, passed = ends[1] - ends[0], origins[inner]
        share = (times[inner] - begin) / (end - begin)
        if np.linalg.norm(way) > tolerances.position:  # else it turns in place
            share = np.clip((passed - ends[0]) @ way / (way @ way), 0.0, 1.0)
        R, p = chain.poses(q[0] + share[:, None] * (q[1] - q[0]))
        turns = np.linalg.norm(rotation_vector(R @ rotations[inner].transpose(0, 2, 1)), axis=1)
        moved = np.linalg.norm(p - passed, axis=1)
        return bool(tolerances.met(moved / _SHARE, turns / _SHARE).all())

    at, last = [float(times[0])], len(times) - 1
    row = 0
    while row < last:
        begin, row = at[-1], row + 1
        while row < last and times[row] - begin < period - _ROUNDING:
            if not stays(begin, times[row + 1]):
                break
            row += 1
        end = float(times[row])
        whole = begin + tick * np.ceil((end - begin - _ROUNDING) / tick)
        if end < whole - _ROUNDING < times[last] - 2.0 * _ROUNDING and stays(begin, whole):
            end, row = whole, int(np.searchsorted(times, whole + _ROUNDING)) - 1
        if len(at) > 1 and end - begin < period - _ROUNDING and stays(at[-2], end):
            del at[-1]  # a move that cannot lead farther begins earlier
        at.append(end)
    return np.array(at)

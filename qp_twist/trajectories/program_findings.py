"""What a check finds of programs alone: rounded points, stops, and accelerations they state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.referee import (
    EXCEEDED,
    Finding,
    JointMotion,
    MotionLimits,
    Passing,
    Tolerances,
    acceleration_use,
    errors_at,
    velocity_use,
    with_default_accelerations,
)
from qp_twist.trajectories.corners import RoundedPoints, task_rows
from qp_twist.trajectories.timed_path import TimedPath

if TYPE_CHECKING:
    from qp_twist.trajectories.check import Check

_BESIDE = np.linspace(-1.0, 1.0, 9)
"""Shares of the distance from which on a point is rounded, before it and behind."""
_ROOM = 0.02
"""Share of the tolerances that is left to digits where less is rounded."""


def of_rounding(
    rows: TimedPath, path_task: PathTask, motion: JointMotion, passing: Passing,
    tolerances: Tolerances,
) -> list[Finding]:  # fmt: skip
    """The largest errors where a program's zones and blends let the tool leave its moves.

    The tool is then as far from its path as from its moves, and these from the path. At a share ξ
    of the distance from which on it is rounded, the tool is off its moves by at most 1 − ξ of what
    it is at the corner: an arc that begins there leaves them by less, as the square. Beside the
    path, where only constraints hold, points count if there are any: the motion that they are asked
    about is that through the points.
    """
    if rows.corners is None:
        return []
    found, moved, beside = _rounded(rows, path_task, motion, passing)
    findings = []
    for k, (what, limit, scale, unit) in enumerate(
        (("position", tolerances.position, 1e3, "mm"),
         ("axis", tolerances.axis, float(np.degrees(1.0)), "°"))
    ):  # fmt: skip
        if len(found.rows):
            values = (moved[..., k] + beside[..., k]).max(axis=1)
            worst = int(np.argmax(values))
            zone, value = found.zones[worst], float(values[worst])
            place = passing.place(float(motion.times[found.rows[worst]]))
            where = f"the move of line {zone.line}, {zone.mark}, {place}"
            findings.append(
                Finding(f"{what} where points are rounded", scale * value, scale * limit, unit,
                        where, value <= limit)
            )  # fmt: skip
    return findings


def kept_rounding(rows: TimedPath, path_task: PathTask, check: Check) -> Array:
    """Shares (P,) of what a checked program rounds its points, that its moves leave room for."""
    points = _points(rows)
    shares = np.ones(len(points))
    if rows.corners is None:
        return shares
    found, moved, beside = _rounded(rows, path_task, check.motion, check.passing)
    most = np.array([check.tolerances.position, check.tolerances.axis])
    room = np.maximum((1.0 - _ROOM) * most - beside, 0.0)
    # Where nothing is moved, the error is that of the moves alone.
    of_all = np.divide(room, moved, out=np.ones_like(moved), where=moved > 0.0)
    shares[np.searchsorted(points, found.rows)] = np.minimum(of_all.min(axis=(1, 2)), 1.0)
    return shares


def beyond_limits(rows: TimedPath, check: Check) -> list[int]:
    """The moves of a checked program, from 0, on which joints exceed their limits."""
    if rows.times is None or not rows.own_ramps:
        return []
    motion, limits = check.motion, check.limits
    fast, changed = (
        (use > 1.0 + EXCEEDED).max(axis=1)
        for use in (
            velocity_use(motion, limits.velocity)[1],
            acceleration_use(motion, limits.acceleration)[1],
        )
    )
    fast[:-1] |= changed  # of the pieces before a row and behind it
    fast[1:] |= changed
    moves = np.searchsorted(_points(rows), np.flatnonzero(fast), "right") - 1
    return sorted(set(moves.tolist()))


def _points(rows: TimedPath) -> Indices:
    """Which rows are points of the program, (P,)."""
    return np.arange(len(rows.q)) if rows.points is None else rows.points


def _rounded(
    rows: TimedPath, path_task: PathTask, motion: JointMotion, passing: Passing
) -> tuple[RoundedPoints, Array, Array]:
    """The points that count; how far the tool is off its moves beside them, and these off the path.

    Each of positions and axes, (K, 9, 2).
    """
    assert rows.corners is not None
    points = _points(rows)
    found = rows.corners.rounded(rows.zones, points, task_rows(path_task))
    times, at = motion.times[found.rows], passing.times
    counts = (times >= at[0]) & (times <= at[-1])
    for k in np.flatnonzero(in_joint_moves(path_task, len(at))).tolist():
        counts &= (times <= at[k]) | (times >= at[k + 1])
    counts |= bool(path_task.stated_constraints)
    found = found.only(counts)
    moved = np.stack([found.position, found.axis], axis=1)[:, None]
    moved = moved * (1.0 - np.abs(_BESIDE))[:, None]
    return found, moved, _beside_corners(path_task, motion, passing, points, found)


def _beside_corners(
    path_task: PathTask, motion: JointMotion, passing: Passing, points: Indices,
    found: RoundedPoints,
) -> Array:  # fmt: skip
    """Task errors of the moves beside rounded points, position and axis, (K, 9, 2)."""
    if not len(found.rows):
        return np.zeros((0, len(_BESIDE), 2))
    times, places = motion.times[found.rows], np.searchsorted(points, found.rows)
    sides = [np.abs(motion.times[points[places + k]] - times) for k in (-1, 1)]
    spans = 0.5 * found.reach[:, None] * np.where(_BESIDE < 0.0, *(x[:, None] for x in sides))
    at = np.clip(times[:, None] + _BESIDE * spans, *passing.times[[0, -1]]).ravel()
    piece, row = (
        np.clip(np.searchsorted(of, at, "right") - 1, 0, len(of) - 2)
        for of in (passing.times, motion.times)
    )
    s = np.arange(len(passing.times), dtype=np.float64)
    errors, _ = errors_at(path_task, motion, passing.times, s, piece, at, row)
    return errors[:, :2].reshape(*spans.shape, 2)


def of_rests(rows: TimedPath, limits: MotionLimits, ranges: JointRanges) -> list[Finding]:
    """The largest of the accelerations without which no robot keeps a program's times at rests."""
    if rows.at_rests is None or not (
        rows.at_rests.any() and np.isfinite(limits.acceleration).any()
    ):
        return []
    assert rows.times is not None
    used = 100.0 * rows.at_rests / limits.acceleration
    k, joint = np.unravel_index(int(np.argmax(used)), used.shape)
    ends = rows.times[_points(rows)[k - 1 : k + 1]]
    passes = bool(used.max() <= 100.0 * (1.0 + EXCEEDED))
    why = "" if passes else ": it takes longer than that, or exceeds its limit"
    where = f"{ranges.names[int(joint)]}, line {rows.lines[k]}, {ends[1] - ends[0]:.4g} s{why}"
    return [
        Finding("accelerations at stops, at least", float(used.max()), 100.0, "%", where, passes)
    ]


def of_stated_ramps(
    rows: TimedPath, limits: MotionLimits, ranges: JointRanges, passing: Passing
) -> tuple[list[Finding], list[str]]:
    """The largest of the accelerations that a program states, and the source of their limits."""
    if rows.ramps is None:
        return [], []
    whole = with_default_accelerations(limits, ranges)
    used = 100.0 * rows.ramps / whole.acceleration
    k, joint = np.unravel_index(int(np.argmax(used)), used.shape)
    time = float(rows.motion.times[_points(rows)[k]])
    where = f"{ranges.names[int(joint)]}, move to {passing.place(time)}"
    passes = bool(used.max() <= 100.0 * (1.0 + EXCEEDED))
    source = [] if whole is limits else [
        f"accelerations that the program states (a) checked against {whole.accelerations_of}"
    ]  # fmt: skip
    found = Finding("accelerations stated (a)", float(used.max()), 100.0, "%", where, passes)
    return [found], source

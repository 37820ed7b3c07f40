"""What a check finds of programs alone: rounded points, and accelerations that they state."""

from __future__ import annotations

import numpy as np

from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.referee import (
    EXCEEDED,
    Finding,
    JointMotion,
    MotionLimits,
    Passing,
    Tolerances,
    with_default_accelerations,
)
from qp_twist.trajectories.corners import task_rows
from qp_twist.trajectories.timed_path import TimedPath


def of_rounding(
    rows: TimedPath, path_task: PathTask, motion: JointMotion, passing: Passing,
    tolerances: Tolerances,
) -> list[Finding]:  # fmt: skip
    """The largest errors where a program's zones and blends let the tool leave its moves.

    It is that of the corner alone, beside the errors of the moves. Beside the
    path, where only constraints hold, points count if there are any: the motion that they are asked
    about is that through the points.
    """
    if rows.corners is None:
        return []
    points = np.arange(len(rows.q)) if rows.points is None else rows.points
    found = rows.corners.rounded(rows.zones, points, task_rows(path_task))
    times, at = motion.times[found.rows], passing.times
    counts = (times >= at[0]) & (times <= at[-1])
    for k in np.flatnonzero(in_joint_moves(path_task, len(at))).tolist():
        counts &= (times <= at[k]) | (times >= at[k + 1])
    counts |= bool(path_task.stated_constraints)
    findings = []
    for what, values, limit, scale, unit in (
        ("position", found.position, tolerances.position, 1e3, "mm"),
        ("axis", found.axis, tolerances.axis, np.degrees(1.0), "°"),
    ):
        if counts.any():
            worst = int(np.argmax(np.where(counts, values, -1.0)))
            zone, value = found.zones[worst], float(values[worst])
            place = passing.place(float(times[worst]))
            where = f"the move of line {zone.line}, {zone.mark}, {place}"
            findings.append(
                Finding(f"{what} where points are rounded", scale * value, scale * limit, unit,
                        where, value <= limit)
            )  # fmt: skip
    return findings


def of_stated_ramps(
    rows: TimedPath, limits: MotionLimits, ranges: JointRanges, passing: Passing
) -> tuple[list[Finding], list[str]]:
    """The largest of the accelerations that a program states, and the source of their limits."""
    if rows.ramps is None:
        return [], []
    whole = with_default_accelerations(limits, ranges)
    used, points = 100.0 * rows.ramps / whole.acceleration, rows.points
    k, joint = np.unravel_index(int(np.argmax(used)), used.shape)
    row = int(k) if points is None else int(points[k])
    where = f"{ranges.names[int(joint)]}, move to {passing.place(float(rows.motion.times[row]))}"
    passes = bool(used.max() <= 100.0 * (1.0 + EXCEEDED))
    source = [] if whole is limits else [
        f"accelerations that the program states (a) checked against {whole.accelerations_of}"
    ]  # fmt: skip
    found = Finding("accelerations stated (a)", float(used.max()), 100.0, "%", where, passes)
    return [found], source

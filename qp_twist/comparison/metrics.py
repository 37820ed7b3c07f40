"""The numbers of ``comparison.json``: one definition each, from a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from qp_twist.checks import Mask
from qp_twist.control import Status
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, Tolerances

OUTSIDE = 1e-9
"""Violation from which a joint counts as outside its limits, rad or m."""
RECONFIGURATION_DEG = 15.0
"""A step larger than this in any joint is a reconfiguration, degrees."""
EXCESSES = ("band_excess_max", "constraint_excess_max")
"""Metrics of tasks with bands or constraints, 0 where none is left."""


def metrics(trajectory: Trajectory) -> dict[str, Any]:
    """All metrics of a trajectory, ready for JSON; the page *Reports and metrics* defines each.

    Waypoints are those of the task, counted from 1, as in the paper; 3.5 is half way from the
    third to the fourth, where a trajectory has rows between them. Errors and ``status`` are about
    the rows; for the motion between them see :attr:`~qp_twist.Trajectory.between` and
    :func:`~qp_twist.check_trajectory`, whose tolerances are the same. Distances are also those
    between rows, where joints go straight. Times compare methods only where the same share of
    the waypoints was :func:`compiled <compiled_share>`.
    """
    ranges = JointRanges.of(trajectory.path_task.model)
    q = ranges.positions(trajectory.q)
    outside = (q < ranges.lower - OUTSIDE) | (q > ranges.upper + OUTSIDE)
    steps_deg = np.degrees(np.abs(np.diff(q[:, ranges.hinge], axis=0)))
    margins = ranges.margins(trajectory.q)
    min_margin = float(margins.min(initial=np.inf))
    numbers: dict[str, Any] = {
        "violations": int(outside.sum()),
        "first_violation": {
            name: waypoint_of(trajectory, int(np.argmax(outside[:, joint])))
            for joint, name in enumerate(ranges.names)
            if outside[:, joint].any()
        },
        # JSON has no infinity: null where no joint has limits.
        "min_margin": min_margin if np.isfinite(min_margin) else None,
        "mean_z": float(trajectory.z.mean()),
        "max_z": float(trajectory.z.max()),
        "position_error_max_m": float(trajectory.position_error.max()),
        "axis_error_max_rad": float(trajectory.axis_error.max()),
        "travel_deg": float(steps_deg.sum()),
        "max_step_deg": float(steps_deg.max(initial=0.0)),
        "reconfigurations": [
            waypoint_of(trajectory, i + 1)
            for i in np.flatnonzero((steps_deg > RECONFIGURATION_DEG).any(axis=1)).tolist()
        ],
        "closure_rad": float(np.linalg.norm(q[-1] - q[0])),
        "sigma_min": float(trajectory.sigma_min.min()),
        "time_per_waypoint_us": 1e6 * trajectory.seconds / max(1, len(q) - 1),
    }
    if trajectory.path_task.bands:
        numbers["band_excess_max"] = float(trajectory.band_excess.max())
    if trajectory.path_task.stated_constraints:
        numbers["constraint_excess_max"] = float(trajectory.constraint_excess.max())
    near = trajectory.nearest
    if near is not None:
        numbers["min_clearance_m"] = near[1].distance
        numbers["asked_clearance_m"] = near[0].distance
    parts = [*faults(trajectory, numbers), *_remarks(trajectory)]
    numbers["status"] = "; ".join(parts) or "ok"
    return numbers


def waypoint_of(trajectory: Trajectory, row: float) -> float:
    """The waypoint of the task, counted from 1, at a row, counted from 0; whole at waypoints.

    Between two rows, and at rows between two waypoints, three decimals of the way are kept.
    """
    at = float(np.interp(row, np.arange(len(trajectory.s)), trajectory.s)) + 1.0
    return int(at) if at.is_integer() else round(at, 3)


def status_of_rows(trajectory: Trajectory) -> str:
    """``status`` without what lies between the rows; empty if there is nothing to say.

    The rows of a trajectory are also those of the motion that is timed and written. Between them
    that motion has further rows, and curves where here joints go straight: only a check says what
    it keeps there.
    """
    return "; ".join([*_at_rows(trajectory, metrics(trajectory)), *_remarks(trajectory)])


def too_near(numbers: Mapping[str, Any], tolerances: Tolerances) -> bool:
    """Whether a pair was nearer than asked, at a waypoint or between two."""
    near, asked = numbers.get("min_clearance_m"), numbers.get("asked_clearance_m", 0.0)
    return near is not None and not tolerances.keeps_clear(near, asked)


def tolerances_of(content: Mapping[str, Any]) -> Tolerances:
    """The tolerances of a ``comparison.json``."""
    return Tolerances(**content.get("tolerances", {}))


def compiled_share(trajectory: Trajectory) -> float:
    """Share of the waypoints after the start computed by compiled code, 0 to 1."""
    return min(1.0, trajectory.compiled / max(1, len(trajectory.q) - 1))


def faults(trajectory: Trajectory, numbers: Mapping[str, Any]) -> list[str]:
    """What a run did not keep, and where, from its verdict and metrics; empty if it kept all."""
    parts, near = _at_rows(trajectory, numbers), trajectory.nearest
    if near is not None and too_near(numbers, trajectory.path_task.tolerances):
        distance, row, pair = near[1]
        how = f"touches by {-1e3 * distance:.3g} mm" if distance < 0.0 else "comes too near"
        how += "" if distance < 0.0 else f", {1e3 * distance:.3g} mm"
        parts.append(f"{how}: {pair}, waypoint {waypoint_of(trajectory, row):g}")
    return parts


def _at_rows(trajectory: Trajectory, numbers: Mapping[str, Any]) -> list[str]:
    """What it did not keep at its rows, and where it ended."""
    parts, verdict = [], trajectory.verdict
    tolerances = trajectory.path_task.tolerances
    if trajectory.diverged_at is not None:
        parts.append(f"diverged at waypoint {trajectory.diverged_at}")
    if not trajectory.ended:
        parts.append(trajectory.ending)
    elif trajectory.failure:
        parts.append(trajectory.failure)
    if verdict.outside.any():
        names = ", ".join(f"{joint} at {i:g}" for joint, i in numbers["first_violation"].items())
        parts.append(f"leaves the limits: {names}")
    for what, left in (("a band", verdict.band), ("a constraint", verdict.constraint)):
        if left.any():
            ignored = ""
            if what == "a constraint" and left.all() and too_near(numbers, tolerances):
                ignored = " (a pair that may touch belongs into ignore of [clearance])"
            parts.append(f"outside {what} at {_places(trajectory, left)}{ignored}")
    off = verdict.off
    if off.any():
        one_step = not METHODS[trajectory.method].constrained and not (trajectory.scale < 1.0).any()
        why = " (one step a waypoint)" if one_step and trajectory.iterations.max() <= 1 else ""
        most = [
            f"{scale * error.max():.4g}{unit} at {waypoint_of(trajectory, int(np.argmax(error))):g}"
            for error, tolerance, scale, unit in (
                (trajectory.position_error, tolerances.position, 1e3, " mm"),
                (trajectory.axis_error, tolerances.axis, 180.0 / np.pi, "°"),
            )
            if not error.max() <= tolerance
        ]
        parts.append(
            f"off the path at {_places(trajectory, off, why)}, by up to {' and '.join(most)}"
        )
    return parts


def _remarks(trajectory: Trajectory) -> list[str]:
    """Where the task was slowed down, and by what, and where steps are not exact."""
    parts, scaled = [], trajectory.scale < 1.0
    if scaled.any():
        names = ", ".join(dict.fromkeys(n for names in trajectory.binding for n in names))
        held = f"held by {names}" if names else "held by no limit that was named"
        parts.append(f"scaled at {_places(trajectory, scaled)}, {held}")
    for status in (Status.DEGRADED, Status.RELAXED):
        at = np.array([s is status for s in trajectory.statuses])
        if at.any():
            parts.append(f"{status.name.lower()} at {_places(trajectory, at)}")
    return parts


def _places(trajectory: Trajectory, which: Mask, why: str = "") -> str:
    """At how many rows, and which is the first; they are waypoints if none lies between two."""
    count, first = int(which.sum()), waypoint_of(trajectory, int(np.argmax(which)))
    if trajectory.at_waypoints[which].all():
        return f"{count} waypoint{'' if count == 1 else 's'}{why}, first at {first:g}"
    return f"{count} row{'' if count == 1 else 's'}{why}, first at waypoint {first:g}"

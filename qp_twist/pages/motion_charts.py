"""Small charts over time of what a motion has to keep, each with its limit and its number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import Clearance
from qp_twist.drawing.charts import Curve, small_chart
from qp_twist.drawing.palette import BLUE, FAINT, ORANGE
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.referee import (
    DIP,
    OFF,
    Finding,
    JointMotion,
    ToolSpeed,
    acceleration_use,
    jerk_use,
    joint_margins,
    velocity_use,
)
from qp_twist.trajectories import Check

_MAIN, _OTHER = {"color": BLUE, "linewidth": 1.6}, {"color": FAINT, "linewidth": 0.7}
"""Styles of the curve that counts, and of those of single joints."""
_ASKED = {"color": ORANGE, "linewidth": 1.2, "linestyle": (0, (4, 2))}
_SLOWEST = 1e-3
"""Of the speeds at the top of a chart, mm/s."""
_FINE, _MOST = 0.01, 200
"""Travel of a joint between two points at which distances are computed, rad or m, and the largest
number of points between two rows."""


class MotionChart(NamedTuple):
    """One chart of the page: a number in a unit, what it is of, its limit in words, its place."""

    key: str
    title: str
    value: float
    unit: str
    of: str
    limit: str
    note: str
    passes: bool
    svg: str


def motion_charts(path_task: PathTask, check: Check) -> list[MotionChart]:
    """The charts of a motion, in the order of the page."""
    by_name = {finding.name: finding for finding in check.findings}
    found = list(_errors(path_task, check, by_name))
    if check.speed is not None:
        found.append(_tool_speed(check, check.speed, by_name.get(DIP)))
    for name, title, limits, use in (
        ("velocity", "Joint speeds", check.limits.velocity, velocity_use),
        ("acceleration", "Joint accelerations", check.limits.acceleration, acceleration_use),
        ("jerk", "Joint jerks", check.limits.jerk, jerk_use),
    ):
        if (finding := by_name.get(f"{name} limits")) is not None:
            times, shares = use(check.motion, limits)
            curves = _of_joints(times, 100.0 * shares, 100.0 * shares.max(axis=1))
            top = 1.2 * max(100.0, float(curves[-1].y.max()))
            svg = _svg(check, title, curves, "% of limit", 100.0, (0.0, top))
            note = f"Largest: {finding.where}. Thin lines: each joint."
            found.append(_of_finding(finding, title, "of the limit", note, finding.passes, svg))
    if (finding := by_name.get("smallest joint margin")) is not None:
        title, ranges = "Distance to the joint limits", JointRanges.of(path_task.model)
        times, margins = joint_margins(ranges, check.motion)
        order = np.argsort(times, kind="stable")
        margins = margins[order][:, ranges.limited]
        curves = _of_joints(times[order], margins, margins.min(axis=1))
        view = (min(1.05 * float(margins.min()) - 0.05, -0.08), 1.0)
        svg = _svg(check, title, curves, "of half range", 0.0, view)
        note = f"Least: {finding.where}. 1 is the middle of a joint's range, 0 its limit."
        found.append(_of_finding(finding, title, "of half the range", note, finding.passes, svg))
    clearances = enumerate(path_task.clearances, start=1)
    return [*found, *(_clearance(check, clearance, k) for k, clearance in clearances)]


def off_the_path(check: Check) -> list[tuple[float, float]]:
    """Begin and end, s, of the motion before the first waypoint, and after the last."""
    ends = np.column_stack([check.motion.times[[0, -1]], check.passing.times[[0, -1]]])
    return [(float(low), float(high)) for low, high in np.sort(ends, axis=1) if high > low]


def _errors(
    path_task: PathTask, check: Check, by_name: dict[str, Finding]
) -> Iterator[MotionChart]:
    errors, tolerances, degrees = check.errors, check.tolerances, float(np.degrees(1.0))
    for name, title, kind, scale, limit in (
        ("position error", "Position error", "position", 1e3, 1e3 * tolerances.position),
        ("axis error", "Orientation error", "axis", degrees, degrees * tolerances.axis),
    ):
        if kind == "axis" and not any(t.angular.rank > 0 for t in path_task.projectors):
            continue
        findings = [by_name[key] for key in (name, f"{name} between", name + OFF) if key in by_name]
        worst = max(findings, key=lambda finding: (not finding.passes, finding.value))
        of = getattr(errors, kind)
        times, values = check.passing.times, scale * of.at
        for beside in (values[:-1], values[1:]):  # with what is between it and its neighbours
            np.maximum(beside, scale * of.between, out=beside)
        for part in check.astray:
            if part.moves:  # its own errors in place of those at the waypoints
                kept = (times < part.times[0]) | (times > part.times[-1])
                times = np.concatenate([times[kept], part.times])
                values = np.concatenate([values[kept], scale * getattr(part, kind)])
                order = np.argsort(times, kind="stable")
                times, values = times[order], values[order]
        view = (0.0, 1.2 * max(limit, float(values.max())))
        svg = _svg(check, title, [Curve(times, values, _MAIN)], worst.unit, limit, view)
        words = f"of {limit:.4g} {worst.unit} allowed".replace(" °", "°")
        passes = all(finding.passes for finding in findings)
        yield _of_finding(worst, title, words, f"Largest at {worst.where}.", passes, svg)


def _tool_speed(check: Check, speed: ToolSpeed, finding: Finding | None) -> MotionChart:
    """The tool's speed over time, and over it the programmed one; nothing in joint moves."""
    apart = np.flatnonzero(np.diff(speed.times) > speed.spans[:-1] + speed.spans[1:]) + 1
    times, programmed, found = (
        np.insert(of, apart, np.nan)
        for of in (speed.times, 1e3 * speed.programmed, 1e3 * speed.speed)
    )
    top = 1.2 * max(float(np.nanmax(programmed)), float(np.nanmax(found)), _SLOWEST)
    title = "Speed of the tool"
    curves = [Curve(times, programmed, _ASKED), Curve(times, found, _MAIN)]
    svg = _svg(check, title, curves, "mm/s", None, (0.0, top), key="tool-speed-curve")
    deepest = min(speed.dips, key=lambda dip: dip.share, default=None)
    note = "No dip between the ramps." if deepest is None else f"Deepest dip: {deepest}."
    passes = finding is None or finding.passes
    return MotionChart(
        "tool-speed", title, 100.0 * speed.at_speed, "%", "share at speed",
        "of the path at the programmed speed", f"{note} Dashed: as programmed.", passes, svg,
    )  # fmt: skip


def _of_finding(
    finding: Finding, title: str, limit: str, note: str, passes: bool, svg: str
) -> MotionChart:
    key = title.lower().replace(" ", "-")
    return MotionChart(
        key, title, finding.value, finding.unit, finding.name, limit, note, passes, svg
    )


def _clearance(check: Check, clearance: Clearance, number: int) -> MotionChart:
    title, asked, tolerances = "Distance from obstacles", clearance.distance, check.tolerances
    times = _fine_times(check.motion)
    q = check.motion.at(times).q
    distances, _ = clearance.closest(q)
    # Where joints go straight from point to point this is the least of all, to 10 µm.
    near = clearance.nearest(q)
    assert near is not None
    at = float(np.interp(near.at, np.arange(len(times)), times))
    later = int(np.searchsorted(times, at))
    times, distances = np.insert(times, later, at), np.insert(distances, later, near.distance)
    findings = [f for f in check.findings if f.name.startswith(f"outside {clearance.kind}")]
    passes = tolerances.keeps_clear(near.distance, asked) and all(f.passes for f in findings)
    words = f"at least {1e3 * asked:.4g} mm required" if asked else "they must not touch"
    if passes and near.distance < asked:
        words += f", to {1e3 * tolerances.position:.4g} mm"
    low, high = 1e3 * float(distances.min()), 1e3 * float(distances.max())
    top = max(1.1 * high, 2e3 * asked, 1.0)
    view = (min(low - 0.05 * (top - low), 0.0), top)
    curves, key = [Curve(times, 1e3 * distances, _MAIN)], f"clearance-{number}"
    svg = _svg(check, title, curves, "mm", 1e3 * asked, view, key=key)
    note = f"Least: {near.pair}, {check.passing.place(at)}."
    value = 1e3 * near.distance
    return MotionChart(key, title, value, "mm", "clearance", words, note, passes, svg)


def _fine_times(motion: JointMotion) -> Array:
    """Times of the rows, and of points between them where the joints move far, s."""
    spans = np.diff(motion.times)
    travel = (motion.largest_speeds() * spans[:, None]).max(axis=1)
    parts = np.clip(np.ceil(travel / _FINE), 2, _MOST).astype(int)
    rows = np.arange(len(motion.times))
    inner = [row + np.arange(count) / count for row, count in enumerate(parts)]
    return np.asarray(np.interp(np.append(np.concatenate(inner), rows[-1]), rows, motion.times))


def _of_joints(times: Array, each: Array, worst: Array) -> list[Curve]:
    """A faint curve of each joint (K, M), and over them the one that counts, (K,)."""
    return [*(Curve(times, y, _OTHER) for y in each.T), Curve(times, worst, _MAIN)]


def _svg(
    check: Check, title: str, curves: Sequence[Curve], unit: str, limit: float | None,
    view: tuple[float, float], key: str = "",
) -> str:  # fmt: skip
    """One small chart; ``view`` are the ends of its vertical axis."""
    shaded = [tuple(_abscissa(check, np.array(ends)).tolist()) for ends in off_the_path(check)]
    over = [curve._replace(x=_abscissa(check, curve.x)) for curve in curves]
    x_range = _abscissa(check, check.motion.times[[0, -1]])
    return small_chart(
        over, unit, "s" if check.passing.timed else "waypoint", *view,
        key=key or title.rsplit(maxsplit=1)[-1], description=f"{title} along the path.",
        x_range=(float(x_range[0]), float(x_range[1])), limit=limit, shaded=shaded,
    )  # fmt: skip


def _abscissa(check: Check, times: Array) -> Array:
    """Times from the first row on, s; without times in the file, the waypoints at them."""
    if check.passing.timed:
        return np.asarray(times - check.motion.times[0])
    count = np.arange(1, len(check.passing.times) + 1)
    return np.asarray(np.interp(times, check.passing.times, count))

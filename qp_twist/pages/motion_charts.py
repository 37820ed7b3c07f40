"""Small charts over time of what a motion has to keep, each with its limit and its number."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import Clearance
from qp_twist.drawing.charts import Curve, small_chart
from qp_twist.drawing.palette import BLUE, FAINT
from qp_twist.kinematics import JointRanges
from qp_twist.pages.motion_facts import data, data_of, with_space
from qp_twist.paths import PathTask
from qp_twist.referee import (
    OFF,
    Finding,
    JointMotion,
    acceleration_use,
    joint_margins,
    velocity_use,
)
from qp_twist.trajectories import Check

_MAIN, _OTHER = {"color": BLUE, "linewidth": 1.6}, {"color": FAINT, "linewidth": 0.7}
"""Styles of the curve that counts, and of those of single joints."""
_FINE, _MOST = 0.01, 200
"""Travel of a joint between two points at which distances are computed, rad or m, and the largest
number of points between two rows."""


class MotionChart(NamedTuple):
    """One chart of the page."""

    key: str
    title: str
    number: str
    """The number that counts, HTML."""
    note: str
    """Where it is, and what it means, HTML."""
    svg: str
    passes: bool


def motion_charts(path_task: PathTask, check: Check) -> list[MotionChart]:
    """The charts of a motion, in the order of the page."""
    by_name = {finding.name: finding for finding in check.findings}
    found = [*_error_charts(path_task, check, by_name), *_speed_charts(check, by_name)]
    margin = by_name.get("smallest joint margin")
    if margin is not None:
        found.append(_margin_chart(path_task, check, margin))
    found += [
        _clearance_chart(path_task, check, clearance, number)
        for number, clearance in enumerate(path_task.clearances, start=1)
    ]
    return found


def _error_charts(
    path_task: PathTask, check: Check, by_name: dict[str, Finding]
) -> list[MotionChart]:
    errors, degrees = check.errors, float(np.degrees(1.0))
    found = []
    for name, title, at, between, scale, limit in (
        ("position error", "Position error", errors.position, errors.position_between, 1e3,
         1e3 * check.tolerances.position),
        ("axis error", "Orientation error", errors.axis, errors.axis_between, degrees,
         degrees * check.tolerances.axis),
    ):  # fmt: skip
        if name == "axis error" and not any(t.angular.rank > 0 for t in path_task.projectors):
            continue
        pair = [by_name[key] for key in (name, f"{name} between", name + OFF) if key in by_name]
        worst = max(pair, key=lambda finding: (not finding.passes, finding.value))
        times, values = check.passing.times, scale * at
        for beside in (values[:-1], values[1:]):  # with what is between it and its neighbours
            np.maximum(beside, scale * between, out=beside)
        for part in filter(lambda part: part.moves, check.astray):
            off = scale * (part.position if name == "position error" else part.axis)
            times, values = _replaced(times, values, part.times, off)
        curves = [Curve(times, values, _MAIN)]
        top = 1.2 * max(limit, float(values.max()))
        found.append(
            MotionChart(
                name.replace(" ", "-"),
                title,
                f"{data_of(worst)} <small>of {limit:.4g}{with_space(worst.unit)} allowed</small>",
                f"Largest at {escape(worst.where)}.",
                _svg(check, title, curves, worst.unit, limit, 0.0, top),
                all(finding.passes for finding in pair),
            )
        )
    return found


def _speed_charts(check: Check, by_name: dict[str, Finding]) -> list[MotionChart]:
    found = []
    for name, title, limits, use in (
        ("velocity limits", "Joint speeds", check.limits.velocity, velocity_use),
        ("acceleration limits", "Joint accelerations", check.limits.acceleration,
         acceleration_use),
    ):  # fmt: skip
        finding = by_name.get(name)
        if finding is None:
            continue
        times, shares = use(check.motion, limits)
        curves = _of_joints(times, 100.0 * shares, 100.0 * shares.max(axis=1))
        top = 1.2 * max(100.0, float(curves[-1].y.max()))
        found.append(
            MotionChart(
                name.replace(" ", "-"),
                title,
                f"{data_of(finding)} <small>of the limit</small>",
                f"Largest: {escape(finding.where)}. Thin lines: each joint.",
                _svg(check, title, curves, "% of limit", 100.0, 0.0, top),
                finding.passes,
            )
        )
    return found


def _margin_chart(path_task: PathTask, check: Check, finding: Finding) -> MotionChart:
    ranges, title = JointRanges.of(path_task.model), "Distance to the joint limits"
    times, margins = joint_margins(ranges, check.motion)
    order = np.argsort(times, kind="stable")
    margins = margins[order][:, ranges.limited]
    curves = _of_joints(times[order], margins, margins.min(axis=1))
    low = float(curves[-1].y.min())
    return MotionChart(
        "margin",
        title,
        f"{data_of(finding)} <small>of half the range</small>",
        f"Least: {escape(finding.where)}. 1 is the middle of a joint's range, 0 its limit.",
        _svg(check, title, curves, "of half range", 0.0, min(1.05 * low - 0.05, -0.08), 1.0),
        finding.passes,
    )


def _clearance_chart(
    path_task: PathTask, check: Check, clearance: Clearance, number: int
) -> MotionChart:
    title, asked = "Distance from obstacles", clearance.distance
    times = _fine_times(check.motion)
    q = check.motion.at(times).q
    distances, _ = clearance.closest(q)
    # Where joints go straight from point to point this is the least of all, to 10 µm.
    near = clearance.nearest(q)
    assert near is not None
    at = float(np.interp(near.at, np.arange(len(times)), times))
    later = int(np.searchsorted(times, at))
    times, distances = np.insert(times, later, at), np.insert(distances, later, near.distance)
    where = f"{escape(near.pair)}, {escape(check.passing.place(at))}"
    findings = [f for f in check.findings if f.name.startswith(f"outside {clearance.kind}")]
    tolerance = check.tolerances.position
    passes = all(finding.passes for finding in findings) and check.tolerances.keeps_clear(
        near.distance, asked
    )
    words = f"at least {1e3 * asked:.4g} mm required" if asked else "they must not touch"
    if passes and near.distance < asked:
        words += f", to {1e3 * tolerance:.4g} mm"
    low, high = 1e3 * float(distances.min()), 1e3 * float(distances.max())
    top = max(1.1 * high, 2e3 * asked, 1.0)
    curves = [Curve(times, 1e3 * distances, _MAIN)]
    svg = _svg(check, title, curves, "mm", 1e3 * asked, min(low - 0.05 * (top - low), 0.0), top,
               key=f"clearance{number}")  # fmt: skip
    return MotionChart(
        f"clearance-{number}",
        title,
        f"{data(1e3 * near.distance, 'mm', 'clearance')} <small>{words}</small>",
        f"Least: {where}.",
        svg,
        passes,
    )


def _fine_times(motion: JointMotion) -> Array:
    """Times of the rows, and of points between them where the joints move far, s."""
    spans = np.diff(motion.times)
    travel = (motion.largest_speeds() * spans[:, None]).max(axis=1)
    parts = np.clip(np.ceil(travel / _FINE), 2, _MOST).astype(int)
    inner = [
        begin + span * np.arange(count) / count
        for begin, span, count in zip(motion.times[:-1], spans, parts, strict=True)
    ]
    return np.append(np.concatenate(inner), motion.times[-1])


def _of_joints(times: Array, each: Array, worst: Array) -> list[Curve]:
    """A faint curve of each joint (K, M), and over them the one that counts, (K,)."""
    return [*(Curve(times, y, _OTHER) for y in each.T), Curve(times, worst, _MAIN)]


def _replaced(times: Array, values: Array, others: Array, instead: Array) -> tuple[Array, Array]:
    """A curve with other values between two times."""
    kept = (times < others[0]) | (times > others[-1])
    times = np.concatenate([times[kept], others])
    values = np.concatenate([values[kept], instead])
    order = np.argsort(times, kind="stable")
    return times[order], values[order]


def _svg(
    check: Check, title: str, curves: Sequence[Curve], unit: str, limit: float, bottom: float,
    top: float, key: str = "",
) -> str:  # fmt: skip
    """One small chart."""
    shaded = [tuple(_abscissa(check, np.array(ends)).tolist()) for ends in off_the_path(check)]
    over = [curve._replace(x=_abscissa(check, curve.x)) for curve in curves]
    x_range = _abscissa(check, check.motion.times[[0, -1]])
    return small_chart(
        over, unit, "s" if check.passing.timed else "waypoint", bottom, top,
        key=key or title.rsplit(maxsplit=1)[-1], description=f"{title} along the path.",
        x_range=(float(x_range[0]), float(x_range[1])), limit=limit, shaded=shaded,
    )  # fmt: skip


def off_the_path(check: Check) -> list[tuple[float, float]]:
    """Begin and end, s, of the motion before the first waypoint, and after the last."""
    ends = np.column_stack([check.motion.times[[0, -1]], check.passing.times[[0, -1]]])
    return [(float(low), float(high)) for low, high in np.sort(ends, axis=1) if high > low]


def _abscissa(check: Check, times: Array) -> Array:
    """Times from the first row on, s; without times in the file, the waypoints at them."""
    if check.passing.timed:
        return np.asarray(times - check.motion.times[0])
    count = np.arange(1, len(check.passing.times) + 1)
    return np.asarray(np.interp(times, check.passing.times, count))

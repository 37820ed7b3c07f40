"""Small curves over time of what a motion has to keep, each with its limit and its number."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.constraints import Clearance
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.pictures.svg import SVG_RC, inline_svg
from qp_twist.referee import (
    OFF,
    Finding,
    JointMotion,
    acceleration_use,
    joint_margins,
    velocity_use,
)
from qp_twist.reporting.words import BETWEEN, amount, data, digits, place, shown, spaced
from qp_twist.trajectories import Check

_INK, _CURVE, _FAINT, _LIMIT, _GRID = "#1b1f24", "#0072b2", "#9fb4c4", "#d00000", "#dddddd"
_VARIABLES = {
    _INK: "--ink", _CURVE: "--curve", _FAINT: "--faint", _LIMIT: "--limit", _GRID: "--grid",
}  # fmt: skip
_POINTS = 220
"""Approximate number of points of a curve."""
_FINE, _MOST = 0.01, 200
"""Travel of a joint between two points at which distances are computed, rad or m, and the largest
number of points between two rows."""


class Chart(NamedTuple):
    """One figure of the page."""

    key: str
    title: str
    number: str
    """The number that counts, HTML."""
    note: str
    """Where it is, and what it means, HTML."""
    svg: str
    passes: bool


class Curve(NamedTuple):
    """What one chart draws."""

    times: Array
    """Ascending, (K,)."""
    values: Array
    """(K,)."""
    others: Array | None = None
    """Fainter curves, (K, M)."""


def charts(path_task: PathTask, check: Check) -> list[Chart]:
    """The charts of a motion, in the order of the page."""
    by_name = {finding.name: finding for finding in check.findings}
    found = [*_error_charts(path_task, check, by_name), *_speed_charts(path_task, check, by_name)]
    margin = by_name.get("smallest joint margin")
    if margin is not None:
        found.append(_margin_chart(path_task, check, margin))
    found += [
        _clearance_chart(path_task, check, clearance, number)
        for number, clearance in enumerate(path_task.clearances, start=1)
    ]
    return found


def _error_charts(path_task: PathTask, check: Check, by_name: dict[str, Finding]) -> list[Chart]:
    errors = check.errors
    angular = any(t.angular.rank > 0 for t in path_task.projectors)
    degrees = float(np.degrees(1.0))
    found = []
    for name, title, at, between, scale, limit in (
        ("position error", "Position error", errors.position, errors.position_between, 1e3,
         1e3 * check.tolerances.position),
        ("axis error", "Orientation error", errors.axis, errors.axis_between, degrees,
         degrees * check.tolerances.axis),
    ):  # fmt: skip
        if name == "axis error" and not angular:
            continue
        pair = [by_name[key] for key in (name, name + BETWEEN, name + OFF) if key in by_name]
        worst = max(pair, key=lambda finding: (not finding.passes, finding.value))
        curve = _merged(check, scale * at, scale * between)
        for part in filter(lambda part: part.moves, check.astray):
            values = scale * (part.position if name == "position error" else part.axis)
            curve = _replaced(curve, part.times, values)
        curve = _largest(curve)
        svg = _draw(check, name.split()[0], curve, worst.unit, title, limit=limit)
        found.append(
            Chart(
                name.replace(" ", "-"),
                title,
                f"{data(shown(worst), worst.name)} <small>of {digits(limit)}"
                f"{spaced(worst.unit)} allowed</small>",
                f"Largest at {place(worst.where)}.",
                svg,
                all(finding.passes for finding in pair),
            )
        )
    return found


def _speed_charts(path_task: PathTask, check: Check, by_name: dict[str, Finding]) -> list[Chart]:
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
        curve = _largest(Curve(times, 100.0 * shares.max(axis=1), 100.0 * shares))
        svg = _draw(check, name.split()[0], curve, "% of limit", title, limit=100.0)
        found.append(
            Chart(
                name.replace(" ", "-"),
                title,
                f"{data(shown(finding), name)} <small>of the limit</small>",
                f"Largest: {place(finding.where)}. Thin lines: each joint.",
                svg,
                finding.passes,
            )
        )
    return found


def _margin_chart(path_task: PathTask, check: Check, finding: Finding) -> Chart:
    ranges = JointRanges.of(path_task.model)
    times, margins = joint_margins(ranges, check.motion)
    order = np.argsort(times, kind="stable")
    times, margins = times[order], margins[order]
    margins = margins[:, ranges.limited]
    curve = _largest(Curve(times, 100.0 * margins.min(axis=1), 100.0 * margins), least=True)
    svg = _draw(check, "margin", curve, "% of half range", "Distance to the joint limits",
                limit=0.0, top=100.0)  # fmt: skip
    dof = ranges.names.index(finding.where.partition(",")[0])
    half = 0.5 * float(ranges.upper[dof] - ranges.lower[dof])
    room = amount(abs(finding.value) * half, ranges.units[dof])
    side = "inside" if finding.value >= 0.0 else "outside"
    return Chart(
        "margin",
        "Distance to the joint limits",
        f"{data(shown(finding), finding.name)} <small>of half the range</small>",
        f"Least: {place(finding.where)}, {room.text}{spaced(room.unit)} {side} its limit. 100 % is "
        "the middle of a joint's range.",
        svg,
        finding.passes,
    )


def _clearance_chart(path_task: PathTask, check: Check, clearance: Clearance, number: int) -> Chart:
    motion = check.motion
    times = _fine_times(motion)
    q = motion.at(times).q
    distances, _ = clearance.closest(q)
    # Where joints go straight from point to point this is the least of all, to 10 µm.
    near = clearance.nearest(q)
    assert near is not None
    at = float(np.interp(near.at, np.arange(len(times)), times))
    later = int(np.searchsorted(times, at))
    times, distances = np.insert(times, later, at), np.insert(distances, later, near.distance)
    asked, tolerance = clearance.distance, check.tolerances.position
    curve = _largest(Curve(times, 1e3 * distances), least=True)
    svg = _draw(check, f"clearance{number}", curve, "mm", "Distance from obstacles",
                limit=1e3 * asked, floor=0.0)  # fmt: skip
    # The referee evaluates other points: the number is the least of both.
    least, where = near.distance, f"{html.escape(near.pair)}, {place(check.passing.place(at))}"
    findings = _of_clearance(path_task, check, clearance)
    worst = max(findings, key=lambda finding: finding.value)
    if not worst.passes and asked - worst.value < least:
        least, where = asked - worst.value, place(worst.where)
    passes = all(finding.passes for finding in findings) and least >= asked - tolerance
    words = f"at least {digits(1e3 * asked)} mm required" if asked else "they must not touch"
    if passes and least < asked:
        words += f", to {digits(1e3 * tolerance)} mm"
    return Chart(
        f"clearance-{number}",
        "Distance from obstacles",
        f"{data(amount(least, 'm'), 'clearance')} <small>{words}</small>",
        f"Least: {where}.",
        svg,
        passes,
    )


def _of_clearance(path_task: PathTask, check: Check, clearance: Clearance) -> list[Finding]:
    """The findings about a clearance: all but those that name a pair of another one."""
    others = {name for other in path_task.clearances for name in other.names} - {*clearance.names}
    return [
        finding
        for finding in check.findings
        if finding.name.startswith(f"outside {clearance.kind}")
        and finding.where.partition(",")[0] not in others
    ]


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


def _merged(check: Check, at: Array, between: Array) -> Curve:
    """Values at the waypoints and the largest between them, in the order of time."""
    when = check.passing.times
    times = np.empty(len(at) + len(between))
    values = np.empty_like(times)
    times[0::2], values[0::2] = when, at
    times[1::2], values[1::2] = 0.5 * (when[:-1] + when[1:]), between
    return Curve(times, values)


def _replaced(curve: Curve, times: Array, values: Array) -> Curve:
    """A curve with other values between two times."""
    kept = (curve.times < times[0]) | (curve.times > times[-1])
    times, values = (
        np.concatenate(pair) for pair in ((curve.times[kept], times), (curve.values[kept], values))
    )
    order = np.argsort(times, kind="stable")
    return Curve(times[order], values[order])


def _largest(curve: Curve, *, least: bool = False) -> Curve:
    """A curve of fewer points that still has its extremes: of each few points the largest."""
    count = len(curve.times)
    each = -(-count // _POINTS)
    if each <= 1:
        return curve
    firsts = np.arange(0, count, each)
    reduce = np.minimum if least else np.maximum
    others = None if curve.others is None else reduce.reduceat(curve.others, firsts, axis=0)
    ends = np.minimum(firsts + each, count) - 1
    times = 0.5 * (curve.times[firsts] + curve.times[ends])
    return Curve(times, reduce.reduceat(curve.values, firsts), others)


def _draw(
    check: Check,
    key: str,
    curve: Curve,
    unit: str,
    title: str,
    *,
    limit: float,
    top: float | None = None,
    floor: float | None = None,
) -> str:
    """One small panel; the page gives it its colours."""
    below = top is not None or floor is not None  # the limit is a lower one
    with mpl.rc_context(SVG_RC | _RC):
        figure = Figure(figsize=(3.6, 1.55), facecolor="none")
        panel = figure.add_axes((0.115, 0.2, 0.87, 0.66))
        scale = _waypoint_scale(check)
        for begin, end in off_the_path(check):
            panel.axvspan(*scale(np.array([begin, end])), color=_GRID, linewidth=0.0)
        if curve.others is not None:
            panel.plot(scale(curve.times), curve.others, color=_FAINT, linewidth=0.7)
        panel.axhline(limit, color=_LIMIT, linewidth=1.2, dashes=(5, 2))
        panel.plot(scale(curve.times), curve.values, color=_CURVE, linewidth=1.6)
        low, high = float(curve.values.min()), float(curve.values.max())
        if below:
            highest = top if top is not None else max(1.1 * high, 2.0 * limit, 1.0)
            lowest = min(low - 0.05 * (highest - low), floor if floor is not None else -8.0)
        else:
            lowest, highest = 0.0, 1.2 * max(limit, high)
        panel.set_ylim(lowest, highest)
        panel.set_xlim(*scale(check.motion.times[[0, -1]]))
        panel.text(0.0, 1.05, unit, transform=panel.transAxes, fontsize=7.5, color=_INK)
        panel.text(1.0, 1.05, "- - limit", transform=panel.transAxes, ha="right", fontsize=7.5,
                   color=_LIMIT)  # fmt: skip
        panel.set_xlabel("s" if check.passing.timed else "waypoint", labelpad=1.0)
        panel.xaxis.set_label_coords(1.0, -0.16)
        panel.locator_params(axis="y", nbins=4)
        panel.locator_params(axis="x", nbins=6)
    return inline_svg(figure, key, f"{title} along the path.", _VARIABLES)


def off_the_path(check: Check) -> list[tuple[float, float]]:
    """Begin and end, s, of the motion before the first waypoint, and after the last."""
    ends = np.column_stack([check.motion.times[[0, -1]], check.passing.times[[0, -1]]])
    return [(float(low), float(high)) for low, high in np.sort(ends, axis=1) if high > low]


_RC = {
    "text.color": _INK, "axes.labelcolor": _INK, "axes.edgecolor": _INK, "xtick.color": _INK,
    "ytick.color": _INK, "axes.facecolor": "none",
    "font.size": 7.5, "axes.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "xtick.major.size": 2.5, "ytick.major.size": 2.5, "xtick.major.pad": 2.0,
    "ytick.major.pad": 2.0,
}  # fmt: skip


def _waypoint_scale(check: Check) -> Callable[[Array], Array]:
    """Times as they are; without times in the file, the waypoints at them."""
    if check.passing.timed:
        return lambda times: np.asarray(times - check.motion.times[0])
    count = np.arange(1, len(check.passing.times) + 1)
    return lambda times: np.asarray(np.interp(times, check.passing.times, count))

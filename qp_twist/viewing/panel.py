"""The panel of readings: joints between their limits, clearance, roll and numbers, as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from qp_twist.checks import Array
from qp_twist.drawing.palette import BLUE, GRID, INK, ORANGE, QUIET, RED
from qp_twist.kinematics import JointRanges
from qp_twist.pages.near_pairs import NearPair
from qp_twist.viewing.one_run import Moment

_OUTSIDE, _AT_LIMIT = 1e-9, 1e-6
"""Margins, as shares of the half-range, from which a joint is outside, and below which it counts as
at its limit."""
_OVER = 8.0
"""Space drawn beyond either end of a track, % of its length."""
_CLEAR_MM, _AT_CLEARANCE = 50.0, 1e-5
"""Range of the bar of the clearance, mm; margin below which a pair is at the asked distance, m."""
_COLOURS = {
    "blue": BLUE, "grid": GRID, "ink": INK, "orange": ORANGE, "quiet": QUIET, "red": RED,
}  # fmt: skip
_TEMPLATE = Environment(
    loader=PackageLoader("qp_twist.viewing", "."), autoescape=True, undefined=StrictUndefined,
    trim_blocks=True, lstrip_blocks=True,
).get_template("panel.html.j2")  # fmt: skip


class Bar(NamedTuple):
    """A row of the panel."""

    name: str
    state: str
    """``free``, ``held``, ``at limit`` or ``outside``."""
    value: str
    word: str = ""
    """The state in a word, so that it is not told by the colour alone."""
    at: float | None = None
    """Place of the mark, % of the track; ``None`` without limits."""
    labels: dict[float, str] = {}  # noqa: RUF012  (never changed)
    """Texts below the track by their place."""


def panel_html(ranges: JointRanges, moment: Moment, near: NearPair | None) -> str:
    """All readings of a moment, with the nearest pair of geoms, if some may collide."""
    bars = joint_bars(ranges, moment.q, moment.binding)
    return _TEMPLATE.render(
        bars=[*bars, *([] if near is None else [clearance_bar(near)])],
        near=near,
        roll=None if moment.roll is None else _fixed(np.degrees(moment.roll), 1) + "°",
        roll_deg=None if moment.roll is None else np.degrees(moment.roll),
        readings=_readings(ranges, moment),
        **_COLOURS,
    )


def status_html(title: str, text: str, *, wrong: bool) -> str:
    """The task's title, and a sentence that is read out when it changes."""
    return (
        f'<div style="font-size:12.5px;line-height:1.35;color:{INK};padding:8px 12px 2px">'
        f'{escape(title)}</div><div class="qt-status" role="status" aria-live="polite" '
        f'style="font-size:12px;line-height:1.35;color:{INK};margin:4px 12px;'
        f"padding:2px 0 2px 8px;border-left:4px solid {RED if wrong else BLUE};"
        f'overflow-wrap:anywhere">{"⚠ " if wrong else ""}{escape(text)}</div>'
    )


def joint_bars(ranges: JointRanges, q: Array, binding: Sequence[str] = ()) -> list[Bar]:
    """One row per joint at a configuration (nq,); a joint without a range has only a value.

    Active limits are named as ``joint_1 (upper velocity limit)``.
    """
    positions, margins = ranges.positions(q), ranges.margins(q)
    bars = []
    for dof, name in enumerate(ranges.names):
        scale, unit, digits = (np.degrees(1.0), "°", 1) if ranges.hinge[dof] else (1.0, " m", 3)
        kinds = [limit.split()[-2] for limit in binding if limit.startswith(f"{name} (")]
        state, word = "free", ""
        if margins[dof] < -_OUTSIDE:
            state = word = "outside"
        elif margins[dof] < _AT_LIMIT or "position" in kinds:
            state = word = "at limit"
        elif kinds:
            state, word = "held", kinds[0]
        at, labels = None, {}
        if np.isfinite(margins[dof]) and ranges.upper[dof] > ranges.lower[dof]:
            lower, upper = float(ranges.lower[dof]), float(ranges.upper[dof])
            at = 100.0 * (float(positions[dof]) - lower) / (upper - lower)
            at = float(np.clip(at, -_OVER, 100.0 + _OVER))
            ends = (_fixed(scale * end, 0 if unit == "°" else 2) + unit for end in (lower, upper))
            labels = dict(zip((0.0, 100.0), ends, strict=True))
        value = _fixed(scale * float(positions[dof]), digits) + unit
        bars.append(Bar(name, state, value, word, at, labels))
    return bars


def clearance_bar(near: NearPair) -> Bar:
    """The distance of the nearest pair, with the one that is asked for as a label."""
    distance, asked = 1e3 * near.distance, 1e3 * near.asked
    full = max(_CLEAR_MM, 4.0 * asked)
    state, word = "free", ""
    if near.too_near:
        state, word = "outside", "overlap" if distance < 0.0 else "too near"
    elif near.distance - near.asked < _AT_CLEARANCE:
        state, word = "held", "at limit"
    at = float(np.clip(100.0 * distance / full, -_OVER, 100.0))
    labels = {100.0 * asked / full: f"{asked:g} mm", 100.0: f"{full:g} mm"}
    return Bar("clearance", state, _fixed(distance, 1) + " mm", word, at, labels)


def _readings(ranges: JointRanges, moment: Moment) -> list[tuple[str, str, str]]:
    """Name, value and meaning of the numbers."""
    position, margin = moment.position_error, "no limits"
    if np.isfinite(moment.margins).any():
        joint = int(np.argmin(moment.margins))
        least = float(moment.margins[joint])
        margin = f"{'⚠ ' if least < -_OUTSIDE else ''}{_fixed(least, 3)} {ranges.names[joint]}"
    return [
        ("scale", f"{moment.scale:.3f}", "share of the task's speed that the limits leave"),
        ("position error", f"{1e3 * position:.3f} mm" if position < 1.0 else f"{position:.3f} m",
         "in the rows of the task"),
        ("angle error", f"{np.degrees(moment.axis_error):.3f}°", "in the rows of the task"),
        ("margin", margin, "of the joint nearest to a limit: 1 in the middle"),
        ("z", f"{moment.z:.3f}", "how far from the middles: 1/8 for each joint at its limit"),
        ("σ min", f"{moment.sigma_min:.3f}", "smallest singular value of the task rows"),
    ]  # fmt: skip


def _fixed(value: float, digits: int) -> str:
    """A number with a sign for minus, and none for −0."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")

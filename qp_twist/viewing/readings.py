"""The numbers of a state, with units, and the roll as a dial, as HTML."""

from __future__ import annotations

import html
import math

import numpy as np

from qp_twist.drawing.palette import BLUE, GRID, INK, QUIET, RED
from qp_twist.kinematics import JointRanges
from qp_twist.viewing.one_run import Moment

_SIZE = 112.0
LEGEND = (
    f'<div style="font-size:11px;line-height:1.5;color:{QUIET};padding:6px 12px">● inside its '
    "limits &nbsp; ◆ held by a limit &nbsp; ✕ outside<br>red: the path; blue: where the tool goes; "
    "axes: the waypoint</div>"
)
"""Legend of the marks and colours."""
NEAR_LEGEND = (
    f'<div style="font-size:11px;line-height:1.5;color:{QUIET};padding:0 12px 6px">orange: near '
    "each other; red: nearer than the task allows</div>"
)
"""Legend of the shapes that are lit."""


def readings(ranges: JointRanges, moment: Moment) -> str:
    """The dial beside the numbers: task errors, distance from limits, singular values.

    Args:
        ranges: Joint ranges of the model.
        moment: The state that is shown.
    """
    rows = [
        ("scale", f"{moment.scale:.3f}", "share of the task's speed that the limits leave"),
        ("position error", _length(moment.position_error), "in the rows of the task"),
        ("angle error", _angle(moment.axis_error), "in the rows of the task"),
        ("margin", _margin(ranges, moment), "of the joint nearest to a limit: 1 in the middle"),
        ("z", f"{moment.z:.3f}", "how far from the middles: 1/8 for each joint at its limit"),
        ("σ<sub>min</sub>", f"{moment.sigma_min:.3f}", "smallest singular value of the task rows"),
    ]
    cells = "".join(
        f'<tr title="{html.escape(why)}"><td style="padding:1px 8px 1px 0;color:{QUIET}">{name}'
        f'</td><td style="text-align:right;white-space:nowrap" data-reading="{html.escape(name)}">'
        f"{value}</td></tr>"
        for name, value, why in rows
    )
    return (
        '<div class="qt-readings" style="display:flex;align-items:center;gap:10px;padding:0 12px;'
        f'color:{INK};font-size:12px;font-variant-numeric:tabular-nums">{roll_dial(moment.roll)}'
        f'<table style="border-collapse:collapse;flex:1">{cells}</table></div>'
    )


def sentence(text: str, *, wrong: bool) -> str:
    """A status sentence, read out when it changes; with a sign if something is wrong."""
    sign = "⚠ " if wrong else ""
    border = RED if wrong else BLUE
    return (
        f'<div class="qt-status" role="status" aria-live="polite" style="font-size:12px;'
        f"line-height:1.35;color:{INK};border-left:4px solid {border};"
        "margin:4px 12px;padding:2px 0 2px 8px;"
        f'overflow-wrap:anywhere">{sign}{html.escape(text)}</div>'
    )


def heading(text: str) -> str:
    """Description of the task."""
    return (
        f'<div style="font-size:12.5px;line-height:1.35;color:{INK};padding:8px 12px 2px">'
        f"{html.escape(text)}</div>"
    )


def note(text: str) -> str:
    """A few words below a control."""
    return f'<div style="font-size:11px;color:{QUIET};padding:0 12px 4px">{html.escape(text)}</div>'


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3f} mm" if metres < 1.0 else f"{metres:.3f} m"


def _angle(radians: float) -> str:
    return f"{np.degrees(radians):.3f}°"


def _margin(ranges: JointRanges, moment: Moment) -> str:
    if not np.isfinite(moment.margins).any():
        return "no limits"
    joint = int(np.argmin(moment.margins))
    least = float(moment.margins[joint])
    text = f"{least:.3f}".replace("-", "−")
    name = html.escape(ranges.names[joint])
    return f"{'⚠ ' if least < -1e-9 else ''}{text} <small>{name}</small>"


def roll_dial(angle: float | None) -> str:
    """A needle at the roll angle, counter-clockwise from the right, with its value.

    Args:
        angle: The roll, rad; ``None`` without a roll axis: then there is no dial.
    """
    if angle is None:
        return ""
    middle, radius = 0.5 * _SIZE, 0.5 * _SIZE - 14.0
    marks = []
    for degrees in range(0, 360, 30):
        c, s = math.cos(math.radians(degrees)), -math.sin(math.radians(degrees))
        inner = radius - (8.0 if degrees % 90 == 0 else 4.0)
        marks.append(
            f'<line x1="{middle + inner * c:.2f}" y1="{middle + inner * s:.2f}" '
            f'x2="{middle + radius * c:.2f}" y2="{middle + radius * s:.2f}" '
            f'stroke="{QUIET}" stroke-width="{1.6 if degrees % 90 == 0 else 0.9}"/>'
        )
    labels = "".join(
        f'<text x="{middle + (radius + 8) * x:g}" y="{middle + (radius + 8) * y + 3:g}" '
        f'font-size="8" fill="{QUIET}" text-anchor="middle">{text}</text>'
        for text, x, y in (("0", 1, 0), ("90", 0, -1), ("180", -1, 0), ("−90", 0, 1))
    )
    c, s = math.cos(angle), -math.sin(angle)
    degrees_text = f"{round(math.degrees(angle), 1) + 0.0:.1f}°".replace("-", "−")
    return (
        f'<svg class="qt-dial" role="img" aria-label="roll {degrees_text}" '
        f'data-angle="{angle:.4f}" viewBox="-4 -4 {_SIZE + 8:g} {_SIZE + 22:g}" width="118" '
        f'font-family="inherit" fill="{INK}">'
        f'<circle cx="{middle:g}" cy="{middle:g}" r="{radius:g}" fill="white" stroke="{GRID}" '
        f'stroke-width="2"/>{"".join(marks)}{labels}'
        f'<line x1="{middle - 8 * c:.2f}" y1="{middle - 8 * s:.2f}" '
        f'x2="{middle + (radius - 9) * c:.2f}" y2="{middle + (radius - 9) * s:.2f}" '
        f'stroke="{BLUE}" stroke-width="3.4" stroke-linecap="round"/>'
        f'<circle cx="{middle:g}" cy="{middle:g}" r="4" fill="{INK}"/>'
        f'<text x="{middle:g}" y="{_SIZE + 14:g}" font-size="12" font-weight="600" '
        f'text-anchor="middle">roll {degrees_text}</text></svg>'
    )

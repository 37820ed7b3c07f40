"""The joints between their limits, and the least clearance, as SVG drawings."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.pages.near_pairs import TOO_NEAR, NearPair, distance_text
from qp_twist.viewing.short_names import short_names

_OUTSIDE = 1e-9
_AT_LIMIT = 1e-6
"""A margin below this share of the half-range counts as at the limit."""
_LEFT, _WIDTH, _ROW, _RIGHT = 62.0, 172.0, 30.0, 66.0
_NAME = 10
"""Characters of a joint's name that there is room for."""
_OVER = 0.08
"""Space drawn beyond either end, as a share of the range."""
_CLEAR_MM, _AT_CLEARANCE = 50.0, 1e-5
"""Range of the bar of the clearance, mm; margin below which a pair is at the asked distance, m."""
INK, QUIET, TRACK = "#1f2937", "#6b7280", "#e5e7eb"
FREE, HELD, LOST = "#0072B2", "#E69F00", "#D00000"


def joint_bars(ranges: JointRanges, q: Array, binding: Sequence[str] = ()) -> str:
    """One row per joint: its range as a track with ticks, a mark at its position, its value.

    A joint with an active limit is marked by a diamond and the word "held", one outside its range
    by a cross and "outside", not by colour alone. Joints without a range only have a value.

    Args:
        ranges: Joint ranges of the model.
        q: Configuration, rad or m, (nq,).
        binding: Names of the active limits, each beginning with the joint's name.
    """
    positions = ranges.positions(q)
    margins = ranges.margins(q)
    rows = []
    shown = short_names(ranges.names, _NAME)
    for dof, name in enumerate(ranges.names):
        held = [limit for limit in binding if limit.startswith(f"{name} (")]
        rows.append(
            _row(
                dof,
                name,
                shown[dof],
                (float(ranges.lower[dof]), float(ranges.upper[dof])),
                float(positions[dof]),
                float(margins[dof]),
                bool(ranges.hinge[dof]),
                held,
            )
        )
    width, height = _LEFT + _WIDTH + _RIGHT, _ROW * len(rows) + 4.0
    described = ", ".join(
        f"{name} {_value(float(p), bool(h))}"
        for name, p, h in zip(ranges.names, positions, ranges.hinge, strict=True)
    )
    return (
        '<svg class="qt-bars" style="box-sizing:border-box;padding:4px 12px" role="img" '
        f'aria-label="{html.escape(described)}" '
        f'viewBox="0 0 {width:g} {height:g}" width="100%" '
        f'font-family="inherit" font-size="11" fill="{INK}">{"".join(rows)}</svg>'
    )


def clearance_bar(near: NearPair) -> str:
    """The distance of the nearest pair in a row like a joint's, with the asked one as a tick.

    The name of the pair is below. A pair at the asked distance has a diamond, a nearer one a cross
    and the words "too near" or "overlap".
    """
    distance, asked = 1e3 * near.distance, 1e3 * near.asked
    full = max(_CLEAR_MM, 4.0 * asked)
    margin = near.distance - near.asked
    state = "outside" if margin < -TOO_NEAR else "held" if margin < _AT_CLEARANCE else "free"
    colour = {"free": FREE, "held": HELD, "outside": LOST}[state]
    word = {"free": "", "held": "at limit", "outside": "too near"}[state]
    if near.distance < -TOO_NEAR:
        word = "overlap"
    y, width = 11.0, _LEFT + _WIDTH + _RIGHT
    x = _at(float(np.clip(distance / full, -_OVER, 1.0)))
    parts = [
        f'<text x="0" y="{y + 4:g}">clearance</text>',
        f'<text x="{width:g}" y="{y + 4:g}" text-anchor="end" '
        f'font-weight="{400 if state == "free" else 700}">{_mm(distance)}</text>',
        f'<rect x="{_at(0.0):g}" y="{y - 4:g}" width="{_at(1.0) - _at(0.0):g}" height="8" rx="2" '
        f'fill="{TRACK}"/>',
    ]
    for value in dict.fromkeys((0.0, asked, full)):
        at = _at(value / full)
        parts.append(
            f'<line x1="{at:g}" x2="{at:g}" y1="{y - 6:g}" y2="{y + 6:g}" '
            f'stroke="{LOST if value == asked else "#9ca3af"}" stroke-width="1.4"/>'
        )
    parts.append(
        f'<rect x="{min(x, _at(0.0)):.2f}" y="{y - 2:g}" width="{abs(x - _at(0.0)):.2f}" '
        f'height="4" fill="{colour}"/>'
    )
    parts.append(_mark(x, y, state, colour))
    for value, anchor in ((asked, "middle"), (full, "end")):
        parts.append(
            f'<text x="{_at(value / full):g}" y="{y + 15:g}" font-size="8" text-anchor="{anchor}" '
            f'fill="{QUIET}">{value:g} mm</text>'
        )
    if word:
        parts.append(
            f'<text x="{width:g}" y="{y + 15:g}" font-size="9" font-weight="700" '
            f'text-anchor="end">{word}</text>'
        )
    name = html.escape(near.name if len(near.name) <= 44 else near.name[:43] + "…")
    parts.append(
        f'<text x="{_at(0.0):g}" y="{y + 28:g}" font-size="9.5" fill="{INK}">{name}</text>'
    )
    described = html.escape(f"{near.name}: {distance_text(near.distance)}, {word or 'clear'}")
    return (
        f'<svg class="qt-clearance" data-state="{state}" data-x="{x:.2f}" role="img" '
        f'style="box-sizing:border-box;padding:0 12px 4px" aria-label="{described}" '
        f'viewBox="0 0 {width:g} {y + 34.0:g}" width="100%" font-family="inherit" font-size="11" '
        f'fill="{INK}">{"".join(parts)}</svg>'
    )


def _row(
    dof: int,
    name: str,
    shown: str,
    limits: tuple[float, float],
    position: float,
    margin: float,
    hinge: bool,
    held: Sequence[str],
) -> str:
    y = _ROW * dof + 11.0
    state = _state(margin, held)
    colour = {"free": FREE, "held": HELD, "at limit": HELD, "outside": LOST}[state]
    parts = [
        f'<text x="0" y="{y + 4:g}">{html.escape(shown)}<title>{html.escape(name)}</title></text>',
        f'<text x="{_LEFT + _WIDTH + _RIGHT:g}" y="{y + 4:g}" text-anchor="end" '
        f'font-weight="{400 if state == "free" else 700}">{_value(position, hinge)}</text>',
    ]
    lower, upper = limits
    x = None
    if np.isfinite(margin) and upper > lower:
        share = (position - lower) / (upper - lower)
        x = _at(float(np.clip(share, -_OVER, 1.0 + _OVER)))
        left, right = _at(0.0), _at(1.0)
        parts.append(
            f'<rect x="{left:g}" y="{y - 4:g}" width="{right - left:g}" height="8" rx="2" '
            f'fill="{TRACK}"/>'
        )
        for at in (0.0, 0.25, 0.5, 0.75, 1.0):
            tall = 6 if at in (0.0, 1.0) else 3
            parts.append(
                f'<line x1="{_at(at):g}" x2="{_at(at):g}" y1="{y - tall:g}" y2="{y + tall:g}" '
                f'stroke="#9ca3af" stroke-width="{1.4 if tall == 6 else 0.8}"/>'
            )
        middle = _at(0.5)
        parts.append(
            f'<rect x="{min(x, middle):.2f}" y="{y - 2:g}" width="{abs(x - middle):.2f}" '
            f'height="4" fill="{colour}"/>'
        )
        parts.append(_mark(x, y, state, colour))
        for value, where, anchor in ((lower, left, "start"), (upper, right, "end")):
            parts.append(
                f'<text x="{where:g}" y="{y + 15:g}" font-size="8" text-anchor="{anchor}" '
                f'fill="{QUIET}">{_value(value, hinge, digits=0 if hinge else 2)}</text>'
            )
    word = state if not held else " ".join(_kinds(held))
    if state != "free":
        parts.append(
            f'<text x="{_LEFT + _WIDTH + _RIGHT:g}" y="{y + 15:g}" font-size="9" '
            f'font-weight="700" text-anchor="end">{word}</text>'
        )
    place = "" if x is None else f' data-x="{x:.2f}"'
    return f'<g data-joint="{html.escape(name)}" data-state="{state}"{place}>{"".join(parts)}</g>'


def _state(margin: float, held: Sequence[str]) -> str:
    if margin < -_OUTSIDE:
        return "outside"
    if held:
        return "held"
    return "at limit" if margin < _AT_LIMIT else "free"


def _kinds(held: Sequence[str]) -> list[str]:
    """The active limit of a joint: "at limit" for its range, else the kind."""
    kinds = []
    for limit in held:
        kind = "at limit" if "position" in limit else limit.split("(")[-1].split(" ")[-2]
        kinds.append({"velocity": "speed limit"}.get(kind, kind))
    return list(dict.fromkeys(kinds))


def _mark(x: float, y: float, state: str, colour: str) -> str:
    if state == "free":
        return (
            f'<circle cx="{x:.2f}" cy="{y:g}" r="4.5" fill="{colour}" stroke="white" '
            'stroke-width="1"/>'
        )
    if state == "outside":
        return (
            f'<path d="M{x - 5:.2f} {y - 5:g} l10 10 m0 -10 l-10 10" stroke="{colour}" '
            'stroke-width="2.6" fill="none"/>'
        )
    return (
        f'<path d="M{x:.2f} {y - 7:g} l7 7 -7 7 -7 -7 z" fill="{colour}" stroke="{INK}" '
        'stroke-width="1.6"/>'
    )


def _at(share: float) -> float:
    """Horizontal position of a share of the range."""
    inner = _WIDTH / (1.0 + 2.0 * _OVER)
    return _LEFT + inner * (_OVER + share)


def _mm(distance: float) -> str:
    return f"{round(distance, 1) + 0.0:.1f} mm".replace("-", "−")


def _value(position: float, hinge: bool, digits: int | None = None) -> str:
    number = np.degrees(position) if hinge else position
    places = (1 if hinge else 3) if digits is None else digits
    text = f"{round(float(number), places) + 0.0:.{places}f}".replace("-", "−")
    return f"{text}°" if hinge else f"{text} m"

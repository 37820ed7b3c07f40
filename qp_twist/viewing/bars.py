"""The joints between their limits, and the least clearance, as SVG drawings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.drawing.palette import BLUE, GRID, INK, ORANGE, QUIET, RED
from qp_twist.kinematics import JointRanges
from qp_twist.pages.near_pairs import NearPair, distance_text
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
_COLOURS = {"free": BLUE, "held": ORANGE, "at limit": ORANGE, "outside": RED}
TICK = "#9ca3af"


class _Bar(NamedTuple):
    """A row: a name, a track with a mark, and a value. Places are shares of the track."""

    name: str
    value: str
    state: str
    word: str = ""
    """Said below the value, unless it is free."""
    place: float | None = None
    """Of the mark; ``None`` without a track."""
    origin: float = 0.0
    """Where the thick part begins."""
    ticks: Sequence[tuple[float, float, str]] = ()
    """Place, half height and colour."""
    labels: Sequence[tuple[float, str, str]] = ()
    """Place, text and anchor."""

    @property
    def x(self) -> float | None:
        """Horizontal place of the mark."""
        return None if self.place is None else _at(float(np.clip(self.place, -_OVER, 1.0 + _OVER)))

    def svg(self, y: float) -> str:
        """The row with its middle at a height."""
        weight, end = (400 if self.state == "free" else 700), _LEFT + _WIDTH + _RIGHT
        parts = [
            f'<text x="0" y="{y + 4:g}">{self.name}</text><text x="{end:g}" y="{y + 4:g}" '
            f'text-anchor="end" font-weight="{weight}">{self.value}</text>'
        ]
        x = self.x
        if x is not None:
            left, begin, colour = _at(0.0), _at(self.origin), _COLOURS[self.state]
            parts.append(
                f'<rect x="{left:g}" y="{y - 4:g}" width="{_at(1.0) - left:g}" height="8" rx="2" '
                f'fill="{GRID}"/>'
            )
            parts += [
                f'<line x1="{_at(place):g}" x2="{_at(place):g}" y1="{y - half:g}" '
                f'y2="{y + half:g}" stroke="{stroke}" stroke-width="{1.4 if half > 3 else 0.8}"/>'
                for place, half, stroke in self.ticks
            ]
            parts.append(
                f'<rect x="{min(x, begin):.2f}" y="{y - 2:g}" width="{abs(x - begin):.2f}" '
                f'height="4" fill="{colour}"/>{_mark(x, y, self.state, colour)}'
            )
            parts += [
                f'<text x="{_at(place):g}" y="{y + 15:g}" font-size="8" text-anchor="{anchor}" '
                f'fill="{QUIET}">{text}</text>'
                for place, text, anchor in self.labels
            ]
        if self.state != "free":
            parts.append(
                f'<text x="{end:g}" y="{y + 15:g}" font-size="9" font-weight="700" '
                f'text-anchor="end">{self.word}</text>'
            )
        return "".join(parts)


def joint_bars(ranges: JointRanges, q: Array, binding: Sequence[str] = ()) -> str:
    """One row per joint: its range as a track with ticks, a mark at its position, its value.

    A joint with an active limit is marked by a diamond and the word "held", one outside its range
    by a cross and "outside", not by colour alone. Joints without a range only have a value.

    Args:
        ranges: Joint ranges of the model.
        q: Configuration, rad or m, (nq,).
        binding: Names of the active limits, each beginning with the joint's name.
    """
    positions, margins = ranges.positions(q), ranges.margins(q)
    rows, described = "", []
    for dof, (name, shown) in enumerate(
        zip(ranges.names, short_names(ranges.names, _NAME), strict=True)
    ):
        hinge, position = bool(ranges.hinge[dof]), float(positions[dof])
        lower, upper = float(ranges.lower[dof]), float(ranges.upper[dof])
        held = [limit for limit in binding if limit.startswith(f"{name} (")]
        state = _state(float(margins[dof]), held)
        bar = _Bar(
            f"{escape(shown)}<title>{escape(name)}</title>", _value(position, hinge), state,
            " ".join(_kinds(held)) or state,
        )  # fmt: skip
        if np.isfinite(margins[dof]) and upper > lower:
            ends = [_value(limit, hinge, digits=0 if hinge else 2) for limit in (lower, upper)]
            bar = bar._replace(
                place=(position - lower) / (upper - lower), origin=0.5,
                ticks=[(k / 4, 3.0 if k % 4 else 6.0, TICK) for k in range(5)],
                labels=[(0.0, ends[0], "start"), (1.0, ends[1], "end")],
            )  # fmt: skip
        place = "" if bar.x is None else f' data-x="{bar.x:.2f}"'
        rows += (
            f'<g data-joint="{escape(name)}" data-state="{state}"{place}>'
            f"{bar.svg(_ROW * dof + 11.0)}</g>"
        )
        described.append(f"{name} {bar.value}")
    attributes = 'class="qt-bars"'
    return _drawing(attributes, ", ".join(described), _ROW * len(ranges.names) + 4.0, rows)


def clearance_bar(near: NearPair) -> str:
    """The distance of the nearest pair in a row like a joint's, with the asked one as a tick.

    The name of the pair is below. A pair at the asked distance has a diamond, a nearer one a cross
    and the words "too near" or "overlap".
    """
    distance, asked = 1e3 * near.distance, 1e3 * near.asked
    full = max(_CLEAR_MM, 4.0 * asked)
    margin = near.distance - near.asked
    state = "outside" if near.too_near else "held" if margin < _AT_CLEARANCE else "free"
    word = {"free": "", "held": "at limit", "outside": "too near"}[state]
    if near.distance < 0.0:
        word = "overlap"
    value = f"{round(distance, 1) + 0.0:.1f} mm".replace("-", "−")
    bar = _Bar(
        "clearance", value, state, word, min(distance / full, 1.0),
        ticks=[(v / full, 6.0, RED if v == asked else TICK) for v in {0.0, asked, full}],
        labels=[(asked / full, f"{asked:g} mm", "middle"), (1.0, f"{full:g} mm", "end")],
    )  # fmt: skip
    name = escape(near.name if len(near.name) <= 44 else near.name[:43] + "…")
    below = f'<text x="{_at(0.0):g}" y="39" font-size="9.5">{name}</text>'
    described = f"{near.name}: {distance_text(near.distance)}, {word or 'clear'}"
    attributes = f'class="qt-clearance" data-state="{state}" data-x="{bar.x:.2f}"'
    return _drawing(attributes, described, 45.0, bar.svg(11.0) + below)


def _drawing(attributes: str, described: str, height: float, content: str) -> str:
    return (
        f'<svg {attributes} style="box-sizing:border-box;padding:4px 12px" role="img" '
        f'aria-label="{escape(described)}" viewBox="0 0 {_LEFT + _WIDTH + _RIGHT:g} {height:g}" '
        f'width="100%" font-family="inherit" font-size="11" fill="{INK}">{content}</svg>'
    )


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
    """A disc, a cross outside, else a diamond."""
    if state == "free":
        return f'<circle cx="{x:.2f}" cy="{y:g}" r="4.5" fill="{colour}" stroke="white"/>'
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


def _value(position: float, hinge: bool, digits: int | None = None) -> str:
    number = np.degrees(position) if hinge else position
    places = (1 if hinge else 3) if digits is None else digits
    text = f"{round(float(number), places) + 0.0:.{places}f}".replace("-", "−")
    return f"{text}°" if hinge else f"{text} m"

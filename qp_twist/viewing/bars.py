"""The joints between their limits, and the least clearance, as bars in HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from qp_twist.checks import Array
from qp_twist.drawing.palette import BLUE, GRID, INK, ORANGE, QUIET, RED
from qp_twist.kinematics import JointRanges
from qp_twist.pages.near_pairs import NearPair, distance_text

_OUTSIDE = 1e-9
_AT_LIMIT = 1e-6
"""A margin below this share of the half-range counts as at the limit."""
_OVER = 0.08
"""Space drawn beyond either end, as a share of the range."""
_CLEAR_MM, _AT_CLEARANCE = 50.0, 1e-5
"""Range of the bar of the clearance, mm; margin below which a pair is at the asked distance, m."""
_MARKS = {
    "free": ("●", BLUE), "held": ("◆", ORANGE), "at limit": ("◆", ORANGE), "outside": ("✕", RED),
}  # fmt: skip
# A long name is cut at its beginning: its end tells a joint from the next one.
_STYLE = f"""<style>
.qt-bars {{ padding: 4px 12px; font-size: 11px; color: {INK}; }}
.qt-bars section {{ display: grid; grid-template-columns: 62px 1fr 66px; height: 30px; }}
.qt-bars .name {{ direction: rtl; text-align: left; overflow: hidden; text-overflow: ellipsis; }}
.qt-bars .name, .qt-bars .value, .qt-bars small {{ white-space: nowrap; }}
.qt-bars .value {{ text-align: right; line-height: 1.2; }}
.qt-bars section:not([data-state=free]) .value {{ font-weight: 700; }}
.qt-bars .track {{ position: relative; height: 8px; margin: 4px 8% 0; border-radius: 2px;
  background: linear-gradient({QUIET}, {QUIET}) center / 1px 100% no-repeat {GRID}; }}
.qt-bars .track > * {{ position: absolute; transform: translateX(-50%); }}
.qt-bars b {{ top: -8px; font-size: 15px; line-height: 22px; }}
.qt-bars .value > span {{ font-size: 9px; }}
.qt-bars p {{ margin: 0; }}
.qt-bars small {{ top: 9px; font-size: 8px; color: {QUIET}; }}
</style>"""


def joint_bars(ranges: JointRanges, q: Array, binding: Sequence[str] = ()) -> str:
    """One row per joint: its range as a track, a mark at its position, its value.

    A joint with an active limit is marked by a diamond and the word "held", one outside its range
    by a cross and "outside", not by colour alone. Joints without a range only have a value.

    Args:
        ranges: Joint ranges of the model.
        q: Configuration, rad or m, (nq,).
        binding: Names of the active limits, each beginning with the joint's name.
    """
    positions, margins = ranges.positions(q), ranges.margins(q)
    rows, described = "", []
    for dof, name in enumerate(ranges.names):
        hinge, position = bool(ranges.hinge[dof]), float(positions[dof])
        lower, upper = float(ranges.lower[dof]), float(ranges.upper[dof])
        held = [limit for limit in binding if limit.startswith(f"{name} (")]
        state, value = _state(float(margins[dof]), held), _value(position, hinge)
        track = ""
        if np.isfinite(margins[dof]) and upper > lower:
            ends = [_value(limit, hinge, digits=0 if hinge else 2) for limit in (lower, upper)]
            share = (position - lower) / (upper - lower)
            track = _track(share, state, {0.0: ends[0], 1.0: ends[1]})
        word = " ".join(_kinds(held)) or state
        rows += _row(f'data-joint="{escape(name)}"', name, state, track, value, word)
        described.append(f"{name} {value}")
    return _bars(", ".join(described), rows)


def clearance_bar(near: NearPair) -> str:
    """The distance of the nearest pair in a row like a joint's, with the asked one as a label.

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
    labels = {asked / full: f"{asked:g} mm", 1.0: f"{full:g} mm"}
    track = _track(min(distance / full, 1.0), state, labels)
    described = f"{near.name}: {distance_text(near.distance)}, {word or 'clear'}"
    row = _row('class="qt-clearance"', "clearance", state, track, value, word)
    return _bars(described, f"{row}<p>{escape(near.name)}</p>")


def _bars(described: str, rows: str) -> str:
    return f'<div class="qt-bars" role="img" aria-label="{escape(described)}">{_STYLE}{rows}</div>'


def _row(attributes: str, name: str, state: str, track: str, value: str, word: str) -> str:
    """A name, a track, and a value with a word below unless it is free."""
    below = "" if state == "free" else f"<br/><span>{word}</span>"
    shown = escape(name)
    return (
        f'<section {attributes} data-state="{state}">'
        f'<span class="name" title="{shown}"><bdi>{shown}</bdi></span><div>{track}</div>'
        f'<span class="value">{value}{below}</span></section>'
    )


def _track(share: float, state: str, labels: dict[float, str]) -> str:
    """A track with a mark at a share of it, and labels below."""
    mark, colour = _MARKS[state]
    at = 100.0 * float(np.clip(share, -_OVER, 1.0 + _OVER))
    below = "".join(f'<small style="left:{100.0 * x:g}%">{t}</small>' for x, t in labels.items())
    return (
        f'<div class="track" data-x="{at:.2f}"><b style="left:{at:.2f}%;color:{colour}">{mark}</b>'
        f"{below}</div>"
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


def _value(position: float, hinge: bool, digits: int | None = None) -> str:
    number = np.degrees(position) if hinge else position
    places = (1 if hinge else 3) if digits is None else digits
    text = f"{round(float(number), places) + 0.0:.{places}f}".replace("-", "−")
    return f"{text}°" if hinge else f"{text} m"

"""The roll as a dial (SVG)."""

from __future__ import annotations

import math

from qp_twist.viewing.bars import FREE, INK, QUIET, TRACK

_SIZE = 112.0


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
            f'stroke="#9ca3af" stroke-width="{1.6 if degrees % 90 == 0 else 0.9}"/>'
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
        f'<circle cx="{middle:g}" cy="{middle:g}" r="{radius:g}" fill="white" stroke="{TRACK}" '
        f'stroke-width="2"/>{"".join(marks)}{labels}'
        f'<line x1="{middle - 8 * c:.2f}" y1="{middle - 8 * s:.2f}" '
        f'x2="{middle + (radius - 9) * c:.2f}" y2="{middle + (radius - 9) * s:.2f}" '
        f'stroke="{FREE}" stroke-width="3.4" stroke-linecap="round"/>'
        f'<circle cx="{middle:g}" cy="{middle:g}" r="4" fill="{INK}"/>'
        f'<text x="{middle:g}" y="{_SIZE + 14:g}" font-size="12" font-weight="600" '
        f'text-anchor="middle">roll {degrees_text}</text></svg>'
    )

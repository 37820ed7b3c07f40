"""GOFWD of APT: a motion along a circle up to a line."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.apt_frames import Frames
from qp_twist.paths.apt_statements import Statement, number, unit_vector
from qp_twist.paths.arcs import Arc, angle_between, check_radii

_ALONG = re.compile(r"\(?CIRCLE/([^()/]*?)\)?,ON(,2,INTOF)?,\(?LINE/([^()/]*?)\)?")
_ON = 2e-5
"""How near to a circle a point is on it, m."""


def arc_to_line(
    of: Statement,
    start: Array | None,
    heading: Sequence[float] | None,
    frames: Frames,
    scale: float,
) -> Arc:
    """The arc of GOFWD from where the tool is, m, (3,), begun in the direction of INDIRV.

    The numbers are in ``frames``, ``scale`` metres each.

    Raises:
        InvalidInput: If it is another motion, or the start or the heading is not known, or that is
            more than 60° from the circle, or the line does not cross it, or ends on it elsewhere.
    """
    circle, line, count = _stated(of)
    if start is None or heading is None:
        lacking = "a GOTO" if start is None else "an INDIRV"
        raise InvalidInput(f"GOFWD: expected {lacking} before it")
    centre, radius = scale * frames.point(circle[:3]), scale * circle[-1]
    axis = unit_vector("GOFWD", circle[3:6] if len(circle) == 7 else [0.0, 0.0, 1.0])
    axis = np.array(frames.vector(axis))
    # A circle without an axis is a cylinder along z: the arc is at the height of the tool.
    centre = centre + axis * float((start - centre) @ axis)
    way = np.array(frames.vector(heading[:3]))
    tangent = np.cross(axis, start - centre)
    lengths = float(np.linalg.norm(tangent) * np.linalg.norm(way))
    cosine = float(tangent @ way) / lengths if lengths > 0.0 else 0.0
    if abs(cosine) < 0.5:
        raise InvalidInput(
            "GOFWD: INDIRV is not along the circle where the tool is, so which way round is open"
        )
    axis = math.copysign(1.0, cosine) * axis
    check_radii(start, start, centre, axis, radius)
    points = (scale * frames.point(line[k : k + 3]) for k in (0, 3))
    one, two = (p - axis * float((p - centre) @ axis) for p in points)
    along = two - one
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        raise InvalidInput("GOFWD: the two points of LINE are the same")
    along /= length
    foot = one + along * float((centre - one) @ along)
    square = radius**2 - float((foot - centre) @ (foot - centre))
    if square <= 0.0:
        raise InvalidInput("GOFWD: LINE does not cross the circle")
    crossings = [foot + side * math.sqrt(square) * along for side in (1.0, -1.0)]
    sweeps = [
        2.0 * math.pi if np.linalg.norm(p - start) < _ON else angle_between(start, p, centre, axis)
        for p in crossings
    ]
    at = int(np.argsort(sweeps, kind="stable")[count - 1])
    end = crossings[at]
    on_circle = abs(float(np.linalg.norm(two - centre)) - radius) < _ON
    if on_circle and np.linalg.norm(two - end) > 2.0 * _ON:
        raise InvalidInput(
            "GOFWD: the second point of LINE is on the circle, but the motion crosses the line at "
            f"another point {'first' if count == 1 else 'the second time'}; which one ends it is "
            "open"
        )
    return Arc(start, end, centre, axis, sweeps[at])


def _stated(of: Statement) -> tuple[list[float], list[float], int]:
    """Numbers of the circle and of the line, and which crossing of the line ends the motion."""
    match = _ALONG.fullmatch(re.sub(r"\s", "", of.rest.upper()))
    if match is None:
        raise InvalidInput(
            "GOFWD is a move along a surface, of which (CIRCLE/x,y,z,r),ON,(LINE/…) with six "
            "numbers is read; write the path as GOTO lines (in the CAM system: linear output)"
        )
    for text, counts in ((match[1], (4, 7)), (match[3], (6,))):
        if text.count(",") + 1 not in counts:
            expected = " or ".join(map(str, counts))
            raise InvalidInput(f"GOFWD: expected {expected} numbers, got {shortened(text)!r}")
    circle, line = ([number("GOFWD", w) for w in text.split(",")] for text in match.group(1, 3))
    return circle, line, 2 if match[2] else 1

"""Motions along a circle up to a line, as APT states them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import arc_sweep, check_radii

_ON = 2e-5
"""How near to a circle a point is on it, m."""


def sense_of_motion(heading: Array, axis: Array, radial: Array) -> float:
    """1 if a motion begins right-handed about an axis, −1 if left-handed.

    Args:
        heading: Direction of the motion, (3,).
        axis: Of the circle, (3,).
        radial: From the centre to where the motion begins, (3,).

    Raises:
        InvalidInput: If the heading is more than 60° from the circle.
    """
    tangent = np.cross(axis, radial)
    lengths = float(np.linalg.norm(tangent) * np.linalg.norm(heading))
    cosine = float(tangent @ heading) / lengths if lengths > 0.0 else 0.0
    if abs(cosine) < 0.5:
        raise InvalidInput(
            "INDIRV is not along the circle where the tool is, so which way round is open"
        )
    return math.copysign(1.0, cosine)


def crossing(
    start: Array, centre: Array, axis: Array, radius: float, points: Sequence[Array], count: int
) -> tuple[Array, float]:
    """The point where a motion along a circle crosses a line for the ``count``-th time.

    Args:
        start: Where it begins, m, (3,).
        centre: Of the circle, m, (3,).
        axis: About which the motion is right-handed, unit vector, (3,).
        radius: Of the circle, m.
        points: Two points of the line, m.
        count: Which crossing ends the motion, from 1.

    Returns:
        The point, and the angle up to it, rad.

    Raises:
        InvalidInput: If the line does not cross the circle, or ends on it elsewhere.
    """
    check_radii(start, start, centre, axis, radius)
    one, two = (p - axis * float((p - centre) @ axis) for p in points)
    along = two - one
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        raise InvalidInput("the two points of LINE are the same")
    along /= length
    foot = one + along * float((centre - one) @ along)
    square = radius**2 - float((foot - centre) @ (foot - centre))
    if square <= 0.0:
        raise InvalidInput("LINE does not cross the circle")
    crossings = [foot + side * math.sqrt(square) * along for side in (1.0, -1.0)]
    sweeps = [
        2.0 * math.pi if np.linalg.norm(p - start) < _ON else arc_sweep(start, p, centre, axis)
        for p in crossings
    ]
    at = sorted((0, 1), key=lambda k: sweeps[k])[count - 1]
    end, sweep = crossings[at], sweeps[at]
    if abs(float(np.linalg.norm(two - centre)) - radius) < _ON and np.linalg.norm(two - end) > (
        2.0 * _ON
    ):
        raise InvalidInput(
            "the second point of LINE is on the circle, but the motion crosses the line at "
            f"another point {'first' if count == 1 else 'the second time'}; which one ends it is "
            "open"
        )
    return end, sweep

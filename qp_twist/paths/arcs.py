"""Circular arcs and helices as polygons with a stated chord error.

Points are in m, (3,); axes, normals and directions are unit vectors, (3,).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath import SAME_POINT

ArcAxis = Literal["right", "left"]
"""Sense of the motion about the axis of ``CIRCLE``: right-handed or left-handed."""
ARC_ERROR = 1e-5
"""Largest distance between an arc and its polygon, unless another is given, m."""
_LARGEST_STEP = math.radians(10.0)
"""Largest angle of one chord, whatever the error."""
_OFF_CIRCLE = (2e-5, 1e-3)
"""How far the ends may be from the circle as programs round them: m, or a share of the radius."""
_LARGEST_RADIUS = 1e6
"""Beyond it, m, rounding moves the points of an arc by more than a nanometre."""
LARGEST_TURN = 36_000.0
"""Largest angle of an arc, or turn of a rotary axis in a cut, degrees: beyond it, one is wrong."""
MOST_POINTS = 1_000_000
"""Largest number of points of a file, those of its divided arcs and turns included."""
_ON_A_LINE = 1e-9
"""Sine of the angle between the chords of an arc below which its points are on a line."""
_CLOSED = 1e-9
"""An end nearer to the start, m, is the start: the arc is a full circle."""
_IN_LINE = 1e-9
"""Cuts that turn by less than this angle, rad, have no corner."""
_UNCLEAR = 5e-6
"""An end nearer to the start, m, but not on it, may be a full circle or almost none."""


class Arc(NamedTuple):
    """A motion along a circle or a helix, right-handed about its axis by an angle, rad."""

    start: Array
    end: Array
    centre: Array
    axis: Array
    sweep: float

    @classmethod
    def between(
        cls, start: Array, end: Array, centre: Array, axis: Array, radius: float | None = None
    ) -> Arc:
        """The arc from one point of a circle to another; a full circle if both are the same.

        ``radius`` is that which the file states, m.

        Raises:
            InvalidInput: If the points are not on one circle, or so close together that a full
                circle and none look alike.
        """
        check_radii(start, end, centre, axis, radius)
        return cls(start, end, centre, axis, angle_between(start, end, centre, axis))

    @classmethod
    def through(cls, start: Array, via: Array, end: Array) -> Arc | None:
        """The arc from a point through another to a third, m; ``None`` on a straight line.

        Raises:
            InvalidInput: If two points are the same, or the line goes back.
        """
        u, v = via - start, end - via
        normal, sizes = cross(u, v), _length(u) * _length(v)
        if sizes < SAME_POINT**2 or _length(end - start) < SAME_POINT:
            raise InvalidInput(
                "two points of the arc are the same, so that its circle is not known"
            )
        if _length(normal) < _ON_A_LINE * sizes:
            if u @ v < 0.0:
                raise InvalidInput("the points of the arc are on a line, and not in its order")
            return None
        # The centre is equally far from the three points, in their plane.
        right = [u @ (start + via) / 2.0, v @ (via + end) / 2.0, normal @ start]
        centre = np.linalg.solve(np.array([u, v, normal]), right)
        return cls.between(start, end, centre, normal / _length(normal))

    @classmethod
    def tangent(cls, start: Array, end: Array, heading: Array, normal: Array) -> Arc:
        r"""The arc, or helix, that continues a direction h in the plane with the normal n.

        With the chord :math:`\mathbf d` and :math:`\mathbf s = \mathbf n \times \mathbf h`, the
        centre is :math:`\mathbf d^2 / (2\, \mathbf d \cdot \mathbf s)` along s.

        Raises:
            InvalidInput: If the end is straight on.
        """
        chord, side = _radial(end - start, normal), cross(normal, heading)
        across = float(chord @ side)
        if abs(across) < _CLOSED:
            raise InvalidInput("CT: its end is straight on, so it is no arc")
        centre = start + side * float(chord @ chord) / (2.0 * across)
        return cls.between(start, end, centre, math.copysign(1.0, across) * normal)

    def points(self, error: float = ARC_ERROR) -> tuple[Array, Array]:
        r"""Points so dense that chords stay within an error of the arc.

        The chord of an angle δ is :math:`2 r \sin^2(\delta/4)` away from an arc of radius r. The
        distances of the two ends from the axis, and their heights along it, are interpolated in
        proportion to the angle.

        Args:
            error: Largest distance of a chord from the arc, m.

        Returns:
            Points without ``start``, the last of them ``end``, m, (N, 3); and their shares of the
            angle, (N,).

        Raises:
            InvalidInput: If there are more than :data:`MOST_POINTS`.
        """
        s, e = self.start - self.centre, self.end - self.centre
        u = _radial(s, self.axis)
        r_start, r_end = _length(u), _length(_radial(e, self.axis))
        u = u / r_start
        largest = max(r_start, r_end)
        step = min(_LARGEST_STEP, 4.0 * math.asin(min(1.0, math.sqrt(0.5 * error / largest))))
        count = max(1, math.ceil(abs(self.sweep) / step * (1.0 - 1e-12)))
        if count == 1:
            return self.end[None], np.ones(1)
        if count > MOST_POINTS:
            raise InvalidInput(
                f"the arc has {count} chords within {1e3 * error:g} mm of it, and at most "
                f"{MOST_POINTS} points are read; allow a larger arc_error"
            )
        shares = np.arange(1, count + 1) / count
        radii = r_start + shares * (r_end - r_start)
        angles, rise = self.sweep * shares, float((e - s) @ self.axis)
        around = [
            radii * np.cos(angles),
            radii * np.sin(angles),
            float(s @ self.axis) + shares * rise,
        ]
        points = np.array(around).T @ np.array([u, cross(self.axis, u), self.axis]) + self.centre
        points[-1] = self.end
        return points, shares


def centre_of_radius(start: Array, end: Array, axis: Array, radius: float) -> Array:
    r"""Centre of a right-handed arc about an axis, of at most 180° for a radius above 0.

    .. math:: \mathbf c = \frac{\mathbf s + \mathbf e}{2}
        + \mathrm{sgn}(r) \sqrt{r^2 - d^2/4}\; \mathbf a \times \frac{\mathbf e - \mathbf s}{d}

    with e without its height above the start s along the axis a, and d the distance from s to e.

    Raises:
        InvalidInput: If the ends are at the same point, or further apart than twice the radius.
    """
    check_radius(radius)
    flat = end - axis * float((end - start) @ axis)
    chord = flat - start
    length = _length(chord)
    if length < 1e-7:
        raise InvalidInput("an arc with a radius R ends at its start; write a full circle by I, J")
    height = radius**2 - 0.25 * length**2
    if height < -1e-3 * radius**2 - 2e-5 * abs(radius):
        raise InvalidInput(
            f"the ends of the arc are {1e3 * length:.6g} mm apart, more than twice its radius, "
            f"{1e3 * abs(radius):.6g} mm"
        )
    side = math.copysign(math.sqrt(max(0.0, height)), radius) / length
    return 0.5 * (start + flat) + side * cross(axis, chord)


def cut_corner(
    before: Array, corner: Array, after: Array, kind: str, size: float
) -> tuple[Array, Arc | None]:
    r"""Where a corner between two straight cuts is left, and the arc tangent to both.

    An arc of radius r begins and ends :math:`r \tan(\varphi/2)` from the corner, φ the angle by
    which the path turns there; a chamfer is its chord.

    Args:
        before: Where the cut to the corner begins.
        corner: The corner.
        after: Where the cut from it ends.
        kind: What the size is: ``R`` the radius, ``C`` what a chamfer takes of each cut, ``CHF``
            its length.
        size: m, above 0.

    Returns:
        The point at which the first cut ends, (3,); the arc, or nothing if the cuts are in line.

    Raises:
        InvalidInput: If a cut is too short for it, or goes back.
    """
    lengths = [_length(end - corner) for end in (before, after)]
    if min(lengths) < _CLOSED:
        raise InvalidInput("a corner is cut between two motions, and one of them has no length")
    u, v = (before - corner) / lengths[0], (after - corner) / lengths[1]
    turn = math.pi - math.atan2(_length(cross(u, v)), float(u @ v))
    if turn < _IN_LINE:
        return corner, None
    if math.pi - turn < 1e-6:
        raise InvalidInput("a corner is cut where the path goes back, which leaves it open")
    back = {
        "R": size * math.tan(0.5 * turn), "C": size, "CHF": 0.5 * size / math.cos(0.5 * turn),
    }[kind]  # fmt: skip
    if back > min(lengths) * (1.0 + 1e-9):
        raise InvalidInput(
            f"the corner takes {1e3 * back:.6g} mm of cuts that are {1e3 * lengths[0]:.6g} mm and "
            f"{1e3 * lengths[1]:.6g} mm long"
        )
    axis = cross(v, u)
    axis /= _length(axis)
    start = corner + back * u
    centre = start + back / math.tan(0.5 * turn) * cross(axis, -u)
    return start, Arc(start, corner + back * v, centre, axis, turn)


def angle_between(start: Array, end: Array, centre: Array, axis: Array) -> float:
    r"""Angle of the right-handed rotation about an axis from one point to another.

    .. math:: \varphi = \mathrm{atan2}(\mathbf a \cdot (\mathbf s \times \mathbf e),\;
        \mathbf s \cdot \mathbf e) \bmod 2\pi

    with s and e from the centre to the start and the end, without their parts along the unit vector
    a of the axis.

    Returns:
        φ in (0, 2π]; 2π if both points are the same.

    Raises:
        InvalidInput: If the points are so close together that a full circle and none look alike.
    """
    s, e = _from_axis(start, centre, axis), _from_axis(end, centre, axis)
    apart = math.dist(e, s)
    if apart < _CLOSED:
        return 2.0 * math.pi
    if apart < _UNCLEAR:
        raise InvalidInput(
            f"the arc ends {1e3 * apart:.2g} mm from its start, which may be a full circle or "
            "nearly none; end it at its start, or leave it out"
        )
    (s0, s1, s2), (e0, e1, e2), (a0, a1, a2) = s, e, axis.tolist()
    across = a0 * (s1 * e2 - s2 * e1) + a1 * (s2 * e0 - s0 * e2) + a2 * (s0 * e1 - s1 * e0)
    angle = math.atan2(across, s0 * e0 + s1 * e1 + s2 * e2)
    return angle if angle > 0.0 else angle + 2.0 * math.pi


def check_radii(start: Array, end: Array, centre: Array, axis: Array, radius: float | None) -> None:
    """Refuse an arc whose ends are not on one circle.

    Raises:
        InvalidInput: If a distance from the axis differs from the others by more than 0.02 mm and
            by more than 0.1 %, or the radius is zero or more than 1000 km.
    """
    r_start, r_end = (math.hypot(*_from_axis(p, centre, axis)) for p in (start, end))
    check_radius(max(r_start, r_end, abs(radius or 0.0)))
    radii = [r_start, r_end] if radius is None else [r_start, r_end, radius]
    if min(radii) < 1e-9:
        raise InvalidInput("the arc has the radius zero")
    if max(radii) - min(radii) > max(_OFF_CIRCLE[0], _OFF_CIRCLE[1] * max(radii)):
        stated = "" if radius is None else f", and the radius is {1e3 * radius:.6g} mm"
        raise InvalidInput(
            f"the arc starts {1e3 * r_start:.6g} mm from its centre and ends {1e3 * r_end:.6g} mm "
            f"from it{stated}; expected the same distance"
        )


def check_radius(radius: float) -> None:
    """Refuse a radius, m, with which coordinates would be rounded.

    Raises:
        InvalidInput: If it is more than 1000 km, or no number.
    """
    if not abs(radius) <= _LARGEST_RADIUS:
        raise InvalidInput(
            f"the arc has a radius above {_LARGEST_RADIUS:g} m; write a straight motion, or check "
            "its centre"
        )


def cross(a: Array, b: Array) -> Array:
    """The cross product of two vectors, (3,), without the time that numpy's takes for any shape."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _from_axis(point: Array, centre: Array, axis: Array) -> tuple[float, float, float]:
    """The way to a point from an axis through a centre, as numbers: thrice as fast as arrays."""
    (x, y, z), (a, b, c) = (point - centre).tolist(), axis.tolist()
    along = x * a + y * b + z * c
    return x - along * a, y - along * b, z - along * c


def _length(vector: Array) -> float:
    return math.hypot(*vector.tolist())


def _radial(vector: Array, axis: Array) -> Array:
    """The part of a vector perpendicular to an axis."""
    return vector - axis * float(vector @ axis)

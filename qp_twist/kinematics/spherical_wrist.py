"""Six axes of which the last three meet in a point: eight branches in closed form (Pieper)."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics.subproblems import (
    NEARLY,
    OBLIQUE,
    Axes,
    about,
    distant,
    dot,
    each,
    meeting_point,
    miss,
    norm,
    projected,
    rotated,
    sine_between,
    turned,
)

# Arrays of vectors are (3, K) or (3, K, B), of angles (K, B): B branches.


def kinds_of(axes: Axes) -> list[str]:
    """How the first three axes may be solved, if the last three meet in a point.

    ``"12"`` or ``"23"`` if these two meet, ``"1∥2"`` or ``"2∥3"`` if they are parallel.
    """
    centre = meeting_point(axes, (3, 4, 5))
    oblique = all(sine_between(axes, a, a + 1).min() > OBLIQUE for a in (3, 4))
    if not oblique or max(miss(axes, k, centre).max() for k in (3, 4, 5)) > NEARLY:
        return []
    kinds = []
    for a in (0, 1):
        sine = sine_between(axes, a, a + 1)
        if sine.max() < NEARLY:
            if sine_between(axes, 1 - a, 2 - a).min() > OBLIQUE:
                kinds.append(f"{a + 1}∥{a + 2}")
        elif sine.min() > OBLIQUE:
            centre = meeting_point(axes, (a, a + 1))
            if max(miss(axes, k, centre).max() for k in (a, a + 1)) < NEARLY:
                kinds.append(f"{a + 1}{a + 2}")
    return kinds


def solved(axes: Axes, kind: str, turn: Array, move: Array) -> Array:
    """Angles of the six hinges, (6, K, 8), for e1 … e6 = (turn (K, 3, 3), move (K, 3))."""
    z, centre = axes.directions[..., None], meeting_point(axes, (3, 4, 5))
    target = (turned(turn, centre) + move.T)[..., None]
    regional = _last_two_parallel if "∥" in kind else _last_two_meet
    if kind.startswith("2"):
        one, two, three = regional(axes, centre[..., None], target)  # (K, 4) each
    else:  # the first two: e3⁻¹ e2⁻¹ e1⁻¹ t = p is of the same form, with axes −ξ3, −ξ2, −ξ1
        mirrored = Axes(-axes.directions[2::-1], axes.anchors[2::-1])
        three, two, one = regional(mirrored, target, centre[..., None])
    # What the last three have to add: R = (e1 e2 e3)⁻¹ turn, applied to two vectors.
    five, six = (turned(turn, axes.directions[k])[..., None] for k in (4, 5))
    for j, angle in ((0, one), (1, two), (2, three)):
        five, six = (rotated(z[j], -angle, vector) for vector in (five, six))
    bend = each(projected(z[4], z[5], z[3], dot(z[3], six)))
    one, two, three = (np.repeat(angle, 2, axis=1) for angle in (one, two, three))
    five, six = (np.repeat(vector, 2, axis=2) for vector in (five, six))
    four = about(z[3], rotated(z[4], bend, z[5]), six)
    rest = rotated(z[4], -bend, rotated(z[3], -four, five))
    last = about(z[5], z[4], rest)
    return np.stack([one, two, three, four, bend, last])


def _last_two_meet(axes: Axes, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """The target's distance from where axes 2 and 3 meet depends on q₁ only."""
    z, a = axes.directions[..., None], axes.anchors[..., None]
    m = meeting_point(axes, (1, 2))[..., None]
    one = each(distant(-z[0], a[0], t, m, norm(p - m)))
    # R(z₂, q₂) R(z₃, q₃) v = u
    v, u = np.broadcast_arrays(p - m, rotated(z[0], -one, t - a[0]) + a[0] - m)
    three = each(projected(z[2], v, z[1], dot(z[1], u)))
    turned = rotated(z[2], three, np.repeat(v, 2, axis=2))
    two = about(z[1], turned, np.repeat(u, 2, axis=2))
    return np.repeat(one, 2, axis=1), two, three


def _last_two_parallel(axes: Axes, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """The target's height along axes 2 and 3 depends on q₁ only."""
    z, a = axes.directions[..., None], axes.anchors[..., None]
    one = each(projected(-z[0], t - a[0], z[1], dot(z[1], p - a[0])))
    y = np.repeat(rotated(z[0], -one, t - a[0]) + a[0] - a[1], 2, axis=2)
    three = each(distant(z[2], a[2], p, a[1], norm(y[..., ::2])))
    x = rotated(z[2], three, p - a[2]) + a[2] - a[1]
    return np.repeat(one, 2, axis=1), about(z[1], x, y), three

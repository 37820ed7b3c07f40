"""Six axes of which the last two meet: three parallel axes before them, or one polynomial."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics.subproblems import (
    NEARLY,
    OBLIQUE,
    Axes,
    about,
    cross,
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

ROOTS = 16
"""Solutions of six hinges, complex ones included (Primrose, 1986): roots of the polynomial."""
PLANAR, NEARLY_PLANAR = "2∥3∥4", "2∥3∥4≈"
"""Three parallel axes, and three that are so up to :data:`NEARLY` only."""
_ROUNDED = 1e-4
"""Axes that miss each other by less meet, m, or are parallel, rad, but for rounding: a model with
1.57 in place of π/2 is beyond, one with 1.5708 is not."""
_NODES = 2.0 * np.pi * np.arange(ROOTS + 1) / (ROOTS + 1)
"""Values of q₁ that determine a trigonometric polynomial of degree 8, which has 17 coefficients."""
_REAL = 1e-2
"""Distance from the unit circle up to which a root may be a real angle. Double roots are rounded by
up to 1e-4; what is none is left by the correction that follows."""
_FITS = 1e-2
"""Residual up to which the other candidates of a root are tried: where roots nearly coincide, each
may belong to several branches."""


def kinds_of(axes: Axes) -> list[str]:
    """How the axes may be solved, if the last two meet.

    :data:`PLANAR` if the three before them are parallel, else ``"2∥3"`` or ``"23"`` if these two
    are parallel or meet.
    """
    p = meeting_point(axes, (4, 5))
    parallel, next_to = sine_between(axes, 1, 2).max(), sine_between(axes, 2, 3)
    aside = miss(axes, 4, p).max()
    if sine_between(axes, 4, 5).min() < OBLIQUE or aside > NEARLY:
        return []
    if max(parallel, next_to.max()) < NEARLY:
        oblique = min(sine_between(axes, a, a + 1).min() for a in (0, 3)) > OBLIQUE
        exact = max(parallel, next_to.max(), aside) < _ROUNDED
        return [PLANAR if exact else NEARLY_PLANAR] if oblique else []
    if aside > _ROUNDED or miss(axes, 3, p).min() < NEARLY:  # or the wrist is nearly spherical
        return []
    if parallel < _ROUNDED:
        return ["2∥3"] if next_to.min() > OBLIQUE else []
    m = meeting_point(axes, (1, 2))
    meet = sine_between(axes, 1, 2).min() > OBLIQUE and miss(axes, 1, m).max() < _ROUNDED
    return ["23"] if meet and miss(axes, 3, m).min() > NEARLY else []


def solved(axes: Axes, kind: str, turn: Array, move: Array) -> Array:
    """Angles of the six hinges for e1 … e6 = (turn (K, 3, 3), move (K, 3)).

    (6, K, 8) with three parallel axes, else (6, K, 64), of which at most 16 are solutions.
    """
    p = meeting_point(axes, (4, 5))
    z, t = axes.directions[..., None], (turned(turn, p) + move.T)[..., None]
    five, six = (turned(turn, axes.directions[k])[..., None] for k in (4, 5))
    if kind.startswith(PLANAR):
        return _three_parallel(axes, p[..., None], t, five, six)
    arm = _Polynomial(axes, kind, p[..., None], t, six)
    one, two, three, four = arm.regional(arm.roots())
    # R5 R6 = (R1 R2 R3 R4)⁻¹ turn, applied to two vectors.
    for j, angle in enumerate((one, two, three, four)):
        five, six = (rotated(z[j], -angle, vector) for vector in (five, six))
    bend = about(z[4], np.broadcast_to(z[5], six.shape), six)
    last = about(z[5], z[4], rotated(z[4], -bend, five))
    return np.stack([one, two, three, four, bend, last])


def _three_parallel(axes: Axes, p: Array, t: Array, five: Array, six: Array) -> Array:
    """Heights along the parallel axes give q₁ and q₅; what is left is a planar arm of three."""
    z, a = axes.directions[..., None], axes.anchors[..., None]
    one = each(projected(-z[0], t - a[0], z[1], dot(z[1], p - a[0])))
    five, six = (rotated(z[0], -one, vector) for vector in (five, six))
    bend = each(projected(z[4], z[5], z[1], dot(z[1], six)))
    one, five, six = (np.repeat(part, 2, axis=-1) for part in (one, five, six))
    planar = about(z[1], rotated(z[4], bend, z[5]), six)  # q₂ ± q₃ ± q₄
    last = about(z[5], z[4], rotated(z[4], -bend, rotated(z[1], -planar, five)))
    y = rotated(z[0], -one, t - a[0]) + a[0] - rotated(z[1], planar, p - a[3]) - a[1]
    three = each(distant(z[2], a[2], a[3], a[1], norm(y)))
    one, bend, last, planar = (np.repeat(part, 2, axis=1) for part in (one, bend, last, planar))
    x = rotated(z[2], three, a[3] - a[2]) + a[2] - a[1]
    two = about(z[1], x, np.repeat(y, 2, axis=2))
    third, fourth = (np.sign(dot(z[1], z[k])) for k in (2, 3))  # they may be antiparallel
    return np.stack([one, two, three, fourth * (planar - two - third * three), bend, last])


class _Lines(NamedTuple):
    """A cos q + B sin q = C, and g₀ + g₁ cos q + g₂ sin q = 0."""

    A: Array
    B: Array
    C: Array
    g0: Array
    g1: Array
    g2: Array
    scale: Array

    def resultant(self) -> Array:
        """0 where a point of the unit circle is on both lines: where these cross, homogeneously."""
        A, B, C, g0, g1, g2, scale = self
        return ((B * g0 + C * g2) ** 2 + (A * g0 + C * g1) ** 2 - (A * g2 - B * g1) ** 2) / scale

    def points(self) -> list[tuple[Array, Array, Array]]:
        """Both points of the circle on the first line, and how far they are from the second."""
        size = np.abs(self.g0) + np.abs(self.g1) + np.abs(self.g2)
        found = _on_circle(self.A, self.B, self.C)
        return [(c, s, np.abs(self.g0 + self.g1 * c + self.g2 * s) / size) for c, s in found]


class _Polynomial:
    r"""The equation for q₁, if axes 5 and 6 meet in p, and axes 2 and 3 are parallel or meet.

    With q₁, :math:`\mathbf u = e^{-[\xi_1]q_1}\mathbf t` and
    :math:`\mathbf k = \mathbf R_1^T \mathbf R \mathbf z_6` are known, and

    .. math:: e^{[\xi_2]q_2} e^{[\xi_3]q_3} e^{[\xi_4]q_4} \mathbf p = \mathbf u, \qquad
        \mathbf z_5 \cdot (\mathbf R_2 \mathbf R_3 \mathbf R_4)^T \mathbf k
        = \mathbf z_5 \cdot \mathbf z_6 .

    What axes 2 and 3 do not change of u (its height along them, or its distance from where they
    meet) gives two values of q₄. For each, the other two coordinates of u and the second equation
    are linear in the cosine and sine of one further angle; their resultant is 0 for solutions. Its
    product over both q₄ is a trigonometric polynomial of degree 8 in q₁.
    """

    def __init__(self, axes: Axes, kind: str, p: Array, t: Array, six: Array) -> None:
        self.z, self.a = axes.directions[..., None], axes.anchors[..., None]
        self.parallel, self.p, self.t, self.six = kind == "2∥3", p, t, six
        self.m = self.a[1] if self.parallel else meeting_point(axes, (1, 2))[..., None]

    def roots(self) -> Array:
        """The real roots q₁, in rad, ascending, (K, 16), some of them perhaps only nearly real."""
        values = np.prod([lines.resultant() for *_, lines in self._lines(_NODES)], axis=0).real
        terms = np.fft.fft(np.broadcast_to(values, (self.t.shape[1], ROOTS + 1)), axis=1)
        terms = np.roll(terms, ROOTS // 2, axis=1)  # of z⁻⁸ … z⁸, z = exp(i q₁)
        companion = np.zeros((len(terms), ROOTS, ROOTS), dtype=complex)
        companion[:, np.arange(1, ROOTS), np.arange(ROOTS - 1)] = 1.0
        companion[:, :, -1] = -terms[:, :-1] / terms[:, -1:]
        found = np.linalg.eigvals(companion)
        with np.errstate(divide="ignore"):
            real = np.abs(np.log(np.abs(found))) < _REAL
        return np.sort(np.where(real, np.angle(found), np.nan), axis=1)

    def regional(self, one: Array) -> tuple[Array, Array, Array, Array]:
        """q₁ … q₄ of the four candidates of each root q₁ (K, 16), (K, 64) each, the best first.

        The others are NaN unless they fit, too, as where branches have the same root.
        """
        every = np.array(
            [
                np.broadcast_arrays(c4, s4, c, s, misses)
                for c4, s4, lines in self._lines(one)
                for c, s, misses in lines.points()
            ]
        )
        order = np.argsort(every[:, 4].real, axis=0)[:, None]  # NaN come last
        every = np.concatenate(list(np.take_along_axis(every, order, axis=0)), axis=2)
        c4, s4, c, s, misses = every
        one = np.tile(one, 4)
        one[:, ROOTS:][misses[:, ROOTS:].real > _FITS] = np.nan
        return one, *self._two_and_three(one, _angle(c4, s4), _angle(c, s))

    def _two_and_three(self, one: Array, four: Array, angle: Array) -> tuple[Array, Array, Array]:
        """From q₁, q₄ and the angle of the lines."""
        z, a = self.z, self.a
        u = rotated(z[0], -one, self.t - a[0]) + a[0] - self.m
        w = rotated(z[3], four, self.p - a[3]) + a[3]
        if self.parallel:  # the angle is q₂ ± q₃
            two = about(z[1], a[2] - a[1], u - rotated(z[1], angle, w - a[2]))
            return two, np.sign(dot(z[1], z[2])) * (angle - two), four
        return angle, about(z[2], w - self.m, rotated(z[1], -angle, u)), four

    def _lines(self, one: Array) -> list[tuple[Array, Array, _Lines]]:
        """For both values of q₄ its cosine and sine, which may be complex, and the lines."""
        z, a, gamma = self.z, self.a, dot(self.z[4], self.z[5])
        u = rotated(z[0], -one, self.t - a[0]) + a[0] - self.m
        k, d, f = rotated(z[0], -one, self.six), self.p - a[3], self.m - a[3]
        if self.parallel:  # z₂ · e4 p = z₂ · e1⁻¹ t
            target, value = z[1], dot(z[1], u + f)
        else:  # |e4 p − m| = |e1⁻¹ t − m|
            target, value = f, 0.5 * (dot(d, d) + dot(f, f) - dot(u, u))
        along = dot(target, z[3]) * dot(d, z[3])
        A, B = dot(target, d) - along, dot(target, cross(z[3], d))
        lines = self._parallel_lines if self.parallel else self._meeting_lines
        found = []
        for c, s in _on_circle(A, B, value - along):
            w, h = (_turned_by(z[3], c, s, vector) for vector in (d, z[4]))
            found.append((c, s, lines(u, k, w + a[3], h, gamma)))
        return found

    def _parallel_lines(self, u: Array, k: Array, w: Array, h: Array, gamma: Array) -> _Lines:
        """Of q₂ + q₃: axis 3 is carried by axis 2 on a circle, and h turns by that angle."""
        z, w, link = self.z[1], w - self.a[2], self.a[2] - self.a[1]
        u, w, link, k_across = (x - dot(x, z) * z for x in (u, w, link, k))
        C = 0.5 * (dot(u, u) + dot(w, w) - dot(link, link))
        g0 = dot(h, z) * dot(z, k) - gamma
        lines = dot(u, w), dot(z, cross(w, u)), C, g0, dot(k_across, h), dot(z, cross(h, k))
        return _Lines(*lines, np.ones(1))

    def _meeting_lines(self, u: Array, k: Array, w: Array, h: Array, gamma: Array) -> _Lines:
        """Of q₂: y = R₂ z₃ is at the same angle to u as z₃ to v = w − m.

        R₂R₃ takes v to u and z₃ to y, and with them h, in the basis v, z₃, v × z₃.
        """
        z2, z3, v = self.z[1], self.z[2], w - self.m
        flat, cosine, sine = dot(z2, z3), self.z[2] - dot(z2, z3) * z2, cross(z2, z3)
        v_z, h_z, h_v, v_v = dot(v, z3), dot(h, z3), dot(h, v), dot(v, v)
        gram = v_v - v_z * v_z
        turned_h = (h_z * v_v - h_v * v_z) * k + dot(h, cross(v, z3)) * cross(k, u)
        g0 = (h_v - h_z * v_z) * dot(k, u) - gamma * gram + flat * dot(turned_h, z2)
        first = dot(u, cosine), dot(u, sine), v_z - flat * dot(z2, u)
        return _Lines(*first, g0, dot(turned_h, cosine), dot(turned_h, sine), gram)


def _on_circle(A: Array, B: Array, C: Array) -> list[tuple[Array, Array]]:
    """Both points (c, s) of the unit circle with A c + B s = C; complex where it is too far."""
    size = A * A + B * B
    root = np.sqrt((size - C * C).astype(complex))
    with np.errstate(invalid="ignore", divide="ignore"):  # of what is no root
        return [((A * C - r * B) / size, (B * C + r * A) / size) for r in (root, -root)]


def _angle(c: Array, s: Array) -> Array:
    """The angle of a point (c, s); of two that are complex by rounding, one to each side.

    In the middle, where both are the same, the Jacobian is singular.
    """
    angle = -1j * np.log(c + 1j * s)
    return angle.real + angle.imag


def _turned_by(z: Array, c: Array, s: Array, x: Array) -> Array:
    """R(z, q) x with the cosine c and the sine s of q."""
    return x * c + cross(z, x) * s + z * (dot(z, x) * (1.0 - c))

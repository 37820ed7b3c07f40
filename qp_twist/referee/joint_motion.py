"""Joints that move in time between the rows of a trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, finite_array, float_array
from qp_twist.errors import InvalidInput

_HALVINGS = 50
"""Bisections by which a zero within a piece is found: its place is exact to 1e-15 of the piece."""
_ENDS = (np.zeros((1, 1)), np.ones((1, 1)))
"""Where a piece begins and ends, as shares of it."""
_NAMES = {1: "linear", 3: "cubic", 5: "quintic"}


class State(NamedTuple):
    """Where the joints are at a time, or at many: (nv,) or (K, nv) each."""

    q: Array
    """Positions, rad or m."""
    velocities: Array
    """Their first derivatives, rad/s or m/s."""
    accelerations: Array
    """Their second derivatives, rad/s² or m/s²."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    r"""Positions at times, and one polynomial in time between every two rows.

    Rows of positions are joined at constant speed (degree d = 1); with velocities every joint moves
    on the cubic with the position and velocity of both rows (d = 3); with accelerations, too, on
    the quintic with position, velocity and acceleration of both (d = 5). This is what ROS' joint
    trajectory controller does with the same rows.

    With :math:`T = t_{k+1} - t_k`, :math:`u = (t - t_k)/T` and :math:`D = (q_{k+1} - q_k)/T` the
    velocity is a polynomial in Bernstein form,

    .. math::

        \dot q = \sum_{i=0}^{d-1} w_i \binom{d-1}{i} u^i (1-u)^{d-1-i},
        \qquad \frac1d\sum_i w_i = D,

    with q̇ and q̈ of both rows at its ends, where the mean D determines the middle w. Positions and
    accelerations are its integral and its derivative.

    Attributes:
        times: Of the rows, s, (N,), increasing.
        q: Joint positions, rad or m, (N, nv).
        velocities: Joint velocities at the rows, rad/s or m/s, (N, nv), or ``None``.
        accelerations: Joint accelerations at the rows, rad/s² or m/s², (N, nv), or ``None``.
        points: Rows at which a controller makes a ramp of its own, from one move to the next, the
            first and the last row among them; ``None``: all rows.

    What has a wrong shape, fewer than two rows, times that do not increase, or accelerations
    without velocities is refused.
    """

    times: Array
    q: Array
    velocities: Array | None = None
    accelerations: Array | None = None
    points: Indices | None = None

    def __post_init__(self) -> None:
        q = finite_array("q", self.q, (None, None))
        if len(q) < 2:
            raise InvalidInput(f"q: expected at least two rows, got {len(q)}.")
        times = finite_array("times", self.times, (len(q),))
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if len(late):
            k = int(late[0])
            raise InvalidInput(
                f"times: row {k + 2} is at {times[k + 1]:.9g} s, row {k + 1} at {times[k]:.9g} s; "
                "times have to increase."
            )
        if self.velocities is not None:
            finite_array("velocities", self.velocities, q.shape)
        if self.accelerations is not None:
            finite_array("accelerations", self.accelerations, q.shape)
            if self.velocities is None:
                raise InvalidInput(
                    "accelerations: the rows have no velocities, so that no curve is defined; give "
                    "both or leave the accelerations out."
                )

    def __repr__(self) -> str:
        rows, joints = self.q.shape
        span = self.times[-1] - self.times[0]
        return f"JointMotion({rows} rows, {joints} joints, {span:.6g} s, {self.interpolation})"

    @property
    def degree(self) -> int:
        """Of the polynomials between the rows: 1, 3 or 5."""
        return 1 if self.velocities is None else 3 if self.accelerations is None else 5

    @property
    def interpolation(self) -> str:
        """``"linear"`` (constant speed from row to row), ``"cubic"`` or ``"quintic"``."""
        return _NAMES[self.degree]

    @property
    def middles(self) -> Array:
        """Times in the middle between rows, s, (N − 1,)."""
        return 0.5 * (self.times[:-1] + self.times[1:])

    def at(self, t: npt.ArrayLike) -> State:
        """The joints at a time or at many, s; before the first row and after the last they rest.

        Where q̇ or q̈ jumps at a row, it is that of the piece which begins there; at the last row
        that of the piece which ends.
        """
        when = float_array("t", t)
        places = np.atleast_1d(when)
        piece, u = self._places(places)
        w = self._speeds[:, piece]
        state = State(
            _value(self._positions(piece), u), _value(w, u), _value(self._changes[:, piece], u)
        )
        outside = (places < self.times[0]) | (places > self.times[-1])
        state.velocities[outside] = 0.0
        state.accelerations[outside] = 0.0
        return State(*(x[0] for x in state)) if when.ndim == 0 else state

    def extremes(self) -> tuple[Array, Array]:
        """Lowest and highest q of each piece, exactly, rad or m, (N − 1, nv) each."""
        pieces = np.arange(len(self.times) - 1)
        b = self._positions(pieces)
        found = np.array([b[0], b[-1], *(_value(b, u) for u in _zeros(self._speeds))])
        return found.min(axis=0), found.max(axis=0)

    def largest_speeds(self) -> Array:
        """Largest |q̇| of each piece between two rows, exactly, rad/s or m/s, (N − 1, nv)."""
        return _largest(self._speeds, [*_ENDS, *self._turning[0]])

    def largest_accelerations(self) -> Array:
        """Largest |q̈| of each piece, exactly, rad/s² or m/s², (N − 1, nv); 0 without velocities."""
        return _largest(self._changes, [*_ENDS, *self._turning[1]])

    def largest_jerks(self) -> Array:
        """Largest |q⃛| of each piece, exactly, rad/s³ or m/s³, (N − 1, nv); its jumps are no part.

        0 without velocities.
        """
        return _largest(self._jerks, [*_ENDS, *_zeros(np.diff(self._jerks, axis=0))])

    def bounds(self) -> tuple[Array, Array, Array]:
        """Bounds of |q̇|, |q̈| and |q⃛| of each piece, (N − 1, nv) each, at little cost.

        A polynomial lies between the least and the largest of its Bernstein coefficients.
        """
        speeds, changes, jerks = (
            np.abs(curve).max(axis=0) for curve in (self._speeds, self._changes, self._jerks)
        )
        return speeds, changes, jerks

    def largest_within(self, piece: Indices, begin: Array, end: Array) -> tuple[Array, Array]:
        """Largest |q̇| and |q̈| within parts of the pieces between rows, exactly, (K, nv) each.

        Args:
            piece: Index of the row before each part, (K,).
            begin: When the part begins, s, (K,), inside its piece.
            end: When it ends, s, (K,).
        """
        T = self._spans[piece]
        first, last = (
            np.clip((t - self.times[piece]) / T, 0.0, 1.0)[:, None] for t in (begin, end)
        )
        speeds, accelerations = (
            _largest(curve[:, piece], [first, last, *np.clip(turning[:, piece], first, last)])
            for curve, turning in zip((self._speeds, self._changes), self._turning, strict=True)
        )
        return speeds, accelerations

    @cached_property
    def _spans(self) -> Array:
        """Duration of each piece, s, (N − 1,)."""
        return np.diff(self.times)

    @cached_property
    def _speeds(self) -> Array:
        """w of each piece, rad/s or m/s, (d, N − 1, nv)."""
        T = self._spans[:, None]
        D = np.diff(self.q, axis=0) / T
        if self.velocities is None:
            return D[None]
        v0, v1 = self.velocities[:-1], self.velocities[1:]
        if self.accelerations is None:
            return np.stack([v0, 3.0 * D - v0 - v1, v1])
        near0 = v0 + self.accelerations[:-1] * T / 4.0
        near1 = v1 - self.accelerations[1:] * T / 4.0
        return np.stack([v0, near0, 5.0 * D - v0 - near0 - near1 - v1, near1, v1])

    @cached_property
    def _changes(self) -> Array:
        """Accelerations in Bernstein form, rad/s² or m/s², (max(d − 1, 1), N − 1, nv)."""
        w = self._speeds
        if len(w) == 1:
            return np.zeros_like(w)
        found: Array = (len(w) - 1) * np.diff(w, axis=0) / self._spans[:, None]
        if self.accelerations is not None:
            found[0], found[-1] = self.accelerations[:-1], self.accelerations[1:]
        return found

    @cached_property
    def _jerks(self) -> Array:
        """Jerks in Bernstein form, rad/s³ or m/s³, (max(d − 2, 1), N − 1, nv)."""
        changes = self._changes
        if len(changes) == 1:
            return np.zeros_like(changes)
        return (len(changes) - 1) * np.diff(changes, axis=0) / self._spans[:, None]

    @cached_property
    def _turning(self) -> tuple[Array, Array]:
        """Where speeds and where accelerations are extreme, as shares of pieces, (…, N − 1, nv)."""
        return _zeros(self._changes), _zeros(np.diff(self._changes, axis=0))

    def _positions(self, piece: Indices) -> Array:
        """Positions in Bernstein form, (d + 1, K, nv), from the nearer end: both are as stored."""
        steps = self._speeds[:, piece] * (self._spans[piece] / self.degree)[:, None]
        half = (self.degree + 1) // 2
        first = [*accumulate([self.q[piece], *steps[: half - 1]])]
        last = [*accumulate([self.q[piece + 1], *-steps[: half - 1 : -1]])]
        return np.array([*first, *last[::-1]])

    def _places(self, when: Array) -> tuple[Indices, Array]:
        """Index of the piece at each time, (K,), and how much of it is over, (K, 1)."""
        last = len(self.times) - 2
        piece = np.clip(np.searchsorted(self.times, when, side="right") - 1, 0, last)
        begin, end = self.times[piece], self.times[piece + 1]
        return piece, np.clip((when - begin) / (end - begin), 0.0, 1.0)[:, None]


def _largest(curve: Array, places: Sequence[Array]) -> Array:
    """Largest absolute value of Bernstein polynomials (m + 1, K, nv) at some places, (K, nv)."""
    return np.asarray(np.abs([_value(curve, u) for u in places]).max(axis=0))


def _value(curve: Array, u: Array) -> Array:
    """Bernstein polynomials (m + 1, K, nv) at u, (K, 1) or (K, nv).

    Horner's scheme in u and 1 − u: c₀ (1 − u)ᵐ + … + (m over k) cₖ uᵏ (1 − u)ᵐ⁻ᵏ + … + cₘ uᵐ.
    """
    degree = len(curve) - 1
    value, power, left = curve[0], np.ones_like(u), 1.0 - u
    for k in range(1, degree + 1):
        power = power * u
        value = value * left + math.comb(degree, k) * power * curve[k]
    return np.asarray(value)


def _zeros(curve: Array) -> Array:
    """Places in [0, 1] among which are all changes of sign of polynomials (m + 1, …), (m, …).

    Between two zeros of its derivative a polynomial is monotonic, so that bisection finds the one
    change of sign that may be there. Without one the place is any: its value is an inner one.
    """
    degree = len(curve) - 1
    if degree < 1:
        return np.zeros((0, *curve.shape[1:]))
    if degree == 1:
        fall = curve[0] - curve[1]
        place: Array = np.divide(curve[0], fall, out=np.zeros_like(fall), where=fall != 0.0)
        return place.clip(0.0, 1.0)[None]
    if degree == 2:
        bend, slope = curve[0] - 2.0 * curve[1] + curve[2], curve[1] - curve[0]
        root = np.sqrt(np.maximum(slope**2 - bend * curve[0], 0.0))
        half = -slope - np.where(slope < 0.0, -root, root)  # loses no digits
        pairs = (half, bend), (curve[0], half)
        found = [np.divide(a, b, out=np.zeros_like(a), where=b != 0.0) for a, b in pairs]
        return np.asarray(np.clip(found, 0.0, 1.0))
    ends = np.zeros((degree + 1, *curve.shape[1:]))
    ends[1:-1] = np.sort(_zeros(np.diff(curve, axis=0)), axis=0)
    ends[-1] = 1.0
    below = np.array([_value(curve, u) for u in ends]) < 0.0
    changes: Any = np.nonzero(below[:-1] != below[1:])  # few of the spans: only these are halved
    low, high, rising = ends[:-1][changes], ends[1:][changes], below[:-1][changes]
    curve = curve[(slice(None), *changes[1:])]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        near = (_value(curve, middle) < 0.0) == rising
        low, high = np.where(near, middle, low), np.where(near, high, middle)
    places: Array = ends[:-1]
    places[changes] = 0.5 * (low + high)
    return places

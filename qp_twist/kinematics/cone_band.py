"""A range for the angle between an axis of the body and a direction."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, number, unit_vector
from qp_twist.geometry import ProjectorKind, TwistProjector, cross, geodesic, perpendicular
from qp_twist.kinematics.frame_pair import FramePair, Stretch, angle_of_chord
from qp_twist.kinematics.tolerance_band import Range, ToleranceBand, keeps

FACES = 16
"""Number of sides of the polygon around a cone; its corners exceed the radius by 1/cos(π/16) − 1 =
2 %."""
_NO_SWING = 1e-12
"""Angle below which the direction of the swing is undefined, rad."""
_AROUND = 2.0 * math.pi / FACES * np.arange(FACES)
_COSINES, _SINES = np.cos(_AROUND), np.sin(_AROUND)


class ConeBand(ToleranceBand):
    r"""Keep the angle θ between an axis u of the body and a reference direction n in a range.

    A tilt of at most 5° is ``upper=radians(5)``; a lead angle of 20° ± 10° is ``lower=radians(10),
    upper=radians(30)``.

    The position of u around n is the plane vector x = θ e, e being the direction from n to u
    (azimuthal equidistant coordinates), k = n × e the axis of the swing:

    .. math::

        \dot{\mathbf x} = (\mathbf k\cdot\boldsymbol\omega)\,\mathbf e
        + \big(\theta\,(\mathbf n - \cot\theta\,\mathbf e)\cdot\boldsymbol\omega\big)\,\mathbf k

    A single row along e would let u leave the cone sideways, so the disc ‖x‖ ≤ upper is enclosed by
    a polygon of 16 rows (:doc:`/equations`). The lower end is one row along e: a sideways motion
    only moves u away from n. Beyond 90° the two exchange their roles.

    Arguments are the axis in the body and the reference, (3,) each, the largest angle, up to π, and
    the smallest, rad, and those of :class:`ToleranceBand`; what has the wrong type or range raises
    :class:`~qp_twist.InvalidInput`.
    """

    kind, unit, frames = "cone", "rad", ("target", "world")

    def __init__(
        self,
        axis: npt.ArrayLike,
        reference: npt.ArrayLike,
        upper: float,
        lower: float = 0.0,
        *,
        frame: Literal["target", "world"] = "target",
        weight: float | None = None,
        recovery_speed: float = 0.5,
    ) -> None:
        super().__init__(weight, recovery_speed, frame)
        self.axis = unit_vector("ConeBand(axis=…)", axis)
        self.reference = unit_vector("ConeBand(reference=…)", reference)
        upper = number("ConeBand(upper=…)", upper, above=0.0, at_most=math.pi)
        lower = number("ConeBand(lower=…)", lower, at_least=0.0)
        self.ranges = (Range.checked("ConeBand", lower, upper, "rad"),)

    def values(self, pair: FramePair) -> Array:
        """θ, rad, (1,)."""
        u, n = self._directions(pair)
        return np.asarray(np.linalg.norm(geodesic(n, u), axis=-1, keepdims=True))

    def gradients(self, pair: FramePair) -> Array:
        """(0, k), (1, 6): the fastest rotation of u away from n; an arbitrary one at 0 and at π."""
        u, n = self._directions(pair)
        axis, _, _ = _swing(u, n)
        return np.concatenate([np.zeros_like(axis), axis], axis=-1)[..., None, :]

    def rows(self, pair: FramePair, reach: float = math.inf) -> tuple[Array, Array]:
        """The polygon's sides and the lower end; see :meth:`ToleranceBand.rows`."""
        (u, n), [(lower, upper)] = self._directions(pair), self.ranges
        # θ lies between 0 and π: a bound there has no effect.
        sides = [(n, upper)] * (upper < math.pi) + [(-n, math.pi - lower)] * (lower > 0.0)
        rows = np.zeros((*u.shape[:-1], 1, FACES * len(sides), 6))
        rooms = np.zeros(rows.shape[:-1])
        for k, (axis, radius) in enumerate(sides):
            part = slice(FACES * k, FACES * (k + 1))
            rows[..., 0, part, 3:], rooms[..., 0, part] = _disc_rows(u, axis, radius, reach)
        return rows, rooms

    def carried(self, pair: FramePair) -> Array:
        """The target's rotation, if the reference rotates with it."""
        return pair.target_twist * ([0, 0, 0, 1, 1, 1] if self.frame == "target" else 0.0)

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """‖u − n‖ = 2 sin(θ/2) bounds θ from above, ‖u + n‖ = 2 cos(θ/2) from below."""
        ends = [self._directions(pair) for pair in (before, after)]
        off = stretch.off_chord_of_angle(target=self.frame == "target")

        def largest(side: float) -> Array:
            chords = np.max([np.linalg.norm(u + side * n, axis=1) for u, n in ends], axis=0)
            return angle_of_chord(chords + off)[:, None]

        return math.pi - largest(1.0), largest(-1.0)

    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Whether T fixes the angle: the whole rotation, or one of the two directions in both."""
        angular = projector.angular
        plane = angular.kind is ProjectorKind.PLANE and projector.frame != "world"
        held = plane and any(keeps(angular.complement, a) for a in (self.axis, self.reference))
        return (self.frame != "world" and (angular.kind is ProjectorKind.FULL or held),)

    def _directions(self, pair: FramePair) -> tuple[Array, Array]:
        """u and n, (3,) each, one of each for every frame."""
        u: Array = pair.rotation @ self.axis
        return u, np.broadcast_to(pair.axes(self.frame) @ self.reference, u.shape)

    def __repr__(self) -> str:
        axes = [axis.round(6).tolist() for axis in (self.axis, self.reference)]
        return self._named(f"{axes[0]} about {axes[1]}")


def _disc_rows(u: Array, n: Array, radius: float, reach: float) -> tuple[Array, Array]:
    """Rows on ω (16, 3) that keep the angle between u and the fixed n below a radius, rooms (16,).

    ``reach`` is the largest required return, rad: from further outside the disc shrinks by it.
    """
    k, e, angle = _swing(u, n)
    within = np.maximum(radius, angle - reach)
    swung = angle > _NO_SWING
    cotangent = np.where(swung, angle / np.tan(np.where(swung, angle, 1.0)), 1.0)  # θ cot θ
    sideways = angle[..., None] * n - cotangent[..., None] * e
    rows = _COSINES[:, None] * k[..., None, :] + _SINES[:, None] * sideways[..., None, :]
    rooms = within[..., None] - angle[..., None] * _COSINES
    # Beyond 90° a sideways motion moves u closer to n: the row along e is sufficient.
    rooms[..., 1:][np.maximum(angle, within) >= math.pi / 2] = math.inf
    return rows, rooms


def _swing(u: Array, n: Array) -> tuple[Array, Array, Array]:
    """k, the axis of the swing from n to u, e = k × n, (3,) each, and the angle, rad, ()."""
    swing = geodesic(n, u)
    angle = np.linalg.norm(swing, axis=-1)
    k = swing / np.where(angle > _NO_SWING, angle, 1.0)[..., None]
    undefined = angle <= _NO_SWING
    if undefined.any():
        k[undefined] = perpendicular(n[undefined])
    return k, cross(k, n), angle

"""A range for the angle between an axis of the body and a direction."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, number, one_of, unit_vector
from qp_twist.geometry import ProjectorKind, TwistProjector, geodesic
from qp_twist.geometry.projector import perpendicular
from qp_twist.geometry.twist_error import cross
from qp_twist.kinematics.tolerance_band import FramePair, Range, ToleranceBand, keeps

FACES = 16
"""Sides of the polygon around a cone; its corners stand out by 1/cos(π/16) − 1 = 2 %."""


class ConeBand(ToleranceBand):
    r"""Keep the angle θ between an axis u of the body and a reference direction n in a range.

    A tilt of at most 5° is ``upper=radians(5)``; a lead angle of 20° ± 10° is ``lower=radians(10),
    upper=radians(30)``.

    The position of u around n is the plane vector x = θ e, e being the direction from n to u
    (azimuthal equidistant coordinates), k = n × e the axis of the swing:

    .. math::

        \dot{\mathbf x} = (\mathbf k\cdot\boldsymbol\omega)\,\mathbf e
        + \big(\theta\,(\mathbf n - \cot\theta\,\mathbf e)\cdot\boldsymbol\omega\big)\,\mathbf k

    A single row along e would let u pass the cone sideways, far when it is near the middle. So the
    disc ‖x‖ ≤ upper is held by 16 rows, the sides of the polygon around it, one of them along e:
    a sideways motion t at the rim overshoots by t²/(2 upper), and never by more than the polygon's
    corners stand out. The lower end is one row along e: sideways u only moves away from n.
    Beyond 90° the two exchange their parts.
    """

    kind = "cone"

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
        """State a band.

        Args:
            axis: The axis in the body, shape (3,).
            reference: The direction around which the cone stands, shape (3,).
            upper: Largest angle, rad, up to π.
            lower: Smallest angle, rad.
            frame: What the reference is fixed to.
            weight: ``None`` for a hard band, else the weight of the soft one.
            recovery_speed: Largest speed of return that is demanded outside, rad/s.

        Raises:
            InvalidInput: If an argument is no such thing, or out of range.
        """
        super().__init__(weight, recovery_speed)
        self.axis = unit_vector("ConeBand(axis=…)", axis)
        self.reference = unit_vector("ConeBand(reference=…)", reference)
        upper = number("ConeBand(upper=…)", upper, above=0.0, at_most=math.pi)
        lower = number("ConeBand(lower=…)", lower, at_least=0.0)
        self.range = Range.checked("ConeBand", lower, upper, "rad")
        self.frame = one_of("ConeBand(frame=…)", frame, ("target", "world"))

    def angle(self, pair: FramePair) -> float:
        """θ, rad."""
        u, n = self._directions(pair)
        return float(np.linalg.norm(geodesic(n, u)))

    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """The polygon's sides and the lower end; see :meth:`ToleranceBand.half_spaces`."""
        blocks = [(np.zeros((0, 3)), np.zeros(0))]
        u, n = self._directions(pair)
        reach = self.recovery_speed * dt
        # θ is never above π nor below 0: an end there is none.
        if not self._fixed(projector) and self.range.upper < math.pi:
            blocks.append(disc_rows(u, n, self.range.upper, reach))
        if not self._fixed(projector) and self.range.lower > 0.0:
            blocks.append(disc_rows(u, -n, math.pi - self.range.lower, reach))
        gradients = np.vstack([rows for rows, _ in blocks])
        bounds = np.concatenate([rooms for _, rooms in blocks]) / dt
        if self.frame == "target":
            bounds = bounds + gradients @ pair.target_twist[3:]
        return np.hstack([np.zeros_like(gradients), gradients]), bounds

    def excess(self, pair: FramePair) -> float:
        """How far the angle is outside its range, rad; 0 inside."""
        return self.range.excess(self.angle(pair))

    def contradiction(self, projector: TwistProjector) -> str | None:
        """In words: the task holds the angle at a value which the range leaves out."""
        held = float(np.linalg.norm(geodesic(self.reference, self.axis)))
        if self._fixed(projector) and self.range.excess(held) > 1e-9:
            return f"it holds the angle at {math.degrees(held):.6g}°, outside the band"
        return None

    def _directions(self, pair: FramePair) -> tuple[Array, Array]:
        return pair.rotation @ self.axis, pair.axes(self.frame) @ self.reference

    def _fixed(self, projector: TwistProjector) -> bool:
        """Whether T holds the angle: all of the rotation, or one of the two directions in both."""
        if self.frame == "world":
            return False
        angular = projector.angular
        if angular.kind is ProjectorKind.FULL:
            return True
        return (
            angular.kind is ProjectorKind.PLANE
            and projector.frame != "world"
            and (keeps(angular.complement, self.axis) or keeps(angular.complement, self.reference))
        )

    def __repr__(self) -> str:
        lower, upper = np.degrees(self.range)
        return (
            f"ConeBand({self.axis.round(6).tolist()} about {self.reference.round(6).tolist()}, "
            f"{lower:.6g}°…{upper:.6g}°, frame={self.frame!r})"
        )


def disc_rows(u: Array, n: Array, radius: float, reach: float) -> tuple[Array, Array]:
    """Rows on ω (k, 3) that keep the angle between u and n within a radius, and the rooms (k,).

    Args:
        u: Unit vector that turns with ω.
        n: Unit vector that stays.
        radius: Largest angle, rad.
        reach: What recovery may demand, rad: from further outside the disc shrinks by this much.
    """
    swing = geodesic(n, u)
    angle = float(np.linalg.norm(swing))
    k = swing / angle if angle > 1e-12 else perpendicular(n)
    e = cross(k, n)
    radius = max(radius, angle - reach)
    # Beyond the quarter turn a sideways motion brings u nearer to n: the row along e is enough.
    faces = FACES if max(angle, radius) < math.pi / 2 else 1
    turn = 2.0 * math.pi / FACES * np.arange(faces)
    sideways = angle * n - (angle / math.tan(angle) if angle > 1e-12 else 1.0) * e
    rows = np.outer(np.cos(turn), k) + np.outer(np.sin(turn), sideways)
    return rows, radius - angle * np.cos(turn)

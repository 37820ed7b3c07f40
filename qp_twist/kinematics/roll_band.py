"""A range for the roll about an axis."""

from __future__ import annotations

import math

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, one_of, unit_vector
from qp_twist.errors import InvalidInput
from qp_twist.geometry import ProjectorFrame, ProjectorKind, TwistProjector, twist_angle
from qp_twist.geometry.twist_error import cross
from qp_twist.kinematics.tolerance_band import FramePair, Range, ToleranceBand, keeps, two_sided

SWUNG_OVER = 1e-3
"""Cosine of half the swing below which the roll counts as undefined: 0.1° short of a half turn."""


class RollBand(ToleranceBand):
    r"""Keep the roll of the frame relative to its target in a range.

    The roll φ is the twist angle of :math:`\mathbf E = \mathbf R\mathbf R_d^T` about the axis a.
    With the quaternion (η, ε) of E and s = a·ε,

    .. math::

        \varphi = 2\,\mathrm{atan2}(s, \eta), \qquad
        \nabla_\omega\varphi = \frac{\eta^2\,\mathbf a + \eta\,\boldsymbol\epsilon\times\mathbf a
        + s\,\boldsymbol\epsilon}{\eta^2 + s^2}

    (differentiate η̇ = −½ ω·ε, ε̇ = ½(ηω + ω×ε)). It is a while the frame is aligned with its
    target but for the roll. An axis fixed to the body and one fixed to the target have the same
    roll. Where the axis has swung by a half turn there is no roll: the band has no rows there.

    Example:
        >>> import math, qp_twist as qt
        >>> qt.RollBand([0, 0, 1], -math.pi / 6, math.pi / 6)
        RollBand([0.0, 0.0, 1.0], -30°…30°, frame='body')
    """

    kind = "roll"

    def __init__(
        self,
        axis: npt.ArrayLike,
        lower: float,
        upper: float,
        *,
        frame: ProjectorFrame = "body",
        weight: float | None = None,
        recovery_speed: float = 0.5,
    ) -> None:
        """State a band.

        Args:
            axis: a, shape (3,).
            lower: Smallest roll, rad. The range may lie across π, e.g. from 150° to 210°.
            upper: Largest roll, rad.
            frame: What the axis is fixed to.
            weight: ``None`` for a hard band, else the weight of the soft one.
            recovery_speed: Largest speed of return that is demanded outside, rad/s.

        Raises:
            InvalidInput: If an argument is no such thing, or the range is a whole turn.
        """
        super().__init__(weight, recovery_speed)
        self.axis = unit_vector("RollBand(axis=…)", axis)
        self.range = Range.checked("RollBand", lower, upper, "rad")
        turn = 2.0 * math.pi
        if max(-self.range.lower, self.range.upper) > turn:
            raise InvalidInput("RollBand: give ends between −2π and 2π (they are in rad).")
        if self.range.upper - self.range.lower >= turn:
            raise InvalidInput(
                "RollBand: a range of a whole turn or more holds every roll; leave the band out."
            )
        self.frame = one_of("RollBand(frame=…)", frame, ("body", "target", "world"))

    def roll(self, pair: FramePair) -> float:
        """φ, within half a turn of the middle of the range, rad."""
        middle = 0.5 * (self.range.lower + self.range.upper)
        error = pair.rotation @ pair.target_rotation.T
        return middle + math.remainder(twist_angle(error, self._axis(pair)) - middle, 2.0 * math.pi)

    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """At most two rows; see :meth:`ToleranceBand.half_spaces`."""
        a, error = self._axis(pair), pair.rotation @ pair.target_rotation.T
        eta, *xyz = mink.SO3.from_matrix(np.ascontiguousarray(error)).wxyz
        epsilon = np.array(xyz)
        s = float(a @ epsilon)
        if self._fixed(projector) or math.hypot(eta, s) < SWUNG_OVER:
            return np.zeros((0, 6)), np.zeros(0)
        gradient = np.zeros(6)
        gradient[3:] = eta * (eta * a + cross(epsilon, a)) + s * epsilon
        gradient /= eta**2 + s**2
        # E turns with ω − E ω_d; an axis that the target carries along makes it ω − ω_d.
        carried = pair.target_twist[3:]
        if self.frame == "world":
            carried = error @ carried
        rooms = self.range.rooms(self.roll(pair), self.recovery_speed * dt)
        return two_sided(gradient, rooms, -float(gradient[3:] @ carried), dt)

    def excess(self, pair: FramePair) -> float:
        """How far the roll is outside its range, rad; 0 inside."""
        return self.range.excess(self.roll(pair))

    def contradiction(self, projector: TwistProjector) -> str | None:
        """In words: the task holds the roll at 0, which the range leaves out."""
        middle = 0.5 * (self.range.lower + self.range.upper)
        nearest = middle + math.remainder(-middle, 2.0 * math.pi)
        if self._fixed(projector) and self.range.excess(nearest) > 1e-9:
            return "it holds the roll about this axis at 0, outside the band"
        return None

    def _axis(self, pair: FramePair) -> Array:
        # R a and R_d a have the same roll: Rᵀ E R = R_dᵀ E R_d. The target's does not depend on R.
        return pair.axes("target" if self.frame == "body" else self.frame) @ self.axis

    def _fixed(self, projector: TwistProjector) -> bool:
        """Whether T holds the roll at 0: about an axis in the range of its block there is none."""
        if projector.angular.kind is ProjectorKind.FULL:
            return True
        same = (self.frame == "world") == (projector.frame == "world")
        return same and keeps(projector.angular, self.axis)

    def __repr__(self) -> str:
        lower, upper = np.degrees(self.range)
        return (
            f"RollBand({self.axis.round(6).tolist()}, {lower:.6g}°…{upper:.6g}°, "
            f"frame={self.frame!r})"
        )

"""A range for the roll about an axis."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask, unit_vector
from qp_twist.errors import InvalidInput
from qp_twist.geometry import ProjectorFrame, ProjectorKind, TwistProjector, rotate, twist_angle
from qp_twist.kinematics.frame_pair import FramePair, Stretch, turn_about
from qp_twist.kinematics.tolerance_band import Range, ToleranceBand, keeps

SWUNG_OVER = 1e-3
"""Cosine of half the swing below which the roll counts as undefined: 0.1° before a half turn."""
_TURN = 2.0 * math.pi


class RollBand(ToleranceBand):
    r"""Keep the roll of the frame relative to its target in a range.

    The roll φ is the twist angle of :math:`\mathbf E = \mathbf R\mathbf R_d^T` about the axis a.
    With the quaternion (η, ε) of E,

    .. math::

        \varphi = 2\,\mathrm{atan2}(\mathbf a\cdot\boldsymbol\varepsilon,\; \eta), \qquad
        \nabla_\omega\varphi = \frac{\mathbf a + \mathbf E\mathbf a}
        {1 + \mathbf a\cdot\mathbf E\mathbf a}

    (differentiate η̇ = −½ ω·ε, ε̇ = ½(ηω + ω×ε)). The gradient's length is 1/cos(swing/2). An axis
    fixed to the body and one fixed to the target have the same roll. If the axis has swung by a
    half turn, the roll is undefined, and the band has no rows.

    Arguments are a, (3,), the smallest and the largest roll, rad, which may lie across π as from
    150° to 210°, and those of :class:`ToleranceBand`; what has the wrong type or range, or spans a
    whole turn, raises :class:`~qp_twist.InvalidInput`.

    Example:
        >>> import math, qp_twist as qt
        >>> qt.RollBand([0, 0, 1], -math.pi / 6, math.pi / 6)
        RollBand([0.0, 0.0, 1.0], -30°…30°, frame='body')
    """

    kind, unit = "roll", "rad"

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
        super().__init__(weight, recovery_speed, frame)
        self.axis = unit_vector("RollBand(axis=…)", axis)
        lower, upper = Range.checked("RollBand", lower, upper, "rad")
        if max(-lower, upper) > _TURN:
            raise InvalidInput("RollBand: give ends between −2π and 2π (they are in rad).")
        if upper - lower >= _TURN:
            raise InvalidInput(
                "RollBand: a range of a whole turn or more holds every roll; leave the band out."
            )
        self.ranges = (Range(lower, upper),)
        self._middle = 0.5 * (lower + upper)

    def values(self, pair: FramePair) -> Array:
        """φ, within half a turn of the middle of the range, rad, (1,)."""
        roll = np.asarray(twist_angle(pair.error, self._axis(pair)))
        wrapped: Array = roll - self._turns(roll)
        return wrapped[..., None]

    def gradients(self, pair: FramePair) -> Array:
        """(1, 6); see :meth:`ToleranceBand.gradients`."""
        a = self._axis(pair)
        turned = rotate(pair.error, a)
        whole = 1.0 + (a * turned).sum(axis=-1, keepdims=True)  # 2 cos²(swing/2)
        defined = 0.5 * whole > SWUNG_OVER**2
        angular = np.where(defined, a + turned, 0.0) / np.where(defined, whole, 1.0)
        return np.concatenate([np.zeros_like(angular), angular], axis=-1)[..., None, :]

    def carried(self, pair: FramePair) -> Array:
        """E rotates with ω − E ω_d; for an axis fixed to the target with ω − ω_d."""
        omega = pair.target_twist[..., 3:]
        angular = rotate(pair.error, omega) if self.frame == "world" else omega
        return np.concatenate([np.zeros_like(angular), angular], axis=-1)

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """The rolls at both ends plus the deviation from the chord, or the full range."""
        lowest, highest = self._span(before, after, stretch)
        # Beyond half a turn from the middle the roll is nearer to the other end.
        least, most = self._middle - math.pi, self._middle + math.pi
        every = (lowest < least) | (highest > most)
        return np.where(every, least, lowest), np.where(every, most, highest)

    def may_hold(self, before: FramePair, after: FramePair, stretch: Stretch) -> Mask:
        """Whether the roll, modulo whole turns, may be in its range between the poses, (K, 1)."""
        lowest, highest = self._span(before, after, stretch)
        [(lower, upper)] = self.ranges
        turns = _TURN * np.array([-1.0, 0.0, 1.0])
        meets = (highest + turns >= lower) & (lowest + turns <= upper)
        return np.asarray(meets.any(axis=1, keepdims=True))

    def _span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """Continuous bounds, from a roll within half a turn of the middle, rad, (K, 1) each."""
        begin, end, away = turn_about(self.axis, self.frame, before, after, stretch)
        ends = np.sort([begin, end], axis=0) - self._turns(begin)
        return (ends[0] - away)[:, None], (ends[1] + away)[:, None]

    def _turns(self, roll: Array) -> Array:
        """The whole turns that bring a roll to within half a turn of the middle, rad."""
        return _TURN * np.round((roll - self._middle) / _TURN)

    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Whether T fixes the roll at 0: its axis is in the range of the angular block."""
        if projector.angular.kind is ProjectorKind.FULL:
            return (True,)
        same = (self.frame == "world") == (projector.frame == "world")
        return (same and keeps(projector.angular, self.axis),)

    def _axis(self, pair: FramePair) -> Array:
        # R a and R_d a have the same roll: Rᵀ E R = R_dᵀ E R_d. The target's does not depend on R.
        return pair.axes("target" if self.frame == "body" else self.frame) @ self.axis

    def __repr__(self) -> str:
        return self._named(f"{self.axis.round(6).tolist()}")

"""Tolerance bands of the position: a slab, and a box of three slabs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, one_of, unit_vector
from qp_twist.geometry import ProjectorFrame, ProjectorKind, TwistProjector, cross
from qp_twist.kinematics.frame_pair import FramePair
from qp_twist.kinematics.stretch import Stretch
from qp_twist.kinematics.tolerance_band import Range, ToleranceBand, keeps


class SlabBand(ToleranceBand):
    r"""Keep the distance from the target along a normal, n·(p − p_d), in a range.

    .. math::

        \dot\varphi = \mathbf n\cdot(\mathbf v - \mathbf v_d)
        + \big(\mathbf n\times(\mathbf p - \mathbf p_d)\big)\cdot\boldsymbol\omega_n

    where ω_n is the angular velocity of the normal: the body's, the target's, or zero.

    Example:
        >>> import qp_twist as qt
        >>> qt.SlabBand([0, 0, 1], -0.001, 0.001)   # a standoff of ± 1 mm
        SlabBand([0.0, 0.0, 1.0], -0.001…0.001 m, frame='target')
    """

    kind, unit = "slab", "m"

    def __init__(
        self,
        normal: npt.ArrayLike,
        lower: float,
        upper: float,
        *,
        frame: ProjectorFrame = "target",
        weight: float | None = None,
        recovery_speed: float = 0.1,
    ) -> None:
        """Make a slab.

        Args:
            normal: n, shape (3,).
            lower: Smallest distance, m.
            upper: Largest distance, m.
            frame: The frame that the normal is fixed to.
            weight: ``None`` for a hard band, else the weight of a soft one.
            recovery_speed: Outside the band, the largest required speed of return, m/s.

        Raises:
            InvalidInput: If an argument has the wrong type or range, or lower is above upper.
        """
        super().__init__(weight, recovery_speed)
        self.normal = unit_vector("SlabBand(normal=…)", normal)
        self.range = Range.checked("SlabBand", lower, upper, "m")
        self.frame = one_of("SlabBand(frame=…)", frame, ("target", "world", "body"))

    @property
    def ranges(self) -> tuple[Range, ...]:
        """The range of the distance, m."""
        return (self.range,)

    def distance(self, pair: FramePair) -> float:
        """n·(p − p_d), m."""
        return float(self.values(pair)[0])

    def values(self, pair: FramePair) -> Array:
        """n·(p − p_d), m, (1,)."""
        apart = pair.position - pair.target_position
        distance: Array = (self._normal(pair) * apart).sum(axis=-1, keepdims=True)
        return distance

    def gradients(self, pair: FramePair) -> Array:
        """(n, 0), or (n, n × (p − p_d)) where the normal turns with the body, (1, 6)."""
        normal, apart = self._normal(pair), pair.position - pair.target_position
        gradient = np.zeros((*apart.shape[:-1], 1, 6))
        gradient[..., 0, :3] = normal
        if self.frame == "body":
            gradient[..., 0, 3:] = cross(normal, apart)
        return gradient

    def carried(self, pair: FramePair) -> Array:
        """Velocity of the target; with frame "target", of its material point at p, (6,)."""
        carried = np.zeros_like(pair.target_twist)
        carried[..., :3] = pair.target_twist[..., :3]
        if self.frame == "target":
            apart = pair.position - pair.target_position
            carried[..., :3] += cross(pair.target_twist[..., 3:], apart)
        return carried

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """Range of the distance between two poses: its end values plus the bound off its chord."""
        ends = self.values(before), self.values(after)
        off = stretch.off_chord(before, after, self.frame)
        off = (off + stretch.slipped(before, after, self.frame))[:, None]
        return np.minimum(*ends) - off, np.maximum(*ends) + off

    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Whether T holds the distance at 0."""
        linear = projector.linear
        held = linear.kind is ProjectorKind.FULL or (
            self.frame == projector.frame and keeps(linear, self.normal)
        )
        return (held,)

    def contradiction(self, projector: TwistProjector) -> str | None:
        """A sentence if the task holds the distance at 0, and 0 is outside the range."""
        if self.fixed(projector)[0] and self.range.excess(0.0) > 0.0:
            return f"it holds the distance along {self.normal.round(6).tolist()} at 0, outside it"
        return None

    def _normal(self, pair: FramePair) -> Array:
        normal: Array = pair.axes(self.frame) @ self.normal
        return normal

    def __repr__(self) -> str:
        return (
            f"SlabBand({self.normal.round(6).tolist()}, {self.range.lower:.6g}…"
            f"{self.range.upper:.6g} m, frame={self.frame!r})"
        )


class BoxBand(ToleranceBand):
    """Keep the position relative to the target in a box: a slab along each axis of a frame.

    Attributes:
        slabs: The three slabs.
    """

    kind, unit = "box", "m"

    def __init__(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        *,
        frame: ProjectorFrame = "target",
        weight: float | None = None,
        recovery_speed: float = 0.1,
    ) -> None:
        """Make a box.

        Args:
            lower: One corner of the box, relative to the target, m, shape (3,).
            upper: The opposite corner, m, shape (3,).
            frame: The frame that the axes are fixed to.
            weight: ``None`` for a hard band, else the weight of a soft one.
            recovery_speed: Outside the box, the largest required speed of return per axis, m/s.

        Raises:
            InvalidInput: If an argument has the wrong type or range, or lower is above upper.
        """
        super().__init__(weight, recovery_speed)
        self.lower = finite_array("BoxBand(lower=…)", lower, (3,))
        self.upper = finite_array("BoxBand(upper=…)", upper, (3,))
        self.slabs = tuple(
            SlabBand(normal, low, high, frame=frame, recovery_speed=recovery_speed)
            for normal, low, high in zip(np.eye(3), self.lower, self.upper, strict=True)
        )

    @property
    def ranges(self) -> tuple[Range, ...]:
        """The range along each axis, m."""
        return tuple(slab.range for slab in self.slabs)

    def values(self, pair: FramePair) -> Array:
        """The position along each axis, m, (3,)."""
        return np.concatenate([slab.values(pair) for slab in self.slabs], axis=-1)

    def gradients(self, pair: FramePair) -> Array:
        """The slabs' gradients, (3, 6)."""
        return np.concatenate([slab.gradients(pair) for slab in self.slabs], axis=-2)

    def carried(self, pair: FramePair) -> Array:
        """The slabs' :meth:`SlabBand.carried`, the same for all three, (6,)."""
        return self.slabs[0].carried(pair)

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """Range along each axis, (K, 3) each."""
        spans = [slab.span(before, after, stretch) for slab in self.slabs]
        lowest, highest = (np.concatenate(part, axis=1) for part in zip(*spans, strict=True))
        return lowest, highest

    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Which of the three distances T holds at 0."""
        return tuple(slab.fixed(projector)[0] for slab in self.slabs)

    def contradiction(self, projector: TwistProjector) -> str | None:
        """The first slab's contradiction, if any has one."""
        return next((why for s in self.slabs if (why := s.contradiction(projector))), None)

    def __repr__(self) -> str:
        return (
            f"BoxBand({self.lower.tolist()}…{self.upper.tolist()} m, frame={self.slabs[0].frame!r})"
        )

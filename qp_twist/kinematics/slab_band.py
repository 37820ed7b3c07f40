"""Tolerance bands of the position: a slab, and a box of three slabs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, unit_vector
from qp_twist.geometry import ProjectorFrame, ProjectorKind, TwistProjector, cross, rotate
from qp_twist.kinematics.frame_pair import FramePair, Stretch
from qp_twist.kinematics.tolerance_band import Range, ToleranceBand, keeps


class _Slabs(ToleranceBand):
    """Ranges for the distances from the target along k normals."""

    unit = "m"
    normals: Array

    def values(self, pair: FramePair) -> Array:
        """The distances, m, (k,)."""
        return rotate(self._normals(pair), pair.position - pair.target_position)

    def gradients(self, pair: FramePair) -> Array:
        """(n, 0), or (n, n × (p − p_d)) where the normal turns with the body, (k, 6)."""
        normals, apart = self._normals(pair), pair.position - pair.target_position
        turning = np.zeros_like(normals)
        if self.frame == "body":
            turning = cross(normals, apart[..., None, :])
        return np.concatenate([normals, turning], axis=-1)

    def carried(self, pair: FramePair) -> Array:
        """Velocity of the target; with frame "target", of its material point at p, (6,)."""
        carried = pair.target_twist.copy()
        if self.frame == "target":
            apart = pair.position - pair.target_position
            carried[..., :3] += cross(pair.target_twist[..., 3:], apart)
        carried[..., 3:] = 0.0
        return carried

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """Range of each distance between two poses: its ends and the bound off its chord."""
        ends = self.values(before), self.values(after)
        off = stretch.off_chord(before, after, self.frame)
        off = (off + stretch.slipped(before, after, self.frame))[:, None]
        return np.minimum(*ends) - off, np.maximum(*ends) + off

    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Which of the distances T holds at 0."""
        linear, same = projector.linear, self.frame == projector.frame
        whole = linear.kind is ProjectorKind.FULL
        return tuple(whole or (same and keeps(linear, normal)) for normal in self.normals)

    def _normals(self, pair: FramePair) -> Array:
        """The normals in the world, (k, 3)."""
        axes = pair.axes(self.frame)
        normals = self.normals @ axes.swapaxes(-1, -2)
        return np.broadcast_to(normals, (*pair.position.shape[:-1], *normals.shape[-2:]))


class SlabBand(_Slabs):
    r"""Keep the distance from the target along a normal, φ = n·(p − p_d), in a range.

    .. math::

        \dot\varphi = \mathbf n\cdot(\mathbf v - \mathbf v_d)
        + \big(\mathbf n\times(\mathbf p - \mathbf p_d)\big)\cdot\boldsymbol\omega_n

    where ω_n is the angular velocity of the normal: the body's, the target's, or zero. Arguments
    are n, (3,), the smallest and the largest distance, m, and those of :class:`ToleranceBand`; what
    has the wrong type or range raises :class:`~qp_twist.InvalidInput`.

    Example:
        >>> import qp_twist as qt
        >>> qt.SlabBand([0, 0, 1], -0.001, 0.001)   # a standoff of ± 1 mm
        SlabBand([0.0, 0.0, 1.0], -0.001…0.001 m, frame='target')
    """

    kind = "slab"

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
        super().__init__(weight, recovery_speed, frame)
        self.normal = unit_vector("SlabBand(normal=…)", normal)
        self.normals = self.normal[None]
        self.ranges = (Range.checked("SlabBand", lower, upper, "m"),)

    def __repr__(self) -> str:
        return self._named(f"{self.normal.round(6).tolist()}")


class BoxBand(_Slabs):
    """Keep the position relative to the target in a box: a slab along each axis of a frame.

    ``lower`` and ``upper`` are opposite corners of the box, relative to the target, m, (3,). The
    others are those of :class:`ToleranceBand`; what has the wrong type or range raises
    :class:`~qp_twist.InvalidInput`.
    """

    kind, normals = "box", np.eye(3)

    def __init__(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        *,
        frame: ProjectorFrame = "target",
        weight: float | None = None,
        recovery_speed: float = 0.1,
    ) -> None:
        super().__init__(weight, recovery_speed, frame)
        self.lower = finite_array("BoxBand(lower=…)", lower, (3,))
        self.upper = finite_array("BoxBand(upper=…)", upper, (3,))
        ends = zip(self.lower, self.upper, strict=True)
        self.ranges = tuple(Range.checked("BoxBand", *pair, "m") for pair in ends)

    def __repr__(self) -> str:
        return f"BoxBand({self.lower.tolist()}…{self.upper.tolist()} m, frame={self.frame!r})"

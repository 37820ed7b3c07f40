"""Ranges for the position: a slab, and the box made of three."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, one_of, unit_vector
from qp_twist.geometry import ProjectorFrame, ProjectorKind, TwistProjector
from qp_twist.geometry.twist_error import cross
from qp_twist.kinematics.tolerance_band import FramePair, Range, ToleranceBand, keeps, two_sided


class SlabBand(ToleranceBand):
    r"""Keep the distance from the target along a normal, n·(p − p_d), in a range.

    .. math::

        \dot\varphi = \mathbf n\cdot(\mathbf v - \mathbf v_d)
        + \big(\mathbf n\times(\mathbf p - \mathbf p_d)\big)\cdot\boldsymbol\omega_n

    where ω_n turns the normal: that of the body, of the target, or none.

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
        """State a band.

        Args:
            normal: n, shape (3,).
            lower: Smallest distance, m.
            upper: Largest distance, m.
            frame: What the normal is fixed to.
            weight: ``None`` for a hard band, else the weight of the soft one.
            recovery_speed: Largest speed of return that is demanded outside, m/s.

        Raises:
            InvalidInput: If an argument is no such thing, or lower is above upper.
        """
        super().__init__(weight, recovery_speed)
        self.normal = unit_vector("SlabBand(normal=…)", normal)
        self.range = Range.checked("SlabBand", lower, upper, "m")
        self.frame = one_of("SlabBand(frame=…)", frame, ("target", "world", "body"))

    def distance(self, pair: FramePair) -> float:
        """n·(p − p_d), m."""
        normal = pair.axes(self.frame) @ self.normal
        return float(normal @ (pair.position - pair.target_position))

    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """At most two rows; see :meth:`ToleranceBand.half_spaces`."""
        if self._fixed(projector):
            return np.zeros((0, 6)), np.zeros(0)
        normal = pair.axes(self.frame) @ self.normal
        arm = cross(normal, pair.position - pair.target_position)
        turned = np.concatenate([normal, arm])
        still = np.concatenate([normal, np.zeros(3)])
        gradient = turned if self.frame == "body" else still
        drift = -float(normal @ pair.target_twist[:3])
        if self.frame == "target":
            drift += float(arm @ pair.target_twist[3:])
        rooms = self.range.rooms(self.distance(pair), self.recovery_speed * dt)
        return two_sided(gradient, rooms, drift, dt)

    def excess(self, pair: FramePair) -> float:
        """How far the frame is outside the slab, m; 0 inside."""
        return self.range.excess(self.distance(pair))

    def contradiction(self, projector: TwistProjector) -> str | None:
        """In words: the task holds the distance at 0, which the range leaves out."""
        if self._fixed(projector) and self.range.excess(0.0) > 0.0:
            return f"it holds the distance along {self.normal.round(6).tolist()} at 0, outside it"
        return None

    def _fixed(self, projector: TwistProjector) -> bool:
        linear = projector.linear
        return linear.kind is ProjectorKind.FULL or (
            self.frame == projector.frame and keeps(linear, self.normal)
        )

    def __repr__(self) -> str:
        return (
            f"SlabBand({self.normal.round(6).tolist()}, {self.range.lower:.6g}…"
            f"{self.range.upper:.6g} m, frame={self.frame!r})"
        )


class BoxBand(ToleranceBand):
    """Keep the position relative to the target in a box: a slab along each axis of a frame.

    Attributes:
        slabs: The three of them.
    """

    kind = "box"

    def __init__(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        *,
        frame: ProjectorFrame = "target",
        weight: float | None = None,
        recovery_speed: float = 0.1,
    ) -> None:
        """State a band.

        Args:
            lower: One corner of the box, seen from the target, m, shape (3,).
            upper: The opposite corner, m, shape (3,).
            frame: What the axes are fixed to.
            weight: ``None`` for a hard band, else the weight of the soft one.
            recovery_speed: Largest speed of return along each axis that is demanded outside, m/s.

        Raises:
            InvalidInput: If an argument is no such thing, or lower is above upper.
        """
        super().__init__(weight, recovery_speed)
        self.lower = finite_array("BoxBand(lower=…)", lower, (3,))
        self.upper = finite_array("BoxBand(upper=…)", upper, (3,))
        self.slabs = tuple(
            SlabBand(normal, low, high, frame=frame, recovery_speed=recovery_speed)
            for normal, low, high in zip(np.eye(3), self.lower, self.upper, strict=True)
        )

    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """Two rows for each axis that T leaves free; see :meth:`ToleranceBand.half_spaces`."""
        rows, bounds = zip(
            *(slab.half_spaces(pair, dt, projector) for slab in self.slabs), strict=True
        )
        return np.vstack(rows), np.concatenate(bounds)

    def excess(self, pair: FramePair) -> float:
        """How far the frame is outside along the worst axis, m; 0 inside."""
        return max(slab.excess(pair) for slab in self.slabs)

    def contradiction(self, projector: TwistProjector) -> str | None:
        """That of the first axis which has one."""
        return next((why for s in self.slabs if (why := s.contradiction(projector))), None)

    def __repr__(self) -> str:
        return (
            f"BoxBand({self.lower.tolist()}…{self.upper.tolist()} m, frame={self.slabs[0].frame!r})"
        )

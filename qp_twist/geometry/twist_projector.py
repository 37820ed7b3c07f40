"""The twist projector T and the redundancy that it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, instance, one_of, rotation_matrix
from qp_twist.errors import InvalidInput
from qp_twist.geometry.projector import Projector

ProjectorFrame = Literal["world", "body", "target"]


@dataclass(frozen=True, eq=False, kw_only=True)
class TwistProjector:
    r"""Block-diagonal projector of a twist (paper, eqs. *decomposition_t*, *twist_decomp*).

    .. math::

        \mathbf t = \mathbf T \mathbf t + (\mathbf 1 - \mathbf T)\mathbf t, \qquad
        \mathbf T = \begin{bmatrix} \mathbf M_v & \mathbf O \\
                                    \mathbf O & \mathbf M_\omega \end{bmatrix}

    Rows and columns are in the order (linear, angular); the paper writes (angular, linear).

    Attributes:
        linear: Projector of the velocity v of the frame's origin.
        angular: Projector of the angular velocity ω.
        frame: The frame that the projectors' axes are fixed to: ``"world"``, ``"body"`` (they move
            with the controlled frame, like a tool axis) or ``"target"`` (they move with the target
            pose, like a surface normal). :meth:`resolved` gives the projector in world axes.

    Raises:
        InvalidInput: If a block is not a :class:`Projector` or the frame is unknown.

    Example:
        >>> roll_free = TwistProjector(
        ...     linear=Projector.full(), angular=Projector.plane([0, 0, 1]), frame="body")
        >>> roll_free.rank
        5
    """

    linear: Projector
    angular: Projector
    frame: ProjectorFrame = field(default="world")

    def __post_init__(self) -> None:
        for name, block in (("linear", self.linear), ("angular", self.angular)):
            if not isinstance(block, Projector):
                raise InvalidInput(
                    f"TwistProjector({name}=…): expected a Projector such as Projector.full() or "
                    f"Projector.plane([0, 0, 1]), got {block!r}."
                )
        one_of("TwistProjector(frame=…)", self.frame, ("world", "body", "target"))

    @property
    def matrix(self) -> Array:
        """T in the axes of ``frame``, shape (6, 6)."""
        return self.basis @ self.basis.T

    @property
    def rank(self) -> int:
        """Number of task rows, 0 to 6."""
        return self.linear.rank + self.angular.rank

    @property
    def basis(self) -> Array:
        """Orthonormal U with T = U Uᵀ, shape (6, rank); linear columns first."""
        linear, angular, split = self.linear.basis, self.angular.basis, self.linear.rank
        basis = np.zeros((*(linear.shape[:-2] or angular.shape[:-2]), 6, self.rank))
        basis[..., :3, :split] = linear
        basis[..., 3:, split:] = angular
        return basis

    @property
    def complement(self) -> TwistProjector:
        """1 − T, fixed to the same frame."""
        return TwistProjector(
            linear=self.linear.complement, angular=self.angular.complement, frame=self.frame
        )

    def intersection(self, other: TwistProjector) -> TwistProjector:
        """The twist projector onto the rows common to both, block by block.

        Axes fixed to different frames are refused: what they have in common changes along a motion.
        """
        instance("other", other, TwistProjector)
        frames = {t.frame for t in (self, other) if t.has_axis}
        if len(frames) > 1:
            raise InvalidInput(
                f"TwistProjector.intersection: the axes of one are fixed to {self.frame!r}, those "
                f"of the other to {other.frame!r}; state both in one frame."
            )
        return TwistProjector(
            linear=self.linear.intersection(other.linear),
            angular=self.angular.intersection(other.angular),
            frame=frames.pop() if frames else self.frame,
        )

    @property
    def has_axis(self) -> bool:
        """Whether the projector depends on ``frame``."""
        return self.linear.axis is not None or self.angular.axis is not None

    def resolved(
        self, body: npt.ArrayLike | None = None, target: npt.ArrayLike | None = None
    ) -> TwistProjector:
        """The same projector in world axes.

        It needs the rotation to the world, (3, 3), of the frame that it is fixed to: the controlled
        one (``body``) or the target; without it raises :class:`~qp_twist.InvalidInput`.
        """
        if self.frame == "world":
            return self
        given = body if self.frame == "body" else target
        if given is None:
            raise InvalidInput(
                f"TwistProjector.resolved: the projector is fixed to the {self.frame} frame; pass "
                f"{self.frame}=R, the rotation of that frame to the world, shape (3, 3)."
            )
        rotation = rotation_matrix(self.frame, given)
        return self.in_world(rotation, rotation)

    def in_world(self, body: Array, target: Array) -> TwistProjector:
        """:meth:`resolved` without its checks, for one pose or for many, (K, 3, 3)."""
        if self.frame == "world":
            return self
        rotation = body if self.frame == "body" else target
        world = object.__new__(TwistProjector)
        world.__dict__.update(
            linear=self.linear.rotated(rotation), angular=self.angular.rotated(rotation),
            frame="world",
        )  # fmt: skip
        return world


def distinct_projectors(
    projectors: Sequence[TwistProjector | None],
) -> tuple[list[TwistProjector], Indices]:
    """The distinct objects among projectors, and the index of each entry's, −1 for ``None``."""
    distinct = list({id(t): t for t in projectors if t is not None}.values())
    place = {id(t): k for k, t in enumerate(distinct)}
    return distinct, np.array([place.get(id(t), -1) for t in projectors], dtype=np.intp)


def with_fewer_rows(before: TwistProjector, after: TwistProjector) -> TwistProjector:
    """Of the projectors of two successive waypoints that which holds between them."""
    return after if after.rank <= before.rank else before


def task_redundancy(operational: TwistProjector, task: TwistProjector) -> int:
    r"""Redundancy of a task, r_t = rank(T_O) − rank(T_T) (paper, section 4).

    T_O is full for a spatial arm, and has the plane's three directions for a planar one; a task
    that needs another direction raises :class:`~qp_twist.InvalidInput`.
    """
    instance("operational", operational, TwistProjector)
    instance("task", task, TwistProjector)
    outside = task.rank > operational.rank
    if operational.frame == task.frame:
        beyond = task.basis - operational.matrix @ task.basis
        outside |= bool(np.abs(beyond).max(initial=0.0) > 1e-9)
    if outside:
        raise InvalidInput(
            f"task_redundancy: the task, of rank {task.rank}, needs a direction outside the "
            f"operational space, of rank {operational.rank}; check the blocks of both projectors."
        )
    return operational.rank - task.rank

"""The four projectors of R³: full, plane, line, none."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, unit_vector
from qp_twist.errors import InvalidInput
from qp_twist.geometry.rotations import cross, perpendicular

SAME_DIRECTION = 1e-9
"""Sine of the angle below which two directions count as one."""


class ProjectorKind(enum.Enum):
    """Which of the four subspaces of R³ a projector keeps; the value is its rank."""

    FULL = 3
    PLANE = 2
    LINE = 1
    NONE = 0


@dataclass(frozen=True, eq=False)
class Projector:
    r"""Orthogonal projector of R³ onto a subspace (paper, eq. *Mi*).

    .. math::

        \mathbf M \in \{\mathbf 1,\; \mathbf P = \mathbf 1 - \mathbf e \mathbf e^T,\;
        \mathbf L = \mathbf e \mathbf e^T,\; \mathbf O\}

    Build one with :meth:`full`, :meth:`plane`, :meth:`line` or :meth:`none`. It has no unit and no
    frame; the frame of its axis is that of :class:`TwistProjector`.

    Attributes:
        kind: Which of the four it is.
        basis: Orthonormal columns U with M = U Uᵀ, shape (3, rank).
        axis: The unit vector e of a plane's normal or a line's direction, shape (3,); ``None`` for
            full and none.

    Example:
        >>> Projector.plane([0, 0, 2]).matrix
        array([[1., 0., 0.],
               [0., 1., 0.],
               [0., 0., 0.]])
    """

    kind: ProjectorKind
    basis: Array
    axis: Array | None = None

    def __post_init__(self) -> None:
        instance("Projector(kind)", self.kind, ProjectorKind)
        basis = finite_array("Projector(basis)", self.basis, (3, self.kind.value))
        if np.abs(basis.T @ basis - np.eye(self.kind.value)).max(initial=0.0) > 1e-6:
            raise InvalidInput(
                "Projector: the columns of its basis must be orthonormal; build one with "
                "Projector.full(), .plane(normal), .line(direction) or .none(), and turn it by "
                "rotation matrices only."
            )
        if self.kind in (ProjectorKind.PLANE, ProjectorKind.LINE):
            finite_array("Projector(axis)", () if self.axis is None else self.axis, (3,))

    @classmethod
    def full(cls) -> Projector:
        """The identity: all three directions (rank 3)."""
        return cls(ProjectorKind.FULL, np.eye(3))

    @classmethod
    def plane(cls, normal: npt.ArrayLike) -> Projector:
        """P = 1 − e eᵀ: the plane perpendicular to ``normal`` (rank 2).

        Raises:
            InvalidInput: If it is not three finite numbers, or zero.
        """
        e = unit_vector("normal", normal)
        u = perpendicular(e)
        return cls(ProjectorKind.PLANE, np.column_stack([u, cross(e, u)]), e)

    @classmethod
    def line(cls, direction: npt.ArrayLike) -> Projector:
        """L = e eᵀ: the line along ``direction`` (rank 1).

        Raises:
            InvalidInput: If it is not three finite numbers, or zero.
        """
        e = unit_vector("direction", direction)
        return cls(ProjectorKind.LINE, e[:, None].copy(), e)

    @classmethod
    def none(cls) -> Projector:
        """The zero matrix: no direction (rank 0)."""
        return cls(ProjectorKind.NONE, np.zeros((3, 0)))

    @property
    def matrix(self) -> Array:
        """M, shape (3, 3)."""
        return self.basis @ self.basis.T

    @property
    def rank(self) -> int:
        """Dimension of the subspace, 0 to 3."""
        return self.kind.value

    @property
    def complement(self) -> Projector:
        """M⊥ = 1 − M (paper, eq. *decomposition*)."""
        if self.axis is None:
            return Projector.none() if self.kind is ProjectorKind.FULL else Projector.full()
        build = Projector.line if self.kind is ProjectorKind.PLANE else Projector.plane
        return build(self.axis)

    def intersection(self, other: Projector) -> Projector:
        r"""The projector onto the intersection of both ranges.

        .. math:: \mathrm{range}\,\mathbf M_1 \cap \mathrm{range}\,\mathbf M_2
            = \ker \begin{bmatrix} \mathbf 1 - \mathbf M_1 \\ \mathbf 1 - \mathbf M_2 \end{bmatrix}

        Two axes that are parallel, or perpendicular, to 1e-9 rad count as exactly so.
        """
        instance("other", other, Projector)
        outside = np.hstack([self.complement.basis, other.complement.basis])
        directions, sigma, _ = np.linalg.svd(outside)
        rank = 3 - int((sigma > SAME_DIRECTION).sum())
        for smaller in (self, other):
            if smaller.rank == rank:
                return smaller
        if rank == 1:  # two planes that cross
            return Projector.line(directions[:, 2])
        return Projector.none()

    def rotated(self, rotation: Array) -> Projector:
        """The projector R M Rᵀ for a rotation matrix (3, 3), which is not checked.

        The basis rotates with it, so that the rows of a task stay continuous along a motion. Full
        and none do not change. For K rotations the basis has shape (K, 3, rank), the axis (K, 3).
        """
        if self.axis is None:
            return self
        made = object.__new__(Projector)
        made.__dict__.update(
            kind=self.kind, basis=rotation @ self.basis, axis=rotation @ self.axis
        )  # fmt: skip
        return made

    def __repr__(self) -> str:
        argument = "" if self.axis is None else str(np.round(self.axis, 6).tolist())
        return f"Projector.{self.kind.name.lower()}({argument})"

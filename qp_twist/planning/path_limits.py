"""The constraints of a joint path: their margins, and their rows for programs."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.planning.hard_constraints import BETWEEN, HardConstraints

Kind = Literal["position", "velocity", "acceleration", "band"]

INSET = 1e-7
"""Distance from every limit that the programs keep, for rounding, rad or m."""


class Margins(NamedTuple):
    """The margins of a joint path in one kind of constraint."""

    kind: Kind
    names: tuple[str, ...]
    """Names of the joints, bands or constraints, (k)."""
    units: tuple[str, ...]
    """Units of the margins, ``"rad"`` or ``"m"``, (k)."""
    values: Array
    """Margins at each waypoint, nonnegative inside, ∞ without a constraint, (N, k)."""
    between: bool = False
    """Whether they belong to the interval before the waypoint."""


class PathLimit(abc.ABC):
    """A constraint on a joint path q (N, nv)."""

    @abc.abstractmethod
    def margins(self, q: Array) -> Margins:
        """Its margins."""

    @abc.abstractmethod
    def rows(self, q: Array) -> tuple[sparse.csr_matrix, Array]:
        """Linear rows that keep the margins above 0: rows (M, N·nv) · Δq ≤ rooms (M,)."""


@dataclass(frozen=True, eq=False)
class LinearLimit(PathLimit):
    """lower ≤ G q ≤ upper, entry by entry of a path: ranges, steps, changes of speed.

    Attributes:
        kind: ``"position"``, ``"velocity"`` or ``"acceleration"``.
        ranges: The joint ranges.
        G: Matrix of the path, (M·nv, N·nv), with rows for M waypoints.
        lower: Lower bounds, rad or m, (M, nv), or (nv,) for all waypoints.
        upper: Upper bounds, likewise.
        first: The waypoint of the first rows, from 0.
    """

    kind: Kind
    ranges: JointRanges
    G: sparse.csr_matrix
    lower: Array
    upper: Array
    first: int

    def margins(self, q: Array) -> Margins:
        """Distance from the nearer bound; ∞ at waypoints without rows."""
        values = (self.G @ q.ravel()).reshape(-1, q.shape[1])
        margins = np.full(q.shape, np.inf)
        here = slice(self.first, self.first + len(values))
        margins[here] = np.minimum(values - self.lower, self.upper - values)
        return Margins(self.kind, self.ranges.names, self.ranges.units, margins)

    def rows(self, q: Array) -> tuple[sparse.csr_matrix, Array]:
        """G and −G."""
        values = (self.G @ q.ravel()).reshape(-1, q.shape[1])
        rooms = [self.upper - values, values - self.lower]
        return sparse.vstack([self.G, -self.G], format="csr"), np.ravel(rooms) - INSET


@dataclass(frozen=True, eq=False)
class AtWaypoints(PathLimit):
    """Hard bands and constraints at the waypoints."""

    hard: HardConstraints

    def margins(self, q: Array) -> Margins:
        """Margins of the configurations."""
        margins = self.hard.margins(q, np.arange(len(q)))
        return Margins("band", self.hard.names, self.hard.units, margins)

    def rows(self, q: Array) -> tuple[sparse.csr_matrix, Array]:
        """Rows of the configurations, as one matrix."""
        rows, rooms, of = self.hard.rows(q, np.arange(len(q)))
        inset = np.minimum(INSET, 0.25 * self.hard.halves)
        return _blocks(rows), (rooms - inset[of]).ravel()


@dataclass(frozen=True, eq=False)
class BetweenWaypoints(PathLimit):
    """Hard bands and constraints between waypoints, with the tolerance :data:`BETWEEN`.

    Attributes:
        hard: Bands and constraints.
        at: Index of the waypoint before each evaluated point, (K,).
        share: Share of the interval to the next, (K,).
    """

    hard: HardConstraints
    at: Indices
    share: Array

    @property
    def allowed(self) -> Array:
        """:data:`BETWEEN` in the unit of each margin, (k,)."""
        return np.array([BETWEEN[unit] for unit in self.hard.units])

    def margins(self, q: Array) -> Margins:
        """The least margin in the interval before each waypoint, plus the tolerance."""
        found = self.hard.margins_between(q[self.at], q[self.at + 1], self.at, self.share)
        least = np.full((len(q), found.shape[1]), np.inf)
        np.minimum.at(least, self.at + 1, found + self.allowed)
        return Margins("band", self.hard.names, self.hard.units, least, between=True)

    def rows(self, q: Array) -> tuple[sparse.csr_matrix, Array]:
        """Half of the tolerance is reserved for the points between the evaluated ones."""
        rows, rooms, of = self.hard.rows_between(q, self.at, self.share)
        nv = q.shape[1]
        joints = (nv * self.at[:, None] + np.arange(nv)).ravel()
        whole = sparse.identity(q.size, format="csr")
        of_end = sparse.diags(np.repeat(self.share, nv))
        moved = whole[joints] + of_end @ (whole[joints + nv] - whole[joints])
        return _blocks(rows) @ moved, (rooms + 0.5 * self.allowed[of]).ravel()


def _blocks(rows: Array) -> sparse.csr_matrix:
    """Rows (K, m, nv) as a block-diagonal matrix on K displacements, (K·m, K·nv)."""
    at = np.arange(len(rows) + 1)
    return sparse.csr_matrix(sparse.bsr_matrix((rows, at[:-1], at)))

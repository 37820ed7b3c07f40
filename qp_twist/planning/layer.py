"""All configurations at one waypoint, on a grid of the free coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.planning.hard_constraints import WITHIN, HardConstraints

TURN = 2.0 * np.pi
_LOOKED_AT = 200
"""Largest number of configurations of which the one with the least violation is chosen."""


@dataclass(frozen=True, eq=False)
class Layer:
    """The configurations of a waypoint that a search may choose from.

    Attributes:
        q: Configurations inside the limits, including whole turns of the joints, (K, nv).
        branch: Index of each one's branch, (K,).
        copy_of: Index of a configuration that each is but for whole turns of its joints, (K,): one
            index for all that have the same pose of all bodies. ``None``: no two do.
        solutions: Number of configurations without limits, whole turns not counted.
        outside: Joints that exclude the waypoint, if no configuration is inside the limits.
        beyond: By how much the configuration that is nearest to fit is outside them then, rad or m,
            (nv,).
        bands: Hard bands that exclude it, if configurations are inside the limits but none inside
            the bands.
        nearby: Whether no configuration is exact, and these are within the tolerances of a check.
    """

    q: Array
    branch: Indices
    solutions: int
    outside: tuple[str, ...] = ()
    beyond: Array = field(default_factory=lambda: np.zeros(0))
    bands: tuple[str, ...] = ()
    nearby: bool = False
    copy_of: Indices | None = None

    @classmethod
    def alone(cls, q: Array) -> Layer:
        """The layer of one configuration (nv,)."""
        return cls(q[None], np.full(1, -1), 1)

    def of(self, nodes: Indices | Mask) -> Layer:
        """With some of its configurations."""
        copy_of = None if self.copy_of is None else self.copy_of[nodes]
        return replace(self, q=self.q[nodes], branch=self.branch[nodes], copy_of=copy_of)

    def joined(self, q: Array, branch: Indices) -> Layer:
        """With further configurations (E, nv) and their branches (E,)."""
        copy_of = self.copy_of
        if copy_of is not None:
            copy_of = np.append(copy_of, copy_of.max(initial=-1) + 1 + np.arange(len(q)))
        every = np.vstack([self.q, q])
        return replace(self, q=every, branch=np.append(self.branch, branch), copy_of=copy_of)

    def emptied(self, bands: tuple[str, ...]) -> Layer:
        """Without its configurations, which these bands exclude."""
        return replace(self.of(np.zeros(0, dtype=np.intp)), bands=bands)

    @cached_property
    def copies(self) -> tuple[Indices, Indices]:
        """The first of each configuration's copies, (B,), and which of these each is of, (K,)."""
        if self.copy_of is None:
            each = np.arange(len(self.q))
            return each, each
        _, first, which = np.unique(self.copy_of, return_index=True, return_inverse=True)
        return first, which

    @cached_property
    def turns(self) -> Indices:
        """Whole turns of each joint from the first copy, (K, nv)."""
        first, which = self.copies
        turns: Indices = np.rint((self.q - self.q[first][which]) / TURN).astype(np.intp)
        return turns


def inside_limits(q: Array, branch: Indices, ranges: JointRanges) -> Layer:
    """The layer of configurations (K, nv), with all their whole turns inside the limits.

    Hinges without limits stay within half a turn.
    """
    every = centred(q, ranges)
    q, which = every, np.arange(len(every))
    width = np.where(ranges.hinge, ranges.upper - ranges.lower, 0.0)
    for joint in np.argsort(width):  # joints with one choice first: fewer rows
        if np.isfinite(width[joint]) and width[joint] > TURN:
            turn = TURN * np.eye(q.shape[1])[joint]
            q, which = np.concatenate([q - turn, q, q + turn]), np.tile(which, 3)
        keep = (q[:, joint] >= ranges.lower[joint]) & (q[:, joint] <= ranges.upper[joint])
        q, which = q[keep], which[keep]
    layer = Layer(q, branch[which], len(every), copy_of=which)
    if len(q) or not len(every):
        return layer
    beyond = -ranges.room(every)
    nearest = beyond[np.argmin(beyond.max(axis=1))]
    always = (beyond > 0.0).all(axis=0)
    forbidding = np.flatnonzero(always if always.any() else nearest > 0.0)
    return replace(layer, outside=tuple(ranges.names[j] for j in forbidding), beyond=nearest)


def centred(q: Array, ranges: JointRanges) -> Array:
    """Remove full turns so that every hinge is nearest to the middle of its range."""
    turns = np.round((q - ranges.middle) / TURN)
    return q - TURN * np.where(ranges.hinge, turns, 0.0)


def wound(apart: Array) -> Array:
    """Differences of angles, the shorter way round."""
    shorter: Array = apart - TURN * np.round(apart / TURN)
    return shorter


def distances(a: Array, b: Array, apart: Callable[[Array, Array], Array]) -> Array:
    """How far each of a (E, B, nv) is from each of b (E, C, nv), (E, B, C); infinite for NaN."""
    each = [np.linalg.norm(apart(a[:, [k]], b), axis=2) for k in range(a.shape[1])]
    found: Array = np.nan_to_num(np.stack(each, axis=1), nan=np.inf)
    return found


def boxed(q: Array, period: Array) -> Array:
    """Coordinates (K, nv) modulo nonzero periods, for a periodic tree."""
    if not period.any():
        return q
    rest = np.mod(q, np.where(period > 0.0, period, 1.0))
    rest = np.where(rest < period, rest, 0.0)  # of -1e-17 the remainder is the period itself
    wrapped: Array = np.where(period > 0.0, rest, q)
    return wrapped


def empty_layer(q: Array, ranges: JointRanges, bands: HardConstraints, index: int) -> Layer:
    """The empty layer of a waypoint: no configuration q (K, nv) is inside limits and bands."""
    layer = inside_limits(q, np.zeros(len(q), dtype=np.intp), ranges)
    return layer.emptied(forbidding_bands(layer.q, bands, index)[0] if len(layer.q) else ())


def forbidding_bands(q: Array, bands: HardConstraints, index: int) -> tuple[tuple[str, ...], Array]:
    """The bands violated by the configuration of q (K, nv) with the least violation.

    Of many configurations some are looked at, evenly chosen: depths of overlap take long.

    Returns:
        Their names, and all margins of that configuration, rad or m, (k,).
    """
    q = q[:: 1 + len(q) // _LOOKED_AT]
    margins = bands.margins(q, np.full(len(q), index))
    nearest: Array = margins[np.argmax(margins.min(axis=1))]
    return tuple(bands.names[k] for k in np.flatnonzero(nearest < -WITHIN)), nearest

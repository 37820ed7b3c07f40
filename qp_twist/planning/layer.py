"""All configurations at one waypoint, on a grid of what the task leaves free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import Indices

TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Layer:
    """What the search may choose from at a waypoint.

    Attributes:
        q: Configurations inside the limits, whole turns of each joint counted, (K, nv).
        branch: Number of the branch that each belongs to, (K,).
        roll: Roll of each against the waypoint's own, rad, (K,); NaN where it is not the roll that
            is free.
        solutions: How many configurations the waypoint has without limits, turns not counted.
        outside: Which joints forbid it, where no configuration is inside the limits.
    """

    q: Array
    branch: Indices
    roll: Array
    solutions: int
    outside: tuple[str, ...] = ()

    def only(self, keep: Indices) -> Layer:
        """The same with some of the configurations."""
        return Layer(self.q[keep], self.branch[keep], self.roll[keep], self.solutions, self.outside)

    def with_seeds(self, q: Array) -> Layer:
        """The same with configurations (S, nv) added, of no branch."""
        more = len(q)
        return Layer(
            np.vstack([self.q, q]),
            np.concatenate([self.branch, np.full(more, -1)]),
            np.concatenate([self.roll, np.full(more, np.nan)]),
            self.solutions,
            self.outside,
        )


def inside_limits(q: Array, branch: Indices, roll: Array, ranges: JointRanges) -> Layer:
    """The layer of configurations (K, nv), of which whole turns do not matter.

    Every choice of turns inside the limits counts; hinges without limits stay within half a turn.
    """
    every = centred(q, ranges)
    q, which = every, np.arange(len(every))
    width = np.where(ranges.hinge, ranges.upper - ranges.lower, 0.0)
    for joint in np.argsort(width):  # those without a second turn first: fewer rows
        if np.isfinite(width[joint]) and width[joint] > TURN:
            turn = TURN * np.eye(q.shape[1])[joint]
            q, which = np.concatenate([q - turn, q, q + turn]), np.tile(which, 3)
        keep = (q[:, joint] >= ranges.lower[joint]) & (q[:, joint] <= ranges.upper[joint])
        q, which = q[keep], which[keep]
    outside = _forbidding(every, ranges) if len(every) and not len(q) else ()
    return Layer(q, branch[which], roll[which], len(every), outside)


def centred(q: Array, ranges: JointRanges) -> Array:
    """Full turns taken off so that every hinge is nearest to the middle of its range."""
    turns = np.round((q - ranges.middle) / TURN)
    return q - TURN * np.where(ranges.hinge, turns, 0.0)


def _forbidding(q: Array, ranges: JointRanges) -> tuple[str, ...]:
    """The joints that are outside in every configuration, or in the one that is nearest to fit."""
    beyond = np.maximum(ranges.lower - q, q - ranges.upper)
    always = np.flatnonzero((beyond > 0.0).all(axis=0))
    if not len(always):
        always = np.flatnonzero(beyond[np.argmin(beyond.max(axis=1))] > 0.0)
    return tuple(ranges.names[dof] for dof in always)

"""How far a tool leaves its moves where a robot rounds the points between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import Projector, TwistProjector, resolved_twist_error, rotation_matrix
from qp_twist.paths import PathTask
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.programs import Zone
from qp_twist.robots import ToolChain

_SHORTEST = 1e-4
"""Moves up to this length, m, count as turns alone, of which a robot may round one half."""


class RoundedPoints(NamedTuple):
    """The points that a program rounds.

    Attributes:
        rows: Of the trajectory, (K,).
        zones: As the program states them, K.
        position: Largest linear task error of the tool at each from what is rounded, m, (K,).
        axis: Likewise the angular one, rad, (K,).
        reach: From which share of half of each move beside it on at most, up to 2, (K,).
    """

    rows: Indices
    zones: tuple[Zone, ...]
    position: Array
    axis: Array
    reach: Array

    def only(self, which: Mask) -> RoundedPoints:
        """Some of the points (K,)."""
        zones = tuple(itertools.compress(self.zones, which))
        return RoundedPoints(
            self.rows[which], zones, self.position[which], self.axis[which], self.reach[which]
        )


class Rounding(NamedTuple):
    """Largest task errors at points that are rounded from half of the shorter move on, (K,) each.

    Attributes:
        linear: From the change of direction, m; in proportion to the distance.
        square: From curvature, m; to its square.
        angular: From the change of the turn, rad; in proportion.
    """

    linear: Array
    square: Array
    angular: Array


class Corners(NamedTuple):
    r"""Points of the tool, N, and the moves from one to the next, straight, round, or of joints.

    Attributes:
        rotations: At the points, (N, 3, 3).
        positions: m, (N, 3).
        ways: Derivatives of the position by the share of each move at both its ends, m,
            (N − 1, 2, 3).
        turns: Likewise the turns in the tool's axes, rad.
        bends: Likewise the curvatures of the way, towards their centres, 1/m.
        arm: The point of the frame that makes the moves, m, (3,).
    """

    rotations: Array
    positions: Array
    ways: Array
    turns: Array
    bends: Array
    arm: Array

    @classmethod
    def of(cls, tool: ToolChain, q: Array, moves: Sequence[ToolMove | None]) -> Corners:
        """Of joint positions (N, n), and the moves of the tool between; ``None``: joint moves."""
        R, p = tool.poses(q)
        own = [each.arm for each in moves if each is not None]
        arm = own[0] if own else np.zeros(3)
        ways, turns = np.zeros((2, len(q) - 1, 2, 3))
        change = np.diff(q, axis=0)
        for end, at in enumerate((slice(None, -1), slice(1, None))):
            v, w = tool.twists(q[at], change)
            ways[:, end] = v + np.cross(w, R[at] @ arm)
            turns[:, end] = (R[at].swapaxes(1, 2) @ w[..., None])[..., 0]
        lengths = np.maximum(np.linalg.norm(ways, axis=2, keepdims=True), _SHORTEST)
        units, bent = ways / lengths, (ways[:, 1] - ways[:, 0])[:, None]
        bends = (bent - (bent * units).sum(axis=2, keepdims=True) * units) / lengths**2
        for k, move in enumerate(moves):
            if move is not None:
                ways[k] = move.length * move.tangents()
                turns[k], bends[k] = move.turns(), move.bends()
        return cls(R, p + R @ arm, ways, turns, bends, arm)

    @property
    def halves(self) -> Array:
        """Half of the shorter of both moves at inner points, m, (N − 2,)."""
        lengths = np.linalg.norm(self.ways, axis=2).max(axis=1)
        halves: Array = 0.5 * np.minimum(lengths[:-1], lengths[1:])
        return halves

    def rounding(
        self, projector: TwistProjector, linear: Array | float = 1.0, angular: Array | float = 1.0
    ) -> Rounding:
        """Of inner points (N − 2,) that are rounded from these shares of :attr:`halves` on.

        An arc that begins and ends at the distance d from a corner of angle θ passes it at
        d tan θ/4; a parabola, at d/2 sin θ/2, is nearer. With unit vectors u before and after it
        that is d |u₂ − u₁| / (2 + |u₁ + u₂|), along u₂ − u₁. Two moves of which one ends while the
        other begins, in ramps over the distance d, are each d/4 from the corner in the middle, so
        that circles of curvatures κ towards their centres add d²/32 (κ₁ + κ₂). Where the turn per
        way changes from w₁ to w₂, the orientation is off by d/4 (w₂ − w₁).
        """
        R, p = self.rotations[1:-1], self.positions[1:-1]
        lengths = np.linalg.norm(self.ways, axis=2, keepdims=True)
        units = self.ways / np.maximum(lengths, 1e-12)
        before, after = units[:-1, 1], units[1:, 0]
        both = np.linalg.norm(before + after, axis=1, keepdims=True)
        d = (linear * self.halves)[:, None]
        most = np.maximum(lengths.max(axis=1), _SHORTEST)
        half = 0.5 * np.minimum(most[:-1], most[1:])
        changed = half / most[1:] * self.turns[1:, 0] - half / most[:-1] * self.turns[:-1, 1]
        turned = R @ rotation_matrix(0.25 * (angular * changed.T).T)
        corner = p + d * (after - before) / (2.0 + both)
        arcs = p + d**2 / 32.0 * (self.bends[:-1, 1] + self.bends[1:, 0])
        sizes = []
        for at, turn in ((corner, turned), (arcs, R)):
            frames = at - turn @ self.arm, p - R @ self.arm
            _, error = resolved_twist_error(turn, frames[0], R, frames[1], projector)
            sizes.append([np.linalg.norm(part, axis=1) for part in np.hsplit(error, 2)])
        return Rounding(sizes[0][0], sizes[1][0], sizes[0][1])

    def rounded(
        self, zones: Sequence[Zone | None], rows: Indices, projector: TwistProjector
    ) -> RoundedPoints:
        """What zones of the points, N, whose rows are (N,), let the tool leave.

        Blends that overlap leave a point out: at most the shorter move times the sine of θ away
        from the line between its neighbours, four times what an arc over that move leaves.
        """
        halves = np.maximum(self.halves, 0.5 * _SHORTEST)
        known = [each or Zone(0, "", 0.0) for each in zones]
        radii, wide = (
            np.array([each.radius if turn is None else turn for each, turn in of])
            for of in ([(each, None) for each in known], [(each, each.turning) for each in known])
        )
        shares = np.array([each.share for each in known])
        free = np.array([each.overlaps for each in known])
        reach = np.where(free, radii, 0.0)
        overlap = reach[:-1] + reach[1:] > np.linalg.norm(self.ways, axis=2).max(axis=1)
        left_out = free[1:-1] & (overlap[:-1] | overlap[1:])
        most = np.where(free[1:-1], 2.0, 1.0)
        linear, angular = (
            np.where(left_out, 8.0, np.minimum(of[1:-1] / halves, most) * shares[1:-1])
            for of in (radii, wide)
        )
        found = self.rounding(projector, linear, angular)
        at = np.flatnonzero([each is not None for each in zones[1:-1]])
        return RoundedPoints(
            rows[1:-1][at], tuple(known[k + 1] for k in at), (found.linear + found.square)[at],
            found.angular[at], np.minimum(np.maximum(linear, angular), 2.0)[at],
        )  # fmt: skip


def task_rows(path_task: PathTask) -> TwistProjector:
    """The directions in which the tool has to stay; all of them where they change on the way."""
    if not path_task.segments:
        return path_task.projector
    return TwistProjector(linear=Projector.full(), angular=Projector.full())

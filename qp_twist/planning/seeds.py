"""Configurations on a waypoint from which the nets over its self-motion manifolds grow."""

from __future__ import annotations

import numpy as np
import scipy  # which loads its parts when they are first used

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges, ParametrisedArm
from qp_twist.paths import PathTask
from qp_twist.planning.layer import TURN, boxed, centred, distances
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.roll_grid import RollGrid, rolled

_FEWEST, _MOST = 150, 4000
"""Numbers of poses and parameters between which a grid's spacing is that of the net."""
_FAR, _COVERED, _HALVINGS, _LARGEST = 1.5, 0.9, 4, 40_000
"""Distance of neighbours of a grid, in units of the net's spacing, beyond which points between them
are added; how often; and the number of points beyond which none are."""
_DRAWN = 300
"""Number of random ones where there is no grid: each gives up to 16 configurations."""


class Seeds:
    """Configurations on a waypoint, or near it.

    In closed form, if six of the arm's hinges have one when the others are given: all branches, on
    a regular grid of the roll that the task leaves free and of the given joints, or at random, if
    more than two degrees are free or others than a roll. Else, without ``arms``, random ones, which
    Newton's method brings onto the waypoint.
    """

    def __init__(
        self, path_task: PathTask, rows: PathRows, spacing: Array, rng: np.random.Generator
    ) -> None:
        self.path_task, self.rows, self.spacing, self._rng = path_task, rows, spacing, rng
        self.ranges = ranges = JointRanges.of(path_task.model)
        self.arms = rows.closed_forms
        width = ranges.upper - ranges.lower
        #: Joints whose whole turns do not matter.
        self._period = np.where(ranges.hinge & ~(width < TURN), TURN, 0.0)
        half = np.where(ranges.hinge, np.pi, 1.0)
        self._lower = np.where(np.isfinite(ranges.lower), ranges.lower, -half)
        self._upper = np.where(np.isfinite(ranges.upper), ranges.upper, half)

    def tree(self, q: Array) -> scipy.spatial.KDTree:
        """Nearest neighbours among q (K, nv)."""
        return scipy.spatial.KDTree(self.scaled(q), boxsize=self._period / self.spacing)

    def scaled(self, q: Array) -> Array:
        """Joints divided by the spacing, modulo whole turns that do not matter."""
        return boxed(q / self.spacing, self._period / self.spacing)

    def random(self, count: int) -> Array:
        """Random configurations, (K, nv)."""
        return self.ranges.random(count, self._rng)

    def solved(self, index: int) -> Array:
        """Solutions in closed form at a waypoint, whole turns not included, (K, nv).

        On a grid, where joints move fast from one point to the next, or a branch ends between them,
        those between are added, unless there are others nearby.
        """
        found = [np.zeros((0, self.path_task.model.nv))]
        if self.regular(index):
            grids: list[_Grid] = []
            for arm in self.arms:
                grids.append(_Grid(self, index, arm))
                for _ in range(_HALVINGS if arm is self.arms[0] else 0):
                    every = np.concatenate([grid.q[grid.near] for grid in grids])
                    if not 0 < len(every) < _LARGEST or not grids[-1].halve(self.tree(every)):
                        break
            found += [grid.q for grid in grids]
        else:  # random poses on the waypoint and values of the given joints
            for arm in self.arms:
                q = self.random(_DRAWN)
                poses = self.rows.projected(*self.rows.chain.poses(q), index)
                found.append(arm.branches(*poses, q[:, list(arm.parameters)]))
        q = np.concatenate([part.reshape(-1, found[0].shape[1]) for part in found])
        finite: Array = q[np.isfinite(q).all(axis=1)]
        return finite

    def regular(self, index: int) -> bool:
        """Whether the solutions of a waypoint are on a grid."""
        if not self.arms or not RollGrid.applies(self.path_task, index):
            return False
        return len(self.arms[0].parameters) + self._rolls(index) <= 2

    def cover(self, index: int) -> bool:
        """Whether the solutions of a waypoint cover its manifolds, so that no net has to grow."""
        exact = all(arm.exact for arm in self.arms) and not self.rows.couplings.names
        return exact and not self.rows.hard and self.regular(index)

    def box(self, index: int, arm: ParametrisedArm) -> tuple[Array, Indices, Indices, int]:
        """A grid of the roll, if it is free, and the given joints of an arm: points (K, d).

        Also the pairs of neighbours, (E,) each, and the number of rolls, 0 or 1.
        """
        rolls, given = self._rolls(index), list(arm.parameters)
        lower = np.append(np.zeros(rolls), self._lower[given])
        upper = np.append(np.full(rolls, TURN), self._upper[given])
        spacing = np.append(np.full(rolls, self.spacing.max()), self.spacing[given])
        return *_box(lower, upper, spacing, rolls), rolls

    def at(self, index: int, arm: ParametrisedArm, points: Array) -> Array:
        """Solutions at points (K, d) of the roll, if it is free, and the given joints."""
        rolls = self._rolls(index)
        roll = points[:, 0] if rolls else np.zeros(len(points))
        return arm.branches(*rolled(self.path_task, index, roll), points[:, rolls:])

    def near(self, q: Array) -> Mask:
        """Which of q (…, nv) are inside the limits, or less than the spacing outside."""
        return np.asarray((self.ranges.room(centred(q, self.ranges)) >= -self.spacing).all(axis=-1))

    def apart(self, a: Array, b: Array) -> Array:
        """Differences of configurations, the shorter way round, in units of the spacing."""
        apart = b - a
        apart -= np.where(self.ranges.hinge, TURN * np.round(apart / TURN), 0.0)
        scaled: Array = apart / self.spacing
        return scaled

    def _rolls(self, index: int) -> int:
        """Number of rolls that a waypoint leaves free, 0 or 1."""
        return int(self.path_task.in_force[index].angular.axis is not None)


class _Grid:
    """The solutions on the grid of one choice of given joints, and its intervals.

    Attributes:
        q: The solutions, (K, B, nv).
        near: Which of them are inside the limits or near them, (K, B).
    """

    def __init__(self, seeds: Seeds, index: int, arm: ParametrisedArm) -> None:
        self.seeds, self.index, self.arm = seeds, index, arm
        points, self._first, self._second, rolls = seeds.box(index, arm)
        self._begin, self._end = points[self._first], points[self._second]
        if rolls:  # the last roll is next to the first
            self._end[:, 0] += np.where(self._end[:, 0] < self._begin[:, 0] - 1e-9, TURN, 0.0)
        self.q = seeds.at(index, arm, points)
        self.near = seeds.near(self.q)

    def halve(self, net: scipy.spatial.KDTree) -> bool:
        """Halve the intervals on which a branch moves far or ends; whether there were any."""
        a, b = self.q[self._first], self.q[self._second]
        near = self.near[self._first] | self.near[self._second]
        if not self.arm.labelled:
            a, b = self._paired(a, b)
            near = self.seeds.near(a) | self.seeds.near(b)
        # Where a branch ends, it turns into another one, which ends there, too.
        ends = near & (np.isnan(a[:, :, 0]) != np.isnan(b[:, :, 0]))
        other = b.copy()
        for k in np.flatnonzero(ends.any(axis=1)):
            last = np.where(np.isnan(a[k]), b[k], a[k])
            which = np.flatnonzero(ends[k])
            apart = np.linalg.norm(self.seeds.apart(last[which, None], last[which]), axis=2)
            np.fill_diagonal(apart, np.inf)
            a[k], other[k, which] = last, last[which[np.argmin(apart, axis=1)]]
        apart = self.seeds.apart(a, other)
        far = near & ((apart**2).sum(axis=2) > _FAR**2)
        row, branch = np.nonzero(far)
        between = a[row, branch] + 0.5 * self.seeds.spacing * apart[row, branch]
        distance, _ = net.query(self.seeds.scaled(between), distance_upper_bound=_COVERED)
        far[row, branch] = ~np.isfinite(distance)
        open_ = far.any(axis=1)
        if not open_.any():
            return False
        first, second = self._first[open_], self._second[open_]
        begin, end = self._begin[open_], self._end[open_]
        middle, new = 0.5 * (begin + end), len(self.q) + np.arange(len(first))
        found = self.seeds.at(self.index, self.arm, middle)
        self.q = np.concatenate([self.q, found])
        self.near = np.concatenate([self.near, self.seeds.near(found)])
        self._first, self._second = np.append(first, new), np.append(new, second)
        self._begin, self._end = np.vstack([begin, middle]), np.vstack([middle, end])
        return True

    def _paired(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Each of a (E, B, nv) beside the nearest of b, and each of b beside that of a."""
        distance = distances(a, b, self.seeds.apart)
        before = np.take_along_axis(a, distance.argmin(axis=1)[:, :, None], axis=1)
        after = np.take_along_axis(b, distance.argmin(axis=2)[:, :, None], axis=1)
        return np.concatenate([a, before], axis=1), np.concatenate([after, b], axis=1)


def _box(lower: Array, upper: Array, spacing: Array, around: int) -> tuple[Array, Indices, Indices]:
    """The middles of a box's cells, about as wide as the spacing, (K, d).

    Also the pairs of neighbours, (E,) each; the first ``around`` axes are closed.
    """
    counts = np.maximum((upper - lower) / spacing, 1.0)
    size = counts.prod(initial=1.0)
    wide = counts > 1.0
    finer = np.clip(size, _FEWEST, _MOST) / size
    counts[wide] *= finer ** (1.0 / max(wide.sum(), 1))
    shape = np.ceil(counts).astype(int)
    axes = [
        a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(lower, upper, shape, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    number = np.arange(len(points)).reshape(shape)
    first, second = [], []
    for axis in range(len(axes)):
        kept = np.arange(shape[axis] if axis < around else shape[axis] - 1)
        first.append(np.take(number, kept, axis=axis).ravel())
        second.append(np.take(np.roll(number, -1, axis=axis), kept, axis=axis).ravel())
    return points, np.concatenate(first), np.concatenate(second)

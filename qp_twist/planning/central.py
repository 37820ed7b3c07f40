"""The most central configurations of a waypoint: the local minima of z inside the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.bound import best_of_branches, settled_nearby
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.layer import centred
from qp_twist.planning.levels import Grid, Roadmap
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm
from qp_twist.qp import QuadraticProgram, Verified, solve

_GRID = np.radians(4.0)
_VALLEY = 0.35
"""A grid configuration with less z than all others within this distance is a seed, rad or m: a
little more than the distance of neighbours in the grid."""
_MOST = 48
"""Largest number of seeds."""
_SEEDS, _ITERATIONS, _PROJECTIONS = 300, 20, 20
_ENOUGH = 60
"""With so many seeds inside the limits, the others are dropped."""
_POLISHED = 6
"""Number of seeds at a limit that are moved on along it."""
_ALIKE = 0.02
"""Configurations whose limited joints differ by less count as one, rad or m."""
_INSET = 1e-9
"""Distance from every limit that the programs keep, rad or m."""
_ROUNDS, _HALVINGS, _SETTLING = 40, 30, 6
_FIRST, _LARGEST, _SMALLEST = 0.1, 0.4, 1e-4
"""Trust region radius: initial, largest, and the one at which the iteration ends."""
_SETTLED = 1e-9
"""Decrease of z below which the iteration ends."""


@dataclass(frozen=True, eq=False)
class CentralConfiguration:
    """A configuration on a waypoint, inside the limits, with locally minimal z.

    Attributes:
        q: The configuration, rad or m, (nv,).
        z: ½‖W(θ̄ − θ)‖² there.
        branch: Index of its branch of the closed-form inverse kinematics; ``None`` without one.
    """

    q: Array
    z: float
    branch: int | None

    def __repr__(self) -> str:
        branch = "" if self.branch is None else f", branch {self.branch}"
        return f"CentralConfiguration(z {self.z:.4f}{branch})"


def central_configurations(path_task: PathTask, index: int = 0) -> list[CentralConfiguration]:
    """The local minima of z on a waypoint inside the limits, the least first.

    For an industrial arm the seeds are all branches and whole turns on a grid of the free
    coordinate; for any other robot random configurations, corrected onto the waypoint and into the
    limits. From each seed, steps in the null space descend to the minimum, along active limits.

    Args:
        path_task: The task.
        index: The waypoint, from 0.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    descent = _Descent(rows, ranges, index)
    arm, layer = closed_form_arm(path_task), None
    if arm is not None and RollGrid.applies(path_task, index):
        joints = np.full(path_task.model.nv, 2.0 * _GRID)
        layer = RollGrid(path_task, arm, _GRID, joints).layer(index)
    if layer is not None and layer.solutions:
        valleys = _valleys(layer.q, ranges)
        branches: list[int | None] = [int(branch) for branch in layer.branch[valleys]]
        begin = layer.q[valleys]
    else:
        seeds = descent.random()
        begin = seeds[_valleys(seeds, ranges)]
        branches = [None] * len(begin)
    q = descent.lowest(begin)
    found: list[CentralConfiguration] = []
    z = ranges.centring(q)
    for number in np.argsort(z, kind="stable"):
        apart = [np.abs(q[number] - other.q)[ranges.limited].max(initial=0.0) for other in found]
        if not apart or min(apart) > _ALIKE:
            found.append(CentralConfiguration(q[number], float(z[number]), branches[number]))
    return found


def best_of_each_branch(
    found: Sequence[CentralConfiguration], count: int
) -> list[CentralConfiguration]:
    """The best of every branch, then the second of every branch, and so on."""
    seen: dict[int | None, int] = {}
    places = []
    for candidate in found:  # ordered by z
        places.append(seen.get(candidate.branch, 0))
        seen[candidate.branch] = places[-1] + 1
    return [found[number] for number in np.argsort(places, kind="stable")[:count]]


def least_mean_z(path_task: PathTask, waypoints: Sequence[int]) -> float:
    """Mean, over some waypoints, of the least z of each.

    NaN if a waypoint has no configuration inside the limits.
    """
    z, q = _least_z(path_task.without_clearance(), waypoints)
    kept = np.isnan(z)  # without clearance there is none either
    kept[~kept] = np.all([c.inside(q[~kept], WITHIN) for c in path_task.clearances], axis=0)
    touching = [index for index, keeps in zip(waypoints, kept, strict=True) if not keeps]
    if touching:
        z[~kept] = _least_z(path_task, touching)[0]
    return float(np.mean(z))


def _least_z(path_task: PathTask, waypoints: Sequence[int]) -> tuple[Array, Array]:
    """The least z of each waypoint, (N,), and its configuration, (N, nv); NaN if there is none."""
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    grid = Grid(_GRID, np.full(path_task.model.nv, 2.0 * _GRID))
    best = [
        best_of_branches(layer, ranges.centring)
        for layer in Roadmap(path_task, rows, grid).layers(waypoints)
    ]
    of = np.repeat(np.arange(len(best)), [len(q) for q in best])
    least, lowest = np.full(len(best), np.nan), np.full((len(best), path_task.model.nv), np.nan)
    begin = np.concatenate([np.zeros((0, path_task.model.nv)), *best])
    q, _ = _lowest_nearby(begin, np.asarray(waypoints, dtype=np.intp)[of], rows, ranges)
    z = ranges.centring(q)
    for number in np.argsort(-z, kind="stable"):  # the least comes last, and stays
        least[of[number]], lowest[of[number]] = z[number], q[number]
    return least, lowest


def _inside(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Mask:
    """Which of q (K, nv) on the waypoints ``at`` (K,) are inside the limits and hard bands."""
    within: Mask = ranges.inside(q)
    if rows.hard:
        within &= rows.hard.inside(q, at)
    return within


def _lowest_nearby(
    q: Array, at: Indices, rows: PathRows, ranges: JointRanges
) -> tuple[Array, Indices]:
    """Descend from configurations q (K, nv) inside the limits to the local minimum of z.

    If that is outside, go as far towards it as is inside, by bisection.

    Returns:
        The configurations, and the indices of those at a limit or band.
    """
    lower = settled_nearby(q, at, rows, ranges)
    lowest = np.where(np.isfinite(lower), lower, q)
    held = np.flatnonzero(~_inside(lowest, at, rows, ranges))
    near, far = q[held], lowest[held]
    for _ in range(_HALVINGS if len(held) else 0):
        middle, arrived = rows.correct(0.5 * (near + far), at[held])
        ok = (arrived & _inside(middle, at[held], rows, ranges))[:, None]
        near, far = np.where(ok, middle, near), np.where(ok, far, middle)
    lowest[held] = near
    return lowest, held


def _valleys(q: Array, ranges: JointRanges) -> Indices:
    """Indices of the configurations (K, nv) with locally minimal z, the least first."""
    if not len(q):
        return np.zeros(0, dtype=np.intp)
    z = ranges.centring(q)
    taken = np.zeros(len(z), dtype=bool)
    tree = KDTree(q)
    pairs = tree.query_pairs(_VALLEY, output_type="ndarray")
    first, last = np.concatenate([pairs, pairs[:, ::-1]]).T
    # Drop configurations that have a neighbour of less z.
    lowest = np.ones(len(z), dtype=bool)
    lowest[first[z[last] < z[first]]] = False
    found: list[int] = []
    for number in np.argsort(z, kind="stable"):
        if len(found) == _MOST:
            break
        if lowest[number] and not taken[number]:
            found.append(int(number))
            taken[tree.query_ball_point(q[number], _VALLEY)] = True
    return np.array(found, dtype=np.intp)


class _Descent:
    """Descend to the local minimum of z, on the waypoint and inside limits and hard bands."""

    def __init__(self, rows: PathRows, ranges: JointRanges, index: int) -> None:
        self.rows = rows
        self.ranges = ranges
        self.index = index

    def random(self) -> Array:
        """Random configurations, corrected onto the waypoint and into the limits, (K, nv).

        Alternates between clipping to the ranges, and correcting onto the waypoint and into the
        bands.
        """
        drawn = self.ranges.random(_SEEDS, np.random.default_rng(0))
        q, arrived = self.rows.correct(drawn, self._at(drawn), iterations=_ITERATIONS)
        middle = centred(q[arrived], self.ranges)
        # In a range longer than a turn, other turns are other seeds.
        turned = (middle != q[arrived]).any(axis=1)
        q = np.vstack([middle, q[arrived][turned]])
        inside = self._inside(q)
        kept, q = [q[inside]], q[~inside]
        if self.rows.hard:
            q, arrived = self.rows.correct_inside(q, self._at(q), iterations=8)
            inside = self._inside(q)
            kept.append(q[arrived & inside])
            q = q[arrived & ~inside]
        for _ in range(_PROJECTIONS if inside.sum() < _ENOUGH else 0):
            if not len(q):
                break
            clipped = np.clip(q, self.ranges.lower, self.ranges.upper)
            q, arrived = self.rows.correct_inside(clipped, self._at(q), iterations=8)
            inside = self._inside(q)
            kept.append(q[arrived & inside])
            q = q[arrived & ~inside]
        return np.vstack(kept)

    def lowest(self, q: Array) -> Array:
        """Descend from configurations q (K, nv), each inside."""
        lowest, held = _lowest_nearby(q, self._at(q), self.rows, self.ranges)
        if self.rows.freedom[self.index] > 1:
            # With more than one free direction, some descents continue along limits and bands.
            for number in held[np.argsort(self.ranges.centring(lowest[held]))][:_POLISHED]:
                lowest[number] = self._along_limits(lowest[number])
        return lowest

    def _at(self, q: Array) -> Indices:
        return np.full(len(q), self.index, dtype=np.intp)

    def _inside(self, q: Array) -> Mask:
        return _inside(q, self._at(q), self.rows, self.ranges)

    def _along_limits(self, q: Array) -> Array:
        """Sequential quadratic programs in the null space, with limits and hard bands as rows."""
        radius = _FIRST
        for _ in range(_ROUNDS):
            there = self._stepped(q, radius)
            gain = 0.0
            if there is not None:
                gain = float(self.ranges.centring(q) - self.ranges.centring(there))
            if there is None or gain <= 0.0:
                radius *= 0.25
                if radius < _SMALLEST:
                    break
                continue
            q, radius = there, min(2.0 * radius, _LARGEST)
            if gain < _SETTLED:
                break
        return q

    def _stepped(self, q: Array, radius: float) -> Array | None:
        """Solve one program and correct onto the waypoint; ``None`` if the result is outside."""
        weight = self.ranges.weight
        moved = self._solved(q, weight, weight * (self.ranges.middle - q), radius)
        for _ in range(_SETTLING):
            if moved is None:
                return None
            corrected, arrived = self.rows.correct(moved[None], np.array([self.index]))
            if not arrived[0]:
                return None
            there: Array = corrected[0]
            if self._inside(corrected)[0]:
                return there
            ones = np.ones(len(q))
            moved = self._solved(there, ones, 0.0 * ones, radius)
        return None

    def _solved(self, q: Array, weight: Array, desired: Array, radius: float) -> Array | None:
        """q + N u that minimises ‖weight · N u − desired‖ within the limits, |uᵢ| ≤ radius."""
        [basis] = self.rows.motions(q[None], np.array([self.index]))
        count = basis.shape[1]
        weighted = weight[:, None] * basis
        G = np.vstack([basis, -basis])
        g = np.concatenate([self.ranges.upper - q, q - self.ranges.lower]) - _INSET
        if self.rows.hard:
            rows, rooms, _ = self.rows.hard.rows(q[None], np.array([self.index]))
            G, g = np.vstack([G, rows[0] @ basis]), np.append(g, rooms[0] - _INSET)
        bounded = np.isfinite(g)
        problem = QuadraticProgram(
            # Joints without limits have no weight in z; a small weight keeps them in place.
            weighted.T @ weighted + 1e-9 * np.eye(count),
            -weighted.T @ desired,
            np.zeros((0, count)),
            np.zeros(0),
            G[bounded],
            g[bounded],
            np.full(count, -radius),
            np.full(count, radius),
        )
        result = solve(problem, "daqp")
        if not isinstance(result, Verified):
            return None
        moved: Array = q + basis @ result.x
        return moved

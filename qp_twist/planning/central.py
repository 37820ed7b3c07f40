"""The most central configurations of a waypoint: the local minima of z inside the limits."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # which loads its parts when they are first used

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.bound import best_of_branches
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.levels import Grid, Roadmap
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import Problem, motion_limits
from qp_twist.planning.smooth import refine

_GRID = np.radians(4.0)
_VALLEY = 0.35
"""A grid configuration with less z than all others within this distance is a seed, rad or m: a
little more than the distance of neighbours in the grid."""
_MOST, _POLISHED = 48, 6
"""Largest number of seeds; and of those at a limit that are moved on along it."""
_ALIKE = 0.02
"""Configurations whose limited joints differ by less count as one, rad or m."""
_HALVINGS = 30


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
    """The local minima of z on a waypoint, from 0, inside the limits, the least first.

    For an industrial arm the seeds are all branches and whole turns on a grid of the free
    coordinate; for any other robot what its self-motion manifolds grow from. From each seed, steps
    in the null space descend to the minimum, the best of them along active limits.
    """
    task = dataclasses.replace(
        path_task, waypoints=path_task.waypoints[index : index + 1], durations=None,
        projector=path_task.in_force[index], segments=(), flipped_waypoints=None, joint_moves=(),
        preference=None,
    )  # fmt: skip
    rows, ranges = PathRows(task), JointRanges.of(task.model)
    roadmap = central_roadmap(task, rows)
    closed_form = roadmap.rolls(0) is not None
    layer = roadmap.layers([0])[0] if closed_form else roadmap.seeded(0)
    if not layer.solutions:
        closed_form, layer = False, roadmap.within_tolerance(0)
    valleys = _valleys(layer.q, ranges)
    at = np.zeros(len(valleys), dtype=np.intp)
    q, held = _lowest_nearby(layer.q[valleys], at, rows, ranges)
    if rows.freedom[0] > 1:
        # With more than one free direction, some descents continue along limits and bands.
        limits = motion_limits(task, ranges, hard=rows.hard)
        problem = Problem(task, rows, limits, Objective.of(ranges, "centering"))
        for number in held[np.argsort(ranges.centering(q[held]))][:_POLISHED]:
            lower = refine(problem, q[number : number + 1])
            if lower.feasible:
                q[number] = lower.q[0]
    found: list[CentralConfiguration] = []
    z = ranges.centering(q)
    for number in np.argsort(z, kind="stable"):
        apart = [np.abs(q[number] - other.q)[ranges.limited].max(initial=0.0) for other in found]
        if not apart or min(apart) > _ALIKE:
            branch = int(layer.branch[valleys[number]]) if closed_form else None
            found.append(CentralConfiguration(q[number], float(z[number]), branch))
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
    rows, ranges, nv = PathRows(path_task), JointRanges.of(path_task.model), path_task.model.nv
    layers = central_roadmap(path_task, rows).layers(waypoints)
    best = [best_of_branches(layer, ranges.centering) for layer in layers]
    of = np.repeat(np.arange(len(best)), [len(q) for q in best])
    least, lowest = np.full(len(best), np.nan), np.full((len(best), nv), np.nan)
    begin = np.concatenate([np.zeros((0, nv)), *best])
    q, _ = _lowest_nearby(begin, np.asarray(waypoints, dtype=np.intp)[of], rows, ranges)
    z = ranges.centering(q)
    order = np.argsort(-z, kind="stable")  # the least comes last, and stays
    least[of[order]], lowest[of[order]] = z[order], q[order]
    return least, lowest


def central_roadmap(path_task: PathTask, rows: PathRows) -> Roadmap:
    """The layers in which central configurations are searched."""
    return Roadmap(path_task, rows, Grid(_GRID, np.full(path_task.model.nv, 2.0 * _GRID)))


def _lowest_nearby(
    q: Array, at: Indices, rows: PathRows, ranges: JointRanges
) -> tuple[Array, Indices]:
    """Descend from configurations q (K, nv) inside the limits to the local minimum of z.

    If that is outside, go as far towards it as is inside, by bisection.

    Returns:
        The configurations, and the indices of those at a limit or band.
    """

    def inside(q: Array, at: Indices) -> Mask:
        return ranges.inside(q) & rows.hard.inside(q, at)

    lower = rows.descend(q, at, ranges)
    lowest = np.where(np.isfinite(lower), lower, q)
    held = np.flatnonzero(~inside(lowest, at))
    near, far = q[held], lowest[held]
    for _ in range(_HALVINGS if len(held) else 0):
        middle, arrived = rows.correct(0.5 * (near + far), at[held])
        ok = (arrived & inside(middle, at[held]))[:, None]
        near, far = np.where(ok, middle, near), np.where(ok, far, middle)
    lowest[held] = near
    return lowest, held


def _valleys(q: Array, ranges: JointRanges) -> Indices:
    """Indices of the configurations (K, nv) with locally minimal z, the least first."""
    if not len(q):
        return np.zeros(0, dtype=np.intp)
    z = ranges.centering(q)
    tree, taken = scipy.spatial.KDTree(q), np.zeros(len(z), dtype=bool)
    first, last = tree.query_pairs(_VALLEY, output_type="ndarray").T
    # Configurations that have a neighbour of less z are none.
    taken[first[z[last] < z[first]]] = True
    taken[last[z[first] < z[last]]] = True
    found: list[int] = []
    for number in np.argsort(z, kind="stable"):
        if not taken[number] and len(found) < _MOST:
            found.append(int(number))
            taken[tree.query_ball_point(q[number], _VALLEY)] = True
    return np.array(found, dtype=np.intp)

"""Bound of the objective over all motions, from the best configuration of each waypoint alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints import JointCouplings
from qp_twist.geometry import ProjectorKind, TwistProjector, geodesic, rotation_vector
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.serial_chain import Screw
from qp_twist.paths import PathTask
from qp_twist.planning.layer import Layer
from qp_twist.planning.objective import Objective
from qp_twist.planning.pace import Pace
from qp_twist.planning.path_rows import ON_TASK, SETTLED, PathRows

_BRANCHES, _CANDIDATES = 6, 6
"""Numbers of configurations of a layer from which the search at a waypoint starts: the best of
different branches, and the best that are :data:`_APART`."""
_APART = 0.35
"""Smallest distance between the latter, in the joint that differs most, rad or m."""
_SWEEPS = 10
"""Largest number of sweeps in which a waypoint also starts from its neighbours' results."""
_NEAR_LEAST = 1.01
"""Descents that end above this multiple of their waypoint's least z are dropped."""
_FINE, _REST = 1e-13, 1e-9
"""The others go on until a step reduces z by less than the first; the second bounds what is left,
as far as z curves no less than a ten-thousandth of what Gauss-Newton steps take it for."""
_CLIMBS, _LONGEST = 40, 0.2
"""Steps of a search of the margin, and the largest of them, rad or m."""
_MARGIN_RANGE = 20.0
"""Margins further than this below the largest of their waypoint are dropped, degrees."""
_ROUNDED = 1e-14
"""Relative rounding error of a bound."""


def pointwise_bound(
    path_task: PathTask,
    objective: Objective,
    rows: PathRows,
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    start: Array | None,
    path: Array | None,
) -> float:
    r"""The objective's value if each waypoint could choose its configuration alone.

    **Centering**: the mean of the waypoints' least z, without joint limits and bands. Descents
    start from the layers, the motion that was found and the neighbours' results; from the least z
    what a task error within the tolerances ε can gain is subtracted,
    :math:`2\lVert\boldsymbol\lambda\rVert\,\epsilon` with the multipliers λ of the task rows.
    **Margin**: the smallest of the waypoints' largest margins, plus the gain that a linear program
    still finds. Both hold for the local optima that the grid and the motion have found.

    **Travel**: a theorem. Between two waypoints the task makes the frame turn by at least an angle
    α and move by at least a length d, and with the largest distance ℓ of the frame from a joint's
    axis (1 for a slide), and the smallest weight of a joint,

    .. math:: \sum_j w_j |\Delta\theta_j| \ge \min_j w_j\,\max(\alpha,\; d / \max_j \ell_j).

    Args:
        path_task: The path.
        objective: The objective.
        rows: The path's task rows.
        layers: Layers of some waypoints; the search uses the most promising configurations.
        waypoints: The layers' waypoints, from 0.
        start: The first configuration, if it is fixed.
        path: The motion that was found, (N, nv), if there is one.

    Returns:
        The bound, rounded to the safe side; at best equal to the value of ``path``.
    """
    tolerance = _tolerances(path_task)

    def candidates(cost: Callable[[Array], Array]) -> tuple[Array, Indices]:
        """For each waypoint configurations of the nearest layer, and that of the path."""
        at = np.arange(len(rows.freedom))
        owner = np.argmin(np.abs(at[:, None] - np.asarray(waypoints)), axis=1)
        chosen = [_promising(layer, cost) for layer in layers]
        q = [chosen[i] for i in owner] + ([] if path is None else [path])
        of = np.repeat(at, [len(chosen[i]) for i in owner])
        return np.concatenate(q), of if path is None else np.append(of, at)

    if objective.margin:
        bound = _largest_margin(
            objective, rows, *candidates(lambda q: -objective.margins(q)), start, tolerance
        )
        bound += _ROUNDED * abs(bound)
        return bound if path is None else max(bound, objective.value(path))
    bound = 0.0
    if objective.centering:
        ranges = objective.ranges
        z = _least_z(ranges, rows, *candidates(ranges.centering), tolerance)
        if start is not None:
            z[0] = ranges.centering(start)
        bound += objective.centering * float(z.mean())
    if objective.travel or objective.pace is not None:
        moved = least_displacements(path_task, rows.chain, tolerance)
        least = float(np.degrees(np.maximum(moved.turned, moved.travelled).sum()))
        bound += objective.travel * float(objective.joints.min(initial=1.0)) * least
        if objective.pace is not None:
            bound += objective.time * _least_time(objective.pace, moved)
    bound -= _ROUNDED * abs(bound)
    return bound if path is None else min(bound, objective.value(path))


def _tolerances(path_task: PathTask) -> Array:
    """Largest errors at which a waypoint counts as reached and couplings as kept, (3,).

    m and rad, at least :data:`ON_TASK`, the error of a plan; and the norm over all couplings.
    """
    iteration = path_task.iteration
    couplings = [c for c in path_task.constraints if isinstance(c, JointCouplings)]
    coupled = np.sqrt(sum(len(c.names) * c.tolerance**2 for c in couplings))
    position, angle = iteration.position_tolerance, iteration.angle_tolerance
    return np.array([max(position, ON_TASK), max(angle, ON_TASK), coupled])


def best_of_branches(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configuration of each of at most six branches, the best first, (K, nv)."""
    order = np.argsort(cost(layer.q), kind="stable")
    _, first = np.unique(layer.branch[order], return_index=True)
    best: Array = layer.q[order[np.sort(first)[:_BRANCHES]]]
    return best


def _promising(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configurations of different branches, and the best at a distance, (K, nv)."""
    left = layer.q[np.argsort(cost(layer.q), kind="stable")]
    found = [best_of_branches(layer, cost)]
    while len(left) and len(found) <= _CANDIDATES:
        found.append(left[:1])
        left = left[np.abs(left - left[0]).max(axis=1) > _APART]
    return np.vstack(found)


def _first_of_each(values: Array, at: Indices, count: int) -> Indices:
    """Index of each waypoint's smallest value (arbitrary if all are NaN), (count,)."""
    order = np.lexsort((np.nan_to_num(values, nan=np.inf), at))
    _, first = np.unique(at[order], return_index=True)
    found: Indices = order[first]
    assert len(found) == count
    return found


def _least_z(ranges: JointRanges, rows: PathRows, q: Array, at: Indices, tolerance: Array) -> Array:
    """Lower bound of each waypoint's z, from configurations q (K, nv), (N,)."""
    count = len(rows.freedom)
    q = rows.descend(q, at, ranges)
    z = ranges.centering(q)
    best = q[_first_of_each(z, at, count)]
    # A neighbour may have a minimum that is missing here: only some waypoints have layers, and a
    # layer may have missed it.
    changed = np.arange(count)
    for _ in range(_SWEEPS):
        improved = np.zeros(count, dtype=bool)
        for step in (1, -1):
            to = changed[(changed + step >= 0) & (changed + step < count)] + step
            there = rows.descend(best[to - step], to, ranges)
            lower = ranges.centering(there) < ranges.centering(best[to]) - SETTLED
            best[to[lower]] = there[lower]
            improved[to[lower]] = True
        changed = np.flatnonzero(improved)
        if not len(changed):
            break
    least = ranges.centering(best)
    if not np.isfinite(least).all():
        return least
    near = np.flatnonzero(z <= _NEAR_LEAST * least[at])
    q, at = np.vstack([best, q[near]]), np.concatenate([np.arange(count), at[near]])
    q = rows.descend(q, at, ranges, _FINE)
    lengths = rows.multipliers(q, at, ranges.weight**2 * (q - ranges.middle))
    gained = _REST * rows.freedom.any() + 2.0 * tolerance @ lengths
    bounds = np.full(count, np.inf)
    np.minimum.at(bounds, at, ranges.centering(q) - gained)
    found: Array = np.maximum(bounds, 0.0)
    return found


def _largest_margin(
    objective: Objective,
    rows: PathRows,
    q: Array,
    at: Indices,
    start: Array | None,
    tolerance: Array,
) -> float:
    """Upper bound of the smallest of the waypoints' largest margins, from q (K, nv), degrees."""
    count = len(rows.freedom)
    margins = objective.margins(q)
    promising = margins > margins[_first_of_each(-margins, at, count)][at] - _MARGIN_RANGE
    at = at[promising]
    q = _climbed(q[promising], at, rows, objective)
    best = q[_first_of_each(-objective.margins(q), at, count)]
    margins = objective.margins(best)
    settled = np.zeros(count, dtype=bool)
    if start is not None:
        margins[0], settled[0] = objective.margins(start), True
    # Only the smallest counts: refine it until the smallest is one that was refined before.
    while not settled[k := int(np.argmin(margins))]:
        margins[k] = _upper_margin(best[k], k, rows, objective, tolerance)
        settled[k] = True
    return float(margins[k])


def _climbed(q: Array, at: Indices, rows: PathRows, objective: Objective) -> Array:
    """Local maximum of the margin, by a pattern search along the null space's basis."""
    q, arrived = rows.correct(q, at)
    step = np.full(len(q), _LONGEST)
    for _ in range(_CLIMBS):
        basis = rows.motions(q, at)
        better = np.zeros(len(q), dtype=bool)
        for direction in np.concatenate([basis, -basis], axis=2).transpose(2, 0, 1):
            there, ok = rows.correct(q + step[:, None] * direction, at)
            wins = ok & (objective.margins(there) > objective.margins(q))
            q[wins] = there[wins]
            better |= wins
        step[~better] *= 0.5
    q[~arrived] = np.nan
    return q


def _upper_margin(
    q: Array, index: int, rows: PathRows, objective: Objective, tolerance: Array
) -> float:
    """Upper bound of the largest margin near q (nv,) on a waypoint, degrees."""
    at, radius = np.array([index]), _LONGEST
    for _ in range(2 * _CLIMBS):
        there, gain = _linear_step(q, at, rows, objective, radius)
        if gain < 1e-12 or radius < 1e-10:
            break
        moved, arrived = rows.correct(there[None], at)
        if arrived[0] and objective.margins(moved[0]) > objective.margins(q):
            q, radius = moved[0], min(2.0 * radius, _LONGEST)
        else:
            radius *= 0.25
    _, missed = _linear_step(q, at, rows, objective, _LONGEST)
    # A task error e lets the joints move by |e|/σ orthogonally to the null space.
    sigma = float(rows.sigma_min(q[None], at)[0])
    error = 2.0 * float(np.linalg.norm(tolerance))
    orthogonal = error / sigma if sigma > 0.0 else 0.0
    return float(objective.margins(q)) + float(np.degrees(missed + orthogonal))


def _linear_step(
    q: Array, at: Indices, rows: PathRows, objective: Objective, radius: float
) -> tuple[Array, float]:
    """q + N u that maximises the linearised margin for |u| ≤ radius, and the gain, rad."""
    from scipy.optimize import linprog  # imported on demand: 0.2 s

    [basis] = rows.motions(q[None], at)
    distance = np.concatenate([objective.ranges.upper - q, q - objective.ranges.lower])
    bounded = np.isfinite(distance)
    moving = np.vstack([basis, -basis])[bounded]
    free = basis.shape[1]
    found = linprog(
        np.append(np.zeros(free), -1.0),
        np.column_stack([moving, np.ones(len(moving))]),
        distance[bounded] - float(distance.min()),
        bounds=[(-radius, radius)] * free + [(0.0, None)],
        method="highs",
    )
    if found.x is None:
        return q, 0.0
    there: Array = q + basis @ found.x[:free]
    return there, max(float(found.x[-1]), 0.0)


class Displacements(NamedTuple):
    """Least displacements from each waypoint to the next, (N − 1,) each."""

    turned: Array
    """Of the frame, rad."""
    shifted: Array
    """Of the frame, m."""
    travelled: Array
    """Of the joints together because of the shift, rad or m."""
    levers: Array
    """Largest distance of the frame from each joint's axis, m, or 1 for slides, (n,)."""
    dofs: Indices
    """The joints' degrees of freedom, (n,)."""


def least_displacements(path_task: PathTask, chain: SerialChain, tolerance: Array) -> Displacements:
    """By what the task prescribes, but for errors of the waypoints, m and rad, (≥ 2,)."""
    screws = chain.screws
    levers, dofs = _levers(path_task, chain)
    farthest = float(levers.max(initial=0.0))
    inner = float(levers[1:].max(initial=0.0))  # the first joint's axis is fixed in the world
    T, first = path_task.in_force, screws[0] if screws else None
    rotations, positions = path_task.poses
    found = np.zeros((3, len(T) - 1))
    for k in range(len(T) - 1):
        turned = _least_turn(T[k], T[k + 1], rotations[k], rotations[k + 1])
        shift = _least_shift(T[k], T[k + 1], positions[k + 1] - positions[k])
        shift -= 2.0 * tolerance[0]
        near = farthest
        if first is not None and all(_sees_distance(t, first) for t in (T[k], T[k + 1])):
            apart = float(np.linalg.norm(np.cross(first.axis, positions[k] - first.anchor)))
            near = min(farthest, max(apart + tolerance[0], inner))
        # A travel t increases the frame's distance from the first axis by at most farthest·t.
        moved = 0.0
        if shift > 0.0 and np.isfinite(farthest):
            moved = 2.0 * shift / (near + np.sqrt(near**2 + 4.0 * farthest * shift))
        found[:, k] = turned - 2.0 * tolerance[1], shift, moved
    turned, shifted, travelled = np.maximum(found, 0.0)
    return Displacements(turned, shifted, travelled, levers, dofs)


def steps_beyond_joints(path_task: PathTask, chain: SerialChain, steps: Array) -> Indices:
    """Steps whose prescribed shift or turn is more than all joints together make, from 0, (K,).

    A theorem for joints that move by at most ``steps`` (N − 1, nv), rad or m.
    """
    levers, dofs = _levers(path_task, chain)
    tolerance, T, within = _tolerances(path_task), path_task.in_force, steps[:, dofs]
    rotations, positions = path_task.poses
    turn = within.sum(axis=1) + 2.0 * tolerance[1]
    shift = np.where(levers > 0.0, levers * within, 0.0).sum(axis=1) + 2.0 * tolerance[0]
    apart = np.diff(positions, axis=0)
    change = np.einsum("kij,kij->k", rotations[1:], rotations[:-1])  # its trace: 1 + 2 cos
    turned = np.arccos(np.clip(0.5 * (change - 1.0), -1.0, 1.0))
    near = np.flatnonzero((np.linalg.norm(apart, axis=1) > shift) | (turned > turn))
    beyond = [
        k
        for k in near.tolist()
        if _least_shift(T[k], T[k + 1], apart[k]) > shift[k]
        or _least_turn(T[k], T[k + 1], rotations[k], rotations[k + 1]) > turn[k]
    ]
    return np.array(beyond, dtype=np.intp)


def _levers(path_task: PathTask, chain: SerialChain) -> tuple[Array, Indices]:
    """Largest distance of the frame from each joint's axis, m, 1 for slides; and its dof, (n,)."""
    ranges, screws = JointRanges.of(path_task.model), chain.screws
    dofs = np.array([screw.dof for screw in screws], dtype=np.intp)
    reference = [screw.reference for screw in screws]
    ends = np.array([ranges.lower[dofs], ranges.upper[dofs]])
    return chain.levers(np.abs(ends - reference).max(axis=0)), dofs


def _least_time(pace: Pace, least: Displacements) -> float:
    """Lower bound of the time of a path, s, by the speeds of all joints together."""
    speeds = pace.velocity[least.dofs]
    turning, shifting = speeds.sum(), np.where(least.levers > 0.0, least.levers * speeds, 0.0).sum()
    times = np.maximum(least.turned / turning, least.shifted / shifting)
    return float(np.maximum(times, pace.feed).sum())


def _sees_distance(projector: TwistProjector, first: Screw) -> bool:
    """Whether the task fixes the frame's distance from the first joint's axis (a hinge)."""
    if first.slides or projector.linear.kind is ProjectorKind.FULL:
        return not first.slides
    plane = projector.linear.kind is ProjectorKind.PLANE and projector.frame == "world"
    axis = projector.linear.axis
    return plane and axis is not None and bool(abs(axis @ first.axis) > 1.0 - 1e-12)


def _least_shift(before: TwistProjector, after: TwistProjector, apart: Array) -> float:
    """Least displacement of the frame between two waypoints that are ``apart`` (3,), m."""
    if before.linear.kind is after.linear.kind is ProjectorKind.FULL:
        return float(np.linalg.norm(apart))
    if before is after and before.frame == "world":
        return float(np.linalg.norm(before.linear.matrix @ apart))
    return 0.0


def _least_turn(before: TwistProjector, after: TwistProjector, R: Array, R_next: Array) -> float:
    """Least rotation angle of the frame between waypoints with rotations R, R_next (3, 3), rad.

    A plane projector holds one direction of the body along one direction in space. That direction
    also turns if the task holds the whole rotation at the other waypoint.
    """
    held = [p for p in (before, after) if p.angular.kind is ProjectorKind.PLANE]
    kinds = {before.angular.kind, after.angular.kind}
    if kinds == {ProjectorKind.FULL}:
        return float(np.linalg.norm(rotation_vector(R_next @ R.T)))
    if not kinds <= {ProjectorKind.FULL, ProjectorKind.PLANE}:
        return 0.0
    if len(held) == 2 and before is not after:
        return 0.0
    axis = held[0].angular.axis
    assert axis is not None
    # A fixed world axis coincides with a different body direction at each of the two waypoints.
    fixed = held[0].frame == "world"
    ends = (R.T @ axis, R_next.T @ axis) if fixed else (R @ axis, R_next @ axis)
    return float(np.linalg.norm(geodesic(*ends)))

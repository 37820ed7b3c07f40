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
from qp_twist.planning.path_rows import ON_TASK, PathRows

_BRANCHES, _CANDIDATES = 6, 6
"""Numbers of configurations of a layer from which the search at a waypoint starts: the best of
different branches, and the best that are :data:`_APART`."""
_APART = 0.35
"""Smallest distance between the latter, in the joint that differs most, rad or m."""
_ROUNDS = 20
_LONGEST = 0.2
"""Largest step of an iteration, rad or m."""
_SETTLED = 1e-9
"""A descent ends when a step would reduce z by less, to first order; Newton's method follows."""
_RESTARTS = 20
"""Largest number of restarts of a descent that has not converged."""
_SWEEPS = 10
"""Largest number of sweeps in which a waypoint also starts from its neighbours' results."""
_NEAR_LEAST = 1.01
"""Descents that end above this multiple of their waypoint's least z are dropped."""
_MARGIN_RANGE = 20.0
"""Margins further than this below the largest of their waypoint are dropped, degrees."""
_NEWTON_STEPS = 6
_PROBE = 1e-3
"""Step length of the finite differences for the second derivatives of z, rad or m."""
_FLAT = 1e-6
"""Share of the largest second derivative below which z counts as flat."""
_SAFETY = 2.0
"""Safety factor on the remainder of the second-order model."""
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

    **Centering**: the mean of the waypoints' least z, without joint limits and bands. At each
    waypoint, descents start from configurations of the grid's layers, from the motion that was
    found, and from the neighbours' results. Each ends, by Newton's method along the null space, at
    a local minimum q of z on the waypoint. The bound subtracts from z(q) the possible distance to
    that minimum and the gain that a task error within the tolerance allows,

    .. math::

        \mathbf g^T \mathbf H^{-1} \mathbf g
        + \lVert\boldsymbol\lambda_v\rVert\,\epsilon_v
        + \lVert\boldsymbol\lambda_\omega\rVert\,\epsilon_\omega,

    with g and H the derivatives of z along the null space (twice the remainder of the second-order
    model), λ the multipliers of the task rows and ε the tolerances. **Margin**: the smallest of the
    waypoints' largest margins, plus the gain that a linear program still finds. Both bounds hold
    for the local optima that the grid and the motion have found, not for optima that they missed.

    **Travel**: a theorem, independent of any search. Between two waypoints the task makes the frame
    turn by at least an angle α and move by at least a length d, and

    .. math::

        \sum_j |\Delta\theta_j| \ge \alpha, \qquad
        \sum_j |\Delta\theta_j| \ge d \,/\, \max_j \ell_j

    with the largest distance ℓ of the frame from a joint's axis between them (1 for a slide). Where
    the joints are weighted, times the smallest of their weights.

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
    tolerance = Tolerance.of(path_task)
    if objective.margin:
        bound = _largest_margin(objective, rows, layers, waypoints, start, path, tolerance)
        bound += _ROUNDED * abs(bound)
        return bound if path is None else max(bound, objective.value(path))
    bound = 0.0
    if objective.centering:
        z = _least_z(objective.ranges, rows, layers, waypoints, path, tolerance)
        if start is not None:
            z[0] = objective.ranges.centring(start)
        bound += objective.centering * float(z.mean())
    if objective.travel:
        least = _least_travel(path_task, rows.chain, tolerance)
        bound += objective.travel * float(objective.joints.min(initial=1.0)) * least
    bound -= _ROUNDED * abs(bound)
    return bound if path is None else min(bound, objective.value(path))


class Tolerance(NamedTuple):
    """Largest errors at which a waypoint counts as reached and couplings as kept."""

    linear: float
    """m."""
    angular: float
    """rad."""
    coupled: float
    """Euclidean norm over all couplings, rad and m."""

    @classmethod
    def of(cls, path_task: PathTask) -> Tolerance:
        """The tolerances of a task, at least :data:`ON_TASK`, the error of a plan."""
        iteration = path_task.iteration
        couplings = [c for c in path_task.constraints if isinstance(c, JointCouplings)]
        return cls(
            max(iteration.position_tolerance, ON_TASK),
            max(iteration.angle_tolerance, ON_TASK),
            float(np.sqrt(sum(len(c.names) * c.tolerance**2 for c in couplings))),
        )


def _candidates(
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    path: Array | None,
    count: int,
    cost: Callable[[Array], Array],
) -> tuple[Array, Indices]:
    """Starting configurations: for each waypoint those of the nearest layer, and of ``path``."""
    owner = np.argmin(np.abs(np.arange(count)[:, None] - np.asarray(waypoints)), axis=1)
    chosen = [_promising(layer, cost) for layer in layers]
    q = np.concatenate([chosen[i] for i in owner])
    at = np.repeat(np.arange(count), [len(chosen[i]) for i in owner])
    if path is not None:
        q, at = np.vstack([q, path]), np.concatenate([at, np.arange(count)])
    return q, at


def _promising(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configurations of different branches, and the best at a distance, (K, nv)."""
    left = layer.q[np.argsort(cost(layer.q), kind="stable")]
    found = [best_of_branches(layer, cost)]
    while len(left) and len(found) <= _CANDIDATES:
        found.append(left[:1])
        left = left[np.abs(left - left[0]).max(axis=1) > _APART]
    return np.vstack(found)


def _least_z(
    ranges: JointRanges,
    rows: PathRows,
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    path: Array | None,
    tolerance: Tolerance,
) -> Array:
    """Lower bound of each waypoint's z: the least z of all descents less its remainder, (N,)."""
    count = len(rows.freedom)
    q, at = _candidates(layers, waypoints, path, count, ranges.centring)
    q = settled_nearby(q, at, rows, ranges)
    z = ranges.centring(q)
    lowest = _first_of_each(z, at, count)
    best = q[lowest]
    # A neighbour may have a minimum that is missing here: only some waypoints have layers, and a
    # layer may have missed it.
    changed = np.arange(count)
    for _ in range(_SWEEPS):
        improved = np.zeros(count, dtype=bool)
        for step in (1, -1):
            to = changed[(changed + step >= 0) & (changed + step < count)] + step
            there = settled_nearby(best[to - step], to, rows, ranges)
            lower = ranges.centring(there) < ranges.centring(best[to]) - _SETTLED
            best[to[lower]] = there[lower]
            improved[to[lower]] = True
        changed = np.flatnonzero(improved)
        if not len(changed):
            break
    least = ranges.centring(best)
    if not np.isfinite(least).all():
        return least
    near = np.flatnonzero(z <= _NEAR_LEAST * least[at])
    q, at = np.vstack([best, q[near]]), np.concatenate([np.arange(count), at[near]])
    q = _polished(q, at, rows, ranges)
    bounds = np.full(count, np.inf)
    np.minimum.at(bounds, at, ranges.centring(q) - _remainder(q, at, rows, ranges, tolerance))
    found: Array = np.maximum(bounds, 0.0)
    return found


def settled_nearby(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """:func:`centred_nearby`, restarted until it has converged, (K, nv)."""
    q, moving = q.copy(), np.arange(len(q))
    before = np.full(len(q), np.inf)
    for _ in range(_RESTARTS):
        q[moving] = centred_nearby(q[moving], at[moving], rows, ranges)
        z = ranges.centring(q[moving])
        # False for NaN: such a configuration has not reached its waypoint.
        gained = z < before - _SETTLED
        moving, before = moving[gained], z[gained]
        if not len(moving):
            break
    return q


def _first_of_each(values: Array, at: Indices, count: int) -> Indices:
    """Index of each waypoint's smallest value (arbitrary if all are NaN), (count,)."""
    order = np.lexsort((np.nan_to_num(values, nan=np.inf), at))
    _, first = np.unique(at[order], return_index=True)
    found: Indices = order[first]
    assert len(found) == count
    return found


def _polished(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """Newton's method along the null space for a local minimum of z, from q (K, nv)."""
    for _ in range(_NEWTON_STEPS if rows.freedom.any() else 0):
        basis, gradient, hessian = _second_order(q, at, rows, ranges)
        values, vectors = np.linalg.eigh(hessian)
        curved = np.abs(values) > _FLAT * np.abs(values).max(axis=1, keepdims=True, initial=1e-300)
        # |curvature|: with negative curvature Newton's step would lead up to a saddle.
        inverse = np.where(curved, 1.0 / np.where(curved, np.abs(values), 1.0), 0.0)
        along = (vectors.transpose(0, 2, 1) @ gradient[:, :, None])[:, :, 0]
        step = -(basis @ (vectors @ (inverse * along)[:, :, None]))[:, :, 0]
        longest = np.abs(step).max(axis=1, initial=_LONGEST)
        there, arrived = rows.correct(q + step * (_LONGEST / longest)[:, None], at)
        lower = arrived & (ranges.centring(there) < ranges.centring(q))
        q = np.where(lower[:, None], there, q)
    return q


def _second_order(
    q: Array, at: Indices, rows: PathRows, ranges: JointRanges
) -> tuple[Array, Array, Array]:
    """Bases of the null space (K, nv, d), and the derivatives of z along them, (K, d), (K, d, d).

    The second derivatives are central differences of z at steps that are corrected onto the
    waypoint.
    """
    basis = rows.motions(q, at)
    weight = ranges.weight**2
    gradient = ((weight * (q - ranges.middle))[:, None] @ basis)[:, 0]
    free = basis.shape[2]
    hessian = np.zeros((len(q), free, free))

    def z(u: Array) -> Array:
        there, _ = rows.correct(q + basis @ u, at)
        values: Array = ranges.centring(there)
        return values

    here, eye = ranges.centring(q), _PROBE * np.eye(free)
    for i in range(free):
        ends = z(eye[i]) + z(-eye[i])
        hessian[:, i, i] = (ends - 2.0 * here) / _PROBE**2
        for j in range(i):
            mixed = z(eye[i] + eye[j]) + z(-eye[i] - eye[j]) - z(eye[i] - eye[j])
            mixed -= z(eye[j] - eye[i])
            hessian[:, i, j] = hessian[:, j, i] = 0.25 * mixed / _PROBE**2
    return basis, gradient, hessian


def _remainder(
    q: Array, at: Indices, rows: PathRows, ranges: JointRanges, tolerance: Tolerance
) -> Array:
    """Bound of z(q) less the local minimum of z within the task tolerances, (K,)."""
    remainder = np.zeros(len(q))
    if rows.freedom.any():
        _, gradient, hessian = _second_order(q, at, rows, ranges)
        values, vectors = np.linalg.eigh(hessian)
        along = (vectors.transpose(0, 2, 1) @ gradient[:, :, None])[:, :, 0]
        floor = _FLAT * np.abs(values).max(axis=1, keepdims=True, initial=1e-300)
        remainder = (0.5 * _SAFETY * along**2 / np.maximum(values, floor)).sum(axis=1)
    gradient_of_z = ranges.weight**2 * (q - ranges.middle)
    linear, angular, coupled = rows.multipliers(q, at, gradient_of_z)
    remainder += 2.0 * linear * tolerance.linear + 2.0 * angular * tolerance.angular
    remainder += 2.0 * coupled * tolerance.coupled
    return remainder


def best_of_branches(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configuration of each of at most six branches, the best first, (K, nv)."""
    order = np.argsort(cost(layer.q), kind="stable")
    _, first = np.unique(layer.branch[order], return_index=True)
    best: Array = layer.q[order[np.sort(first)[:_BRANCHES]]]
    return best


def centred_nearby(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """Local minimum of z, by Gauss-Newton steps along the null space; NaN where it fails.

    Joint limits are not enforced.
    """
    return rows.descend(q, at, ranges, (_ROUNDS, _LONGEST, _SETTLED))


def _climbed(q: Array, at: Indices, rows: PathRows, objective: Objective) -> Array:
    """Local maximum of the margin, by a pattern search along the null space's basis."""
    q, arrived = rows.correct(q, at)
    step = np.full(len(q), _LONGEST)
    for _ in range(2 * _ROUNDS):
        basis = rows.motions(q, at)
        better = np.zeros(len(q), dtype=bool)
        for direction in range(basis.shape[2]):
            for sign in (1.0, -1.0):
                there, ok = rows.correct(q + sign * step[:, None] * basis[:, :, direction], at)
                wins = ok & (objective.margins(there) > objective.margins(q))
                q[wins] = there[wins]
                better |= wins
        step[~better] *= 0.5
    q[~arrived] = np.nan
    return q


def _largest_margin(
    objective: Objective,
    rows: PathRows,
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    start: Array | None,
    path: Array | None,
    tolerance: Tolerance,
) -> float:
    """Upper bound of the smallest of the waypoints' largest margins, degrees."""
    count = len(rows.freedom)
    q, at = _candidates(layers, waypoints, path, count, lambda q: -objective.margins(q))
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


def _upper_margin(
    q: Array, index: int, rows: PathRows, objective: Objective, tolerance: Tolerance
) -> float:
    """Upper bound of the largest margin near q (nv,) on a waypoint, degrees."""
    at, radius = np.array([index]), _LONGEST
    for _ in range(4 * _ROUNDS):
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
    [basis] = rows.motions(q[None], at)
    ranges = objective.ranges
    distance = np.concatenate([ranges.upper - q, q - ranges.lower])
    bounded = np.isfinite(distance)
    moving = np.vstack([basis, -basis])[bounded]
    free = basis.shape[1]
    least = float(distance.min())
    from scipy.optimize import linprog  # imported on demand: 0.2 s

    found = linprog(
        np.append(np.zeros(free), -1.0),
        np.column_stack([moving, np.ones(len(moving))]),
        distance[bounded] - least,
        bounds=[(-radius, radius)] * free + [(0.0, None)],
        method="highs",
    )
    if found.x is None:
        return q, 0.0
    there: Array = q + basis @ found.x[:free]
    return there, max(float(found.x[-1]), 0.0)


def _least_travel(path_task: PathTask, chain: SerialChain, tolerance: Tolerance) -> float:
    """Lower bound of the joints' travel over the path, by the task's displacements, degrees."""
    ranges = JointRanges.of(path_task.model)
    lever, farthest, at = 0.0, 0.0, chain.position
    inner = 0.0  # as ``farthest``, without the first joint, whose axis is fixed in the world
    for number, screw in reversed(list(enumerate(chain.screws))):
        lever, at = lever + float(np.linalg.norm(screw.anchor - at)), screw.anchor
        farthest = max(farthest, 1.0 if screw.slides else lever)
        if screw.slides:
            ends = np.array([ranges.lower[screw.dof], ranges.upper[screw.dof]])
            lever += float(np.abs(ends - screw.reference).max())
        if number == 1:
            inner = farthest
    total = 0.0
    first = chain.screws[0] if chain.screws else None
    for k, (before, after) in enumerate(
        zip(path_task.in_force[:-1], path_task.in_force[1:], strict=True)
    ):
        here, there = path_task.waypoints[k], path_task.waypoints[k + 1]
        R, R_next = here.rotation().as_matrix(), there.rotation().as_matrix()
        turned = _least_turn(before, after, R, R_next) - 2.0 * tolerance.angular
        shift = _least_shift(before, after, there.translation() - here.translation())
        shift -= 2.0 * tolerance.linear
        near = farthest
        if first is not None and _sees_distance(before, first) and _sees_distance(after, first):
            apart = here.translation() - first.anchor
            axis_distance = float(np.linalg.norm(np.cross(first.axis, apart))) + tolerance.linear
            near = min(farthest, max(axis_distance, inner))
        # A travel t increases the frame's distance from the first axis by at most farthest·t.
        moved = 0.0
        if shift > 0.0 and np.isfinite(farthest):
            moved = 2.0 * shift / (near + np.sqrt(near**2 + 4.0 * farthest * shift))
        total += max(turned, moved, 0.0)
    return float(np.degrees(total))


def _sees_distance(projector: TwistProjector, first: Screw) -> bool:
    """Whether the task fixes the frame's distance from the first joint's axis (a hinge)."""
    if first.slides or _whole(projector):
        return not first.slides
    plane = projector.linear.kind is ProjectorKind.PLANE and projector.frame == "world"
    axis = projector.linear.axis
    return plane and axis is not None and bool(abs(axis @ first.axis) > 1.0 - 1e-12)


def _whole(projector: TwistProjector) -> bool:
    return projector.linear.kind is ProjectorKind.FULL


def _least_shift(before: TwistProjector, after: TwistProjector, apart: Array) -> float:
    """Least displacement of the frame between two waypoints that are ``apart`` (3,), m."""
    if _whole(before) and _whole(after):
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

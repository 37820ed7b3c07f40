"""What no motion can be better than: the best of every waypoint for itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from qp_twist.checks import Array, Indices
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.serial_chain import Screw
from qp_twist.limits import JointCouplings
from qp_twist.path import PathTask
from qp_twist.planning.layer import Layer
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import ON_TASK, PathRows, newton

_BRANCHES, _CANDIDATES = 6, 6
"""Configurations of a layer from which a waypoint's best is looked for: of different branches, and
of any that are apart."""
_APART = 0.35
"""How far those are apart in some joint at least, rad or m."""
_ROUNDS = 20
_LONGEST = 0.2
"""Largest step of a round, rad or m."""
_SETTLED = 1e-9
"""Less of z to gain by a step, to first order, is nothing: Newton's method goes on from there."""
_AGAIN = 20
"""Times that descents are gone on with which still gain."""
_SWEEPS = 10
"""Times that a waypoint also begins where its neighbours ended."""
_WORTH = 1.01
"""Descents that end above so many times the least z of their waypoint are not led on."""
_HOPEFUL = 20.0
"""Nor is a margin that is less than the largest of its waypoint by so much, degrees."""
_POLISHED = 6
"""Newton steps."""
_PROBE = 1e-3
"""Length of the steps from which second derivatives of z are told, rad or m."""
_FLAT = 1e-6
"""Share of the largest second derivative, below which z counts as flat."""
_SAFETY = 2.0
"""Times the remainder of the second-order model that is taken off."""
_ROUNDED = 1e-14
"""Share of a bound that the arithmetic may have lost."""


def pointwise_bound(
    path_task: PathTask,
    objective: Objective,
    rows: PathRows,
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    start: Array | None,
    path: Array | None,
) -> float:
    r"""The value which the objective would have if every waypoint stood alone.

    **Centering**: the mean of the waypoints' least z. What joint limits and bands take away is not
    counted. Of each waypoint the descents begin at configurations of the grid's layers, at the
    motion that was found, and where its neighbours' ended; each ends, by Newton's method along the
    null space, at a local minimum q of z on the waypoint. From z(q) is taken off what it may still
    be above that minimum and what a task error within the tolerance may gain,

    .. math::

        \mathbf g^T \mathbf H^{-1} \mathbf g
        + \lVert\boldsymbol\lambda_v\rVert\,\epsilon_v
        + \lVert\boldsymbol\lambda_\omega\rVert\,\epsilon_\omega,

    with g and H the derivatives of z along the null space (twice the remainder of the second-order
    model), λ the multipliers of the task rows and ε the tolerances. **Margin**: the least of the
    waypoints' largest margins, likewise with the gain that a linear program still sees. So both are
    proved of the valleys that the grid and the motion have found, and not of ones that they missed.

    **Travel**: a theorem, whatever was found. On the way from one waypoint to the next the frame
    turns by the angle α and moves by the length d at least, which the task fixes, and

    .. math::

        \sum_j |\Delta\theta_j| \ge \alpha, \qquad
        \sum_j |\Delta\theta_j| \ge d \,/\, \max_j \ell_j

    with the largest distance ℓ of the frame from a joint's axis on the way (1 for a slide).

    Args:
        path_task: The path.
        objective: The objective.
        rows: Of the path.
        layers: Of some waypoints; in each the most promising configurations are looked at.
        waypoints: Of those layers, from 0.
        start: The first configuration, if it is given.
        path: The motion that was found, (N, nv), if there is one.

    Returns:
        The bound, not better than the value of ``path``, and rounded to the safe side.
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
        bound += objective.travel * _least_travel(path_task, rows.chain, tolerance)
    bound -= _ROUNDED * abs(bound)
    return bound if path is None else min(bound, objective.value(path))


class Tolerance(NamedTuple):
    """Task errors of a waypoint that counts as reached, and of couplings that count as kept."""

    linear: float
    """m."""
    angular: float
    """rad."""
    coupled: float
    """rad and m, the length of all couplings' together."""

    @classmethod
    def of(cls, path_task: PathTask) -> Tolerance:
        """Those of a task; a plan's are at most :data:`ON_TASK`."""
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
    """Promising configurations, for every waypoint those of the nearest layer and of the path."""
    owner = np.argmin(np.abs(np.arange(count)[:, None] - np.asarray(waypoints)), axis=1)
    chosen = [_promising(layer, cost) for layer in layers]
    q = np.concatenate([chosen[i] for i in owner])
    at = np.repeat(np.arange(count), [len(chosen[i]) for i in owner])
    if path is not None:
        q, at = np.vstack([q, path]), np.concatenate([at, np.arange(count)])
    return q, at


def _promising(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configurations of different branches, and the best that are apart, (K, nv)."""
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
    """Of each waypoint the least z that descents find, less what they may have missed, (N,)."""
    count = len(rows.freedom)
    q, at = _candidates(layers, waypoints, path, count, ranges.centring)
    q = settled_nearby(q, at, rows, ranges)
    z = ranges.centring(q)
    lowest = _first_of_each(z, at, count)
    best = q[lowest]
    # Where only some waypoints have layers, or a layer missed a valley, a neighbour may have it.
    ahead = np.arange(count)
    for _ in range(_SWEEPS):
        improved = np.zeros(count, dtype=bool)
        for step in (1, -1):
            to = ahead[(ahead + step >= 0) & (ahead + step < count)] + step
            there = settled_nearby(best[to - step], to, rows, ranges)
            lower = ranges.centring(there) < ranges.centring(best[to]) - _SETTLED
            best[to[lower]] = there[lower]
            improved[to[lower]] = True
        ahead = np.flatnonzero(improved)
        if not len(ahead):
            break
    least = ranges.centring(best)
    if not np.isfinite(least).all():
        return least
    worth = np.flatnonzero(z <= _WORTH * least[at])
    q, at = np.vstack([best, q[worth]]), np.concatenate([np.arange(count), at[worth]])
    q = _polished(q, at, rows, ranges)
    bounds = np.full(count, np.inf)
    np.minimum.at(bounds, at, ranges.centring(q) - _remainder(q, at, rows, ranges, tolerance))
    found: Array = np.maximum(bounds, 0.0)
    return found


def settled_nearby(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """:func:`centred_nearby`, gone on with where it has not come to an end, (K, nv)."""
    q, moving = q.copy(), np.arange(len(q))
    before = np.full(len(q), np.inf)
    for _ in range(_AGAIN):
        q[moving] = centred_nearby(q[moving], at[moving], rows, ranges)
        z = ranges.centring(q[moving])
        # What is NaN has not arrived on its waypoint, and does not go on.
        gained = z < before - _SETTLED
        moving, before = moving[gained], z[gained]
        if not len(moving):
            break
    return q


def _first_of_each(values: Array, at: Indices, count: int) -> Indices:
    """The number of the least of each waypoint's values; of those that are NaN any, (count,)."""
    order = np.lexsort((np.nan_to_num(values, nan=np.inf), at))
    _, first = np.unique(at[order], return_index=True)
    found: Indices = order[first]
    assert len(found) == count
    return found


def _polished(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """Newton's method for the least z nearby, along the null space, from q (K, nv)."""
    for _ in range(_POLISHED if rows.freedom.any() else 0):
        basis, gradient, hessian = _second_order(q, at, rows, ranges)
        values, vectors = np.linalg.eigh(hessian)
        curved = np.abs(values) > _FLAT * np.abs(values).max(axis=1, keepdims=True, initial=1e-300)
        # Where z curves downwards it is no minimum: go on down, not to the saddle.
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

    The second ones by differences of the gradient along steps that return to the waypoint.
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
    """What the least z nearby, at a task error within the tolerance, may be below z(q), (K,)."""
    missed = np.zeros(len(q))
    if rows.freedom.any():
        _, gradient, hessian = _second_order(q, at, rows, ranges)
        values, vectors = np.linalg.eigh(hessian)
        along = (vectors.transpose(0, 2, 1) @ gradient[:, :, None])[:, :, 0]
        floor = _FLAT * np.abs(values).max(axis=1, keepdims=True, initial=1e-300)
        missed = (0.5 * _SAFETY * along**2 / np.maximum(values, floor)).sum(axis=1)
    pull = ranges.weight**2 * (q - ranges.middle)
    linear, angular, coupled = rows.multipliers(q, at, pull)
    missed += 2.0 * linear * tolerance.linear + 2.0 * angular * tolerance.angular
    missed += 2.0 * coupled * tolerance.coupled
    return missed


def best_of_branches(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configurations of different branches, the best first, at most six, (K, nv)."""
    order = np.argsort(cost(layer.q), kind="stable")
    _, first = np.unique(layer.branch[order], return_index=True)
    best: Array = layer.q[order[np.sort(first)[:_BRANCHES]]]
    return best


def centred_nearby(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """Least z nearby, by Gauss and Newton's steps along the null space; NaN where it fails.

    Nothing holds the limits but z itself.
    """
    q = np.array(q, order="C")
    rows.compiled.descend(q, at, ranges, newton(), (_ROUNDS, _LONGEST, _SETTLED))
    return q


def _climbed(q: Array, at: Indices, rows: PathRows, objective: Objective) -> Array:
    """Largest margin nearby, by trying both ways along each free direction, ever shorter."""
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
    """The least of the waypoints' largest margins, and what was missed of it, degrees."""
    count = len(rows.freedom)
    q, at = _candidates(layers, waypoints, path, count, lambda q: -objective.margins(q))
    margins = objective.margins(q)
    hopeful = margins > margins[_first_of_each(-margins, at, count)][at] - _HOPEFUL
    at = at[hopeful]
    q = _climbed(q[hopeful], at, rows, objective)
    best = q[_first_of_each(-objective.margins(q), at, count)]
    margins = objective.margins(best)
    settled = np.zeros(count, dtype=bool)
    if start is not None:
        margins[0], settled[0] = objective.margins(start), True
    # Only the waypoint with the least counts: it is led on until it is no longer the one.
    while not settled[k := int(np.argmin(margins))]:
        margins[k] = _upper_margin(best[k], k, rows, objective, tolerance)
        settled[k] = True
    return float(margins[k])


def _upper_margin(
    q: Array, index: int, rows: PathRows, objective: Objective, tolerance: Tolerance
) -> float:
    """The largest margin near q (nv,) on a waypoint, and what may be missing to it, degrees."""
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
    # A task error e lets the joints move by |e|/σ beside the null space.
    sigma = float(rows.sigma_min(q[None], at)[0])
    error = 2.0 * float(np.linalg.norm(tolerance))
    beside = error / sigma if sigma > 0.0 else 0.0
    return float(objective.margins(q)) + float(np.degrees(missed + beside))


def _linear_step(
    q: Array, at: Indices, rows: PathRows, objective: Objective, radius: float
) -> tuple[Array, float]:
    """q + N u of the largest margin to first order, |u| ≤ radius, and the gain, rad."""
    [basis] = rows.motions(q[None], at)
    ranges = objective.ranges
    room = np.concatenate([ranges.upper - q, q - ranges.lower])
    bounded = np.isfinite(room)
    moving = np.vstack([basis, -basis])[bounded]
    free = basis.shape[1]
    least = float(room.min())
    found = linprog(
        np.append(np.zeros(free), -1.0),
        np.column_stack([moving, np.ones(len(moving))]),
        room[bounded] - least,
        bounds=[(-radius, radius)] * free + [(0.0, None)],
        method="highs",
    )
    if found.x is None:
        return q, 0.0
    there: Array = q + basis @ found.x[:free]
    return there, max(float(found.x[-1]), 0.0)


def _least_travel(path_task: PathTask, chain: SerialChain, tolerance: Tolerance) -> float:
    """Degrees that the joints must do for the task's own displacement, over the whole path."""
    ranges = JointRanges.of(path_task.model)
    lever, farthest, at = 0.0, 0.0, chain.position
    inner = 0.0  # of the joints but the first, whose axis stands still
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
        # A travel t brings the frame no further from the first axis than t times its lever.
        moved = 0.0
        if shift > 0.0 and np.isfinite(farthest):
            moved = 2.0 * shift / (near + np.sqrt(near**2 + 4.0 * farthest * shift))
        total += max(turned, moved, 0.0)
    return float(np.degrees(total))


def _sees_distance(projector: TwistProjector, first: Screw) -> bool:
    """Whether the task fixes how far the frame is from the axis of the first joint, a hinge."""
    if first.slides or _whole(projector):
        return not first.slides
    plane = projector.linear.kind is ProjectorKind.PLANE and projector.frame == "world"
    axis = projector.linear.axis
    return plane and axis is not None and bool(abs(axis @ first.axis) > 1.0 - 1e-12)


def _whole(projector: TwistProjector) -> bool:
    return projector.linear.kind is ProjectorKind.FULL


def _least_shift(before: TwistProjector, after: TwistProjector, apart: Array) -> float:
    """How far a frame moves at least from a waypoint to the next, which is ``apart`` (3,), m."""
    if _whole(before) and _whole(after):
        return float(np.linalg.norm(apart))
    if before is after and before.frame == "world":
        return float(np.linalg.norm(before.linear.matrix @ apart))
    return 0.0


def _least_turn(before: TwistProjector, after: TwistProjector, R: Array, R_next: Array) -> float:
    """Angle that a frame turns by at least between waypoints with rotations (3, 3), rad.

    Of a plane the task holds one direction of the body along one direction in space; with the whole
    rotation at the other end, that direction turns, too.
    """
    held = [p for p in (before, after) if p.angular.kind is ProjectorKind.PLANE]
    kinds = {before.angular.kind, after.angular.kind}
    if kinds == {ProjectorKind.FULL}:
        return float(np.arccos(np.clip(0.5 * (np.trace(R_next @ R.T) - 1.0), -1.0, 1.0)))
    if not kinds <= {ProjectorKind.FULL, ProjectorKind.PLANE}:
        return 0.0
    if len(held) == 2 and before is not after:
        return 0.0
    axis = held[0].angular.axis
    assert axis is not None
    # An axis of the world has another direction of the body along it at either waypoint.
    fixed = held[0].frame == "world"
    ends = (R.T @ axis, R_next.T @ axis) if fixed else (R @ axis, R_next @ axis)
    sine = float(np.linalg.norm(np.cross(*ends)))
    return float(np.arctan2(sine, ends[0] @ ends[1]))

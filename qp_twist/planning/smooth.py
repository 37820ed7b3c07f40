"""Move a joint path off the grid: all waypoints at once, by quadratic programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from qp_twist.checks import Array
from qp_twist.planning.objective import Objective
from qp_twist.planning.pace import Pace
from qp_twist.planning.problem import JudgedPath, Problem, block_diagonal

_TIE_BREAK = 1e-6
"""Weight of the mean z as a tie-breaker of the objective."""
ITERATIONS, _SETTLING = 40, 6
_FIRST, _LARGEST, _SMALLEST = 0.1, 0.4, 1e-6
"""Trust region radius, rad: initial, largest, and the one at which the iteration ends."""
_SETTLED = 1e-6
"""Change by an iteration, as a share of the objective, below which it ends."""
_SLOW, _SLOW_IN_TIME, _LAST = 3e-5, 5e-3, 6
"""Gain of the last six iterations, as a share of the objective, below which it ends with hard bands
and constraints, along those that curve, and where only the time counts: all further ones together
would gain little (of the time 0.1 to 0.4 %, and they would be half of all)."""
_STUCK, _STAYS = 4, 0.01
"""With a violation it ends after so many iterations in turn that gain less than this share of the
penalty."""
_SPAN, _SPAN_OF_RADIUS = 0.3, 3.0
"""Largest change of a time by a program, as a share of it; and per radius, 1/rad: speeds are its
inverse, and their changes linear only nearby."""
_POINTS = 6
"""Number of times that points of violations between waypoints are added."""
_LEAST_SHARE = 0.25
"""Share of a program's motion down to which it is halved if it makes a path worse: the model's gain
falls with the share, what curvature takes of it with its square."""
_SETTINGS = clarabel.DefaultSettings()
"""Those of a program, whose solution is a motion to try: without iterative refinement it takes half
the time, with the same objective to 1e-8 (656 waypoints, nine joints)."""
_SETTINGS.verbose = _SETTINGS.iterative_refinement_enable = False


def smooth(
    problem: Problem,
    q: Array,
    *,
    iterations: int = ITERATIONS,
    progress: Callable[[float], None] | None = None,
    keep: Callable[[Array], None] = lambda q: None,
) -> JudgedPath:
    """The best path near q (N, nv) that satisfies the constraints at and between the waypoints.

    If a band is violated between two waypoints beyond the tolerance, the point of the largest
    violation is added to the programs. The configurations of q are on their waypoints. ``progress``
    is called with the share done, ``keep`` with every better path that violates no constraint.
    """
    limits, begun, again = problem.limits.evaluated_along(q), q, False
    for _ in range(1 + _POINTS):
        found = refine(replace(problem, limits=limits), q, iterations, progress, keep)
        if found.feasible:
            keep(found.q)
        if not (limits.hard or limits.on_path) or not (found.feasible or again):
            break
        if not found.feasible:  # the way to it led too far inside
            q, again = begun, False
            continue
        q = found.q
        beyond, share = limits.beyond_between(q)
        left = np.flatnonzero((beyond > 0.0).any(axis=1))
        if not len(left):
            break
        found = replace(found, excess=float(beyond.max()))
        if np.isinf(found.excess):  # it jumps, which no program mends
            break
        again = True
        limits = limits.with_points(left, share[left])
    return found


def refine(
    problem: Problem,
    q: Array,
    iterations: int = ITERATIONS,
    progress: Callable[[float], None] | None = None,
    keep: Callable[[Array], None] = lambda q: None,
) -> JudgedPath:
    r"""The best path near ``q`` (N, nv), whose configurations are on their waypoints.

    Sequential quadratic programming in the null space: with
    :math:`\mathbf q_k \leftarrow \mathbf q_k + \mathbf N_k \mathbf u_k` and Newton corrections onto
    the waypoints,

    .. math::

        \min_{\mathbf u, \sigma}\; f(\mathbf q + \mathbf N\mathbf u) + \mu\sigma
        \quad\text{s.t.}\quad \text{ranges, steps and changes of speed within } \sigma,\quad
        \lVert\mathbf u\rVert_\infty \le \rho,\; \sigma \ge 0,

    sparse, for all waypoints together. The penalty μ drives a path that violates constraints back
    inside, if possible. The radius ρ shrinks if the linear model was inaccurate. Hard bands and
    constraints use the rows of
    :meth:`~qp_twist.planning.hard_constraints.HardConstraints.rows`: for a cone these are the sides
    of a polygon, so that it is kept in all directions. ``keep`` is called with every better path
    that violates no constraint.
    """
    here, radius, objective = problem.judged(q), _FIRST, problem.objective
    if not problem.freedom:  # no free direction
        return here
    stuck, before = 0, [np.inf] * _LAST
    timed = objective.pace is not None and not (objective.centering or objective.travel)
    ends, slow = timed or bool(problem.rows.hard), _SLOW_IN_TIME if timed else _SLOW
    for iteration in range(iterations):
        if progress is not None:
            progress(iteration / iterations)
        there, share = _step(problem, here, radius)
        merit = _merit(here, objective)
        gain = -np.inf if there is None else merit - _merit(there, objective)
        stays = not here.feasible and gain < _STAYS * objective.penalty * here.excess
        stuck = stuck + 1 if stays else 0
        if stuck == _STUCK:
            break
        before = [*before[1:], merit if here.feasible else np.inf]
        if ends and before[0] - merit <= slow * abs(merit):
            break
        settled = abs(gain) <= _SETTLED * abs(merit)
        if there is None or gain <= 0.0:
            radius *= _LEAST_SHARE
            if radius < _SMALLEST or settled:
                break
            continue
        here, radius = there, min(2.0 * share * radius, _LARGEST)
        if here.feasible:
            keep(here.q)
        if settled:
            break
    # The remaining violation, due to curvature, is removed by a few least-norm steps.
    for _ in range(_SETTLING):
        if here.feasible:
            break
        there, _ = _step(problem, here, _FIRST, settle=True)
        if there is None or there.excess >= here.excess:
            break
        here = there
    return here


def _merit(path: JudgedPath, objective: Objective) -> float:
    value = -path.value if objective.margin else path.value
    return value + objective.penalty * max(path.excess, 0.0)


def _step(
    problem: Problem, here: JudgedPath, radius: float, *, settle: bool = False
) -> tuple[JudgedPath | None, float]:
    """The path after one program, and the share of its motion that leads there.

    ``None`` where the program has no solution, or the path cannot be corrected onto the task.
    ``settle``: its steps are the shortest ones to a path inside, whatever the objective.
    """
    at, goal = np.arange(len(here.q)), problem.objective
    basis = problem.rows.motions(here.q, at)
    if problem.start is not None:
        basis[0] = 0.0
    u = _solved(problem, here, basis, radius, settle)
    if u is None:
        return None, 0.0
    motion, share = (basis @ u[:, :, None])[:, :, 0], 1.0
    while True:
        moved, arrived = problem.rows.correct(here.q + share * motion, at)
        if problem.start is not None:
            moved[0] = here.q[0]
        there = problem.judged(moved) if arrived.all() else None
        worse = there is None or (not settle and _merit(there, goal) >= _merit(here, goal))
        if not worse or share <= _LEAST_SHARE:
            return there, share
        share *= 0.5


def _solved(
    problem: Problem, here: JudgedPath, basis: Array, radius: float, settle: bool
) -> Array | None:
    """The solution u (N, d) of the sparse program at a path (N, nv).

    Its unknowns are u, the times t of the steps, further unknowns x, and the largest violation σ.
    """
    objective, q, free = problem.objective, here.q, basis.shape[2]
    count, nv = q.shape
    size, largest = count * free, radius * np.sqrt(free)
    move = block_diagonal(basis)
    # Rows G u + T t + E x + s σ ≤ g as [G, T, E, s], and their sides g. Bounds are rows, too: a
    # backend would make rows of infinite ones and take them out again.
    whole = sparse.identity(size, format="csr")
    rows: list[list[Any]] = [[whole, None, None, None], [-whole, None, None, None]]
    sides = [np.full(size, largest), np.full(size, largest)]
    rows.append([None, None, None, -np.ones((1, 1))])
    sides.append(np.zeros(1))
    P, c, seconds, costs = whole, np.zeros(size), np.zeros(0), np.zeros(0)
    if not settle:
        weight = np.tile(objective.ranges.weight**2, count) / count
        share = objective.centering or _TIE_BREAK
        P = share * (move.T @ sparse.diags(weight) @ move)
        c = share * (move.T @ (weight * (q - objective.ranges.middle).ravel()))
        if objective.preferred is not None:
            A, b = objective.preferred.linear(q)
            A = A @ move
            P, c = P + A.T @ A, c + A.T @ b
        G, change = move[nv:] - move[:-nv], np.diff(q, axis=0)
        if objective.pace is not None:
            each, times, least = _times(objective.pace, here, G, radius, largest)
            rows.append([each, times, None, None])
            sides.append(least)
            seconds = np.full(count - 1, objective.time)
        if objective.travel:  # x are the absolute values of the changes
            less = -sparse.identity(change.size)
            rows += [[G, None, less, None], [-G, None, less, None]]
            sides += [-change.ravel(), change.ravel()]
            costs = np.tile(np.degrees(objective.travel * objective.joints), count - 1)
        if objective.margin:  # x is the margin, at most that of each joint
            costs = np.full(1, -np.degrees(1.0))
            for sign, ends in ((1.0, objective.ranges.upper), (-1.0, -objective.ranges.lower)):
                room = (ends - sign * q).ravel()
                near = np.flatnonzero(room < room.min() + 4.0 * largest + 1e-3)
                rows.append([sign * move[near], None, np.ones((len(near), 1)), None])
                sides.append(room[near])
    for G, g in problem.limits.rows(q):
        on_u = G @ move
        # Rows that no u within the radius can reach are left out.
        near = np.flatnonzero(g <= largest * np.asarray(abs(on_u).sum(axis=1)).ravel())
        if len(near):
            # What is kept stays so, to first order: without a price a violation would spread.
            rows.append([on_u[near], None, None, -1.0 * (g[near, None] < 0.0)])
            sides.append(g[near])
    used = [k for k in range(4) if any(row[k] is not None for row in rows)]
    rows = [[row[k] for k in used] for row in rows]
    further = np.concatenate([seconds, costs, [objective.penalty]])
    P = sparse.block_diag([P, sparse.csc_matrix((len(further),) * 2)], format="csc")
    A, b = sparse.bmat(rows, format="csc"), np.concatenate(sides)
    cones = [clarabel.NonnegativeConeT(len(b))]
    program = clarabel.DefaultSolver(
        sparse.triu(P, format="csc"), np.concatenate([c, further]), A, b, cones, _SETTINGS
    )
    x = np.array(program.solve().x)[:size]  # the path it leads to is judged, not the solution
    return x.reshape(count, free) if np.isfinite(x).all() else None


def _times(
    pace: Pace, here: JudgedPath, G: sparse.csr_matrix, radius: float, largest: float
) -> tuple[sparse.csr_matrix, sparse.csr_matrix, Array]:
    """Rows G' u + T t ≤ g of the least times t (N − 1,) of a path (N, nv), its steps plus G u.

    Changes of speed are linear in u and t near the present times, from which t stays within a share
    that shrinks with the ``radius``. Without speeds that no u within ``largest`` makes the slowest
    of a step.
    """
    change, now = np.diff(here.q, axis=0), here.times
    (count, nv), limited = change.shape, np.isfinite(pace.acceleration)
    slowness = np.tile(1.0 / pace.velocity, count)
    reach = largest * np.asarray(abs(G).sum(axis=1)).ravel() * slowness
    shares = change.ravel() * slowness
    least = np.maximum((np.abs(shares) - reach).reshape(count, nv).max(axis=1), pace.feed)
    none, one = sparse.csr_matrix((count, G.shape[1])), sparse.identity(count, format="csr")
    each, times, sides = [none], [-one], [-pace.feed]
    for sign in (1.0, -1.0):
        near = np.flatnonzero(sign * shares + reach >= np.repeat(least, nv))
        each.append(sparse.diags(sign * slowness[near]) @ G[near])
        times.append(-one[near // nv])
        sides.append(-sign * shares[near])
    if limited.any():
        span = min(_SPAN, _SPAN_OF_RADIUS * radius) * now
        each += [none, none]
        times += [one, -one]
        sides += [now + span, span - now]
        lasting = np.where(now > 0.0, now, 1.0)
        speeds = (change / lasting[:, None])[:, limited]
        # Speeds, 0 at rest, are linear in the steps; their times make them slower.
        most = pace.acceleration[limited]
        joints = np.flatnonzero(np.tile(limited, count))
        per_step = sparse.diags(np.repeat(1.0 / lasting, len(most))) @ G[joints]
        per_time = sparse.diags((-speeds / lasting[:, None]).ravel()) @ sparse.kron(
            one, np.ones((len(most), 1))
        )
        differ = _differences(count, pace.rests)
        by_joint = sparse.kron(differ, sparse.identity(len(most)), format="csr")
        room = np.append(pace.room, 1.0)[slice(None) if pace.rests else slice(1, -1)]
        spans = sparse.kron(sparse.diags(room) @ _mean_times(lasting, pace.rests), most[:, None])
        changes = np.asarray(differ @ speeds).ravel()
        for sign in (1.0, -1.0):
            each.append(sign * (by_joint @ per_step))
            times.append(sign * (by_joint @ per_time) - spans)
            sides.append(sign * (np.asarray(by_joint @ (per_time @ now)).ravel() - changes))
    return (
        sparse.vstack(each, format="csr"),
        sparse.vstack(times, format="csr"),
        np.concatenate(sides),
    )


def _differences(count: int, rests: bool) -> sparse.csr_matrix:
    """Differences of ``count`` successive values, and from and to 0 at the ends if it ``rests``."""
    whole = sparse.diags([1.0, -1.0], [0, -1], shape=(count + 1, count), format="csr")
    return whole if rests else whole[1:-1]


def _mean_times(t: Array, rests: bool) -> sparse.csr_matrix:
    """Derivatives of the harmonic means of successive times (N,), and of half of those at rests.

    Times t themselves are mapped to the means, which are homogeneous.
    """
    share = (t[:-1] / (t[:-1] + t[1:])) ** 2
    before, after = 2.0 * (1.0 - np.sqrt(share)) ** 2, 2.0 * share
    diagonals = [np.append(0.5, after), np.append(before, 0.5)]
    whole = sparse.diags(diagonals, [0, -1], shape=(len(t) + 1, len(t)), format="csr")
    return whole if rests else whole[1:-1]

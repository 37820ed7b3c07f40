"""Move a joint path off the grid: all waypoints at once, by quadratic programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import qpsolvers
from scipy import sparse

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.planning.objective import Objective
from qp_twist.planning.problem import JudgedPath, PathConstraints, Problem, block_diagonal

_TIE_BREAK = 1e-6
"""Weight of the mean z as a tie-breaker of the objective."""
ITERATIONS, _SETTLING = 40, 6
_FIRST, _LARGEST, _SMALLEST = 0.1, 0.4, 1e-6
"""Trust region radius, rad: initial, largest, and the one at which the iteration ends."""
_SETTLED = 1e-6
"""Change by an iteration, as a share of the objective, below which it ends."""
_SLOW, _LAST = 3e-5, 6
"""Gain of the last six iterations, as a share of the objective, below which it ends with hard bands
and constraints: along those that curve all further ones together would gain little."""
_STUCK, _STAYS = 4, 0.01
"""With a violation it ends after so many iterations in turn that gain less than this share of the
penalty."""
_POINTS = 6
"""Number of times that points of violations between waypoints are added."""


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
    violation is added to the programs.

    Args:
        problem: The problem.
        q: A path whose configurations are on their waypoints.
        iterations: Largest number of programs.
        progress: Called with the share done.
        keep: Called with every better path that violates no constraint.
    """
    limits, begun, again = problem.limits.evaluated_along(q), q, False
    for _ in range(1 + _POINTS):
        found = refine(replace(problem, limits=limits), q, iterations, progress, keep)
        if found.feasible:
            keep(found.q)
        if not problem.rows.hard or not (found.feasible or again):
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
    for iteration in range(iterations):
        if progress is not None:
            progress(iteration / iterations)
        there = _step(problem, here, radius)
        merit = _merit(here, objective)
        gain = -np.inf if there is None else merit - _merit(there, objective)
        stays = not here.feasible and gain < _STAYS * objective.penalty * here.excess
        stuck = stuck + 1 if stays else 0
        if stuck == _STUCK:
            break
        before = [*before[1:], merit if here.feasible else np.inf]
        if problem.rows.hard and before[0] - merit <= _SLOW * abs(merit):
            break
        settled = abs(gain) <= _SETTLED * abs(merit)
        if there is None or gain <= 0.0:
            radius *= 0.25
            if radius < _SMALLEST or settled:
                break
            continue
        here, radius = there, min(2.0 * radius, _LARGEST)
        if here.feasible:
            keep(here.q)
        if settled:
            break
    # The remaining violation, due to curvature, is removed by a few least-norm steps.
    for _ in range(_SETTLING):
        if here.feasible:
            break
        there = _step(problem, here, _FIRST, settle=True)
        if there is None or there.excess >= here.excess:
            break
        here = there
    return here


def _merit(path: JudgedPath, objective: Objective) -> float:
    value = -path.value if objective.margin else path.value
    return value + objective.penalty * max(path.excess, 0.0)


def _step(
    problem: Problem, here: JudgedPath, radius: float, *, settle: bool = False
) -> JudgedPath | None:
    """The path after one program; ``None`` where it has no solution or leaves the task.

    ``settle``: its steps are the shortest ones to a path inside, whatever the objective.
    """
    at, fixed_start = np.arange(len(here.q)), problem.limits.fixed_start
    basis = problem.rows.motions(here.q, at)
    if fixed_start:
        basis[0] = 0.0
    u = _solved(here.q, basis, problem.limits, problem.objective, radius, settle)
    if u is None:
        return None
    moved, arrived = problem.rows.correct(here.q + (basis @ u[:, :, None])[:, :, 0], at)
    if fixed_start:
        moved[0] = here.q[0]
    return problem.judged(moved) if arrived.all() else None


def _solved(
    q: Array,
    basis: Array,
    limits: PathConstraints,
    objective: Objective,
    radius: float,
    settle: bool,
) -> Array | None:
    """The solution u (N, d) of the program at a path q (N, nv)."""
    count, nv = q.shape
    free = basis.shape[2]
    move = block_diagonal(basis)
    program = _Program(count * free, radius * np.sqrt(free))
    weight = np.tile(objective.ranges.weight**2, count) / count
    if settle:
        program.quadratic(sparse.eye(count * free, format="csr"), np.zeros(count * free))
    else:
        offset = (q - objective.ranges.middle).ravel()
        share = objective.centering or _TIE_BREAK
        program.quadratic(share * (move.T @ sparse.diags(weight) @ move),
                          share * (move.T @ (weight * offset)))  # fmt: skip
        if objective.travel:
            program.least_sum(
                move[nv:] - move[:-nv],
                np.diff(q, axis=0).ravel(),
                np.tile(np.degrees(objective.travel * objective.joints), count - 1),
            )
        if objective.margin:
            program.least_largest(move, objective.ranges, q)
    for G, g in limits.rows(q):
        program.soft_rows(G @ move, g)
    x = program.solution(objective.penalty)
    return None if x is None else x[: count * free].reshape(count, free)


class _Program:
    """A sparse program in (u, further unknowns, σ), assembled block by block."""

    def __init__(self, size: int, radius: float) -> None:
        self.size, self.radius = size, radius
        self.P = sparse.csr_matrix((size, size))
        self.c = np.zeros(size)
        self.rows: list[tuple[sparse.csr_matrix, sparse.csr_matrix, Array, bool]] = []
        self.more: list[Array] = []
        # Bounds as rows: a backend would make rows of infinite ones, too, and take them out again.
        whole, none = sparse.identity(size, format="csr"), sparse.csr_matrix((size, 0))
        self.rows += [(sign * whole, none, np.full(size, radius), False) for sign in (1.0, -1.0)]
        self.soft_rows(sparse.csr_matrix((1, size)), np.zeros(1))  # 0 ≤ σ

    def quadratic(self, P: sparse.csr_matrix, c: Array) -> None:
        """Add ½uᵀPu + cᵀu."""
        self.P, self.c = self.P + P, self.c + c

    def soft_rows(self, G: sparse.csr_matrix, g: Array) -> None:
        """Add G u − σ ≤ g; rows that no u within the radius can reach are left out."""
        reach = self.radius * np.asarray(abs(G).sum(axis=1)).ravel()
        near = np.flatnonzero(g <= reach)
        self.rows.append((G[near], sparse.csr_matrix((len(near), self._added)), g[near], True))

    def least_sum(self, G: sparse.csr_matrix, g: Array, weights: Array) -> None:
        """Add Σ weight × |G u + g|, with one unknown for each absolute value."""
        count, before = len(g), self._added
        self.more.append(weights)
        bound = sparse.hstack(
            [sparse.csr_matrix((count, before)), -sparse.eye(count)], format="csr"
        )
        self.rows += [(G, bound, -g, False), (-G, bound, g, False)]

    def least_largest(self, move: sparse.csr_matrix, ranges: JointRanges, q: Array) -> None:
        """Subtract the margin in degrees: its unknown t is at most each joint's margin."""
        before = self._added
        self.more.append(np.full(1, -np.degrees(1.0)))
        for sign, ends in ((1.0, ranges.upper), (-1.0, -ranges.lower)):
            room = (ends - sign * q).ravel()
            near = np.flatnonzero(room < room.min() + 4.0 * self.radius + 1e-3)
            one = np.zeros((len(near), before + 1))
            one[:, -1] = 1.0
            self.rows.append((sign * move[near], sparse.csr_matrix(one), room[near], False))

    def solution(self, penalty: float) -> Array | None:
        """The minimiser, or ``None``."""
        n = self.size + self._added + 1
        # Build from all entries at once: stacking blocks takes longer than solving the program.
        at, columns, entries = [], [], []
        before = 0
        for G, more, g, soft in self.rows:
            for block, first in ((G.tocoo(), 0), (more.tocoo(), self.size)):
                at.append(before + block.row)
                columns.append(first + block.col)
                entries.append(block.data)
            if soft:
                at.append(np.arange(before, before + len(g)))
                columns.append(np.full(len(g), n - 1))
                entries.append(np.full(len(g), -1.0))
            before += len(g)
        inequalities = sparse.csc_matrix(
            (np.concatenate(entries), (np.concatenate(at), np.concatenate(columns))),
            shape=(before, n),
        )
        P = sparse.csc_matrix(self.P)
        P = sparse.csc_matrix(
            (P.data, P.indices, np.append(P.indptr, np.full(n - self.size, P.nnz))), shape=(n, n)
        )
        problem = qpsolvers.Problem(
            P,
            np.concatenate([self.c, *self.more, [penalty]]),
            inequalities,
            np.concatenate([row[2] for row in self.rows]),
        )
        solution = qpsolvers.solve_problem(problem, solver="clarabel")
        if not solution.found or solution.x is None or not np.isfinite(solution.x).all():
            return None
        return np.asarray(solution.x)

    @property
    def _added(self) -> int:
        return sum(len(block) for block in self.more)

"""One step from poses and Jacobians to a verified joint velocity, compiled."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from qp_twist.kernel.bounds import bounds
from qp_twist.kernel.compiling import inner, plain
from qp_twist.kernel.directions import regular_from, rotate, stopping_share
from qp_twist.kernel.dual_active_set import cholesky
from qp_twist.kernel.null_space import null_space, row_space
from qp_twist.kernel.one_program import EMPTY, OPTIMAL, solve
from qp_twist.kernel.record import Floats, Integers, RecordType, reader
from qp_twist.kernel.step_record import PROGRAM, Program, Sizes
from qp_twist.kernel.twist_rows import in_basis, twist_rows
from qp_twist.kernel.verified_program import (
    AT_THE_EDGE,
    BRAKED,
    BRAKED_BELOW,
    DONE,
    INFEASIBLE,
    REFUSED,
    SolverTolerances,
    well_conditioned,
)

RAISE, SCALE, RELAX = 0, 1, 2
"""If the first level is infeasible: leave it to the reference, scale the task, or minimise its
residual inside the limits."""
FROM_PYTHON = 3
"""Replaces the projector's axes in ``kinds`` if the task's rows are computed in Python."""


class Settings(NamedTuple):
    """Scalar settings of a controller."""

    singularity: float
    """Singular value of the rows below which the step is left to the reference."""
    weight: float
    """ρ."""
    nearly_unseen: float
    """Share of the largest singular value below which motion gradually counts as unseen."""
    fastest: float
    """Largest desired speed of a task or a secondary, m/s or rad/s."""
    noticeable: float
    """Smallest violation of a limit that counts, rad or m."""
    unlimited: float
    """A bound beyond it counts as infinite, rad/s or m/s."""
    steepest: float
    """Largest linear cost of other tasks, relative to the largest quadratic one."""
    infeasible: float
    """How an infeasible first level is handled: ``RAISE``, ``SCALE`` or ``RELAX``."""
    smooth: float
    """Whether a step has to change little with its data (``one_program``); 1 or 0."""
    trusts: float
    """Whether weak directions are damped by the length of the error; 1 or 0."""
    braking: float
    """Whether a task is slowed down so that the joints can stop in time; 1 or 0."""


class StepInputs(NamedTuple):
    """Inputs of a step; for the arrays see ``twist_rows`` and ``bounds``."""

    settings: Settings
    tolerances: SolverTolerances
    free_costs: Annotated[Floats, 2]
    """Square roots of the weights of the rows of 1 − T, linear and angular."""
    middle: Annotated[Floats, "nv"]
    """θ̄ of the secondary h = displacement + stiffness (θ̄ − θ), rad or m."""
    stiffness: Annotated[Floats, "nv"]
    displacement: Annotated[Floats, "nv"]
    metric: Annotated[Floats, "nv"]
    """Diagonal of M."""
    shapes: Annotated[Floats, "tasks", 27]
    poses: Annotated[Floats, "tasks", 12]
    """R and p of the frames."""
    targets: Annotated[Floats, "tasks", 18]
    """R_d, p_d and the twist of the targets."""
    target_poses: Annotated[Floats, "tasks", 7]
    """Unit quaternions and positions, from which ``live_step`` computes R_d and p_d."""
    jacobians: Annotated[Floats, "tasks", 6, "nv"]
    limits: Annotated[Floats, "limits", "nv", 7]
    python_rows: Annotated[Floats, "m", "nv"]
    """Rows of the tasks whose kind is ``FROM_PYTHON``, computed in Python."""
    python_rhs: Annotated[Floats, "m"]
    """Their right-hand sides."""
    python_forward: Annotated[Floats, "m"]
    """The part of them that follows moving targets."""
    python_free: Annotated[Floats, "free", "nv"]
    """Their rows of 1 − T, times the square roots of the weights."""
    quadratic: Annotated[Floats, "others", "nv"]
    """H of other tasks."""
    linear: Annotated[Floats, "others"]
    """c of other tasks."""
    rooms: Annotated[Floats, "k"]
    """Part of each g that is what is left of a clearance, over dt; a longer step takes less."""
    kinds: Annotated[Integers, "tasks", 3]
    """For each task the projector's ranks and axes; or number of rows, 0, ``FROM_PYTHON``."""
    ends: Annotated[Integers, "levels"]
    """Index after the last row of each level."""
    addresses: Annotated[Integers, "nv"]
    """Index of each degree of freedom in q; −1 where it has none of its own."""
    types: Annotated[Integers, "limits"]
    """Kinds of the limits."""
    links: Annotated[Integers, "tasks", "nv"]
    """Which joints move each task's frame: see ``live_step``."""
    sources: Annotated[Integers, "5 + 2 * tasks"]
    """Addresses of MuJoCo's arrays, and the number of joints: see ``live_step``."""


STEP_INPUTS = RecordType(StepInputs, Sizes)


class StepArrays(NamedTuple):
    """Inputs and program of a step."""

    inputs: StepInputs
    program: Program


STEP = RecordType(StepArrays, Sizes, STEP_INPUTS, PROGRAM)
read_step = reader(STEP)


@plain
def _all_seen(H, metric, N, nearly, work):
    """Whether rows with the Gram matrix H see all motion well but N (p, n), which they do not see.

    True if M^(−1/2) H M^(−1/2) + t NᵀN has no small eigenvalue. Its trace t serves as an upper
    bound of the largest one.
    """
    n, trace = len(metric), 0.0
    for i in range(n):
        trace += H[i, i] / metric[i]
    for i in range(n):
        for j in range(i + 1):
            total = H[i, j] / math.sqrt(metric[i] * metric[j])
            for k in range(len(N)):
                total += trace * N[k, i] * N[k, j]
            work[i, j] = total
        work[i, i] -= nearly * nearly * trace
    return cholesky(work)


@plain
def _unseen(w, metric, nearly):
    """Fill ``w.directions`` (joints times √metric) and ``w.sigma``; return how many there are.

    ``w.sigma`` is 1 for an unseen direction and 0 for a well seen one. Usually the directions are
    the null space of the rows. Otherwise they are the rows' right singular vectors; eigenvectors of
    H would lose accuracy with the square of the rows' condition number.
    """
    m, n, largest = len(w.A), len(metric), 0.0
    for j in range(n):  # the columns of the rows A and of those of 1 − T
        root = math.sqrt(metric[j])
        for i in range(m):
            w.seen[j, i] = w.A[i, j] / root
        for i in range(len(w.free)):
            w.seen[j, m + i] = w.free[i, j] / root
    rank = row_space(w.seen.T, w.directions)
    N = w.J[: n - rank]
    null_space(w.directions[:rank], N)
    for i in range(n - rank):
        w.sigma[i] = 1.0
        for j in range(n):
            w.directions[i, j] = N[i, j]
    if _all_seen(w.H, metric, w.directions[: n - rank], nearly, w.J):
        return n - rank
    for i in range(n):
        for j in range(n):
            w.directions[i, j] = 1.0 if i == j else 0.0
    rotate(w.seen, w.directions, w.sigma)
    for i in range(n):
        largest = max(largest, w.sigma[i])
    for i in range(n):
        share = w.sigma[i] / (nearly * nearly * largest) if largest > 0.0 else 0.0
        w.sigma[i] = 1.0 - min(1.0, share)
    return n


@plain
def _add_unseen(w, metric, weight, nearly):
    """Add the joint-space cost of motion that no row sees to H and c (``posing.unseen``).

    H is ``w.H``, c is ``w.c`` and ḣ is ``w.line``.
    """
    n = len(metric)
    for k in range(_unseen(w, metric, nearly)):
        if w.sigma[k] > 0.0:
            for i in range(n):
                for j in range(n):
                    entry = (
                        weight * w.sigma[k] * w.directions[k, i] * w.directions[k, j]
                        * math.sqrt(metric[i] * metric[j])
                    )  # fmt: skip
                    w.H[i, j] += entry
                    w.c[i] -= entry * w.line[j]


@plain
def stated_rows(g, dt, A, b, free):
    """Stack the rows of all tasks."""
    row = 0
    for index in range(len(g.kinds)):
        rank = g.kinds[index, 0] + g.kinds[index, 1]
        first = 6 * index if len(free) else 0
        if g.kinds[index, 2] == FROM_PYTHON:
            for i in range(row, row + rank):
                b[i] = g.python_rhs[i]
                for dof in range(A.shape[1]):
                    A[i, dof] = g.python_rows[i, dof]
            for i in range(first, first + 6 if len(free) else 0):
                for dof in range(A.shape[1]):
                    free[i, dof] = g.python_free[i, dof]
        else:
            twist_rows(
                g.kinds[index], g.shapes[index], g.poses[index], g.targets[index],
                g.jacobians[index], dt, A[row : row + rank], b[row : row + rank],
                free[first : first + 6], g.free_costs,
            )  # fmt: skip
        row += rank


@plain
def desired_velocities(qpos, addresses, middle, stiffness, displacement, dt, use_secondary, q, c):
    """Write joint positions to q and ḣ to c; return max |ḣ|, or ∞ if q is not finite."""
    largest = 0.0
    for dof in range(len(q)):
        q[dof] = qpos[addresses[dof]] if addresses[dof] >= 0 else 0.0
        if not math.isfinite(q[dof]):
            return math.inf
        c[dof] = 0.0
        if use_secondary:
            c[dof] = (displacement[dof] + stiffness[dof] * (middle[dof] - q[dof])) / dt
        if not abs(c[dof]) <= largest:
            largest = abs(c[dof])
    return largest


@plain
def _twist_cost(w, metric, weight, nearly):
    """H = FᵀF + AᵀA with F = ``w.free``, and c = −FᵀF ḣ from ḣ in c; then the unseen motion."""
    A, free, H, c, desired = w.A, w.free, w.H, w.c, w.line
    nv = len(c)
    for i in range(nv):
        desired[i] = c[i]
        for j in range(i + 1):
            total = 0.0
            for k in range(len(free)):
                total += free[k, i] * free[k, j]
            H[i, j] = H[j, i] = total
    for i in range(nv):
        total = 0.0
        for j in range(nv):
            total -= H[i, j] * desired[j]
        c[i] = total
    for i in range(nv):
        for j in range(i + 1):
            total = H[i, j]
            for k in range(len(A)):
                total += A[k, i] * A[k, j]
            H[i, j] = H[j, i] = total
    if not _all_seen(H, metric, w.directions[:0], nearly, w.J):
        _add_unseen(w, metric, weight, nearly)


@plain
def _joint_cost(metric, weight, H, c):
    """H = ρM, and c = −Hḣ from ḣ in c."""
    for i in range(len(c)):
        for j in range(len(c)):
            H[i, j] = 0.0
        H[i, i] = weight * metric[i]
        c[i] *= -H[i, i]


@plain
def _add_costs(quadratic, linear, steepest, H, c):
    """Add the costs of other tasks; return whether c is small enough relative to H."""
    hardest, largest = 0.0, 0.0
    for i in range(len(linear)):
        c[i] += linear[i]
        # Written so that NaN counts as the largest.
        if not abs(c[i]) <= largest:
            largest = abs(c[i])
        for j in range(len(linear)):
            H[i, j] += quadratic[i, j]
            hardest = max(hardest, abs(H[i, j]))
    return largest <= steepest * hardest


@plain
def costs(w, metric, quadratic, linear, settings, twist_space):
    """Compute H and c from ḣ in c; return whether they can be computed with.

    ``twist_space`` is ``None`` for the joint-space cost: numba then does not compile the
    twist-space cost, which saves a sixth of a step's compilation time.
    """
    if twist_space is None:
        _joint_cost(metric, settings.weight, w.H, w.c)
    else:
        _twist_cost(w, metric, settings.weight, settings.nearly_unseen)
    return len(linear) == 0 or _add_costs(quadratic, linear, settings.steepest, w.H, w.c)


@plain
def forward_rows(g, forward):
    """Uᵀt_ff of all tasks: the part of b that follows moving targets, (m,)."""
    row = 0
    for index in range(len(g.kinds)):
        rank = g.kinds[index, 0] + g.kinds[index, 1]
        if g.kinds[index, 2] == FROM_PYTHON:
            for i in range(row, row + rank):
                forward[i] = g.python_forward[i]
        else:
            in_basis(
                g.kinds[index], g.shapes[index], g.poses[index], g.targets[index],
                g.targets[index, 12:], forward[row : row + rank],
            )  # fmt: skip
        row += rank


@plain
def _orthonormal_rows(A, L, Q):
    """Write L of AAᵀ = LLᵀ and the orthonormal rows Q of A = LQ; return whether they exist."""
    m, n = A.shape
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += A[i, k] * A[j, k]
            L[i, j] = total
    if not cholesky(L):
        return False
    for i in range(m):
        for k in range(n):
            total = A[i, k]
            for j in range(i):
                total -= L[i, j] * Q[j, k]
            Q[i, k] = total / L[i, i]
    return True


@plain
def brake(g, w, dt):
    """Slow b of regular levels down so that the joints can stop in time; false for the reference.

    The displacement that would remove a level's error is that of least norm on what the levels
    above leave: with A = LQ it is Qᵢᵀyᵢ of Lᵢᵢyᵢ = bᵢ − Σ Lᵢⱼyⱼ.
    """
    p, n, L, Q, y, first = w.levels, len(w.x), w.R, w.levels.Q, w.levels.r, 0
    forward_rows(g, p.ahead)
    if not _orthonormal_rows(w.A, L, Q):
        return False
    for level in range(len(g.ends)):
        end = g.ends[level]
        _solve_rows(L, w.b, p.ahead, 1.0, first, end, y)
        for k in range(n):
            p.x[k] = 0.0
            for i in range(first, end):
                p.x[k] += dt * Q[i, k] * y[i]
        share, which = stopping_share(p.x, g.limits, g.types, dt)
        if level == 0:
            w.braking[0] = share
        if w.braking[1] == 0.0:
            w.braking[1] = which
        for i in range(first, end):
            taken = (1.0 - share) * (w.b[i] - p.ahead[i])
            w.b[i] -= taken
            w.eased[i] = taken if level > 0 else 0.0
        _solve_rows(L, w.b, p.ahead, 0.0, first, end, y)
        first = end
    return True


@plain
def _solve_rows(L, b, forward, share, first, end, y):
    """Solve the rows ``first`` to ``end`` of L y = b − ``share`` · forward, given those above."""
    for i in range(first, end):
        total = b[i] - share * forward[i]
        for j in range(i):
            total -= L[i, j] * y[j]
        y[i] = total / L[i, i]


@plain
def take(w, found):
    """Copy a result to the program of a step."""
    w.sensitivity[0] = 1.0
    for i in range(len(w.x)):
        w.x[i], w.box[i] = found.x[i], found.box[i]
    for row in range(len(w.y)):
        w.y[row] = found.y[row]
    for row in range(len(w.lam)):
        w.lam[row] = found.lam[row]


@inner
def step_on_rows(g, w, qpos, dt, use_secondary, twist_space):
    """Compute the joint velocity ``w.x`` from the task rows in ``w``.

    ``twist_space``: see :func:`_costs`.

    Returns:
        ``DONE``, ``BRAKED`` or ``BRAKED_BELOW``; ``INFEASIBLE`` if the rows are infeasible within
        the limits: call ``edge_step``, as for ``AT_THE_EDGE``; or ``REFUSED`` if the reference
        has to compute the step.
    """
    fastest = desired_velocities(
        qpos, g.addresses, g.middle, g.stiffness, g.displacement, dt, use_secondary, w.q, w.c
    )
    for row in range(len(w.b)):
        # Written so that NaN counts as the fastest.
        if not abs(w.b[row]) <= fastest:
            fastest = abs(w.b[row])
    if not fastest <= g.settings.fastest:
        return REFUSED
    threshold = g.settings.singularity
    w.braking[0], w.braking[1], w.lacks[0] = 1.0, 0.0, 0.0
    for row in range(len(w.eased)):
        w.eased[row] = 0.0
    if g.settings.trusts > 0.0:
        threshold = regular_from(threshold)
    regular = well_conditioned(w.A, g.ends, threshold, w.R, w.J)
    if not bounds(
        g.limits, g.types, w.q, dt, g.settings.noticeable, g.settings.unlimited, w.lower, w.upper,
        w.lower_kind, w.upper_kind,
    ):  # fmt: skip
        return REFUSED
    if not regular:
        return AT_THE_EDGE
    if g.settings.braking > 0.0 and not brake(g, w, dt):
        return AT_THE_EDGE
    if not costs(w, g.metric, g.quadratic, g.linear, g.settings, twist_space):
        return REFUSED
    found = solve(w.H, w.c, w.A, w.b, w.G, w.g, w.lower, w.upper, g.tolerances)
    if found.status != OPTIMAL:
        return INFEASIBLE if found.status == EMPTY else REFUSED
    take(w, found)
    if w.braking[1] == 0.0:
        return DONE
    w.sensitivity[0] = w.braking[0]
    return BRAKED if w.braking[0] < 1.0 else BRAKED_BELOW


@inner
def step(g, w, qpos, dt, use_secondary, twist_space):
    """Compute a step from g into w; returns as :func:`step_on_rows`."""
    stated_rows(g, dt, w.A, w.b, w.free)
    return step_on_rows(g, w, qpos, dt, use_secondary, twist_space)

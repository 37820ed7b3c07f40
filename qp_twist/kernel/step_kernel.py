"""One step from poses and Jacobians to a verified joint velocity, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.bounds import bounds
from qp_twist.kernel.compiling import plain
from qp_twist.kernel.constants import FASTEST, NEARLY_UNSEEN, STEEPEST
from qp_twist.kernel.copying import put, put_rows
from qp_twist.kernel.directions import regular_from, rotate, stopping_share, well_conditioned
from qp_twist.kernel.dual_active_set import Program, Work, cholesky
from qp_twist.kernel.null_space import null_space, row_space
from qp_twist.kernel.one_program import EMPTY, OPTIMAL, solve_in
from qp_twist.kernel.step_record import (
    AT_THE_EDGE,
    BRAKED,
    BRAKED_BELOW,
    DONE,
    FROM_PYTHON,
    INFEASIBLE,
    REFUSED,
)
from qp_twist.kernel.twist_rows import in_basis, twist_rows


@plain
def _all_seen(s, N):
    """Whether rows with the Gram matrix H see all motion well but N (p, n), which they do not see.

    True if M^(−1/2) H M^(−1/2) + t NᵀN has no small eigenvalue. Its trace t serves as an upper
    bound of the largest one.
    """
    H, metric, work, n, trace = s.H, s.metric, s.J, len(s.metric), 0.0
    for i in range(n):
        trace += H[i, i] / metric[i]
    for i in range(n):
        for j in range(i + 1):
            total = H[i, j] / math.sqrt(metric[i] * metric[j])
            for k in range(len(N)):
                total += trace * N[k, i] * N[k, j]
            work[i, j] = total
        work[i, i] -= NEARLY_UNSEEN * NEARLY_UNSEEN * trace
    return cholesky(work, n)


@plain
def _unseen(s):
    """Fill ``s.directions`` (joints times √metric) and ``s.sigma``; return how many there are.

    ``s.sigma`` is 1 for an unseen direction and 0 for a well seen one. Usually the directions are
    the null space of the rows. Otherwise they are the rows' right singular vectors; eigenvectors of
    H would lose accuracy with the square of the rows' condition number.
    """
    m, n, largest = len(s.A), len(s.metric), 0.0
    for j in range(n):  # the columns of the rows A and of those of 1 − T
        root = math.sqrt(s.metric[j])
        for i in range(m):
            s.seen[j, i] = s.A[i, j] / root
        for i in range(len(s.free)):
            s.seen[j, m + i] = s.free[i, j] / root
    rank = row_space(s.seen.T, s.directions)
    N = s.J[: n - rank]
    null_space(s.directions[:rank], N)
    for i in range(n - rank):
        s.sigma[i] = 1.0
        for j in range(n):
            s.directions[i, j] = N[i, j]
    if _all_seen(s, s.directions[: n - rank]):
        return n - rank
    for i in range(n):
        for j in range(n):
            s.directions[i, j] = 1.0 if i == j else 0.0
    rotate(s.seen, s.directions, s.sigma)
    for i in range(n):
        largest = max(largest, s.sigma[i])
    for i in range(n):
        share = s.sigma[i] / (NEARLY_UNSEEN * NEARLY_UNSEEN * largest) if largest > 0.0 else 0.0
        s.sigma[i] = 1.0 - min(1.0, share)
    return n


@plain
def _add_unseen(s):
    """Add the joint-space cost of motion that no row sees to H and c (``posing.unseen``).

    ḣ is in ``s.desired``.
    """
    n = len(s.metric)
    for k in range(_unseen(s)):
        if s.sigma[k] > 0.0:
            for i in range(n):
                for j in range(n):
                    entry = (
                        s.settings.weight * s.sigma[k] * s.directions[k, i] * s.directions[k, j]
                        * math.sqrt(s.metric[i] * s.metric[j])
                    )  # fmt: skip
                    s.H[i, j] += entry
                    s.c[i] -= entry * s.desired[j]


@plain
def stated_rows(s, dt):
    """Stack the rows of all tasks."""
    A, b, free, row = s.A, s.b, s.free, 0
    for index in range(len(s.kinds)):
        kinds = s.kinds[index]
        end, first = row + kinds[0] + kinds[1], 6 * index if len(free) else 0
        rows, numbers, left = A[row:end], b[row:end], free[first : first + 6]
        if kinds[2] == FROM_PYTHON:
            put(s.python_rhs[row:end], numbers)
            put_rows(s.python_rows[row:end], rows)
            put_rows(s.python_free[first : first + 6], left)
        else:
            twist_rows(
                kinds, s.shapes[index], s.poses[index], s.targets[index], s.jacobians[index], dt,
                rows, numbers, left, s.free_costs,
            )  # fmt: skip
        row = end


@plain
def desired_velocities(s, qpos, dt, use_secondary):
    """Write joint positions to q and ḣ to c; return max |ḣ|, or ∞ if q is not finite."""
    q, c, largest = s.q, s.c, 0.0
    for dof in range(len(q)):
        q[dof] = qpos[s.addresses[dof]] if s.addresses[dof] >= 0 else 0.0
        if not math.isfinite(q[dof]):
            return math.inf
        c[dof] = 0.0
        if use_secondary:
            c[dof] = (s.displacement[dof] + s.stiffness[dof] * (s.middle[dof] - q[dof])) / dt
        if not abs(c[dof]) <= largest:
            largest = abs(c[dof])
    return largest


@plain
def _twist_cost(s):
    """H = FᵀF + AᵀA with F = ``s.free``, and c = −FᵀF ḣ from ḣ in c; then the unseen motion."""
    A, free, H, c, desired = s.A, s.free, s.H, s.c, s.desired
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
    if not _all_seen(s, s.directions[:0]):
        _add_unseen(s)


@plain
def _joint_cost(s):
    """H = ρM, and c = −Hḣ from ḣ in c."""
    H, c = s.H, s.c
    for i in range(len(c)):
        for j in range(len(c)):
            H[i, j] = 0.0
        H[i, i] = s.settings.weight * s.metric[i]
        c[i] *= -H[i, i]


@plain
def _add_costs(s):
    """Add the costs of other tasks; return whether c is small enough relative to H."""
    H, c, hardest, largest = s.H, s.c, 0.0, 0.0
    for i in range(len(s.linear)):
        c[i] += s.linear[i]
        # Written so that NaN counts as the largest.
        if not abs(c[i]) <= largest:
            largest = abs(c[i])
        for j in range(len(s.linear)):
            H[i, j] += s.quadratic[i, j]
            hardest = max(hardest, abs(H[i, j]))
    return largest <= STEEPEST * hardest


@plain
def costs(s, twist_space):
    """Compute H and c from ḣ in c; return whether they can be computed with.

    ``twist_space`` is ``None`` for the joint-space cost: numba then does not compile the
    twist-space cost, which saves a sixth of a step's compilation time.
    """
    if twist_space is None:
        _joint_cost(s)
    else:
        _twist_cost(s)
    return len(s.linear) == 0 or _add_costs(s)


@plain
def forward_rows(s):
    """Uᵀt_ff of all tasks: the part of b that follows moving targets, (m,)."""
    row = 0
    for index in range(len(s.kinds)):
        kinds, target = s.kinds[index], s.targets[index]
        end = row + kinds[0] + kinds[1]
        forward = s.ahead[row:end]
        if kinds[2] == FROM_PYTHON:
            put(s.python_forward[row:end], forward)
        else:
            in_basis(kinds, s.shapes[index], s.poses[index], target, target[12:], forward)
        row = end


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
    if not cholesky(L, m):
        return False
    for i in range(m):
        for k in range(n):
            total = A[i, k]
            for j in range(i):
                total -= L[i, j] * Q[j, k]
            Q[i, k] = total / L[i, i]
    return True


@plain
def brake(s, dt):
    """Slow b of regular levels down so that the joints can stop in time; false for the reference.

    The displacement that would remove a level's error is that of least norm on what the levels
    above leave: with A = LQ it is Qᵢᵀyᵢ of Lᵢᵢyᵢ = bᵢ − Σ Lᵢⱼyⱼ.
    """
    n, L, Q, y, first = len(s.x), s.R, s.Q, s.r, 0
    forward_rows(s)
    if not _orthonormal_rows(s.A, L, Q):
        return False
    for level in range(len(s.ends)):
        end = s.ends[level]
        _solve_rows(L, s.b, s.ahead, 1.0, first, end, y)
        for k in range(n):
            s.motion[k] = 0.0
            for i in range(first, end):
                s.motion[k] += dt * Q[i, k] * y[i]
        share, which = stopping_share(s.motion, s.limits, s.types, dt)
        if level == 0:
            s.braking[0] = share
        if s.braking[1] == 0.0:
            s.braking[1] = which
        for i in range(first, end):
            taken = (1.0 - share) * (s.b[i] - s.ahead[i])
            s.b[i] -= taken
            s.eased[i] = taken if level > 0 else 0.0
        _solve_rows(L, s.b, s.ahead, 0.0, first, end, y)
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
def step_on_rows(s, qpos, dt, use_secondary, twist_space):
    """Compute the joint velocity ``s.x`` from the task rows in ``s``; return the outcome.

    After ``INFEASIBLE`` and ``AT_THE_EDGE`` call ``edge_step``; ``twist_space``: see :func:`costs`.
    """
    fastest = desired_velocities(s, qpos, dt, use_secondary)
    for row in range(len(s.b)):
        # Written so that NaN counts as the fastest.
        if not abs(s.b[row]) <= fastest:
            fastest = abs(s.b[row])
    if not fastest <= FASTEST:
        return REFUSED
    threshold = s.settings.singularity
    s.braking[0], s.braking[1], s.lacks[0] = 1.0, 0.0, 0.0
    for row in range(len(s.eased)):
        s.eased[row] = 0.0
    if s.settings.damps_by_error > 0.0:
        threshold = regular_from(threshold)
    regular = well_conditioned(s.A, s.ends, threshold, s.R, s.J)
    if not bounds(s, s.q, dt):
        return REFUSED
    if not regular:
        return AT_THE_EDGE
    if s.settings.braking > 0.0 and not brake(s, dt):
        return AT_THE_EDGE
    if not costs(s, twist_space):
        return REFUSED
    program = Program(s.H, s.c, s.A, s.b, s.G, s.g, s.lower, s.upper)
    work = Work(
        s.x, s.u, s.active, s.held, s.L, s.start, s.Q, s.rows, s.N, s.J, s.vectors, s.lengths
    )  # fmt: skip
    status = solve_in(program, work, s.y, s.lam, s.box)
    if status != OPTIMAL:
        return INFEASIBLE if status == EMPTY else REFUSED
    s.sensitivity[0] = s.braking[0]
    if s.braking[1] == 0.0:
        return DONE
    return BRAKED if s.braking[0] < 1.0 else BRAKED_BELOW


@plain
def step(s, qpos, dt, use_secondary, twist_space):
    """Compute a step from its inputs; returns as :func:`step_on_rows`."""
    stated_rows(s, dt)
    return step_on_rows(s, qpos, dt, use_secondary, twist_space)

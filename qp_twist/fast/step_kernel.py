"""One step from poses and Jacobians to a verified joint velocity, compiled."""

from __future__ import annotations

import math

import numpy as np

from qp_twist.fast.bounds import bounds
from qp_twist.fast.compiling import kernel, part, plain
from qp_twist.fast.dual_active_set import NO_ROOM, SOLVED, cholesky, cholesky_inverse
from qp_twist.fast.largest_scale import largest_scale
from qp_twist.fast.null_space import null_space, row_space
from qp_twist.fast.reduced_program import reduced_program
from qp_twist.fast.twist_rows import twist_rows

DONE, REFUSED, SCALED = 0, 1, 2
"""The step is verified; the reference has to look at it; it is verified at a reduced speed."""


@plain
def well_conditioned(A, ends, threshold, work, scratch):
    """Whether no singular value of a level's rows is below a threshold.

    Of each level in the null space of those above. AAᵀ = LLᵀ, and there what is left of the squares
    of a level's rows is made of its own block of L.
    """
    m, n = A.shape
    if m > n:
        return False
    square = threshold * threshold
    for i in range(m):
        for j in range(i + 1):
            total = -square if i == j and len(ends) == 1 else 0.0
            for k in range(n):
                total += A[i, k] * A[j, k]
            work[i, j] = total
    if not cholesky(work):
        return False
    first = 0
    for level in range(len(ends) if len(ends) > 1 else 0):
        end = ends[level]
        for i in range(first, end):
            for j in range(first, i + 1):
                total = -square if i == j else 0.0
                for k in range(first, j + 1):
                    total += work[i, k] * work[j, k]
                scratch[i - first, j - first] = total
        if not cholesky(scratch[: end - first, : end - first]):
            return False
        first = end
    return True


@plain
def _clear_cut(H, metric, N, nearly, work):
    """Whether every motion is either in the null space N (p, n) or well seen.

    By eigenvalues: with those of N lifted to the trace, none is small.
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


@kernel
def _unseen(A, free, metric, nearly, H, work):
    """Directions of motion in joints times √metric, (p, n), and how far each is unseen, (p,).

    Nearly always they are the null space of the rows. Else by singular values of these: the
    eigenvectors of their squares know a motion that is not seen only to the square of the rows'
    condition number.
    """
    m, n = A.shape
    scaled, V = np.empty((m + len(free), n)), np.empty((n, n))
    for j in range(n):
        root = math.sqrt(metric[j])
        for i in range(m):
            scaled[i, j] = A[i, j] / root
        for i in range(len(free)):
            scaled[m + i, j] = free[i, j] / root
    rank = row_space(scaled, V)
    N = np.empty((n - rank, n))
    null_space(V[:rank], N)
    if _clear_cut(H, metric, N, nearly, work):
        return N, np.ones(len(N))
    _, sigma, right = np.linalg.svd(scaled, True)
    unseen, largest = np.ones(n), sigma[0] if sigma[0] > 0.0 else 1.0
    for k in range(len(sigma)):
        unseen[k] -= min(1.0, (sigma[k] / (nearly * largest)) ** 2)
    return right, unseen


@kernel
def _add_unseen(A, free, metric, weight, nearly, H, c, wanted, work):
    """Add the joint-space cost on motion that no row sees, and its pull (``posing.unseen``)."""
    n = len(metric)
    directions, unseen = _unseen(A, free, metric, nearly, H, work)
    for k in range(len(unseen)):
        if unseen[k] > 0.0:
            for i in range(n):
                for j in range(n):
                    entry = (
                        weight * unseen[k] * directions[k, i] * directions[k, j]
                        * math.sqrt(metric[i] * metric[j])
                    )  # fmt: skip
                    H[i, j] += entry
                    c[i] -= entry * wanted[j]


@part
def _excess(hardest, left, largest, gap, w, tolerances):
    """What the multipliers leave, in units of its tolerance, as ``verification`` has it.

    ``hardest`` is the largest entry of H, ``left`` that of r = Hx + c + Aᵀy + Gᵀλ + μ, ``largest``
    the largest term in it, and ``gap`` ½rᵀH⁻¹r.
    """
    n, steepest, furthest, held = len(w.c), 0.0, 0.0, 0.0
    for i in range(n):
        steepest, furthest = max(steepest, abs(w.c[i])), max(furthest, abs(w.x[i]))
        largest = max(largest, abs(w.c[i]), abs(w.box[i]))
        if w.box[i] > 0.0:
            held += w.box[i] * (w.upper[i] - w.x[i])
        elif w.box[i] < 0.0:
            held -= w.box[i] * (w.x[i] - w.lower[i])
    gap += held
    largest_b, off = 0.0, 0.0
    for row in range(len(w.b)):
        total = -w.b[row]
        for i in range(n):
            total += w.A[row, i] * w.x[i]
        gap -= w.y[row] * total
        off, largest_b = max(off, abs(total)), max(largest_b, abs(w.b[row]))
    over, lost = 0.0, 0.0
    for row in range(len(w.g)):
        room, terms = w.g[row], abs(w.g[row])
        for i in range(n):
            room -= w.G[row, i] * w.x[i]
            terms += abs(w.G[row, i] * w.x[i])
        over = max(over, -room)
        if w.lam[row] > 0.0:
            gap += w.lam[row] * room
            held += w.lam[row] * max(room, 0.0)
            lost += tolerances.rounding * w.lam[row] * terms
    reach = 1.0 + furthest
    cost = (hardest * reach + steepest) * reach
    worst = max(off / (tolerances.equality * (1.0 + largest_b)), over / (tolerances.bound * reach))
    least = tolerances.optimality * hardest * reach + tolerances.rounding * largest
    worst = max(worst, left / least)
    worst = max(worst, held / (tolerances.gain * cost + lost))
    return max(worst, gap / (tolerances.gap * cost + lost))


@plain
def _pull_of_rows(A, y, residual):
    """Add Aᵀy to ``residual``; the largest of it."""
    largest = 0.0
    for i in range(A.shape[1] if len(y) else 0):
        total = 0.0
        for row in range(len(y)):
            total += A[row, i] * y[row]
        residual[i] += total
        largest = max(largest, abs(total))
    return largest


@part
def _excess_of_diagonal(w, tolerances, residual):
    """:func:`_excess` where H = diag h."""
    hardest, left, gap = 1e-300, 0.0, 0.0
    for i in range(len(w.c)):
        residual[i] = w.h[i] * w.x[i] + w.c[i] + w.box[i]
    largest = max(_pull_of_rows(w.A, w.y, residual), _pull_of_rows(w.G, w.lam, residual))
    for i in range(len(w.c)):
        hardest, left = max(hardest, w.h[i]), max(left, abs(residual[i]))
        gap += 0.5 * residual[i] * residual[i] / w.h[i]
    return _excess(hardest, left, largest, gap, w, tolerances)


@part
def _excess_of_dense(w, tolerances, residual, along):
    """:func:`_excess` for any H, with JJᵀ = H⁻¹: rᵀH⁻¹r = ‖Jᵀr‖²."""
    n, hardest, left, gap = len(w.c), 1e-300, 0.0, 0.0
    for i in range(n):
        residual[i] = w.c[i] + w.box[i]
        along[i] = 0.0
        for j in range(n):
            residual[i] += w.dense[i, j] * w.x[j]
            hardest = max(hardest, abs(w.dense[i, j]))
    largest = max(_pull_of_rows(w.A, w.y, residual), _pull_of_rows(w.G, w.lam, residual))
    for k in range(n):
        left = max(left, abs(residual[k]))
        for i in range(n):
            along[i] += w.J[k, i] * residual[k]
    for i in range(n):
        gap += 0.5 * along[i] * along[i]
    return _excess(hardest, left, largest, gap, w, tolerances)


@part
def _all_rows(kinds, shapes, poses, targets, jacobians, dt, A, b, free, free_costs):
    """The rows of all tasks, one below the other; the fastest that they ask for."""
    row, fastest = 0, 0.0
    for index in range(len(kinds)):
        rank = kinds[index, 0] + kinds[index, 1]
        first = 6 * index if len(free) else 0
        twist_rows(
            kinds[index], shapes[index], poses[index], targets[index], jacobians[index], dt,
            A[row : row + rank], b[row : row + rank], free[first : first + 6], free_costs,
        )  # fmt: skip
        row += rank
    for i in range(row):
        # Written so that NaN is the fastest of all.
        if not abs(b[i]) <= fastest:
            fastest = abs(b[i])
    return fastest


@part
def _desired(qpos, addresses, middle, stiffness, displacement, dt, use_secondary, q, c):
    """Joint positions into q and ḣ into c; the largest entry of ḣ, infinite where q is not."""
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
def _all_seen(H, metric, nearly, work):
    """Whether no motion is nearly unseen by rows whose squares are in H, the common case.

    With the trace for the largest eigenvalue of M^(−1/2) H M^(−1/2), which is not above it.
    """
    n, trace = len(metric), 0.0
    for i in range(n):
        for j in range(i + 1):
            work[i, j] = H[i, j] / math.sqrt(metric[i] * metric[j])
        trace += work[i, i]
    for i in range(n):
        work[i, i] -= nearly * nearly * trace
    return cholesky(work)


@part
def _twist_cost(A, free, metric, weight, nearly, H, c, wanted, work):
    """H with AᵀA, and −(H − AᵀA) ḣ in place of ḣ in c: A ḣ is not wished for."""
    nv = len(c)
    for i in range(nv):
        wanted[i] = c[i]
        for j in range(i + 1):
            total = 0.0
            for k in range(len(free)):
                total += free[k, i] * free[k, j]
            H[i, j] = H[j, i] = total
    for i in range(nv):
        total = 0.0
        for j in range(nv):
            total -= H[i, j] * wanted[j]
        c[i] = total
    for i in range(nv):
        for j in range(i + 1):
            total = H[i, j]
            for k in range(len(A)):
                total += A[k, i] * A[k, j]
            H[i, j] = H[j, i] = total
    if not _all_seen(H, metric, nearly, work):
        _add_unseen(A, free, metric, weight, nearly, H, c, wanted, work)


@part
def _joint_cost(metric, weight, H, c):
    """H = ρM, and −Hḣ in place of ḣ in c."""
    for i in range(len(c)):
        for j in range(len(c)):
            H[i, j] = 0.0
        H[i, i] = weight * metric[i]
        c[i] *= -H[i, i]


@part
def _add_costs(quadratic, linear, steepest, H, c):
    """Add the costs of other tasks; whether c is not too steep for the arithmetic."""
    hardest, largest = 0.0, 0.0
    for i in range(len(linear)):
        c[i] += linear[i]
        # Written so that NaN is the largest of all.
        if not abs(c[i]) <= largest:
            largest = abs(c[i])
        for j in range(len(linear)):
            H[i, j] += quadratic[i, j]
            hardest = max(hardest, abs(H[i, j]))
    return largest <= steepest * hardest


@part
def _costs(w, metric, quadratic, linear, settings):
    """H and c of the step, from ḣ in c; and S where H is not diagonal. Whether H ≻ 0."""
    if len(w.h):
        for i in range(len(w.h)):
            w.h[i] = settings.weight * metric[i]
            w.c[i] *= -w.h[i]
        return True
    if settings.twist_space != 0.0:
        _twist_cost(
            w.A, w.free, metric, settings.weight, settings.nearly_unseen, w.dense, w.c, w.line, w.J
        )
    else:
        _joint_cost(metric, settings.weight, w.dense, w.c)
    if not _add_costs(quadratic, linear, settings.steepest, w.dense, w.c):
        return False
    return cholesky_inverse(w.dense, w.J)


@plain
def _into_the_box(x, lower, upper):
    """To the last bit; whether x is finite."""
    for i in range(len(x)):
        x[i] = min(max(x[i], lower[i]), upper[i])
        if not math.isfinite(x[i]):
            return False
    return True


@part
def solved_program(w, scales, tolerances):
    """The verified solution of a program into ``w.x``; at a reduced speed if ``scales``."""
    w.scale[0] = 1.0
    status = reduced_program(w)
    if status == NO_ROOM and scales:
        w.scale[0] = largest_scale(w)
        if w.scale[0] == 0.0:
            return REFUSED
        for row in range(len(w.b)):
            w.b[row] *= w.scale[0]
        status = reduced_program(w)
    if status != SOLVED or not _into_the_box(w.x, w.lower, w.upper):
        return REFUSED
    if len(w.h):
        excess = _excess_of_diagonal(w, tolerances, w.line)
    else:
        excess = _excess_of_dense(w, tolerances, w.root, w.line)
    if not excess <= 1.0:
        return REFUSED
    return DONE if w.scale[0] == 1.0 else SCALED


@plain
def verified_velocity(
    w, ends, limits, types, metric, quadratic, linear, settings, tolerances, dt
):  # fmt: skip
    """The joint velocity into ``w.x``, from the rows, q and ḣ (in ``w.c``) that are in ``w``.

    Returns:
        ``DONE`` or ``SCALED``, or ``REFUSED`` where the reference has to look at the step.
    """
    if not well_conditioned(w.A, ends, settings.singularity, w.R, w.J):
        return REFUSED
    if not bounds(
        limits, types, w.q, dt, settings.noticeable, settings.unlimited, w.lower, w.upper,
        w.lower_kind, w.upper_kind,
    ):  # fmt: skip
        return REFUSED
    if not _costs(w, metric, quadratic, linear, settings):
        return REFUSED
    return solved_program(w, settings.scales != 0.0 and len(ends) == 1, tolerances)


@part
def step(g, w, qpos, dt, use_secondary):
    """A step from what is given to w; what :func:`verified_velocity` returns."""
    fastest = _desired(
        qpos, g.addresses, g.middle, g.stiffness, g.displacement, dt, use_secondary, w.q, w.c
    )
    asked = _all_rows(
        g.kinds, g.shapes, g.poses, g.targets, g.jacobians, dt, w.A, w.b, w.free, g.free_costs
    )
    if not (fastest <= g.settings.fastest and asked <= g.settings.fastest):
        return REFUSED
    return verified_velocity(
        w, g.ends, g.limits, g.types, g.metric, g.quadratic, g.linear, g.settings, g.tolerances, dt
    )

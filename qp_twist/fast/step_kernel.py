"""One step from poses and Jacobians to a verified joint velocity, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from qp_twist.fast.dual_active_set import SOLVED, cholesky, dual_active_set
from qp_twist.fast.twist_rows import twist_rows

POSITION, MOTION, WINDOW = 0, 1, 2
"""Kinds of limits."""
ACCELERATION_BOUND, VELOCITY_BOUND, POSITION_BOUND = 0, 1, 2
"""What a bound comes from, in the order in which they give way to each other."""
DONE, REFUSED = 0, 1
"""The step is verified; or the reference has to look at it."""


@njit(cache=True, error_model="numpy")
def _stopping_speed(room, acceleration, dt):
    """As ``limits.stopping_speed``, for one joint."""
    if math.isinf(acceleration) or math.isinf(room):
        return room / dt
    braking = acceleration * dt
    steps = math.floor((math.sqrt(1.0 + 8.0 * room / (braking * dt)) - 1.0) / 2.0)
    return room / ((steps + 1.0) * dt) + 0.5 * steps * braking


@njit(cache=True, error_model="numpy")
def _narrow(dof, low, high, kind, lower, upper, lower_kind, upper_kind):
    """Intersect the bounds of a joint with others; of equal ones the kind that gives way least."""
    if low > lower[dof] or (low == lower[dof] and kind < lower_kind[dof]):
        lower[dof], lower_kind[dof] = low, kind
    if high < upper[dof] or (high == upper[dof] and kind < upper_kind[dof]):
        upper[dof], upper_kind[dof] = high, kind


@njit(cache=True, error_model="numpy")
def bounds(
    limits, types, q, dt, noticeable, unlimited, lower, upper, lower_kind, upper_kind
):  # fmt: skip
    """The box of all limits, (nv,); whether no joint is outside and no two limits contradict.

    Args:
        limits: A table for each limit, (L, 7, nv): of positions θ_min, θ_max and what the joint
            stops short of either by; of motions also v_max, a_max and the velocity before; of
            windows the reference and the half width.
        types: Of the limits, (L,).
        q: Joint positions, (nv,).
        dt: Length of the step, s.
        noticeable: What counts as outside, rad or m.
        unlimited: A bound beyond it is none, rad/s or m/s.
        lower: Result.
        upper: Result.
        lower_kind: Result.
        upper_kind: Result.
    """
    for dof in range(len(q)):
        lower[dof], upper[dof] = -math.inf, math.inf
        lower_kind[dof] = upper_kind[dof] = 9
        for index in range(len(types)):
            table = limits[index]
            if types[index] == WINDOW:
                moved = table[0, dof] - q[dof]
                low = min((moved - table[1, dof]) / dt, 0.0)
                high = max((moved + table[1, dof]) / dt, 0.0)
                _narrow(dof, low, high, VELOCITY_BOUND, lower, upper, lower_kind, upper_kind)
                continue
            below, above = q[dof] - table[0, dof], table[1, dof] - q[dof]
            if below < -noticeable or above < -noticeable:
                return False
            down = max(below - table[2, dof], 0.0)
            up = max(above - table[3, dof], 0.0)
            if types[index] == MOTION:
                fastest, hardest, before = table[4, dof], table[5, dof], table[6, dof]
                change = hardest * dt
                _narrow(dof, before - change, before + change, ACCELERATION_BOUND,
                        lower, upper, lower_kind, upper_kind)  # fmt: skip
                _narrow(dof, -fastest, fastest, VELOCITY_BOUND,
                        lower, upper, lower_kind, upper_kind)  # fmt: skip
                if abs(before) > fastest + noticeable:
                    return False
                # Too fast to stop in time: recovering, which the reference tells of.
                for speed, room in ((-before, below), (before, above)):
                    within = _stopping_speed(max(room, 0.0) + noticeable, hardest, dt)
                    if speed - change > within:
                        return False
                down, up = _stopping_speed(down, hardest, dt), _stopping_speed(up, hardest, dt)
            else:
                down, up = down / dt, up / dt
            _narrow(dof, -down, up, POSITION_BOUND, lower, upper, lower_kind, upper_kind)
        if not lower[dof] <= upper[dof] or lower[dof] > unlimited or upper[dof] < -unlimited:
            return False
        if lower[dof] < -unlimited:
            lower[dof] = -math.inf
        if upper[dof] > unlimited:
            upper[dof] = math.inf
    return True


@njit(cache=True, error_model="numpy")
def _well_conditioned(A, threshold, work):
    """Whether no singular value of A (m, n) is below a threshold: AAᵀ − threshold²·1 ≻ 0."""
    m, n = A.shape
    if m > n:
        return False
    for i in range(m):
        for j in range(i + 1):
            work[i, j] = -threshold * threshold if i == j else 0.0
            for k in range(n):
                work[i, j] += A[i, k] * A[j, k]
    return cholesky(work)


@njit(cache=True, error_model="numpy")
def _add_unseen(A, free, metric, weight, nearly, H):
    """Add the joint-space cost on the motion that neither A nor ``free`` see (``_unseen``)."""
    m, n = A.shape
    rows = np.empty((m + len(free), n))
    for i in range(m):
        for j in range(n):
            rows[i, j] = A[i, j] / math.sqrt(metric[j])
    for i in range(len(free)):
        for j in range(n):
            rows[m + i, j] = free[i, j] / math.sqrt(metric[j])
    squares, vectors = np.linalg.eigh(rows.T @ rows)
    largest = squares[n - 1] if squares[n - 1] > 0.0 else 1.0
    for k in range(n):
        unseen = 1.0 - min(1.0, max(squares[k], 0.0) / (nearly * nearly * largest))
        if unseen > 0.0:
            for i in range(n):
                for j in range(n):
                    H[i, j] += (
                        weight * unseen * vectors[i, k] * vectors[j, k]
                        * math.sqrt(metric[i] * metric[j])
                    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _sizes(H, c, x):
    """The largest of |H|, of |c| and of |x|."""
    hardest, steepest, furthest = 1e-300, 0.0, 0.0
    for i in range(len(c)):
        steepest, furthest = max(steepest, abs(c[i])), max(furthest, abs(x[i]))
        for j in range(len(c)):
            hardest = max(hardest, abs(H[i, j]))
    return hardest, steepest, furthest


@njit(cache=True, error_model="numpy")
def _left_of_gradient(H, c, A, x, y, box, residual):
    """r = Hx + c + Aᵀy + μ into ``residual``; the largest of it, and the largest term in it."""
    left, largest = 0.0, 0.0
    for i in range(len(c)):
        gradient, equality = c[i], 0.0
        for j in range(len(c)):
            gradient += H[i, j] * x[j]
        for row in range(len(y)):
            equality += A[row, i] * y[row]
        residual[i] = gradient + equality + box[i]
        left = max(left, abs(residual[i]))
        largest = max(largest, abs(c[i]))
        largest = max(largest, abs(equality))
        largest = max(largest, abs(box[i]))
    return left, largest


@njit(cache=True, error_model="numpy")
def _excess(H, c, A, b, lower, upper, x, y, box, J, tolerances, residual):
    """What the multipliers leave, in units of its tolerance, as ``verification._excess``."""
    hardest, steepest, furthest = _sizes(H, c, x)
    left, largest = _left_of_gradient(H, c, A, x, y, box, residual)
    reach = 1.0 + furthest
    held, gap = 0.0, 0.0
    for i in range(len(c)):
        if box[i] > 0.0:
            held += box[i] * (upper[i] - x[i])
        elif box[i] < 0.0:
            held -= box[i] * (x[i] - lower[i])
        along = 0.0  # rᵀH⁻¹r = ‖Jᵀr‖²
        for k in range(len(c)):
            along += J[k, i] * residual[k]
        gap += 0.5 * along * along
    gap += held
    largest_b, off = 0.0, 0.0
    for row in range(len(b)):
        total = -b[row]
        for i in range(len(c)):
            total += A[row, i] * x[i]
        gap -= y[row] * total
        off, largest_b = max(off, abs(total)), max(largest_b, abs(b[row]))
    cost = (hardest * reach + steepest) * reach
    worst = off / (tolerances[0] * (1.0 + largest_b))
    worst = max(worst, left / (tolerances[1] * hardest * reach + tolerances[4] * largest))
    worst = max(worst, held / (tolerances[2] * cost))
    return max(worst, gap / (tolerances[3] * cost))


@njit(cache=True, error_model="numpy")
def _all_rows(kinds, shapes, poses, targets, jacobians, dt, A, b, free, free_costs, work):
    """The rows of all tasks, one below the other; the fastest that they ask for."""
    row, fastest = 0, 0.0
    for index in range(len(kinds)):
        rank = kinds[index, 0] + kinds[index, 1]
        first = 6 * index if len(free) else 0
        twist_rows(
            kinds[index], shapes[index], poses[index], targets[index], jacobians[index], dt,
            A[row : row + rank], b[row : row + rank], free[first : first + 6], free_costs, work,
        )  # fmt: skip
        row += rank
    for i in range(row):
        # Written so that NaN is the fastest of all.
        if not abs(b[i]) <= fastest:
            fastest = abs(b[i])
    return fastest


@njit(cache=True, error_model="numpy")
def _wish(qpos, addresses, middle, pull, wish, dt, use_secondary, q, c):
    """Joint positions into q and ḣ into c; the largest entry of ḣ, infinite where q is not."""
    largest = 0.0
    for dof in range(len(q)):
        q[dof] = qpos[addresses[dof]] if addresses[dof] >= 0 else 0.0
        if not math.isfinite(q[dof]):
            return math.inf
        c[dof] = 0.0
        if use_secondary:
            c[dof] = (wish[dof] + pull[dof] * (middle[dof] - q[dof])) / dt
        if not abs(c[dof]) <= largest:
            largest = abs(c[dof])
    return largest


@njit(cache=True, error_model="numpy")
def _cost(A, free, metric, weight, nearly, twist_space, H, c, wanted):
    """H, and −H ḣ in place of ḣ in c; AᵀA is added behind that, since A ḣ is not wished for."""
    nv = len(c)
    for i in range(nv):
        wanted[i] = c[i]
        for j in range(nv):
            H[i, j] = 0.0
            for k in range(len(free)):
                H[i, j] += free[k, i] * free[k, j]
        if not twist_space:
            H[i, i] = weight * metric[i]
    if twist_space:
        _add_unseen(A, free, metric, weight, nearly, H)
    for i in range(nv):
        c[i] = 0.0
        for j in range(nv):
            c[i] -= H[i, j] * wanted[j]
    if twist_space:
        for i in range(nv):
            for j in range(nv):
                for k in range(len(A)):
                    H[i, j] += A[k, i] * A[k, j]


@njit(cache=True, error_model="numpy")
def _multipliers(m, count, active, u, x, lower, upper, y, box):
    """x into the box to the last bit, and the multipliers by rows and bounds; whether x is finite.

    The signs are those of ``verification``: Hx + c + Aᵀy + μ = 0.
    """
    nv = len(x)
    for i in range(nv):
        box[i] = 0.0
        x[i] = min(max(x[i], lower[i]), upper[i])
        if not math.isfinite(x[i]):
            return False
    for i in range(count):
        if i < m:
            y[i] = -u[i]
        elif active[i] < m + nv:
            box[active[i] - m] -= u[i]
        else:
            box[active[i] - m - nv] += u[i]
    return True


@njit(cache=True, error_model="numpy")
def step_kernel(
    kinds, shapes, poses, targets, jacobians, qpos, addresses, middle, pull, wish,
    limits, types, metric, free_costs, settings, tolerances, dt, use_secondary,
    out, bound_kinds, active, ints, work,
):  # fmt: skip
    """A step; ``controller.compiled_step`` lays out the arrays.

    Returns:
        ``DONE``, or ``REFUSED`` for whatever is not a plain step inside all limits.
    """
    nv, m = len(metric), len(ints) - 1 - 2 * len(metric)
    twist_space = settings[0] > 0.0
    # Views of the result.
    A, H = out[: m * nv].reshape(m, nv), out[m * nv : m * nv + nv * nv].reshape(nv, nv)
    at = (m + nv) * nv
    b, at = out[at : at + m], at + m
    vectors = out[at:].reshape(5, nv)
    c, lower, upper, x, box = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    # Views of the workspace.
    J = work[: nv * nv].reshape(nv, nv)
    R = work[nv * nv : 2 * nv * nv].reshape(nv, nv)
    at = 2 * nv * nv
    u, three = work[at : at + nv + 1], work[at + nv + 1 : at + 4 * nv + 4].reshape(3, nv + 1)
    at += 4 * nv + 4
    q, y = work[at : at + nv], work[at + nv : at + nv + m]
    at += nv + m
    square, small = work[at : at + m * m].reshape(m, m), work[at + m * m : at + m * m + 48]
    at += m * m + 48
    freed = 6 * len(kinds) if twist_space else 0
    free = work[at : at + freed * nv].reshape(freed, nv)

    fastest = _wish(qpos, addresses, middle, pull, wish, dt, use_secondary, q, c)
    asked = _all_rows(
        kinds, shapes, poses, targets, jacobians, dt, A, b, free, free_costs, small.reshape(12, 4)
    )
    if not (fastest <= settings[4] and asked <= settings[4]):
        return REFUSED
    if not _well_conditioned(A, settings[1], square):
        return REFUSED
    _cost(A, free, metric, settings[2], settings[3], twist_space, H, c, three[0])
    if not bounds(
        limits, types, q, dt, settings[5], settings[6], lower, upper, bound_kinds[0], bound_kinds[1]
    ):
        return REFUSED
    before, ints[0] = ints[0], 0
    status, count = dual_active_set(
        H, c, A, b, np.empty((0, nv)), np.empty(0), lower, upper, active, before, x, u, J, R,
        ints[1:], three,
    )  # fmt: skip
    if status != SOLVED or not _multipliers(m, count, active, u, x, lower, upper, y, box):
        return REFUSED
    if not _excess(H, c, A, b, lower, upper, x, y, box, J, tolerances, q) <= 1.0:
        return REFUSED
    for i in range(m, count):  # for the next step
        active[i - m] = active[i]
    ints[0] = count - m
    return DONE

"""A step at the edge of the reach, near a singularity, or where the limits do not allow the task.

The readable versions, with the formulas, are ``qp.edge`` and ``control.edge_step``. This one takes
a single priority level, and limits as the only rows of G.
"""

from __future__ import annotations

import math

from qp_twist.kernel.bounds import MOTION
from qp_twist.kernel.closest_levels import NOT_PROVEN, begin, length_of_rows, take_level
from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.dual_active_set import (
    NO_ROOM,
    SOLVED,
    cholesky,
    cholesky_inverse,
    cholesky_solve,
)
from qp_twist.kernel.edge_rows import (
    BEND,
    DEGRADED,
    FADES,
    FAR,
    FITTING,
    PASSED,
    REACH,
    ROOM,
    SIZE,
    SMALLEST,
    SPREAD,
    ask,
    damp,
    ease,
    fit,
    lengthen,
    longest_secondary,
    rotate_rows,
    stopping_share,
    task_motion,
    weaken,
)
from qp_twist.kernel.joint_program import joint_program
from qp_twist.kernel.paced_program import find_null_space, paced_program
from qp_twist.kernel.reduced_program import reduced_program, unlimited
from qp_twist.kernel.step_kernel import (
    RAISE,
    RELAX,
    SCALE,
    costs,
    desired_velocities,
    forward_rows,
    rest_is_excluded,
    stated_rows,
)
from qp_twist.kernel.verified_program import (
    BRAKED,
    DONE,
    FADED,
    INFEASIBLE,
    REFUSED,
    RELAXED,
    SCALED,
    checked,
    clip_to_bounds,
    excess_of,
)

WORTH, WORTH_CURVED = 5.0, 1e-2
"""γ and δ of ``control.edge_step``."""
DEAD = 0.03
"""Share of the relaxed step's progress below which a scaled step passes over to it."""
AT_REST = 1e-7
"""As in ``control.edge_step``."""
INERTIA, MISSED, LOOSE = 0.7, 0.1, 10.0
"""ζ, ρ₀ and c of ``control.edge_step``."""
YIELDING = 0.01
"""Share of a relaxed step from which all rows yield so much that their slacks are eliminated."""
NULL_SHARE, ROUNDING = 0.3, 1e-9
"""As in ``qp.edge``."""
NOTICEABLE = 1e-8
"""``qp.verification.EQUALITY_TOLERANCE``: less is not called lost."""
_LINEAR = 1e-10
"""Cost ½ε²‖x‖² beside ½(s − 2)² in the program of the largest s: see ``largest_scale``."""
_STIFF = 1e-5
"""ε² where limits nearly coincide in the plane of motion and scale, divided by the squared speed of
the task's motion: the smaller one finds no room between them. Where rest is allowed, s* is the same
unless it takes 300 times that motion."""
_ROUNDED = 1e-9
"""Room between limits that meet exactly at a task's solution, rad/s and m/s: without it rounding
decides whether there is a solution. The step itself keeps its limits."""
_OF_THE_MOTION = 1e-4
"""A multiplier of at most this share of ε²‖x‖ is due to that cost: it does not limit s."""


@plain
def _weaken_and_brake(g, w, e, dt, trusts):
    """Set all of ``e`` up to the right-hand sides, and the braked b; false for the reference."""
    singularity, m, n = g.settings.singularity, len(w.b), len(w.x)
    forward_rows(g, e.ahead)
    for i in range(m):
        e.rate[i], e.forward[i] = w.b[i], e.ahead[i]
        for k in range(n):
            e.rows[i, k] = w.A[i, k]
    rotate_rows(e)
    weaken(e, singularity)
    share = 1.0
    if g.settings.braking > 0.0 and m > 0:
        damp(e, singularity, dt, trusts, 1.0)
        for i in range(m):
            e.goal[i] = e.rate[i] - e.forward[i]
        task_motion(e, False, e.motion)
        for k in range(n):
            e.motion[k] *= dt
        share, which = stopping_share(e.motion, g.limits, g.types, dt)
        w.braking[0], w.braking[1] = share, which
    damp(e, singularity, dt, trusts, 0.0)
    for i in range(m):
        e.goal[i] = share * (e.rate[i] - e.forward[i]) + e.forward[i]
        w.b[i] = share * (w.b[i] - e.ahead[i]) + e.ahead[i]
    e.numbers[FITTING] = 1.0
    if g.settings.infeasible == SCALE and e.numbers[DEGRADED] > 0.0:
        if not lengthen(g, w, e, dt, SPREAD):
            return False
        fit(w, e)
    ask(e, singularity)
    return True


@plain
def _shorten(w, e, dt, singularity):
    """Shorten ḣ in ``w.c`` to what stays clear of the nearest singularity; return its length."""
    square = 0.0
    for k in range(len(w.c)):
        square += w.c[k] * w.c[k]
    length, longest = math.sqrt(square), longest_secondary(e, singularity) / dt
    if length <= longest:
        return length
    for k in range(len(w.c)):
        w.c[k] *= longest / length
    return longest


@plain
def largest_cost(w):
    """The largest entry of H."""
    largest = 0.0
    for i in range(len(w.h)):
        largest = max(largest, w.h[i])
    for i in range(len(w.dense)):
        for j in range(len(w.dense)):
            largest = max(largest, abs(w.dense[i, j]))
    return largest


@plain
def joint_cost(w, e):
    """Copy H to ``e.cost``, (n, n)."""
    for i in range(len(w.x)):
        for j in range(len(w.x)):
            e.cost[i, j] = 0.0 if len(w.h) > 0 else w.dense[i, j]
        if len(w.h) > 0:
            e.cost[i, i] = w.h[i]


@plain
def _program(e):
    """Where the step is posed: without slacks if no direction needs one."""
    for i in range(len(e.missing)):
        if e.missing[i] > 0.0:
            return e.program
    return e.slim


@part
def _slacks(p, w):
    """Number of slacks of a program with the scale."""
    return len(p.x) - len(w.x) - 1


@plain
def _take_limits(w, e, p):
    """Copy the limits to a program, with the room that it has."""
    room = e.numbers[ROOM]
    for i in range(len(w.x)):
        p.lower[i], p.upper[i] = w.lower[i] - room, w.upper[i] + room
    for row in range(len(w.g)):
        p.g[row] = w.g[row] + room


@plain
def _factorised(w, p):
    """Write S of H⁻¹ = SSᵀ to J; return whether H is positive definite."""
    if len(w.h) == 0:
        return cholesky_inverse(p.dense, p.J)
    for i in range(len(p.x)):
        for j in range(len(p.x)):
            p.J[i, j] = 0.0
        if not p.dense[i, i] > 0.0:
            return False
        p.J[i, i] = 1.0 / math.sqrt(p.dense[i, i])
    return True


@plain
def _begin_program(w, e, p, of_slacks, of_scale):
    """The costs H, of slacks and of the scale, no linear cost, and all limits."""
    n, unknowns = len(w.x), len(p.x)
    for i in range(unknowns):
        for j in range(unknowns):
            p.dense[i, j] = e.cost[i, j] if i < n and j < n else 0.0
        p.c[i], p.lower[i], p.upper[i] = 0.0, -math.inf, math.inf
    _take_limits(w, e, p)
    for i in range(_slacks(p, w)):
        p.dense[n + i, n + i] = of_slacks
        if e.missing[i] > 0.0:
            p.lower[n + i], p.upper[n + i] = -e.numbers[REACH], e.numbers[REACH]
    if unknowns > n:
        p.dense[unknowns - 1, unknowns - 1] = of_scale
    for row in range(len(w.g)):
        for i in range(unknowns):
            p.G[row, i] = w.G[row, i] if i < n else 0.0


@plain
def _write_rows(w, e, p, scale, of_u):
    """Write the rows B q̇ − S z − ``of_u`` slope u = at_rest + ``scale`` slope."""
    n, slacks = len(w.x), _slacks(p, w)
    for i in range(len(w.b)):
        for k in range(n):
            p.A[i, k] = e.rows[i, k]
        for j in range(slacks):
            p.A[i, n + j] = -e.missing[i] if i == j else 0.0
        p.A[i, n + slacks] = -of_u * e.slope[i]
        p.b[i] = e.at_rest[i] + scale * e.slope[i]


@plain
def _solution(w, e, p):
    """Solve a program with the scale, with S of H⁻¹ = SSᵀ in J; returns as ``reduced_program``.

    It begins with the constraints that were active in the last program of this step.
    """
    return paced_program(e, p) if _slacks(p, w) == 0 else reduced_program(p)


@plain
def _solved(w, e, p, tolerances):
    """The verified solution of a program with the scale; returns as ``solved_program``."""
    if not _factorised(w, p):
        return REFUSED
    return checked(p, _solution(w, e, p), tolerances)


@plain
def _solved_in_joints(p, tolerances):
    """The same of a program without rows, as ``DONE`` or ``REFUSED``."""
    if not cholesky_inverse(p.dense, p.J):
        return REFUSED
    if joint_program(p) != SOLVED:
        return REFUSED
    if not clip_to_bounds(p.x, p.lower, p.upper):
        return REFUSED
    return DONE if excess_of(p, tolerances) <= 1.0 else REFUSED


@plain
def _pose(w, e, p, largest):
    """Write the program at full speed."""
    _begin_program(w, e, p, largest, 1.0)
    for k in range(len(w.x)):
        p.c[k] = w.c[k]
    _write_rows(w, e, p, 1.0, 0.0)


@plain
def _as_posed(w, e, largest, tolerances):
    """Solve the program at full speed."""
    p = _program(e)
    _pose(w, e, p, largest)
    return _solved(w, e, p, tolerances)


@plain
def _strain(w, e, largest, dt):
    """As ``control.edge_step.strain``; negative on failure."""
    if e.numbers[DEGRADED] == 0.0:
        return 0.0
    p, unknowns, square = _program(e), len(_program(e).x), 0.0
    _pose(w, e, p, largest)
    if not (cholesky_inverse(p.dense, p.J) and unlimited(p)):
        return -1.0
    for i in range(len(w.b)):
        beyond = 0.0
        for k in range(unknowns - 1):
            beyond += p.A[i, k] * (min(max(p.x[k], p.lower[k]), p.upper[k]) - p.x[k])
        square += beyond * beyond
    short = e.numbers[DEGRADED] * dt * math.sqrt(square)
    size = e.numbers[SIZE]
    return short if BEND * short > ROUNDING * size else 0.0


@plain
def excess(damping, size):
    """Damping t + ℓ r of rows with σ_max = ``size``; not less than rounding."""
    return max(damping, ROUNDING * size * size)


@plain
def _shortfall(w, e, largest, dt, tolerances):
    """r, m and rad: what the limits do not allow of the task's displacement; negative on failure.

    The multipliers of the limits in the way are written to ``sensitivity`` of the program.
    """
    p, m, square = _program(e), len(w.b), 0.0
    _begin_program(w, e, p, largest, 1.0)
    _write_rows(w, e, p, 1.0, 0.0)
    begin(p, p.levels)
    guessed = _active_by(e.sensitivity, w, len(p.x), p.levels.active)
    if take_level(p, p.levels, 0, 0, m, tolerances, guessed) == NOT_PROVEN:
        return -1.0
    for i in range(m):
        square += p.levels.r[i] * p.levels.r[i]
    return dt * math.sqrt(square)


@plain
def _active_by(sensitivity, w, unknowns, active):
    """Write the limits with multipliers, (n + k,), as an active set; return their number.

    They are numbered as in ``active_set`` for a program with so many unknowns and no rows.
    """
    n, k, count = len(w.x), len(w.g), 0
    for i in range(n + k):
        multiplier = sensitivity[i]
        if multiplier == 0.0 or count == n:
            continue
        active[count] = i - n if i >= n else k + i + (unknowns if multiplier > 0.0 else 0)
        count += 1
    return count


@plain
def _times(A, x, y):
    """y = A x."""
    for i in range(len(y)):
        total = 0.0
        for j in range(len(x)):
            total += A[i, j] * x[j]
        y[i] = total


@plain
def relaxed_cost(e, c, goal, first, end, more, weight, H, linear):
    """Write the cost of ``EdgeRows.relaxed`` of the rows ``first`` to ``end`` to H and ``linear``.

    With N = 1 − Aᵀ max(AAᵀ, ε²)⁻¹ A it is ``weight`` (N H N, N (c + H q̇_task)) and the rows' own.

    Args:
        e: The rotated rows and H; ``motion`` is what the levels above do to the joints, (n,), and
            is overwritten.
        c: Linear cost of the step, (n,).
        goal: Right-hand sides of the rotated rows, (m,).
        first: Index of the first row.
        end: Index after the last row.
        more: What is added to d.
        weight: Of the cost in the null space.
        H: Result, (≥ n, ≥ n).
        linear: Result, (n,).
    """
    n, N = len(c), e.project
    for k in range(n):
        for j in range(n):
            N[k, j] = 1.0 if k == j else 0.0
    for i in range(first, end):
        gain = goal[i] / (e.damped[i] + more)
        for k in range(n):
            e.motion[k] += gain * e.rows[i, k]
            for j in range(n):
                N[k, j] -= e.rows[i, k] * e.rows[i, j] / e.floor[i]
    _times(e.cost, e.motion, e.scratch)
    for k in range(n):
        e.scratch[k] = weight * (c[k] + e.scratch[k])
    _times(N, e.scratch, linear)
    for j in range(n):
        _times(e.cost, N[j], e.scratch)
        for k in range(j, n):  # N is symmetric, and so is N H N
            total = 0.0
            for i in range(n):
                total += N[k, i] * e.scratch[i]
            H[k, j] = H[j, k] = weight * total
    for i in range(first, end):
        damped = (e.damped[i] + more) / e.floor[i]
        for k in range(n):
            linear[k] -= e.square[i] / e.floor[i] * goal[i] * e.rows[i, k]
            for j in range(n):
                H[k, j] += damped * e.rows[i, k] * e.rows[i, j]


@plain
def _relaxed(w, e, short, largest, dt, tolerances):
    """The damped least squares of the task inside the limits; returns ``DONE`` or ``REFUSED``."""
    p, n, m = e.bare, len(w.x), len(w.b)  # z = 0
    size, far = e.numbers[SIZE], e.numbers[FAR]
    more = BEND * size * short
    weight = NULL_SHARE * excess(far + BEND * size * short, size) / largest
    for k in range(n):
        e.motion[k] = 0.0
    _begin_program(w, e, p, 1.0, 1.0)
    relaxed_cost(e, w.c, e.goal, 0, m, more, weight, p.dense, p.c)
    return _solved_in_joints(p, tolerances)


@plain
def _scaled_motion(e, at_rest, slope, motion):
    """Motion of the task alone for ``at_rest`` + ``slope`` times its slope; return its length."""
    square = 0.0
    for k in range(len(motion)):
        motion[k] = 0.0
        for i in range(len(e.goal)):
            asked = at_rest * e.at_rest[i] + slope * e.slope[i]
            motion[k] += e.rows[i, k] * asked / e.floor[i]
        square += motion[k] * motion[k]
    return math.sqrt(square)


@plain
def _largest(w, e, backoff, weight):
    """s*, less the backoff; −1 if not even rest is feasible, −2 on failure.

    The derivatives of s* by the limits are written to ``e.sensitivity``. ``weight`` is ε², the cost
    of the joints' motion.
    """
    p, n = _program(e), len(w.x)
    u = len(p.x) - 1
    speed = _scaled_motion(e, 0.0, 1.0, e.motion)
    _begin_program(w, e, p, weight, 1.0)
    furthest = 1.0
    for i in range(n):
        for j in range(n):
            p.dense[i, j] = weight if i == j else 0.0
    p.c[u], p.lower[u], p.upper[u] = -2.0, 0.0, 1.0
    _write_rows(w, e, p, 0.0, 1.0)
    for i in range(u + 1):
        for j in range(u + 1):
            p.J[i, j] = 1.0 / math.sqrt(p.dense[i, i]) if i == j else 0.0
    status = _solution(w, e, p)
    if status == NO_ROOM:
        return -1.0
    if status != SOLVED or not clip_to_bounds(p.x, p.lower, p.upper):
        return -2.0
    scale = p.x[u]
    for i in range(u):
        furthest = max(furthest, abs(p.x[i]))
    least = _OF_THE_MOTION * weight * furthest
    for i in range(n):
        e.sensitivity[i] = p.box[i] / (2.0 - scale) if abs(p.box[i]) > least else 0.0
    for row in range(len(w.g)):
        e.sensitivity[n + row] = p.lam[row] / (2.0 - scale) if p.lam[row] > least else 0.0
    return scale * (1.0 - backoff) if scale * speed > AT_REST else 0.0


@plain
def _largest_with_rest(w, e, backoff):
    """:func:`_largest`; if it finds none though rest is allowed, stiffer and with some room."""
    top = _largest(w, e, backoff, _LINEAR)
    if top != -1.0 or e.numbers[DEGRADED] > 0.0 or rest_is_excluded(w):
        return top
    e.numbers[ROOM] = _ROUNDED
    speed = max(_scaled_motion(e, 0.0, 1.0, e.motion), AT_REST)
    return _largest(w, e, backoff, _STIFF / (speed * speed))


@plain
def _worthwhile(g, w, e, top, largest, dt, tolerances):
    """The scale s = u s* that is worth its joint motion; −1 on failure. The motion is in e."""
    p, n = _program(e), len(w.x)
    u = len(p.x) - 1
    _begin_program(w, e, p, largest, 1.0)
    if not ease(g, w, e, p, dt, 1.0 + (SPREAD - 1.0) * (1.0 - top)):
        return -1.0
    _write_rows(w, e, p, 0.0, top)
    _scaled_motion(e, 1.0, top, e.motion)
    for k in range(n):
        p.lower[k], p.upper[k] = e.lower[k], e.upper[k]
        e.scratch[k] = -w.c[k]
    for i in range(n):
        for j in range(n):
            e.project[i, j] = e.cost[i, j]
    if not cholesky(e.project):
        return -1.0
    cholesky_solve(e.project, e.scratch)
    for k in range(n):
        e.scratch[k] = min(max(e.scratch[k], w.lower[k]), w.upper[k])
    worth = 0.0
    for i in range(n):
        total, pulled = 0.0, 0.0
        for j in range(n):
            total += e.cost[i, j] * e.motion[j]
            pulled += e.cost[i, j] * e.scratch[j]
        worth += e.motion[i] * total
        p.c[i] = -pulled
    worth *= WORTH / (1.0 - top)
    curved = WORTH_CURVED * worth if worth > 0.0 else 1.0
    p.dense[u, u], p.c[u] = curved, -worth - curved
    p.lower[u], p.upper[u] = 0.0, 1.0
    status = _solved(w, e, p, tolerances)
    if status != DONE:
        # Joints that move already may not be able to slow down as the eased bounds ask; and where
        # they leave a single velocity, it is that of s* itself.
        _take_limits(w, e, p)
        p.upper[u] = 1.0 + 2.0 * tolerances.backoff
        status = _solved(w, e, p, tolerances)
    return top * p.x[u] if status == DONE else -1.0


@plain
def _take(w, p):
    """Copy the velocity and the multipliers from a program."""
    for k in range(len(w.x)):
        w.x[k], w.box[k] = p.x[k], p.box[k]
    for row in range(len(w.lam)):
        w.lam[row] = p.lam[row]
    for row in range(len(w.y)):
        w.y[row] = 0.0


@plain
def _note_fading(w, e):
    """Set whether less than b is asked of a direction, noticeably (``EdgeRows.lost``)."""
    longest, largest = length_of_rows(w.A, e.stated, 0, len(w.b))
    e.numbers[FADES] = 0.0
    noticeable = NOTICEABLE * ((longest if longest > 0.0 else 1.0) + largest)
    for i in range(len(w.b)):
        share = 1.0 - e.weakness[i]
        share *= 1.0 - e.weakness[i] * (1.0 - e.numbers[FITTING])
        if share < 1.0 and (1.0 - share) * abs(e.rate[i]) > noticeable:
            e.numbers[FADES] = 1.0


@plain
def _met(w, e):
    """The outcome of a step that was solved as posed."""
    _take(w, _program(e))
    return _outcome(w, e)


@plain
def _outcome(w, e):
    """``DONE``, or what less than that is asked."""
    w.sensitivity[0] = w.braking[0]
    if e.numbers[FADES] > 0.0:
        return FADED
    return BRAKED if w.braking[0] < 1.0 else DONE


@plain
def _give_way(w, e, strained, largest, dt, tolerances):
    """Relax the task; return ``RELAXED`` or ``REFUSED``. Multipliers: of the limits in the way."""
    short = _shortfall(w, e, largest, dt, tolerances)
    if short < 0.0:
        return REFUSED
    p, n = _program(e), len(w.x)
    for k in range(n):
        w.sensitivity[1 + k] = p.sensitivity[1 + k]
    for row in range(len(w.g)):
        w.sensitivity[1 + n + row] = p.sensitivity[1 + len(p.x) + row]
    e.bare.active_count[0] = _active_by(w.sensitivity[1:], w, n, e.bare.active)
    if _relaxed(w, e, max(short, strained), largest, dt, tolerances) != DONE:
        return REFUSED
    _take(w, e.bare)
    w.sensitivity[0] = w.braking[0]
    return RELAXED


@plain
def _left(e, scale):
    """The smaller one of s and of what is left of the weakest direction, 1 − φ (1 − θ)."""
    return min(scale, 1.0 - e.numbers[DEGRADED] * (1.0 - e.numbers[FITTING]))


@part
def _lag(slow, free, none):
    """As ``control.edge_step``."""
    most = max(free, slow, none)
    return max(0.0, slow - none) / most if most > 0.0 else 1.0


@plain
def _stopped(e, scale, x):
    """``control.edge_step.stopped`` for the relaxed velocity x."""
    fitting, none = e.numbers[FITTING], 0.0
    slow, free, slow_weak, free_weak = 0.0, 0.0, 0.0, 0.0
    for i in range(len(e.goal)):
        goal, weak, reached = e.goal[i], e.weakness[i], 0.0
        for k in range(len(x)):
            reached += e.rows[i, k] * x[k]
        whole = e.met[i] * goal
        none += ROUNDING * goal * goal
        slow += scale * (1.0 - weak) * (1.0 - weak) * whole * goal
        free += (1.0 - weak) * goal * (reached - fitting * weak * whole)
        slow_weak += fitting * weak * weak * whole * goal
        free_weak += weak * goal * (reached - scale * (1.0 - weak) * whole)
    regular = max(_lag(slow, free, none), scale)
    return min(regular, max(_lag(slow_weak, free_weak, none), _left(e, 1.0)))


@plain
def _is_asked(e):
    """Whether the task asks for a motion."""
    largest = 0.0
    for rate in e.goal:
        largest = max(largest, abs(rate))
    return largest > 0.0


@plain
def _pass_over(w, e, scale, largest, dt, tolerances):
    """Write q̇ + ψ (q̇_relaxed − q̇) to ``w.x``, q̇ that of the program; return ψ, −1 on failure.

    ``scale`` is that of q̇.
    """
    for k in range(len(w.x)):
        e.scaled[k] = _program(e).x[k]
    if _give_way(w, e, 0.0, largest, dt, tolerances) != RELAXED:
        return -1.0
    e.numbers[PASSED] = share = max(0.0, 1.0 - _stopped(e, scale, w.x) / DEAD)
    for k in range(len(w.x)):
        w.x[k] = e.scaled[k] + share * (w.x[k] - e.scaled[k])
    return share


@plain
def _just_met(w, e, top, largest, tolerances):
    """The outcome of a task that the limits exclude by rounding alone: its scale is nearly 1."""
    p, missed = _program(e), 0.0
    for i in range(len(w.b)):
        missed = max(missed, (1.0 - top) * abs(e.slope[i]))
    longest, asked = length_of_rows(w.A, w.b, 0, len(w.b))
    if missed > tolerances.equality * (longest + asked):
        return REFUSED
    # The active set takes violations of as much for rounding, when it finds the scale, too.
    e.numbers[ROOM] += 2.0 * _ROUNDED
    _pose(w, e, p, largest)
    _write_rows(w, e, p, top, 0.0)
    return _met(w, e) if _solved(w, e, p, tolerances) == DONE else REFUSED


@plain
def _as_scaled(g, w, e, top, largest, dt, tolerances):
    """The step at a scale up to ``top``, or between it and the relaxed one.

    Returns:
        The scale and ψ; −1 on failure.
    """
    if top == 0.0 and _is_asked(e):
        # The relaxed step alone, whatever the scaled one is: see _stopped.
        if _give_way(w, e, 0.0, largest, dt, tolerances) != RELAXED:
            return -1.0, 0.0
        e.numbers[PASSED] = 1.0
        return 0.0, 1.0
    scale = _worthwhile(g, w, e, top, largest, dt, tolerances)
    if scale < 0.0:
        return -1.0, 0.0
    if _left(e, scale) >= DEAD:
        _take(w, _program(e))
        return scale, 0.0
    share = _pass_over(w, e, scale, largest, dt, tolerances)
    if share < 0.0 or not clip_to_bounds(w.x, w.lower, w.upper):
        return -1.0, 0.0
    return scale, share


@plain
def _slower(g, w, e, largest, dt, tolerances):
    """Scale the task, and pass over to the relaxed step where a limit stops it."""
    top = _largest_with_rest(w, e, tolerances.backoff)
    if top == -1.0:
        return _give_way(w, e, 0.0, largest, dt, tolerances)
    if top < 0.0:
        return REFUSED
    if top >= 1.0 - 2.0 * tolerances.backoff:
        return _just_met(w, e, top, largest, tolerances)
    scale, share = _as_scaled(g, w, e, top, largest, dt, tolerances)
    if scale < 0.0:
        return REFUSED
    for i in range(len(w.x) + len(w.g)):
        w.sensitivity[1 + i] = e.sensitivity[i]
    if share > 0.0:
        return RELAXED
    w.sensitivity[0] = scale * w.braking[0]
    for i in range(len(w.b)):
        w.b[i] *= scale
    return SCALED


@plain
def _feasible(w, e, mode, largest, dt, tolerances):
    """The outcome of a step whose program has a solution as posed, which it holds."""
    outcome = _met(w, e)
    if mode == RAISE:
        return REFUSED if outcome == FADED else outcome
    if mode == RELAX:
        strained = _strain(w, e, largest, dt)
        if strained == 0.0:
            return outcome
        return _give_way(w, e, strained, largest, dt, tolerances) if strained > 0.0 else REFUSED
    if _left(e, 1.0) >= DEAD:
        return outcome
    share = _pass_over(w, e, 1.0, largest, dt, tolerances)
    if share > 0.0 and clip_to_bounds(w.x, w.lower, w.upper):
        return RELAXED
    if share < 0.0 or _as_posed(w, e, largest, tolerances) != DONE:
        return REFUSED
    return _met(w, e)


@plain
def _without_inertia(g, w, e, is_infeasible, largest, dt, tolerances):
    """The outcome of the step whose costs and limits are in w and e."""
    mode = g.settings.infeasible
    status = INFEASIBLE
    for i in range(len(w.x) + len(w.g)):
        e.sensitivity[i] = 0.0
    if not (is_infeasible and mode == SCALE):
        status = _as_posed(w, e, largest, tolerances)
    if status == DONE:
        return _feasible(w, e, mode, largest, dt, tolerances)
    if status != INFEASIBLE or mode == RAISE:
        return REFUSED
    if mode == SCALE:
        return _slower(g, w, e, largest, dt, tolerances)
    strained = _strain(w, e, largest, dt)
    return _give_way(w, e, strained, largest, dt, tolerances) if strained >= 0.0 else REFUSED


@plain
def _inert_share(g, dof, dt):
    """ζ of a joint, less where its acceleration limit keeps it from reversing in one step anyhow.

    And its velocity before the step.
    """
    fastest, hardest, before = math.inf, math.inf, 0.0
    for index in range(len(g.types)):
        if g.types[index] == MOTION:
            fastest = min(fastest, g.limits[index, dof, 4])
            hardest = min(hardest, g.limits[index, dof, 5])
            before = g.limits[index, dof, 6]
    if fastest == math.inf:
        return 0.0, before
    return INERTIA * min(1.0, 0.5 * hardest * dt / fastest), before


@plain
def _lagging(g, dof_count, before, passed_over, dt):
    """``control.posed.Inertia.lagging``; ``before`` is ψ of the last step."""
    kept = 0.0
    for k in range(dof_count):
        kept = max(kept, _inert_share(g, k, dt)[0])
    return passed_over + kept * max(0.0, before - passed_over)


@plain
def _missed(w, e):
    """How much of the task is not met, from 0 to 1; A q̇ of the rotated rows is left in slope."""
    short, asked = 0.0, 0.0
    for i in range(len(e.goal)):
        e.slope[i] = 0.0
        for k in range(len(w.x)):
            e.slope[i] += e.rows[i, k] * w.x[k]
        short += (e.slope[i] - e.goal[i]) ** 2
        asked += e.goal[i] * e.goal[i]
    asked = math.sqrt(asked)
    none = NOTICEABLE * (e.numbers[SIZE] + asked)
    missed = max(0.0, math.sqrt(short) - none) / max(asked, none) if none > 0.0 else 0.0
    return min(1.0, missed / MISSED)


@plain
def _keep_rows(e, p, n, relaxed):
    """Write the rows of ``control.edge_step._with_inertia``; their slacks are free."""
    u = len(p.x) - 1
    for i in range(len(p.b)):
        kept = (1.0 - e.weakness[i]) * (1.0 - relaxed)
        for k in range(n):
            p.A[i, k] = kept * e.rows[i, k]
        for j in range(u - n):
            p.A[i, n + j] = (kept - 1.0) * LOOSE * math.sqrt(e.floor[i]) if i == j else 0.0
        p.A[i, u], p.b[i] = -kept * e.slope[i], 0.0
    for j in range(u - n):
        p.lower[n + j], p.upper[n + j] = -math.inf, math.inf


@plain
def _price_rows(e, p, n, relaxed, largest):
    """The same with the slacks eliminated: what the rows miss is a cost of the joints and u."""
    for i in range(len(e.goal)):
        kept = (1.0 - e.weakness[i]) * (1.0 - relaxed)
        price = largest / e.floor[i] * (kept / ((1.0 - kept) * LOOSE)) ** 2
        for k in range(n):
            along = price * e.rows[i, k]
            for j in range(n):
                p.dense[k, j] += along * e.rows[i, j]
            p.dense[k, n] -= along * e.slope[i]
            p.dense[n, k] -= along * e.slope[i]
        p.dense[n, n] += price * e.slope[i] * e.slope[i]


@plain
def _begin_with_bare(e, p):
    """Let a program with one unknown more than e.bare begin with the constraints active there."""
    n, k = len(e.bare.x), len(e.bare.g)
    p.active_count[0] = e.bare.active_count[0]
    for i in range(p.active_count[0]):
        p.active[i] = e.bare.active[i] + (1 if e.bare.active[i] >= k + n else 0)


@plain
def _posed_with_inertia(e, relaxed):
    """Where the step with inertia is posed, by ψ."""
    if relaxed == 1.0:
        return e.bare  # nothing of the task is kept
    if relaxed >= YIELDING:
        return e.loose
    if relaxed == 0.0 and e.numbers[DEGRADED] == 0.0:
        return e.slim  # all of it
    return e.program


@plain
def _solved_with_inertia(w, e, p, relaxed, scale, speed, largest, tolerances):
    """Solve the program p, whose cost in the joints is written; ``speed`` is ‖q̇*‖² in H."""
    n, u = len(w.x), len(p.x) - 1
    if relaxed == 1.0:
        return _solved_in_joints(p, tolerances)
    p.dense[u, u] = WORTH_CURVED * speed if speed > 0.0 else 1.0
    p.c[u] = -p.dense[u, u]
    p.lower[u], p.upper[u] = max(0.0, 1.0 - (1.0 - scale) / MISSED), 1.0
    if relaxed >= YIELDING:
        _price_rows(e, p, n, relaxed, largest)
        _begin_with_bare(e, p)
        return _solved_in_joints(p, tolerances)
    _keep_rows(e, p, n, relaxed)
    return _solved(w, e, p, tolerances)


@plain
def _with_inertia(g, w, e, outcome, before, relaxed, largest, dt, tolerances):
    """``control.edge_step._with_inertia`` of the step in w. Returns as that.

    ``relaxed`` is ψ of this step, ``before`` of the last one.
    """
    missed = _missed(w, e)
    e.numbers[PASSED] = 0.0
    if missed == 0.0:
        return outcome
    n, speed = len(w.x), 0.0
    e.numbers[PASSED] = relaxed = _lagging(g, n, before, relaxed, dt)
    p = _posed_with_inertia(e, relaxed)
    scale = w.sensitivity[0] / w.braking[0] if outcome == SCALED else 1.0
    for k in range(n):
        share, velocity = _inert_share(g, k, dt)
        e.motion[k] = w.x[k] + missed * share * (velocity - w.x[k])
    _begin_program(w, e, p, largest, 1.0)
    for i in range(n):
        for j in range(n):
            p.c[i] -= e.cost[i, j] * e.motion[j]
            speed += w.x[i] * e.cost[i, j] * w.x[j]
    if _solved_with_inertia(w, e, p, relaxed, scale, speed, largest, tolerances) != DONE:
        return REFUSED
    for k in range(n):
        w.x[k] = p.x[k]
    if outcome == SCALED:
        slower = p.x[len(p.x) - 1]
        w.sensitivity[0] *= slower
        for i in range(len(w.b)):
            w.b[i] *= slower
    return outcome


@plain
def edge_step(g, w, e, qpos, dt, use_secondary, twist_space, is_infeasible):
    """Compute the step that ``step_kernel.step`` found at the edge or infeasible.

    Args:
        g: Inputs of the step.
        w: Its program, which receives the result.
        e: ``edge_rows.EdgeArrays``; ``numbers[PASSED]`` is ψ of the last step, and then of this.
        qpos: q, (nq,).
        dt: Length of the step, s.
        use_secondary: Whether the secondary acts.
        twist_space: ``None`` for the joint-space cost.
        is_infeasible: Whether it was found infeasible with regular rows: it is not solved again.

    Returns:
        ``DONE``, ``BRAKED``, ``FADED``, ``SCALED`` or ``RELAXED``, verified; ``REFUSED`` if the
        reference has to compute the step.
    """
    mode, tolerances = g.settings.infeasible, g.tolerances
    stated_rows(g, dt, w.A, w.b, w.free)
    for i in range(len(w.b)):
        e.stated[i] = w.b[i]
    w.braking[0], w.braking[1] = 1.0, 0.0
    desired_velocities(
        qpos, g.addresses, g.middle, g.stiffness, g.displacement, dt, use_secondary, w.q, w.c
    )
    if not _weaken_and_brake(g, w, e, dt, g.settings.trusts > 0.0):
        return REFUSED
    _note_fading(w, e)
    speed = _shorten(w, e, dt, g.settings.singularity)
    e.numbers[REACH] += speed
    if twist_space is not None and e.numbers[SMALLEST] < g.settings.singularity:
        return REFUSED
    if not costs(w, g.metric, g.quadratic, g.linear, g.settings, twist_space):
        return REFUSED
    joint_cost(w, e)
    largest = largest_cost(w)
    before, e.numbers[PASSED] = e.numbers[PASSED], 0.0
    # The programs of a step begin with the active constraints of those before, not of other steps.
    e.program.active_count[0] = e.slim.active_count[0] = e.bare.active_count[0] = 0
    if len(_program(e).x) == len(e.slim.x) and not find_null_space(w, e):
        return REFUSED
    e.numbers[ROOM] = 0.0
    outcome = _without_inertia(g, w, e, is_infeasible, largest, dt, tolerances)
    relaxed = e.numbers[PASSED]
    if outcome in (DONE, BRAKED, REFUSED) or not g.settings.inertia > 0.0:
        e.numbers[PASSED] = 0.0
    else:
        if mode == RELAX or (outcome == RELAXED and relaxed == 0.0):
            relaxed = 1.0
        outcome = _with_inertia(g, w, e, outcome, before, relaxed, largest, dt, tolerances)
    if e.numbers[ROOM] > 0.0 and not clip_to_bounds(w.x, w.lower, w.upper):
        return REFUSED
    return outcome

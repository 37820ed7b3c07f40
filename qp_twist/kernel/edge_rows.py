"""The task rows at the edge of the reach and near singularities, compiled.

The readable version, with the formulas, is ``qp.edge``. Here the rows are rotated to UᵀA instead,
whose rows are orthogonal: no formula divides by a singular value then.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from qp_twist.kernel.bounds import MOTION, bounds, stopping_speed
from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.null_space import ROUNDING, SWEEPS, jacobi_rotation
from qp_twist.kernel.record import Floats, RecordType, reader
from qp_twist.kernel.step_record import PROGRAM, Program, Sizes

REGULAR, MOST_REGULAR = 0.05, 50.0
"""σ₁, m/rad or 1, from which on a direction is met as stated; in units of ε if that is less."""
BEND = 0.6
"""ℓ as a share of the largest singular value."""
SMOOTHED = 0.005
"""T, s: time within which the share σ²/σ₁² of a small error is removed."""
BRAKING = 0.8
"""η of ``constraints.stopping_share``."""
SPREAD = 20.0
"""Steps that the distance to a position limit is spread over where the task stops."""
HALF, WHOLE = 0.5, 0.95
"""Shares of the bounds of a longer step, and of this one, that weak directions take up."""
SHORTENED = 2.0
"""Multiple of ε below which the secondary is shortened."""
_RANK = 1e-12


class EdgeArrays(NamedTuple):
    """The rotated rows UᵀA q̇ = Uᵀb of a step, and its program with slacks and the scale.

    Sizes are those of the program: nv is the step's n, and then a slack z for each row, and u.
    """

    stated: Annotated[Floats, "m"]
    """b as stated."""
    numbers: Annotated[Floats, 9]
    """See the constants below."""
    rows: Annotated[Floats, "m", "nv - m - 1"]
    """UᵀA, rows σᵢvᵢᵀ, orthogonal."""
    rate: Annotated[Floats, "m"]
    """Uᵀb as stated, m/s and rad/s."""
    forward: Annotated[Floats, "m"]
    """The part of it that follows moving targets."""
    ahead: Annotated[Floats, "m"]
    """The part of it that follows moving targets."""
    goal: Annotated[Floats, "m"]
    """Uᵀb, braked."""
    square: Annotated[Floats, "m"]
    """σ²."""
    floor: Annotated[Floats, "m"]
    """max(σ², ε²)."""
    weak: Annotated[Floats, "m"]
    """w(σ²)."""
    damped: Annotated[Floats, "m"]
    """d = max(max(σ², ε²) + ℓ r_l, t)."""
    met: Annotated[Floats, "m"]
    """max(σ², ε²)/d."""
    weakness: Annotated[Floats, "m"]
    """φ = 1 − σ²/d."""
    missing: Annotated[Floats, "m"]
    """(ε² − σ²)₊^½, what a slack gets of a row."""
    at_rest: Annotated[Floats, "m"]
    """Right-hand side at s = 0: what weak directions are asked for at any scale."""
    slope: Annotated[Floats, "m"]
    """Its derivative by s."""
    motion: Annotated[Floats, "nv - m - 1"]
    lower: Annotated[Floats, "nv - m - 1"]
    """Bounds that approach position limits more slowly."""
    upper: Annotated[Floats, "nv - m - 1"]
    kinds: Annotated[Floats, 2, "nv - m - 1"]
    scaled: Annotated[Floats, "nv - m - 1"]
    """q̇ of the scaled step, while the relaxed one is computed."""
    sensitivity: Annotated[Floats, "nv + k"]
    null_basis: Annotated[Floats, "max(nv - 2 * m - 1, 0)", "nv - m - 1"]
    """Orthonormal basis of the rows' null space, if there are no slacks: see ``paced_program``."""
    project: Annotated[Floats, "nv - m - 1", "nv - m - 1"]
    cost: Annotated[Floats, "nv - m - 1", "nv - m - 1"]
    """H."""
    scratch: Annotated[Floats, "nv - m - 1"]
    start: Annotated[Floats, "nv - m - 1"]
    """q̇ of the levels above, and which bounds they hold: see ``edge_levels``."""
    fixed: Annotated[Floats, "nv - m - 1"]
    program: Program
    slim: Annotated[Program, {"nv": "nv - m", "dense": "nv - m"}]
    """Without slacks."""
    bare: Annotated[Program, {"nv": "nv - m - 1", "dense": "nv - m - 1", "m": "0"}]
    """In the joints alone, without rows."""
    loose: Annotated[Program, {"nv": "nv - m", "dense": "nv - m", "m": "0"}]
    """In the joints and the scale, without rows."""


SIZE, SMALLEST, FAR, DEGRADED, FITTING, REACH, FADES, PASSED, ROOM = range(9)
"""Places in ``numbers``: σ_max, σ_min, t_e, the largest φ, θ, the bound of the slacks, whether a
direction is asked for less than b, ψ, the share of a relaxed step, and by how much programs may
exceed a limit."""

EDGE = RecordType(EdgeArrays, Sizes, PROGRAM)
read_edge = reader(EDGE)


@plain
def _squares(A, square):
    """Write the squared lengths of rows, and return their sum."""
    whole = 0.0
    for i in range(len(A)):
        total = 0.0
        for k in range(A.shape[1]):
            total += A[i, k] * A[i, k]
        square[i] = total
        whole += total
    return whole


@plain
def rotate(A, rate, forward, square):
    """Rotate rows (m, n), and with them two columns (m,), until the rows are orthogonal.

    One-sided Jacobi: Hestenes, J. SIAM 6 (1958). ``square`` receives σ².
    """
    m, n = A.shape
    turned, sweeps = True, 0
    while turned and sweeps < SWEEPS:
        turned, sweeps = False, sweeps + 1
        whole = _squares(A, square)
        for i in range(m):
            for j in range(i):
                both = 0.0
                for k in range(n):
                    both += A[i, k] * A[j, k]
                first, second = square[i], square[j]
                if abs(both) <= ROUNDING * max(math.sqrt(first * second), ROUNDING * whole):
                    continue
                turned = True
                cos, sin = jacobi_rotation(first, second, both)
                # What one row loses in length the other one gains; rounding is left for a sweep.
                moved = both * sin / cos
                square[i], square[j] = max(first - moved, 0.0), second + moved
                for k in range(n):
                    a, b = A[i, k], A[j, k]
                    A[i, k], A[j, k] = cos * a - sin * b, sin * a + cos * b
                a, b = rate[i], rate[j]
                rate[i], rate[j] = cos * a - sin * b, sin * a + cos * b
                a, b = forward[i], forward[j]
                forward[i], forward[j] = cos * a - sin * b, sin * a + cos * b
    _squares(A, square)


@plain
def rotate_rows(e):
    """Rotate all rows, ``rate`` and ``forward``; set σ_max and σ_min."""
    rotate(e.rows, e.rate, e.forward, e.square)
    largest, smallest = 0.0, math.inf
    for i in range(len(e.square)):
        largest, smallest = max(largest, e.square[i]), min(smallest, e.square[i])
    e.numbers[SIZE], e.numbers[SMALLEST] = math.sqrt(largest), math.sqrt(smallest)


@part
def regular_from(singularity):
    """σ₁: singular value from which on a direction is met as stated, m/rad or 1."""
    return max(2.0 * singularity, min(REGULAR, MOST_REGULAR * singularity))


@plain
def weaken(e, singularity):
    """Set what depends on the singular values alone: floor, w and the slacks' share."""
    first = regular_from(singularity)
    for i in range(len(e.square)):
        square = e.square[i]
        e.floor[i] = max(square, singularity * singularity)
        e.weak[i] = max(0.0, 1.0 - square / (first * first)) ** 3
        e.missing[i] = math.sqrt(max(0.0, singularity * singularity - square))


@plain
def damp(e, singularity, dt, trusts, share):
    """Set t_e, d, φ and what is met, for the error of ``rate`` less ``share`` of ``forward``."""
    total, worst, first = 0.0, 0.0, regular_from(singularity)
    for i in range(len(e.rate)):
        weak = e.weak[i] * (e.rate[i] - share * e.forward[i])
        total += weak * weak
    far = BEND * e.numbers[SIZE] * dt * math.sqrt(total) if trusts else 0.0
    damping = max(first * first * min(1.0, SMOOTHED / dt), far) if trusts else 0.0
    smallest = e.numbers[SMALLEST]
    regular = smallest >= singularity and smallest * smallest >= damping
    left = 0.0
    for i in range(len(e.rate) if not regular else 0):
        if damping > e.floor[i]:
            missing = (1.0 - e.floor[i] / damping) * (e.rate[i] - share * e.forward[i])
            left += missing * missing
    bent = BEND * e.numbers[SIZE] * dt * math.sqrt(left)
    for i in range(len(e.rate)):
        e.damped[i] = e.floor[i] if regular else max(e.floor[i] + bent, damping)
        e.met[i] = e.floor[i] / e.damped[i]
        e.weakness[i] = 0.0 if regular else 1.0 - e.square[i] / max(e.floor[i], damping)
        worst = max(worst, e.weakness[i])
    e.numbers[FAR], e.numbers[DEGRADED] = far, worst


@plain
def stopping_share(motion, limits, types, dt):
    r"""Share s_b of a displacement from whose speed the joints can stop.

    The readable version is ``constraints.stopping_share``.

    Args:
        motion: The displacement, rad or m, (n,).
        limits: Tables of the limits, (L, n, 7).
        types: Their kinds, (L,).
        dt: Length of this step and of those to come, s.

    Returns:
        The share; and 1 + the joint whose limit decides, negative where it moves down.
    """
    least, which = math.inf, 0
    for index in range(len(types)):
        if types[index] != MOTION:
            continue
        for dof in range(len(motion)):
            length = abs(motion[dof])
            if length > 0.0 and limits[index, dof, 5] / length < least:
                least = limits[index, dof, 5] / length
                which = 1 + dof if motion[dof] > 0.0 else -1 - dof
    if least == math.inf:
        return 1.0, 0
    share = dt * stopping_speed(1.0, BRAKING * least, dt)
    return (share, which) if share < 1.0 else (1.0, 0)


@plain
def task_motion(e, by_weakness, motion):
    """Aᵀ D⁻¹ of the goal, (n,): of all of it, or of its weak part φ."""
    for k in range(len(motion)):
        motion[k] = 0.0
    for i in range(len(e.goal)):
        gain = e.met[i] * e.goal[i] / e.floor[i]
        if by_weakness:
            gain *= e.weakness[i]
        for k in range(len(motion)):
            motion[k] += gain * e.rows[i, k]


@plain
def lengthen(g, w, e, dt, steps):
    """The bounds of a step ``steps`` times as long; return whether there are any."""
    return bounds(
        g.limits, g.types, w.q, steps * dt, g.settings.noticeable, g.settings.unlimited, e.lower,
        e.upper, e.kinds[0], e.kinds[1],
    )  # fmt: skip


@plain
def ease(g, w, e, p, dt, steps):
    """Bounds of this step that also hold for one ``steps`` times as long; false if there are none.

    A joint then approaches its position limit over several steps, as all do what must not touch:
    g of the program p is eased, too.
    """
    if not lengthen(g, w, e, dt, steps):
        return False
    for i in range(len(w.q)):
        lower = min(max(w.lower[i], e.lower[i]), w.upper[i])
        upper = max(min(w.upper[i], e.upper[i]), w.lower[i])
        e.lower[i], e.upper[i] = lower, max(lower, upper)
    for row in range(len(w.g)):
        p.g[row] = w.g[row] - g.rooms[row] * (1.0 - 1.0 / steps)
    return True


@plain
def fit(w, e):
    """θ: weak directions take up half of a longer step's bounds, and fit into those of this one."""
    task_motion(e, True, e.motion)
    share = 1.0
    for k in range(len(e.motion)):
        x = e.motion[k]
        room = min(HALF * e.upper[k], WHOLE * w.upper[k])
        if x < 0.0:
            room = min(-HALF * e.lower[k], -WHOLE * w.lower[k])
        if abs(x) > 0.0:
            share = min(share, max(0.0, room) / abs(x))
    e.numbers[FITTING] = share


@plain
def ask(e, singularity):
    """Set the right-hand side at rest and its slope, and the bound of the slacks."""
    reach = 0.0
    for i in range(len(e.goal)):
        whole = e.met[i] * e.goal[i]
        e.at_rest[i] = e.numbers[FITTING] * e.weakness[i] * whole
        e.slope[i] = (1.0 - e.weakness[i]) * whole
        if e.missing[i] > 0.0:
            reach += whole * whole
    e.numbers[REACH] = math.sqrt(reach) / singularity


@plain
def longest_secondary(e, singularity):
    """As ``qp.edge.longest_secondary``."""
    weakest, size = math.inf, e.numbers[SIZE]
    for i in range(len(e.square)):
        sigma = math.sqrt(e.square[i])
        if sigma > _RANK * size:
            weakest = min(weakest, sigma)
    if weakest == math.inf:
        return math.inf
    near = 1.0 - (weakest / (SHORTENED * singularity)) ** 2
    return max(weakest, singularity) / (size * near) if near > 0.0 else math.inf

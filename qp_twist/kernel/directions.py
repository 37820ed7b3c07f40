"""A level's rows in their singular directions, compiled.

The readable version, with the formulas, is ``qp.directions``. Here the rows are rotated by Jacobi's
method until they are orthogonal, so that no formula divides by a singular value.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from qp_twist.kernel.bounds import MOTION, stopping_speed
from qp_twist.kernel.compiling import inner, part, plain
from qp_twist.kernel.constants import BEND, BRAKING, DEPENDENT, MOST_REGULAR, REGULAR, SMOOTHED
from qp_twist.kernel.copying import put_rows
from qp_twist.kernel.dual_active_set import cholesky

_SWEEPS = 60
"""Limit of the sweeps; ten are enough in practice."""
_ROUNDING = 1e-15
"""Cosine of the angle below which rows count as orthogonal; share below which a row is zero."""


Directions = namedtuple("Directions", "rows rate ahead square floor damped slack stated")
"""The rotated rows UᵀA q̇ = Uᵀb of a level of m rows.

``rows`` are σᵢvᵢᵀ, (m, n), ``rate`` is β = Uᵀb, (m,), and ``ahead`` the part of it that follows
moving targets; ``square`` is σ², ``floor`` max(σ², ε²), ``damped`` d, and ``slack`` λ = d − σ².
``stated`` is Uᵀ(A b) of the rows as they are stated, (m, n + 1); (m, 0) where nobody needs them.
"""


@part
def regular_from(singularity):
    """σ₁: singular value from which on a direction is met as stated, m/rad or 1."""
    return max(2.0 * singularity, min(REGULAR, MOST_REGULAR * singularity))


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
def rotate(A, along, square):
    """Rotate rows (m, n), and with them other rows (m, p), until those of A are orthogonal.

    One-sided Jacobi: Hestenes, J. SIAM 6 (1958). ``square`` receives σ².
    """
    m, n = A.shape
    turned, sweeps = True, 0
    while turned and sweeps < _SWEEPS:
        turned, sweeps = False, sweeps + 1
        whole = _squares(A, square)
        for i in range(m):
            for j in range(i):
                both = 0.0
                for k in range(n):
                    both += A[i, k] * A[j, k]
                first, second = square[i], square[j]
                if abs(both) <= _ROUNDING * max(math.sqrt(first * second), _ROUNDING * whole):
                    continue
                turned = True
                zeta = (second - first) / (2.0 * both)
                tan = (1.0 if zeta > 0.0 else -1.0) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                cos = 1.0 / math.sqrt(1.0 + tan * tan)
                sin = cos * tan
                # What one row loses in length the other one gains; rounding is left for a sweep.
                moved = both * tan
                square[i], square[j] = max(first - moved, 0.0), second + moved
                for k in range(n):
                    a, b = A[i, k], A[j, k]
                    A[i, k], A[j, k] = cos * a - sin * b, sin * a + cos * b
                for k in range(along.shape[1]):
                    a, b = along[i, k], along[j, k]
                    along[i, k], along[j, k] = cos * a - sin * b, sin * a + cos * b
    _squares(A, square)


@inner
def directions(A, b, ahead, stated, size, dt, singularity, damp):
    """The directions of rows A q̇ = b, (m, n), on what the levels above leave.

    ``ahead`` (m,) is the part of b that follows moving targets, ``stated`` (m, p) other rows to
    rotate, those as stated; ``size`` is the largest singular value of these, that of A if it is 0;
    ``damp``: whether t counts.
    """
    m = len(b)
    rows, along, square = A.copy(), np.empty((m, 2 + stated.shape[1])), np.empty(m)
    for i in range(m):
        along[i, 0], along[i, 1] = b[i], ahead[i]
    put_rows(stated, along[:, 2:])
    rotate(rows, along, square)
    d = Directions(
        rows, along[:, 0].copy(), along[:, 1].copy(), square, np.zeros(m), np.zeros(m),
        np.zeros(m), along[:, 2:].copy(),
    )  # fmt: skip
    largest, smallest, far, first = size * size, math.inf, 0.0, regular_from(singularity)
    for i in range(m):
        largest = max(largest, d.square[i])
    for i in range(m):
        if d.square[i] <= DEPENDENT * DEPENDENT * largest:  # rounding
            d.square[i] = 0.0
            for k in range(d.rows.shape[1]):
                d.rows[i, k] = 0.0
        square = d.square[i]
        smallest = min(smallest, square)
        weak = max(0.0, 1.0 - square / (first * first)) ** 3 * d.rate[i] if first > 0.0 else 0.0
        far += weak * weak
    t = 0.0
    if damp:
        bend = BEND * math.sqrt(largest)
        t = max(first * first * min(1.0, SMOOTHED / dt), bend * dt * math.sqrt(far))
    least = max(singularity * singularity, DEPENDENT * DEPENDENT * largest)
    regular = smallest >= (first * first if damp else singularity * singularity)
    for i in range(m):
        d.floor[i] = max(d.square[i], least)
        d.damped[i] = d.floor[i] if regular else max(d.floor[i], t)
        d.slack[i] = max(d.damped[i] - d.square[i], 0.0)
    return d


@part
def weakness(d, i):
    """φ of a direction."""
    return d.slack[i] / d.damped[i] if d.damped[i] > 0.0 else 0.0


@plain
def motion_of(d, ahead, motion):
    """Σ vᵢ σᵢ βᵢ/dᵢ, (n,), of β less a share ``ahead`` of what follows moving targets."""
    for k in range(len(motion)):
        motion[k] = 0.0
    for i in range(len(d.rate)):
        if d.damped[i] > 0.0:
            gain = (d.rate[i] - ahead * d.ahead[i]) / d.damped[i]
            for k in range(len(motion)):
                motion[k] += gain * d.rows[i, k]


@plain
def free_of(d, c):
    """Replace a linear cost (n,) by N c, N = 1 − Σ σᵢ²vᵢvᵢᵀ/max(σᵢ², ε²)."""
    for i in range(len(d.rate)):
        along = 0.0
        for k in range(d.rows.shape[1]):
            along += d.rows[i, k] * c[k]
        if d.floor[i] > 0.0:
            for k in range(d.rows.shape[1]):
                c[k] -= along / d.floor[i] * d.rows[i, k]


@plain
def stopping_share(motion, limits, types, dt):
    """Share of a displacement from whose speed the joints can stop: ``constraints.stopping_share``.

    ``limits`` are their tables, (L, n, 7). Returned are the share, and 1 + the joint whose limit
    decides, negative where it moves down.
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
def well_conditioned(A, ends, threshold, work, scratch):
    """Return whether no singular value of a level's rows is below a threshold.

    Each level's rows are first projected to the null space of the levels above. With AAᵀ = LLᵀ, the
    Gram matrix of a level's projected rows is that of its own diagonal block of L.
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
    if not cholesky(work, m):
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
        if not cholesky(scratch, end - first):
            return False
        first = end
    return True

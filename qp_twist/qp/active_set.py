"""Linear least squares under inequality rows, by a primal active-set method."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array

RANK_TOLERANCE = 1e-10
"""Singular values below this share of a level's largest count as zero."""
_STILL = 1e-13
"""A step shorter than this share of the point counts as zero."""
_SIGN_TOLERANCE = 1e-11
"""Multipliers above minus this share of the gradient count as non-negative."""
_LOST = 4e-16
"""Rounding error of a residual, as a share of the sum of its terms' magnitudes."""


class ActiveSetResult(NamedTuple):
    """Result of :func:`constrained_least_squares`."""

    z: Array
    """The minimiser, (p,)."""
    multipliers: Array
    """Non-negative multiplier of each row of C, (m,)."""
    optimal: bool
    """Whether the optimality conditions hold; otherwise z is only feasible and no worse."""
    working: tuple[int, ...]
    """Active rows of C at z; they are independent."""


def constrained_least_squares(
    B: Array, r: Array, C: Array, d: Array, z: Array, *, smallest: float
) -> ActiveSetResult:
    r"""min ½‖B z − r‖²  subject to  C z ≤ d,  from a feasible point.

    Each iteration takes the shortest step to the minimum on the working set. It stops at the first
    blocking row and adds it, or, at the minimum, drops the row with the most negative multiplier
    (Nocedal and Wright, *Numerical Optimization*, algorithm 16.3). B may have any rank, since the
    step is the minimum-norm one. The iterates stay feasible and the cost never increases, so that
    rounding cannot make the problem infeasible; Bland's rule prevents cycles.

    Args:
        B: Rows, (m, p).
        r: Right-hand side, (m,).
        C: Inequality rows, (k, p), of length about one.
        d: Their bounds, (k,).
        z: A point with C z ≤ d, (p,).
        smallest: Singular values of B below this count as zero.
    """
    z = z.copy()
    working: list[int] = []
    basis = np.eye(len(z))
    inverse = _inverse(B, smallest)
    free = np.ones(len(d), dtype=bool)
    degenerate = arrived = 0
    multipliers = np.zeros(len(d))
    dropped, retained, best = -1, list[int](), np.inf
    residual, sizes = r - B @ z, np.abs(B)
    for _ in range(50 + 20 * (len(d) + len(z))):
        step = inverse @ residual
        # A second full step only refines the first; if B is ill-conditioned its length is
        # rounding error and never becomes small enough.
        if arrived > 1 or _length(step) <= _STILL * (1.0 + _length(z)):
            if not working:
                return ActiveSetResult(z, multipliers, True, ())
            gradient = B.T @ residual
            values = np.linalg.lstsq(C[working].T, gradient, rcond=None)[0]
            negative = values < -_SIGN_TOLERANCE * (1.0 + np.abs(gradient).max())
            wrong = np.flatnonzero(negative & ~np.isin(working, retained))
            if not len(wrong):
                multipliers[working] = np.maximum(values, 0.0)
                return ActiveSetResult(z, multipliers, True, tuple(working))
            # Most negative multiplier for speed; lowest index (Bland) to prevent cycles.
            drop = (
                min(wrong, key=lambda i: working[i])
                if degenerate > len(z)
                else wrong[np.argmin(values[wrong])]
            )
            dropped = working.pop(int(drop))
            free[dropped] = True
            arrived = 0
            basis = _complement(C[working], len(z))
            inverse = basis @ _inverse(B @ basis, smallest)
            continue
        length, blocking = _longest(C, d, z, step, free)
        degenerate = degenerate + 1 if length == 0.0 else 0
        z += length * step
        arrived += 1
        # After a row is dropped, the step must leave it and reduce the cost. If it does not, the
        # negative multiplier was rounding error: keep the row until there is progress.
        residual = r - B @ z
        now = _length(residual)
        if now < best - _LOST * _length(sizes @ np.abs(z) + np.abs(r)):
            best = now
            retained.clear()
        elif dropped >= 0 and (length > 0.0 or blocking == dropped):
            retained.append(dropped)
            dropped = -1
        if blocking is not None:
            arrived = 0
            working.append(blocking)
            free[blocking] = False
            basis = _without(basis, C[blocking])
            inverse = basis @ _inverse(B @ basis, smallest)
    return ActiveSetResult(z, multipliers, False, tuple(working))


def null_basis(rows: Array, n: int, *, tolerance: float = RANK_TOLERANCE) -> Array:
    """Orthonormal basis of the null space of ``rows`` (m, n), (n, p); rows of length about one."""
    if not len(rows):
        return np.eye(n)
    _, sigma, right = np.linalg.svd(rows)
    basis: Array = right[int((sigma > tolerance).sum()) :].T
    return basis


def clear_cut(rows: Array) -> bool:
    """Whether no singular value of the rows is within a factor of 10 of the rank's threshold."""
    sigma = np.linalg.svd(rows, compute_uv=False)
    close = (sigma > 0.1 * RANK_TOLERANCE) & (sigma < 10.0 * RANK_TOLERANCE)
    return not close.any()


def _complement(rows: Array, n: int) -> Array:
    """As :func:`null_basis`, faster, for independent rows such as those of a working set."""
    if not len(rows):
        return np.eye(n)
    complement: Array = np.linalg.qr(rows.T, mode="complete")[0][:, len(rows) :]
    return complement


def _without(basis: Array, row: Array) -> Array:
    """Basis of the part of span(``basis``), (n, p), orthogonal to ``row`` (n,): (n, p − 1).

    A Householder reflection maps the row's components to the first column, which is dropped.
    """
    u = row @ basis
    u[0] += math.copysign(math.sqrt(u @ u), u[0])
    reflected: Array = basis[:, 1:] - np.outer(basis @ u, (2.0 / (u @ u)) * u[1:])
    return reflected


def _inverse(B: Array, smallest: float) -> Array:
    """The pseudoinverse: its product with r is the shortest least-squares solution of B y = r."""
    left, sigma, right = np.linalg.svd(B, full_matrices=False)
    keep = sigma > smallest
    inverse: Array = right[keep].T @ (left[:, keep] / sigma[keep]).T
    return inverse


def _longest(
    C: Array, d: Array, z: Array, step: Array, free: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> tuple[float, int | None]:
    """Share of ``step`` that C z ≤ d allows, at most 1, and the blocking row."""
    speed = C @ step
    slack = np.maximum(d - C @ z, 0.0)
    # Comparing slack with speed first avoids the division for most rows.
    ahead = np.flatnonzero(free & (speed > _STILL * _length(step)) & (slack < speed))
    if not len(ahead):
        return 1.0, None
    share = slack[ahead] / speed[ahead]
    first = int(share.argmin())
    return float(share[first]), int(ahead[first])


def _length(vector: Array) -> float:
    return math.sqrt(vector @ vector)

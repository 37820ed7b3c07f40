"""The squared speed along a curve, as large as limits permit, compiled.

A curve q(ξ) is divided into cells. ``curve`` (C, 2, 3, nv) has q′, q″ and q‴ at the begin and the
end of each, ``h`` (C,) the lengths of the cells. With y = ξ̇² the joints have

    q̈ = ½ q′ y′ + q″ y,    q⃛ = √y (½ q′ y″ + (3/2) q″ y′ + q‴ y).
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import kernel, part, plain

_ROUNDING = 1e-12
"""Share by which the two ends of an interval may change places by rounding."""
_DECREASE, _SHRINK = 0.1, 0.5
"""Of a line search: share of the expected decrease that is required, factor of the steps."""
_SHORTEST = 1e-9
"""Step, as a share of Newton's, below which the line search ends."""
_CENTERED = 0.1
"""Newton's decrement, squared, at which the weight of the barrier is reduced."""
_REDUCTION = 0.1
"""Factor of the weight of the barrier."""
_STEPS = 400
"""Largest number of Newton steps."""


@part
def _interval(curve, h, most, i, y, highest):
    """Ends of the interval of ½ y′ in cell i, from y to at most ``highest``, and their change."""
    low, high, by_low, by_high = -y / (2.0 * h), (highest - y) / (2.0 * h), 0.0, 0.0
    by_low = by_high = -0.5 / h
    for end in range(2):
        for j in range(len(most)):
            if math.isinf(most[j]):
                continue
            A, B = curve[i, end, 0, j], curve[i, end, 1, j]
            if end == 1:
                A += 2.0 * h * B
            if A < 0.0:
                A, B = -A, -B
            if A * high - B * y <= most[j] and A * low - B * y >= -most[j] and B == 0.0:
                continue
            if A == 0.0:
                continue
            upper, lower = (most[j] - B * y) / A, (-most[j] - B * y) / A
            if upper < high:
                high, by_high = upper, -B / A
            if lower > low:
                low, by_low = lower, -B / A
    return low, high, by_low, by_high


@kernel
def reachable(curve, h, most, cap):
    """Largest y at the ends of the cells for acceleration limits, y linear in each, (C + 1,).

    Limits hold at both ends of each cell. As in reachability analysis (Pham and Pham 2018) a pass
    backwards computes from which y the rest of the path can be followed; these are intervals from 0
    on. A pass forwards takes the largest y that it can. It begins and ends at rest.

    Args:
        curve: q′, q″ (and q‴, which are not used), (C, 2, 3, nv).
        h: Lengths of the cells, (C,).
        most: Acceleration limits, (nv,); ∞ without one.
        cap: Largest y at the ends of the cells, (C + 1,).
    """
    cells = len(h)
    y = cap.copy()
    y[0] = y[cells] = 0.0
    for i in range(cells - 1, -1, -1):
        largest = y[i]
        for end in range(2):
            for j in range(len(most)):
                A, B = curve[i, end, 0, j], curve[i, end, 1, j]
                if end == 1:
                    A += 2.0 * h[i] * B
                if A == 0.0 and B != 0.0:
                    largest = min(largest, most[j] / abs(B))
        # The length of the interval is concave in y, and not negative at 0.
        while True:
            low, high, by_low, by_high = _interval(curve, h[i], most, i, largest, y[i + 1])
            if high - low >= -_ROUNDING * (abs(high) + abs(low)) or by_high >= by_low:
                break
            less = largest - (high - low) / (by_high - by_low)
            if less >= largest or less <= 0.0:
                largest = max(min(less, largest), 0.0)
                break
            largest = less
        y[i] = largest
    for i in range(cells):
        low, high, _, _ = _interval(curve, h[i], most, i, y[i], y[i + 1])
        y[i + 1] = min(y[i + 1], max(y[i] + 2.0 * h[i] * high, 0.0))
    return y


@part
def _cell(c, h, i):
    """Shares of the coefficients i and i + 2 in the first and last Bernstein coefficient of y."""
    last = len(h) - 1
    first_share = 1.0 if i == 0 else h[i] / (h[i - 1] + h[i])
    last_share = 1.0 if i == last else h[i] / (h[i] + h[i + 1])
    return (
        first_share * c[i] + (1.0 - first_share) * c[i + 1],
        (1.0 - last_share) * c[i + 1] + last_share * c[i + 2],
        first_share,
        last_share,
    )


@part
def _add(g, H, d0, d1, d2, by, twice):
    """Add by and twice, the derivatives of a function of d·B, to gradient and Hessian in B."""
    g[0] += by * d0
    g[1] += by * d1
    g[2] += by * d2
    H[0] += twice * d0 * d0
    H[1] += twice * d0 * d1
    H[2] += twice * d0 * d2
    H[3] += twice * d1 * d1
    H[4] += twice * d1 * d2
    H[5] += twice * d2 * d2


@part
def _spread(gradient, bands, g, H, f, t, i):
    """Add the derivatives with respect to a cell's Bernstein coefficients to those of all."""
    f1, t1 = 1.0 - f, 1.0 - t
    gradient[i] += f * g[0]
    gradient[i + 1] += f1 * g[0] + g[1] + t1 * g[2]
    gradient[i + 2] += t * g[2]
    bands[0, i] += f * f * H[0]
    bands[0, i + 1] += f1 * f1 * H[0] + 2.0 * f1 * H[1] + 2.0 * f1 * t1 * H[2]
    bands[0, i + 1] += H[3] + 2.0 * t1 * H[4] + t1 * t1 * H[5]
    bands[0, i + 2] += t * t * H[5]
    bands[1, i] += f * (f1 * H[0] + H[1] + t1 * H[2])
    bands[1, i + 1] += t * (f1 * H[2] + H[4] + t1 * H[5])
    bands[2, i] += f * t * H[2]


@part
def _of_joints(hard, jerky, shape, y, slope, second, g, H, derive):
    """Less the logarithms of what is left of the joints' limits at a place; ∞ beyond them.

    ``hard`` (2, nv) and ``jerky`` (3, nv) as of ``_barrier``, ``shape`` (9,) are the shares of the
    coefficients in y, y′ and y″.
    """
    root, product = 1.0 / math.sqrt(y), 1.0
    for j in range(hard.shape[1]):
        A, B = hard[0, j], hard[1, j]
        use = A * slope + B * y
        left = 1.0 - use * use
        A2, B2, C2 = jerky[0, j], jerky[1, j], jerky[2, j]
        jerk = A2 * second + B2 * slope + C2 * y
        above, below = root - jerk, root + jerk
        if not (left > 0.0 and above > 0.0 and below > 0.0):
            return math.inf
        product *= left * above * below * y
        if derive:
            by, twice = 2.0 * use / left, 2.0 * (1.0 + use * use) / (left * left)
            d0, d1 = A * shape[3] + B * shape[0], A * shape[4] + B * shape[1]
            _add(g, H, d0, d1, A * shape[5] + B * shape[2], by, twice)
            fall = -0.5 * root / y
            e0, e1, e2 = shape[0], shape[1], shape[2]
            d0 = A2 * shape[6] + B2 * shape[3] + C2 * e0
            d1 = A2 * shape[7] + B2 * shape[4] + C2 * e1
            d2 = A2 * shape[8] + B2 * shape[5] + C2 * e2
            for sign, room in ((-1.0, above), (1.0, below)):
                _add(
                    g, H, fall * e0 + sign * d0, fall * e1 + sign * d1, fall * e2 + sign * d2,
                    -1.0 / room, 1.0 / (room * room),
                )  # fmt: skip
            _add(g, H, e0, e1, e2, -1.0 / y, 0.0)
    return -math.log(product)


@plain
def _barrier(c, h, hard, jerky, cap, weight, derive, gradient, bands, g, H, shape):
    """The duration in weights of the barrier, less the logarithms of what is left of the limits.

    ∞ where a limit is not kept. With ``derive`` the gradient (C + 2,) and the Hessian's diagonals
    (3, C + 2) are written; the part of the Hessian that is not convex is left out.

    ``c`` (C + 2,) are the coefficients of y, a quadratic B-spline. At the begin, the middle and the
    end of each cell ``hard`` (C, 3, 2, nv) has q′/2 and q″ over the acceleration limits, ``jerky``
    (C, 3, 3, nv) q′/2, (3/2) q″ and q‴ over the jerk limits, ``cap`` (C, 3) the largest y. ``g``
    (3,), ``H`` (6,) and ``shape`` (9,) are overwritten.
    """
    total = 0.0
    if derive:
        gradient[:] = 0.0
        bands[:] = 0.0
    for i in range(len(h)):
        first, last, f, t = _cell(c, h, i)
        middle = c[i + 1]
        if not (first > 0.0 and middle > 0.0 and last > 0.0):
            return math.inf
        g[:] = 0.0
        H[:] = 0.0
        change = 2.0 / (h[i] * h[i])
        second = change * (first - 2.0 * middle + last)
        shape[6], shape[7], shape[8] = change, -2.0 * change, change
        for place in range(3):
            u = 0.5 * place
            shape[0], shape[1], shape[2] = (1.0 - u) * (1.0 - u), 2.0 * u * (1.0 - u), u * u
            shape[3] = -2.0 * (1.0 - u) / h[i]
            shape[4], shape[5] = 2.0 * (1.0 - 2.0 * u) / h[i], 2.0 * u / h[i]
            y = shape[0] * first + shape[1] * middle + shape[2] * last
            slope = shape[3] * first + shape[4] * middle + shape[5] * last
            # Simpson's rule of the duration.
            took = (4.0 if place == 1 else 1.0) * h[i] / (6.0 * weight * math.sqrt(y))
            by, twice = -0.5 * took / y, 0.75 * took / (y * y)
            total += took
            if not math.isinf(cap[i, place]):
                left = cap[i, place] - y
                if not left > 0.0:
                    return math.inf
                total -= math.log(left / cap[i, place])
                by, twice = by + 1.0 / left, twice + 1.0 / (left * left)
            if derive:
                _add(g, H, shape[0], shape[1], shape[2], by, twice)
            total += _of_joints(
                hard[i, place], jerky[i, place], shape, y, slope, second, g, H, derive
            )
        if math.isinf(total):
            return total
        if derive:
            _spread(gradient, bands, g, H, f, t, i)
    return total


@part
def _solve(bands, x):
    """Solve a positive definite system with two diagonals beside the main one, in place."""
    n = len(x)
    for i in range(n):
        pivot = bands[0, i]
        if i + 1 < n:
            ratio = bands[1, i] / pivot
            bands[0, i + 1] -= ratio * bands[1, i]
            x[i + 1] -= ratio * x[i]
            if i + 2 < n:
                bands[1, i + 1] -= ratio * bands[2, i]
                further = bands[2, i] / pivot
                bands[0, i + 2] -= further * bands[2, i]
                x[i + 2] -= further * x[i]
    for i in range(n - 1, -1, -1):
        if i + 1 < n:
            x[i] -= bands[1, i] * x[i + 1]
        if i + 2 < n:
            x[i] -= bands[2, i] * x[i + 2]
        x[i] /= bands[0, i]


@part
def _duration(c, h):
    """∫ dξ/√y by Simpson's rule, s."""
    total = 0.0
    for i in range(len(h)):
        first, last, _, _ = _cell(c, h, i)
        middle = 0.25 * (first + 2.0 * c[i + 1] + last)
        total += h[i] / 6.0 / math.sqrt(first)
        total += h[i] / 6.0 * (4.0 / math.sqrt(middle) + 1.0 / math.sqrt(last))
    return total


@kernel
def with_jerk_limits(c, h, hard, jerky, cap, first_gap, gap):
    """Improve coefficients of y that keep all limits until the duration is nearly the least.

    Newton's method for the duration less the logarithms of what is left of each limit, with
    weights that fall from ``first_gap``, the share of the duration that these are worth, to
    ``gap``. Other arguments as of ``_barrier``; ``c`` is overwritten.
    """
    n = len(c)
    gradient, bands, step, tried = np.empty(n), np.empty((3, n)), np.empty(n), np.empty(n)
    g, H, shape = np.empty(3), np.empty(6), np.empty(9)
    limits = 3.0 * (4.0 * hard.shape[3] + 1.0) * len(h)
    weight = first_gap * _duration(c, h) / limits
    for _ in range(_STEPS):
        value = _barrier(c, h, hard, jerky, cap, weight, True, gradient, bands, g, H, shape)
        step[:] = -gradient
        _solve(bands, step)
        expected = -np.dot(gradient, step)
        length, found = 1.0, math.inf
        while not found <= value - _DECREASE * length * expected and length > _SHORTEST:
            tried[:] = c + length * step
            found = _barrier(
                tried, h, hard, jerky, cap, weight, False, gradient, bands, g, H, shape
            )
            length *= _SHRINK
        if found < value:
            c[:] = tried
        if expected < _CENTERED or not found < value:
            if weight * limits <= gap * _duration(c, h):
                break
            weight *= _REDUCTION

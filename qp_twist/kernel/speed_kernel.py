"""The squared speed along a curve, as large as limits permit, compiled.

A curve q(ξ) is divided into cells. ``curve`` (C, 2, 3, nv) has q′, q″ and q‴ at the begin and the
end of each, ``h`` (C,) the lengths of the cells. With y = ξ̇² the joints have

    q̈ = ½ q′ y′ + q″ y,    q⃛ = √y (½ q′ y″ + (3/2) q″ y′ + q‴ y).
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import inner, kernel, part

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
_BLOCK = 64
"""Cells that are computed side by side, so that the processor takes several at once: a third of the
time. Each has a column of what follows."""
_FIRST, _MIDDLE, _LAST, _Y, _SLOPE, _BEND, _ROOT, _TOOK, _LEAST, _LEFT = range(10)
"""The Bernstein coefficients of y; at a place y, y′, y″, 1/√y, the duration, and the least and the
product of what is left of the limits."""
_G, _H, _TO, _SIZE = 10, 13, 19, 28
"""3 first and 6 second derivatives with respect to y, y′ and y″; 3 and 6 to the coefficients."""


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
def _coefficients(c, shares, i):
    """The Bernstein coefficients of y in cell i: first, middle and last."""
    middle = c[i + 1]
    first, last = shares[0, i] * (c[i] - middle), shares[1, i] * (c[i + 2] - middle)
    return middle + first, middle, middle + last


@part
def _look(h, begin, n, place, weight, w):
    """Write y, y′, y″, 1/√y and the duration in weights, by Simpson's rule, at a place of n cells.

    The place is 0, 1 or 2: the begin, the middle or the end of each cell.
    """
    u, share = 0.5 * place, (4.0 if place == 1 else 1.0) / (6.0 * weight)
    for k in range(n):
        rise, further = w[_MIDDLE, k] - w[_FIRST, k], w[_LAST, k] - w[_MIDDLE, k]
        per = 2.0 / h[begin + k]
        w[_Y, k] = w[_FIRST, k] + u * (2.0 * rise + u * (further - rise))
        w[_SLOPE, k] = per * (rise + u * (further - rise))
        w[_BEND, k] = 0.5 * per * per * (further - rise)
        w[_ROOT, k] = 1.0 / math.sqrt(w[_Y, k])
        w[_TOOK, k] = share * h[begin + k] * w[_ROOT, k]


@part
def _left(joint, k, w):
    """The share of the acceleration limit that a joint uses, and what is left of its limits."""
    A, B, A2, B2, C2 = joint
    use = A[k] * w[_SLOPE, k] + B[k] * w[_Y, k]
    jerk = A2[k] * w[_BEND, k] + B2[k] * w[_SLOPE, k] + C2[k] * w[_Y, k]
    return use, 1.0 - use * use, w[_ROOT, k] - jerk, w[_ROOT, k] + jerk


@inner
def _barrier(c, h, shares, rows, cap, weight):
    """The duration in weights of the barrier, less the logarithms of what is left of the limits.

    ∞ where a limit is not kept. Other arguments as of ``with_jerk_limits``.
    """
    w, total = np.empty((_SIZE, _BLOCK)), 0.0
    for begin in range(0, len(h), _BLOCK):
        end = min(begin + _BLOCK, len(h))
        cells = slice(begin, end)
        n, least = end - begin, math.inf
        for k in range(n):
            w[_FIRST, k], w[_MIDDLE, k], w[_LAST, k] = _coefficients(c, shares, begin + k)
            least = min(least, w[_FIRST, k], w[_MIDDLE, k], w[_LAST, k])
        if not least > 0.0:
            return math.inf
        for place in range(3):
            _look(h, begin, n, place, weight, w)
            for k in range(n):
                w[_LEAST, k] = w[_LEFT, k] = 1.0 - w[_Y, k] / cap[place, begin + k]
            for j in range(rows.shape[1]):
                r = rows[place, j]
                joint = r[0, cells], r[1, cells], r[2, cells], r[3, cells], r[4, cells]
                for k in range(n):
                    _, left, above, below = _left(joint, k, w)
                    w[_LEAST, k] = min(w[_LEAST, k], left, above, below)
                    w[_LEFT, k] *= left * above * below * w[_Y, k]
            for k in range(n):
                least = min(least, w[_LEAST, k])
            if not least > 0.0:
                return math.inf
            for k in range(n):
                total += w[_TOOK, k] - math.log(w[_LEFT, k])
    return total


@part
def _add_joint(joint, n, w):
    """Add a joint's part of the derivatives with respect to y, y′ and y″ at n places.

    They are those of −log(1 − use²) − log(1/√y − J) − log(1/√y + J) − log y, where J is the jerk
    over √y. The part of the second derivatives that is not convex is left out.
    """
    for k in range(n):
        use, left, above, below = _left(joint, k, w)
        A, B, A2, B2, C2 = joint[0][k], joint[1][k], joint[2][k], joint[3][k], joint[4][k]
        by, twice = 2.0 * use / left, 2.0 * (1.0 + use * use) / (left * left)
        inverse, fall = 1.0 / (above * below), -0.5 * w[_ROOT, k] / w[_Y, k]
        # With a = 1/above and b = 1/below: a + b, a − b, a² + b² and b² − a².
        whole, change = inverse * (above + below), inverse * (below - above)
        square, odd = whole * whole - 2.0 * inverse, -whole * change * fall
        w[_G, k] += by * B + change * C2 - whole * fall - 1.0 / w[_Y, k]
        w[_G + 1, k] += by * A + change * B2
        w[_G + 2, k] += change * A2
        w[_H, k] += twice * B * B + square * (fall * fall + C2 * C2) + 2.0 * odd * C2
        w[_H + 1, k] += twice * A * B + (square * C2 + odd) * B2
        w[_H + 2, k] += (square * C2 + odd) * A2
        w[_H + 3, k] += twice * A * A + square * B2 * B2
        w[_H + 4, k] += square * A2 * B2
        w[_H + 5, k] += square * A2 * A2


@part
def _times(y, s, b, k, w):
    """The second derivatives with respect to y, y′ and y″ times their changes."""
    yy, ys, yb = w[_H, k], w[_H + 1, k], w[_H + 2, k]
    ss, sb, bb = w[_H + 3, k], w[_H + 4, k], w[_H + 5, k]
    return yy * y + ys * s + yb * b, ys * y + ss * s + sb * b, yb * y + sb * s + bb * b


@part
def _to_cells(h, begin, n, place, w):
    """Add the derivatives at a place to those with respect to the cells' coefficients."""
    u = 0.5 * place
    y0, y1, y2 = (1.0 - u) * (1.0 - u), 2.0 * u * (1.0 - u), u * u
    for k in range(n):
        per = 2.0 / h[begin + k]
        s0, s1, s2, b = -per * (1.0 - u), per * (1.0 - 2.0 * u), per * u, 0.5 * per * per
        g0, g1, g2 = w[_G, k], w[_G + 1, k], w[_G + 2, k]
        w[_TO, k] += y0 * g0 + s0 * g1 + b * g2
        w[_TO + 1, k] += y1 * g0 + s1 * g1 - 2.0 * b * g2
        w[_TO + 2, k] += y2 * g0 + s2 * g1 + b * g2
        t0, t1, t2 = _times(y0, s0, b, k, w)
        w[_TO + 3, k] += y0 * t0 + s0 * t1 + b * t2
        w[_TO + 4, k] += y1 * t0 + s1 * t1 - 2.0 * b * t2
        w[_TO + 5, k] += y2 * t0 + s2 * t1 + b * t2
        t0, t1, t2 = _times(y1, s1, -2.0 * b, k, w)
        w[_TO + 6, k] += y1 * t0 + s1 * t1 - 2.0 * b * t2
        w[_TO + 7, k] += y2 * t0 + s2 * t1 + b * t2
        t0, t1, t2 = _times(y2, s2, b, k, w)
        w[_TO + 8, k] += y2 * t0 + s2 * t1 + b * t2


@part
def _spread(gradient, bands, f, t, i, w, k):
    """Add the derivatives with respect to a cell's coefficients to those of all."""
    f1, t1 = 1.0 - f, 1.0 - t
    g0, g1, g2 = w[_TO, k], w[_TO + 1, k], w[_TO + 2, k]
    H00, H01, H02 = w[_TO + 3, k], w[_TO + 4, k], w[_TO + 5, k]
    H11, H12, H22 = w[_TO + 6, k], w[_TO + 7, k], w[_TO + 8, k]
    gradient[i] += f * g0
    gradient[i + 1] += f1 * g0 + g1 + t1 * g2
    gradient[i + 2] += t * g2
    bands[0, i] += f * f * H00
    bands[0, i + 1] += f1 * (f1 * H00 + 2.0 * (H01 + t1 * H02)) + H11 + t1 * (2.0 * H12 + t1 * H22)
    bands[0, i + 2] += t * t * H22
    bands[1, i] += f * (f1 * H00 + H01 + t1 * H02)
    bands[1, i + 1] += t * (f1 * H02 + H12 + t1 * H22)
    bands[2, i] += f * t * H02


@inner
def _derivatives(c, h, shares, rows, cap, weight, gradient, bands):
    """Write the gradient (C + 2,) of the barrier and the diagonals (3, C + 2) of its Hessian."""
    w = np.empty((_SIZE, _BLOCK))
    gradient[:] = 0.0
    bands[:] = 0.0
    for begin in range(0, len(h), _BLOCK):
        end = min(begin + _BLOCK, len(h))
        cells = slice(begin, end)
        n = end - begin
        for k in range(n):
            w[_FIRST, k], w[_MIDDLE, k], w[_LAST, k] = _coefficients(c, shares, begin + k)
        w[_TO:] = 0.0
        for place in range(3):
            _look(h, begin, n, place, weight, w)
            w[_G:_TO] = 0.0
            for k in range(n):
                y, left = w[_Y, k], cap[place, begin + k] - w[_Y, k]
                w[_G, k] = 1.0 / left - 0.5 * w[_TOOK, k] / y
                w[_H, k] = 1.0 / (left * left) + 0.75 * w[_TOOK, k] / (y * y)
            for j in range(rows.shape[1]):
                r = rows[place, j]
                joint = r[0, cells], r[1, cells], r[2, cells], r[3, cells], r[4, cells]
                _add_joint(joint, n, w)
            _to_cells(h, begin, n, place, w)
        for k in range(n):
            i = begin + k
            _spread(gradient, bands, shares[0, i], shares[1, i], i, w, k)


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
def _duration(c, h, shares):
    """∫ dξ/√y by Simpson's rule, s."""
    total = 0.0
    for i in range(len(h)):
        first, middle, last = _coefficients(c, shares, i)
        middle = 0.25 * (first + 2.0 * middle + last)
        total += h[i] / 6.0 / math.sqrt(first)
        total += h[i] / 6.0 * (4.0 / math.sqrt(middle) + 1.0 / math.sqrt(last))
    return total


@kernel
def with_jerk_limits(c, h, rows, cap, first_gap, gap):
    """Improve coefficients of y that keep all limits until the duration is nearly the least.

    Newton's method for the duration less the logarithms of what is left of each limit, with
    weights that fall from ``first_gap``, the share of the duration that these are worth, to
    ``gap``.

    Args:
        c: Coefficients of y, a quadratic B-spline, (C + 2,); overwritten.
        h: Lengths of the cells, (C,).
        rows: At the begin, the middle and the end of each cell q′/2 and q″ over the acceleration
            limits, q′/2, (3/2) q″ and q‴ over the jerk limits, (3, nv, 5, C).
        cap: Largest y at these places, (3, C); ∞ without one.
        first_gap: See above.
        gap: See above.
    """
    n = len(c)
    gradient, bands, step, tried = np.empty(n), np.empty((3, n)), np.empty(n), np.empty(n)
    shares = np.ones((2, n - 2))  # of coefficients i and i + 2 in the first and the last of cell i
    shares[0, 1:] = h[1:] / (h[:-1] + h[1:])
    shares[1, :-1] = h[:-1] / (h[:-1] + h[1:])
    limits = 3.0 * (4.0 * rows.shape[1] + 1.0) * len(h)
    weight = first_gap * _duration(c, h, shares) / limits
    value = _barrier(c, h, shares, rows, cap, weight)
    for _ in range(_STEPS):
        _derivatives(c, h, shares, rows, cap, weight, gradient, bands)
        step[:] = -gradient
        _solve(bands, step)
        expected = -np.dot(gradient, step)
        length, found = 1.0, math.inf
        while not found <= value - _DECREASE * length * expected and length > _SHORTEST:
            tried[:] = c + length * step
            found = _barrier(tried, h, shares, rows, cap, weight)
            length *= _SHRINK
        better = found < value
        if better:
            c[:], value = tried, found
        if expected < _CENTERED or not better:
            if weight * limits <= gap * _duration(c, h, shares):
                break
            weight *= _REDUCTION
            value = _barrier(c, h, shares, rows, cap, weight)

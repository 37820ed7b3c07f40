r"""Rows of one step that keep pairs of shapes apart, where the step leads and on the way to rest.

After a step with the velocity v the joints can brake, each as hard as it may: with braking b a step
(acceleration times dt), joint j is then, n steps later, at

.. math:: q_j + D_n(v_j), \qquad D_n(v) = \operatorname{sign}(v)\,dt \sum_{i=0}^{n} (|v| - i b)_+

A velocity is safe if every pair keeps its distance at all these places until the joints are at
rest. What brakes as hard as it may stays on its way, so it is safe again: a safe velocity always
exists, if the last one was safe and nothing else moves. A joint without acceleration limit stops at
once, and the way is the step alone.

The first rows are those of the hardest braking w = sign(v₀)(|v₀| − b)₊ from the last velocity v₀:
with the least distance d of a pair on its way, found n steps later, and its gradient g there,

.. math:: d + \sum_j g_j \frac{D_n(v_{0j} + b) - D_n(v_{0j} - b)}{2 b}\,(v_j - w_j) \ge d_{min}

They are linear and the way is not. While an obstacle comes, further rows let the joints brake early
before the ends of their ranges. Where a solution is unsafe, further rows are those of where it
leads to, with D_n' in place of the chord.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.bounds import stopping_speed
from qp_twist.kernel.clearance_kernel import (
    change_of,
    distance_of,
    gradient_of,
    place,
    show_obstacles,
)
from qp_twist.kernel.compiling import entry, part, plain
from qp_twist.kernel.convex import dot

_LATEST = 1 << 40
"""Number of a step at which everything is at rest."""
_SAMPLES = 32
"""Largest number of places on the way to rest that are looked at."""
_BESIDE = 5e-3
"""Margin below which the places beside the least one are looked at too, m; it is known exactly."""
_NEAREST = 8
"""Largest number of rows by which a solution is corrected."""
_PARTS = 8
"""Parts of a step in which the place is looked for where it comes too near."""
_SUDDEN = 1e6
"""Acceleration that counts as none at all, rad/s² or m/s²."""
_UNHURRIED = 0.5
"""Share of the joints' accelerations with which a pair begins to give way to an obstacle: the rest
is for other pairs, and for directions in which not all joints may help."""
_BEFORE_ENDS = 0.2
"""Share of its acceleration with which a joint brakes before an end of its range while an obstacle
comes. The other joints have to take over from it, and may be slower or have longer to go."""
_STEPS_AHEAD = 4.0
"""A pair has a row if joints without acceleration limits could bring it too near in so many steps,
at their velocity limits. One would do for the distance; a scaled task slows down earlier."""
_ABLE = 0.99
"""Share of what the joints are able to do that a row may ask for."""


_Floats = npt.NDArray[np.float64]


class Braking(NamedTuple):
    """The joints in a step, the rows of a clearance, and scratch; pairs are in the cell."""

    q: _Floats  # configuration at its beginning, (nq,)
    at: _Floats  # configuration on the way, (nq,)
    before: _Floats  # v₀, rad/s or m/s, (nv,)
    hardest: _Floats  # acceleration limits, rad/s² or m/s², (nv,); ∞ where there are none
    fastest: _Floats  # velocity limits, rad/s or m/s, (nv,); ∞ where there are none
    lower: _Floats  # lower end of each joint's range, rad or m, (nv,); −∞ where there is none
    upper: _Floats  # upper end, likewise
    braked: _Floats  # w, (nv,)
    travel: _Floats  # scratch, (nv,)
    slope: _Floats  # scratch, (nv,)
    G: _Floats  # G q̇ ≤ g, (R, nv)
    g: _Floats  # (R,)
    pair: npt.NDArray[np.int64]  # the pair of each row, (R,)

    @classmethod
    def empty(cls, coordinates: int, dofs: int, rows: int) -> Braking:
        """Zeros, for so many coordinates, degrees of freedom and rows."""
        q, at = np.zeros((2, coordinates))
        before, hardest, fastest, lower, upper, braked, travel, slope = np.zeros((8, dofs))
        return cls(
            q, at, before, hardest, fastest, lower, upper, braked, travel, slope,
            np.zeros((rows, dofs)), np.zeros(rows), np.zeros(rows, np.int64),
        )  # fmt: skip


@part
def _moved(speed, braking, n, dt):
    """D_n(v) of one joint, and its derivative; ``braking`` is b."""
    if math.isinf(braking):
        return dt * speed, dt
    steps = min(n, max(math.ceil(abs(speed) / braking) - 1.0, 0.0))
    path = (steps + 1.0) * abs(speed) - 0.5 * braking * steps * (steps + 1.0)
    return math.copysign(dt * path, speed), dt * (steps + 1.0)


@part
def _last(velocity, hardest, dt):
    """Number of the step after which all joints are at rest."""
    last = 0.0
    for j in range(len(velocity)):
        if not math.isinf(hardest[j]):
            last = max(last, math.ceil(abs(velocity[j]) / (hardest[j] * dt)) - 1.0)
    return int(last)


@plain
def _go(cell, s, velocity, n, dt):
    """Place everything where it is n steps after a step with a velocity (nv,)."""
    for i in range(len(s.q)):
        s.at[i] = s.q[i]
    for k in range(len(cell.joints)):
        joint = cell.joints[k]
        moved, _ = _moved(velocity[joint.dof], s.hardest[joint.dof] * dt, n, dt)
        s.at[joint.address] += moved
    place(cell, s.at)


@plain
def _ask(cell, asked, ahead):
    """Place the obstacles, and write the distance to keep from each.

    Where they are expected after the step, what is unforeseen of them comes on top.
    """
    show_obstacles(cell, ahead)
    for k in range(len(cell.pairs)):
        pair = cell.pairs[k]
        pair.kept = asked + (pair.unforeseen if ahead else 0.0)


@part
def _margin(cell, pair, enough):
    """Margin of a pair; above ``enough`` a lower bound of it."""
    return distance_of(cell, pair, enough + pair.kept, -math.inf) - pair.kept


@plain
def _look(cell, pair, n):
    """Take the margin of a pair at a place on the way if it is the least so far."""
    found = _margin(cell, pair, min(pair.worst, max(pair.reach, _BESIDE)))
    if found < pair.worst:
        pair.worst, pair.sample = found, n


@plain
def _look_at(cell, s, velocity, n, dt):
    """Place everything where it is after n steps, and look at the pairs that may be near."""
    _go(cell, s, velocity, n, dt)
    for k in range(len(cell.pairs)):
        if cell.pairs[k].near < cell.pairs[k].reach:
            _look(cell, cell.pairs[k], n)


@plain
def _look_along(cell, s, velocity, dt, only_obstacles):
    """Write the least margins on the way of a velocity, and where, to ``worst`` and ``sample``.

    ``near`` is a bound of them: the joints brake towards rest, so that their travel between the
    ends of the way bounds what a margin can lose. Where it does not decide, places on the way are
    looked at, and those beside the least of them by halving: a pair that passes by may be nearer
    between two places than at either. If only pairs with an obstacle are asked for, the others have
    infinite margins.
    """
    last = _last(velocity, s.hardest, dt)
    for j in range(len(velocity)):
        near, _ = _moved(velocity[j], s.hardest[j] * dt, 0, dt)
        far, _ = _moved(velocity[j], s.hardest[j] * dt, last, dt)
        s.travel[j] = abs(far - near)
    _go(cell, s, velocity, 0, dt)
    left = False
    for k in range(len(cell.pairs)):
        pair = cell.pairs[k]
        pair.near = pair.worst = math.inf
        if only_obstacles and not pair.obstacle:
            continue
        change = change_of(cell, pair, s.travel) if last > 0 else 0.0
        pair.worst, pair.sample = _margin(cell, pair, pair.reach + change), 0
        pair.near = pair.worst - change
        left = left or pair.near < pair.reach
    if last == 0 or not left:
        return
    spacing = 1 + (last - 1) // _SAMPLES
    _look_at(cell, s, velocity, last, dt)
    for n in range(spacing, last, spacing):
        _look_at(cell, s, velocity, n, dt)
    while spacing > 1:
        spacing = (spacing + 1) // 2
        for k in range(len(cell.pairs)):
            pair = cell.pairs[k]
            if not (pair.near < pair.reach and pair.worst < _BESIDE):
                continue
            middle = pair.sample
            for n in (middle - spacing, middle + spacing):
                if 0 < n < last:
                    _go(cell, s, velocity, n, dt)
                    _look(cell, pair, n)


@plain
def _take_reaches(cell, s, dt, horizon, moves):
    """Write w, place everything where it leads, and write from which margin a pair does not matter.

    With acceleration limits on all joints those velocities end at most ``travel`` from rest of w; a
    joint without one goes at most as fast as it may.
    """
    bounded = True
    for j in range(len(s.before)):
        braking = s.hardest[j] * dt
        s.braked[j] = math.copysign(max(abs(s.before[j]) - braking, 0.0), s.before[j])
        s.travel[j] = _STEPS_AHEAD * s.fastest[j] * dt
        if not math.isinf(braking):
            bounded = bounded and not moves  # a pair gives way long before
            here, _ = _moved(s.braked[j], braking, _LATEST, dt)
            one, _ = _moved(s.before[j] + braking, braking, _LATEST, dt)
            other, _ = _moved(s.before[j] - braking, braking, _LATEST, dt)
            s.travel[j] = max(abs(one - here), abs(other - here))
        bounded = bounded and not math.isinf(s.travel[j])
    _go(cell, s, s.braked, 0, dt)
    for k in range(len(cell.pairs)):
        pair = cell.pairs[k]
        pair.reach = min(horizon, change_of(cell, pair, s.travel)) if bounded else horizon


@plain
def _row(s, k, until, closing, room, dt, recovery, row):
    """Turn the gradient of pair k in G into its row; return by how much its margin may decrease, m.

    ``until`` is the number n of the place of its least margin; at the end of the way ``_LATEST``,
    because a faster velocity goes on until it is at rest. ``closing`` is the speed of an obstacle,
    ``room`` the margin if it stood still, less what it takes on the way, and ``recovery`` the speed
    at which a pair that is too near is moved apart.
    """
    G, along, able, harder = s.G[row], 0.0, 0.0, 0.0
    for j in range(len(G)):
        braking, slope, gradient = s.hardest[j] * dt, dt, G[j]
        if math.isinf(braking):
            able += math.inf if gradient != 0.0 else 0.0
        else:
            one, _ = _moved(s.before[j] + braking, braking, until, dt)
            other, _ = _moved(s.before[j] - braking, braking, until, dt)
            slope = (one - other) / (2.0 * braking)
            most = s.before[j] + math.copysign(braking, gradient) - s.braked[j]
            able += gradient * slope * most
        G[j] = -gradient * slope / dt
        along += G[j] * s.braked[j]
        harder += abs(gradient) * min(s.hardest[j], _SUDDEN)
    if room < 0.0:
        room = max(room, -recovery * dt)
    elif closing > 0.0 and harder > 0.0:
        # So far ahead that the joints become as fast as the obstacle without haste.
        room *= dt / (dt + closing / (_UNHURRIED * harder))
    room = max(room - closing * dt, -_ABLE * able)
    s.g[row], s.pair[row] = room / dt + along, k
    return room


@plain
def _rows_before_ends(cell, s, k, dt, count):
    """Add rows of joints that brake gently before the ends of their ranges; return their number.

    They are named by pair k, and are behind the first ``count`` ones. What the hardest braking
    leads to is always allowed, so that a safe velocity is left.
    """
    for i in range(len(cell.joints)):
        joint = cell.joints[i]
        dof = joint.dof
        if math.isinf(s.hardest[dof]):
            continue
        at, gentle = s.q[joint.address], _BEFORE_ENDS * s.hardest[dof]
        for side in (-1.0, 1.0):
            left = s.upper[dof] - at if side > 0.0 else at - s.lower[dof]
            fastest, before = stopping_speed(max(left, 0.0), gentle, dt), side * s.before[dof]
            braking = s.hardest[dof] * dt
            if fastest >= before + braking:  # no velocity of this step is as fast
                continue
            for j in range(len(s.before)):
                s.G[count, j] = 0.0
            s.G[count, dof] = side
            s.g[count], s.pair[count] = max(fastest, before - braking), k
            count += 1
    return count


@entry
def write_rows(cell, s, dt, asked, horizon, recovery, moves):
    """Write the rows of a step, from ``q``, ``before``, ``hardest`` and ``fastest``.

    They keep the distance ``asked``, of pairs with a margin below ``horizon``; ``recovery`` is the
    speed at which a pair that is too near is moved apart; ``moves``: whether an obstacle does.
    Returned are the number of rows, and the least margin left if the joints brake and no obstacle
    moves, m.
    """
    _ask(cell, asked, True)
    _take_reaches(cell, s, dt, horizon, moves)
    if moves:
        _ask(cell, asked, False)
        _look_along(cell, s, s.braked, dt, True)
        for k in range(len(cell.pairs)):
            cell.pairs[k].still = cell.pairs[k].worst
        _ask(cell, asked, True)
    _look_along(cell, s, s.braked, dt, False)
    last, count, placed, nearest = _last(s.braked, s.hardest, dt), 0, -1, -1
    least = nearest_left = math.inf
    for k in range(len(cell.pairs)):
        pair = cell.pairs[k]
        then_left, n = pair.worst, pair.sample
        left = pair.still if moves and pair.obstacle else then_left
        least = min(least, left)
        pair.floor = 0.0
        for i in range(3):
            pair.normal[i] = 0.0
        if min(left, then_left) >= pair.reach:
            continue
        if placed != n:
            _go(cell, s, s.braked, n, dt)
            placed = n
        distance_of(cell, pair, math.inf, -math.inf)
        gradient_of(cell, pair, s.G[count])
        for i in range(3):
            pair.normal[i] = cell.simplex[0].away[i]
        closing = max(left - then_left, 0.0) / dt
        until = n if n < last else _LATEST
        room = _row(s, k, until, closing, left - closing * n * dt, dt, recovery, count)
        pair.floor = min(then_left - room, 0.0)
        count += 1
        if closing > 0.0 and left < nearest_left:
            nearest, nearest_left = k, left
    if nearest >= 0:
        count = _rows_before_ends(cell, s, nearest, dt, count)
    return count, least


@entry
def lack_of(cell, s, velocity, dt):
    """By how much a velocity (nv,) leads below the margins that its step may leave, m.

    After :func:`write_rows`. What is left of each margin is in ``worst``, where it is negative.
    """
    for k in range(len(cell.pairs)):
        cell.pairs[k].reach = 0.0
    _look_along(cell, s, velocity, dt, False)
    lack = 0.0
    for k in range(len(cell.pairs)):
        cell.pairs[k].worst -= cell.pairs[k].floor
        lack = max(lack, -cell.pairs[k].worst)
    return lack


@plain
def _correction(cell, s, k, velocity, left, dt, row):
    """Write a row of where a velocity leads, with ``slope`` of its way; return whether it counts.

    On the far side of something the way out would be ahead: there the distance has turned against
    its direction at the beginning, or the pair moves apart.
    """
    pair, G = cell.pairs[k], s.G[row]
    distance_of(cell, pair, math.inf, -math.inf)
    gradient_of(cell, pair, G)
    along, rate = dot(cell.simplex[0].away, pair.normal), 0.0  # no row, no normal: along = 0
    for j in range(len(G)):
        rate += G[j] * velocity[j]
    if along < 0.0 or (along == 0.0 and rate >= 0.0):
        return False
    end = left / dt
    for j in range(len(G)):
        G[j] *= -s.slope[j] / dt
        end += G[j] * velocity[j]
    s.g[row], s.pair[row] = end, k
    return True


@plain
def _correct_where_most_lacks(cell, s, velocity, dt, count):
    """Add rows of the pairs that lack most, each where it does; return the number of rows."""
    last = _last(velocity, s.hardest, dt)
    for _ in range(_NEAREST):
        nearest = 0
        for k in range(len(cell.pairs)):
            if cell.pairs[k].worst < cell.pairs[nearest].worst:
                nearest = k
        left, n = cell.pairs[nearest].worst, cell.pairs[nearest].sample
        if left >= 0.0 or count == len(s.g):
            break
        cell.pairs[nearest].worst = math.inf
        for j in range(len(velocity)):
            until = n if n < last else _LATEST
            _, s.slope[j] = _moved(velocity[j], s.hardest[j] * dt, until, dt)
        _go(cell, s, velocity, n, dt)
        count += _correction(cell, s, nearest, velocity, left, dt, count)
    return count


@plain
def _correct_where_first_lacks(cell, s, velocity, dt, count):
    """Add rows of the first place in the step where a pair is too near; return their number.

    A pair that is too near from the beginning, because an obstacle comes, has none.
    """
    for k in range(len(cell.pairs)):
        cell.pairs[k].worst = math.inf
    for part_ in range(_PARTS + 1):
        share = part_ / _PARTS
        for j in range(len(velocity)):
            s.slope[j] = share * dt
        for i in range(len(s.q)):
            s.at[i] = s.q[i]
        for k in range(len(cell.joints)):
            s.at[cell.joints[k].address] += share * dt * velocity[cell.joints[k].dof]
        place(cell, s.at)
        for k in range(len(cell.pairs)):
            pair = cell.pairs[k]
            if not math.isinf(pair.worst) or count == len(s.g):
                continue
            left = _margin(cell, pair, 0.0) - pair.floor
            if left < 0.0:
                pair.worst = left
                if part_ > 0:
                    count += _correction(cell, s, k, velocity, left, dt, count)
    return count


@entry
def correct(cell, s, velocity, dt, count):
    """Add rows for what :func:`lack_of` has found, behind the first ``count``; return how many.

    They are those of the pairs that lack most, where they do; and those of the first place on the
    way through the step where a pair is too near.
    """
    count = _correct_where_most_lacks(cell, s, velocity, dt, count)
    return _correct_where_first_lacks(cell, s, velocity, dt, count)

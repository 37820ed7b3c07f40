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
from typing import Annotated, NamedTuple

from qp_twist.kernel.bounds import stopping_speed
from qp_twist.kernel.clearance_kernel import (
    change_of,
    distance_of,
    gradient_of,
    place,
    read_cell,
)
from qp_twist.kernel.compiling import entry, part, plain
from qp_twist.kernel.dual_active_set import ROUNDING
from qp_twist.kernel.record import Floats, Integers, RecordType, reader

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


class ApartSizes(NamedTuple):
    """Sizes of :class:`Apart`."""

    coordinates: int
    dofs: int
    pairs: int
    rows: int


class Apart(NamedTuple):
    """What is known in a step, its rows, and scratch."""

    q: Annotated[Floats, "coordinates"]
    """Configuration at its beginning."""
    before: Annotated[Floats, "dofs"]
    """v₀, rad/s or m/s."""
    hardest: Annotated[Floats, "dofs"]
    """Acceleration limits, rad/s² or m/s²; ∞ where there are none."""
    fastest: Annotated[Floats, "dofs"]
    """Velocity limits, rad/s or m/s; ∞ where there are none."""
    lower: Annotated[Floats, "dofs"]
    """Lower end of each joint's range, rad or m; −∞ where there is none."""
    upper: Annotated[Floats, "dofs"]
    """Upper end, likewise."""
    braked: Annotated[Floats, "dofs"]
    """w."""
    at: Annotated[Floats, "coordinates"]
    """Configuration on the way."""
    travel: Annotated[Floats, "dofs"]
    slope: Annotated[Floats, "dofs"]
    reach: Annotated[Floats, "pairs"]
    """A pair of at least this margin matters to no velocity of the step, m."""
    counts: Annotated[Integers, "pairs"]
    """Whether a velocity of the step may bring it too near."""
    worst: Annotated[Floats, "pairs"]
    """Least margin of each pair on the way, m; where it is above ``reach`` it may be a bound."""
    sample: Annotated[Integers, "pairs"]
    """Number n of the step in which it is found."""
    still: Annotated[Floats, "pairs"]
    """The same if nothing else moved, of pairs that move with an obstacle."""
    least: Annotated[Floats, 1]
    """The least of these margins of all pairs."""
    floor: Annotated[Floats, "pairs"]
    """What may be left of the margin: 0, or less for a pair that returns, m."""
    gradients: Annotated[Floats, "pairs", "dofs"]
    """Derivatives of the margins on the way of w; 0 of pairs without a row."""
    normals: Annotated[Floats, "pairs", 3]
    """Directions of the distances there; 0 of pairs without a row."""
    G: Annotated[Floats, "rows", "dofs"]
    """G Δq ≤ h."""
    h: Annotated[Floats, "rows"]
    room: Annotated[Floats, "rows"]
    """What is left of the margin, or 0, m."""
    pair: Annotated[Integers, "rows"]
    """The pair of each row."""


APART = RecordType(Apart, ApartSizes)
read_apart = reader(APART)


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
    for joint in range(len(cell.pairs.dof)):
        dof = cell.pairs.dof[joint]
        moved, _ = _moved(velocity[dof], s.hardest[dof] * dt, n, dt)
        s.at[cell.tree.address[joint]] += moved
    place(cell, s.at)


@part
def _margin(cell, pair, enough, asked):
    """Margin of a pair, less what is unforeseen of its obstacle; above ``enough`` a lower bound."""
    kept = asked + cell.places.unforeseen[pair]
    return distance_of(cell, pair, enough + kept, True) - kept


@part
def _take_gradient(cell, s, pair):
    """Keep the derivatives of the distance that was computed last, and its direction."""
    gradient_of(cell, pair, s.gradients[pair])
    for i in range(3):
        s.normals[pair, i] = cell.simplex.result[6 + i]


@plain
def _look(cell, s, pair, n, asked):
    """Take the margin of a pair at a place on the way if it is the least so far."""
    found = _margin(cell, pair, min(s.worst[pair], max(s.reach[pair], _BESIDE)), asked)
    if found < s.worst[pair]:
        s.worst[pair], s.sample[pair] = found, n


@plain
def _look_between(cell, s, velocity, dt, asked, last):
    """Look at places between the ends of the way, and beside the least of them by halving.

    A pair that passes by may be nearer between two places than at either.
    """
    near, spacing = cell.places.near, 1 + (last - 1) // _SAMPLES
    for n in range(spacing, last, spacing):
        _go(cell, s, velocity, n, dt)
        for pair in range(len(s.worst)):
            if near[pair] < s.reach[pair]:
                _look(cell, s, pair, n, asked)
    for pair in range(len(s.worst)):
        half = spacing if near[pair] < s.reach[pair] and s.worst[pair] < _BESIDE else 1
        while half > 1:
            half = (half + 1) // 2
            middle = s.sample[pair]
            for n in (middle - half, middle + half):
                if 0 < n < last:
                    _go(cell, s, velocity, n, dt)
                    _look(cell, s, pair, n, asked)


@plain
def _look_along(cell, s, velocity, dt, asked, slopes, among):
    """Write the least margins on the way of a velocity, and where, to ``worst`` and ``sample``.

    Everything is placed at its beginning. With ``slopes`` also the gradients of those that are
    below ``reach`` there. Pairs that are not ``among`` those to look at, (pairs,), have none.

    The joints brake towards rest, so their travel between the ends of the way bounds what a margin
    can lose on it.
    """
    last = _last(velocity, s.hardest, dt)
    for j in range(len(velocity)):
        braking = s.hardest[j] * dt
        near, _ = _moved(velocity[j], braking, 0, dt)
        far, _ = _moved(velocity[j], braking, last, dt)
        s.travel[j] = abs(far - near)
    change, near = cell.places.change, cell.places.near
    left = False
    for pair in range(len(s.worst)):
        if not among[pair]:
            near[pair] = s.worst[pair] = math.inf
            continue
        change[pair] = change_of(cell, pair, s.travel) if last > 0 else 0.0
        enough = s.reach[pair] + change[pair]
        near[pair] = _margin(cell, pair, enough, asked)
        s.worst[pair], s.sample[pair] = near[pair], 0
        if slopes and near[pair] < s.reach[pair]:
            _take_gradient(cell, s, pair)
        left = left or near[pair] < enough
    if last == 0 or not left:
        return
    _go(cell, s, velocity, last, dt)
    left = False
    for pair in range(len(s.worst)):
        enough = s.reach[pair] + change[pair]
        if near[pair] < enough:
            far = _margin(cell, pair, enough, asked)
            if far < s.worst[pair]:
                s.worst[pair], s.sample[pair] = far, last
            # Between the two ends the margin is at least this.
            near[pair] = 0.5 * (near[pair] + far - change[pair])
            left = left or near[pair] < s.reach[pair]
    if left:
        _look_between(cell, s, velocity, dt, asked, last)


@plain
def _take_reaches(cell, s, dt, horizon, moves):
    """Write w, place everything where it leads, and write from which margin a pair does not matter.

    With acceleration limits on all joints those velocities end at most ``travel`` from rest of w; a
    joint without one goes at most as fast as it may.
    """
    longest = 0.0
    for j in range(len(s.before)):
        braking = s.hardest[j] * dt
        if moves and not math.isinf(braking):
            longest = math.inf  # a pair gives way long before
        s.braked[j] = math.copysign(max(abs(s.before[j]) - braking, 0.0), s.before[j])
        s.travel[j] = _STEPS_AHEAD * s.fastest[j] * dt
        if not math.isinf(braking):
            here, _ = _moved(s.braked[j], braking, _LATEST, dt)
            one, _ = _moved(s.before[j] + braking, braking, _LATEST, dt)
            other, _ = _moved(s.before[j] - braking, braking, _LATEST, dt)
            s.travel[j] = max(abs(one - here), abs(other - here))
        longest = max(longest, s.travel[j])
    _go(cell, s, s.braked, 0, dt)
    for pair in range(len(s.reach)):
        s.reach[pair], s.counts[pair] = horizon, 1
        if not math.isinf(longest):
            s.reach[pair] = min(horizon, change_of(cell, pair, s.travel))


@plain
def _row(s, pair, until, closing, room, dt, recovery, row):
    """Write the row of a pair from its gradient; return by how much its margin may decrease, m.

    Args:
        s: What is known.
        pair: The pair.
        until: Number n of the place of its least margin; at the end of the way ``_LATEST``, because
            a faster velocity goes on until it is at rest.
        closing: Speed of an obstacle, m/s.
        room: The margin if the obstacle stood still, less what it takes on the way, m.
        dt: Length of the step, s.
        recovery: Speed at which a pair that is too near is moved apart, m/s.
        row: Number of the row.
    """
    g, G, end, able, harder = s.gradients[pair], s.G[row], 0.0, 0.0, 0.0
    for j in range(len(g)):
        braking, slope = s.hardest[j] * dt, dt
        if math.isinf(braking):
            able += math.inf if g[j] != 0.0 else 0.0
        else:
            one, _ = _moved(s.before[j] + braking, braking, until, dt)
            other, _ = _moved(s.before[j] - braking, braking, until, dt)
            slope = (one - other) / (2.0 * braking)
            able += g[j] * slope * (s.before[j] + math.copysign(braking, g[j]) - s.braked[j])
        G[j] = -g[j] * slope / dt
        end += G[j] * s.braked[j] * dt
        harder += abs(g[j]) * min(s.hardest[j], _SUDDEN)
    if room < 0.0:
        room = max(room, -recovery * dt)
    elif closing > 0.0 and harder > 0.0:
        # So far ahead that the joints become as fast as the obstacle without haste.
        room *= dt / (dt + closing / (_UNHURRIED * harder))
    room = max(room - closing * dt, -_ABLE * able)
    s.h[row], s.room[row], s.pair[row] = room + end, max(room, 0.0), pair
    return room


@plain
def _rows_before_ends(cell, s, pair, dt, count):
    """Add rows of joints that brake gently before the ends of their ranges; return their number.

    What the hardest braking leads to is always allowed, so that a safe velocity is left.

    Args:
        cell: The cell.
        s: What is known.
        pair: The pair by which the rows are named: of those whose obstacle comes, the nearest.
        dt: Length of the step, s.
        count: Number of rows so far.
    """
    for joint in range(len(cell.pairs.dof)):
        dof = cell.pairs.dof[joint]
        if math.isinf(s.hardest[dof]):
            continue
        at, gentle = s.q[cell.tree.address[joint]], _BEFORE_ENDS * s.hardest[dof]
        for side in (-1.0, 1.0):
            left = s.upper[dof] - at if side > 0.0 else at - s.lower[dof]
            fastest, before = stopping_speed(max(left, 0.0), gentle, dt), side * s.before[dof]
            braking = s.hardest[dof] * dt
            if fastest >= before + braking:  # no velocity of this step is as fast
                continue
            for j in range(len(s.before)):
                s.G[count, j] = 0.0
            s.G[count, dof] = side
            s.h[count] = dt * max(fastest, before - braking)
            s.room[count], s.pair[count] = 0.0, pair
            count += 1
    return count


@plain
def write_rows(now, then, s, dt, asked, horizon, recovery, moves):
    """Write the rows of a step, from ``q``, ``before`` and ``hardest``.

    Args:
        now: The :class:`~qp_twist.kernel.clearance_kernel.Cell`.
        then: The same, with obstacles where they are expected after the step.
        s: :class:`Apart`.
        dt: Length of the step, s.
        asked: The distance to keep, m.
        horizon: Margin from which on a pair has no row, m.
        recovery: Speed at which a pair that is too near is moved apart, m/s.
        moves: Whether an obstacle moves.

    Returns:
        The number of rows.
    """
    _take_reaches(then, s, dt, horizon, moves)
    if moves:
        _go(now, s, s.braked, 0, dt)
        _look_along(now, s, s.braked, dt, asked, False, now.pairs.obstacle)
        for pair in range(len(s.worst)):
            s.still[pair] = s.worst[pair]
    _look_along(then, s, s.braked, dt, asked, True, s.counts)
    last, count, placed = _last(s.braked, s.hardest, dt), 0, -1
    s.least[0] = math.inf
    nearest, least = -1, math.inf
    for pair in range(len(s.worst)):
        then_left, n = s.worst[pair], s.sample[pair]
        left = s.still[pair] if moves and then.pairs.obstacle[pair] else then_left
        s.least[0] = min(s.least[0], left)
        s.floor[pair] = 0.0
        if min(left, then_left) >= s.reach[pair]:
            # The horizon is no bound of the motion, and samples are not the whole way.
            if s.reach[pair] < horizon and then.places.near[pair] >= s.reach[pair]:
                s.counts[pair] = 0
            for j in range(len(s.before)):
                s.gradients[pair, j] = 0.0
            for i in range(3):
                s.normals[pair, i] = 0.0
            continue
        if n > 0 or not then_left < s.reach[pair]:
            if placed != n:
                _go(then, s, s.braked, n, dt)
                placed = n
            distance_of(then, pair, math.inf, True)
            _take_gradient(then, s, pair)
        closing = max(left - then_left, 0.0) / dt
        until = n if n < last else _LATEST
        room = _row(s, pair, until, closing, left - closing * n * dt, dt, recovery, count)
        s.floor[pair] = min(then_left - room, 0.0)
        count += 1
        if closing > 0.0 and left < least:
            nearest, least = pair, left
    if nearest >= 0:
        count = _rows_before_ends(then, s, nearest, dt, count)
    return count


@part
def _is_allowed(s, velocity, dt):
    """Whether a velocity (nv,) keeps the limits from which the reaches follow, but for rounding."""
    for j in range(len(velocity)):
        braking = s.hardest[j] * dt
        if math.isinf(braking) and not abs(velocity[j]) <= s.fastest[j]:
            return False
        if not abs(velocity[j] - s.before[j]) <= (1.0 + ROUNDING) * braking:
            return False
    return True


@plain
def lack_of(then, s, velocity, dt, asked):
    """By how much a velocity (nv,) leads below the margins that its step may leave, m.

    What is left of each margin is in ``worst``, where it is negative.
    """
    allowed = _is_allowed(s, velocity, dt)
    for pair in range(len(s.worst)):
        s.reach[pair] = 0.0
        if not allowed:
            s.counts[pair] = 1
    _go(then, s, velocity, 0, dt)
    _look_along(then, s, velocity, dt, asked, False, s.counts)
    lack = 0.0
    for pair in range(len(s.worst)):
        s.worst[pair] -= s.floor[pair]
        lack = max(lack, -s.worst[pair])
    return lack


@entry
def rows_apart(now, then, integers, floats, table, dt, asked, horizon, recovery, moves):
    """:func:`write_rows` from the floats of the cells, their integers, and those of ``Apart``."""
    s = read_apart(floats, table, table)
    before, after = read_cell(now, integers, integers), read_cell(then, integers, integers)
    return write_rows(before, after, s, dt, asked, horizon, recovery, moves)


@entry
def lack_apart(then, integers, floats, table, velocity, dt, asked):
    """:func:`lack_of` from the same arrays."""
    s = read_apart(floats, table, table)
    return lack_of(read_cell(then, integers, integers), s, velocity, dt, asked)


@plain
def _correction(cell, s, pair, velocity, left, dt, row):
    """Write a row of where a velocity leads, with ``slope`` of its way; return whether it counts.

    On the far side of something the way out would be ahead: there the distance has turned against
    its direction at the beginning, or the pair moves apart.
    """
    distance_of(cell, pair, math.inf, True)
    G = s.G[row]
    gradient_of(cell, pair, G)
    along, rate, known = 0.0, 0.0, False
    for i in range(3):
        along += cell.simplex.result[6 + i] * s.normals[pair, i]
        known = known or s.normals[pair, i] != 0.0
    for j in range(len(G)):
        rate += G[j] * velocity[j]
    if (known and along < 0.0) or (not known and rate >= 0.0):
        return False
    end = left
    for j in range(len(G)):
        G[j] *= -s.slope[j] / dt
        end += G[j] * velocity[j] * dt
    s.h[row], s.room[row], s.pair[row] = end, 0.0, pair
    return True


@plain
def _correct_where_most_lacks(cell, s, velocity, dt, count):
    """Add rows of the pairs that lack most, each where it does; return the number of rows."""
    last = _last(velocity, s.hardest, dt)
    for _ in range(_NEAREST):
        nearest = 0
        for pair in range(len(s.worst)):
            if s.worst[pair] < s.worst[nearest]:
                nearest = pair
        left, n = s.worst[nearest], s.sample[nearest]
        if left >= 0.0 or count == len(s.h):
            break
        s.worst[nearest] = math.inf
        for j in range(len(velocity)):
            until = n if n < last else _LATEST
            _, s.slope[j] = _moved(velocity[j], s.hardest[j] * dt, until, dt)
        _go(cell, s, velocity, n, dt)
        count += _correction(cell, s, nearest, velocity, left, dt, count)
    return count


@plain
def _correct_where_first_lacks(cell, s, velocity, dt, asked, count):
    """Add rows of the first place in the step where a pair is too near; return their number.

    A pair that is too near from the beginning, because an obstacle comes, has none.
    """
    for pair in range(len(s.worst)):
        s.worst[pair] = math.inf
    for k in range(_PARTS + 1):
        share = k / _PARTS
        for j in range(len(velocity)):
            s.slope[j] = share * dt
        for i in range(len(s.q)):
            s.at[i] = s.q[i]
        for joint in range(len(cell.pairs.dof)):
            s.at[cell.tree.address[joint]] += share * dt * velocity[cell.pairs.dof[joint]]
        place(cell, s.at)
        for pair in range(len(s.worst)):
            if not math.isinf(s.worst[pair]) or count == len(s.h):
                continue
            left = _margin(cell, pair, 0.0, asked) - s.floor[pair]
            if left < 0.0:
                s.worst[pair] = left
                if k > 0:
                    count += _correction(cell, s, pair, velocity, left, dt, count)
    return count


@entry
def correct_apart(then, integers, floats, table, velocity, dt, asked, count):
    """Add rows for what :func:`lack_apart` has found, behind the first ``count``; return how many.

    They are those of the pairs that lack most, where they do; and those of the first place on the
    way through the step where a pair is too near.
    """
    s = read_apart(floats, table, table)
    cell = read_cell(then, integers, integers)
    count = _correct_where_most_lacks(cell, s, velocity, dt, count)
    return _correct_where_first_lacks(cell, s, velocity, dt, asked, count)

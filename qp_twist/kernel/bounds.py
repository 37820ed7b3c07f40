"""The box of all limits, joint by joint, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.constants import NOTICEABLE, UNLIMITED

POSITION, MOTION, WINDOW, BOX_BOUNDS, MINK_RANGE = 0, 1, 2, 3, 4
"""Kinds of limits. ``BOX_BOUNDS`` are velocity bounds that Python has evaluated. ``MINK_RANGE`` is
mink's joint range: a step may cover a share of the distance to its end, and returns from outside
at once."""
ACCELERATION_BOUND, VELOCITY_BOUND, POSITION_BOUND = 0.0, 1.0, 2.0
"""Kind of a bound, which is also its priority: of equal bounds the one with the lower number is
reported. Numbers in between belong to other kinds of limits."""
NO_BOUND = 9.0


@part
def stopping_speed(room, acceleration, dt):
    """As ``constraints.stopping_speed``, for one joint."""
    if math.isinf(acceleration) or math.isinf(room):
        return room / dt
    braking = acceleration * dt
    steps = math.floor((math.sqrt(1.0 + 8.0 * room / (braking * dt)) - 1.0) / 2.0)
    return room / ((steps + 1.0) * dt) + 0.5 * steps * braking


@part
def _above(bound, kind, least, least_kind):
    """Return the higher of two lower bounds; of equal ones the one with the lower kind."""
    if bound > least or (bound == least and kind < least_kind):
        return bound, kind
    return least, least_kind


@part
def _below(bound, kind, most, most_kind):
    """Return the lower of two upper bounds; of equal ones the one with the lower kind."""
    if bound < most or (bound == most and kind < most_kind):
        return bound, kind
    return most, most_kind


@part
def joint_bounds(kind, q, dt, numbers, least, from_below, most, from_above):
    """Narrow a joint's velocity bounds by one limit.

    Columns of ``numbers`` (7,), by kind of limit:

    ============  =========  =========  ================  ==========  =====  =====  ========
    kind          0          1          2                 3           4      5      6
    ============  =========  =========  ================  ==========  =====  =====  ========
    POSITION      θ_min      θ_max      distance kept     distance
                                        to θ_min          to θ_max
    MOTION        as above                                            v_max  a_max  last q̇
    WINDOW        reference  half
                             width
    BOX_BOUNDS    lower      upper      kind of bound
    MINK_RANGE    θ_min      θ_max      share of the
                                        distance
    ============  =========  =========  ================  ==========  =====  =====  ========

    Returned are whether the joint is inside its range and can stop in time; then the bounds, as
    narrowed, each with its kind.
    """
    first, second = numbers[0], numbers[1]
    if kind == BOX_BOUNDS:
        least, from_below = _above(first, numbers[2], least, from_below)
        most, from_above = _below(second, numbers[2], most, from_above)
        return True, least, from_below, most, from_above
    if kind == MINK_RANGE:
        share = numbers[2] / dt
        least, from_below = _above(share * (first - q), POSITION_BOUND, least, from_below)
        most, from_above = _below(share * (second - q), POSITION_BOUND, most, from_above)
        return True, least, from_below, most, from_above
    if kind == WINDOW:
        low = min((first - q - second) / dt, 0.0)
        high = max((first - q + second) / dt, 0.0)
        least, from_below = _above(low, VELOCITY_BOUND, least, from_below)
        most, from_above = _below(high, VELOCITY_BOUND, most, from_above)
        return True, least, from_below, most, from_above
    below, above = q - first, second - q
    inside = below >= -NOTICEABLE and above >= -NOTICEABLE
    low, high = max(below - numbers[2], 0.0), max(above - numbers[3], 0.0)
    if kind == MOTION:
        fastest, hardest, before = numbers[4], numbers[5], numbers[6]
        change = hardest * dt
        # A joint that is too fast to stop in time is left to the reference, which reports it.
        inside = (
            inside
            and abs(before) <= fastest + NOTICEABLE
            and -before - change <= stopping_speed(max(below, 0.0) + NOTICEABLE, hardest, dt)
            and before - change <= stopping_speed(max(above, 0.0) + NOTICEABLE, hardest, dt)
        )
        least, from_below = _above(before - change, ACCELERATION_BOUND, least, from_below)
        most, from_above = _below(before + change, ACCELERATION_BOUND, most, from_above)
        least, from_below = _above(-fastest, VELOCITY_BOUND, least, from_below)
        most, from_above = _below(fastest, VELOCITY_BOUND, most, from_above)
        low, high = stopping_speed(low, hardest, dt), stopping_speed(high, hardest, dt)
    else:
        low, high = low / dt, high / dt
    least, from_below = _above(-low, POSITION_BOUND, least, from_below)
    most, from_above = _below(high, POSITION_BOUND, most, from_above)
    return inside, least, from_below, most, from_above


@plain
def bounds(s, q, dt):
    """Intersect the bounds of all limits, (nv,); return whether all joints are inside them.

    Also returns false if two limits contradict each other. ``q`` are joint positions, (nv,); the
    limits and the result are those of the arrays of a step.
    """
    limits, types, lower, upper = s.limits, s.types, s.lower, s.upper
    lower_kind, upper_kind = s.lower_kind, s.upper_kind
    for dof in range(len(q)):
        least, most, from_below, from_above = -math.inf, math.inf, NO_BOUND, NO_BOUND
        for index in range(len(types)):
            inside, least, from_below, most, from_above = joint_bounds(
                types[index], q[dof], dt, limits[index][dof], least, from_below, most,
                from_above,
            )  # fmt: skip
            if not inside:
                return False
        # A joint that can only just stop: its acceleration limit counts before its range.
        if least > most and from_below == ACCELERATION_BOUND and from_above == POSITION_BOUND:
            most, from_above = least, from_below
        if least > most and from_above == ACCELERATION_BOUND and from_below == POSITION_BOUND:
            least, from_below = most, from_above
        if not least <= most or least > UNLIMITED or most < -UNLIMITED:
            return False
        lower[dof] = least if least >= -UNLIMITED else -math.inf
        upper[dof] = most if most <= UNLIMITED else math.inf
        lower_kind[dof], upper_kind[dof] = from_below, from_above
    return True

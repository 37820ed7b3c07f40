"""The box of all limits, joint by joint, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain

POSITION, MOTION, WINDOW, STATED, MINK_RANGE = 0, 1, 2, 3, 4
"""Kinds of limits. What is stated are bounds on velocities, by whatever limit; a range of mink's is
approached at a share of the way to its end each step, and snaps back from outside."""
ACCELERATION_BOUND, VELOCITY_BOUND, POSITION_BOUND = 0.0, 1.0, 2.0
"""What a bound comes from, in the order in which they give way to each other; numbers between them
are of limits of other kinds."""
NO_BOUND = 9.0


@part
def _stopping_speed(room, acceleration, dt):
    """As ``limits.stopping_speed``, for one joint."""
    if math.isinf(acceleration) or math.isinf(room):
        return room / dt
    braking = acceleration * dt
    steps = math.floor((math.sqrt(1.0 + 8.0 * room / (braking * dt)) - 1.0) / 2.0)
    return room / ((steps + 1.0) * dt) + 0.5 * steps * braking


@part
def _above(bound, kind, least, least_kind):
    """The higher of two lower bounds; of equal ones the one whose kind comes first."""
    if bound > least or (bound == least and kind < least_kind):
        return bound, kind
    return least, least_kind


@part
def _below(bound, kind, most, most_kind):
    """The lower of two upper bounds; of equal ones the one whose kind comes first."""
    if bound < most or (bound == most and kind < most_kind):
        return bound, kind
    return most, most_kind


@part
def joint_bounds(kind, q, dt, noticeable, numbers, least, from_below, most, from_above):
    """Narrow a joint's bounds by one limit.

    Args:
        kind: Of the limit.
        q: Position of the joint.
        dt: Length of the step, s.
        noticeable: What counts as outside, rad or m.
        numbers: Of the joint in the limit's table, (7,): of positions θ_min, θ_max and what the
            joint stops short of either by; of motions also v_max, a_max and the velocity before;
            of windows the reference and the half width; of what is stated the two bounds and what
            they come from; of mink's ranges the two ends and the share.
        least: Lower bound by the limits before, rad/s or m/s.
        from_below: What it comes from.
        most: Upper bound by the limits before.
        from_above: What it comes from.

    Returns:
        Whether the joint is inside, and can stop in time; the bounds, each with what it comes from.
    """
    first, second = numbers[0], numbers[1]
    if kind == STATED:
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
    inside = below >= -noticeable and above >= -noticeable
    low, high = max(below - numbers[2], 0.0), max(above - numbers[3], 0.0)
    if kind == MOTION:
        fastest, hardest, before = numbers[4], numbers[5], numbers[6]
        change = hardest * dt
        # Too fast to stop in time: recovering, which the reference tells of.
        inside = (
            inside
            and abs(before) <= fastest + noticeable
            and -before - change <= _stopping_speed(max(below, 0.0) + noticeable, hardest, dt)
            and before - change <= _stopping_speed(max(above, 0.0) + noticeable, hardest, dt)
        )
        least, from_below = _above(before - change, ACCELERATION_BOUND, least, from_below)
        most, from_above = _below(before + change, ACCELERATION_BOUND, most, from_above)
        least, from_below = _above(-fastest, VELOCITY_BOUND, least, from_below)
        most, from_above = _below(fastest, VELOCITY_BOUND, most, from_above)
        low, high = _stopping_speed(low, hardest, dt), _stopping_speed(high, hardest, dt)
    else:
        low, high = low / dt, high / dt
    least, from_below = _above(-low, POSITION_BOUND, least, from_below)
    most, from_above = _below(high, POSITION_BOUND, most, from_above)
    return inside, least, from_below, most, from_above


@plain
def bounds(
    limits, types, q, dt, noticeable, unlimited, lower, upper, lower_kind, upper_kind
):  # fmt: skip
    """The box of all limits, (nv,); whether no joint is outside and no two limits contradict.

    Args:
        limits: A table for each limit, (L, nv, 7): see :func:`joint_bounds`.
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
        least, most, from_below, from_above = -math.inf, math.inf, NO_BOUND, NO_BOUND
        for index in range(len(types)):
            inside, least, from_below, most, from_above = joint_bounds(
                types[index], q[dof], dt, noticeable, limits[index][dof], least, from_below, most,
                from_above,
            )  # fmt: skip
            if not inside:
                return False
        if not least <= most or least > unlimited or most < -unlimited:
            return False
        lower[dof] = least if least >= -unlimited else -math.inf
        upper[dof] = most if most <= unlimited else math.inf
        lower_kind[dof], upper_kind[dof] = from_below, from_above
    return True

"""One method along a path, waypoint by waypoint, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.fast.arm_kernel import pose_and_jacobian
from qp_twist.fast.bounds import WINDOW, bounds
from qp_twist.fast.compiling import kernel, part, plain
from qp_twist.fast.null_space import INDEPENDENT, least_norm, reflect
from qp_twist.fast.path_kernel import Rows
from qp_twist.fast.step_kernel import Settings, verified_velocity
from qp_twist.fast.step_record import Sizes, read_program
from qp_twist.fast.twist_rows import twist_rows
from qp_twist.fast.verified_program import DONE, Tolerances

_STANDS_STILL = 1e-13
"""A displacement below it is none, rad or m."""


class Way(NamedTuple):
    """What a method does, the same for every waypoint and every lap."""

    program: bool
    """Whether a step is the QP; otherwise the closed form of minimum norm plus free motion."""
    twist_space: bool
    iterations: int
    every_iteration: bool
    """Whether the secondary acts in all of them, and a waypoint begins with it (a plan)."""
    tolerances: npt.NDArray[np.float64]
    """Position and angle at which a waypoint counts as reached, m and rad, (2,)."""
    pull: npt.NDArray[np.float64]
    """h = pull · (reference − θ), (nv,)."""
    limits: npt.NDArray[np.float64]
    """As ``fast.bounds`` takes them, (L, nv, 7); of a window the width is one second's."""
    types: npt.NDArray[np.int64]
    metric: npt.NDArray[np.float64]
    free_costs: npt.NDArray[np.float64]
    settings: Settings
    verified: Tolerances
    sane: float
    """A joint beyond it has diverged, rad or m."""


class Path(NamedTuple):
    """What a lap meets."""

    rows: Rows
    """That the method holds; where the number of the projector is −1, they are not known here."""
    durations: npt.NDArray[np.float64]
    """Time from the waypoint before, s, (N,)."""
    references: npt.NDArray[np.float64]
    """What the secondary pulls to, rad or m, (N, nv)."""


class Lap(NamedTuple):
    """Arrays for one waypoint at a time."""

    pose: Any
    J: Any
    q: Any
    V: Any
    R: Any
    limits: Any
    floats: Any
    """Of the program."""
    integers: Any
    """Likewise; the active set."""
    ends: Any
    """Where the rows of its only level end, (1,)."""


@plain
def _size(nv, rows, twist_space):
    """Of the program of one task without inequality rows."""
    if twist_space:
        return Sizes(nv, rows, 1, 1, 0, nv, 6, 0, 0)
    return Sizes(nv, rows, 1, 1, 0, 0, 0, 0, 0)


@kernel
def _arrays(way):
    """For a robot of as many degrees of freedom as the metric has entries, and up to 6 rows."""
    nv, floats, integers, nothing = len(way.metric), 0, 0, np.zeros(0)
    for rows in range(7):
        size = _size(nv, rows, way.twist_space)
        _, i, j = read_program(nothing, 0, np.zeros(0, dtype=np.int64), 0, size)
        floats, integers = max(floats, i), max(integers, j)
    return Lap(
        np.zeros(12), np.zeros((6, nv)), np.zeros(nv), np.zeros((6, nv)), np.zeros((6, 6)),
        way.limits.copy(), np.zeros(floats), np.zeros(integers, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
    )  # fmt: skip


@part
def _begin(way, path, at, q, w, lap):
    """Open the windows of a waypoint and take its lead; whether there is one."""
    dt = path.durations[at]
    for index in range(len(way.types)):
        if way.types[index] == WINDOW:
            for dof in range(len(q)):
                lap.limits[index, dof, 0] = q[dof]
                lap.limits[index, dof, 1] = way.limits[index, dof, 1] * dt
    if not way.every_iteration:
        return True
    if not bounds(
        lap.limits, way.types, q, dt, way.settings.noticeable, way.settings.unlimited, w.lower,
        w.upper, w.lower_kind, w.upper_kind,
    ):  # fmt: skip
        return False
    for dof in range(len(q)):
        wish = way.pull[dof] * (path.references[at, dof] - q[dof])
        q[dof] += min(max(wish, min(w.lower[dof] * dt, 0.0)), max(w.upper[dof] * dt, 0.0))
    return True


@part
def _programmed(way, path, at, q, pulls, w, lap):
    """The step of the QP into ``w.x``, as a displacement; whether it is a plain one."""
    dt, fastest = path.durations[at], way.settings.fastest
    for row in range(len(w.b)):
        if not abs(w.b[row]) <= fastest:
            return False
    for dof in range(len(q)):
        w.q[dof], w.c[dof] = q[dof], 0.0
        if pulls:
            w.c[dof] = way.pull[dof] * (path.references[at, dof] - q[dof]) / dt
        if not abs(w.c[dof]) <= fastest:
            return False
    lap.ends[0] = len(w.b)
    none, nothing = w.G, w.g  # no costs of other tasks
    status = verified_velocity(
        w, lap.ends, lap.limits, way.types, way.metric, none, nothing, way.settings, way.verified,
        dt,
    )  # fmt: skip
    for dof in range(len(q)):
        w.x[dof] *= dt
    return status == DONE


@part
def _closed_form(way, path, at, q, pulls, w, lap):
    """(TJ)†TΔt + (1 − (TJ)†TJ) h into ``w.x``; whether the rows are independent."""
    m = len(w.b)
    if m > len(q) or not reflect(w.A, lap.V[:m], lap.R) >= INDEPENDENT:
        return False
    for dof in range(len(q)):
        w.x[dof] = 0.0
        if pulls:
            w.x[dof] = way.pull[dof] * (path.references[at, dof] - q[dof])
    least_norm(lap.V[:m], lap.R, w.b, w.x)
    return True


@part
def _approach(arm, way, path, at, q, lap):
    """Iterate to a waypoint, as ``following.walk`` does; the iterations, −1 for the reference."""
    rows = path.rows
    kinds, shape = rows.kinds[rows.which[at]], rows.shapes[rows.which[at]]
    size = _size(len(q), kinds[0] + kinds[1], way.twist_space)
    w, _, _ = read_program(lap.floats, 0, lap.integers, 0, size)
    if not _begin(way, path, at, q, w, lap):
        return -1
    dt = path.durations[at] if way.program else 1.0
    for iteration in range(way.iterations):
        pose_and_jacobian(arm, q, lap.pose, lap.J)
        apart, turned = twist_rows(
            kinds, shape, lap.pose, rows.targets[at], lap.J, dt, w.A, w.b, w.free, way.free_costs
        )
        if iteration > 0 and apart <= way.tolerances[0] and turned <= way.tolerances[1]:
            return iteration
        pulls = iteration == 0 or way.every_iteration
        if way.program:
            plain = _programmed(way, path, at, q, pulls, w, lap)
        else:
            plain = _closed_form(way, path, at, q, pulls, w, lap)
        if not plain:
            return -1
        largest = 0.0
        for dof in range(len(q)):
            q[dof] += w.x[dof]
            largest = max(largest, abs(w.x[dof]))
            if not abs(q[dof]) < way.sane:
                return -1
        if largest < _STANDS_STILL:
            return iteration + 1
    return way.iterations


@kernel
def follow(arm, way, path, first, q, iterations):
    """Fill the rows of q (N, nv) from ``first`` on, from the one before it.

    Args:
        arm: The robot.
        way: The method.
        path: What it follows.
        first: Number of the first waypoint that is not done, at least 1.
        q: Configurations, those before ``first`` given.
        iterations: Result, (N,).

    Returns:
        The number of the first waypoint that the reference has to look at; N if there is none.
    """
    lap = _arrays(way)
    for at in range(first, len(q)):
        if path.rows.which[at] < 0:
            return at
        if path.rows.which[at] != path.rows.which[at - 1]:
            lap.integers[q.shape[1]] = 0  # what was active last time belongs to other rows
        for dof in range(q.shape[1]):
            lap.q[dof] = q[at - 1, dof]
        iterations[at] = _approach(arm, way, path, at, lap.q, lap)
        if iterations[at] < 0:
            return at
        for dof in range(q.shape[1]):
            q[at, dof] = lap.q[dof]
    return len(q)


@kernel
def measure(arm, rows, q, errors, found):
    """Lengths of the task errors (N, 2), m and rad, and the rows UᵀJ (N, 6, nv) along a path."""
    pose, J, b, free = np.zeros(12), np.zeros((6, q.shape[1])), np.zeros(6), np.zeros((0, 0))
    for at in range(len(q)):
        pose_and_jacobian(arm, q[at], pose, J)
        number = rows.which[at]
        errors[at, 0], errors[at, 1] = twist_rows(
            rows.kinds[number], rows.shapes[number], pose, rows.targets[at], J, 1.0, found[at], b,
            free, b,
        )  # fmt: skip


@kernel
def _move(move, targets, moved):
    """Targets (N, 18) of a path that is carried by a rigid motion (12)."""
    for at in range(len(targets)):
        target, there = targets[at], moved[at]
        for i in range(3):
            a, b, c = move[3 * i], move[3 * i + 1], move[3 * i + 2]
            for j in range(3):
                there[3 * i + j] = a * target[j] + b * target[3 + j] + c * target[6 + j]
            there[9 + i] = move[9 + i] + a * target[9] + b * target[10] + c * target[11]


@kernel
def onto_start(arm, way, path, moves, q):
    """Iterate from q (K, nq), in place, to the first waypoint of paths that are moved.

    ``way`` is that of the correction: no secondary, and limits of position alone. It goes as far as
    plain steps lead; whether it arrived has to be measured.
    """
    rows = path.rows
    lap, targets = _arrays(way), rows.targets[:1].copy()
    held = Rows(rows.kinds, rows.shapes, rows.which[:1], targets)
    first = Path(held, np.ones(1), path.references[:1])
    for k in range(len(q)):
        _move(moves[k], rows.targets[:1], targets)
        _approach(arm, way, first, 0, q[k], lap)


@kernel
def _summary(errors, weight, middle, q, iterations, numbers):
    """What :func:`follow_many` says of a lap, from its configurations and errors."""
    count = len(q)
    for i in range(len(numbers)):
        numbers[i] = 0.0
    numbers[2] = math.inf
    for at in range(count):
        numbers[0] = max(numbers[0], errors[at, 0])
        numbers[1] = max(numbers[1], errors[at, 1])
        numbers[5] += iterations[at]
        for dof in range(q.shape[1]):
            offset = abs(weight[dof] * (q[at, dof] - middle[dof]))
            if weight[dof] > 0.0:
                numbers[2] = min(numbers[2], 1.0 - 2.0 * offset)
            numbers[3] += 0.5 * offset * offset / count
            if at > 0:
                numbers[4] = max(numbers[4], abs(q[at, dof] - q[at - 1, dof]))


@kernel
def follow_many(arm, way, path, measured, moves, starts, weight, middle, kept, numbers, ends):
    """:func:`follow` for many laps, each for itself.

    Args:
        arm: The robot.
        way: The method.
        path: What is followed.
        measured: The rows whose errors count.
        moves: Rigid motion of each lap's path: rotation (9) and translation (3), (K, 12).
        starts: Configurations on the first waypoints, (K, nq).
        weight: 1/(θ_max − θ_min), 0 where a joint has no range, (nv,).
        middle: θ̄, (nv,).
        kept: Result: configurations (K, N, nq); or (0, N, nq), and they are forgotten.
        numbers: Result, (K, 6): largest position and axis error, m and rad; least margin; mean z;
            largest step of a joint, rad or m; steps taken.
        ends: Result: number of the first waypoint that the reference has to look at, (K,).
    """
    rows = path.rows
    count, nq = len(rows.which), starts.shape[1]
    targets = rows.targets.copy()
    q, iterations = np.zeros((count, nq)), np.zeros(count, dtype=np.int64)
    errors, found = np.zeros((count, 2)), np.zeros((count, 6, nq))
    held = Rows(rows.kinds, rows.shapes, rows.which, targets)
    seen = Rows(measured.kinds, measured.shapes, measured.which, targets)
    moved = Path(held, path.durations, path.references)
    for lap in range(len(starts)):
        _move(moves[lap], rows.targets, targets)
        for dof in range(nq):
            q[0, dof] = starts[lap, dof]
        end = follow(arm, way, moved, 1, q, iterations)
        ends[lap] = end
        measure(arm, seen, q[:end], errors, found)
        _summary(errors, weight, middle, q[:end], iterations, numbers[lap])
        if len(kept):
            for at in range(count):
                for dof in range(nq):
                    kept[lap, at, dof] = q[at, dof] if at < end else math.nan

"""Costs of mink's own tasks from the poses and axes in MuJoCo's data, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import entry, part, plain
from qp_twist.kernel.convex import cross, dot
from qp_twist.kernel.twist_rows import quaternion, rotation_vector, turned_back

_UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_STRAIGHT = 1e-10
"""rad². Below it mink takes the Jacobian of the logarithm as 1."""


@part
def _between(a, b):
    """The quaternion ā b; as in mink, neither needs unit length."""
    u, v = (a[1], a[2], a[3]), (b[1], b[2], b[3])
    x, y, z = cross(v, u)
    return (
        a[0] * b[0] + dot(u, v),
        a[0] * b[1] - b[0] * a[1] + x,
        a[0] * b[2] - b[0] * a[2] + y,
        a[0] * b[3] - b[0] * a[3] + z,
    )


@part
def _turned_by_inverse(q, v):
    """A vector turned by q̄."""
    u = q[1], q[2], q[3]
    t = cross(u, v)
    s = cross(u, t)
    return (
        v[0] + 2.0 * (s[0] - q[0] * t[0]),
        v[1] + 2.0 * (s[1] - q[0] * t[1]),
        v[2] + 2.0 * (s[2] - q[0] * t[2]),
    )


@part
def _bend(square):
    """β = (1 − ½θ cot ½θ)/θ² and β′/θ at an angle θ, for θ²."""
    if square < _STRAIGHT:
        return 1.0 / 12.0, 1.0 / 360.0
    angle = math.sqrt(square)
    sine, tangent = math.sin(0.5 * angle), math.tan(0.5 * angle)
    beta = (1.0 - 0.5 * angle / tangent) / square
    return beta, (0.25 / (sine * sine) - 0.5 / (angle * tangent) - 2.0 * beta) / square


@part
def _unbent(v, w, beta, slope, x, y, row):
    """The inverse of SE(3)'s left Jacobian at (v, w) times (x, y), into ``row`` (6,).

    It is that of SO(3), 1 − ½[w] + β[w]², at the dual vector w + ε v.
    """
    wx, wy, vy = cross(w, x), cross(w, y), cross(v, y)
    wwx, wwy, wvy, vwy = cross(w, wx), cross(w, wy), cross(w, vy), cross(v, wy)
    along = slope * dot(v, w)
    for i in range(3):
        bent = beta * (wwx[i] + wvy[i] + vwy[i]) + along * wwy[i]
        row[i] = x[i] - 0.5 * (wx[i] + vy[i]) + bent
        row[3 + i] = y[i] - 0.5 * wy[i] + beta * wwy[i]


@plain
def _frame_rows(
    place, target, xpos, xmat, geom_xpos, geom_xmat, site_xpos, site_xmat, cdof, com, error, rows
):
    """Logarithm of a frame in its target (6,), and a row of its derivative for each joint.

    The target, quaternion and position, is in a root frame. ``place`` (2 + k, 3) has kind and id of
    the frame and of its root, then the k degrees of freedom that move the one in the other: index,
    ±1, body whose centre of mass is the origin of the axis in ``cdof``.
    """
    positions, rotations = (xpos, geom_xpos, site_xpos), (xmat, geom_xmat, site_xmat)
    R, p = rotations[place[0, 0]][place[0, 1]], positions[place[0, 0]][place[0, 1]]
    R_root, p_root = rotations[place[1, 0]][place[1, 1]], positions[place[1, 0]][place[1, 1]]
    q = _between(quaternion(_UNTURNED, R_root), quaternion(_UNTURNED, R))
    qw, qx, qy, qz = _between(target, q)
    w = rotation_vector(qw, qx, qy, qz)
    x, y, z = turned_back(R_root, p[0] - p_root[0], p[1] - p_root[1], p[2] - p_root[2])
    t = _turned_by_inverse(target, (x - target[4], y - target[5], z - target[6]))
    zero, (beta, slope) = (0.0, 0.0, 0.0), _bend(dot(w, w))
    _unbent(zero, w, beta, slope, t, w, error)
    v = -error[0], -error[1], -error[2]
    w = -w[0], -w[1], -w[2]
    if dot(w, w) < _STRAIGHT:
        v, w = zero, zero
    for i in range(len(place) - 2):
        axis, sign, centre = cdof[place[2 + i, 0]], place[2 + i, 1], com[place[2 + i, 2]]
        turn = sign * axis[0], sign * axis[1], sign * axis[2]
        x, y, z = cross(turn, (p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]))
        x, y, z = x + sign * axis[3], y + sign * axis[4], z + sign * axis[5]
        turn = turned_back(R, turn[0], turn[1], turn[2])
        _unbent(v, w, beta, slope, turned_back(R, x, y, z), turn, rows[i])


@plain
def _add_frame(dofs, cost, gain, error, rows, H, c):
    """Add a frame's cost to the lower half of H and to c; return the square of its error."""
    missed = 0.0
    for k in range(6):
        error[k] *= gain * cost[k]
        missed += error[k] * error[k]
    for i in range(len(dofs)):
        a, slope = dofs[i, 0], 0.0
        for k in range(6):
            rows[i, k] *= cost[k]
            slope += rows[i, k] * error[k]
        c[a] += slope
        for j in range(i + 1):
            entry = 0.0
            for k in range(6):
                entry += rows[i, k] * rows[j, k]
            H[a, dofs[j, 0]] += entry
    return missed


@plain
def _add_posture(joints, q, target, cost, gain, H, c):
    """The same of a posture; ``joints`` (k, 3): degree of freedom, place in q, whether it turns."""
    missed = 0.0
    for i in range(len(joints)):
        dof, at = joints[i, 0], joints[i, 1]
        e, count = (q[at] - target[at], 0.0, 0.0), 1
        if joints[i, 2]:
            qw, qx, qy, qz = _between(target[at : at + 4], q[at : at + 4])
            e, count = rotation_vector(qw, qx, qy, qz), 3
        for k in range(count):
            weight = cost[dof + k]
            error = gain * weight * e[k]
            missed += error * error
            c[dof + k] += weight * error
            H[dof + k, dof + k] += weight * weight
    return missed


@entry
def write_frame_rows(
    place, target, xpos, xmat, geom_xpos, geom_xmat, site_xpos, site_xmat, cdof, com, sign, rows, A
):
    """Write sign · derivative to A (6, nv), zeros; sign · logarithm to the last of ``rows``."""
    error = rows[len(rows) - 1]
    _frame_rows(
        place[1:], target, xpos, xmat, geom_xpos, geom_xmat, site_xpos, site_xmat, cdof, com,
        error, rows,
    )  # fmt: skip
    for k in range(6):
        error[k] *= sign
        for i in range(place[0, 1]):
            A[k, place[3 + i, 0]] = sign * rows[i, k]


@entry
def add_task_costs(
    places, numbers, settings, q, xpos, xmat, geom_xpos, geom_xmat, site_xpos, site_xmat, cdof, com,
    rows, H, c,
):  # fmt: skip
    """Add costs ½‖W Δq − e‖² of mink's tasks to the lower half of H and to c; return their ∑ μ.

    ``settings`` (2 T,) are gain and damping of each task, ``numbers`` its target and cost, one
    task after the other. So are ``places`` (·, 3): a row with the number of its frames, 0 or 2,
    and of its joints, then what :func:`_add_posture` or :func:`_frame_rows` takes. The rest is
    MuJoCo's, but for ``rows`` (nv + 1, 6), which is changed.
    """
    number, at, mu, error = 0, 0, 0.0, rows[len(c)]
    for task in range(len(settings) // 2):
        gain, frames = settings[2 * task], places[at, 0]
        middle = number + (7 if frames else len(q))
        end, last = middle + (6 if frames else len(c)), at + 1 + frames + places[at, 1]
        target, cost, place = numbers[number:middle], numbers[middle:end], places[at + 1 : last]
        if frames:
            _frame_rows(
                place, target, xpos, xmat, geom_xpos, geom_xmat, site_xpos, site_xmat, cdof, com,
                error, rows,
            )  # fmt: skip
            missed = _add_frame(place[2:], cost, gain, error, rows, H, c)
        else:
            missed = _add_posture(place, q, target, cost, gain, H, c)
        mu += settings[2 * task + 1] * missed
        number, at = end, last
    return mu

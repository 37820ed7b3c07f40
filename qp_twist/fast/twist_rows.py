"""Task rows of one frame, compiled: the same equations as ``geometry`` and ``TwistTask``."""

from __future__ import annotations

import math

from numba import njit

WORLD, BODY, TARGET = 0, 1, 2
"""What the axes of a projector are fixed to."""
NONE, LINE, PLANE, FULL = 0, 1, 2, 3
"""Kinds of projectors: their ranks."""
_TINY = 1e-12


@njit(cache=True, error_model="numpy")
def geodesic(start, end, out):
    """Rotation vector of the shortest rotation that takes one unit vector to another."""
    cosine = start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    sign = -1.0 if cosine > 0.0 else 1.0
    x, y, z = end[0] + sign * start[0], end[1] + sign * start[1], end[2] + sign * start[2]
    out[0] = start[1] * z - start[2] * y
    out[1] = start[2] * x - start[0] * z
    out[2] = start[0] * y - start[1] * x
    sine = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if sine < _TINY:
        if cosine <= 0.0:
            _half_turn(start, out)
        return
    scale = math.atan2(sine, cosine) / sine
    out[0] *= scale
    out[1] *= scale
    out[2] *= scale


@njit(cache=True, error_model="numpy")
def _half_turn(e, out):
    """π about a fixed axis perpendicular to e: the one that is furthest from e's smallest entry."""
    least = 0
    if abs(e[1]) < abs(e[least]):
        least = 1
    if abs(e[2]) < abs(e[least]):
        least = 2
    hx, hy, hz = 0.0, 0.0, 0.0
    if least == 0:
        hx = 1.0
    elif least == 1:
        hy = 1.0
    else:
        hz = 1.0
    x, y, z = e[1] * hz - e[2] * hy, e[2] * hx - e[0] * hz, e[0] * hy - e[1] * hx
    scale = math.pi / math.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit(cache=True, error_model="numpy")
def quaternion(R, wxyz):
    """Unit quaternion of a rotation matrix, by the largest of its four entries (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    most, which = trace, -1
    for i in range(3):
        if R[i, i] > most:
            most, which = R[i, i], i
    if which < 0:
        s = math.sqrt(1.0 + trace) * 2.0
        wxyz[0] = 0.25 * s
        wxyz[1] = (R[2, 1] - R[1, 2]) / s
        wxyz[2] = (R[0, 2] - R[2, 0]) / s
        wxyz[3] = (R[1, 0] - R[0, 1]) / s
        return
    i, j, k = which, (which + 1) % 3, (which + 2) % 3
    s = math.sqrt(1.0 + R[i, i] - R[j, j] - R[k, k]) * 2.0
    wxyz[0] = (R[k, j] - R[j, k]) / s
    wxyz[1 + i] = 0.25 * s
    wxyz[1 + j] = (R[j, i] + R[i, j]) / s
    wxyz[1 + k] = (R[k, i] + R[i, k]) / s


@njit(cache=True, error_model="numpy")
def _rotation_vector(wxyz, out):
    """Of a unit quaternion, of length at most π, rad."""
    sign = -1.0 if wxyz[0] < 0.0 else 1.0
    x, y, z = sign * wxyz[1], sign * wxyz[2], sign * wxyz[3]
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0
    if sine >= _TINY:
        scale = 2.0 * math.atan2(sine, sign * wxyz[0]) / sine
    out[0], out[1], out[2] = scale * x, scale * y, scale * z


@njit(cache=True, error_model="numpy")
def _twist_about(wxyz, axis, out):
    """The part of a rotation that turns about an axis, in (−π, π], as a vector."""
    along = wxyz[1] * axis[0] + wxyz[2] * axis[1] + wxyz[3] * axis[2]
    if math.hypot(along, wxyz[0]) < _TINY:
        return
    angle = 2.0 * math.atan2(along, wxyz[0])
    if angle > math.pi:
        angle -= 2.0 * math.pi
    elif angle <= -math.pi:
        angle += 2.0 * math.pi
    for i in range(3):
        out[i] = angle * axis[i]


@njit(cache=True, error_model="numpy")
def angular_error(R, R_d, kind, axis, moves_with_body, work, out):
    """Δω of a projector's kind and world axis, (3,): as ``geometry.angular_error`` states it.

    ``work`` is (4, 4).
    """
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    if kind == NONE:
        return
    E, wxyz, turned = work[:3, :3], work[3], work[:3, 3]
    for i in range(3):
        for j in range(3):
            E[i, j] = R_d[i, 0] * R[j, 0] + R_d[i, 1] * R[j, 1] + R_d[i, 2] * R[j, 2]
    if kind == PLANE:
        for i in range(3):
            turned[i] = 0.0
            for j in range(3):
                turned[i] += (E[i, j] if moves_with_body else E[j, i]) * axis[j]
        if moves_with_body:
            geodesic(axis, turned, out)
        else:
            geodesic(turned, axis, out)
        return
    quaternion(E, wxyz)
    if kind == FULL:
        _rotation_vector(wxyz, out)
    else:
        _twist_about(wxyz, axis, out)


@njit(cache=True, error_model="numpy")
def _shorten(vector, longest):
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > longest:
        scale = longest / length
        vector[0] *= scale
        vector[1] *= scale
        vector[2] *= scale


@njit(cache=True, error_model="numpy")
def _in_world(kind, turn, fixed, shape, basis, axis):
    """Basis (3, kind) and axis (3,) of a block in the world; R of the frame they are fixed to."""
    given, given_axis = shape[:9].reshape(3, 3), shape[9:12]
    stays = fixed or kind in (FULL, NONE)
    for i in range(3):
        if stays:
            axis[i] = given_axis[i]
        else:
            axis[i] = (
                turn[i, 0] * given_axis[0] + turn[i, 1] * given_axis[1] + turn[i, 2] * given_axis[2]
            )
        for j in range(kind):
            if stays:
                basis[i, j] = given[i, j]
            else:
                basis[i, j] = (
                    turn[i, 0] * given[0, j] + turn[i, 1] * given[1, j] + turn[i, 2] * given[2, j]
                )


@njit(cache=True, error_model="numpy")
def _linear_error(kind, basis, position, target, error):
    """U Uᵀ(p_d − p), (3,)."""
    dx, dy, dz = target[0] - position[0], target[1] - position[1], target[2] - position[2]
    if kind == FULL:
        error[0], error[1], error[2] = dx, dy, dz
        return
    error[0], error[1], error[2] = 0.0, 0.0, 0.0
    for j in range(kind):
        along = basis[0, j] * dx + basis[1, j] * dy + basis[2, j] * dz
        for i in range(3):
            error[i] += basis[i, j] * along


@njit(cache=True, error_model="numpy")
def _rows_of(kind, basis, error, gain, dt, twist, J, A, b):
    """UᵀJ and Uᵀ(k Δt/dt + t_ff) of a block, with its three rows of J."""
    for j in range(kind):
        b[j] = 0.0
        for i in range(3):
            b[j] += basis[i, j] * (gain * error[i] / dt + twist[i])
        for column in range(J.shape[1]):
            A[j, column] = (
                basis[0, j] * J[0, column] + basis[1, j] * J[1, column] + basis[2, j] * J[2, column]
            )


@njit(cache=True, error_model="numpy")
def _free_of(kind, axis, cost, J, free):
    """(1 − M) J of a block times its cost, three rows."""
    for column in range(J.shape[1]):
        along = axis[0] * J[0, column] + axis[1] * J[1, column] + axis[2] * J[2, column]
        for i in range(3):
            value = 0.0
            if kind == NONE:
                value = J[i, column]
            elif kind == PLANE:
                value = along * axis[i]
            elif kind == LINE:
                value = J[i, column] - along * axis[i]
            free[i, column] = cost * value


@njit(cache=True, error_model="numpy")
def twist_rows(kinds, shape, pose, target, J, dt, A, b, free, free_costs, work):
    r"""Rows A q̇ = b of one task, and the rows of what it leaves free, times their costs.

    Args:
        kinds: Of the linear and the angular block, and what their axes are fixed to, (3,).
        shape: Bases (3, 3) of the two blocks, padded with zeros, each with its axis (3,) behind it;
            then gain and the longest steps, m and rad: (27,).
        pose: R (9) and p (3) of the frame.
        target: R_d (9), p_d (3) and the twist (6) of the target.
        J: World-aligned Jacobian, (6, nv).
        dt: Length of the step, s.
        A: Result, (r, nv).
        b: Result, (r,).
        free: Result, (6, nv), or (0, nv) where it is not wanted: 1 − T, three rows a block.
        free_costs: Of the linear and the angular rows, (2,).
        work: Workspace, (12, 4).
    """
    R, R_d = pose[:9].reshape(3, 3), target[:9].reshape(3, 3)
    body = kinds[2] == BODY
    turn = R if body else R_d
    basis, axis, error = work[4:7, :3], work[8:11, 0], work[11, :3]
    row = 0
    for block in range(2):
        kind, J_block = kinds[block], J[3 * block : 3 * block + 3]
        _in_world(kind, turn, kinds[2] == WORLD, shape[12 * block :], basis, axis)
        if block == 0:
            _linear_error(kind, basis, pose[9:], target[9:12], error)
        else:
            angular_error(R, R_d, kind, axis, body, work[:4], error)
        _shorten(error, shape[25 + block])
        _rows_of(
            kind, basis, error, shape[24], dt, target[12 + 3 * block :], J_block,
            A[row:], b[row:],
        )  # fmt: skip
        row += kind
        if len(free):
            _free_of(kind, axis, free_costs[block], J_block, free[3 * block : 3 * block + 3])

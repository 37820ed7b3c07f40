"""Task rows of one frame: the equations of ``geometry`` and ``TwistTask``, in scalars."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain

WORLD, BODY, TARGET = 0, 1, 2
"""Frame to which the axes of a projector are fixed."""
NONE, LINE, PLANE, FULL = 0, 1, 2, 3
"""Kinds of projectors, equal to their ranks."""
_TINY = 1e-12


@part
def geodesic(ax, ay, az, bx, by, bz):
    """Rotation vector of the shortest rotation that takes one unit vector to another."""
    cosine = ax * bx + ay * by + az * bz
    sign = -1.0 if cosine > 0.0 else 1.0
    x, y, z = bx + sign * ax, by + sign * ay, bz + sign * az
    nx, ny, nz = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    sine = math.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 1.0
    if sine >= _TINY:
        scale = math.atan2(sine, cosine) / sine
    elif cosine <= 0.0:
        nx, ny, nz = _perpendicular(ax, ay, az)
        scale = math.pi
    return scale * nx, scale * ny, scale * nz


@part
def _perpendicular(x, y, z):
    """A fixed unit vector perpendicular to e: e × the axis of e's smallest entry."""
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        u, v, w = 0.0, z, -y
    elif abs(y) <= abs(z):
        u, v, w = -z, 0.0, x
    else:
        u, v, w = y, -x, 0.0
    length = math.sqrt(u * u + v * v + w * w)
    return u / length, v / length, w / length


@part
def quaternion(pose, target):
    """w, x, y, z of R_d Rᵀ, by the largest of its four entries (Shepperd 1978)."""
    a = target[0] * pose[0] + target[1] * pose[1] + target[2] * pose[2]
    b = target[0] * pose[3] + target[1] * pose[4] + target[2] * pose[5]
    c = target[0] * pose[6] + target[1] * pose[7] + target[2] * pose[8]
    d = target[3] * pose[0] + target[4] * pose[1] + target[5] * pose[2]
    e = target[3] * pose[3] + target[4] * pose[4] + target[5] * pose[5]
    f = target[3] * pose[6] + target[4] * pose[7] + target[5] * pose[8]
    g = target[6] * pose[0] + target[7] * pose[1] + target[8] * pose[2]
    h = target[6] * pose[3] + target[7] * pose[4] + target[8] * pose[5]
    i = target[6] * pose[6] + target[7] * pose[7] + target[8] * pose[8]
    trace = a + e + i
    if trace >= a and trace >= e and trace >= i:
        s = 2.0 * math.sqrt(1.0 + trace)
        return 0.25 * s, (h - f) / s, (c - g) / s, (d - b) / s
    if a >= e and a >= i:
        s = 2.0 * math.sqrt(1.0 + a - e - i)
        return (h - f) / s, 0.25 * s, (d + b) / s, (g + c) / s
    if e >= i:
        s = 2.0 * math.sqrt(1.0 + e - i - a)
        return (c - g) / s, (d + b) / s, 0.25 * s, (h + f) / s
    s = 2.0 * math.sqrt(1.0 + i - a - e)
    return (d - b) / s, (g + c) / s, (h + f) / s, 0.25 * s


@part
def rotation_vector(w, x, y, z):
    """Rotation vector of a unit quaternion, of length at most π, rad."""
    sine = math.sqrt(x * x + y * y + z * z)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    scale = 2.0
    if sine >= _TINY:
        scale = 2.0 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


@part
def _turned_about(w, along):
    """Angle in (−π, π] of the part of a rotation that turns about an axis."""
    if math.hypot(along, w) < _TINY:
        return 0.0
    angle = 2.0 * math.atan2(along, w)
    if angle > math.pi:
        angle -= 2.0 * math.pi
    elif angle <= -math.pi:
        angle += 2.0 * math.pi
    return angle


@part
def _turned(M, x, y, z):
    """M v, for the rotation in the first nine entries of M."""
    return (
        M[0] * x + M[1] * y + M[2] * z,
        M[3] * x + M[4] * y + M[5] * z,
        M[6] * x + M[7] * y + M[8] * z,
    )


@part
def turned_back(M, x, y, z):
    """Mᵀ v."""
    return (
        M[0] * x + M[3] * y + M[6] * z,
        M[1] * x + M[4] * y + M[7] * z,
        M[2] * x + M[5] * y + M[8] * z,
    )


@part
def angular_error(pose, target, kind, x, y, z, moves_with_body):
    """Δω for a projector's kind and world axis: see ``geometry.angular_error``."""
    if kind == NONE:
        return 0.0, 0.0, 0.0
    if kind == PLANE:
        if moves_with_body:  # R_d Rᵀ maps the axis to its desired direction
            ux, uy, uz = turned_back(pose, x, y, z)
            ux, uy, uz = _turned(target, ux, uy, uz)
            return geodesic(x, y, z, ux, uy, uz)
        ux, uy, uz = turned_back(target, x, y, z)
        ux, uy, uz = _turned(pose, ux, uy, uz)
        return geodesic(ux, uy, uz, x, y, z)
    qw, qx, qy, qz = quaternion(pose, target)
    if kind == FULL:
        return rotation_vector(qw, qx, qy, qz)
    angle = _turned_about(qw, qx * x + qy * y + qz * z)
    return angle * x, angle * y, angle * z


@part
def linear_error(pose, target, kind, shape, turn, stays):
    """U Uᵀ(p_d − p)."""
    x, y, z = target[9] - pose[9], target[10] - pose[10], target[11] - pose[11]
    if kind == FULL:
        return x, y, z
    ex, ey, ez = 0.0, 0.0, 0.0
    for j in range(kind):
        u, v, w = _column(shape, j, turn, stays)
        along = u * x + v * y + w * z
        ex += along * u
        ey += along * v
        ez += along * w
    return ex, ey, ez


@part
def _column(shape, at, turn, stays):
    """A column of a basis, which begins at ``at`` of ``shape`` row by row, in the world."""
    x, y, z = shape[at], shape[at + 3], shape[at + 6]
    if stays:
        return x, y, z
    return _turned(turn, x, y, z)


@part
def _axis(shape, at, turn, stays):
    """The axis, which begins at ``at`` of ``shape``, in the world."""
    if stays:
        return shape[at], shape[at + 1], shape[at + 2]
    return _turned(turn, shape[at], shape[at + 1], shape[at + 2])


@part
def _left(kind, x, y, z, u, v, w):
    """(1 − M) of a vector, for a projector's kind and axis."""
    along = x * u + y * v + z * w
    if kind == PLANE:
        return along * x, along * y, along * z
    if kind == LINE:
        return u - along * x, v - along * y, w - along * z
    if kind == FULL:
        return 0.0, 0.0, 0.0
    return u, v, w


@plain
def _free_of(kind, x, y, z, cost, first, J, free):
    """(1 − M) J of a block times its cost, three rows from ``first`` on."""
    for column in range(J.shape[1]):
        u, v, w = _left(kind, x, y, z, J[first, column], J[first + 1, column], J[first + 2, column])
        free[first, column] = cost * u
        free[first + 1, column] = cost * v
        free[first + 2, column] = cost * w


@part
def desired_velocity(block, kinds, shape, pose, target, dt):
    """Axis and desired velocity, in the world, of the linear (0) or angular (1) block.

    Arguments are those of :func:`twist_rows`; the last result is the length of the error before
    clamping, m or rad.
    """
    body = kinds[2] == BODY
    turn = pose if body else target
    kind, at, first = kinds[block], 12 * block, 12 + 3 * block
    stays = kinds[2] == WORLD or kind in (FULL, NONE)
    x, y, z = _axis(shape, at + 9, turn, stays)
    if block == 0:
        ex, ey, ez = linear_error(pose, target, kind, shape, turn, stays)
    else:
        ex, ey, ez = angular_error(pose, target, kind, x, y, z, body)
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    share = shape[24] / dt
    if length > shape[25 + block]:
        share *= shape[25 + block] / length
    ex = share * ex + target[first]
    ey = share * ey + target[first + 1]
    ez = share * ez + target[first + 2]
    return x, y, z, ex, ey, ez, length


@plain
def in_basis(kinds, shape, pose, target, twist, b):
    """Uᵀt of a twist (6,) into b (r,)."""
    turn = pose if kinds[2] == BODY else target
    row = 0
    for block in range(2):
        kind, first = kinds[block], 3 * block
        stays = kinds[2] == WORLD or kind in (FULL, NONE)
        for j in range(kind):
            u, v, w = _column(shape, 12 * block + j, turn, stays)
            b[row] = u * twist[first] + v * twist[first + 1] + w * twist[first + 2]
            row += 1


@plain
def twist_rows(kinds, shape, pose, target, J, dt, A, b, free, free_costs):
    r"""Rows A q̇ = b of one task, and its rows of 1 − T times their costs.

    ``kinds`` (3,) are those of the linear and the angular block, and the frame of their axes;
    ``shape`` (27,) has for each block its basis (3, 3), padded with zeros, and its axis (3,), then
    the gain and the largest steps, m and rad; ``pose`` R (9) and p (3), ``target`` R_d (9), p_d (3)
    and twist (6); J (6, nv) is world-aligned. Results are A (r, nv), b (r,) and ``free``, three
    rows of 1 − T for each block, (6, nv), or (0, nv) to skip them. Returned are the lengths of the
    linear and the angular error before clamping, m and rad.
    """
    turn = pose if kinds[2] == BODY else target
    row, apart, turned = 0, 0.0, 0.0
    for block in range(2):
        kind, at, first = kinds[block], 12 * block, 3 * block
        stays = kinds[2] == WORLD or kind in (FULL, NONE)
        x, y, z, ex, ey, ez, length = desired_velocity(block, kinds, shape, pose, target, dt)
        apart, turned = turned, length
        for j in range(kind):
            u, v, w = _column(shape, at + j, turn, stays)
            b[row] = u * ex + v * ey + w * ez
            for column in range(J.shape[1]):
                A[row, column] = (
                    u * J[first, column] + v * J[first + 1, column] + w * J[first + 2, column]
                )
            row += 1
        if free.shape[0]:
            _free_of(kind, x, y, z, free_costs[block], first, J, free)
    return apart, turned

"""Random steps and their referee, compiled, from the numbers of the MuJoCo model alone.

Nothing here calls the package: neither its kinematics nor its rows, bounds, costs or solvers. For a
step the referee states

    min ½‖x − h‖²  (or, in twist space, ½‖F(x − h)‖²)   s.t.   A x = s b,   lower ≤ x ≤ upper

anew from q and the target: kinematics along the chain of bodies, A and b in a basis of its own
across the tool axis, the bounds from ranges and speed limits. Of a velocity x and a scale s that
are called solved it says

- residual: max |A x − s b|, refused above 1e-8 (1 + max |b|);
- excess: how far x is beyond a bound at most, refused above 1e-8 (1 + max |x|);
- gradient: max |x − clip(x − (g + Aᵀy)/η, lower, upper)| with the gradient g of the cost and its
  largest curvature η (1 in joint space). It is 0 for some y exactly at the optimum (Karush, Kuhn
  and Tucker). y comes from least squares on the joints that touch no bound, by Gram and Schmidt
  with pivoting. Refused above 1e-6 (1 + max |x|);
- slack, where s < 1: every y with bᵀy = 1 proves that no scale is larger than
  Σᵢ max(vᵢ lowerᵢ, vᵢ upperᵢ), v = Aᵀy (duality of linear programs); slack is by how much, relative
  to s, that is above s. y comes from least squares, weighted by the room of each joint. Refused
  above 1e-7.

The excess counts from the ends of the ranges; optimal is what is optimal in bounds that end a hair
before them, as `qp_twist.PositionLimit` says: 10⁻¹² of the end, or of 1 rad or m.

The first two are facts. The others are proofs by a y: where gradient and slack are small, x and s
are optimal. Where they are not, another y might prove it, and whoever asks has to solve the program
by other means to know.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit

Array = np.ndarray
ROWS, BOUNDS, GRADIENT, SLACK = 1e-8, 1e-8, 1e-6, 1e-7
"""Tolerances, see above."""
TOUCHES = (1e-9, 1e-11, 3e-8)
"""A joint that is so close to its bound, rad/s or m/s, does not count as free. Where the first does
not prove the optimum, as at a reduced scale with hardly any room between the bounds, the others are
tried."""
HAIR = 1e-12
POINT, AXIS, POSE = 3, 5, 6
"""Ranks of the tasks: position; position and direction of the tool's z; and whole orientation."""
UNLIMITED = 2.0
"""Joints without a range are drawn from ±2 rad or m."""

compiled = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})


class Chain(NamedTuple):
    """The joints between the world and a site, and their limits."""

    fixed: Array
    """From each joint (the first: the world) to the next, the last one to the site: rotation, row
    by row (9), and translation, m (3); (n + 1, 12)."""
    axes: Array
    """Of the joints, in the frame that they turn, (n, 3)."""
    zero: Array
    """Coordinates at which the fixed parts count, (n,)."""
    slides: Array
    """1 for a slide, 0 for a hinge, (n,)."""
    lower: Array
    """Ranges, rad or m, (n,); infinite where there is none."""
    upper: Array


def quaternion_matrix(quaternion: Array) -> Array:
    """R of a quaternion w, x, y, z."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def chain_of(model: mujoco.MjModel, site: str) -> Chain:
    """From the arrays of a model all of whose joints are hinges and slides that move the site."""
    number = model.site(site).id
    bodies, body = [], int(model.site_bodyid[number])
    while body > 0:
        bodies, body = [body, *bodies], int(model.body_parentid[body])
    fixed, joints, R, p = [], [], np.eye(3), np.zeros(3)
    for body in bodies:
        p = p + R @ model.body_pos[body]
        R = R @ quaternion_matrix(model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            fixed.append(np.concatenate([R.ravel(), p + R @ model.jnt_pos[joint]]))
            joints.append(joint)
            R, p = np.eye(3), -model.jnt_pos[joint]  # from here on in the frame that it turns
    p, R = p + R @ model.site_pos[number], R @ quaternion_matrix(model.site_quat[number])
    fixed.append(np.concatenate([R.ravel(), p]))
    types = model.jnt_type[joints]
    assert joints == list(range(model.nv)) and np.isin(types, [2, 3]).all()
    limited = model.jnt_limited.astype(bool)
    return Chain(
        np.array(fixed), model.jnt_axis[joints].copy(), model.qpos0.copy(),
        (types == mujoco.mjtJoint.mjJNT_SLIDE).astype(np.int64),
        np.where(limited, model.jnt_range[:, 0], -np.inf),
        np.where(limited, model.jnt_range[:, 1], np.inf),
    )  # fmt: skip


@compiled
def turn(R, ax, ay, az, sin, versine):
    """R times the rotation about a unit axis (Rodrigues), in place."""
    c = 1.0 - versine
    xx, yy, zz = c + versine * ax * ax, c + versine * ay * ay, c + versine * az * az
    xy, xz, yz = versine * ax * ay, versine * ax * az, versine * ay * az
    for i in range(3):
        u, v, w = R[i, 0], R[i, 1], R[i, 2]
        R[i, 0] = u * xx + v * (xy + sin * az) + w * (xz - sin * ay)
        R[i, 1] = u * (xy - sin * az) + v * yy + w * (yz + sin * ax)
        R[i, 2] = u * (xz + sin * ay) + v * (yz - sin * ax) + w * zz


@compiled
def kinematics(chain, q, R, p, J):
    """Pose of the site into R (3, 3) and p (3,), its Jacobian into J (6, n): (linear, angular)."""
    n = len(q)
    for i in range(3):
        p[i] = 0.0
        for j in range(3):
            R[i, j] = 1.0 if i == j else 0.0
    for joint in range(n + 1):
        F = chain.fixed[joint]
        for i in range(3):
            u, v, w = R[i, 0], R[i, 1], R[i, 2]
            p[i] += u * F[9] + v * F[10] + w * F[11]
            R[i, 0] = u * F[0] + v * F[3] + w * F[6]
            R[i, 1] = u * F[1] + v * F[4] + w * F[7]
            R[i, 2] = u * F[2] + v * F[5] + w * F[8]
        if joint == n:
            break
        x, y, z = chain.axes[joint, 0], chain.axes[joint, 1], chain.axes[joint, 2]
        travel = q[joint] - chain.zero[joint]
        for i in range(3):
            J[3 + i, joint] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            J[i, joint] = p[i]  # a point on the axis, until the site is known
        if chain.slides[joint]:
            for i in range(3):
                p[i] += travel * J[3 + i, joint]
        else:
            half = math.sin(0.5 * travel)
            turn(R, x, y, z, math.sin(travel), 2.0 * half * half)
    for joint in range(n):
        u, v, w = J[3, joint], J[4, joint], J[5, joint]
        if chain.slides[joint]:
            J[0, joint], J[1, joint], J[2, joint] = u, v, w
            J[3, joint] = J[4, joint] = J[5, joint] = 0.0
        else:
            x, y, z = p[0] - J[0, joint], p[1] - J[1, joint], p[2] - J[2, joint]
            J[0, joint], J[1, joint], J[2, joint] = v * z - w * y, w * x - u * z, u * y - v * x


def random_problems(chain: Chain, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Configurations anywhere in the ranges, (count, n), and targets near by, (count, 4, 4).

    A target is 10⁻⁶ to 10⁻¹ of a decimetre and of 0.3 rad away, times normally distributed vectors.
    """
    bounded = np.isfinite(chain.lower) & np.isfinite(chain.upper)
    lower = np.where(bounded, chain.lower, -UNLIMITED)
    upper = np.where(bounded, chain.upper, UNLIMITED)
    q = rng.uniform(lower, upper, (count, len(lower)))
    away = 10.0 ** rng.uniform(-6.0, -1.0, (count, 1))
    moved, turned = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    targets = np.zeros((count, 4, 4))
    targets_near(chain, q, away[:, 0], moved, turned, targets)
    return q, targets


@compiled
def targets_near(chain, q, away, moved, turned, targets):
    """Poses of the site at q (K, n), each moved by 0.1 and turned by 0.3 times ``away`` (K,)."""
    p, J, R = np.zeros(3), np.zeros((6, q.shape[1])), np.zeros((3, 3))
    for k in range(len(q)):
        kinematics(chain, q[k], R, p, J)
        x, y, z = 0.3 * away[k] * turned[k, 0], 0.3 * away[k] * turned[k, 1], turned[k, 2]
        z *= 0.3 * away[k]
        angle = math.sqrt(x * x + y * y + z * z)
        half = math.sin(0.5 * angle)
        # In world axes, from the left: the transpose of Rᵀ times the rotation the other way.
        back = R.T.copy()
        turn(back, x / angle, y / angle, z / angle, -math.sin(angle), 2.0 * half * half)
        for i in range(3):
            targets[k, i, 3] = p[i] + 0.1 * away[k] * moved[k, i]
            for j in range(3):
                targets[k, i, j] = back[j, i]
        targets[k, 3, 3] = 1.0


@compiled
def across(x, y, z):
    """Two unit vectors across a unit vector (Duff et al., JCGT 6, 2017)."""
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return 1.0 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@compiled
def rotation_between(R, target, kind):
    """Rotation vector that the task asks for: of R_d Rᵀ, or the shortest that turns z to z_d."""
    if kind == AXIS:
        ax, ay, az, bx, by, bz = R[0, 2], R[1, 2], R[2, 2], target[0, 2], target[1, 2], target[2, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        cosine = ax * bx + ay * by + az * bz
    else:
        # The skew part of R_d Rᵀ is sin φ times the axis, its trace 1 + 2 cos φ.
        x = y = z = trace = 0.0
        for k in range(3):
            x += 0.5 * (target[2, k] * R[1, k] - target[1, k] * R[2, k])
            y += 0.5 * (target[0, k] * R[2, k] - target[2, k] * R[0, k])
            z += 0.5 * (target[1, k] * R[0, k] - target[0, k] * R[1, k])
            trace += target[0, k] * R[0, k] + target[1, k] * R[1, k] + target[2, k] * R[2, k]
        cosine = 0.5 * (trace - 1.0)
    sine = math.sqrt(x * x + y * y + z * z)
    share = math.atan2(sine, cosine) / sine if sine > 0.0 else 1.0
    return share * x, share * y, share * z


@compiled
def state(chain, kind, speed, gain, dt, q, target, R, p, J, A, b, ends, box, h, F):
    """What a step has to do.

    Args:
        chain: Of the robot; kind, speed, gain and dt as in :func:`judge`.
        q: Configuration, (n,).
        target: Pose, (4, 4).
        R: Result: the site's rotation, (3, 3).
        p: Result: its position, (3,).
        J: Result: its Jacobian, (6, n).
        A: Result: rows of the task, (m, n).
        b: Result: their right-hand sides at full speed, (m,).
        ends: Result: lower and upper bounds, (2, n).
        box: Result: the same a hair before the ends of the ranges, (2, n).
        h: Result: desired velocity, (n,).
        F: Result: row of the rotation that ``AXIS`` leaves free, (n,).
    """
    n = len(q)
    kinematics(chain, q, R, p, J)
    for i in range(3):
        b[i] = (target[i, 3] - p[i]) / dt
        for j in range(n):
            A[i, j] = J[i, j]
    if kind != POINT:
        x, y, z = rotation_between(R, target, kind)
    if kind == AXIS:
        ax, ay, az = R[0, 2], R[1, 2], R[2, 2]
        ux, uy, uz, vx, vy, vz = across(ax, ay, az)
        b[3], b[4] = (ux * x + uy * y + uz * z) / dt, (vx * x + vy * y + vz * z) / dt
        for j in range(n):
            A[3, j] = ux * J[3, j] + uy * J[4, j] + uz * J[5, j]
            A[4, j] = vx * J[3, j] + vy * J[4, j] + vz * J[5, j]
            F[j] = ax * J[3, j] + ay * J[4, j] + az * J[5, j]
    elif kind == POSE:
        b[3], b[4], b[5] = x / dt, y / dt, z / dt
        for i in range(3, 6):
            for j in range(n):
                A[i, j] = J[i, j]
    for j in range(n):
        low, high = chain.lower[j], chain.upper[j]
        ends[0, j] = max(-speed, -max(q[j] - low, 0.0) / dt)
        ends[1, j] = min(speed, max(high - q[j], 0.0) / dt)
        box[0, j], box[1, j], h[j] = ends[0, j], ends[1, j], 0.0
        if high - low < math.inf:
            before, after = HAIR * max(1.0, abs(low)), HAIR * max(1.0, abs(high))
            box[0, j] = max(-speed, -max(q[j] - low - before, 0.0) / dt)
            box[1, j] = min(speed, max(high - q[j] - after, 0.0) / dt)
            h[j] = gain * (0.5 * (low + high) - q[j]) / dt


class Stated(NamedTuple):
    """Results of :func:`state`."""

    A: Array
    b: Array
    ends: Array
    box: Array
    h: Array
    F: Array


def stated(
    chain: Chain, kind: int, speed: float, gain: float, dt: float, q: Array, target: Array
) -> Stated:
    """What a step has to do, in new arrays; arguments as in :func:`state`."""
    n, m = len(q), kind
    ends, box = np.zeros((2, 2, n))
    found = Stated(np.zeros((m, n)), np.zeros(m), ends, box, np.zeros(n), np.zeros(n))
    pose = np.zeros((3, 3)), np.zeros(3), np.zeros((6, n))
    state(chain, kind, speed, gain, dt, q, target, *pose, *found)
    return found


@compiled
def orthogonalise(M, Q, T, order):  # noqa: PLR0912
    """Rows M[order] (m, n) = Tᵀ Q by Gram and Schmidt, twice, the longest first; their rank."""
    m, n = M.shape
    for i in range(m):
        order[i] = i
        for j in range(n):
            Q[i, j] = M[i, j]
    first = 0.0
    for row in range(m):
        best, most = row, -1.0
        for i in range(row, m):
            total = 0.0
            for j in range(n):
                total += Q[i, j] * Q[i, j]
            if total > most:
                best, most = i, total
        if row == 0:
            first = most
        if not most > 1e-24 * first:
            return row
        if best != row:
            order[row], order[best] = order[best], order[row]
            for j in range(n):
                Q[row, j], Q[best, j] = Q[best, j], Q[row, j]
            for i in range(row):
                T[i, row], T[i, best] = T[i, best], T[i, row]
        for i in range(row):  # once more: what rounding has left of those before
            total = 0.0
            for j in range(n):
                total += Q[i, j] * Q[row, j]
            T[i, row] += total
            for j in range(n):
                Q[row, j] -= total * Q[i, j]
        most = 0.0
        for j in range(n):
            most += Q[row, j] * Q[row, j]
        if not most > 1e-24 * first:
            return row
        length = math.sqrt(most)
        T[row, row] = length
        for j in range(n):
            Q[row, j] /= length
        for i in range(row + 1, m):
            total = 0.0
            for j in range(n):
                total += Q[row, j] * Q[i, j]
            T[row, i] = total
            for j in range(n):
                Q[i, j] -= total * Q[row, j]
    return m


@compiled
def gradient_left(A, g, steep, x, lower, upper, touches, y, M, Q, T, order):
    """max |x − clip(x − (g + Aᵀy)/η)|, y by least squares on the joints that touch no bound."""
    m, n = A.shape
    for j in range(n):
        free = x[j] > lower[j] + touches and x[j] < upper[j] - touches
        for i in range(m):
            M[i, j] = A[i, j] if free else 0.0
    rank = orthogonalise(M, Q, T, order)
    for i in range(rank):
        total = 0.0
        for j in range(n):
            total -= Q[i, j] * g[j]  # Q is 0 where M is
        y[i] = total
    for i in range(rank - 1, -1, -1):
        for k in range(i + 1, rank):
            y[i] -= T[i, k] * y[k]
        y[i] /= T[i, i]
    worst = 0.0
    for j in range(n):
        left = g[j]
        for i in range(rank):
            left += A[order[i], j] * y[i]
        aim = min(max(x[j] - left / steep, lower[j]), upper[j])
        worst = max(worst, abs(x[j] - aim))
    return worst


@compiled
def scale_slack(A, b, s, x, lower, upper, y, M, Q, T, order):
    """By how much a bound on the scale is above s, relative to s; infinite where none is found.

    y minimises Σ (wᵢ vᵢ)², v = Aᵀy, with bᵀy = 1, wᵢ the way to the nearer bound: at the largest
    scale there is a y whose v vanishes where neither bound is touched.
    """
    m, n = A.shape
    for j in range(n):
        w = max(min(x[j] - lower[j], upper[j] - x[j]), 1e-8)
        for i in range(m):
            M[i, j] = A[i, j] * w
    rank = orthogonalise(M, Q, T, order)
    if rank < m:
        return math.inf
    for i in range(m):  # TᵀT y = b
        total = b[order[i]]
        for k in range(i):
            total -= T[k, i] * y[k]
        y[i] = total / T[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            y[i] -= T[i, k] * y[k]
        y[i] /= T[i, i]
    along = slack = 0.0
    for i in range(m):
        along += b[order[i]] * y[i]
        missing = s * b[order[i]]
        for j in range(n):
            missing -= A[order[i], j] * x[j]
        slack -= y[i] * missing
    for j in range(n):
        v = 0.0
        for i in range(m):
            v += A[order[i], j] * y[i]
        slack += v * (upper[j] - x[j]) if v > 0.0 else v * (lower[j] - x[j])
    return slack / (along * s) if along > 0.0 else math.inf


@compiled
def judge(  # noqa: PLR0912
    chain, kind, twist_space, speed, gain, dt, q, targets, velocities, scales, solved, found
):  # fmt: skip
    """What the referee says of each step that is called solved.

    Args:
        chain: Of the robot.
        kind: ``POINT``, ``AXIS`` or ``POSE``.
        twist_space: Whether the cost is that of twist space; for ``AXIS``.
        speed: Speed limit of all joints, rad/s or m/s.
        gain: k of h = k (middle of the range − q) / dt.
        dt: Length of the step, s.
        q: (K, n).
        targets: (K, 4, 4).
        velocities: (K, n).
        scales: (K,).
        solved: Which are called solved, (K,).
        found: Result, (K, 5): residual over 1 + max |b|, excess over 1 + max |x|, gradient over
            1 + max |x|, slack (0 at full speed), and 1 where a bound is touched.
    """
    n, m = q.shape[1], kind
    R, p, J, F = np.zeros((3, 3)), np.zeros(3), np.zeros((6, n)), np.zeros(n)
    A, b, y, order = np.zeros((m, n)), np.zeros(m), np.zeros(m), np.zeros(m, dtype=np.int64)
    M, Q, T = np.zeros((m, n)), np.zeros((m, n)), np.zeros((m, m))
    ends, box, h, g = np.zeros((2, n)), np.zeros((2, n)), np.zeros(n), np.zeros(n)
    lower, upper = box[0], box[1]
    for k in range(len(q)):
        x, s = velocities[k], scales[k]
        if not solved[k]:
            continue
        state(chain, kind, speed, gain, dt, q[k], targets[k], R, p, J, A, b, ends, box, h, F)
        off = largest = 0.0
        for i in range(m):
            total = -s * b[i]
            for j in range(n):
                total += A[i, j] * x[j]
            # Written so that NaN is the largest of all.
            if not abs(total) <= off:
                off = abs(total)
            largest = max(largest, abs(b[i]))
        over, fastest, touched = 0.0, 0.0, False
        for j in range(n):
            beyond = max(ends[0, j] - x[j], x[j] - ends[1, j])
            if not beyond <= over:
                over = beyond
            touched |= beyond >= -TOUCHES[0]
            fastest = max(fastest, abs(x[j]))
        steep, along = 1.0, 0.0
        if twist_space:
            steep = 1e-300
            for j in range(n):
                along += F[j] * (x[j] - h[j])
                steep = max(steep, F[j] * F[j])
        for j in range(n):
            g[j] = along * F[j] if twist_space else x[j] - h[j]
        left = math.inf
        for touches in TOUCHES:
            left = min(
                left, gradient_left(A, g, steep, x, lower, upper, touches, y, M, Q, T, order)
            )
            if left <= GRADIENT * (1.0 + fastest):
                break
        found[k, 0], found[k, 1] = off / (1.0 + largest), over / (1.0 + fastest)
        found[k, 2], found[k, 3] = left / (1.0 + fastest), 0.0
        if s < 1.0:
            found[k, 3] = scale_slack(A, b, s, x, lower, upper, y, M, Q, T, order)
        elif s != 1.0:
            found[k, 3] = math.inf
        found[k, 4] = touched

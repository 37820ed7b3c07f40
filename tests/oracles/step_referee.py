"""Random steps and their referee, from the numbers of the MuJoCo model alone.

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
  and Tucker). y comes from least squares on the joints that touch no bound. Refused above
  1e-6 (1 + max |x|);
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

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray
ROWS, BOUNDS, GRADIENT, SLACK = 1e-8, 1e-8, 1e-6, 1e-7
"""Tolerances, see above."""
TOUCHES = (1e-9, 1e-11, 3e-8)
"""A joint that is so close to its bound, rad/s or m/s, does not count as free. Where the first does
not prove the optimum, as at a reduced scale with hardly any room between the bounds, the others are
tried."""
HAIR, RANK = 1e-12, 1e-12
POINT, AXIS, POSE = 3, 5, 6
"""Ranks of the tasks: position; position and direction of the tool's z; and whole orientation."""
UNLIMITED = 2.0
"""Joints without a range are drawn from ±2 rad or m."""


class Chain(NamedTuple):
    """The joints between the world and a site, and their limits."""

    turns: Array
    """From each joint (the first: the world) to the next, or to the site, (n + 1, 3, 3)."""
    moves: Array
    """Likewise, m, (n + 1, 3)."""
    axes: Array
    """Of the joints, in the frame that they turn, (n, 3)."""
    zero: Array
    """Coordinates at which the fixed parts count, (n,)."""
    slides: Array
    """Which are slides, the others hinges, (n,)."""
    lower: Array
    """Ranges, rad or m, (n,); infinite where there is none."""
    upper: Array


def chain_of(model: mujoco.MjModel, site: str) -> Chain:
    """From the arrays of a model all of whose joints are hinges and slides that move the site."""

    def matrix(quaternion: Array) -> Array:
        return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()

    number = model.site(site).id
    bodies, body = [], int(model.site_bodyid[number])
    while body > 0:
        bodies, body = [body, *bodies], int(model.body_parentid[body])
    turns, moves, joints, R, p = [], [], [], np.eye(3), np.zeros(3)
    for body in bodies:
        p = p + R @ model.body_pos[body]
        R = R @ matrix(model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            turns.append(R)
            moves.append(p + R @ model.jnt_pos[joint])
            joints.append(joint)
            R, p = np.eye(3), -model.jnt_pos[joint]  # from here on in the frame that it turns
    moves.append(p + R @ model.site_pos[number])
    turns.append(R @ matrix(model.site_quat[number]))
    types = model.jnt_type[joints]
    assert joints == list(range(model.nv)) and np.isin(types, [2, 3]).all()
    limited = model.jnt_limited.astype(bool)
    return Chain(
        np.array(turns), np.array(moves), model.jnt_axis[joints].copy(), model.qpos0.copy(),
        types == mujoco.mjtJoint.mjJNT_SLIDE,
        np.where(limited, model.jnt_range[:, 0], -np.inf),
        np.where(limited, model.jnt_range[:, 1], np.inf),
    )  # fmt: skip


def kinematics(chain: Chain, q: Array) -> tuple[Array, Array, Array]:
    """R (K, 3, 3), p (K, 3) and Jacobian (K, 6, n), (linear, angular), of the site at q (K, n)."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    points, axes = np.zeros((2, *q.shape, 3))
    for joint, (turn, move) in enumerate(zip(chain.turns, chain.moves, strict=True)):
        p, R = p + R @ move, R @ turn
        if joint == q.shape[1]:
            break
        travel = (q[:, joint] - chain.zero[joint])[:, None]
        points[:, joint], axes[:, joint] = p, R @ chain.axes[joint]
        if chain.slides[joint]:
            p = p + travel * axes[:, joint]
        else:
            R = R @ Rotation.from_rotvec(travel * chain.axes[joint]).as_matrix()
    slides = chain.slides[:, None]
    linear = np.where(slides, axes, np.cross(axes, p[:, None] - points))
    J = np.concatenate([linear, np.where(slides, 0.0, axes)], axis=2)
    return R, p, J.swapaxes(1, 2)


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
    R, p, _ = kinematics(chain, q)
    targets = np.tile(np.eye(4), (count, 1, 1))
    targets[:, :3, :3] = Rotation.from_rotvec(0.3 * away * turned).as_matrix() @ R
    targets[:, :3, 3] = p + 0.1 * away * moved
    return q, targets


class Stated(NamedTuple):
    """What steps have to do."""

    A: Array
    """Rows of the task, (K, m, n)."""
    b: Array
    """Their right-hand sides at full speed, (K, m)."""
    ends: Array
    """Lower and upper bounds, (K, 2, n)."""
    box: Array
    """The same a hair before the ends of the ranges."""
    h: Array
    """Desired velocities, (K, n)."""
    F: Array
    """Rows of the rotation that ``AXIS`` leaves free, (K, n)."""


def all_stated(
    chain: Chain, kind: int, speed: float, gain: float, dt: float, q: Array, targets: Array
) -> Stated:
    """What steps at q (K, n) have to do; arguments as in :func:`judge`."""
    R, p, J = kinematics(chain, q)
    A, b, z = J[:, :3], targets[:, :3, 3] - p, R[:, :, 2]
    if kind == AXIS:
        goal = targets[:, :3, 2]
        swing = np.cross(z, goal)
        sine = np.linalg.norm(swing, axis=1)
        angle = np.arctan2(sine, (z * goal).sum(axis=1))
        swing *= np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)[:, None]
        across = np.linalg.svd(z[:, None])[2][:, 1:]  # two unit vectors at right angles to z
        A = np.concatenate([A, across @ J[:, 3:]], axis=1)
        b = np.concatenate([b, (across @ swing[..., None])[..., 0]], axis=1)
    elif kind == POSE:
        turn = Rotation.from_matrix(targets[:, :3, :3] @ R.swapaxes(1, 2)).as_rotvec()
        A, b = J, np.concatenate([b, turn], axis=1)
    low, high = chain.lower, chain.upper
    ranged = high - low < np.inf
    hair = np.where(ranged, HAIR * np.maximum(1.0, np.abs([low, high])), 0.0)

    def bounds(hair: Array) -> Array:
        below, above = np.maximum(q - low - hair[0], 0.0), np.maximum(high - q - hair[1], 0.0)
        return np.stack([np.maximum(-speed, -below / dt), np.minimum(speed, above / dt)], axis=1)

    with np.errstate(invalid="ignore"):
        h = np.where(ranged, gain * (0.5 * (low + high) - q) / dt, 0.0)
    F = (z[:, None] @ J[:, 3:])[:, 0]
    return Stated(A, b / dt, bounds(0.0 * hair), bounds(hair), h, F)


def stated(
    chain: Chain, kind: int, speed: float, gain: float, dt: float, q: Array, target: Array
) -> Stated:
    """What one step at q (n,) has to do, without K."""
    found = all_stated(chain, kind, speed, gain, dt, q[None], target[None])
    return Stated(*(part[0] for part in found))


def gradient_left(stated: Stated, g: Array, steep: Array, x: Array, touches: float) -> Array:
    """max |x − clip(x − (g + Aᵀy)/η)|, y by least squares on the joints that touch no bound."""
    lower, upper = stated.box.swapaxes(0, 1)
    free = (x > lower + touches) & (x < upper - touches)
    inverse = np.linalg.pinv(stated.A * free[:, None], rcond=RANK)
    y = -(g * free)[:, None] @ inverse
    left = g + (y @ stated.A)[:, 0]
    aim = np.clip(x - left / steep[:, None], lower, upper)
    return np.abs(x - aim).max(axis=1)


def scale_slack(stated: Stated, s: Array, x: Array) -> Array:
    """By how much a bound on the scale is above s, relative to s; infinite where none is found.

    y minimises Σ (wᵢ vᵢ)², v = Aᵀy, with bᵀy = 1, wᵢ the way to the nearer bound: at the largest
    scale there is a y whose v vanishes where neither bound is touched.
    """
    lower, upper = stated.box.swapaxes(0, 1)
    room = np.maximum(np.minimum(x - lower, upper - x), 1e-8)
    inverse = np.linalg.pinv(stated.A * room[:, None], rcond=RANK)
    y = inverse.swapaxes(1, 2) @ (inverse @ stated.b[..., None])
    v = (stated.A.swapaxes(1, 2) @ y)[..., 0]
    y = y[..., 0]
    missing = s[:, None] * stated.b - (stated.A @ x[..., None])[..., 0]
    slack = np.where(v > 0.0, v * (upper - x), v * (lower - x)).sum(axis=1)
    slack -= (y * missing).sum(axis=1)
    along = (stated.b * y).sum(axis=1)
    return np.where(along > 0.0, slack / np.where(along > 0.0, along * s, 1.0), np.inf)


def judge(
    chain: Chain, kind: int, twist_space: bool, speed: float, gain: float, dt: float, q: Array,
    targets: Array, velocities: Array, scales: Array, solved: Array,
) -> Array:  # fmt: skip
    """What the referee says of each step that is called solved; zeros of the others.

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

    Returns:
        (K, 5): residual over 1 + max |b|, excess over 1 + max |x|, gradient over 1 + max |x|, slack
        (0 at full speed), and 1 where a bound is touched.
    """
    found = np.zeros((len(q), 5))
    known = np.isfinite(velocities).all(axis=1) & np.isfinite(scales)
    found[solved & ~known, :4] = np.inf
    chosen = np.flatnonzero(solved & known)
    x, s = velocities[chosen], scales[chosen]
    state = all_stated(chain, kind, speed, gain, dt, q[chosen], targets[chosen])
    size = 1.0 + np.abs(x).max(axis=1)
    off = np.abs((state.A @ x[..., None])[..., 0] - s[:, None] * state.b).max(axis=1)
    beyond = np.maximum(state.ends[:, 0] - x, x - state.ends[:, 1]).max(axis=1)
    g, steep = x - state.h, np.ones(len(x))
    if twist_space:
        g = (state.F * g).sum(axis=1)[:, None] * state.F
        steep = np.maximum((state.F**2).max(axis=1), 1e-300)
    left = np.full(len(x), np.inf)
    for touches in TOUCHES:
        open_ = np.flatnonzero(~(left <= GRADIENT * size))
        part = Stated(*(each[open_] for each in state))
        again = gradient_left(part, g[open_], steep[open_], x[open_], touches)
        left[open_] = np.minimum(left[open_], again)
    slack = np.where(s == 1.0, 0.0, np.inf)
    slower = np.flatnonzero(s < 1.0)
    slack[slower] = scale_slack(Stated(*(v[slower] for v in state)), s[slower], x[slower])
    found[chosen] = np.column_stack([
        off / (1.0 + np.abs(state.b).max(axis=1)), np.maximum(beyond, 0.0) / size, left / size,
        slack, beyond >= -TOUCHES[0],
    ])  # fmt: skip
    return found

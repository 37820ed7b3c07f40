"""The referee against dense sampling: plain MuJoCo poses and formulas of their own."""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration, random_direction
from oracles.joint_paths import evenly, joint_path, slider
from oracles.twists import ALONG_X, KINDS, SPATIAL, projector
from scipy.spatial.transform import Rotation, Slerp

import qp_twist as qt
from qp_twist.kinematics import FramePair, SerialChain, Stretch
from qp_twist.kinematics.tolerance_band import Range
from qp_twist.planning import Certificate, Plan, motion_limits
from qp_twist.planning.levels import Grid
from qp_twist.referee import Finding, JointMotion, LeverArms, PathErrors, Tolerances, path_errors
from qp_twist.referee.joint_rates import largest_accelerations
from qp_twist.trajectories import TimedPath, check_trajectory

Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)
DENSE = 1_500
TIGHT = (1e-4, 1e-3)
"""Tolerances of a check, m and rad."""
FRAMES = ("world", "body", "target")


# ---------------------------------------------------------------- the oracle


def poses(task: qt.PathTask, q: Array) -> tuple[Array, Array]:
    data = mujoco.MjData(task.model)
    R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        R[k] = data.site("tool").xmat.reshape(3, 3)
        p[k] = data.site("tool").xpos
    return R, p


def hermite(rows: JointMotion, k: int, u: Array) -> Array:
    """Row k to k + 1 at shares u, by the Hermite polynomials of a textbook."""
    q0, q1 = rows.q[k : k + 2]
    if rows.velocities is None:
        return q0 + u[:, None] * (q1 - q0)
    T = rows.times[k + 1] - rows.times[k]
    v0, v1 = T * rows.velocities[k : k + 2]
    u = u[:, None]
    return (
        (2 * u**3 - 3 * u**2 + 1) * q0
        + (u**3 - 2 * u**2 + u) * v0
        + (3 * u**2 - 2 * u**3) * q1
        + (u**3 - u**2) * v1
    )


def angle_between(a: Array, b: Array) -> Array:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ki,ki->k", a, b))


def twist(rotations: Array, axes: Array) -> Array:
    quaternion = Rotation.from_matrix(rotations).as_quat()
    along = np.einsum("ki,ki->k", quaternion[:, :3], axes)
    return np.remainder(2.0 * np.arctan2(along, quaternion[:, 3]) + np.pi, 2.0 * np.pi) - np.pi


def dense(task: qt.PathTask, rows: JointMotion, k: int, count: int = DENSE) -> tuple[Array, ...]:
    """Position error, axis error, each band's excess, at the nearest share, (count, …)."""
    T = task.projector
    R, p = poses(task, hermite(rows, k, np.linspace(0.0, 1.0, count)))
    ends = task.waypoints[k : k + 2]
    p0, p1 = (w.translation() for w in ends)
    slerp = Slerp([0, 1], Rotation.from_matrix([w.rotation().as_matrix() for w in ends]))
    fixed = {"world": np.eye(3), "target": ends[0].rotation().as_matrix()}
    M = T.linear.matrix if T.linear.rank in (0, 3) else None
    if M is None:
        A = fixed[T.frame]
        M = A @ T.linear.matrix @ A.T
    way = M @ (p1 - p0)
    lam = np.clip((p - p0) @ way / (way @ way), 0.0, 1.0)
    R_d, p_d = slerp(lam).as_matrix(), p0 + lam[:, None] * (p1 - p0)
    axes = {"world": np.broadcast_to(np.eye(3), R.shape), "body": R, "target": R_d}[T.frame]
    seen = np.einsum("kji,kj->ki", axes, p_d - p) @ T.linear.matrix
    linear = np.linalg.norm(seen, axis=1)
    if T.angular.rank == 3:
        cosine = np.clip(0.5 * (np.einsum("kij,kij->k", R, R_d) - 1.0), -1.0, 1.0)
        angular = np.where(
            cosine > 0.9,
            2.0 * np.arcsin(np.linalg.norm(R - R_d, axis=(1, 2)) / np.sqrt(8.0)),
            np.arccos(cosine),
        )
    elif T.angular.rank == 2:
        e = T.angular.axis
        if T.frame == "world":
            angular = angle_between(R.transpose(0, 2, 1) @ e, R_d.transpose(0, 2, 1) @ e)
        else:
            angular = angle_between(R @ e, R_d @ e)
    elif T.angular.rank == 1:
        angular = np.abs(twist(R_d @ R.transpose(0, 2, 1), axes @ T.angular.axis))
    else:
        angular = np.zeros(count)
    excess = [
        [
            band.excess(FramePair(*pair, np.zeros(6)))
            for pair in zip(R[::9], p[::9], R_d[::9], p_d[::9], strict=True)
        ]
        for band in task.bands
    ]
    return linear, angular, np.array(excess).T.reshape(-1, len(task.bands))


def random_block(rng: np.random.Generator, kinds: Sequence[str]) -> qt.Projector:
    return projector(str(rng.choice(kinds)), random_direction(rng))


def random_bands(rng: np.random.Generator) -> tuple[qt.ToleranceBand, ...]:
    a, n, frame = random_direction(rng), random_direction(rng), rng.choice(FRAMES)
    low, wide = rng.uniform(-0.2, 0.0), rng.uniform(0.05, 0.4)
    cone = rng.uniform(0.0, 1.0)
    return (
        qt.RollBand(a, low, low + wide, frame=frame),
        qt.ConeBand(a, n, cone + wide, cone, frame=rng.choice(("world", "target"))),
        qt.SlabBand(n, 0.1 * low, 0.1 * low + 0.05 * wide, frame=frame),
        qt.BoxBand(3 * [-0.01], [0.01, 0.02, 0.05], frame=frame),
    )


def random_case(
    rng: np.random.Generator, *, size: float, turns: int
) -> tuple[qt.PathTask, JointMotion]:
    """A path that an arm can follow, and a motion near it, or one that turns in between."""
    model = random_arm(rng, int(rng.integers(2, 7)), slides=bool(rng.integers(2)), limited=False)
    frame = rng.choice(FRAMES)
    # Linear rows that turn with the body have a nearest point of their own kind: not asked here.
    linear = ["full"] if frame == "body" else KINDS[:3]
    T = qt.TwistProjector(
        linear=random_block(rng, linear), angular=random_block(rng, KINDS), frame=frame
    )
    q = random_configuration(model, rng) + 0.1 * np.cumsum(rng.normal(size=(3, model.nv)), axis=0)
    task = joint_path(model, q, evenly(3, 1.0), projector=T).path_task
    task = dataclasses.replace(task, bands=random_bands(rng))
    q = q + size * rng.normal(size=q.shape)
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    q[1:, rng.choice(hinges)] += 2.0 * np.pi * turns
    v = rng.normal(size=q.shape) * rng.choice([0.1, 1.0]) if rng.integers(2) else None
    return task, JointMotion(np.array([0.0, 0.7, 2.0]), q, v)


def compare(task: qt.PathTask, motion: JointMotion, errors: PathErrors, count: int = DENSE) -> None:
    """No sample is above its bound, and nothing was found that samples do not nearly find."""
    for k in range(2):
        linear, angular, excess = dense(task, motion, k, count)
        rounding = 1e-8  # of angles near 0 and π
        assert linear.max() <= errors.position.bound[k] * (1 + 1e-9) + 1e-12
        assert angular.max() <= errors.axis.bound[k] + rounding
        assert (
            excess.max(axis=0) <= np.array([of.bound[k] for of in errors.bands]) + rounding
        ).all()
        assert errors.position.between[k] <= errors.position.bound[k] + 1e-12
        assert errors.axis.between[k] <= errors.axis.bound[k] + rounding


# ---------------------------------------------------------------- bounds


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_second_derivatives_of_a_frame_are_within_their_bounds(seed: int) -> None:
    """Against differences of MuJoCo's poses along random quadratics in the joints."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, int(rng.integers(1, 8)), slides=bool(rng.integers(2)), limited=False)
    if rng.integers(2):
        model.qpos0[:] = 0.3 * rng.normal(size=model.nq)
    q, dq, ddq = random_configuration(model, rng), *rng.normal(size=(2, model.nv))
    task = joint_path(model, np.array([q, q + 1.0]), None).path_task
    h = 1e-4
    s = np.array([-h, 0.0, h])[:, None]
    near = q + s * dq + 0.5 * s**2 * ddq
    R, p = poses(task, near)
    motion = JointMotion(np.arange(3.0), near)
    arms = LeverArms.of(SerialChain.of(model, "tool", "site"), motion)
    turn, change, bend = (
        x[0] for x in arms.displacement(np.abs([dq]), np.abs([ddq]), np.array([1.0]))
    )
    assert np.linalg.norm(p[0] - 2.0 * p[1] + p[2]) / h**2 <= bend + 1e-4
    second = np.linalg.norm(R[0] - 2.0 * R[1] + R[2]) / np.sqrt(2.0) / h**2
    assert second <= turn**2 + change + 1e-4
    assert Rotation.from_matrix(R[0].T @ R[2]).magnitude() / (2.0 * h) <= turn + 1e-4


@given(
    SEEDS, st.sampled_from([1e-4, 1e-2, 0.3]), st.sampled_from([None, (1e-4, 1e-3), (0.05, 0.1)])
)
@settings(max_examples=15, deadline=None)
def test_no_sample_is_above_what_is_proven(
    seed: int, size: float, tolerances: tuple[float, float] | None
) -> None:
    task, motion = random_case(np.random.default_rng(seed), size=size, turns=0)
    compare(task, motion, path_errors(task, motion, tolerances=tolerances))


@pytest.mark.whole_path
@given(SEEDS, st.integers(1, 20), st.sampled_from([0, 1, 8]))
@settings(max_examples=6, deadline=None)
def test_whole_turns_between_two_rows_are_not_passed_over(
    seed: int, turns: int, samples: int
) -> None:
    task, motion = random_case(np.random.default_rng(seed), size=0.0, turns=turns)
    errors = path_errors(task, motion, tolerances=(1e-3, 1e-2), samples=samples)
    compare(task, motion, errors)
    for k in range(2):
        linear, angular, _ = dense(task, motion, k)
        kept = errors.kept(1e-3, 1e-2)[k]
        assert not kept or (linear.max() <= 1e-3 * (1 + 1e-6) and angular.max() <= 1e-2 * 1.001)


def links(*lengths: float) -> mujoco.MjModel:
    """Hinges about z without ranges, ``one``, ``two`` …, links along x, the frame at the end."""
    bodies = "".join(
        f'<body pos="{before} 0 0"><joint name="{name}" axis="0 0 1"/><geom size="0.1"/>'
        for name, before in zip(("one", "two"), (0.0, *lengths[:-1]), strict=False)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}<site name="tool" '
        f'pos="{lengths[-1]} 0 0"/>{"</body>" * len(lengths)}</worldbody></mujoco>'
    )


@pytest.mark.parametrize("turns", [1, 2, 3, 5, 8, 13, 20])
def test_a_check_sees_every_number_of_turns(turns: int) -> None:
    """The frame leaves the path by 4 m, and is on it at shares of one in ``turns``."""
    q = np.array([[0.0], [1e-3], [2e-3]])
    task = joint_path(links(2.0), q, None).path_task
    assert check_trajectory(TimedPath(("one",), q), task).passes
    q[1:] += 2.0 * np.pi * turns
    check = check_trajectory(TimedPath(("one",), q), task)
    assert not check.passes
    [between] = [f for f in check.findings if f.name == "position error between"]
    assert between.value == pytest.approx(4000.0, rel=0.02)
    assert between.where == "waypoints 1 to 2"


@given(SEEDS, st.floats(0.3, 3.0))
@settings(max_examples=15, deadline=None)
def test_what_passes_is_within_the_tolerances_and_what_is_well_within_passes(
    seed: int, share: float
) -> None:
    """Motions whose largest errors are near the tolerances."""
    rng = np.random.default_rng(seed)
    task, motion = random_case(rng, size=1e-3, turns=0)
    sampled = [dense(task, motion, k) for k in range(2)]
    largest = [max(s[part].max() for s in sampled) for part in range(2)]
    excess = np.max([s[2].max(axis=0) for s in sampled], axis=0)
    position = share * max(largest[0], excess[2:].max(), 1e-9)
    axis = share * max(largest[1], excess[:2].max(), 1e-7)
    errors = path_errors(task, motion, tolerances=(position, axis))
    passes = errors.kept(position, axis).all()
    assert passes == (share >= 1.0) or 0.99 < share < 1.01


# ---------------------------------------------------------------- limits of the joints


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_extremes_of_cubics_are_those_of_dense_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 2.0, size=3))])
    motion = JointMotion(times, rng.normal(size=(4, 2)), 3.0 * rng.normal(size=(4, 2)))
    u = np.linspace(0.0, 1.0, 10_001)
    lowest, highest = motion.extremes()
    for k, T in enumerate(np.diff(times)):
        q = hermite(motion, k, u)
        v = np.diff(q, axis=0) / np.diff(u)[:, None] / T
        a = np.diff(v, axis=0) / np.diff(u)[1:, None] / T
        assert lowest[k] == pytest.approx(q.min(axis=0), abs=1e-6)
        assert highest[k] == pytest.approx(q.max(axis=0), abs=1e-6)
        fastest = np.abs(v).max(axis=0)
        assert motion.largest_speeds()[k] == pytest.approx(fastest, rel=1e-3)
        assert motion.largest_accelerations()[k] == pytest.approx(
            np.abs(a).max(axis=0), rel=2e-3, abs=1e-3
        )
        # Of a part of a piece, too.
        part = np.sort(rng.uniform(0.0, 1.0, size=2))
        ends = times[k] + part * T
        speeds, accelerations = motion.largest_within(np.array([k]), ends[:1], ends[1:])
        inside = (u[:-1] >= part[0]) & (u[1:] <= part[1])
        if inside.sum() > 100:
            assert speeds[0] == pytest.approx(np.abs(v[inside]).max(axis=0), rel=0.01, abs=0.01)
            assert accelerations[0] == pytest.approx(
                np.abs(a[inside[1:]]).max(axis=0), rel=0.01, abs=0.05
            )


# ---------------------------------------------------------------- progress


def rail(motion: JointMotion, q: Array, fastest: float, **options: object) -> PathErrors:
    task = joint_path(slider(), q, evenly(len(q), 1.0)).path_task
    return path_errors(
        task, motion, tolerances=TIGHT, fastest=np.full(len(q) - 1, fastest),
        **options,  # type: ignore[arg-type]
    )  # fmt: skip


@given(SEEDS, st.floats(1.0, 6.0))
@settings(max_examples=20, deadline=None)
def test_progress_is_proven_where_no_two_instants_are_too_fast(seed: int, fastest: float) -> None:
    """On a rail progress is the joint: cubics forth and back against all pairs of samples."""
    rng = np.random.default_rng(seed)
    q = np.array([[0.0], [rng.choice([2e-4, 1e-3, 0.1, 1.0])]])
    v = q[1, 0] * rng.uniform(-3.0, 6.0, size=(2, 1))
    motion = JointMotion(np.array([0.0, 1.0]), q, v)
    errors = rail(motion, q, fastest)
    u = np.linspace(0.0, 1.0, 401)
    lam = np.clip(hermite(motion, 0, u)[:, 0] / q[1, 0], 0.0, 1.0)
    within = 2e-4 / q[1, 0]
    rises = [
        (sign * lam - fastest * u)[b:].max() - (sign * lam - fastest * u)[b]
        for sign in (1.0, -1.0)
        for b in range(len(u))
    ]
    if max(rises) > within * (1 + 1e-5):
        assert not errors.rate_kept[0]
    elif max(rises) < 0.99 * within - 1e-3 or (
        np.abs(np.diff(lam) / np.diff(u)).max() < 0.99 * fastest
    ):
        assert errors.rate_kept[0]


def test_a_tip_that_rushes_forth_and_back_on_its_way_is_seen() -> None:
    """Equal links, the elbow turning back twice as fast: the tip stays on a line, at any speed."""
    q = np.array([[np.pi, -2.0 * np.pi], [2.0 * np.pi, -4.0 * np.pi]])
    task = joint_path(links(1.0, 1.0), q, evenly(2, 1.0)).path_task
    fastest = np.array([1.7])  # π/2 is the most that one half turn makes

    def errors(q: Array) -> PathErrors:
        motion = JointMotion(np.arange(2.0), q)
        return path_errors(task, motion, tolerances=TIGHT, fastest=fastest)

    slow = errors(q)
    assert slow.rate_kept.all()
    assert slow.rate[0] == pytest.approx(np.pi / 2.0, rel=0.02)
    fast = errors(q + np.pi * np.array([[0.0, 0.0], [18.0, -36.0]]))
    assert fast.position.bound[0] < 1e-4  # never off the line
    assert not fast.rate_kept.any()
    assert fast.rate[0] > 10.0


# ---------------------------------------------------------------- plans and runs


def plan_of(task: qt.PathTask, q: Array | None) -> Plan:
    return Plan(task, q, 0.0, 0.0, Certificate("path", Grid(1.0, np.ones(1))), "travel")


def test_a_plan_says_what_it_keeps_between_its_waypoints() -> None:
    q = np.array([[0.0], [0.01], [0.02]])
    task = joint_path(links(2.0), q, evenly(3, 1.0)).path_task
    task = dataclasses.replace(task, bands=(qt.RollBand([0, 0, 1], -0.1, 0.1),))
    plan = plan_of(task, q)
    height = 2.0 * (1.0 - np.cos(0.005))
    assert 0.9 * height <= plan.between.position.between.max() <= height * (1 + 1e-9)
    assert height <= plan.between.position.bound.max() <= 1.3 * height + 1e-5
    assert plan.promise.startswith("on the path at the waypoints; between them, the joints moving")
    assert plan.promise.endswith("outside hard bands by at most 0°")
    assert {f.name for f in plan.examined()} >= {"position error between", "feed between"}
    assert all(f.passes for f in plan.examined())
    untimed = dataclasses.replace(plan, path_task=dataclasses.replace(task, durations=None))
    assert {f.name for f in untimed.examined()}.isdisjoint({"feed", "time", "joint speed"})
    tight = plan.examined(Tolerances(position=0.5 * height))
    assert [f.name for f in tight if not f.passes] == ["position error between"]
    with pytest.raises(qt.InvalidInput, match="no plan"):
        plan_of(task, None).promise  # noqa: B018


def test_a_joint_without_a_range_may_not_turn_by_more_than_half_a_turn_in_a_plan() -> None:
    q = np.array([[0.0], [0.01], [0.02]])
    task = joint_path(links(2.0), q, evenly(3, 100.0), velocity=3.0).path_task
    ranges = qt.JointRanges.of(task.model)
    assert motion_limits(task, ranges).steps.max() == np.pi
    limited = joint_path(slider(), q, evenly(3, 100.0), velocity=3.0).path_task
    ranges = qt.JointRanges.of(limited.model)
    assert motion_limits(limited, ranges).steps.max() == 300.0


# ---------------------------------------------------------------- work


def test_ordinary_motions_are_little_work_and_endless_ones_end() -> None:
    """A motion at a bound of the work says that it is not proven; nothing is waited for."""
    q = np.cumsum(0.02 * np.random.default_rng(0).normal(size=(400, 6)), axis=0)
    model = random_arm(np.random.default_rng(3), 6, limited=False)
    task = joint_path(model, q, None, projector=SPATIAL).path_task
    motion = JointMotion(np.arange(400.0), q)
    errors = path_errors(task, motion, tolerances=(5e-3, 1e-2), work=0)
    assert errors.kept(5e-3, 1e-2).all()
    spun = q.copy()
    spun[200:, 0] += 2e5 * np.pi
    motion = JointMotion(np.arange(400.0), spun)
    errors = path_errors(task, motion, tolerances=(5e-3, 1e-2), work=1000)
    assert list(np.flatnonzero(~errors.kept(5e-3, 1e-2))) == [199]


class Ball(qt.ToleranceBand):
    """The frame within a distance of its target: a band that the package does not know."""

    kind, unit = "ball", "m"
    ranges = (Range(0.0, 0.03),)

    def values(self, pair: FramePair) -> Array:
        return np.linalg.norm(pair.position - pair.target_position, axis=-1, keepdims=True)

    def gradients(self, pair: FramePair) -> Array:
        apart = pair.position - pair.target_position
        along = apart / np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-12)
        return np.concatenate([along, np.zeros_like(along)], axis=-1)[..., None, :]

    def carried(self, pair: FramePair) -> Array:
        return pair.target_twist * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])

    def fixed(self, projector: qt.TwistProjector) -> tuple[bool, ...]:
        return (projector.linear.rank == 3,)

    def contradiction(self, projector: qt.TwistProjector) -> str | None:
        return None

    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        ends = np.maximum(self.values(before), self.values(after))
        away = stretch.off_chord(before, after, "world") + stretch.slip
        return 0.0 * ends, ends + away[:, None]


def test_a_band_of_ones_own_class_is_asked_as_those_of_the_package_are() -> None:
    q = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    along = ALONG_X
    task = joint_path(slider(2), q, None, projector=along).path_task
    task = dataclasses.replace(task, bands=(Ball(None, 1.0),))
    names = ("slide_1", "slide_2")
    for height, passes in ((0.0299, True), (0.0313, False)):
        rows = np.array([[0.0, 0.0], [0.5, height], [1.0, 0.0], [1.5, 0.02], [2.0, 0.0]])
        check = check_trajectory(TimedPath(names, rows), task)
        [between] = [f for f in check.findings if f.name == "outside a band between"]
        assert between.passes == passes == check.passes
        assert between.value == pytest.approx(max(height - 0.03, 0.0), abs=1e-4)


def test_at_points_of_a_program_the_speed_changes_over_half_of_both_moves() -> None:
    """A joint gains speed on its first move, jumps to another, and keeps that on the second."""
    gain, jump, dt = 3.0, 0.4, 0.01
    t = np.arange(0.0, 0.2 + 1e-9, dt)
    first = 0.5 * gain * t**2
    speed = gain * t[-1]
    then = np.arange(dt, 0.1 + 1e-9, dt)
    q = np.concatenate([first, first[-1] + (speed + jump) * then])[:, None]
    times = np.concatenate([t, t[-1] + then])
    points = np.array([0, len(t) - 1, len(q) - 1])
    rows, found = largest_accelerations(JointMotion(times, q, points=points))
    assert rows == pytest.approx(times[1:-1])
    at = len(t) - 2
    # The mean speed of the last piece of the first move is half a step short of its end's.
    assert found[at, 0] == pytest.approx((jump + 0.5 * gain * dt) / (0.5 * (0.2 + 0.1)))
    assert found[:at, 0] == pytest.approx(gain)
    assert found[at + 1 :, 0] == pytest.approx(0.0, abs=1e-9)
    # Where every row is a point, that is what changes from piece to piece.
    every = largest_accelerations(JointMotion(times, q))[1]
    assert every[at, 0] == pytest.approx((jump + 0.5 * gain * dt) / dt)


@given(st.floats(-12, 0), st.floats(1e-5, 1e5), st.booleans())
def test_what_fails_is_told_in_digits_that_differ_from_its_limit(
    over: float, limit: float, of_bound: bool
) -> None:
    large = limit * (1.0 + 10.0**over)
    value, bound = (0.5 * limit, large) if of_bound else (large, None)
    found = Finding("speed", value, limit, "%", "joint_1", False, bound)
    shown_value, shown_bound, shown_limit = found.shown
    shown = shown_bound if of_bound else shown_value
    assert float(shown) > float(shown_limit)
    assert f"{shown} %" in str(found) and f"limit {shown_limit} %" in str(found)
    assert Finding("speed", value, limit, "%", "joint_1", True, bound).shown[2] == f"{limit:.4g}"


def test_few_digits_stay_few() -> None:
    sentence = "speed: 100 % at joint_1, limit 100 %"
    assert str(Finding("speed", 100.0, 100.0, "%", "joint_1", True)) == sentence
    wide = Finding("speed", 123.456, 100.0, "%", "joint_1", False)
    assert str(wide) == "speed: 123.5 % at joint_1, limit 100 %"
    hair = Finding("speed", 100.0152, 100.0, "%", "joint_1", False)
    assert str(hair) == "speed: 100.02 % at joint_1, limit 100 %"

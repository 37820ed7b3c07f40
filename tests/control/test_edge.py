"""At the edge of the reach and near singularities: continuous, calm, and exact everywhere else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from oracles.arms import planar_arm, random_arm, random_configuration

import qp_twist as qt
from qp_twist.constraints import stopping_share, stopping_speed
from qp_twist.constraints.stopping_speed import BRAKING
from qp_twist.control import solving
from qp_twist.kernel import directions as compiled_directions
from qp_twist.kernel import edge_step
from qp_twist.kernel import one_program as compiled_program
from qp_twist.qp import Directions, one_program, scaling
from qp_twist.qp import directions as read

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
EPSILON, DT = 1e-3, 0.005
FASTEST = 0.5 * np.pi
TWO_ARMS = Path(qt.__file__).parents[1] / "scenes" / "two_arms.xml"
HOME = np.array([0, 0.5, 0, -1.4, 0, 1.2, 0])


def seven_axes() -> mujoco.MjModel:
    """Shoulder at 0.36 m, upper arm 0.42, forearm 0.40, wrist to tool 0.15."""
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
    heights = (0.18, 0.18, 0.21, 0.21, 0.2, 0.2, 0.08)
    ends = (2.96, 2.09, 2.96, 2.09, 2.96, 2.09, 3.05)
    opening = "".join(
        f'<body name="link_{i + 1}" pos="0 0 {height}">'
        f'<joint name="a{i + 1}" axis="{axis}" range="-{end} {end}"/><geom size="0.05" mass="2"/>'
        for i, (axis, height, end) in enumerate(zip(axes, heights, ends, strict=True))
    )
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody>'
        f'{opening}<site name="tool" pos="0 0 0.07"/>{"</body>" * 7}</worldbody></mujoco>'
    )


SEVEN = seven_axes()


# ------------------------------------------------------------------------------------- the formula


def weak_rows(rng: np.random.Generator) -> tuple[Array, Array]:
    """Task rows with some singular values near zero, some close to each other, and an error."""
    m = int(rng.integers(1, 7))
    n = int(rng.integers(m, 9))
    left, right = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
    sigma = 10.0 ** rng.uniform(-5.0, 0.3, m)
    if m > 1 and rng.random() < 0.5:
        sigma[1] = sigma[0]
    error = 10.0 ** rng.uniform(-4.0, 0.0) * rng.normal(size=m)
    return left @ np.diag(sigma) @ right[:m], error


@given(SEEDS)
@settings(max_examples=100)
def test_a_weak_direction_is_met_by_the_damped_inverse(seed: int) -> None:
    """Its cost beside that of the joints has the damped inverse as its minimum, whatever A is."""
    rng = np.random.default_rng(seed)
    A, error = weak_rows(rng)
    found = Directions.of(A, error, 1.0, EPSILON)
    H, c = np.eye(A.shape[1]), np.zeros(A.shape[1])
    weak = found.slack > 0.0
    H, c = one_program.with_weak_rows(
        H, c, found.rows, found.rate, found.slack, np.ones(len(error))
    )
    E, e = found.rows[~weak], found.rate[~weak]
    k = len(e)
    saddle = np.block([[H, E.T], [E, np.zeros((k, k))]])
    x = np.linalg.lstsq(saddle, np.concatenate([-c, e]), rcond=None)[0][: len(c)]
    np.testing.assert_allclose(x, found.motion(), atol=1e-7 * (1.0 + np.abs(x).max()))
    # What is weak moves by at most σ/ℓ: the arm does not leap over the singularity.
    share = np.maximum(0.0, 1.0 - (found.sigma / 0.05) ** 2) ** 3
    step = share * np.abs(found.rate) * found.sigma / np.maximum(found.damped, 1e-300)
    assert (step <= found.sigma / (read.BEND * found.size) + 1e-12).all()


@given(SEEDS)
@settings(max_examples=100)
def test_no_weak_singular_value_changes_faster_than_its_bound(seed: int) -> None:
    """|uᵀ dA(v) v| by differences of A: below ℓ, so that the damped step comes to rest."""
    rng = np.random.default_rng(seed)
    planar = bool(rng.random() < 0.5)
    if planar:
        model = planar_arm(rng.uniform(0.1, 1.0, int(rng.integers(2, 5))).tolist())
        q, frame, rank = 0.3 * rng.normal(size=model.nv), "tip", 2
    else:
        model, frame, rank = SEVEN, "tool", 3
        q = random_configuration(model, rng)
        q[3] = 0.1 * rng.normal()

    def rows(q: Array) -> Array:
        jacobian = np.zeros((3, model.nv))
        data = mink.Configuration(model, q).data
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(frame).id)
        return jacobian[:rank]

    A = rows(q)
    left, sigma, right = np.linalg.svd(A)
    bound = read.BEND * sigma[0]
    for i in np.flatnonzero(sigma < 0.1 * sigma[0]):
        v = right[i]
        change = (rows(q + 1e-6 * v) - rows(q - 1e-6 * v)) / 2e-6
        assert abs(left[:, i] @ change @ v) <= bound


def test_both_statements_have_the_same_constants() -> None:
    """In the kernel they are compiled in; a difference would be one of the step."""
    assert (
        compiled_directions.REGULAR, compiled_directions.BEND, compiled_directions.SMOOTHED,
        compiled_directions.BRAKING,
    ) == (
        read.REGULAR, read.BEND, read.SMOOTHED, BRAKING,
    )  # fmt: skip
    assert (
        compiled_program.WORTH, compiled_program.BEYOND, compiled_program.CURVED,
        compiled_program.SOFT, compiled_program.DEAD, compiled_program.LEAST_MOTION,
        compiled_program.BACKOFF, edge_step.WHOLE,
    ) == (
        one_program.WORTH, one_program.BEYOND, one_program.CURVED, one_program.SOFT,
        one_program.DEAD, one_program.LEAST_MOTION, scaling.SCALE_BACKOFF, solving.WHOLE,
    )  # fmt: skip


# ----------------------------------------------------------------------------- one step of a robot


THREE_LINKS = planar_arm([0.5, 0.4, 0.1])


def planar_step(
    q2: float,
    distance: float,
    mode: str,
    side: float = 0.02,
    solver: str | None = None,
    dt: float = DT,
    before: Array | None = None,
    singularity: float | None = None,
) -> qt.Step:
    """A 3R arm with its second joint at q2 (straight at 0) and its target further along x.

    With the velocity ``before`` the joints have inertia.
    """
    model = THREE_LINKS
    q = np.array([-0.5 * q2, q2, -0.3 * q2])
    configuration = mink.Configuration(model, q)
    plane = qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none())
    task = qt.TwistTask("tip", "site", plane)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    task.set_target(mink.SE3.from_translation(tip + np.array([distance, side, 0.0])))
    names = [model.joint(i).name for i in range(3)]
    limits: list[mink.Limit] = [qt.MotionLimit(model, velocity=FASTEST)]
    if before is None:
        speeds = dict.fromkeys(names, FASTEST)
        limits = [qt.PositionLimit(model), mink.VelocityLimit(model, speeds)]
    controller = qt.Controller(
        model, [task], limits=limits, solver=solver, on_infeasible=mode,  # type: ignore[arg-type]
        secondary=[qt.PostureReference(model, np.array([-0.4, 0.8, 0.4]), gain=0.01)],
    )  # fmt: skip
    if singularity is not None:
        controller.singularity = singularity
    return controller.step(configuration, dt, velocity=before)


BEFORE = np.array([0.9, -1.3, 0.6])


@pytest.mark.parametrize("before", [None, BEFORE], ids=["", "inertia"])
@pytest.mark.parametrize("solver", [None, "daqp"])
@pytest.mark.parametrize("mode", ["scale", "relax"])
@pytest.mark.parametrize("along", ["q", "target"])
def test_the_velocity_is_continuous_across_the_edge(
    mode: str, along: str, solver: str | None, before: Array | None
) -> None:
    """Where the velocity changes most on a line across the edge, it changes by nothing at last.

    The largest changes are enclosed by bisection: a jump would stay as large as it is.
    """

    def velocity(x: float) -> Array:
        if along == "q":
            return planar_step(0.05 * x, 0.3, mode, solver=solver, before=before).velocity
        return planar_step(0.02, 0.05 * x, mode, solver=solver, before=before).velocity

    line = np.linspace(-1.0, 1.0, 101)
    found = np.array([velocity(x) for x in line])
    change = np.abs(np.diff(found, axis=0)).max(axis=1)
    for k in np.argsort(-change)[:3]:
        a, b = line[k], line[k + 1]
        at_a, at_b = found[k], found[k + 1]
        for _ in range(24):
            middle = 0.5 * (a + b)
            between = velocity(middle)
            if np.abs(between - at_a).max() > np.abs(between - at_b).max():
                b, at_b = middle, between
            else:
                a, at_a = middle, between
        assert np.abs(at_b - at_a).max() < 1e-4


@given(SEEDS)
@settings(max_examples=40)
def test_a_regular_task_is_exact(seed: int) -> None:
    """Closed form: least norm beside the secondary, 1e-9, where no limit is active."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, int(rng.integers(6, 9)))
    q = random_configuration(model, rng, margin=0.2)
    configuration = mink.Configuration(model, q)
    task = qt.TwistTask.axis_free("tool", "site")
    pose = configuration.get_transform_frame_to_world("tool", "site")
    task.set_target(pose.plus(10.0 ** rng.uniform(-4.0, -1.0) * rng.normal(size=6)))
    posture = qt.PostureReference(model, random_configuration(model, rng), gain=0.1)
    A, b = task.velocity_rows(configuration, 0.1)
    if np.linalg.svd(A, compute_uv=False)[-1] < 0.05:
        return
    controller = qt.Controller(model, [task], secondary=[posture], limits=[], solver="daqp")
    step = controller.step(configuration, 0.1)
    h = posture.displacement(configuration) / 0.1
    expected = h + np.linalg.pinv(A) @ (b - A @ h)
    assert step.status is qt.Status.SOLVED
    np.testing.assert_allclose(step.velocity, expected, atol=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_a_small_error_in_a_weak_direction_falls_by_the_stated_share(mode: str) -> None:
    """σ²/σ₁² of it in a step, and all of the rest: the error of a target that stays vanishes."""
    step = planar_step(0.15, -1e-4, mode, side=0.0)
    assert 0.01 < step.sigma_min < 0.05
    kept = (step.sigma_min / 0.05) ** 2
    asked = 1e-4 / DT
    assert step.status is qt.Status.DEGRADED
    (weak,) = step.lost
    assert weak.share == pytest.approx(kept, rel=1e-6)
    missing = abs(float(weak.direction @ step.residuals[0]))
    assert missing == pytest.approx((1.0 - kept) * asked, rel=1e-2)  # almost all of it is weak
    assert np.linalg.norm(step.residuals[0]) == pytest.approx(missing, rel=1e-2)


def test_noise_of_a_target_inside_the_edge_is_not_amplified() -> None:
    """0.1 mm of it, 2 mm inside, at 200 Hz: joints keep their direction, and no error stays."""
    model, rng = planar_arm([0.42, 0.4]), np.random.default_rng(5)
    configuration = mink.Configuration(model, np.array([0.0, 0.14]))
    plane = qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none())
    task = qt.TwistTask("tip", "site", plane)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    assert 0.001 < 0.82 - np.linalg.norm(tip) < 0.003
    limit = qt.MotionLimit(model, velocity=FASTEST)
    controller = qt.Controller(model, [task], limits=[limit])
    velocities = []
    for k in range(600):
        noise = 1e-4 * rng.normal(size=2) * (k < 400)
        task.set_target(mink.SE3.from_translation(tip + np.append(noise, 0.0)))
        velocities.append(controller.step(configuration, DT).velocity)
        configuration.integrate_inplace(velocities[-1], DT)
    v = np.array(velocities)
    reversals = (v[1:] * v[:-1] < 0.0) & (np.minimum(abs(v[1:]), abs(v[:-1])) > 0.3)
    assert reversals.sum() == 0
    left = configuration.get_transform_frame_to_world("tip", "site").translation() - tip
    assert np.linalg.norm(left) < 1e-9


# ------------------------------------------------------------------------------------------- runs


class Run(NamedTuple):
    """What a run shows."""

    flips: int
    rms: float
    final: float
    excess: float


def run(
    offset: Callable[[float], Array], length: float, mode: str, *,
    acceleration: Any = "default", twist: Callable[[float], Array] | None = None,
    solver: str | None = None,
) -> Run:  # fmt: skip
    """The seven-axis arm at 200 Hz after a target that starts at home."""
    configuration = mink.Configuration(SEVEN, HOME.copy())
    home = configuration.get_transform_frame_to_world("tool", "site")
    task = qt.TwistTask.axis_free("tool", "site")
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST, acceleration=acceleration)
    controller = qt.Controller(
        SEVEN, [task], limits=[limit], solver=solver, on_infeasible=mode,  # type: ignore[arg-type]
        secondary=[qt.PostureReference(SEVEN, HOME, gain=0.01)],
    )  # fmt: skip
    velocities, excess, error = [], -np.inf, 0.0
    lower, upper = SEVEN.jnt_range.T
    for i in range(round(length / DT)):
        goal = home.translation() + offset(i * DT)
        task.set_target(
            mink.SE3.from_rotation_and_translation(home.rotation(), goal),
            None if twist is None else np.append(twist(i * DT), np.zeros(3)),
        )
        velocity = controller.step(configuration, DT).velocity
        configuration.integrate_inplace(velocity, DT)
        q = configuration.q
        excess = max(excess, (q - upper).max(), (lower - q).max(), np.abs(velocity).max() - FASTEST)
        velocities.append(velocity)
        place = configuration.get_transform_frame_to_world("tool", "site").translation()
        error = float(np.linalg.norm(place - goal))
    v = np.array(velocities)
    changes = np.diff(np.vstack([np.zeros(7), v]), axis=0)
    change = limit.max_acceleration * DT
    excess = max(excess, float((np.abs(changes) - change).max()))
    fast = (v[1:] * v[:-1] < 0.0) & (np.minimum(np.abs(v[1:]), np.abs(v[:-1])) > 0.3)
    rms = float(np.sqrt((changes**2).mean())) / DT
    return Run(int(fast.sum()), rms, error, float(excess))


def there_and_back(direction: list[float], length: float) -> Callable[[float], Array]:
    return lambda t: np.array(direction) * np.sin(np.pi * min(t / length, 1.0))


CASES: dict[str, tuple[Callable[[float], Array], float]] = {
    "out": (there_and_back([0.7, 0, 0], 1.6), 2.8),
    "diagonal": (there_and_back([0.5, 0.5, 0], 1.6), 2.8),
    "jump": (lambda t: np.array([0.7, 0.2, 0.1]) * (0.1 < t < 1.1), 2.6),
    "20 mm outside": (lambda t: np.array([0.2245 * min(t / 0.5, 1.0), 0, 0]), 1.5),
    "folded": (there_and_back([-0.6, 0, -0.1], 1.6), 2.6),
}


@pytest.mark.parametrize("mode", ["scale", "relax"])
@pytest.mark.parametrize("name", CASES)
def test_no_joint_chatters_when_the_target_leaves_the_reach(name: str, mode: str) -> None:
    offset, length = CASES[name]
    found = run(offset, length, mode)
    assert found.flips <= 5
    assert found.rms < 30.0
    assert found.excess <= 1e-9
    if name != "20 mm outside":
        assert found.final < 1e-4


@pytest.mark.parametrize(
    ("robot", "mode", "seed"),
    [
        ("seven", "scale", 20178),
        ("seven", "scale", 20219),
        ("seven", "scale", 20103),
        ("seven", "scale", 104130),
        ("seven", "scale", 105869),
        ("seven", "scale", 106269),
        ("seven", "scale", 107962),
        ("seven", "relax", 20046),
        ("seven", "relax", 20299),
        ("six", "scale", 20051),
        ("six", "relax", 20032),
        ("six", "relax", 20216),
    ],
)
def test_no_joint_reverses_again_and_again_as_a_target_rushes_past(
    robot: str, mode: str, seed: int
) -> None:
    """Excursions up to metres beyond the reach, and back, at 200 Hz without acceleration limits.

    Without inertia there were 7 to 50 sign changes: a joint at its position limit with a direction
    just short of the singularity, and joints that reverse from one speed limit to the other. From
    104130 on a limit stops the task in one step and not in the next: 9 to 30 sign changes if the
    path was kept again at once.
    """
    model, home = SEVEN, HOME
    if robot == "six":
        model, home = qt.load_task("deburring").model, np.array([0.0, 0.3, -0.4, 0.0, -0.9, 0.0])
    rng = np.random.default_rng([seed, 7])
    waves = rng.normal(size=(3, 3)) * rng.uniform(0.05, 0.6)
    rates = rng.uniform(0.5, 4.0, 3)
    turn = rng.normal(size=3) * rng.uniform(0.0, 0.8)
    configuration = mink.Configuration(model, home)
    first = configuration.get_transform_frame_to_world("tool", "site")
    task = qt.TwistTask.axis_free("tool", "site")
    controller = qt.Controller(
        model, [task], limits=[qt.MotionLimit(model, velocity=FASTEST)],
        on_infeasible=mode,  # type: ignore[arg-type]
        secondary=[qt.PostureReference(model, home, gain=0.01)],
    )  # fmt: skip
    before, flips, square = np.zeros(model.nv), 0, 0.0
    for i in range(1000):
        window = np.sin(0.5 * np.pi * min(i * DT, 2.0))
        task.set_target(
            mink.SE3.from_rotation_and_translation(
                mink.SO3.exp(window * turn) @ first.rotation(),
                first.translation() + window * np.sin(rates * i * DT) @ waves,
            )
        )
        velocity = controller.step(configuration, DT).velocity
        fast = np.minimum(np.abs(velocity), np.abs(before)) > 0.3
        flips += int(((velocity * before < 0.0) & fast).sum())
        square += float(((velocity - before) ** 2).mean())
        before = velocity
        configuration.integrate_inplace(velocity, DT)
        assert np.abs(velocity).max() <= FASTEST
        assert (configuration.q >= model.jnt_range[:, 0] - 1e-9).all()
        assert (configuration.q <= model.jnt_range[:, 1] + 1e-9).all()
    assert flips <= 5
    assert np.sqrt(square / 1000) / DT < 20.0
    place = configuration.get_transform_frame_to_world("tool", "site").translation()
    np.testing.assert_allclose(place, first.translation(), atol=1e-4)


@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_a_large_singularity_weakens_as_much_in_the_kernel(mode: str) -> None:
    """With ε = 0.05 directions are weak up to 2 ε, beyond the usual σ₁."""
    given = 0.3, 0.3, mode, 0.0
    fast, read = (planar_step(*given, s, 1.0, singularity=0.05) for s in (None, "daqp"))
    assert 0.05 < fast.sigma_min < 0.1
    assert fast.status is read.status is qt.Status.DEGRADED
    np.testing.assert_allclose(fast.velocity, read.velocity, atol=1e-9)


def test_a_named_backend_is_as_calm() -> None:
    offset, length = CASES["diagonal"]
    calm, other = run(offset, length, "scale", solver="daqp"), run(offset, length, "scale")
    assert calm.flips <= 5
    assert calm.rms == pytest.approx(other.rms, rel=1e-3)


@pytest.mark.parametrize("mode", ["scale", "relax"])
@pytest.mark.parametrize("name", ["out", "jump"])
def test_with_acceleration_limits_too(name: str, mode: str) -> None:
    offset, length = CASES[name]
    found = run(offset, length + 2.0, mode, acceleration=10.0)
    assert found.flips <= 5
    assert found.excess <= 1e-9
    assert found.final < 1e-4


# ---------------------------------------------------------------------------------------- braking


@given(SEEDS)
@settings(max_examples=100)
def test_a_motion_that_is_braked_can_stop_at_its_end(seed: int) -> None:
    """From v(1) on, braking at the planned rate from step to step goes no further than the end."""
    rng = np.random.default_rng(seed)
    motion, dt = rng.normal(size=5) * 10.0 ** rng.uniform(-5, 1), 10.0 ** rng.uniform(-3, -1)
    acceleration = rng.uniform(1.0, 50.0, 5)
    share = stopping_share(motion, acceleration, dt)
    rate = 0.8 * np.min(acceleration / np.abs(motion))
    speed, way = share / dt, 0.0
    while speed > 0.0:
        way += speed * dt
        speed -= rate * dt
    assert way <= 1.0 + 1e-9
    if share < 1.0:
        assert share == pytest.approx(dt * stopping_speed(np.array(1.0), np.array(rate), dt))


@pytest.mark.parametrize("mode", ["scale", "relax"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_target_is_reached_without_overshoot(mode: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    away = rng.normal(size=3)
    away *= 0.2 / np.linalg.norm(away)
    away[2] -= 0.05
    configuration = mink.Configuration(SEVEN, HOME.copy())
    home = configuration.get_transform_frame_to_world("tool", "site")
    goal = home.translation() + away
    task = qt.TwistTask.axis_free("tool", "site")
    task.set_target(mink.SE3.from_rotation_and_translation(home.rotation(), goal))
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST, acceleration=10.0)
    controller = qt.Controller(
        SEVEN,
        [task],
        limits=[limit],
        solver="daqp",
        on_infeasible=mode,  # type: ignore[arg-type]
    )
    errors = []
    for _ in range(240):
        step = controller.step(configuration, DT)
        configuration.integrate_inplace(step.velocity, DT)
        place = configuration.get_transform_frame_to_world("tool", "site").translation()
        errors.append(float(np.linalg.norm(place - goal)))
    outside = np.array(errors) > 1e-3
    assert (np.flatnonzero(outside)[-1] + 1) * DT <= 0.7
    assert np.count_nonzero(np.diff(outside.astype(int)) == 1) == 0
    assert errors[-1] < 1e-6


def test_a_target_with_its_twist_keeps_its_speed() -> None:
    """0.1 m/s along y under acceleration limits: without a lag once the arm is at speed."""
    speed = np.array([0.0, 0.1, 0.0])
    found = run(lambda t: speed * t, 1.0, "scale", acceleration=10.0, twist=lambda _: speed)
    assert found.final < 1e-4 + 0.1 * DT


# ----------------------------------------------------------------------------------------- levels


def test_a_braked_step_names_the_joint_that_could_not_stop() -> None:
    configuration = mink.Configuration(SEVEN, HOME.copy())
    task = qt.TwistTask.axis_free("tool", "site")
    pose = configuration.get_transform_frame_to_world("tool", "site")
    task.set_target(pose.plus(np.array([0.002, 0.0, 0.0, 0.0, 0.0, 0.0])))
    limit = qt.MotionLimit(SEVEN, acceleration=10.0)
    controller = qt.Controller(SEVEN, [task], limits=[limit], solver="daqp")
    A, b = task.velocity_rows(configuration, DT)
    step = controller.step(configuration, DT, velocity=np.linalg.pinv(A) @ b * 0.2)
    assert step.status is qt.Status.SCALED
    assert step.scale < 1.0
    (limit_named,) = step.binding[:1]
    assert limit_named.kind == "acceleration"
    np.testing.assert_allclose(A @ step.velocity, step.scale * b, atol=1e-7)
    free = qt.Controller(SEVEN, [task], limits=[], solver="daqp")
    free.braking = False
    assert free.step(configuration, DT).status is qt.Status.SOLVED


def test_a_limit_that_would_stop_the_scaled_task_is_gone_around() -> None:
    """A joint at its limit that the task needs: scale 0, and yet the error becomes smaller."""
    q = np.array([0.638, 1.47, 0.016, 0.451, -0.039, 2.09, 0.0])
    configuration = mink.Configuration(SEVEN, q)
    home = mink.Configuration(SEVEN, HOME.copy()).get_transform_frame_to_world("tool", "site")
    task = qt.TwistTask.axis_free("tool", "site")
    task.set_target(home)
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST)
    controller = qt.Controller(SEVEN, [task], limits=[limit], solver="daqp")
    for _ in range(500):
        configuration.integrate_inplace(controller.step(configuration, DT).velocity, DT)
    place = configuration.get_transform_frame_to_world("tool", "site")
    np.testing.assert_allclose(place.translation(), home.translation(), atol=1e-4)


def test_a_weak_direction_that_a_limit_stops_is_gone_around_in_both_statements() -> None:
    """Joint 2 of six at its limit, the target 0.5 m away in the direction that is nearly lost."""
    path_task = qt.load_task("deburring")
    model = path_task.model
    q = np.array([0.083140453, -1.5708, -1.725138589, -0.452886106, 0.257855346, -2.722331898])
    q[1] = model.jnt_range[1, 0]
    configuration = mink.Configuration(model, q)
    home = np.array([0.0, 0.3, -0.4, 0.0, -0.9, 0.0])
    goal = mink.Configuration(model, home).get_transform_frame_to_world("tool", "site")
    found = []
    for solver in ("compiled", "daqp"):
        task = qt.TwistTask.axis_free("tool", "site")
        task.set_target(goal)
        controller = qt.Controller(
            model, [task], limits=[qt.MotionLimit(model, velocity=FASTEST)], solver=solver,
            secondary=[qt.PostureReference(model, home, gain=0.01)],
        )  # fmt: skip
        found.append(controller.step(configuration, DT))
        assert controller.reference_steps == 0 or solver == "daqp"
    np.testing.assert_allclose(found[0].velocity, found[1].velocity, atol=1e-6)
    assert found[0].status is found[1].status
    A, b = task.velocity_rows(configuration, DT)
    assert b @ A @ found[0].velocity > 0.0  # it comes nearer


def test_what_is_lost_far_outside_does_not_shake_the_other_directions() -> None:
    """Two arms, the target of one up to 1.5 m outside, which made joints reverse at every step."""
    model = mujoco.MjModel.from_xml_path(str(TWO_ARMS))
    home = np.tile(HOME, 2)
    tasks = [qt.TwistTask.axis_free(name, "site") for name in ("left_tool", "right_tool")]
    controller = qt.Controller(
        model, tasks, limits=[qt.MotionLimit(model, velocity=FASTEST)],
        secondary=[qt.PostureReference(model, home, gain=0.01)],
    )  # fmt: skip
    configuration = mink.Configuration(model, home)
    first, second = (
        configuration.get_transform_frame_to_world(t.frame_name, "site") for t in tasks
    )
    tasks[1].set_target(second)
    rng = np.random.default_rng([10269, 7])
    waves = rng.normal(size=(3, 3)) * rng.uniform(0.05, 0.6)
    rates = rng.uniform(0.5, 4.0, 3)
    turn = rng.normal(size=3) * rng.uniform(0.0, 0.8)
    before, flips = np.zeros(model.nv), 0
    for i in range(250):
        window = np.sin(0.5 * np.pi * i * DT)
        tasks[0].set_target(
            mink.SE3.from_rotation_and_translation(
                mink.SO3.exp(window * turn) @ first.rotation(),
                first.translation() + window * np.sin(rates * i * DT) @ waves,
            )
        )
        velocity = controller.step(configuration, DT).velocity
        fast = np.minimum(np.abs(velocity), np.abs(before)) > 0.3
        flips += int(((velocity * before < 0.0) & fast).sum())
        before = velocity
        configuration.integrate_inplace(velocity, DT)
    assert flips <= 5


def test_a_lower_level_out_of_reach_is_calm_and_moves_nothing_above_it() -> None:
    configuration = mink.Configuration(SEVEN, HOME.copy())
    home = configuration.get_transform_frame_to_world("tool", "site")
    elbow = configuration.get_transform_frame_to_world("link_4", "body")
    task, elbow_task = qt.TwistTask.point("tool", "site"), qt.TwistTask.point("link_4", "body")
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST)
    options: Any = {
        "limits": [limit], "solver": "daqp",
        "secondary": [qt.PostureReference(SEVEN, HOME, gain=0.01)],
    }  # fmt: skip
    controller = qt.Controller(SEVEN, levels=[[task], [elbow_task]], **options)
    alone = qt.Controller(SEVEN, levels=[[task]], **options)
    before, flips = np.zeros(7), 0
    for i in range(400):
        t = 2.5 * i * DT
        task.set_target(
            mink.SE3.from_rotation_and_translation(
                home.rotation(),
                home.translation()
                + 0.3 * np.array([0.3 * np.sin(t), 0.3 * np.sin(2 * t), 0.15 * np.sin(3 * t)]),
            )
        )
        share = np.sin(np.pi * min(i / 320, 1.0))
        elbow_task.set_target(
            mink.SE3.from_translation(elbow.translation() + share * np.array([0, 0.6, 0.1]))
        )
        step = controller.step(configuration, DT, velocity=before)
        A, _ = task.velocity_rows(configuration, DT)
        above = alone.step(configuration, DT, velocity=before)
        np.testing.assert_allclose(A @ step.velocity, A @ above.velocity, atol=1e-9)
        fast = np.minimum(np.abs(step.velocity), np.abs(before)) > 0.3
        flips += int(((step.velocity * before < 0.0) & fast).sum())
        before = step.velocity
        configuration.integrate_inplace(step.velocity, DT)
    assert flips <= 5


@given(SEEDS)
@settings(max_examples=60)
def test_levels_give_way_in_the_kernel_as_in_the_reference(seed: int) -> None:
    """Two levels of a redundant arm, the lower one far away, some with acceleration limits."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, int(rng.integers(7, 12)))
    configuration = mink.Configuration(model, random_configuration(model, rng, margin=0.2))
    tasks = [qt.TwistTask.point("tool", "site"), qt.TwistTask.point("link_5", "body")]
    for task, size in zip(tasks, (0.003, 0.3), strict=True):
        pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        away = size * rng.uniform() * rng.normal(size=3)
        task.set_target(
            mink.SE3.from_rotation_and_translation(pose.rotation(), pose.translation() + away)
        )
    acceleration = 10.0 ** rng.uniform(1, 3) if rng.random() < 0.5 else None
    before = 0.2 * rng.normal(size=model.nv) * (rng.random() < 0.5)
    found = []
    for solver in ("compiled", "daqp"):
        limit = qt.MotionLimit(model, velocity=2.0, acceleration=acceleration)
        controller = qt.Controller(
            model, levels=[[task] for task in tasks], limits=[limit], solver=solver,
            secondary=[qt.PostureReference(model, np.zeros(model.nv), gain=0.05)],
        )  # fmt: skip
        found.append(controller.step(configuration, 0.02, velocity=before))
    ours, theirs = found
    size = 1.0 + np.abs(theirs.velocity).max()
    assert ours.status is theirs.status
    np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=1e-6 * size)
    assert ours.scale == pytest.approx(theirs.scale, abs=1e-8)
    assert {str(v) for v in ours.binding} == {str(v) for v in theirs.binding}
    event(f"{ours.status.name} by {type(ours).__name__}")


def test_joints_that_just_stop_at_their_limits_are_braked_in_the_kernel() -> None:
    """At the stopping speed rounding decides which bound is higher: acceleration counts first."""
    model = SEVEN
    away = np.array([2.9, 2.0, -2.9, 2.0, 2.9, -2.0, 3.0])
    found = []
    for solver in ("compiled", "daqp"):
        configuration = mink.Configuration(model, 0.3 * away)
        limit = qt.MotionLimit(model, velocity=FASTEST, acceleration=10.0)
        task = qt.TwistTask(
            "tool",
            "site",
            qt.TwistProjector(linear=qt.Projector.none(), angular=qt.Projector.none()),
        )
        task.set_target_from_configuration(configuration)
        controller = qt.Controller(
            model, [task], limits=[limit], solver=solver,
            secondary=[qt.PostureReference(model, 2.0 * away, gain=1.0)],
        )  # fmt: skip
        for _ in range(400):
            configuration.integrate_inplace(controller.step(configuration, DT).velocity, DT)
        found.append(configuration.q)
        if solver == "compiled":
            assert controller.reference_steps == 0
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
    np.testing.assert_allclose(np.abs(found[0]), model.jnt_range[:, 1], atol=1e-6)


def test_a_secondary_leads_out_of_the_singularity() -> None:
    """A 2R arm exactly stretched, its target inwards: the rows see nothing of it at first."""
    model = planar_arm([0.5, 0.4])
    configuration = mink.Configuration(model, np.array([0.3, 0.0]))
    plane = qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none())
    task = qt.TwistTask("tip", "site", plane)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    task.set_target(mink.SE3.from_translation(0.8 * tip))
    posture = qt.PostureReference(model, np.array([0.0, 0.6]), gain=0.2)
    controller = qt.Controller(model, tasks=[task], secondary=[posture], solver="daqp")
    assert controller.step(configuration, 0.1).status is qt.Status.DEGRADED
    for _ in range(120):
        configuration.integrate_inplace(controller.step(configuration, 0.1).velocity, 0.1)
    reached = configuration.get_transform_frame_to_world("tip", "site").translation()
    np.testing.assert_allclose(reached, 0.8 * tip, atol=1e-6)


@pytest.mark.parametrize("mode", ["scale", "relax"])
@pytest.mark.parametrize(
    ("before", "name", "value"),
    [
        ({}, "smooth", False),
        ({"smooth": False}, "smooth", True),
        ({}, "singularity", 0.0),
        ({"singularity": 0.0}, "singularity", 5e-3),
        ({}, "braking", False),
        ({"acceleration": np.inf}, "max_acceleration", np.full(7, 5.0)),
        ({"velocity": np.inf, "acceleration": np.inf}, "max_velocity", np.full(7, 1.0)),
    ],
)
def test_settings_that_change_between_two_steps_are_those_of_the_next(
    mode: str, before: dict, name: str, value: object
) -> None:
    """The compiled step beside the reference, which reads them anew at every step."""
    before = dict(before)
    motion = {"velocity": 1.5, "acceleration": 10.0}
    motion |= {key: before.pop(key) for key in motion if key in before}
    steps = []
    for solver in (None, "daqp"):
        task = qt.TwistTask.axis_free("tool", "site")
        limit = qt.MotionLimit(SEVEN, **motion)  # type: ignore[arg-type]
        controller = qt.Controller(
            SEVEN, [task], limits=[limit], solver=solver,
            on_infeasible=mode,  # type: ignore[arg-type]
        )  # fmt: skip
        for setting, first in before.items():
            setattr(controller, setting, first)
        near, stretched = (
            mink.Configuration(SEVEN, q) for q in (HOME, HOME * [0, 1, 0, 0.04, 0, 0.2, 0])
        )
        result = []
        for change in (False, True):
            if change:
                setattr(limit if name.startswith("max") else controller, name, value)
            for configuration, distance in ((near, 0.1), (stretched, 0.01)):
                tool = configuration.get_transform_frame_to_world("tool", "site")
                shift = np.array([distance, 0.0, 0.5 * distance])
                task.set_target(mink.SE3.from_translation(shift) @ tool)
                result.append(controller.step(configuration, DT, velocity=np.zeros(7)))
        assert controller.reference_steps == (0 if solver is None else 4)
        steps.append(result)
    for compiled, reference in zip(*steps, strict=True):
        assert compiled.status is reference.status
        np.testing.assert_allclose(compiled.velocity, reference.velocity, atol=1e-6)
        assert compiled.scale == pytest.approx(reference.scale, rel=1e-6)
    pairs = [(steps[1][k], steps[1][k + 2]) for k in (0, 1)]
    changes = [[*(a.velocity - b.velocity), a.scale / b.scale - 1.0] for a, b in pairs]
    # Otherwise nothing is tested. From rest the acceleration limit scales as much as braking would.
    assert np.abs(changes).max() > 1e-4 or (name, mode) == ("braking", "scale")


@pytest.mark.parametrize(
    ("name", "value"), [("on_infeasible", "stop"), ("smooth", "no"), ("braking", 0.5)]
)
def test_a_setting_that_does_not_exist_is_refused_when_assigned(name: str, value: object) -> None:
    controller = qt.Controller(SEVEN, [qt.TwistTask.point("tool", "site")])
    with pytest.raises(qt.InvalidInput, match=f"{name}: expected"):
        setattr(controller, name, value)


# ---------------------------------------------------------------------------------------- noise


def _turns_under_noise(acceleration: Any, mode: str) -> int:
    """How many joints turn round at speed, following a noisy pose 6 mm inside the reach."""
    path, rng = qt.load_task("deburring"), np.random.default_rng(0)
    full = qt.Projector.full()
    task = qt.TwistTask("tool", "site", qt.TwistProjector(linear=full, angular=full))
    configuration = mink.Configuration(path.model, path.start)
    home = configuration.get_transform_frame_to_world("tool", "site")
    far = np.array([3.0, 0.0, 0.0])
    task.set_target(mink.SE3.from_translation(far) @ home)
    limits: list[mink.Limit] = [qt.MotionLimit(path.model, velocity=3.0)]
    posture = qt.PostureReference(path.model, path.start, gain=1e-3)
    reaching = qt.Controller(
        path.model, [task], limits=limits, secondary=[posture], on_infeasible="relax"
    )
    for _ in range(500):
        configuration.integrate_inplace(reaching.step(configuration, 0.02).velocity, 0.02)
    edge = configuration.get_transform_frame_to_world("tool", "site")
    place = edge.translation() - [0.006, 0.0, 0.0]
    controller = qt.Controller(
        path.model,
        [task],
        limits=[qt.MotionLimit(path.model, velocity=FASTEST, acceleration=acceleration)],
        secondary=[qt.PostureReference(path.model, path.start, gain=0.01)],
        on_infeasible=mode,
    )
    turns, before = 0, np.zeros(path.model.nv)
    for _ in range(400):
        noise = 5e-4 * rng.normal(size=6)
        turn = mink.SO3.exp(noise[3:]) @ edge.rotation()
        task.set_target(mink.SE3.from_rotation_and_translation(turn, place + noise[:3]))
        velocity = controller.step(configuration, DT).velocity
        fast = np.minimum(np.abs(velocity), np.abs(before)) > 0.3
        turns += int((fast & (velocity * before < 0.0)).sum())
        configuration.integrate_inplace(velocity, DT)
        before = velocity
    return turns


@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_noise_at_the_edge_turns_no_joint_round_with_an_acceleration_limit(mode: str) -> None:
    """The default of a joint with a speed limit: full speed within 50 ms."""
    assert _turns_under_noise("default", mode) == 0

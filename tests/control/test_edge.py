"""At the edge of the reach and near singularities: continuous, calm, and exact everywhere else."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.arms import planar_arm, random_configuration, seven_axes
from oracles.twists import PLANE, SPATIAL, at, pose, site
from oracles.walks import reversals, walk

import qp_twist as qt
from qp_twist.constraints import stopping_share, stopping_speed
from qp_twist.qp import Directions, one_program
from qp_twist.qp import directions as read

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
EPSILON, DT = 1e-3, 0.005
FASTEST = 0.5 * np.pi
HOME = np.array([0, 0.5, 0, -1.4, 0, 1.2, 0])
SEVEN = seven_axes()
DEBURRING = qt.load_task("deburring")
BOTH_MODES = pytest.mark.parametrize("mode", ["scale", "relax"])


def controller_of(model: mujoco.MjModel, tasks: Any, home: Array, **options: Any) -> qt.Controller:
    """With speed limits, drawn weakly to a posture."""
    acceleration = options.pop("acceleration", "default")
    limit = qt.MotionLimit(model, velocity=FASTEST, acceleration=acceleration)
    posture = qt.PostureReference(model, home, gain=0.01)
    return qt.Controller(model, tasks, limits=[limit], secondary=[posture], **options)


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
def test_a_weak_direction_is_met_by_the_damped_inverse(seed: int) -> None:
    """Its cost beside that of the joints has the damped inverse as its minimum, whatever A is."""
    A, error = weak_rows(np.random.default_rng(seed))
    found = Directions.of(A, error, 1.0, EPSILON)
    n, weak = A.shape[1], found.slack > 0.0
    H, c = one_program.with_weak_rows(
        np.eye(n), np.zeros(n), found.rows, found.rate, found.slack, np.ones(len(error))
    )
    E, e = found.rows[~weak], found.rate[~weak]
    saddle = np.block([[H, E.T], [E, np.zeros((len(e), len(e)))]])
    x = np.linalg.lstsq(saddle, np.concatenate([-c, e]), rcond=None)[0][:n]
    np.testing.assert_allclose(x, found.motion(), atol=1e-7 * (1.0 + np.abs(x).max()))
    # What is weak moves by at most σ/ℓ: the arm does not leap over the singularity.
    share = np.maximum(0.0, 1.0 - (found.sigma / 0.05) ** 2) ** 3
    step = share * np.abs(found.rate) * found.sigma / np.maximum(found.damped, 1e-300)
    assert (step <= found.sigma / (read.BEND * found.size) + 1e-12).all()


@given(SEEDS)
def test_no_weak_singular_value_changes_faster_than_its_bound(seed: int) -> None:
    """|uᵀ dA(v) v| by differences of A: below ℓ, so that the damped step comes to rest."""
    rng = np.random.default_rng(seed)
    if rng.random() < 0.5:
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

    left, sigma, right = np.linalg.svd(rows(q))
    for i in np.flatnonzero(sigma < 0.1 * sigma[0]):
        v = right[i]
        change = (rows(q + 1e-6 * v) - rows(q - 1e-6 * v)) / 2e-6
        assert abs(left[:, i] @ change @ v) <= read.BEND * sigma[0]


# ----------------------------------------------------------------------------- one step of a robot


THREE_LINKS = planar_arm([0.5, 0.4, 0.1])
BEFORE = np.array([0.9, -1.3, 0.6])


@cache
def planar_controller(mode: str, *, inertia: bool) -> qt.Controller:
    """Of a 3R arm: made once, since that takes ten times as long as a step."""
    task = qt.TwistTask("tip", "site", PLANE)
    limits: list[mink.Limit] = [qt.MotionLimit(THREE_LINKS, velocity=FASTEST)]
    if not inertia:
        names = [THREE_LINKS.joint(i).name for i in range(3)]
        speeds = dict.fromkeys(names, FASTEST)
        limits = [qt.PositionLimit(THREE_LINKS), mink.VelocityLimit(THREE_LINKS, speeds)]
    posture = qt.PostureReference(THREE_LINKS, np.array([-0.4, 0.8, 0.4]), gain=0.01)
    return qt.Controller(
        THREE_LINKS, [task], limits=limits, on_infeasible=mode, secondary=[posture]  # type: ignore[arg-type]
    )  # fmt: skip


def planar_step(
    q2: float, distance: float, mode: str, side: float = 0.02, before: Array | None = None
) -> qt.Step:
    """A 3R arm with its second joint at q2 (straight at 0) and its target further along x.

    With the velocity ``before`` the joints have inertia.
    """
    configuration = mink.Configuration(THREE_LINKS, np.array([-0.5 * q2, q2, -0.3 * q2]))
    controller = planar_controller(mode, inertia=before is not None)
    tip = site(configuration, "tip").translation()
    controller.twist_tasks[0].set_target(at(*(tip + np.array([distance, side, 0.0]))))
    return controller.step(configuration, DT, velocity=before)


@pytest.mark.parametrize("before", [None, BEFORE], ids=["", "inertia"])
@BOTH_MODES
@pytest.mark.parametrize("along", ["q", "target"])
def test_the_velocity_is_continuous_across_the_edge(
    mode: str, along: str, before: Array | None
) -> None:
    """Where the velocity changes most on a line across the edge, it changes by nothing at last.

    The largest changes are enclosed by bisection: a jump would stay as large as it is.
    """

    def velocity(x: float) -> Array:
        place = (0.05 * x, 0.3) if along == "q" else (0.02, 0.05 * x)
        return planar_step(*place, mode, before=before).velocity

    line = np.linspace(-1.0, 1.0, 101)
    found = np.array([velocity(x) for x in line])
    change = np.abs(np.diff(found, axis=0)).max(axis=1)
    for k in np.argsort(-change)[:3]:
        (a, b), (at_a, at_b) = line[k : k + 2], found[k : k + 2]
        for _ in range(24):
            middle = 0.5 * (a + b)
            between = velocity(middle)
            if np.abs(between - at_a).max() > np.abs(between - at_b).max():
                b, at_b = middle, between
            else:
                a, at_a = middle, between
        assert np.abs(at_b - at_a).max() < 1e-4


@BOTH_MODES
def test_a_small_error_in_a_weak_direction_falls_by_the_stated_share(mode: str) -> None:
    """σ²/σ₁² of it in a step, and all of the rest: the error of a target that stays vanishes."""
    step = planar_step(0.15, -1e-4, mode, side=0.0)
    assert 0.01 < step.sigma_min < 0.05
    kept = (step.sigma_min / 0.05) ** 2
    assert step.status is qt.Status.DEGRADED
    (weak,) = step.lost
    assert weak.share == pytest.approx(kept, rel=1e-6)
    missing = abs(float(weak.direction @ step.residuals[0]))
    assert missing == pytest.approx((1.0 - kept) * 1e-4 / DT, rel=1e-2)  # almost all of it is weak
    assert np.linalg.norm(step.residuals[0]) == pytest.approx(missing, rel=1e-2)


@BOTH_MODES
def test_noise_at_the_edge_turns_no_joint_round_with_an_acceleration_limit(mode: str) -> None:
    """A noisy pose 6 mm inside; the default of a joint with a speed limit: full speed in 50 ms."""
    model, start, rng = DEBURRING.model, DEBURRING.start, np.random.default_rng(0)
    task = qt.TwistTask("tool", "site", SPATIAL)
    configuration = mink.Configuration(model, start)
    task.set_target(at(3.0, 0.0, 0.0) @ site(configuration))
    reaching = qt.Controller(
        model, [task], limits=[qt.MotionLimit(model, velocity=3.0)], on_infeasible="relax",
        secondary=[qt.PostureReference(model, start, gain=1e-3)],
    )  # fmt: skip
    walk(reaching, configuration, 500, 0.02)
    edge = site(configuration)
    place = edge.translation() - [0.006, 0.0, 0.0]

    def noise(_: float) -> None:
        by = 5e-4 * rng.normal(size=6)
        task.set_target(pose(mink.SO3.exp(by[3:]) @ edge.rotation(), place + by[:3]))

    controller = controller_of(model, [task], start, on_infeasible=mode)
    assert reversals(walk(controller, configuration, 400, DT, noise)[1]) == 0


# ------------------------------------------------------------------------------------------- runs


class Run(NamedTuple):
    """What a run shows."""

    flips: int
    rms: float
    final: float
    excess: float


def run(
    offset: Callable[[float], Array], length: float, mode: str, *, acceleration: Any = "default",
    twist: Callable[[float], Array] | None = None, solver: str | None = None,
) -> Run:  # fmt: skip
    """The seven-axis arm at 200 Hz after a target that starts at home."""
    configuration = mink.Configuration(SEVEN, HOME.copy())
    home, task = site(configuration), qt.TwistTask.axis_free("tool", "site")

    def feed(t: float) -> None:
        goal = pose(home.rotation(), home.translation() + offset(t))
        task.set_target(goal, None if twist is None else np.append(twist(t), np.zeros(3)))

    controller = controller_of(
        SEVEN, [task], HOME, acceleration=acceleration, solver=solver, on_infeasible=mode
    )
    q, v = walk(controller, configuration, round(length / DT), DT, feed)
    lower, upper = SEVEN.jnt_range.T
    changes = np.abs(np.diff(np.vstack([np.zeros(7), v]), axis=0))
    hardest = controller.limits[0].max_acceleration  # type: ignore[attr-defined]
    over = (q - upper, lower - q, np.abs(v) - FASTEST, changes - hardest * DT)
    assert task.target is not None
    left = site(configuration).translation() - task.target.translation()
    rms = float(np.sqrt((changes**2).mean())) / DT
    return Run(reversals(v), rms, float(np.linalg.norm(left)), max(float(x.max()) for x in over))


def there_and_back(direction: list[float], length: float) -> Callable[[float], Array]:
    return lambda t: np.array(direction) * np.sin(np.pi * min(t / length, 1.0))


CASES: dict[str, tuple[Callable[[float], Array], float]] = {
    "out": (there_and_back([0.7, 0, 0], 1.6), 2.8),
    "diagonal": (there_and_back([0.5, 0.5, 0], 1.6), 2.8),
    "jump": (lambda t: np.array([0.7, 0.2, 0.1]) * (0.1 < t < 1.1), 2.6),
    "20 mm outside": (lambda t: np.array([0.2245 * min(t / 0.5, 1.0), 0, 0]), 1.5),
    "folded": (there_and_back([-0.6, 0, -0.1], 1.6), 2.6),
}


@BOTH_MODES
@pytest.mark.parametrize("name", CASES)
def test_no_joint_chatters_when_the_target_leaves_the_reach(name: str, mode: str) -> None:
    offset, length = CASES[name]
    found = run(offset, length, mode)
    assert found.flips <= 5
    assert found.rms < 30.0
    assert found.excess <= 1e-9
    if name != "20 mm outside":
        assert found.final < 1e-4


# ---------------------------------------------------------------------------------------- braking


@given(SEEDS)
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


@BOTH_MODES
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_target_is_reached_without_overshoot(mode: str, seed: int) -> None:
    away = np.random.default_rng(seed).normal(size=3)
    away *= 0.2 / np.linalg.norm(away)
    away[2] -= 0.05
    configuration = mink.Configuration(SEVEN, HOME.copy())
    home, task = site(configuration), qt.TwistTask.axis_free("tool", "site")
    goal = home.translation() + away
    task.set_target(pose(home.rotation(), goal))
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST, acceleration=10.0)
    controller = qt.Controller(SEVEN, [task], limits=[limit], on_infeasible=mode)  # type: ignore[arg-type]
    q, _ = walk(controller, configuration, 240, DT)
    places = [site(mink.Configuration(SEVEN, row)).translation() for row in q]
    errors = np.linalg.norm(np.array(places) - goal, axis=1)
    outside = errors > 1e-3
    assert (np.flatnonzero(outside)[-1] + 1) * DT <= 0.7
    assert np.count_nonzero(np.diff(outside.astype(int)) == 1) == 0
    assert errors[-1] < 1e-6


def test_a_braked_step_names_the_joint_that_could_not_stop() -> None:
    configuration = mink.Configuration(SEVEN, HOME.copy())
    task = qt.TwistTask.axis_free("tool", "site")
    task.set_target(site(configuration).plus(np.array([0.002, 0.0, 0.0, 0.0, 0.0, 0.0])))
    limit = qt.MotionLimit(SEVEN, acceleration=10.0)
    controller = qt.Controller(SEVEN, [task], limits=[limit], solver="daqp")
    A, b = task.velocity_rows(configuration, DT)
    step = controller.step(configuration, DT, velocity=np.linalg.pinv(A) @ b * 0.2)
    assert step.status is qt.Status.SCALED
    assert step.scale < 1.0
    assert step.binding[0].kind == "acceleration"
    np.testing.assert_allclose(A @ step.velocity, step.scale * b, atol=1e-7)
    free = qt.Controller(SEVEN, [task], limits=[], solver="daqp")
    free.braking = False
    assert free.step(configuration, DT).status is qt.Status.SOLVED


# ------------------------------------------------------------------- around what is in the way


def test_a_limit_that_would_stop_the_scaled_task_is_gone_around() -> None:
    """A joint at its limit that the task needs: scale 0, and yet the error becomes smaller."""
    q = np.array([0.638, 1.47, 0.016, 0.451, -0.039, 2.09, 0.0])
    configuration = mink.Configuration(SEVEN, q)
    home = site(mink.Configuration(SEVEN, HOME.copy()))
    task = qt.TwistTask.axis_free("tool", "site")
    task.set_target(home)
    limit = qt.MotionLimit(SEVEN, velocity=FASTEST)
    walk(qt.Controller(SEVEN, [task], limits=[limit]), configuration, 500, DT)
    np.testing.assert_allclose(site(configuration).translation(), home.translation(), atol=1e-4)

"""Twist tasks by name, relative ones, gaze, and targets that move."""

from collections.abc import Callable

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import mink_problems

import qp_twist as qt

DT = 0.01
LEFT, RIGHT = ("left_hand", "site"), ("right_hand", "site")
seeds = st.integers(0, 10_000)

Make = Callable[..., qt.TwistTask]
NAMED: dict[str, tuple[Make, int]] = {
    "axis_free": (qt.TwistTask.axis_free, 5), "point": (qt.TwistTask.point, 3),
    "on_line": (qt.TwistTask.on_line, 2), "on_plane": (qt.TwistTask.on_plane, 1),
    "flat on_plane": (lambda *a, **k: qt.TwistTask.on_plane(*a, flat=True, **k), 3),
    "line_on_line": (qt.TwistTask.line_on_line, 4), "gaze": (qt.GazeTask, 2),
}  # fmt: skip


def pose(c: mink.Configuration, frame: tuple[str, str]) -> mink.SE3:
    return c.get_transform_frame_to_world(*frame)


def near(c: mink.Configuration, rng: np.random.Generator, far: float = 1.0) -> mink.SE3:
    """A pose near that of the left hand, in the world."""
    now = pose(c, LEFT)
    return mink.SE3.from_rotation_and_translation(
        mink.SO3.exp(0.2 * far * rng.normal(size=3)) @ now.rotation(),
        now.translation() + 0.05 * far * rng.normal(size=3),
    )


def off(name: str, frame: mink.SE3, target: mink.SE3) -> float:
    """How far a frame is from what the task of that name means, by its geometry alone."""
    p = target.inverse() @ frame
    x, R = p.translation(), p.rotation().as_matrix()
    if name == "axis_free":
        return float(np.linalg.norm(x) + np.linalg.norm(R[:, 2] - [0, 0, 1]))
    if name == "point":
        return float(np.linalg.norm(x))
    if name == "on_line":  # the x axis of the target
        return float(np.linalg.norm(x[1:]))
    if name == "on_plane":  # its xy plane
        return float(abs(x[2]))
    if name == "flat on_plane":
        return float(abs(x[2]) + np.linalg.norm(R[:, 2] - [0, 0, 1]))
    if name == "line_on_line":  # its z axis
        return float(np.linalg.norm(x[:2]) + np.linalg.norm(R[:, 2] - [0, 0, 1]))
    back = (frame.inverse() @ target).translation()
    return float(np.linalg.norm(back / np.linalg.norm(back) - [0, 0, 1]))


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("name", NAMED)
def test_a_named_task_leads_to_what_its_name_says(name: str, relative: bool) -> None:
    make, rank = NAMED[name]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        c = mink_problems.configuration(seed)
        target = near(c, rng)
        if name == "gaze":
            target = target @ mink.SE3.from_translation(np.array([0.1, 0.1, 0.5]))
        task = make(*LEFT, **({"relative_to": RIGHT} if relative else {}))
        task.set_target(pose(c, RIGHT).inverse() @ target if relative else target)
        assert task.projector.rank == rank
        J = task.compute_jacobian(c)
        assert J.shape == (rank, c.model.nv)
        assert np.linalg.matrix_rank(J) == rank
        controller = qt.Controller(c.model, [task], limits=[])
        before = off(name, pose(c, LEFT), target)
        assert before > 1e-3
        for _ in range(10):
            c.integrate_inplace(controller.step(c, DT).velocity, DT)
        if relative:  # the other arm has moved as well, and taken the target along
            assert task.target is not None
            target = pose(c, RIGHT) @ task.target
        assert off(name, pose(c, LEFT), target) < 1e-7


def difference(c: mink.Configuration, v: np.ndarray, of: Callable[[], np.ndarray]) -> np.ndarray:
    """Derivative of what ``of`` reads from the configuration, along v."""
    q, h, read = c.q.copy(), 1e-6, []
    for sign in (1.0, -1.0):
        c.update(q)
        c.integrate_inplace(sign * h * v, 1.0)
        read.append(of())
    c.update(q)
    return (read[0] - read[1]) / (2.0 * h)


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_the_relative_jacobian_is_the_derivative_of_the_relative_pose(seed: int) -> None:
    rng, c = np.random.default_rng(seed), mink_problems.configuration(seed)
    v = rng.normal(size=c.model.nv)

    def position() -> np.ndarray:
        return (pose(c, RIGHT).inverse() @ pose(c, LEFT)).translation()

    start = (pose(c, RIGHT).inverse() @ pose(c, LEFT)).rotation()

    def turned() -> np.ndarray:
        now = (pose(c, RIGHT).inverse() @ pose(c, LEFT)).rotation()
        return (now @ start.inverse()).log()

    R = pose(c, RIGHT).rotation().as_matrix()
    task = qt.TwistTask.point(*LEFT, relative_to=RIGHT)
    task.set_target(mink.SE3.identity())
    twist = task.state(c).jacobian @ v
    np.testing.assert_allclose(R.T @ twist[:3], difference(c, v, position), atol=1e-7)
    np.testing.assert_allclose(R.T @ twist[3:], difference(c, v, turned), atol=1e-7)


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from(sorted(NAMED)), st.booleans())
def test_the_rows_are_the_derivative_of_the_error_at_the_target(
    seed: int, name: str, relative: bool
) -> None:
    """There the error is zero in the rows, whatever the free directions hold."""
    rng, c = np.random.default_rng(seed), mink_problems.configuration(seed)
    task = NAMED[name][0](*LEFT, **({"relative_to": RIGHT} if relative else {}))
    free = np.zeros(3)
    if name == "gaze":
        free = np.array([0.0, 0.0, rng.uniform(0.2, 2.0)])
    elif task.projector.linear.rank < 3:
        T = task.projector.linear.complement.matrix
        free = T @ rng.normal(size=3)
    target = pose(c, LEFT) @ mink.SE3.from_translation(free)
    task.set_target(pose(c, RIGHT).inverse() @ target if relative else target)
    np.testing.assert_allclose(task.compute_error(c), 0.0, atol=1e-9)
    v = rng.normal(size=c.model.nv)
    U = task.state(c).basis
    expected = difference(c, v, lambda: U.T @ -task.state(c).error)
    np.testing.assert_allclose(task.compute_jacobian(c) @ v, expected, atol=2e-6)


@settings(max_examples=25, deadline=None)
@given(seeds, st.booleans())
def test_the_angle_of_the_gaze_changes_as_its_rows_say(seed: int, relative: bool) -> None:
    """At any angle: along the error itself the rows are exact."""
    rng, c = np.random.default_rng(seed), mink_problems.configuration(seed)
    task = qt.GazeTask(*LEFT, **({"relative_to": RIGHT} if relative else {}))
    at = near(c, rng, far=5.0)
    if relative:
        at = pose(c, RIGHT).inverse() @ at
    task.set_point(at.translation())
    v = rng.normal(size=c.model.nv)

    def angle() -> np.ndarray:
        target = task.target if not relative else pose(c, RIGHT) @ task.target
        sight = target.translation() - pose(c, LEFT).translation()
        axis = pose(c, LEFT).rotation().as_matrix()[:, 2]
        return np.array(np.arctan2(np.linalg.norm(np.cross(axis, sight)), axis @ sight))

    error = task.compute_error(c)
    direction = error / np.linalg.norm(error)
    along = direction @ task.compute_jacobian(c) @ v
    np.testing.assert_allclose(along, difference(c, v, angle), rtol=1e-4, atol=1e-4)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_bands_of_a_relative_task_see_the_relative_motion(seed: int) -> None:
    rng, c = np.random.default_rng(seed), mink_problems.configuration(seed)
    band = qt.SlabBand([0, 0, 1], -1.0, 1.0)
    T = qt.TwistProjector(
        linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none(), frame="target"
    )
    task = qt.TwistTask(*LEFT, T, relative_to=RIGHT, bands=[band])
    target = mink.SE3.from_rotation_and_translation(
        mink.SO3.exp(rng.normal(size=3)), rng.normal(size=3)
    )
    task.set_target(target)

    def distance() -> np.ndarray:
        x = (pose(c, RIGHT) @ target).inverse() @ pose(c, LEFT)
        return np.array(x.translation()[2])

    v = rng.normal(size=c.model.nv)
    [rows] = task.band_rows(c, DT)
    rate = difference(c, v, distance)
    np.testing.assert_allclose(np.abs(rows.rows @ v), np.abs(rate), atol=1e-6)


# ---------------------------------------------------------------- beside mink's own


def test_at_the_target_the_cost_of_the_axis_is_that_of_minks_axis_task() -> None:
    c = mink_problems.configuration(4)
    theirs = mink.AxisAlignTask(*LEFT, axis=(0, 0, 1), cost=1.0)
    theirs.set_target_from_configuration(c)
    T = qt.TwistProjector(
        linear=qt.Projector.none(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
    )
    ours = qt.TwistTask(*LEFT, T)
    ours.set_target_from_configuration(c)
    J, K = ours.compute_jacobian(c), theirs.compute_jacobian(c)
    assert len(J) == 2
    assert len(K) == 3
    np.testing.assert_allclose(J.T @ J, K.T @ K, atol=1e-12)


# ---------------------------------------------------------------- targets that move


def lag(dt: float, twist_at: Callable[[float], mink.SE3] | None, *, feedforward: bool) -> float:
    """Largest distance from a target on its way, once the start is over."""
    c = mink_problems.configuration(2)
    task, start = qt.TwistTask.axis_free(*LEFT), pose(c, LEFT)
    controller = qt.Controller(c.model, [task], limits=[])
    assert twist_at is not None
    worst = 0.0
    for k in range(round(0.5 / dt)):
        now, then = (twist_at(t) @ start for t in (k * dt, (k + 1) * dt))
        task.set_target(now, qt.target_twist(now, then, dt) if feedforward else None)
        c.integrate_inplace(controller.step(c, dt).velocity, dt)
        if k * dt > 0.1:
            arrived = pose(c, LEFT).translation() - then.translation()
            worst = max(worst, float(np.linalg.norm(arrived)))
    return worst


def conveyor(t: float) -> mink.SE3:
    return mink.SE3.from_translation(np.array([0.1, -0.2, 0.05]) * t)


def turntable(t: float) -> mink.SE3:
    return mink.SE3.from_rotation(mink.SO3.from_z_radians(0.5 * t))


@pytest.mark.parametrize("moving", [conveyor, turntable])
def test_a_moving_workpiece_is_followed_without_steady_lag(
    moving: Callable[[float], mink.SE3],
) -> None:
    behind = lag(0.01, moving, feedforward=False)
    coarse, fine = (lag(dt, moving, feedforward=True) for dt in (0.01, 0.005))
    assert behind > 1e-3  # speed times step
    assert coarse < 0.01 * behind
    assert fine < 0.3 * coarse + 1e-12  # what is left is of second order in the step


def test_a_part_on_a_carrier_that_moves_is_followed_by_the_task_itself() -> None:
    """The carrier is driven by another task; the first one keeps up with it."""
    c = mink_problems.configuration(3)
    weld = qt.TwistTask.axis_free(*LEFT, relative_to=RIGHT)
    weld.set_target_from_configuration(c)
    carry = qt.TwistTask("right_hand", "site", qt.load_task("deburring").operational)
    controller = qt.Controller(c.model, [weld, carry], limits=[])
    start = pose(c, RIGHT)
    for k in range(20):
        now, then = (conveyor(t) @ start for t in (k * DT, (k + 1) * DT))
        carry.set_target(now, qt.target_twist(now, then, DT))
        step = controller.step(c, DT)
        assert step.status is qt.Status.SOLVED
        c.integrate_inplace(step.velocity, DT)
        assert np.linalg.norm(weld.compute_error(c)) < 1e-4
    assert np.linalg.norm(pose(c, RIGHT).translation() - start.translation()) > 0.04


# ---------------------------------------------------------------- bad input


def test_bad_input_is_a_sentence() -> None:
    world = qt.TwistProjector(linear=qt.Projector.line([0, 0, 1]), angular=qt.Projector.none())
    with pytest.raises(qt.InvalidInput, match="give the projector frame='body' or frame='target'"):
        qt.TwistTask(*LEFT, world, relative_to=RIGHT)
    for wrong in ("right_hand", ("right_hand",), 3):
        with pytest.raises(qt.InvalidInput, match="expected \\(name, type\\) of a frame"):
            qt.TwistTask.point(*LEFT, relative_to=wrong)  # type: ignore[arg-type]
    with pytest.raises(mink.UnsupportedFrame):
        qt.TwistTask.point(*LEFT, relative_to=("right_hand", "hand"))
    c = mink_problems.configuration(0)
    task = qt.TwistTask.point(*LEFT, relative_to=("third_hand", "site"))
    with pytest.raises(mink.InvalidFrame):
        task.set_target_from_configuration(c)
    with pytest.raises(qt.InvalidInput, match="bands"):
        qt.GazeTask(*LEFT, bands=[qt.RollBand([0, 0, 1], -1.0, 1.0)])
    look = qt.GazeTask(*LEFT)
    with pytest.raises(qt.InvalidTarget):
        look.set_point([np.nan, 0.0, 0.0])
    look.set_point(pose(c, LEFT).translation())
    with pytest.raises(qt.InvalidInput, match="no direction to look in"):
        look.compute_error(c)
    with pytest.raises(qt.InvalidInput, match=r"axis=….*has no direction"):
        qt.GazeTask(*LEFT, axis=[0, 0, 0])
    with pytest.raises(qt.InvalidInput, match="dt"):
        qt.target_twist(mink.SE3.identity(), mink.SE3.identity(), 0.0)
    with pytest.raises(qt.InvalidInput, match="target_twist: now"):
        qt.target_twist(mink.SE3.identity(), mink.SE3(np.full(7, np.nan)), 0.1)
    with pytest.raises(qt.InvalidInput, match="SE3"):
        qt.target_twist(None, mink.SE3.identity(), 0.1)  # type: ignore[arg-type]

"""Near a singularity: bounded, exact elsewhere, continuous, and it says what is lost."""

from __future__ import annotations

import mink
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import planar_arm

import qp_twist as qt
from qp_twist.qp import regular_rows

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
PLANE = qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none())
EPSILON = 5e-3
TWO_LINKS = planar_arm([0.5, 0.4])


def rows(seed: int) -> tuple[Array, Array]:
    """Task rows with singular values from far above to far below the threshold, and a rate."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 7))
    n = int(rng.integers(m, 9))
    left, _ = np.linalg.qr(rng.normal(size=(m, m)))
    right, _ = np.linalg.qr(rng.normal(size=(n, n)))
    sigma = np.sort(10.0 ** rng.uniform(-7.0, 1.0, m))[::-1]
    return left @ np.diag(sigma) @ right[:m], rng.normal(size=m)


def solved(A: Array, b: Array) -> Array:
    """The shortest velocity that the rows allow."""
    regular = regular_rows(A, b, EPSILON)
    all_rows = np.vstack([regular.A, regular.damped])
    return np.linalg.lstsq(all_rows, np.concatenate([regular.b, regular.damped_b]), rcond=1e-12)[0]


# ------------------------------------------------------------------------------------- the formula


@given(SEEDS)
@settings(max_examples=100)
def test_the_rows_are_a_damped_inverse_in_the_singular_directions(seed: int) -> None:
    """σ/ε² below ε and 1/σ above, direction by direction; below 1e-3 ε nothing is asked."""
    A, b = rows(seed)
    left, sigma, right = np.linalg.svd(A, full_matrices=False)
    inverse = np.where(sigma >= EPSILON, 1.0 / sigma, sigma / EPSILON**2)
    asked = sigma > 1e-3 * EPSILON
    expected = right[asked].T @ (inverse * (left.T @ b))[asked]
    np.testing.assert_allclose(solved(A, b), expected, atol=1e-6 * (1.0 + np.abs(expected).max()))


@given(SEEDS)
@settings(max_examples=100)
def test_the_velocity_is_bounded_and_regular_directions_are_exact(seed: int) -> None:
    A, b = rows(seed)
    x = solved(A, b)
    assert np.linalg.norm(x) <= np.linalg.norm(b) / EPSILON * (1.0 + 1e-6)
    left, sigma, _ = np.linalg.svd(A, full_matrices=False)
    met = left.T @ (A @ x - b)
    np.testing.assert_allclose(met[sigma >= EPSILON], 0.0, atol=1e-9 * (1.0 + np.abs(b).max()))


@given(SEEDS)
@settings(max_examples=100)
def test_what_is_lost_is_reported(seed: int) -> None:
    A, b = rows(seed)
    regular = regular_rows(A, b, EPSILON)
    left, sigma, _ = np.linalg.svd(A, full_matrices=False)
    assert regular.sigma_min == pytest.approx(sigma[-1], abs=1e-12 * sigma[0])
    singular = sigma < EPSILON
    asked = np.abs(left.T @ b) * (1.0 - (sigma / EPSILON) ** 2)
    reported = [lost.sigma for lost in regular.lost]
    np.testing.assert_allclose(
        reported, sigma[singular & (asked > 1e-9 * (1.0 + np.abs(b).max()))], atol=1e-12 * sigma[0]
    )
    missing = A @ solved(A, b) - b
    for lost in regular.lost:
        assert np.linalg.norm(lost.direction) == pytest.approx(1.0)
        assert np.linalg.norm(A.T @ lost.direction) == pytest.approx(lost.sigma, abs=1e-9)
        assert lost.share == pytest.approx((lost.sigma / EPSILON) ** 2, abs=1e-9)
        # What is not delivered in this direction; below 1e-3 ε the last millionth is not either.
        assert abs(missing @ lost.direction) == pytest.approx(lost.missing, rel=1e-5, abs=1e-9)
    # Nothing is missing in any other direction.
    for lost in regular.lost:
        missing = missing - (missing @ lost.direction) * lost.direction
    np.testing.assert_allclose(missing, 0.0, atol=2e-6 * (1.0 + np.abs(b).max()))


def test_regular_rows_are_left_alone_and_a_threshold_of_zero_is_off() -> None:
    A, b = np.array([[1.0, 0.0], [0.0, 1e-9]]), np.array([1.0, 2.0])
    for threshold in (0.0, 1e-10):
        untouched = regular_rows(A, b, threshold)
        assert untouched.A is A
        assert untouched.b is b
        assert untouched.lost == ()
    empty = regular_rows(np.zeros((0, 2)), np.zeros(0), EPSILON)
    assert empty.sigma_min == np.inf


def test_the_threshold_compares_metres_with_radians_and_so_knows_the_size_of_an_arm() -> None:
    """The same arm a thousand times smaller: no configuration of it is above ε = 1e-3."""
    q = np.array([0.3, 1.2])
    steps = {}
    for size, epsilon in ((1.0, EPSILON), (1e-3, EPSILON), (1e-3, 1e-3 * EPSILON)):
        model = planar_arm([0.5 * size, 0.4 * size])
        task = qt.TwistTask("tip", "site", PLANE)
        configuration = mink.Configuration(model, q)
        pose = configuration.get_transform_frame_to_world("tip", "site")
        moved = pose.translation() + size * np.array([0.01, -0.02, 0.0])
        task.set_target(mink.SE3.from_rotation_and_translation(pose.rotation(), moved))
        sigma = np.linalg.svd(task.state(configuration).jacobian[:2], compute_uv=False)
        assert bool(sigma[-1] < EPSILON) == (size < 1.0)
        controller = qt.Controller(model, [task], limits=[], singularity=epsilon)
        steps[size, epsilon] = controller.step(configuration, 0.1)
    full, small, told = steps.values()
    assert [s.status.name for s in (full, small, told)] == ["SOLVED", "DEGRADED", "SOLVED"]
    np.testing.assert_allclose(told.velocity, full.velocity, rtol=1e-6)
    assert np.abs(small.velocity).max() < 0.5 * np.abs(full.velocity).max()


def test_more_rows_than_joints_are_dependent() -> None:
    A, b = np.array([[1.0], [1.0]]), np.array([1.0, 3.0])
    regular = regular_rows(A, b, EPSILON)
    assert regular.sigma_min == 0.0
    assert len(regular.lost) == 1
    np.testing.assert_allclose(np.abs(regular.lost[0].direction), np.sqrt([0.5, 0.5]))
    assert regular.lost[0].missing == pytest.approx(np.sqrt(2.0))  # (3 − 1)/√2
    np.testing.assert_allclose(solved(A, b), [2.0])


@given(SEEDS)
@settings(max_examples=60)
def test_below_other_levels_singular_is_what_those_leave(seed: int) -> None:
    """An algorithmic singularity: the rows are regular alone, but not beside the level above."""
    rng = np.random.default_rng(seed)
    above = rng.normal(size=(2, 6))
    angle = 10.0 ** rng.uniform(-7.0, -4.0)
    A = np.vstack([above[0] + angle * rng.normal(size=6), rng.normal(size=6)])
    b, rate = rng.normal(size=2), rng.normal(size=2)
    regular = regular_rows(A, b, EPSILON, above=(above, rate))
    assert len(regular.lost) == 1
    both, sides = np.vstack([above, regular.A]), np.concatenate([rate, regular.b])
    x = np.linalg.lstsq(both, sides, rcond=1e-12)[0]
    np.testing.assert_allclose(above @ x, rate, atol=1e-8)
    lost = regular.lost[0].direction
    missing = A @ x - b
    np.testing.assert_allclose(missing - (missing @ lost) * lost, 0.0, atol=1e-5)
    # Bounded: what the level above asks for, and 1/ε times what is left to be asked.
    wanted = b - A @ (np.linalg.pinv(above) @ rate)
    largest = np.linalg.norm(np.linalg.pinv(above) @ rate) + np.linalg.norm(wanted) / EPSILON
    assert np.linalg.norm(x) <= largest * (1.0 + 1e-6)


# ---------------------------------------------------------------------------- arms near stretched


def stretched(
    q2: float, pull: tuple[float, float] = (0.05, 0.02), **options: object
) -> tuple[qt.Step, Array, Array]:
    """A step of a 2R arm at elbow angle ``q2``, its Jacobian's plane rows, and the rate asked."""
    model = TWO_LINKS
    configuration = mink.Configuration(model, np.array([0.3, q2]))
    task = qt.TwistTask("tip", "site", PLANE)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    radial = np.array([np.cos(0.3), np.sin(0.3), 0.0])
    tangential = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    task.set_target(mink.SE3.from_translation(tip + pull[0] * radial + pull[1] * tangential))
    controller = qt.Controller(model, tasks=[task], limits=[], **options)  # type: ignore[arg-type]
    step = controller.step(configuration, 0.1)
    A, b = task.velocity_rows(configuration, 0.1)
    return step, A, b


@pytest.mark.parametrize("q2", [0.0, *(10.0**-k for k in range(1, 13)), -1e-5])
@pytest.mark.parametrize("space", ["joint", "twist"])
def test_a_stretched_arm_stays_calm(q2: float, space: str) -> None:
    step, A, b = stretched(q2, secondary_space=space)
    left, sigma, _ = np.linalg.svd(A)
    assert step.sigma_min == pytest.approx(sigma[-1], abs=1e-12)
    assert np.linalg.norm(step.velocity) <= np.linalg.norm(b) / EPSILON * (1.0 + 1e-6)
    delivered = left.T @ step.residuals[0]
    assert delivered[0] == pytest.approx(0.0, abs=1e-8)
    if sigma[-1] >= EPSILON:
        assert step.status is qt.Status.SOLVED
        assert delivered[1] == pytest.approx(0.0, abs=1e-8)
        assert step.lost == ()
    else:
        assert step.status is qt.Status.DEGRADED
        (lost,) = step.lost
        assert abs(lost.direction @ left[:, 1]) == pytest.approx(1.0)
        radial = np.array([np.cos(0.3), np.sin(0.3)])
        assert abs(lost.direction @ in_the_plane(radial)) == pytest.approx(1.0, abs=1e-3)
        assert "lost" in step.message
        assert f"σ = {lost.sigma:.2g}" in step.message
        if space == "joint":
            assert abs(delivered[1]) == pytest.approx(lost.missing, rel=1e-5)
        else:  # the twist that the secondary space prefers may deliver more of it
            assert abs(delivered[1]) <= lost.missing * (1.0 + 1e-5)


def in_the_plane(radial: Array) -> Array:
    """A direction of the plane in the rows of the task."""
    return PLANE.basis[:3].T @ np.append(radial, 0.0)


@pytest.mark.parametrize("space", ["joint", "twist"])
def test_the_step_is_continuous_through_the_singularity(space: str) -> None:
    """A fine sweep: no jump where σ crosses ε, and the slope is what 1/ε² allows.

    Where a direction is given up to the secondary, at 1e-3 ε, the rows' part in it has faded to
    1e-3 rate/ε, and the secondary's own speed sets in.
    """
    at_epsilon, given_up = _crossings()
    closely = np.linspace(1.0 - 1e-3, 1.0 + 1e-3, 20)
    angles = np.unique(
        np.concatenate([
            np.linspace(-2e-2, 2e-2, 301),
            *(side * closely * place for side in (-1, 1) for place in (at_epsilon, given_up)),
        ])
    )  # fmt: skip
    velocities = np.array(
        [stretched(q2, pull=(-1e-3, 0.002), secondary_space=space)[0].velocity for q2 in angles]
    )
    rate = np.linalg.norm([1e-2, 2e-2])
    jumps = np.abs(np.diff(velocities, axis=0)).max(axis=1)
    # |dq̇/dσ| ≤ rate/ε², and |dσ/dq2| < 1.
    allowed = rate / EPSILON**2 * np.diff(angles)
    crosses = np.abs(np.abs(angles[1:]) - given_up) <= 2.0 * np.diff(angles)
    free = np.abs(stretched(0.0, pull=(-1e-3, 0.002), secondary_space=space)[0].velocity).max()
    assert (jumps <= allowed + np.where(crosses, free + 1e-3 * rate / EPSILON, 1e-9)).all()
    assert jumps.max() < 0.2 * np.abs(velocities).max()


def _crossings() -> list[float]:
    """Elbow angles at which σ_min is ε and 1e-3 ε, by bisection on the arm's own rows."""
    found = []
    for level in (EPSILON, 1e-3 * EPSILON):
        low, high = 0.0, 0.1
        for _ in range(60):
            middle = 0.5 * (low + high)
            J = np.array([
                [-0.4 * np.sin(middle), -0.4 * np.sin(middle)],
                [0.5 + 0.4 * np.cos(middle), 0.4 * np.cos(middle)],
            ])  # fmt: skip
            below = np.linalg.svd(J, compute_uv=False)[-1] < level
            low, high = (middle, high) if below else (low, middle)
        found.append(low)
    return found


@given(SEEDS)
@settings(max_examples=40)
def test_a_scaled_step_at_a_singularity_is_off_in_the_lost_direction_only(seed: int) -> None:
    """A stretched arm with tight speed limits: the other direction holds at the scale, exactly."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    model = planar_arm(rng.uniform(0.2, 0.6, count).tolist())
    q = 10.0 ** rng.uniform(-9.0, -3.5, count) * rng.normal(size=count)
    q[0] = rng.uniform(-1.0, 1.0)
    configuration = mink.Configuration(model, q)
    task = qt.TwistTask("tip", "site", PLANE)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    away = np.append(0.3 * rng.normal(size=2), 0.0)
    task.set_target(mink.SE3.from_translation(tip + away))
    speeds = {model.joint(i).name: float(rng.uniform(0.01, 0.2)) for i in range(count)}
    controller = qt.Controller(
        model, tasks=[task], limits=[mink.VelocityLimit(model, speeds)], smooth=False
    )
    step = controller.step(configuration, 0.02)
    if step.status is not qt.Status.SCALED:
        return
    A, b = task.velocity_rows(configuration, 0.02)
    residual = A @ step.velocity - step.scale * b
    np.testing.assert_allclose(residual, step.residuals[0], atol=1e-12)
    (lost,) = step.lost
    off = residual @ lost.direction
    np.testing.assert_allclose(residual - off * lost.direction, 0.0, atol=1e-8)
    # Not more than that is promised of it; the other direction cannot be any faster.
    assert abs(off) >= lost.missing * (1.0 - 1e-5) - 1e-9
    assert abs(off) <= step.scale * np.linalg.norm(b) * (1.0 + 1e-9)
    assert "of all directions but the lost ones" in step.message
    kept = np.array([-lost.direction[1], lost.direction[0]])
    reach = np.abs(kept @ A) @ np.array(list(speeds.values()))
    assert step.scale * abs(kept @ b) == pytest.approx(reach, rel=1e-3)


def test_raise_raises_where_a_direction_is_lost() -> None:
    with pytest.raises(qt.InfeasibleStep, match="singular in a direction") as caught:
        stretched(1e-4, on_infeasible="raise")
    assert "σ =" in str(caught.value)
    step, _, _ = stretched(0.5, on_infeasible="raise")
    assert step.status is qt.Status.SOLVED
    # Nothing is asked in the singular direction: nothing is lost, and nothing is raised.
    step, _, _ = stretched(0.0, pull=(0.0, 0.05), on_infeasible="raise")
    assert step.status is qt.Status.SOLVED


def test_without_the_guard_the_arm_snaps() -> None:
    """What the threshold is for."""
    guarded, _, b = stretched(1e-6)
    bare, _, _ = stretched(1e-6, singularity=0.0)
    assert np.linalg.norm(bare.velocity) > 1e3 * np.linalg.norm(b) / EPSILON
    assert np.linalg.norm(guarded.velocity) < np.linalg.norm(b) / EPSILON


def test_a_secondary_leads_out_of_the_singularity() -> None:
    """In the direction that is given up the secondary decides, and bends the elbow."""
    model = TWO_LINKS
    configuration = mink.Configuration(model, np.array([0.3, 0.0]))
    task = qt.TwistTask("tip", "site", PLANE)
    tip = configuration.get_transform_frame_to_world("tip", "site").translation()
    task.set_target(mink.SE3.from_translation(0.8 * tip))  # inwards, which J cannot see
    posture = qt.PostureReference(model, np.array([0.0, 0.6]), gain=0.2)
    controller = qt.Controller(model, tasks=[task], secondary=[posture])
    first = controller.step(configuration, 0.1)
    assert first.status is qt.Status.DEGRADED
    for _ in range(60):
        step = controller.step(configuration, 0.1)
        configuration.integrate_inplace(step.velocity, 0.1)
    reached = configuration.get_transform_frame_to_world("tip", "site").translation()
    np.testing.assert_allclose(reached, 0.8 * tip, atol=1e-3)


# ---------------------------------------------------------------------------------- wrist straight

DEBURRING = qt.load_task("deburring")


@pytest.mark.parametrize("q5", [0.0, *(10.0**-k for k in range(1, 10))])
def test_a_straight_wrist_loses_one_direction_of_the_full_pose(q5: float) -> None:
    """All six of the M-16iB: axes 4 and 6 in line. Roll-free, with five rows, it loses nothing."""
    model = DEBURRING.model
    q = DEBURRING.start.copy()
    q[4] = q5
    configuration = mink.Configuration(model, q)
    pose = configuration.get_transform_frame_to_world("tool", "site")
    target = pose.plus(np.array([0.0, 0.0, 0.0, 0.01, 0.02, 0.0]))
    full = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    for name, projector in (("full", full), ("roll-free", DEBURRING.projector)):
        task = qt.TwistTask("tool", "site", projector)
        task.set_target(target)
        step = qt.Controller(model, tasks=[task], limits=[]).step(configuration, 0.1)
        A, b = task.velocity_rows(configuration, 0.1)
        left, sigma, _ = np.linalg.svd(A)
        assert step.sigma_min == pytest.approx(sigma[-1], abs=1e-10)
        assert np.linalg.norm(step.velocity) <= np.linalg.norm(b) / min(EPSILON, sigma[-1])
        delivered = left.T @ step.residuals[0]
        np.testing.assert_allclose(delivered[sigma >= EPSILON], 0.0, atol=1e-8)
        lost = int((sigma < EPSILON).sum())
        assert len(step.lost) == lost
        assert step.status is (qt.Status.DEGRADED if lost else qt.Status.SOLVED)
        assert lost == (1 if name == "full" and q5 < 0.02 else 0)

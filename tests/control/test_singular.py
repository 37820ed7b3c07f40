"""Near a singularity: bounded, exact elsewhere, continuous, and it says what is lost."""

import mink
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import planar_arm
from oracles.twists import PLANE, SPATIAL, at, site
from oracles.walks import walk

import qp_twist as qt

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
EPSILON = 5e-3
TWO_LINKS = planar_arm([0.5, 0.4])
ARM = qt.load_task("deburring")


# ---------------------------------------------------------------------------- arms near stretched


def stretched(
    q2: float,
    pull: tuple[float, float] = (0.05, 0.02),
    singularity: float | None = None,
    **options: object,
) -> tuple[qt.Step, Array, Array]:
    """A step of a 2R arm at elbow angle ``q2``, its Jacobian's plane rows, and the rate asked."""
    model = TWO_LINKS
    configuration = mink.Configuration(model, np.array([0.3, q2]))
    task = qt.TwistTask("tip", "site", PLANE)
    tip = site(configuration, "tip").translation()
    radial = np.array([np.cos(0.3), np.sin(0.3), 0.0])
    tangential = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    task.set_target(mink.SE3.from_translation(tip + pull[0] * radial + pull[1] * tangential))
    controller = qt.Controller(model, tasks=[task], limits=[], **options)  # type: ignore[arg-type]
    if singularity is not None:
        controller.singularity = singularity
    step = controller.step(configuration, 0.1)
    A, b = task.velocity_rows(configuration, 0.1)
    return step, A, b


@pytest.mark.parametrize("q2", [0.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12, -1e-5])
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
            np.linspace(-2e-2, 2e-2, 151),
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
@settings(max_examples=20)
def test_a_scaled_step_at_a_singularity_is_off_in_the_lost_direction_only(seed: int) -> None:
    """A stretched arm with tight speed limits: the other direction holds at the scale, exactly."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    model = planar_arm(rng.uniform(0.2, 0.6, count).tolist())
    q = 10.0 ** rng.uniform(-9.0, -3.5, count) * rng.normal(size=count)
    q[0] = rng.uniform(-1.0, 1.0)
    configuration = mink.Configuration(model, q)
    task = qt.TwistTask("tip", "site", PLANE)
    tip = site(configuration, "tip").translation()
    away = np.append(0.3 * rng.normal(size=2), 0.0)
    task.set_target(mink.SE3.from_translation(tip + away))
    speeds = {model.joint(i).name: float(rng.uniform(0.01, 0.2)) for i in range(count)}
    controller = qt.Controller(model, tasks=[task], limits=[mink.VelocityLimit(model, speeds)])
    controller.smooth = False
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


def test_a_secondary_leads_out_of_the_singularity() -> None:
    """The target is inwards, which J cannot see: the secondary decides, and bends the elbow."""
    configuration = mink.Configuration(TWO_LINKS, np.array([0.3, 0.0]))
    task = qt.TwistTask("tip", "site", PLANE)
    tip = site(configuration, "tip").translation()
    task.set_target(at(*(0.8 * tip)))
    posture = qt.PostureReference(TWO_LINKS, np.array([0.0, 0.6]), gain=0.2)
    controller = qt.Controller(TWO_LINKS, tasks=[task], secondary=[posture])
    assert controller.step(configuration, 0.1).status is qt.Status.DEGRADED
    walk(controller, configuration, 120, 0.1)
    np.testing.assert_allclose(site(configuration, "tip").translation(), 0.8 * tip, atol=1e-6)


# ---------------------------------------------------------------------------------- wrist straight


@pytest.mark.parametrize("q5", [0.0, 1e-1, 1e-2, 1e-3, 1e-6, 1e-9])
def test_a_straight_wrist_loses_one_direction_of_the_full_pose(q5: float) -> None:
    """All six of the M-16iB: axes 4 and 6 in line. Roll-free, with five rows, it loses nothing."""
    model = ARM.model
    q = ARM.start.copy()
    q[4] = q5
    configuration = mink.Configuration(model, q)
    pose = site(configuration)
    target = pose.plus(np.array([0.0, 0.0, 0.0, 0.01, 0.02, 0.0]))
    for name, projector in (("full", SPATIAL), ("roll-free", ARM.projector)):
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

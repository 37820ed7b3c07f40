"""TwistTask as a mink task: its derivative, its place in mink's solvers, its targets."""

import itertools
import math
import re
from typing import Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from oracles.arms import planar_arm, random_arm, random_configuration, random_direction
from oracles.twists import (
    FRAMES,
    KINDS,
    ROLL_FREE,
    SPATIAL,
    Z,
    across,
    close,
    pose,
    regular,
    turn,
    twists,
)
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from qp_twist.errors import InvalidInput, InvalidTarget
from qp_twist.kinematics import TwistTask, frame_jacobian, frame_pose

Array = npt.NDArray[np.float64]

# qpsolvers' defaults for ProxQP and OSQP are far too loose for equality rows.
SOLVERS = {
    "daqp": {},
    "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
    "osqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "polishing": True, "max_iter": 50_000},
}
# mink hands OSQP dense matrices, which qpsolvers converts and says so; qpsolvers in turn calls OSQP
# in a way that OSQP will change. Neither is ours to mend.
pytestmark = [
    pytest.mark.filterwarnings("ignore::qpsolvers.warnings.SparseConversionWarning"),
    pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning"),
]
ALL_KINDS = pytest.mark.parametrize(("linear", "angular"), list(itertools.product(KINDS, KINDS)))


def tool(projector: Any = SPATIAL, **options: Any) -> TwistTask:
    return TwistTask("tool", "site", projector, **options)


def misaligned(
    configuration: mink.Configuration, rng: np.random.Generator, degrees: float
) -> mink.SE3:
    """A target whose z axis is tilted, rolled at random about it, and 10 cm away."""
    R, p = frame_pose(configuration, "tool", "site")
    tilt = turn(np.deg2rad(degrees) * across(R[:, 2], rng))
    return pose(tilt @ R @ turn(rng.uniform(-3.0, 3.0) * Z), p + 0.1 * random_direction(rng))


def derivative(task: TwistTask, configuration: mink.Configuration, step: float = 1e-6) -> Array:
    """The central finite difference of the error along every degree of freedom."""
    moved = mink.Configuration(configuration.model)
    columns = []
    for direction in np.eye(configuration.nv):
        errors = []
        for sign in (1.0, -1.0):
            moved.update(configuration.integrate(sign * direction, step))
            errors.append(task.compute_error(moved))
        columns.append((errors[0] - errors[1]) / (2.0 * step))
    return np.column_stack(columns)


# ---------------------------------------------------------------------------------- the Jacobian


@pytest.mark.parametrize(
    ("name", "frame_type"), [("tool", "site"), ("link_4", "body"), ("geom_6", "geom")]
)
def test_the_frame_jacobian_is_minks_in_the_world_and_the_velocity_of_the_frame(
    name: str, frame_type: str
) -> None:
    rng, step = np.random.default_rng(0), 1e-6
    for _ in range(5):
        model = random_arm(rng, 6, slides=True)
        configuration = mink.Configuration(model, random_configuration(model, rng))
        R, p = frame_pose(configuration, name, frame_type)
        transform = configuration.get_transform_frame_to_world(name, frame_type)
        close(R, transform.rotation().as_matrix())
        close(p, transform.translation())
        J = frame_jacobian(configuration, name, frame_type)
        close(J, block_diag(R, R) @ configuration.get_frame_jacobian(name, frame_type))
        for i, direction in enumerate(np.eye(6)):
            ahead = mink.Configuration(model, configuration.integrate(direction, step))
            behind = mink.Configuration(model, configuration.integrate(direction, -step))
            (R_a, p_a), (R_b, p_b) = (frame_pose(c, name, frame_type) for c in (ahead, behind))
            omega = Rotation.from_matrix(R_a @ R_b.T).as_rotvec()
            close(J[:, i], np.concatenate([p_a - p_b, omega]) / (2 * step), atol=1e-8)


@ALL_KINDS
@pytest.mark.parametrize("frame", FRAMES)
def test_a_task_has_as_many_rows_as_its_projector_has_rank_and_they_are_the_derivative_of_its_error(
    linear: str, angular: str, frame: str
) -> None:
    """Where the orientation is met: there all errors are linear in small motions."""
    rank = {"full": 3, "plane": 2, "line": 1, "none": 0}
    rng, rows = np.random.default_rng(3), rank[linear] + rank[angular]
    configuration = regular(rng)
    R, p = frame_pose(configuration, "tool", "site")
    # A turn about e is free for a plane and is the error itself for a line: both stay linear. For
    # full the orientation must agree.
    e = random_direction(rng)
    free = {"full": 0.0, "plane": 2.0, "line": 1.0, "none": 2.5}[angular]
    R_d = turn(free * e) @ R
    # Linear axes that turn with the body change the linear rows while the error is not zero.
    moving = frame == "body" and linear in ("plane", "line")
    p_d = p if moving else p + 0.3 * random_direction(rng)
    to_frame = {"world": np.eye(3), "body": R.T, "target": R_d.T}[frame]
    task = tool(twists(linear, angular, frame, (random_direction(rng), to_frame @ e)))
    task.set_target(pose(R_d, p_d))
    assert isinstance(task, mink.Task)
    np.testing.assert_array_equal(task.cost, np.ones(rows))
    assert task.compute_error(configuration).shape == (rows,)
    jacobian = task.compute_jacobian(configuration)
    assert jacobian.shape == (rows, 6)
    # No row is wasted: on a regular arm they are independent.
    assert rows == 0 or np.linalg.matrix_rank(jacobian, tol=1e-6) == rows
    close(jacobian, derivative(task, configuration), atol=1e-7)


@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("distance", [1e-2, 1e-5])
def test_a_full_task_is_minks_frame_task_to_first_order(frame: str, distance: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        configuration = regular(rng)
        R, p = frame_pose(configuration, "tool", "site")
        target = pose(
            turn(distance * random_direction(rng)) @ R, p + distance * random_direction(rng)
        )
        solutions = []
        theirs = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=1.0)
        for task in (tool(twists("full", "full", frame)), theirs):
            task.set_target(target)
            solutions.append(solve(configuration, task, 1.0))
        # The step is of the order of the distance, what differs of the order of its square.
        assert np.linalg.norm(solutions[1]) > 0.1 * distance
        close(solutions[0], solutions[1], atol=20.0 * distance**2)


# --------------------------------------------------------------------------- in mink's solve_ik


def solve(
    configuration: mink.Configuration, task: mink.Task, dt: float, solver: str = "daqp"
) -> Array:
    """The velocity that mink finds with the task as its constraint."""
    damping = [mink.DampingTask(configuration.model, cost=1.0)]
    options: dict[str, Any] = {"limits": [], "constraints": [task], **SOLVERS[solver]}
    return mink.solve_ik(configuration, damping, dt, solver, **options)


def roles(task: TwistTask, model: mujoco.MjModel) -> dict[str, tuple[list[mink.Task], list]]:
    """The places of mink.solve_ik where a task may stand: (tasks, constraints)."""
    posture = mink.PostureTask(model, cost=1.0)
    posture.set_target(np.zeros(model.nq))
    return {
        "constraint beside damping": ([mink.DampingTask(model, cost=1.0)], [task]),
        "constraint beside posture": ([posture], [task]),
        "task": ([task], []),
    }


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("role", ["constraint beside damping", "constraint beside posture", "task"])
@pytest.mark.parametrize("degrees", [0.001, 45.0, 179.999, 180.0])
def test_a_task_works_in_minks_solve_ik_at_any_misalignment(
    solver: str, role: str, degrees: float
) -> None:
    rng, dt = np.random.default_rng(6), 0.1
    for of in (ROLL_FREE, SPATIAL):
        configuration = regular(rng)
        task = tool(of, gain=0.8)
        task.set_target(misaligned(configuration, rng, degrees))
        tasks, constraints = roles(task, configuration.model)[role]
        velocity = mink.solve_ik(
            configuration, tasks, dt, solver, limits=[], constraints=constraints, **SOLVERS[solver]
        )
        # The rows that a user would write down, from the error's definition.
        error = task.compute_error(configuration)
        left = task.compute_jacobian(configuration) @ (velocity * dt) + 0.8 * error
        assert np.linalg.norm(left) < 1e-6
        assert np.linalg.norm(error) >= 0.0999  # there was something to do


@pytest.mark.parametrize("solver", SOLVERS)
def test_iterating_solve_ik_reaches_the_target_and_leaves_the_roll(solver: str) -> None:
    rng = np.random.default_rng(8)
    configuration = regular(rng)
    goal = mink.Configuration(
        configuration.model, configuration.q + 0.4 * rng.choice([-1.0, 1.0], size=6)
    )
    R_goal, p_goal = frame_pose(goal, "tool", "site")
    R_d = R_goal @ turn(1.5 * Z)
    task = tool(ROLL_FREE, max_linear_step=0.1, max_angular_step=0.3)
    task.set_target(pose(R_d, p_goal))
    for _ in range(60):
        configuration.integrate_inplace(solve(configuration, task, 0.1, solver), 0.1)
    R, p = frame_pose(configuration, "tool", "site")
    close(p, p_goal, atol=1e-7)
    close(R[:, 2], R_d[:, 2], atol=1e-7)
    assert Rotation.from_matrix(R_d @ R.T).magnitude() > 0.1  # the roll went where it liked


# --------------------------------------------------------------------------------- feed-forward


def test_feed_forward_needs_the_time_step_and_a_resting_target_does_not() -> None:
    rng = np.random.default_rng(13)
    configuration = regular(rng)
    target = misaligned(configuration, rng, 10.0)
    task, at_rest = tool(), tool()
    task.set_target(target, twist=[0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    for use in (task.compute_error, task.compute_qp_residual, task.compute_qp_objective):
        with pytest.raises(mink.IntegrationTimestepNotSet, match=r"TwistTask\('tool', 'site'\)"):
            use(configuration)
    task.set_dt(0.01)
    task.compute_error(configuration)
    at_rest.set_target(target, twist=np.zeros(6))
    at_rest.compute_error(configuration)


def test_a_moving_target_is_followed_without_lag() -> None:
    # At gain k a target of speed v is otherwise followed at the distance v dt / k.
    rng = np.random.default_rng(15)
    start = regular(rng)
    R, p = frame_pose(start, "tool", "site")
    twist = np.concatenate([0.2 * random_direction(rng), 0.3 * random_direction(rng)])
    gain, steps, dt = 0.2, 40, 0.01

    def target(time: float) -> mink.SE3:
        return pose(turn(time * twist[3:]) @ R, p + time * twist[:3])

    lag = {}
    for feedforward in (twist, None):
        configuration = mink.Configuration(start.model, start.q)
        task = tool(gain=gain)
        task.set_dt(dt)
        for i in range(steps):
            task.set_target(target(i * dt), twist=feedforward)
            configuration.integrate_inplace(solve(configuration, task, dt), dt)
        R_end, p_end = frame_pose(configuration, "tool", "site")
        end = target(steps * dt)
        turned = Rotation.from_matrix(end.rotation().as_matrix() @ R_end.T).magnitude()
        lag[feedforward is None] = np.linalg.norm(p_end - end.translation()) + turned
    assert lag[True] == pytest.approx(0.5 * dt / gain, rel=0.1)
    assert lag[False] < 0.01 * lag[True]


def test_feed_forward_at_gain_zero_is_refused_since_mink_would_drop_it() -> None:
    rng = np.random.default_rng(17)
    configuration = regular(rng)
    task = tool(gain=0.0)
    task.set_dt(0.01)
    task.set_target(misaligned(configuration, rng, 10.0))
    task.compute_error(configuration)  # a task that only holds still is fine
    task.set_target(task.target, twist=np.ones(6))
    with pytest.raises(InvalidInput, match="with gain 0 mink drops the feed-forward"):
        task.compute_error(configuration)


# -------------------------------------------------------------------------------------- targets


def quaternion(*wxyz: float) -> mink.SE3:
    """A pose at the origin from four numbers, whatever their length."""
    return mink.SE3(wxyz_xyz=np.array([*wxyz, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("target", "sentence"),
    [
        (quaternion(np.nan, 0, 0, 0), "target: entry 0 is nan"),
        (mink.SE3(wxyz_xyz=np.array([1, 0, 0, 0, 0, np.inf, 0.0])), "target: entry 5 is inf"),
        (quaternion(2, 0, 0, 0), "quaternion has length 2; normalise it"),
        (quaternion(0, 0, 0, 0), "quaternion has length 0; normalise it"),
        (quaternion(1.00001, 0, 0, 0), "normalise it"),
        (np.eye(4), "must be a mink.SE3, got ndarray"),
        (mink.SO3.identity(), "must be a mink.SE3, got SO3"),
        (None, "must be a mink.SE3, got NoneType"),
    ],
)
def test_a_target_that_is_no_pose_is_refused_and_the_old_one_kept(
    target: object, sentence: str
) -> None:
    task = tool()
    old = pose(np.eye(3), np.ones(3))
    task.set_target(old)
    for family in (InvalidTarget, mink.InvalidTarget, ValueError):
        with pytest.raises(family, match=sentence) as refusal:
            task.set_target(target)
        assert "TwistTask('tool', 'site')" in str(refusal.value)
    np.testing.assert_array_equal(task.target.wxyz_xyz, old.wxyz_xyz)


def test_a_target_is_copied_and_a_new_one_rests_again() -> None:
    wxyz_xyz, twist, task = np.array([1.0, 0, 0, 0, 1, 2, 3]), np.ones(6), tool()
    task.set_target(mink.SE3(wxyz_xyz=wxyz_xyz), twist=twist)
    wxyz_xyz[4] = twist[0] = 77.0
    assert task.target.translation()[0] == 1.0
    np.testing.assert_array_equal(task.feedforward, np.ones(6))
    task.set_target(mink.SE3.identity())
    np.testing.assert_array_equal(task.feedforward, np.zeros(6))


@pytest.mark.parametrize(
    "given",
    [
        np.array([1, 0, 0, 0, 1, 2, 3]),
        np.repeat([1.0, 0, 0, 0, 1, 2, 3], 2)[::2],
        np.array([1.0, 0, 0, 0, 1, 2, 3], dtype=">f8"),
        np.array([1.0, 0, 0, 0, 1e308, 1.5e308, -1.0]),  # finite, though its sum is not
    ],
)
def test_a_target_of_any_floats_is_kept_as_it_was_and_cannot_be_written_to(given: Any) -> None:
    task = tool()
    task.set_target(mink.SE3(wxyz_xyz=given))
    np.testing.assert_array_equal(task.target.wxyz_xyz, given)
    with pytest.raises(ValueError, match="read-only"):
        task.target.wxyz_xyz[4] = 0.0


def test_a_task_without_target_says_so_and_at_the_present_pose_has_nothing_to_do() -> None:
    configuration, task = regular(np.random.default_rng(18)), tool()
    for use in (task.compute_error, task.compute_jacobian, task.compute_qp_residual):
        with pytest.raises(mink.TargetNotSet, match=re.escape("TwistTask('tool', 'site')")):
            use(configuration)
    task.set_target_from_configuration(configuration)
    close(task.compute_error(configuration), np.zeros(6))


# --------------------------------------------------------------------------- frames and refusals


@pytest.mark.parametrize(
    ("name", "kind", "sentence"),
    [
        ("gripper", "site", r"site 'gripper' .*\['tip'\]"),
        ("tip", "body", r"body 'tip' .*link_2"),  # a name of another type of frame
        (-1, "body", "id -1 is out of range"),
        (3, "body", "id 3 is out of range"),
    ],
)
def test_an_unknown_frame_is_refused_by_name_with_the_names_there_are(
    name: Any, kind: str, sentence: str
) -> None:
    task = TwistTask(name, kind, SPATIAL)
    task.set_target(mink.SE3.identity())
    for use in (task.compute_error, task.compute_jacobian):
        with pytest.raises(mink.InvalidFrame, match=sentence):
            use(mink.Configuration(planar_arm([1.0, 1.0])))


@pytest.mark.parametrize(
    ("carrier", "sentence"),
    [
        (["part", "body"], "expected .name, type. of a frame"),
        ((None, "body"), "expected the name or the id of a body, got None"),
        ((2.5, "body"), "expected the name or the id of a body, got 2.5"),
        ((True, "body"), "expected the name or the id"),
        ((-1, "body"), "no body is called -1"),
        (("", "site"), "no site is called ''"),
        (("tool", "site"), "the controlled frame itself"),
    ],
)
def test_a_carrier_that_is_none_is_refused_at_once(carrier: object, sentence: str) -> None:
    with pytest.raises(InvalidInput, match=sentence):
        tool(ROLL_FREE, relative_to=carrier)
    task = tool(ROLL_FREE, relative_to=("part", "body"))
    with pytest.raises(InvalidInput, match=sentence):
        task.relative_to = carrier
    assert task.relative_to == ("part", "body")


# ----------------------------------------------------------------------------- the longest step


@pytest.mark.parametrize(("longest", "widest"), [(0.1, 0.2), (0.1, math.inf), (math.inf, 0.2)])
def test_a_far_target_is_approached_by_the_longest_step_in_its_own_direction(
    longest: float, widest: float
) -> None:
    rng = np.random.default_rng(20)
    configuration = regular(rng)
    R, p = frame_pose(configuration, "tool", "site")
    way, axis = random_direction(rng), random_direction(rng)
    task = tool(gain=0.5, max_linear_step=longest, max_angular_step=widest)
    task.set_target(pose(turn(2.0 * axis) @ R, p + 3.0 * way))
    asked = frame_jacobian(configuration, "tool", "site") @ solve(configuration, task, 1.0)
    close(asked[:3], 0.5 * min(longest, 3.0) * way, atol=1e-7)
    close(asked[3:], 0.5 * min(widest, 2.0) * axis, atol=1e-7)
    # The state still tells the whole error.
    close(task.state(configuration).error, np.concatenate([3.0 * way, 2.0 * axis]), atol=1e-9)


def test_minks_arguments_of_a_relative_task_are_told_ours() -> None:
    with pytest.raises(InvalidInput, match=r"root_type, is relative_to=\(name, type\)"):
        TwistTask("tool", "site", "part", "body")

"""The secondary objectives, alone and in mink's solve_ik, and the rows that T leaves free."""

import itertools

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from oracles.arms import (
    planar_arm,
    random_arm,
    random_configuration,
    random_direction,
    random_rotation,
)
from oracles.twists import FRAMES, KINDS, PLANE, POINT, SPATIAL, close, pose, twists

from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.kinematics import (
    JointCentering,
    JointRanges,
    Manipulability,
    PostureReference,
    RollReference,
    SecondaryObjective,
    TwistTask,
)

Array = npt.NDArray[np.float64]


# A floating base, a ball joint, a hinge whose range is switched off, a hinge and a slide with one.
FLOATING = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="base" pos="0.1 0.2 0.3"><freejoint name="float"/><geom size="0.1"/>
    <body name="shoulder" pos="0.2 0 0.1"><joint name="ball" type="ball"/><geom size="0.1"/>
      <body name="elbow" pos="0.3 0.1 0">
        <joint name="free_hinge" axis="0 1 0.2" limited="false" range="-1 1"/><geom size="0.1"/>
        <body name="wrist" pos="0 0.2 0.3">
          <joint name="hinge" axis="1 0.3 0" range="-1 3"/>
          <joint name="slide" type="slide" axis="0 0 1" range="-0.1 0.5"/><geom size="0.1"/>
          <site name="tool" pos="0.1 0.2 0.3" euler="0.3 0.4 0.5"/>
        </body></body></body></body>
</worldbody></mujoco>"""


def random_pose(rng: np.random.Generator) -> mink.SE3:
    """Return a random pose near the origin."""
    return pose(random_rotation(rng), rng.normal(size=3))


def floating(rng: np.random.Generator) -> mink.Configuration:
    """Return the floating model somewhere."""
    model = mujoco.MjModel.from_xml_string(FLOATING)
    configuration = mink.Configuration(model)
    configuration.integrate_inplace(rng.normal(size=model.nv), 1.0)
    return configuration


def slope(function: object, configuration: mink.Configuration, step: float = 1e-6) -> Array:
    """Return the central finite difference of a scalar along every degree of freedom."""
    moved = mink.Configuration(configuration.model)
    slopes = []
    for direction in np.eye(configuration.nv):
        values = []
        for sign in (1.0, -1.0):
            moved.update(configuration.integrate(sign * direction, step))
            values.append(function(moved))
        slopes.append((values[0] - values[1]) / (2.0 * step))
    return np.array(slopes)


def papers_z(model: mujoco.MjModel, q: Array) -> float:
    """Return z of a fully limited arm, as the paper writes it."""
    low, high = model.jnt_range.T
    W = np.diag(1.0 / (high - low))
    offset = 0.5 * (high + low) - q
    return 0.5 * offset @ W.T @ W @ offset


# ---------------------------------------------------------------------------------- joint ranges


@pytest.mark.parametrize("slides", [False, True])
def test_z_and_the_margins_are_the_papers(slides: bool) -> None:
    rng = np.random.default_rng(0)
    for joints in range(2, 8):
        model = random_arm(rng, joints, slides=slides)
        ranges = JointRanges.of(model)
        low, high = model.jnt_range.T
        many = rng.normal(size=(4, 3, joints))
        z, margins = ranges.centering(many), ranges.margins(many)
        assert z.shape == (4, 3)
        for index in np.ndindex(4, 3):
            q = many[index]
            assert z[index] == pytest.approx(papers_z(model, q), rel=1e-12)
            middle, half = (low + high) / 2, (high - low) / 2
            close(margins[index], 1.0 - np.abs(q - middle) / half)
        assert ranges.centering(low) == pytest.approx(joints / 8)
        close(ranges.margins(high), np.zeros(joints))
        close(ranges.margins((low + high) / 2), np.ones(joints))
        assert ranges.names == tuple(f"joint_{i + 1}" for i in range(joints))


# -------------------------------------------------------------------------------- joint centering


@pytest.mark.parametrize("slides", [False, True])
def test_the_three_weights_are_powers_of_the_papers_w(slides: bool) -> None:
    """The gradient steps down the slope of z, by finite differences."""
    rng = np.random.default_rng(3)
    model = random_arm(rng, 6, slides=slides)
    configuration = mink.Configuration(model, random_configuration(model, rng))
    low, high = model.jnt_range.T
    W, offset = np.diag(1.0 / (high - low)), (low + high) / 2 - configuration.q
    objectives = {"gradient": W.T @ W @ offset, "paper": W @ offset, "natural": offset}
    for weight, expected in objectives.items():
        objective = JointCentering(model, weight=weight, gain=0.5)
        close(objective.direction(configuration), expected)
        close(objective.displacement(configuration), 0.5 * expected)
    down = -slope(lambda c: papers_z(model, c.q), configuration)
    close(objectives["gradient"], down, atol=1e-8)
    # The natural step at gain 1 is the whole way to the middle.
    objective = JointCentering(model, weight="natural")
    configuration.integrate_inplace(objective.displacement(configuration), 1.0)
    close(configuration.q, (low + high) / 2)


@pytest.mark.parametrize("weight", ["gradient", "paper", "natural"])
def test_joints_without_a_range_do_not_move(weight: str) -> None:
    rng = np.random.default_rng(4)
    configuration = floating(rng)
    h = JointCentering(configuration.model, weight=weight).displacement(configuration)
    assert h.shape == (12,)
    np.testing.assert_array_equal(h[:10], np.zeros(10))
    hinge, slide = configuration.q[12:]
    power = {"gradient": 2, "paper": 1, "natural": 0}[weight]
    close(h[10:], [(1.0 - hinge) / 4**power, (0.2 - slide) / 0.6**power])

    arm = random_arm(rng, 6, limited=False)
    anywhere = mink.Configuration(arm, random_configuration(arm, rng))
    centering = JointCentering(arm, weight=weight)
    np.testing.assert_array_equal(centering.displacement(anywhere), np.zeros(6))


# ------------------------------------------------------------------------------ posture reference


def test_a_posture_reference_is_reached_at_gain_one_with_floating_base_and_ball_joint() -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        configuration, reference = floating(rng), floating(rng)
        objective = PostureReference(configuration.model, reference.q)
        h = objective.displacement(configuration)
        assert h.shape == (12,)
        assert np.linalg.norm(h) > 0.5
        reached = mink.Configuration(configuration.model, configuration.integrate(h, 1.0))
        for name in ("base", "shoulder", "elbow", "wrist"):
            close(reached.data.body(name).xmat, reference.data.body(name).xmat, atol=1e-9)
            close(reached.data.body(name).xpos, reference.data.body(name).xpos, atol=1e-9)
        close(objective.displacement(reached), np.zeros(12), atol=1e-9)


@pytest.mark.parametrize(
    ("q_ref", "sentence"),
    [
        (np.zeros(12), r"shape \(14\), got \(12,\)"),
        (np.full(14, np.nan), "entry 0 is nan"),
        ("home", "expected numbers"),
    ],
)
def test_a_reference_that_is_no_configuration_is_refused(q_ref: object, sentence: str) -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    with pytest.raises(InvalidInput, match=sentence):
        PostureReference(model, q_ref)


# --------------------------------------------------------------------------------- manipulability


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("joints", [4, 7])
def test_the_gradient_of_manipulability_is_that_of_its_measure(joints: int, frame: str) -> None:
    rng = np.random.default_rng(7)
    checked = 0
    for linear, angular in itertools.product(KINDS, KINDS):
        model = random_arm(rng, joints, slides=bool(rng.integers(2)))
        # The site is offset and turned in its body; bodies and geoms carry the frame themselves.
        last = f"link_{joints}"
        name, kind = [("tool", "site"), (last, "body"), (f"geom_{joints}", "geom")][checked % 3]
        projector = twists(linear, angular, frame, (random_direction(rng), random_direction(rng)))
        if not 0 < projector.rank <= joints:
            continue
        task = TwistTask(name, kind, projector)
        task.set_target(random_pose(rng))
        objective = Manipulability(model, task)
        for _ in range(40):
            configuration = mink.Configuration(model, random_configuration(model, rng))
            values = np.linalg.svd(task.compute_jacobian(configuration), compute_uv=False)
            if values[-1] > 0.03:
                break
        else:
            continue  # too few or parallel joints for these rows, wherever the arm stands
        expected = slope(objective.measure, configuration)
        close(objective.gradient(configuration), expected, atol=1e-6 * (1 + np.abs(expected).max()))
        checked += 1
    assert checked >= 5


def planar_positioning(q: list[float]) -> tuple[mink.Configuration, TwistTask]:
    """Return a planar 2R and the task of placing its tip."""
    configuration = mink.Configuration(planar_arm([2.0, 1.5]), np.array(q))
    task = TwistTask("tip", "site", PLANE)
    task.set_target(mink.SE3.identity())
    return configuration, task


@pytest.mark.parametrize("elbow", [0.5, -1.2, 2.5, 1e-3, -1e-6, 1e-9])
def test_the_planar_2r_unbends_by_the_textbook_and_no_further_than_allowed(elbow: float) -> None:
    # det(J) = l₁ l₂ sin θ₂
    configuration, task = planar_positioning([0.4, elbow])
    objective = Manipulability(configuration.model, task, longest=0.5)
    expected = np.array([0.0, 2.0 / np.tan(elbow)])
    found = objective.gradient(configuration)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-5)
    assert abs(found[0]) < 1e-6 * abs(expected[1])
    assert objective.measure(configuration) == pytest.approx(2 * np.log(3 * abs(np.sin(elbow))))

    direction = objective.direction(configuration)
    length = min(0.5, abs(expected[1]))
    close(direction, [0.0, np.copysign(length, expected[1])], atol=1e-5)
    doubled = Manipulability(configuration.model, task, gain=2.0, longest=0.5)
    close(doubled.displacement(configuration), 2.0 * direction)


def test_at_a_singularity_the_measure_is_minus_infinity_and_the_direction_finite() -> None:
    configuration, task = planar_positioning([0.0, 0.0])
    objective = Manipulability(configuration.model, task)
    assert objective.measure(configuration) == -np.inf
    direction = objective.direction(configuration)
    assert np.isfinite(direction).all()
    assert np.linalg.norm(direction) <= 1.0 + 1e-12


def test_the_direction_is_bounded_on_the_way_into_a_singularity() -> None:
    rng = np.random.default_rng(10)
    model = random_arm(rng, 6)
    task = TwistTask("tool", "site", SPATIAL)
    task.set_target(mink.SE3.identity())
    objective = Manipulability(model, task, longest=0.3)
    configuration = mink.Configuration(model, random_configuration(model, rng))
    # Walk down the measure: it has no lower bound but at singularities.
    for _ in range(200):
        direction = objective.direction(configuration)
        assert np.isfinite(direction).all()
        assert np.linalg.norm(direction) <= 0.3 + 1e-12
        configuration.integrate_inplace(-0.1 * direction, 1.0)
    assert np.linalg.norm(objective.gradient(configuration)) > 10.0
    assert np.linalg.norm(objective.direction(configuration)) == pytest.approx(0.3)


@pytest.mark.parametrize(("linear", "angular"), [("none", "none"), ("full", "line")])
def test_a_measure_without_rows_or_with_too_many_is_refused(linear: str, angular: str) -> None:
    projector = twists(linear, angular)
    task = TwistTask("tip", "site", projector)
    with pytest.raises(InvalidInput, match=f"has {projector.rank} rows and the robot 3 degrees"):
        Manipulability(planar_arm([1.0, 1.0, 1.0]), task)


# ---------------------------------------------------------------------------------- roll reference


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("joints", [6, 7])
def test_the_roll_returns_to_that_of_the_target_and_nothing_else_moves(
    joints: int, frame: str
) -> None:
    rng = np.random.default_rng(joints)
    model = random_arm(rng, joints)
    axis = random_direction(rng)
    free = TwistProjector(
        linear=Projector.full(),
        angular=Projector.plane(axis),
        frame=frame,  # type: ignore[arg-type]
    )
    task = TwistTask("tool", "site", free)
    configuration = mink.Configuration(model, random_configuration(model, rng))
    here = configuration.get_transform_frame_to_world("tool", "site")
    R = here.rotation().as_matrix()
    about = axis if frame == "world" else R @ axis
    turned = mink.SO3.exp(0.3 * about).as_matrix() @ R
    task.set_target(pose(turned, here.translation()))
    objective = RollReference(model, task)
    twist = task.state(configuration).jacobian @ objective.direction(configuration)
    close(twist, np.concatenate([np.zeros(3), 0.3 * about]), 1e-9)
    objective.longest = 0.1
    twist = task.state(configuration).jacobian @ objective.displacement(configuration)
    close(twist, np.concatenate([np.zeros(3), 0.1 * about]), 1e-9)
    task.projector = SPATIAL
    assert not objective.direction(configuration).any()


# ------------------------------------------------------------------------- as plain mink tasks


def objectives(rng: np.random.Generator, **options: float) -> list[SecondaryObjective]:
    """Return one objective of each class, on one arm."""
    model = random_arm(rng, 6)
    task = TwistTask("tool", "site", POINT)  # fmt: skip
    task.set_target(mink.SE3.identity())
    return [
        JointCentering(model, **options),
        PostureReference(model, random_configuration(model, rng), **options),
        Manipulability(model, task, **options),
    ]


@pytest.mark.parametrize("gain", [0.0, 0.5, 1.0, 2.5])
def test_as_a_plain_mink_task_an_objective_is_followed_exactly(gain: float) -> None:
    rng = np.random.default_rng(15)
    dt = 0.02
    for objective in objectives(rng, gain=gain, cost=1.0):
        model = objective.model
        configuration = mink.Configuration(model, random_configuration(model, rng))
        assert isinstance(objective, mink.Task)
        velocity = mink.solve_ik(configuration, [objective], dt, "daqp", limits=[])
        direction = objective.direction(configuration)
        assert np.linalg.norm(direction) > 1e-3
        close(velocity, gain * direction / dt, atol=1e-7)
        close(objective.displacement(configuration), gain * direction)


@pytest.mark.parametrize("name", ["gain", "cost"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, "much"])
def test_gains_and_costs_that_are_negative_or_no_numbers_are_refused(
    name: str, value: object
) -> None:
    model = planar_arm([1.0, 1.0])
    task = TwistTask("tip", "site", PLANE)
    for refused in (
        lambda: JointCentering(model, **{name: value}),
        lambda: PostureReference(model, np.zeros(2), **{name: value}),
        lambda: Manipulability(model, task, **{name: value}),
    ):
        with pytest.raises(InvalidInput, match=f"^{name}: expected|^{name}: entry"):
            refused()

"""Joints that MJCF couples: one constraint, which steps, plans, checks and studies keep."""

import dataclasses
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import chain
from oracles.banded_paths import every
from oracles.half_space import HalfSpace
from oracles.joint_paths import between, evenly, joint_path
from oracles.twists import ALONG_X, NOTHING

import qp_twist as qt
from qp_twist.constraints import COUPLED_WITHIN
from qp_twist.following.batch import follow as follow_many
from qp_twist.planning import random_start
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.roll_grid import closed_form_arm
from qp_twist.trajectories import TimedPath, check_trajectory

Array = np.ndarray
ROOT = Path(__file__).parents[2]
SEEDS = st.integers(0, 2**32 - 1)
X, Y, Z = np.eye(3)
FINGERS = """
  <body><joint name="finger_1" type="slide" axis="0 1 0" range="0 0.04"/>
    <geom size="0.01" contype="0" conaffinity="0"/></body>
  <body><joint name="finger_2" type="slide" axis="0 -1 0" range="0 0.04"/>
    <geom size="0.01" contype="0" conaffinity="0"/></body>
"""


def scene(name: str, equality: str, bodies: str = "") -> mujoco.MjModel:
    """A scene of the package with couplings, and with more bodies beside its tool."""
    text = (ROOT / "scenes" / f"{name}.xml").read_text("utf-8")
    text = text.replace('<site name="tool"', f'{bodies}<site name="tool"')
    text = text.replace("</mujoco>", f"<equality>{equality}</equality></mujoco>")
    return mujoco.MjModel.from_xml_string(text)


def with_gripper(
    equality: str = '<joint joint1="finger_2" joint2="finger_1"/>', step: int = 20
) -> qt.PathTask:
    """The deburring arm with a gripper: its fingers are in the chain of nothing."""
    task = qt.load_task("deburring")
    model = scene("m16ib_deburring", equality, FINGERS)
    limits = {
        "velocity_limits": np.append(task.velocity_limits, [0.1, 0.1]),
        "acceleration_limits": np.append(task.acceleration_limits, [np.inf, np.inf]),
        "start": np.append(task.start, [0.01, 0.01]),
        "starts": {},
    }
    return every(dataclasses.replace(task, model=model, **limits), step)


def planar(equality: str) -> qt.PathTask:
    """The planar arm, its tool's x along a line and y free, with some of its joints coupled."""
    line = every(qt.load_task("planar_line"), 10, projector=ALONG_X)
    return dataclasses.replace(line, model=scene("planar_3r", equality))


def coupled_chain(rng: np.random.Generator, joints: int = 4) -> mujoco.MjModel:
    """Hinges and slides with random references and couplings of every degree, one by itself."""
    opening = "".join(
        f'<body pos="0.1 0 0.2"><joint name="j{i}" type="{"slide" if i == 1 else "hinge"}" '
        f'axis="{rng.normal()} {rng.normal()} 1" ref="{rng.uniform(-1, 1)}"/>'
        '<geom size="0.05" mass="1"/>'
        for i in range(joints)
    )
    rows = ""
    for _ in range(3):
        one, two = rng.choice(joints, 2, replace=False)
        degree = rng.integers(0, 5)
        coefficients = np.zeros(5)
        coefficients[: degree + 1] = rng.normal(size=degree + 1)
        other = f'joint2="j{two}"' if rng.uniform() < 0.8 else ""
        text = " ".join(map(repr, map(float, coefficients)))
        rows += f'<joint joint1="j{one}" {other} polycoef="{text}"/>'
    rows += '<joint joint1="j0" joint2="j1" polycoef="9 9 9 9 9" active="false"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{opening}<site name="tool"/>'
        f"{'</body>' * joints}</worldbody><equality>{rows}</equality></mujoco>"
    )


def mujocos_residuals(model: mujoco.MjModel, q: Array) -> Array:
    """How far apart MuJoCo itself says that coupled joints are, (N, C)."""
    data, found = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        of_equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        found.append(data.efc_pos[of_equality][np.argsort(data.efc_id[of_equality])])
    return np.array(found)


# ---------------------------------------------------------------- what the constraint states


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_polynomial_is_mujocos_and_the_derivative_is_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = coupled_chain(rng)
    couplings = qt.JointCouplings(model, 0.3)
    q = rng.uniform(-1.5, 1.5, (5, model.nq))
    residuals = mujocos_residuals(model, q)
    np.testing.assert_allclose(couplings.residuals(q), residuals, atol=1e-12)
    np.testing.assert_allclose(couplings.margins(q), 0.3 - np.abs(residuals), atol=1e-12)
    step = 1e-6 * rng.normal(size=q.shape)
    central = 0.5 * (couplings.residuals(q + step) - couplings.residuals(q - step))
    along = (couplings.slopes(q) @ step[:, :, None])[:, :, 0]
    np.testing.assert_allclose(along, central, atol=2e-10)
    away = np.abs(residuals) > 1e-4
    central = 0.5 * (couplings.margins(q + step) - couplings.margins(q - step))
    along = (couplings.gradients(q) @ step[:, :, None])[:, :, 0]
    np.testing.assert_allclose(along[away], central[away], atol=2e-10)
    # Both sides are rows: they let pass what MuJoCo's residual lets pass, to first order.
    rows, rooms, of = couplings.rows(q)
    assert rows.shape == (5, 6, model.nv) and of.tolist() == [0, 1, 2, 0, 1, 2]
    np.testing.assert_allclose(rooms, 0.3 + np.hstack([-residuals, residuals]), atol=1e-12)
    np.testing.assert_allclose(rows[:, :3], -rows[:, 3:])


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_bound_of_the_change_holds_on_ways_that_turn_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = coupled_chain(rng)
    couplings = qt.JointCouplings(model)
    stops = rng.uniform(-1, 1, model.nq) + np.cumsum(0.4 * rng.normal(size=(4, model.nq)), axis=0)
    travel = np.abs(np.diff(stops, axis=0)).sum(axis=0)
    margins = couplings.margins(between(stops, 400))
    change = couplings.change(stops[:1], travel[None])[0]
    assert (np.abs(np.diff(margins, axis=0)).sum(axis=0) <= change + 1e-9).all()
    least = couplings.least(stops[:1], stops[-1:], travel[None])[0]
    assert (least <= margins.min(axis=0) + 1e-9).all()


# ---------------------------------------------------------------- who has it


def test_a_path_has_the_couplings_of_its_model_whatever_else_it_is_given() -> None:
    task = with_gripper()
    [couplings] = task.constraints
    assert isinstance(couplings, qt.JointCouplings)
    assert couplings.names == ("finger_2 to finger_1",) and couplings.units == ("m",)
    assert couplings.tolerance == COUPLED_WITHIN
    assert len(dataclasses.replace(task, constraints=()).constraints) == 1
    loose = qt.JointCouplings(task.model, 1e-3)
    own = HalfSpace(task.model, "link_5", "body", Z, 0.1)
    given_ = dataclasses.replace(task, constraints=(loose, own)).constraints
    assert given_[0] is own and given_[1].tolerance == 1e-3
    # Of another model that has none, none; the tolerance is kept with another that has some.
    plain = dataclasses.replace(task, model=scene("m16ib_deburring", "", FINGERS))
    assert plain.constraints == ()
    other = dataclasses.replace(task, constraints=(loose,))
    both = '<joint joint1="finger_2" joint2="finger_1"/><joint joint1="joint_6" joint2="joint_5"/>'
    other = dataclasses.replace(other, model=scene("m16ib_deburring", both, FINGERS))
    assert [(c.names, c.units, c.tolerance) for c in other.constraints] == [
        (("joint_6 to joint_5",), ("rad",), COUPLED_WITHIN),
        (("finger_2 to finger_1",), ("m",), 1e-3),
    ]
    # One for a controller may be of both units.
    assert qt.JointCouplings(other.model).units == ("m", "rad")
    asleep = dataclasses.replace(task, model=with_gripper(
        '<joint joint1="finger_2" joint2="finger_1" active="false"/>').model)  # fmt: skip
    assert asleep.constraints == ()


@pytest.mark.parametrize("solver", [None, "daqp"])
def test_a_step_keeps_joints_coupled_unless_its_limits_are_given(solver: str | None) -> None:
    """A secondary that pulls the fingers apart moves them together, and leaves the task alone."""
    task = with_gripper()
    twist = qt.TwistTask("tool", "site", task.projector)
    twist.set_target(task.waypoints[1])
    apart = np.append(task.start[:6], [0.03, 0.0])
    pull = qt.PostureReference(task.model, apart, 0.3)
    controller = qt.Controller(task.model, tasks=[twist], secondary=[pull], solver=solver)
    bare = qt.Controller(task.model, tasks=[twist], secondary=[pull], limits=[], solver=solver)
    configuration = mink.Configuration(task.model, task.start)
    assert bare.step(configuration, 0.1).velocity[6] > 0.02
    for _ in range(30):
        step = controller.step(configuration, 0.1)
        configuration.integrate_inplace(step.velocity, 0.1)
        assert abs(configuration.q[7] - configuration.q[6]) <= COUPLED_WITHIN + 1e-12
    assert step.status is qt.Status.SOLVED
    assert np.linalg.norm(twist.compute_error(configuration)) < 1e-8
    assert configuration.q[6] == pytest.approx(0.015, abs=1e-4)  # the middle of what they want
    assert ("finger_2 to finger_1", "coupling") in [(b.joint, b.kind) for b in step.binding]
    # What is torn apart comes back at the constraint's own speed.
    configuration.update(np.append(configuration.q[:6], [0.01, 0.03]))
    step = controller.step(configuration, 0.1)
    assert step.velocity[7] - step.velocity[6] <= -0.1 + 1e-9
    assert "finger_2 to finger_1" in step.message


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_reference_and_kernel_take_the_same_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = coupled_chain(rng, 6)
    task = qt.TwistTask("tool", "site", ALONG_X)
    q = rng.uniform(-0.5, 0.5, model.nq)
    configuration = mink.Configuration(model, q)
    task.set_target_from_configuration(configuration)
    assert task.target is not None
    near = task.target.translation() + 0.02 * rng.normal(size=3)
    task.set_target(mink.SE3.from_translation(near))
    pull = qt.PostureReference(model, rng.uniform(-1, 1, model.nq), 0.1)
    steps = []
    for solver in ("compiled", "daqp"):
        controller = qt.Controller(model, tasks=[task], secondary=[pull], solver=solver)
        try:
            steps.append(controller.step(configuration, 0.05))
        except (qt.NoSolutionFound, qt.InvalidInput) as error:  # couplings that contradict others
            steps.append(type(error))
    one, other = steps
    if isinstance(one, type) or isinstance(other, type):
        assert one is other
        return
    assert one.status is other.status
    np.testing.assert_allclose(one.velocity, other.velocity, atol=1e-6)
    assert {(b.joint, b.kind) for b in one.binding} == {(b.joint, b.kind) for b in other.binding}


# ---------------------------------------------------------------- runs and their checks


def test_a_run_with_a_gripper_keeps_it_and_a_check_finds_where_another_does_not() -> None:
    task = with_gripper()
    torn = dataclasses.replace(task, start=np.append(task.start[:6], [0.03, 0.01]))
    run = qt.follow(torn, "qp_gradient")  # a start that is torn apart is brought together
    assert np.abs(run.q[:, 7] - run.q[:, 6]).max() <= COUPLED_WITHIN + 1e-12
    assert run.position_error.max() < 1e-6
    passes = {f.name: f for f in check_trajectory(run, task).findings}
    assert passes["outside coupling"].passes and passes["outside coupling between"].passes
    q = run.q.copy()
    q[4, 6] += 2e-3
    rows = TimedPath(qt.JointRanges.of(task.model).names, q)
    failed = {f.name: f for f in check_trajectory(rows, task).findings}
    assert not failed["outside coupling"].passes
    assert failed["outside coupling"].where == "finger_2 to finger_1, waypoint 5"
    assert failed["outside coupling"].value == pytest.approx(2e-3, abs=3e-5)
    assert not failed["outside coupling between"].passes
    # A closed form ignores the coupling, and the comparison says so.
    comparison = qt.compare(torn, methods=["gradient_projection", "qp_gradient"]).to_dict()
    excess = {name: m["constraint_excess_max"] for name, m in comparison["methods"].items()}
    assert excess["gradient_projection"] > 0.01
    assert excess["qp_gradient"] < 1e-9


def test_what_leaves_a_coupling_between_waypoints_only_is_found() -> None:
    joints = ('range="-3 3"', 'range="-3 3"')
    bent = '<joint joint1="joint_2" joint2="joint_1" polycoef="0 1 0.5 0 0"/>'
    turn = np.array([0.2, 0.6])
    q = np.column_stack([turn, turn + 0.5 * turn**2])
    path = joint_path(chain(*joints, equality=bent), q, None, projector=NOTHING).path_task
    check = check_trajectory(TimedPath(("joint_1", "joint_2"), q), path)
    found = {f.name: f for f in check.findings}
    assert found["outside coupling"].passes and not found["outside coupling between"].passes
    deepest = 0.5 * 0.4**2 / 4.0 - COUPLED_WITHIN  # of a parabola below its chord
    assert found["outside coupling between"].value == pytest.approx(deepest, rel=1e-3)


def test_curved_couplings_are_kept_by_a_run_to_what_a_check_lets_pass() -> None:
    task = planar('<joint joint1="joint_2" joint2="joint_1" polycoef="0.1 0.5 0.2 0 0.02"/>')
    task = dataclasses.replace(task, start=np.array([1.4, 1.27, 2.0]))
    run = qt.follow(task, "qp_gradient")
    assert run.position_error.max() < 1e-5
    assert np.ptp(run.q[:, 0]) > 0.2
    assert mujocos_residuals(task.model, run.q) == pytest.approx(0.0, abs=2.1e-5)


@pytest.mark.whole_path
def test_a_study_takes_a_task_whose_scene_couples_joints(tmp_path: Path) -> None:
    text = (ROOT / "tasks" / "planar_line.toml").read_text("utf-8")
    text = text.replace("steps_per_segment = 100", "steps_per_segment = 8")
    equality = '<joint joint1="joint_3" joint2="joint_2" polycoef="0 -1 0 0 0"/>'
    robot = (ROOT / "scenes" / "planar_3r.xml").read_text("utf-8")
    robot = robot.replace("</mujoco>", f"<equality>{equality}</equality></mujoco>")
    (tmp_path / "coupled.xml").write_text(robot, "utf-8")
    before = next(line for line in text.splitlines() if line.startswith("scene"))
    (tmp_path / "line.toml").write_text(text.replace(before, 'scene = "coupled.xml"'), "utf-8")
    task = qt.load_task(tmp_path / "line.toml")
    assert [c.kind for c in task.constraints] == ["coupling"]
    study = qt.study(
        task, ["start"], 1, ["qp_gradient"], out=tmp_path / "study", jobs=1, certify=False
    )
    assert [summary.method for summary in study.summary()] == ["qp_gradient"]
    assert study.missing() == []
    loose = dataclasses.replace(task, constraints=(qt.JointCouplings(task.model, 1e-3),))
    with pytest.raises(qt.InvalidInput, match=r"constraints \(coupling\) that its task file lacks"):
        qt.study(loose, ["start"], 1, out=tmp_path / "other")


def test_who_cannot_ask_it_refuses_the_task() -> None:
    task = with_gripper()
    assert "sns" not in task.method_names()
    assert not any(qt.METHODS[name].peer for name in task.method_names())
    with pytest.raises(qt.InvalidInput, match=r"deburring has constraints \(coupling\)"):
        qt.follow(task, "sns")
    with pytest.raises(qt.InvalidInput, match="has no compiled form"):
        follow_many(task, starts=task.start[None])


LOOPS = {
    "closed at a point": ('<connect name="loop" body1="a" body2="b" anchor="0 0 0"/>', "a", "b"),
    "closed at sites": ('<connect site1="tool" site2="end"/>', "a", "b"),
    "to the world": ('<weld body1="a"/>', "a", "world"),
    "of tendons": ('<tendon tendon1="t" polycoef="0 1 0 0 0"/>',),
}


def with_equality(equality: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="a"><joint name="j0"/><joint name="j1" type="slide"/>'
        '<geom size="0.1"/><site name="tool"/><body name="stuck" pos="0 0 0.1"/></body>'
        '<body name="b" pos="0 0 1"><joint name="j2"/><geom size="0.1"/><site name="end"/></body>'
        '</worldbody><tendon><fixed name="t"><joint joint="j0" coef="1"/></fixed></tendon>'
        f"<equality>{equality}</equality></mujoco>"
    )


@pytest.mark.parametrize("of", LOOPS)
def test_a_path_is_refused_where_it_would_tear_a_closed_loop(of: str) -> None:
    equality, *bodies = LOOPS[of]
    with pytest.raises(qt.InvalidInput, match="keeps couplings of joints only") as refused:
        joint_path(with_equality(equality), np.zeros((3, 3)), evenly(3, 1.0), 1.0, 1.0)
    assert all(repr(body) in str(refused.value) for body in bodies)
    for idle in (equality.replace("/>", ' active="false"/>'), '<weld body1="a" body2="stuck"/>'):
        made = joint_path(with_equality(idle), np.zeros((3, 3)), evenly(3, 1.0), 1.0, 1.0)
        assert {c.kind for c in made.path_task.stated_constraints} == {"clearance"}


# ---------------------------------------------------------------- plans


@pytest.mark.whole_path
def test_a_plan_of_an_arm_with_a_gripper_is_as_central_as_without() -> None:
    task = with_gripper()
    free = dataclasses.replace(every(qt.load_task("deburring"), 20))
    task = dataclasses.replace(task, durations=None)
    plan, alone = qt.plan(task), qt.plan(free)
    q = plan.motion()
    assert mujocos_residuals(task.model, q) == pytest.approx(0.0, abs=1e-9)
    assert mujocos_residuals(task.model, between(q)) == pytest.approx(0.0, abs=2e-5)
    # Closed fingers in the middle of their range cost nothing.
    assert plan.value == pytest.approx(alone.value, rel=0.02)
    assert plan.bound == pytest.approx(alone.bound, rel=0.02)
    assert "no proof" not in str(plan.certificate)
    assert all(f.passes for f in plan.examined() if "coupling" in f.name)
    run = qt.follow(task, "qp_planned", plan=plan)
    assert run.constraint_excess.max() <= 1e-9 and run.position_error.max() < 1e-8
    assert closed_form_arm(free) is not None and closed_form_arm(task) is None
    for start in (random_start(task, np.random.default_rng(0)), qt.find_starts(task)[0].q):
        assert start is not None
        assert abs(start[7] - start[6]) <= COUPLED_WITHIN


def test_a_coupling_in_the_chain_is_kept_and_the_plan_as_good_as_brute_force() -> None:
    """joint_2 = 1.2 − joint_1/2: of the two joints that are free the task leaves one."""
    task = planar('<joint joint1="joint_2" joint2="joint_1" polycoef="1.2 -0.5 0 0 0"/>')
    plan = qt.plan(task, max_step_deg=40.0)
    q = plan.motion()
    assert mujocos_residuals(task.model, q) == pytest.approx(0.0, abs=1e-8)
    assert (PathRows(task).freedom == 1).all()
    # All configurations of a fine grid that keep the coupling and are on the line.
    ranges, total = qt.JointRanges.of(task.model), 0.0
    one = np.linspace(ranges.lower[0], ranges.upper[0], 40001)
    two = 1.2 - 0.5 * one
    for waypoint in task.waypoints:
        cosine = waypoint.translation()[0] - 2.0 * np.cos(one) - 1.5 * np.cos(one + two)
        ok = np.abs(cosine) <= 1.0
        best = np.inf
        for sign in (1.0, -1.0):
            third = sign * np.arccos(cosine[ok]) - (one + two)[ok]
            third = (third + np.pi) % (2.0 * np.pi) - np.pi
            every_q = np.column_stack([one[ok], two[ok], third])
            inside = ranges.inside(every_q)
            best = min(best, ranges.centering(every_q[inside]).min(initial=np.inf))
        total += best / len(task.waypoints)
    assert total - 1e-6 <= plan.value <= 1.02 * total
    assert plan.bound <= plan.value + 1e-9
    assert plan.bound >= 0.98 * total


@pytest.mark.whole_path
def test_what_couplings_leave_no_configuration_of_is_said() -> None:
    """joint_2 is held where its range does not reach."""
    task = every(planar('<joint joint1="joint_2" polycoef="5 0 0 0 0"/>'), 10)
    plan = qt.plan(task)
    assert plan.q is None and plan.certificate.kind == "limits"
    assert "joint_2" in str(plan.certificate)
    with pytest.raises(qt.following.NoStart, match="joint_2"):
        qt.find_starts(task)
    # Two couplings that contradict each other.
    task = planar(
        '<joint joint1="joint_2" joint2="joint_1"/>'
        '<joint joint1="joint_2" joint2="joint_1" polycoef="0.1 1 0 0 0"/>'
    )
    plan = qt.plan(every(task, 10))
    assert plan.q is None and "joint_2 to joint_1" in str(plan.certificate)

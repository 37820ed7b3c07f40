"""A constraint is one class: plans, steps and checks keep it, or refuse the task in a sentence."""

import dataclasses
import re

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration, random_direction
from oracles.banded_paths import ARM, BANDS, every, least_mean_z
from oracles.half_space import HalfSpace
from oracles.joint_paths import between, joint_path, slider
from oracles.twists import ALONG_X, NOTHING, at

import qp_twist as qt
from qp_twist.following.batch import follow as follow_many
from qp_twist.referee import JointMotion, constraints_left, path_errors
from qp_twist.trajectories import TimedPath, check_trajectory

Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)
X, Y, Z = np.eye(3)


def heights(model: mujoco.MjModel, body: str, q: Array, normal: Array) -> Array:
    """n·p of a body or site by MuJoCo, one configuration after the other."""
    data, found = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        named = data.site(body).xpos if body in ("tool", "tip") else data.body(body).xpos
        found.append(named @ normal)
    return np.array(found)


# ---------------------------------------------------------------- what a constraint states


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_the_example_states_its_derivative_and_bounds_its_change(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_arm(rng, 5, slides=True)
    half = HalfSpace(model, "tool", "site", random_direction(rng), 0.1)
    q = np.array([random_configuration(model, rng) for _ in range(4)])
    step = 1e-6 * rng.normal(size=q.shape)
    change = 0.5 * (half.margins(q + step) - half.margins(q - step))
    np.testing.assert_allclose((half.gradients(q) @ step[:, :, None])[:, :, 0], change, atol=2e-11)
    # On a way that turns back: what it varies by in sum.
    stops = q[:, None] + np.cumsum(0.2 * rng.normal(size=(4, 3, 5)), axis=1)
    stops = np.concatenate([q[:, None], stops], axis=1)
    travel = np.abs(np.diff(stops, axis=1)).sum(axis=1)
    for k in range(4):
        margins = half.margins(between(stops[k], 200))
        assert np.abs(np.diff(margins[:, 0])).sum() <= half.change(q, travel)[k, 0] + 1e-9
        least = half.least(stops[:, 0], stops[:, -1], travel)[k, 0]
        assert least <= margins.min() + 1e-9


# ---------------------------------------------------------------- between waypoints


@pytest.mark.whole_path
@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_what_is_proven_between_waypoints_holds_at_every_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_arm(rng, 4, slides=True, limited=False)
    q = random_configuration(model, rng) + np.cumsum(0.2 * rng.normal(size=(3, 4)), axis=0)
    half = HalfSpace(model, "tool", "site", random_direction(rng), 0.0)
    # The plane touches what the motion passes, or nearly.
    half.offset = float((half.margins(between(q)) + half.offset).min() + rng.uniform(-2, 2) * 1e-3)
    task = joint_path(model, q, None, projector=NOTHING).path_task
    task = dataclasses.replace(task, constraints=(half,))
    sampled = np.maximum(-half.margins(between(q, 1000)), 0.0).max()
    left = constraints_left(task, q, (1e-4, 1e-3))
    assert sampled <= left.bound.max() + 1e-12
    assert left.found.max() <= sampled + 1e-6
    assert left.bound.max() <= max(1.01e-4, 1.021 * sampled + 1e-6)
    motion = JointMotion(np.arange(3.0), q, rng.normal(size=q.shape))
    errors = path_errors(task, motion, tolerances=(1e-4, 1e-3))
    passed = motion.at(np.linspace(0.0, 2.0, 3000)).q
    sampled = np.maximum(-half.margins(passed), 0.0).max()
    assert sampled <= max(of.bound.max() for of in errors.bands) + 1e-12
    assert not errors.kept(1e-4, 1e-3).all() or sampled <= 1.001e-4


@pytest.mark.parametrize(("depth", "passes"), [(0.0499, True), (0.0503, False)])
def test_a_check_refutes_what_leaves_it_between_waypoints_only(depth: float, passes: bool) -> None:
    """The frame is on y = 0 at every waypoint, and dips between two of them."""
    q = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    task = joint_path(slider(2), q, None, projector=ALONG_X).path_task
    half = HalfSpace(task.model, "tool", "site", Y, -0.05)
    task = dataclasses.replace(task, constraints=(half,))
    rows = np.array([[0.0, 0.0], [1.0, 0.0], [1.5, -depth], [2.0, 0.0]])
    check = check_trajectory(TimedPath(("slide_1", "slide_2"), rows), task)
    found = {finding.name: finding for finding in check.findings}
    assert check.passes == passes
    assert found["outside half-space"].passes
    assert found["outside half-space"].where.startswith("tool, waypoint")
    assert found["outside half-space between"].passes == passes
    if not passes:
        assert found["outside half-space between"].where == "tool, waypoints 2 to 3"
        assert found["outside half-space between"].value == pytest.approx(depth - 0.05, rel=1e-6)
        assert "outside half-space between" in str(check.verdict)


# ---------------------------------------------------------------- plans


def wrist(task: qt.PathTask, height: float) -> qt.PathTask:
    """With the wrist above a table."""
    half = HalfSpace(task.model, "link_5", "body", Z, height)
    return dataclasses.replace(task, bands=(), constraints=(half,))


@pytest.mark.whole_path
def test_a_plan_keeps_it_and_is_as_central_as_brute_force() -> None:
    free, height, most = every(BANDS, 4, bands=()), 0.8, np.radians(20.0)
    task = wrist(free, height)
    plan = qt.plan(task, max_step_deg=20.0)
    q = plan.motion()
    assert heights(task.model, "link_5", q, Z).min() >= height - 1e-9
    assert heights(task.model, "link_5", between(q), Z).min() >= height - 1e-4
    unbound = qt.plan(free, max_step_deg=20.0)
    assert heights(task.model, "link_5", unbound.motion(), Z).min() < height - 0.05
    layers = []
    for waypoint in task.waypoints:
        some = ARM.inside_with_turns(ARM.branches(waypoint, np.radians(np.arange(0.0, 360.0))))
        layers.append(some[heights(task.model, "link_5", some, Z) >= height])
    assert plan.value <= 1.02 * least_mean_z(task, layers, most)
    assert unbound.value < plan.value
    assert "all limits and constraints" in str(plan.certificate)
    assert "outside constraints by at most" in plan.promise
    assert all(f.passes for f in plan.examined() if "half-space" in f.name)
    run = qt.follow(task, "qp_planned", plan=plan)
    assert run.constraint_excess.max() <= 1e-9
    assert run.position_error.max() < 1e-8 and run.axis_error.max() < 1e-8


@pytest.mark.whole_path
def test_the_constraint_that_forbids_a_waypoint_is_named() -> None:
    task = wrist(every(BANDS, 20), 1.5)
    plan = qt.plan(task)
    assert plan.q is None and plan.certificate.kind == "band"
    assert plan.certificate.bands == ("constraints[0], link_5",)
    assert "inside both the joint limits and constraints[0], link_5" in str(plan.certificate)
    assert "no proof" in str(plan.certificate)  # rolls between those of the grid
    with pytest.raises(qt.InvalidInput, match=r"In the way: .*link_5 \(upper half-space limit\)"):
        qt.plan(task, start=task.start)
    free = dataclasses.replace(task, constraints=())
    start = qt.plan(free, max_step_deg=60.0).start
    lower = heights(task.model, "link_5", start[None], Z)[0]
    by = f"{1e3 * (1.5 - lower):.3g} mm"
    with pytest.raises(qt.InvalidInput, match=rf"outside constraints\[0\], link_5 by {by}"):
        qt.plan(task, start=start)
    with pytest.raises(qt.following.NoStart, match=r"joint limits and constraints\[0\]"):
        qt.find_starts(task)


# ---------------------------------------------------------------- steps and runs


@pytest.mark.parametrize("solver", [None, "daqp"])
def test_a_step_keeps_it_and_names_it(solver: str | None) -> None:
    """The target is 0.3 m below the table."""
    model = slider(3)
    half = HalfSpace(model, "tool", "site", [0.0, 0.6, 0.8], -0.08)
    task = qt.TwistTask(
        "tool", "site", joint_path(model, np.zeros((2, 3)), None).path_task.projector
    )
    task.set_target(at(0.0, 0.0, -0.4))
    controller = qt.Controller(model, tasks=[task], limits=[half], solver=solver)
    configuration = mink.Configuration(model)
    for _ in range(40):
        step = controller.step(configuration, 0.1)
        configuration.integrate_inplace(step.velocity, 0.1)
    # The straight way ends there; it slides on to the closest point of the half-space.
    np.testing.assert_allclose(configuration.q, [0.0, 0.144, -0.208], atol=1e-7)
    [binding] = step.binding
    assert (binding.joint, binding.kind) == ("tool", "half-space")
    # From outside it comes back, no faster than it says.
    configuration.update(np.array([0.0, 0.0, -0.2]))
    assert half.compute_qp_inequalities(configuration, 0.1).h == pytest.approx([-0.01])
    configuration.update(np.array([0.0, 0.0, -0.101]))
    assert half.compute_qp_inequalities(configuration, 0.1).h == pytest.approx([-0.0008])


def test_minks_own_function_keeps_it() -> None:
    model = slider(3)
    half = HalfSpace(model, "tool", "site", Z, -0.1)
    task = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=0.0)
    task.set_target(at(0.1, 0.0, -0.4))
    configuration = mink.Configuration(model)
    for _ in range(40):
        velocity = mink.solve_ik(configuration, [task], 0.1, solver="daqp", limits=[half])
        configuration.integrate_inplace(velocity, 0.1)
    assert configuration.q == pytest.approx([0.1, 0.0, -0.1], abs=1e-4)


@pytest.mark.whole_path
@pytest.mark.parametrize("method", ["qp_gradient", "qp", "qp_minimum_norm"])
def test_a_run_keeps_it_and_a_closed_form_that_does_not_is_told_of(method: str) -> None:
    line = every(qt.load_task("planar_line"), 5, projector=ALONG_X)
    half = HalfSpace(line.model, line.frame_name, line.frame_type, Y, 1.95)
    task = dataclasses.replace(line, constraints=(half,))
    run = qt.follow(task, method)
    assert run.compiled == 0
    at = heights(task.model, task.frame_name, run.q, Y)
    assert at.min() >= 1.95 - 1e-5
    assert run.position_error.max() < 1e-4
    assert run.constraint_excess == pytest.approx(np.maximum(1.95 - at, 0.0), abs=1e-12)


def test_a_comparison_says_by_how_much_it_is_left() -> None:
    task = wrist(every(BANDS, 10), 0.8)
    comparison = qt.compare(task, methods=["minimum_norm", "qp_gradient"])
    numbers = comparison.to_dict()["methods"]
    left = numbers["minimum_norm"]
    q = qt.follow(task, "minimum_norm").q
    most = 0.8 - heights(task.model, "link_5", q, Z).min()
    assert left["constraint_excess_max"] == pytest.approx(most)
    assert re.search(r"outside a constraint at \d+ waypoints?, first at", left["status"])
    assert numbers["qp_gradient"]["constraint_excess_max"] < most
    assert "constraint" in comparison.table()
    said = " ".join(comparison.findings())
    assert re.search("minimum_norm: [^.]*outside a constraint at", said)


# ---------------------------------------------------------------- who cannot ask it refuses it


def refused() -> qt.PathTask:
    return wrist(every(BANDS, 20), 0.5)


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda task: qt.follow(task, "sns"), "takes bounds on single joints only.*half-space"),
        (lambda task: qt.follow(task, "mink"), "constraints are not handed to mink"),
        (lambda task: follow_many(task, starts=task.start[None]), "has to keep its half-space"),
        (lambda task: qt.study(task, out="never"), "its task file lacks"),
    ],
)
def test_who_cannot_ask_it_refuses_the_task(ask, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(qt.InvalidInput, match=said):
        ask(refused())
    assert "sns" not in refused().method_names()
    assert "mink" not in refused().method_names()


def test_what_is_no_constraint_of_a_path_is_refused() -> None:
    task, model = every(BANDS, 20), BANDS.model
    half = HalfSpace(model, "link_5", "body", Z, 0.5)

    class Mixed(HalfSpace):  # type: ignore[misc, valid-type]
        def __init__(self) -> None:
            super().__init__(model, "link_5", "body", Z, 0.5)
            self.names, self.units = ("a", "b"), ("m", "rad")

    class Narrow(HalfSpace):  # type: ignore[misc, valid-type]
        def margins(self, q: Array) -> Array:
            return super().margins(q)[:, 0]

    for given_, said in (
        ((mink.VelocityLimit(model, {}),), "expected a qp_twist.Constraint, got VelocityLimit"),
        ((qt.MotionLimit(model, velocity=1.0),), "MotionLimit limits velocities, too"),
        ((half, Mixed()), r"constraints\[1\]: expected a unit for each of its 2 names"),
        ((Narrow(model, "link_5", "body", Z, 0.5),), r"margins\(q\) of two configurations"),
        ("table", "expected a list"),
    ):
        with pytest.raises(qt.InvalidInput, match=said):
            dataclasses.replace(task, constraints=given_)
    with pytest.raises(TypeError, match="change"):
        type("Half", (qt.Constraint,), {"margins": None, "gradients": None})()


class Wall(qt.Constraint):
    """The sum of some joints stays above an angle, on an arm of so many joints."""

    names, units, kind = ("wall",), ("rad",), "wall"

    def __init__(self, angle: float, joints: tuple[int, ...] = (5,), nv: int = 6) -> None:
        self.angle, self.joints, self.nv = angle, list(joints), nv

    def margins(self, q: Array) -> Array:
        return q[:, self.joints].sum(axis=1, keepdims=True) - self.angle

    def gradients(self, q: Array) -> Array:
        row = np.isin(np.arange(self.nv), self.joints).astype(float)
        return np.tile(row, (len(q), 1, 1))

    def change(self, q: Array, travel: Array) -> Array:
        return travel[:, self.joints].sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"nv": 7, "joints": [6]},
            r"limits=.*Wall: margins\(q\).*raises IndexError.*6 degrees of freedom",
        ),
        ({"nv": 5}, r"limits=.*Wall: gradients\(q\).*expected numbers of shape \(2, 1, 6\)"),
        ({"kind": ""}, "limits=.*Wall: expected its kind as a name for messages, got ''"),
        ({"kind": None}, "limits=.*Wall: expected its kind"),
        ({"names": ("a", "b")}, "limits=.*Wall: expected names, texts, and as many units"),
        ({"names": ("a", "b"), "units": ("rad", "rad")}, r"margins\(q\).*shape \(2, 2\)"),
        ({"change": lambda q, travel: np.full((2, 1), np.nan)}, r"change\(q, travel\)"),
    ],
)
@pytest.mark.parametrize("solver", [None, "daqp"])
def test_a_controller_refuses_a_constraint_that_does_not_fit(
    changed: dict[str, object], said: str, solver: str | None
) -> None:
    model = qt.load_task("deburring").model
    wall, tool = Wall(-9.0), qt.TwistTask.axis_free("tool", "site")
    vars(wall).update(changed)
    with pytest.raises(qt.InvalidInput, match=said):
        qt.Controller(model, [tool], limits=[wall], solver=solver)
    with pytest.raises(qt.InvalidInput, match=said):
        qt.Controller(model, levels=[[tool], [wall]], limits=[], solver=solver)


@pytest.mark.parametrize("solver", [None, "daqp", "solve_ik"])
def test_a_step_says_which_constraint_is_left(solver: str | None) -> None:
    task = qt.load_task("deburring")
    configuration = mink.Configuration(task.model, task.start)
    tool = qt.TwistTask.axis_free("tool", "site")
    tool.set_target(task.waypoints[1])

    def step(angle: float) -> qt.Step:
        limits = [Wall(angle, (4, 5))]  # of two joints, so that its row is no bound
        if solver == "solve_ik":
            return qt.ik_step(configuration, [tool], 0.01, "daqp", limits=limits)
        controller = qt.Controller(task.model, [tool], limits=limits, solver=solver)
        return controller.step(configuration, 0.01)

    at = float(task.start[4] + task.start[5])
    assert step(at - 0.1).recovering == ()
    assert step(at - 1e-12).recovering == ()
    outside = step(at + 0.1)
    assert outside.recovering == ("wall is 0.1 rad outside its wall limit",)
    assert "recovering: wall is 0.1 rad outside" in outside.message

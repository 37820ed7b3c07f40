"""Junk anywhere in the public API: only documented exceptions come out, each with a sentence."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.twists import SPATIAL, pose

import qp_twist as qt
from qp_twist import closed_form
from qp_twist.constraints import DisplacementWindow
from qp_twist.geometry import twist_error

JUNK: list[Any] = [
    None, "abc", "", b"x", True, 0, -1, 1.5, float("nan"), float("inf"), 1e308, 10**400, 1 + 2j,
    [], [[]], [1, 2], [1, "a", 2], [None] * 3, [[1, 2], [3]], {}, {"a": 1}, set(), object(),
    np.zeros(3), np.full(3, np.nan), np.full(6, np.inf), np.zeros((3, 3)), np.zeros((6, 0)),
    np.array(["a", "b"]), lambda: 0, int, range(3), mink.SE3.identity(),
    "1.5", b"1", [True, False], np.array(True), ["1", "2", "3"], 5e-324, -1e300, 1e300,
    np.full(6, 1e300), np.full(6, -1e300), np.full(6, 5e-324), np.zeros(6, dtype=complex),
]  # fmt: skip

DEBURRING = qt.load_task("deburring")
PLANAR = qt.load_task("planar_line")
MODEL = DEBURRING.model
CONFIGURATION = mink.Configuration(MODEL, DEBURRING.start)
J, TWIST, WISH = np.eye(6), np.full(6, 0.01), np.full(6, 0.01)


def task(**options: Any) -> qt.TwistTask:
    made = qt.TwistTask(**{
        "frame_name": "tool", "frame_type": "site", "projector": DEBURRING.projector, **options
    })  # fmt: skip
    made.set_target(DEBURRING.waypoints[0])
    return made


def step(**options: Any) -> qt.Step:
    dt = options.pop("dt", 0.1)
    configuration = options.pop("configuration", CONFIGURATION)
    velocity = options.pop("velocity", None)
    controller = qt.Controller(**{"model": MODEL, "tasks": [task()], **options})
    return controller.step(configuration, dt, velocity=velocity)


def used(kind: Any, argument: str, place: str = "secondary", **fixed: Any) -> Callable[[Any], Any]:
    """An objective or limit with one argument of junk, in use."""
    return lambda junk: step(**{place: [kind(**{"model": MODEL, **fixed, argument: junk})]})


class OddLimit(mink.Limit):
    """A limit of somebody else's, which returns anything."""

    def __init__(self, G: Any = None, h: Any = None) -> None:
        self.G = np.eye(6) if G is None else G
        self.h = np.ones(6) if h is None else h

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Any:
        return mink.Constraint(G=self.G, h=self.h)


class OddTask(mink.Task):
    """A task of somebody else's, which returns anything."""

    def __init__(self, error: Any = None, jacobian: Any = None) -> None:
        super().__init__(cost=np.ones(6))
        self.error = np.zeros(6) if error is None else error
        self.jacobian = np.eye(6) if jacobian is None else jacobian

    def compute_error(self, configuration: mink.Configuration) -> Any:
        return self.error

    def compute_jacobian(self, configuration: mink.Configuration) -> Any:
        return self.jacobian

    def compute_qp_residual(self, configuration: mink.Configuration) -> Any:
        return self.jacobian, self.error, 0.0


ROW, RATE, LOW, HIGH = np.ones((1, 3)), np.ones(1), -np.ones(3), np.ones(3)


def levels(
    A: Any = ROW, b: Any = RATE, lower: Any = LOW, upper: Any = HIGH, **options: Any
) -> qt.Solution:
    return qt.solve_levels([(A, b)], lower, upper, **options)


def assigned(name: str, value: Any) -> None:
    setattr(qt.Controller(MODEL, [task()]), name, value)


CONTROLLER = (
    "model", "tasks", "secondary", "secondary_space", "limits", "solver", "on_infeasible", "metric",
)  # fmt: skip
CALLS: dict[str, Callable[[Any], Any]] = {
    "Projector(kind)": lambda x: qt.Projector(x, np.eye(3)),
    "Projector(basis)": lambda x: qt.Projector(qt.Projector.full().kind, x),
    "Projector(axis)": lambda x: qt.Projector(
        qt.Projector.line([0, 0, 1]).kind, np.eye(3)[:, 2:], x
    ),
    "clamped": lambda x: task().clamped(x),
    "solve_levels(levels)": lambda x: qt.solve_levels(x, LOW, HIGH),
    "solve_levels(levels=[…])": lambda x: qt.solve_levels([x], LOW, HIGH),
    "solve_levels(G)": lambda x: qt.solve_levels([(ROW, RATE, x, RATE)], LOW, HIGH),
    "solve_levels(g)": lambda x: qt.solve_levels([(ROW, RATE, ROW, x)], LOW, HIGH),
    "solve_levels(both bounds)": lambda x: levels(lower=x, upper=x),
    "Controller(levels)": lambda x: step(tasks=[], levels=x),
    "Controller(levels=[…])": lambda x: step(tasks=[], levels=[x]),
    "Controller(levels=[[…]])": lambda x: step(tasks=[], levels=[[task()], [x]]),
    "Controller.singularity": lambda x: assigned("singularity", x),
    "limit's G": lambda x: step(limits=[OddLimit(G=x)]),
    "limit's h": lambda x: step(limits=[OddLimit(h=x)]),
    "task's error": lambda x: step(tasks=[task(), OddTask(error=x)]),
    "task's rows": lambda x: step(tasks=[task(), OddTask(jacobian=x)]),
    "level's error": lambda x: step(tasks=[], levels=[[task()], [OddTask(error=x)]]),
    "level's rows": lambda x: step(tasks=[], levels=[[task()], [OddTask(jacobian=x)]]),
    "Projector.plane": qt.Projector.plane,
    "Projector.line": qt.Projector.line,
    "TwistProjector(linear)": lambda x: qt.TwistProjector(linear=x, angular=qt.Projector.full()),
    "TwistProjector(frame)": lambda x: qt.TwistProjector(
        linear=qt.Projector.full(), angular=qt.Projector.full(), frame=x
    ),
    "resolved": lambda x: DEBURRING.projector.resolved(body=x),
    "task_redundancy(operational)": lambda x: qt.task_redundancy(x, SPATIAL),
    "task_redundancy(task)": lambda x: qt.task_redundancy(SPATIAL, x),
    "twist_error(rotation)": lambda x: twist_error(x, np.zeros(3), np.eye(3), np.zeros(3), SPATIAL),
    "twist_error(position)": lambda x: twist_error(np.eye(3), x, np.eye(3), np.zeros(3), SPATIAL),
    "twist_error(target)": lambda x: twist_error(np.eye(3), np.zeros(3), x, np.zeros(3), SPATIAL),
    "twist_error(projector)": lambda x: twist_error(
        np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), x
    ),
    "rmr(jacobian)": lambda x: closed_form.resolved_motion_rate(x, TWIST),
    "rmr(twist)": lambda x: closed_form.resolved_motion_rate(J, x),
    "minimum_norm(projector)": lambda x: closed_form.minimum_norm(J, x, TWIST),
    "gradient_projection(h)": lambda x: closed_form.gradient_projection(J, SPATIAL, TWIST, x),
    "twa(jacobian)": lambda x: closed_form.twa(x, SPATIAL, TWIST, WISH),
    "twa(operational)": lambda x: closed_form.twa(J, SPATIAL, TWIST, WISH, operational=x),
    "weighted_least_norm(weight)": lambda x: closed_form.weighted_least_norm(J, SPATIAL, TWIST, x),
    "weighted_least_norm(jacobian)": lambda x: closed_form.weighted_least_norm(
        x, None, TWIST, WISH
    ),
    "joint_limit_weights(q)": lambda x: closed_form.joint_limit_weights(x, -WISH, WISH),
    "joint_limit_weights(lower)": lambda x: closed_form.joint_limit_weights(WISH, x, 2 * WISH),
    "joint_limit_weights(previous)": lambda x: closed_form.joint_limit_weights(
        WISH, -WISH, 2 * WISH, x
    ),
    "sns(jacobian)": lambda x: closed_form.saturation_in_null_space(x, None, TWIST, -WISH, WISH),
    "sns(twist)": lambda x: closed_form.saturation_in_null_space(
        J, SPATIAL, x, -WISH, WISH, optimal=True
    ),
    "sns(lower)": lambda x: closed_form.saturation_in_null_space(J, SPATIAL, TWIST, x, WISH),
    "sns(upper)": lambda x: closed_form.saturation_in_null_space(
        J, SPATIAL, TWIST, -WISH, x, optimal=True
    ),
    "set_target": lambda x: task().set_target(x),
    "set_target(twist)": lambda x: task().set_target(DEBURRING.waypoints[0], x),
    "set_target_from_configuration": lambda x: task().set_target_from_configuration(x),
    "set_dt": lambda x: task().set_dt(x),
    "compute_error": lambda x: task().compute_error(x),
    "velocity_rows(dt)": lambda x: task().velocity_rows(CONFIGURATION, x),
    "JointCentering(model)": used(qt.JointCentering, "model"),
    "JointCentering(weight)": used(qt.JointCentering, "weight"),
    "JointCentering(gain)": used(qt.JointCentering, "gain"),
    "PostureReference(q_ref)": used(qt.PostureReference, "q_ref"),
    "Manipulability(task)": used(qt.Manipulability, "task"),
    "JointRanges.of": qt.JointRanges.of,
    "JointRanges.positions": qt.JointRanges.of(MODEL).positions,
    "PositionLimit(model)": qt.PositionLimit,
    "PositionLimit(recovery_speed)": used(qt.PositionLimit, "recovery_speed", "limits"),
    "MotionLimit(velocity)": used(qt.MotionLimit, "velocity", "limits"),
    "MotionLimit(acceleration)": used(qt.MotionLimit, "acceleration", "limits"),
    "MotionLimit.note": qt.MotionLimit(MODEL).note,
    "DisplacementWindow(q_ref)": used(DisplacementWindow, "q_ref", "limits", half_width=np.ones(6)),
    "DisplacementWindow(half_width)": used(DisplacementWindow, "half_width", "limits", q_ref=WISH),
    **{f"Controller({name})": (lambda x, name=name: step(**{name: x})) for name in CONTROLLER},
    **{
        f"Controller({name}=[…])": (lambda x, name=name: step(**{name: [x]}))
        for name in ("tasks", "secondary", "limits")
    },
    **{
        f"step({name})": (lambda x, name=name: step(**{name: x}))
        for name in ("configuration", "dt", "velocity")
    },
    **{
        f"solve_levels({name})": (lambda x, name=name: levels(**{name: x}))
        for name in ("A", "b", "lower", "upper", "reference", "solver", "on_infeasible")
    },
    **{
        f"TwistTask({name})": (lambda x, name=name: step(tasks=[task(**{name: x})]))
        for name in ("frame_name", "frame_type", "projector", "gain", "max_linear_step", "cost")
    },
    "Controller.joint_weight": lambda x: assigned("joint_weight", x),
    "Controller.free_twist_costs": lambda x: assigned("free_twist_costs", (x, 1.0)),
    "load_task": qt.load_task,
    "follow(path_task)": qt.follow,
    "follow(method)": lambda x: qt.follow(PLANAR, x, iterations=1),
    "follow(solver)": lambda x: qt.follow(PLANAR, "twa", solver=x),
    "follow(iterations)": lambda x: qt.follow(PLANAR, "twa", iterations=x),
    "follow(gain)": lambda x: qt.follow(PLANAR, "twa", gain=x),
    "compare(task)": qt.compare,
    "compare(methods)": lambda x: qt.compare(PLANAR, x) if x is not None else None,
    "compare(methods=[…])": lambda x: qt.compare(PLANAR, [x]),
}


@pytest.mark.parametrize("name", CALLS)
def test_junk_is_refused_with_a_sentence_or_taken_for_what_it_is(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for junk in JUNK:
        try:
            with warnings.catch_warnings():
                # Numbers such as 1e308 overflow in a plain formula; the result says so.
                warnings.filterwarnings("ignore", ".*(overflow|invalid value).*", RuntimeWarning)
                result = CALLS[name](junk)
        except mink.MinkError as error:
            assert str(error).strip(), junk
            assert len(str(error)) < 700, junk
            continue
        if isinstance(result, qt.Solution):
            assert np.isfinite(result.x).all(), junk
        if isinstance(result, qt.Step):
            assert np.isfinite(result.velocity).all(), junk
            assert 0.0 <= result.scale <= 1.0, junk


# ------------------------------------------------------------------ arbitrary numbers, everywhere

FLOATS = st.one_of(
    st.floats(),
    st.sampled_from([0.0, 1e-320, 1e-12, 1e9, 1e12, 1e15, 1e100, 1e300, -1e300, np.inf, np.nan]),
)
JOINTS = st.lists(FLOATS, min_size=6, max_size=6)
TWISTS = st.lists(st.one_of(st.floats(-1.0, 1.0), FLOATS), min_size=6, max_size=6)


@given(st.data())
@settings(max_examples=60)
def test_a_controller_takes_any_numbers_or_says_why_not(data: st.DataObject) -> None:
    """One to three numbers of a step are arbitrary; the rest is sound. No warning, no hang."""
    draw = data.draw
    choices = {
        "dt": FLOATS, "velocity": JOINTS, "metric": JOINTS, "joint_weight": FLOATS,
        "singularity": FLOATS, "gain": FLOATS, "max_linear_step": FLOATS, "twist": TWISTS,
        "q": JOINTS, "limit": FLOATS, "cost": FLOATS, "posture": JOINTS, "h": FLOATS,
        "position": st.lists(FLOATS, min_size=3, max_size=3), "free_linear_cost": FLOATS,
    }  # fmt: skip
    odd = {
        key: draw(choices[key], label=key)
        for key in draw(st.sets(st.sampled_from(sorted(choices)), min_size=1, max_size=3))
    }
    mode = draw(st.sampled_from(["scale", "relax", "raise"]))
    space = draw(st.sampled_from(["joint", "twist"]))
    layered = draw(st.booleans())
    try:
        made = qt.TwistTask(
            "tool", "site", DEBURRING.projector,
            **{k: odd[k] for k in ("gain", "max_linear_step") if k in odd},
        )  # fmt: skip
        target = DEBURRING.waypoints[0]
        if "position" in odd:
            target = pose(target.rotation(), np.array(odd["position"]))
        made.set_target(target, odd.get("twist"))
        posture = mink.PostureTask(MODEL, cost=odd.get("cost", 0.1))
        posture.set_target(np.array(odd.get("posture", DEBURRING.start)))
        speed = odd.get("limit", 1.0)
        controller = qt.Controller(
            MODEL,
            **({"levels": [[made], [posture]]} if layered else {"tasks": [made, posture]}),
            secondary=[qt.JointCentering(MODEL, gain=odd.get("h", 0.1))],
            secondary_space=space,
            limits=[
                qt.PositionLimit(MODEL),
                mink.VelocityLimit(MODEL, {MODEL.joint(i).name: speed for i in range(6)}),
            ],
            on_infeasible=mode,
            metric=odd.get("metric"),
        )
        for name in ("joint_weight", "singularity"):
            if name in odd:
                setattr(controller, name, odd[name])
        if "free_linear_cost" in odd:
            controller.free_twist_costs = odd["free_linear_cost"], 1.0
        q = np.array(odd.get("q", DEBURRING.start))
        with np.errstate(all="ignore"):  # MuJoCo's kinematics of 1e300 rad are mink's affair
            configuration = mink.Configuration(MODEL, q)
        step = controller.step(configuration, odd.get("dt", 0.1), velocity=odd.get("velocity"))
    except mink.MinkError as error:
        assert str(error).strip()
        assert len(str(error)) < 1500
        return
    assert np.isfinite(step.velocity).all()
    assert 0.0 <= step.scale <= 1.0
    assert (step.velocity >= step.problem.lower[:6]).all()
    assert (step.velocity <= step.problem.upper[:6]).all()
    assert all(np.isfinite(left).all() for left in step.residuals)


@given(st.data())
@settings(max_examples=60)
def test_solve_levels_takes_any_numbers_or_says_why_not(data: st.DataObject) -> None:
    draw = data.draw
    n = draw(st.integers(1, 4))
    numbers = st.one_of(st.floats(-3.0, 3.0), FLOATS)

    def array(*shape: int) -> np.ndarray[Any, Any]:
        values = draw(st.lists(numbers, min_size=math.prod(shape), max_size=math.prod(shape)))
        return np.array(values).reshape(shape)

    given_levels = []
    for _ in range(draw(st.integers(1, 3))):
        m, k = draw(st.integers(0, 3)), draw(st.integers(0, 2))
        given_levels.append((array(m, n), array(m), array(k, n), array(k)))
    lower, upper = np.sort([array(n), array(n)], axis=0)
    mode = draw(st.sampled_from(["scale", "relax", "raise"]))
    try:
        solution = qt.solve_levels(
            given_levels, lower, upper, on_infeasible=mode, reference=array(n)
        )
    except qt.QpTwistError as error:
        assert str(error).strip()
        return
    assert np.isfinite(solution.x).all()
    assert (solution.x >= np.minimum(lower, 1e12)).all()
    assert (solution.x <= np.maximum(upper, -1e12)).all()
    assert 0.0 <= solution.scale <= 1.0


def test_a_message_names_what_was_called_and_not_what_it_calls() -> None:
    """``check_trajectory`` said ``write_trajectory``, and ``compare`` ``load_task``."""
    path_task = qt.load_task("planar_line")
    with pytest.raises(qt.InvalidInput, match=r"^trajectory: expected a Trajectory.*got ndarray"):
        qt.check_trajectory(path_task.start, path_task)
    asks: list[Callable[[Any], Any]] = [
        qt.compare, qt.load_task, lambda task: qt.study(task, out="never")
    ]  # fmt: skip
    for ask in asks:
        with pytest.raises(qt.InvalidInput, match=r"^task: expected the name of a shipped task or"):
            ask([3])

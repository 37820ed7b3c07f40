"""Junk anywhere in the public API: only documented exceptions come out, each with a sentence."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest

import qp_twist as qt
from qp_twist import closed_form

JUNK: list[Any] = [
    None, "abc", "", b"x", True, 0, -1, 1.5, float("nan"), float("inf"), 1e308, 10**400, 1 + 2j,
    [], [[]], [1, 2], [1, "a", 2], [None] * 3, [[1, 2], [3]], {}, {"a": 1}, set(), object(),
    np.zeros(3), np.full(3, np.nan), np.full(6, np.inf), np.zeros((3, 3)), np.zeros((6, 0)),
    np.array(["a", "b"]), lambda: 0, int, range(3), mink.SE3.identity(),
]  # fmt: skip

DEBURRING = qt.load_task("deburring")
PLANAR = qt.load_task("planar_line")
MODEL = DEBURRING.model
CONFIGURATION = mink.Configuration(MODEL, DEBURRING.start)
FULL = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
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
    controller = qt.Controller(**{"model": MODEL, "tasks": [task()], **options})
    return controller.step(configuration, dt)


def second(argument: str, **fixed: Any) -> Callable[[Any], Any]:
    """An objective or limit with one argument of junk, in use."""
    kind = fixed.pop("kind")
    place = fixed.pop("place", "secondary")
    return lambda junk: step(**{place: [kind(**{**fixed, argument: junk})]})


CALLS: dict[str, Callable[[Any], Any]] = {
    "Projector.plane": qt.Projector.plane,
    "Projector.line": qt.Projector.line,
    "TwistProjector(linear)": lambda x: qt.TwistProjector(linear=x, angular=qt.Projector.full()),
    "TwistProjector(frame)": lambda x: qt.TwistProjector(
        linear=qt.Projector.full(), angular=qt.Projector.full(), frame=x
    ),
    "resolved": lambda x: DEBURRING.projector.resolved(body=x),
    "task_redundancy(operational)": lambda x: qt.task_redundancy(x, FULL),
    "task_redundancy(task)": lambda x: qt.task_redundancy(FULL, x),
    "twist_error(rotation)": lambda x: qt.twist_error(x, np.zeros(3), np.eye(3), np.zeros(3), FULL),
    "twist_error(position)": lambda x: qt.twist_error(np.eye(3), x, np.eye(3), np.zeros(3), FULL),
    "twist_error(target)": lambda x: qt.twist_error(np.eye(3), np.zeros(3), x, np.zeros(3), FULL),
    "twist_error(projector)": lambda x: qt.twist_error(
        np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), x
    ),
    "rmr(jacobian)": lambda x: closed_form.resolved_motion_rate(x, TWIST),
    "rmr(twist)": lambda x: closed_form.resolved_motion_rate(J, x),
    "minimum_norm(projector)": lambda x: closed_form.minimum_norm(J, x, TWIST),
    "gradient_projection(h)": lambda x: closed_form.gradient_projection(J, FULL, TWIST, x),
    "twa(jacobian)": lambda x: closed_form.twa(x, FULL, TWIST, WISH),
    "twa(operational)": lambda x: closed_form.twa(J, FULL, TWIST, WISH, operational=x),
    "weighted_least_norm(weight)": lambda x: closed_form.weighted_least_norm(J, FULL, TWIST, x),
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
        J, FULL, x, -WISH, WISH, optimal=True
    ),
    "sns(lower)": lambda x: closed_form.saturation_in_null_space(J, FULL, TWIST, x, WISH),
    "sns(upper)": lambda x: closed_form.saturation_in_null_space(
        J, FULL, TWIST, -WISH, x, optimal=True
    ),
    "TwistTask(frame_name)": lambda x: step(tasks=[task(frame_name=x)]),
    "TwistTask(frame_type)": lambda x: step(tasks=[task(frame_type=x)]),
    "TwistTask(projector)": lambda x: task(projector=x),
    "TwistTask(gain)": lambda x: step(tasks=[task(gain=x)]),
    "TwistTask(max_linear_step)": lambda x: step(tasks=[task(max_linear_step=x)]),
    "TwistTask(linear_cost)": lambda x: task(linear_cost=x),
    "set_target": lambda x: task().set_target(x),
    "set_target(twist)": lambda x: task().set_target(DEBURRING.waypoints[0], x),
    "set_target_from_configuration": lambda x: task().set_target_from_configuration(x),
    "set_dt": lambda x: task().set_dt(x),
    "compute_error": lambda x: task().compute_error(x),
    "velocity_rows(dt)": lambda x: task().velocity_rows(CONFIGURATION, x),
    "FreeTwistCost(task)": qt.FreeTwistCost,
    "FreeTwistCost(objectives)": lambda x: qt.FreeTwistCost(task(), x),
    "JointCentering(model)": second("model", kind=qt.JointCentering),
    "JointCentering(weight)": second("weight", kind=qt.JointCentering, model=MODEL),
    "JointCentering(gain)": second("gain", kind=qt.JointCentering, model=MODEL),
    "PostureReference(q_ref)": second("q_ref", kind=qt.PostureReference, model=MODEL),
    "Manipulability(task)": second("task", kind=qt.Manipulability, model=MODEL),
    "JointRanges.of": qt.JointRanges.of,
    "JointRanges.positions": qt.JointRanges.of(MODEL).positions,
    "PositionLimit(model)": qt.PositionLimit,
    "PositionLimit(recovery_speed)": second(
        "recovery_speed", kind=qt.PositionLimit, model=MODEL, place="limits"
    ),
    "MotionLimit(velocity)": second("velocity", kind=qt.MotionLimit, model=MODEL, place="limits"),
    "MotionLimit(acceleration)": second(
        "acceleration", kind=qt.MotionLimit, model=MODEL, place="limits"
    ),
    "MotionLimit.note": qt.MotionLimit(MODEL).note,
    "DisplacementWindow(q_ref)": second(
        "q_ref", kind=qt.DisplacementWindow, model=MODEL, half_width=np.ones(6), place="limits"
    ),
    "DisplacementWindow(half_width)": second(
        "half_width", kind=qt.DisplacementWindow, model=MODEL, q_ref=WISH, place="limits"
    ),
    "Controller(model)": lambda x: step(model=x),
    "Controller(tasks)": lambda x: step(tasks=x),
    "Controller(tasks=[…])": lambda x: step(tasks=[x]),
    "Controller(secondary)": lambda x: step(secondary=x),
    "Controller(secondary=[…])": lambda x: step(secondary=[x]),
    "Controller(secondary_space)": lambda x: step(secondary_space=x),
    "Controller(limits)": lambda x: step(limits=x),
    "Controller(limits=[…])": lambda x: step(limits=[x]),
    "Controller(solver)": lambda x: step(solver=x),
    "Controller(on_infeasible)": lambda x: step(on_infeasible=x),
    "Controller(metric)": lambda x: step(metric=x),
    "Controller(joint_weight)": lambda x: step(joint_weight=x),
    "Controller(free_linear_cost)": lambda x: step(free_linear_cost=x, secondary_space="twist"),
    "step(configuration)": lambda x: step(configuration=x),
    "step(dt)": lambda x: step(dt=x),
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
        if isinstance(result, qt.Step):
            assert np.isfinite(result.velocity).all(), junk
            assert 0.0 <= result.scale <= 1.0, junk

"""The example of a closed loop: against kinematics and lags, statistics of noise, pushes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from oracles.arms import planar_arm
from scipy.linalg import expm
from simulated_robot import ClosedLoop, Push, Record, Servos, TimedPath

import qp_twist as qt

Array = np.ndarray
PATH = qt.load_task("deburring")


def controlled(gain: float = 0.1, **options: Any) -> tuple[qt.TwistTask, qt.Controller]:
    task = qt.TwistTask("tool", "site", PATH.projector, gain=gain)
    task.set_target(PATH.waypoints[0])
    return task, qt.Controller(PATH.model, [task], **options)


def resting(plant: Servos, feedback: str = "integrated", **options: Any) -> ClosedLoop:
    return ClosedLoop(controlled()[1], plant, PATH.start, feedback=feedback, **options)  # type: ignore[arg-type]


def pendulum(timestep: float = 0.001) -> mujoco.MjModel:
    """One hinge about the vertical: gravity does nothing to it."""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{timestep}"/><worldbody>'
        '<body name="arm"><joint name="j" axis="0 0 1" range="-3 3"/>'
        '<geom type="capsule" size="0.03" fromto="0 0 0 0.5 0 0" mass="2"/>'
        '<site name="tip" pos="0.5 0 0"/></body></worldbody></mujoco>'
    )


def turn(plant: Any, velocity: Callable[[float], float], seconds: float) -> Array:
    """Time, true position and true velocity of the pendulum under a commanded velocity."""
    steps, h, position = round(seconds / plant.timestep), plant.timestep, 0.0
    rows = []
    for k in range(steps):
        speed = velocity(k * h)
        position += speed * h
        plant.advance(np.array([position]), np.array([speed]))
        rows.append(((k + 1) * h, position, plant.data.qpos[0], plant.data.qvel[0]))
    return np.array(rows).T


# ---------------------------------------------------------------- the dynamics


@pytest.mark.parametrize(("lag", "bandwidth"), [(0.05, 2000.0), (0.0, 4.0), (0.03, 8.0)])
def test_a_velocity_servo_stays_behind_by_speed_times_delay(lag: float, bandwidth: float) -> None:
    servos = Servos(pendulum(), "velocity", lag=lag, bandwidth=bandwidth)
    _, commanded, true, _ = turn(servos, lambda _: 0.4, 1.5)
    delay = lag + 1.0 / (2.0 * np.pi * bandwidth)
    # A command that changes in steps of h comes h/2 early or late.
    assert commanded[-1] - true[-1] == pytest.approx(0.4 * delay, abs=0.4 * servos.timestep)
    assert servos.delay == pytest.approx(delay)


@pytest.mark.parametrize("feedforward", [0.0, 0.6, 1.0])
def test_a_position_servo_stays_behind_by_what_it_is_not_told(feedforward: float) -> None:
    servos = Servos(
        pendulum(timestep=4e-4), bandwidth=5.0, damping_ratio=0.7, feedforward=feedforward, lag=0.02
    )
    _, commanded, true, _ = turn(servos, lambda _: 0.3, 1.2)
    delay = 0.02 + 1.4 * (1.0 - feedforward) / (10.0 * np.pi)
    assert commanded[-1] - true[-1] == pytest.approx(0.3 * delay, abs=0.6 * servos.timestep)
    assert servos.delay == pytest.approx(delay)


def test_a_position_servo_steps_like_the_second_order_system_that_it_states() -> None:
    servos = Servos(pendulum(timestep=2e-4), "position", bandwidth=3.0, damping_ratio=0.5)
    omega = 6.0 * np.pi
    A = np.array([[0.0, 1.0], [-(omega**2), -omega]])
    for steps in (200, 600, 1000):
        servos.start(np.array([0.2]))
        for _ in range(steps):
            servos.advance(np.array([0.7]), np.zeros(1))
        expected = 0.7 + (expm(A * steps * 2e-4) @ [-0.5, 0.0])[0]
        assert servos.data.qpos[0] == pytest.approx(expected, abs=2e-3)


# ---------------------------------------------------------------- the loop


@pytest.mark.parametrize("feedback", ["integrated", "measured", "blended"])
def test_stiff_servos_without_lag_and_noise_do_what_the_kinematics_do(feedback: str) -> None:
    # The velocity is held over a period: true and integrated positions agree at its end.
    stiff = Servos(PATH.model, "velocity", bandwidth=5000.0, timestep=0.001)
    task, controller = controlled(gain=0.5)
    path = TimedPath(task, PATH.waypoints[:6], PATH.durations[:6])
    record = ClosedLoop(controller, stiff, PATH.start, feedback=feedback).run(0.25, path)  # type: ignore[arg-type]
    configuration = mink.Configuration(PATH.model, PATH.start)
    task, controller = controlled(gain=0.5)
    path = TimedPath(task, PATH.waypoints[:6], PATH.durations[:6])
    for i in range(25):
        assert record.q[i] == pytest.approx(configuration.q, abs=1e-4)
        path(0.01 * i)
        configuration.integrate_inplace(controller.step(configuration, 0.01).velocity, 0.01)
    assert np.abs(record.q[-1] - PATH.start).max() > 0.01


def pushed(kind: str, feedback: str) -> Record:
    servos = Servos(PATH.model, kind)  # type: ignore[arg-type]
    loop = resting(servos, feedback)
    return loop.run(1.0, pushes=[Push("link_6", force=(0.0, 0.0, -300.0), start=0.3)])


def test_a_push_is_noticed_by_the_feedback_that_looks() -> None:
    records = {
        (kind, feedback): pushed(kind, feedback)
        for kind in ("position", "velocity")
        for feedback in ("integrated", "measured", "blended")
        if (kind, feedback) != ("position", "blended")
    }
    time = records["position", "integrated"].time
    before, after_start = (time > 0.25) & (time < 0.3), time > 0.35
    for (_, feedback), record in records.items():
        assert record.position_error[before].max() < 2e-3
        assert record.position_error.max() > 1e-2
        commanded = np.abs(record.command[after_start]).max()
        assert (commanded < 1e-3) if feedback == "integrated" else (commanded > 1e-2)
    after = {case: record.position_error[-1] for case, record in records.items()}
    assert after["position", "integrated"] < 1e-4  # the spring brings it back
    assert after["velocity", "integrated"] > 0.05  # nothing does
    assert after["velocity", "measured"] < 1e-3
    assert after["velocity", "blended"] < 1e-2


@pytest.mark.parametrize("on_infeasible", ["scale", "raise"])
def test_an_infeasible_step_does_not_stop_the_loop(on_infeasible: str) -> None:
    arm = planar_arm([0.5, 0.5])
    task = qt.TwistTask(
        "tip",
        "site",
        qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none()),
        gain=0.1,
    )
    limits = [qt.PositionLimit(arm), mink.VelocityLimit(arm, {"joint_1": 0.2, "joint_2": 0.2})]
    controller = qt.Controller(arm, [task], limits=limits, on_infeasible=on_infeasible)  # type: ignore[arg-type]
    start = np.array([0.3, 0.8])
    task.set_target_from_configuration(mink.Configuration(arm, start))
    rest = task.target
    assert rest is not None
    away = mink.SE3.from_translation(np.array([-0.4, 0.5, 0.0]))
    loop = ClosedLoop(controller, Servos(arm, "velocity"), start, feedback="measured")

    def target(time: float) -> None:
        task.set_target(away if 0.1 <= time < 0.2 else rest)

    record = loop.run(0.4, target)
    assert len(record.time) == 40
    during = (record.time > 0.095) & (record.time < 0.195)
    assert (record.scale[during] < 1.0).all()
    assert record.position_error[-1] < record.position_error[during].max()
    if on_infeasible == "raise":
        assert [s is None for s in record.statuses] == list(during)
        assert (record.command[during] == 0.0).all()
        assert record.count()["NO_STEP"] == 10 == len(record.failures)
        assert all("joint_" in text for text in record.failures.values())
    else:
        assert record.count()["SCALED"] >= 10
        assert np.abs(record.command).max() == pytest.approx(0.2)


# ---------------------------------------------------------------- the page


def test_the_pages_tables_are_what_the_benchmark_measures_and_say_what_the_text_says() -> None:
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "streaming.md").read_text("utf-8")

    def rows_of(name: str) -> list[list[str]]:
        lines = (
            (docs / "generated" / "benchmarks" / f"closed_loop_{name}.md")
            .read_text("utf-8")
            .splitlines()
        )
        assert f"{{include}} generated/benchmarks/closed_loop_{name}.md" in page
        return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]

    run = {tuple(cells[:3]): [float(v) for v in cells[3:]] for cells in rows_of("run")}
    # Error v D of the integrated velocity servos, v (D − dt/2) / k of the measured position ones.
    for lag, velocity, position in (("0", 8.0, 15.9), ("20", 28.0, 35.9)):
        row = run["velocity", lag, "integrated"]
        assert row[0] == pytest.approx(0.05 * velocity, rel=0.2)
        assert run["position", lag, "measured"][1] == pytest.approx(
            0.05 * (position - 5.0) / 0.1, rel=0.1
        )
        assert run["position", lag, "integrated"][0] < run["position", lag, "blended"][0]
        assert run["position", lag, "blended"][0] < run["position", lag, "measured"][0]
        assert run["velocity", lag, "measured"][0] < row[0] / 4.0
        assert run["velocity", lag, "blended"][4] < run["velocity", lag, "measured"][4]
    assert rows_of("disturbances") and rows_of("limits")
    plants = [
        Servos(PATH.model, "position", lag=0.02),
        Servos(PATH.model, "position", lag=0.02, feedforward=1.0),
        Servos(PATH.model, "velocity", lag=0.02),
    ]
    assert "that is {:.0f}, {:.0f} and {:.0f} ms".format(*(1e3 * p.delay for p in plants)) in page
    assert f"{PATH.model.body_mass[3:].sum():.0f} kg from the turret on" in page
    # A cell of the table, measured again.
    plant = plants[2]
    task, _ = controlled()
    names = qt.JointRanges.of(PATH.model).names
    speeds = dict(zip(names, PATH.velocity_limits, strict=True))
    limits = [qt.PositionLimit(PATH.model), mink.VelocityLimit(PATH.model, speeds)]
    controller = qt.Controller(PATH.model, [task], limits=limits)
    loop = ClosedLoop(controller, plant, PATH.start, feedback="measured", noise=5e-4)
    record = loop.run(3.0, TimedPath(task, PATH.waypoints, PATH.durations, start=1.0))
    [kept] = [c[3] for c in rows_of("gains") if c[:2] == ["velocity", "measured"]]
    error = 1e3 * record.summary(since=1.5)["position_error_rms"]
    assert error == pytest.approx(float(kept.split()[0]), rel=0.02)

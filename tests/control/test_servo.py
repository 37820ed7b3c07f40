"""A controller that is fed by a stream: what it follows, how it stops, what it refuses."""

import threading
from collections.abc import Callable
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.twists import SPATIAL, at, pose, site, twists
from oracles.walks import reversals

import qp_twist as qt
from qp_twist.control import ServoState, Tick
from qp_twist.control.target_stream import moved, twist_between
from qp_twist.shipped import shipped_folder

Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)
DT = 0.005
DEBURRING = qt.load_task("deburring")
REST = np.zeros(6)
STREAMS: dict[str, Callable[[Any, float], object]] = {
    "track": lambda rig, t: rig.servo.track(rig.shifted(0.05 * t)),
    "jog": lambda rig, t: rig.servo.jog([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]),
    "move": lambda rig, t: rig.servo.move(np.full(6, 0.3)),
}


class Rig:
    """An arm that does what the servo commands, and a clock."""

    def __init__(
        self,
        *,
        velocity: float = 1.5,
        acceleration: Any = "default",
        model: mujoco.MjModel = DEBURRING.model,
        tasks: list[qt.TwistTask] | None = None,
        q: Array = DEBURRING.start,
        limits: list[mink.Limit] = [],  # noqa: B006
        period: float = DT,
        on_infeasible: Any = "scale",
        secondary: Any = (),
        **options: Any,
    ) -> None:
        self.now, self.period, self.model = 0.0, period, model
        self.tasks = tasks or [qt.TwistTask("tool", "site", DEBURRING.projector)]
        self.task = self.tasks[0]
        motion = qt.MotionLimit(model, velocity=velocity, acceleration=acceleration)
        self.controller = qt.Controller(
            model, self.tasks, limits=[motion, *limits], on_infeasible=on_infeasible,
            secondary=list(secondary),
        )  # fmt: skip
        self.configuration = mink.Configuration(model, q)
        self.servo = qt.Servo(
            self.controller, self.configuration, period=period, clock=lambda: self.now, **options
        )
        self.start = self.pose()

    def pose(self) -> mink.SE3:
        return site(self.configuration, self.task.frame_name)

    def shifted(self, x: float, y: float = 0.0, z: float = 0.0) -> mink.SE3:
        return at(x, y, z) @ self.start

    def went(self) -> Array:
        return self.pose().translation() - self.start.translation()

    def tick(self) -> Tick:
        tick = self.servo.tick()
        self.configuration.integrate_inplace(tick.velocity, self.period)
        self.now += self.period
        return tick

    def run(self, seconds: float, feed: Callable[[float], object] = lambda _: None) -> list[Tick]:
        ticks = []
        for _ in range(round(seconds / self.period)):
            feed(self.now)
            ticks.append(self.tick())
        return ticks

    def off(self, target: mink.SE3) -> float:
        return float(np.linalg.norm(self.pose().translation() - target.translation()))


def fastest(ticks: list[Tick]) -> float:
    return float(np.abs([tick.velocity for tick in ticks]).max())


def accelerations(ticks: list[Tick]) -> Array:
    return np.abs(np.diff([tick.velocity for tick in ticks], axis=0)) / DT


# ---------------------------------------------------------------- the reference


@given(SEEDS)
def test_a_twist_between_poses_is_minks_and_takes_the_one_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (
        pose(mink.SO3.from_rpy_radians(*rng.uniform(-3.0, 3.0, 3)), rng.normal(size=3))
        for _ in range(2)
    )
    twist = twist_between(one.wxyz_xyz, other.wxyz_xyz)
    np.testing.assert_allclose(twist[:3], other.translation() - one.translation(), atol=1e-12)
    turn = (other.rotation() @ one.rotation().inverse()).log()
    np.testing.assert_allclose(twist[3:], turn, atol=1e-7)
    there = mink.SE3(moved(moved(one.wxyz_xyz, twist, 0.3), twist, 0.7))
    np.testing.assert_allclose(there.as_matrix(), other.as_matrix(), atol=1e-9)


def test_poses_at_every_tick_are_followed_as_they_are() -> None:
    rig = Rig()
    for k in range(200):
        target = rig.shifted(0.05 * np.sin(0.02 * k), 0.0, 0.02 * np.sin(0.03 * k))
        rig.servo.track(target)
        tick = rig.tick()
        if k > 20:
            assert tick.state is ServoState.TRACKING
            assert rig.off(target) < 1e-5


@pytest.mark.parametrize("every", [3, 13])
def test_rare_poses_are_followed_smoothly_with_a_lag_of_about_their_spacing(every: int) -> None:
    rig = Rig()
    velocities, lag = [], 0.0
    for k in range(400):
        if k % every == 0:
            rig.servo.track(rig.shifted(0.06 * np.sin(2.0 * rig.now)))
        velocities.append(rig.tick().velocity)
        if k > 100:
            lag = max(lag, rig.off(rig.shifted(0.06 * np.sin(2.0 * rig.now))))
    assert lag < 0.12 * 2.2 * every * DT  # largest speed 0.12 m/s
    jumps = np.abs(np.diff(np.array(velocities)[100:], axis=0)).max()
    # Followed at once, each pose would be a burst of `every` times the speed.
    assert jumps < 0.5 * np.abs(velocities).max()


def test_a_pose_with_its_velocity_is_followed_without_lag() -> None:
    rig = Rig()
    for k in range(300):
        if k % 8 == 0:
            velocity = [0.12 * np.cos(2.0 * rig.now), 0.0, 0.0, 0.0, 0.0, 0.0]
            rig.servo.track(rig.shifted(0.06 * np.sin(2.0 * rig.now)), velocity)
        rig.tick()
        if k > 150:
            assert rig.off(rig.shifted(0.06 * np.sin(2.0 * rig.now))) < 1e-3


# ---------------------------------------------------------------- stopping


@pytest.mark.parametrize("how", STREAMS)
def test_where_the_stream_ceases_the_arm_is_at_rest_within_the_stated_time(how: str) -> None:
    rig = Rig(secondary=[qt.JointCentering(DEBURRING.model, gain=0.02)])
    assert np.abs(rig.run(0.5, lambda t: STREAMS[how](rig, t))[-1].velocity).max() > 0.02
    servo = rig.servo
    stopping = rig.run(servo.stale_after + servo.stop_within + 2 * DT)
    assert stopping[-1].state is ServoState.HOLDING
    speeds = np.array([np.linalg.norm(tick.velocity) for tick in stopping])
    assert speeds[-1] < 1e-9
    ceased = speeds[[tick.state is ServoState.STOPPING for tick in stopping]]
    assert len(ceased) >= round(servo.stop_within / DT) - 2
    # It slows down steadily: no tick takes more than its share of the speed, but for curvature.
    assert np.abs(np.diff(ceased)).max() < 2.5 * max(ceased) * DT / servo.stop_within
    at_rest = rig.configuration.q.copy()
    rig.run(0.5)
    np.testing.assert_allclose(rig.configuration.q, at_rest, atol=1e-9)


def test_a_secondary_fades_in_with_a_stream_and_out_where_it_ceases() -> None:
    """What moves in the null space is the share of q̇ = (1 − A†A) h/dt, from 0 to 1 within T."""
    centering = qt.JointCentering(DEBURRING.model, gain=2e-4)
    rig = Rig(secondary=[centering], stop_within=0.2)
    here, shares = rig.pose(), []
    for k in range(300):
        if k < 150:
            rig.servo.track(here)
        state = rig.task.state(rig.configuration)
        A = state.basis.T @ state.jacobian
        free = np.eye(6) - np.linalg.pinv(A) @ A
        whole = free @ centering.displacement(rig.configuration) / DT
        moving = free @ rig.tick().velocity
        shares.append(float(moving @ whole / (whole @ whole)))
        np.testing.assert_allclose(moving, shares[-1] * whole, atol=1e-9)
    ceases = int(np.flatnonzero(np.diff(shares) < -1e-6)[0]) + 1
    assert abs(ceases - 149 - round(rig.servo.stale_after / DT)) <= 1
    along = DT / 0.2 * np.arange(1, 301)
    np.testing.assert_allclose(shares[:ceases], np.minimum(1.0, along[:ceases]), atol=1e-6)
    fading = np.maximum(0.0, 1.0 - along[: 300 - ceases])
    np.testing.assert_allclose(shares[ceases:], fading, atol=1e-6)


def test_one_arm_goes_on_while_the_other_stops() -> None:
    model = mujoco.MjModel.from_xml_path(str(shipped_folder("scenes") / "two_arms.xml"))
    q = np.array([0.0, 0.1, 0.0, -1.5, 0.0, 0.8, 0.0, 0.0, 0.3, 0.0, -1.7, 0.0, -1.2, 0.0])
    tasks = [qt.TwistTask.axis_free(f"{side}_tool", "site") for side in ("left", "right")]
    rig, up, places = Rig(model=model, tasks=tasks, q=q), [0, 0, 0.05, 0, 0, 0], []
    for k in range(300):
        for task in tasks if k < 100 else tasks[1:]:
            rig.servo.jog(up, task=task)
        rig.tick()
        places.append([site(rig.configuration, t.frame_name).translation()[2] for t in tasks])
    speeds = np.diff(places, axis=0)[-50:] / DT
    np.testing.assert_allclose(speeds[:, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(speeds[:, 1], 0.05, rtol=1e-3)
    with pytest.raises(qt.InvalidInput, match="2 tasks with a target pose; name one"):
        rig.servo.jog(REST)


def test_where_no_step_is_found_the_joints_are_brought_to_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig()

    def jog(_: float) -> None:
        rig.servo.jog([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])

    def fails(*_: object, **__: object) -> None:
        raise qt.InfeasibleStep("infeasible step: for a test", None)

    moving = rig.run(0.5, jog)
    assert moving[-1].state is ServoState.TRACKING
    monkeypatch.setattr(rig.controller, "step", fails)
    ticks = rig.run(0.5, jog)
    assert {tick.state for tick in ticks} == {ServoState.BLOCKED}
    assert "infeasible step: for a test" in ticks[-1].message
    assert not ticks[-1].velocity.any()
    speeds = [np.abs(tick.velocity).max() for tick in (moving[-1], *ticks)]
    # Linear over stop_within, 0.25 s.
    assert max(-np.diff(speeds)) < 1.1 * speeds[0] * DT / 0.25
    monkeypatch.undo()
    again = rig.run(0.5, jog)  # and then it goes on, from where the arm is
    assert again[-1].state is ServoState.TRACKING
    assert DT * accelerations(again).max() < 0.2 * np.abs(again[-1].velocity).max()


@pytest.mark.any_blas
def test_inputs_of_other_threads_disturb_no_tick() -> None:
    rig = Rig()
    stop = threading.Event()

    def feed() -> None:
        while not stop.is_set():
            rig.servo.track(rig.shifted(0.01))
            rig.servo.jog(REST)

    threads = [threading.Thread(target=feed) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        ticks = rig.run(2.0)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert ServoState.BLOCKED not in {tick.state for tick in ticks}
    # A jog at rest carries on from the smoothed velocity of the poses: by another 10 mm at most.
    assert np.linalg.norm(rig.went()) < 0.025
    rig.run(1.0, lambda t: rig.servo.track(rig.shifted(0.01)))
    assert rig.off(rig.shifted(0.01)) < 1e-5


@pytest.mark.parametrize("on_infeasible", ["scale", "relax"])
def test_the_reference_waits_for_an_arm_that_cannot_follow(on_infeasible: str) -> None:
    rig = Rig(velocity=0.05, on_infeasible=on_infeasible)
    # A stream that is much faster than the arm, and comes back.
    rig.run(0.5, lambda t: rig.servo.track(rig.shifted(0.4 * t)))
    assert rig.tick().state is ServoState.SLOWED
    ahead = rig.task.target.translation() - rig.pose().translation()
    assert np.linalg.norm(ahead) < 0.05 + 0.4 * DT + 1e-3  # `jump`
    rig.run(3.0, lambda t: rig.servo.track(rig.start))
    assert rig.off(rig.start) < 1e-5


# ---------------------------------------------------------------- what is refused or approached


def test_a_far_target_is_approached_at_the_set_speed() -> None:
    rig = Rig(approach_speed=(0.1, 0.5))
    far, places, states = rig.shifted(0.0, 0.15, 0.1), [rig.start.translation()], set()
    for _ in range(700):
        rig.servo.track(far)
        states.add(rig.tick().state)
        places.append(rig.pose().translation())
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() / DT < 0.1 * 1.001
    assert ServoState.APPROACHING in states
    assert rig.off(far) < 1e-6
    assert rig.tick().state is ServoState.TRACKING


def test_what_is_not_finite_is_refused_and_changes_nothing() -> None:
    rig = Rig()
    rig.servo.track(rig.shifted(0.01))
    bad = mink.SE3(np.array([1.0, 0.0, 0.0, 0.0, np.nan, 0.0, 0.0]))
    other = qt.TwistTask("tool", "site", DEBURRING.projector)
    for ask, error, sentence in (
        (lambda: rig.servo.track(bad), qt.InvalidTarget, "entry 4 is nan"),
        (lambda: rig.servo.track([0.0] * 7), qt.InvalidTarget, r"must be a mink\.SE3, got list"),
        (lambda: rig.servo.jog([np.nan] * 6), qt.InvalidTarget, "entry 0 is nan"),
        (lambda: rig.servo.move(np.zeros(5)), qt.InvalidInput, r"shape \(6\), got \(5,\)"),
        (lambda: rig.servo.jog(REST, task=other), qt.InvalidInput, "one of the controller's"),
    ):
        with pytest.raises(error, match=sentence):
            ask()
    rig.run(0.09)
    assert rig.off(rig.shifted(0.01)) < 5e-3  # still on its way to the good one


def test_old_late_and_future_inputs_are_counted_and_left_out() -> None:
    rig = Rig()
    rig.run(0.5)
    assert rig.servo.track(rig.shifted(0.01), at=rig.now)
    assert not rig.servo.track(rig.shifted(0.04), at=rig.now - 0.02)
    assert not rig.servo.track(rig.shifted(0.04), at=rig.now - 0.2)
    assert not rig.servo.jog(np.ones(6), at=rig.now + 10.0)
    assert rig.servo.refused == {"older than the last": 1, "out of date": 1, "of the future": 1}
    rig.run(0.05)
    assert rig.off(rig.shifted(0.01)) < 0.01


def test_jogging_along_the_axes_of_the_tool() -> None:
    rig = Rig()
    axis = rig.pose().rotation().as_matrix()[:, 2]
    rig.run(1.0, lambda t: rig.servo.jog([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], axes="tool"))
    assert rig.went() @ axis == pytest.approx(np.linalg.norm(rig.went()), rel=1e-4)
    assert 0.04 < rig.went() @ axis < 0.05  # it takes a while to be at speed


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"period": 0.0}, "period: "),
        ({"period": 0.01, "stale_after": 0.001}, "stale_after: "),
        ({"jump": (0.1,)}, r"jump: expected an array of shape \(2\)"),
        ({"approach_speed": (0.1, -1.0)}, "approach_speed: expected two numbers above 0"),
        ({"clock": 3.0}, "clock: expected a function that returns seconds"),
        ({"stop_within": 0.1}, r"needs 0.15 s to stop .* Give stop_within=0.15 or more"),
    ],
)
def test_settings_that_cannot_be_are_refused(options: dict, said: str) -> None:
    rig = Rig(acceleration=10.0)
    with pytest.raises(qt.InvalidInput, match=said):
        qt.Servo(rig.controller, rig.configuration, **options)


# ---------------------------------------------------------------- clocks


CLOCKS = {
    "goes back by 1 s": lambda t: t if t < 1.0 else t - 1.0,
    "goes back to 0 and on": lambda t: t % 1.0,
    "goes back by half of stale_after": lambda t: t if t < 1.0 else t - 0.05,
    "goes back at every tick": lambda t: t if t < 1.0 else 2.0 - t,
    "stops": lambda t: min(t, 1.0),
    "is NaN once": lambda t: float("nan") if abs(t - 1.0) < 0.5 * DT else t,
    "is NaN from then on": lambda t: t if t < 1.0 else float("nan"),
    "jumps ahead": lambda t: t if t < 1.0 else t + 1e6,
}


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize(("how", "stops"), [("track", False), ("jog", True), ("move", False)])
def test_whatever_the_clock_does_the_arm_stops_when_the_inputs_cease_or_stop(
    clock: str, how: str, stops: bool
) -> None:
    rig, ticks = Rig(velocity=1.0, acceleration=10.0), []
    for k in range(400):
        t = k * DT
        rig.now = CLOCKS[clock](t)
        if t < 1.0:
            assert STREAMS[how](rig, t)
        elif stops:
            assert rig.servo.jog(REST)
        ticks.append(rig.tick())
    assert accelerations(ticks).max() < 10.0 * (1.0 + 1e-6)
    # A clock that stands still may be a coarse one: it is waited for as long as for a target.
    patience = rig.servo.stale_after if clock == "stops" else 0.0
    # Jogging takes up what is asked for, a stop too, within stop_within but for e⁻⁴.
    within = rig.servo.stop_within + (0.05 if stops else patience + 0.1)
    late = ticks[round((1.0 + within) / DT) + 2 :]
    assert fastest(late) <= (np.exp(-4.0) if stops else 1e-9) * fastest(ticks[199:200])
    assert stops or {tick.state for tick in late} == {ServoState.HOLDING}


@pytest.mark.parametrize("clock", ["goes back by 1 s", "goes back to 0 and on", "is NaN once"])
def test_a_stream_is_followed_on_whatever_the_clock_does(clock: str) -> None:
    rig, ticks = Rig(velocity=1.0, acceleration=10.0), []
    for k in range(400):
        rig.now = CLOCKS[clock](k * DT)
        if k % 8 == 0:
            assert rig.servo.track(rig.shifted(0.04 * np.sin(2.0 * k * DT)))
        ticks.append(rig.tick())
    assert not rig.servo.refused
    assert {tick.state for tick in ticks} == {ServoState.TRACKING}
    assert accelerations(ticks).max() < 10.0 * (1.0 + 1e-6)


# ---------------------------------------------------------------- singularities


def straight_wrist() -> mujoco.MjModel:
    """An arm whose wrist is straight in its zero posture, well inside its reach."""
    places = ["0 0 .36", ".12 0 .1", "0 0 .5", ".1 0 .06", ".42 0 0", ".09 0 0"]
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"]
    ranges = ["-2.9 2.9", "-1.7 2.2", "-2.4 1.6", "-3.1 3.1", "-2.1 2.1", "-6.2 6.2"]
    links = "".join(
        f'<body pos="{place}"><joint name="j{k}" axis="{axis}" range="{limits}"/>'
        '<geom size=".02" contype="0" conaffinity="0"/>'
        for k, (place, axis, limits) in enumerate(zip(places, axes, ranges, strict=True), 1)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{links}'
        f'<site name="tip" pos=".12 0 0"/>{"</body>" * 6}</worldbody></mujoco>'
    )


FREE_AXIS = twists("full", "plane", "body", axes=([0, 0, 1], [1, 0, 0]))


def jogged(
    projector: qt.TwistProjector, twist: Array, seconds: float, q: Array = REST
) -> tuple[list[Tick], Array, float]:
    """Ticks, the way of the tip, and the largest angle of its x axis, rad."""
    rig = Rig(
        model=straight_wrist(), tasks=[qt.TwistTask("tip", "site", projector)], q=q, velocity=2.0,
        acceleration=15.0,
    )  # fmt: skip
    ticks, along = [], 1.0
    for _ in range(round(seconds / DT)):
        rig.servo.jog(twist)
        ticks.append(rig.tick())
        axes = (p.rotation().as_matrix()[:, 0] for p in (rig.start, rig.pose()))
        along = min(along, float(np.dot(*axes)))
    return ticks, rig.went(), float(np.arccos(along))


@pytest.mark.parametrize(
    ("projector", "sign"), [(FREE_AXIS, 1.0), (SPATIAL, -1.0)], ids=["free axis", "all six"]
)
def test_an_arm_that_is_jogged_out_of_a_singularity_names_and_leaves_it(
    projector: qt.TwistProjector, sign: float
) -> None:
    twist = sign * np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    ticks, went, tilt = jogged(projector, twist, 6.0)
    stuck = [tick for tick in ticks if tick.state is ServoState.SINGULAR]
    assert stuck and ServoState.AT_THE_EDGE not in {tick.state for tick in ticks}
    assert stuck[0].message.startswith("singular: ") and "j4" in stuck[0].message
    assert ticks[-1].state is ServoState.TRACKING
    assert went[1] * sign > 0.1
    assert np.abs(went[[0, 2]]).max() < 1e-3
    assert tilt < 0.01
    assert reversals([tick.velocity for tick in ticks]) == 0
    assert accelerations(ticks).max() < 15.0 * (1.0 + 1e-6)
    assert accelerations(ticks[-100:]).max() < 1.0  # it moves on smoothly

"""A controller with a period, fed by a stream of targets."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import finite_array, instance, largest, number, one_of
from qp_twist.control.controller import Controller
from qp_twist.control.joint_steps import JointSteps
from qp_twist.control.newest_inputs import NewestInputs
from qp_twist.control.singular_exit import SingularExit
from qp_twist.control.step import Status
from qp_twist.control.target_stream import Fade, StreamSettings, TargetStream, beyond, error_of
from qp_twist.control.tick import STILL, ServoState, Tick, TickTimes
from qp_twist.errors import InvalidInput, InvalidTarget, QpTwistError
from qp_twist.kinematics import GazeTask, TwistTask, check_configuration, checked_pose
from qp_twist.kinematics.joint_ranges import joint_names

_NOTICEABLE = 1e-3, 1e-2
"""m and rad. Whoever is slowed for a tick while accelerating is not behind by as much."""


class Servo:
    r"""A :class:`Controller` that is called every period and fed by a stream of targets.

    Targets come when they come: poses (:meth:`track`), twists (:meth:`jog`) or joint velocities
    (:meth:`move`). Between two poses the reference is interpolated. A target further than ``jump``
    from the last is approached at a set speed. Where no target has come for ``stale_after``, the
    reference of that task is brought to rest from where the robot is, t(τ) = (1 − τ/T) t(0) with
    T = ``stop_within``; once all streams have ceased, what moves in the null space fades with it.

    The servo reads ``configuration`` and does not change it: the caller integrates the velocity, or
    updates it from measurements. Inputs may come from other threads; ticks from one. The controller
    and its tasks and limits belong to one servo.

    Attributes:
        controller: The controller; the servo sets the targets of the tasks that it is fed for.
        configuration: Where the robot is.
        refused: How many inputs were refused, by reason.
        times: Durations of the ticks.

    Example:
        >>> import mink, qp_twist as qt
        >>> path_task = qt.load_task("deburring")
        >>> task = qt.TwistTask("tool", "site", path_task.projector)
        >>> controller = qt.Controller(path_task.model, [task],
        ...                            limits=[qt.MotionLimit(path_task.model, velocity=1.0)])
        >>> configuration = mink.Configuration(path_task.model, path_task.start)
        >>> servo = qt.Servo(controller, configuration, period=0.002)
        >>> servo.jog([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
        True
        >>> tick = servo.tick()
        >>> configuration.integrate_inplace(tick.velocity, servo.period)
        >>> tick.message
        'tracking the targets'
    """

    def __init__(
        self,
        controller: Controller,
        configuration: mink.Configuration,
        *,
        period: float = 0.002,
        stale_after: float = 0.1,
        stop_within: float = 0.25,
        jump: tuple[float, float] = (0.05, 0.25),
        approach_speed: tuple[float, float] = (0.25, 1.0),
        clock: Callable[[], float] | None = None,
    ) -> None:
        """Stand still until targets come. Machine code is loaded, or compiled, here.

        Args:
            controller: The controller.
            configuration: Where the robot is; the caller keeps it up to date.
            period: dt, s.
            stale_after: Age, s, from which a target counts as missing; at least a period.
            stop_within: Within this time, s, a stream that has ceased is brought to rest.
            jump: Distance in m and rad from the last target, beyond which one is approached at
                ``approach_speed`` and not followed at once.
            approach_speed: m/s and rad/s.
            clock: Time, s, in which inputs are stamped; ``time.monotonic`` if ``None``. Where it
                goes back, as that of a simulation that is reset, or returns NaN, a tick counts as
                a period.

        Raises:
            InvalidInput: If an argument has the wrong type or range, or an acceleration limit is
                too low to stop from the velocity limit within ``stop_within``.
        """
        instance("controller", controller, Controller)
        check_configuration(configuration)
        self.controller, self.configuration = controller, configuration
        period = number("period", period, above=0.0)
        self._settings = settings = StreamSettings(
            period,
            number("stale_after", stale_after, at_least=period),
            number("stop_within", stop_within, above=0.0),
            _pair("jump", jump),
            _pair("approach_speed", approach_speed),
        )
        if clock is not None and not callable(clock):
            raise InvalidInput(f"clock: expected a function that returns seconds, got {clock!r}.")
        self._inputs = NewestInputs(clock or time.monotonic, period, settings.stale_after)
        self.refused = self._inputs.refused
        _check_stopping(controller, settings.stop_within)
        self._velocity = np.zeros(controller.model.nv)
        tasks = [t for t in controller.twist_tasks if not isinstance(t, GazeTask)]
        if not tasks:
            raise InvalidInput(
                "Servo: the controller has no TwistTask with a target pose; add one."
            )
        self._streams = {task: TargetStream(task, settings, configuration) for task in tasks}
        self._behind = False
        self._secondary, self._exit = Fade(settings), SingularExit(controller, settings)
        self.times = TickTimes(period)
        self._by_joints = JointSteps(controller, configuration, settings)
        controller.load(configuration, period)

    @property
    def period(self) -> float:
        """dt, s."""
        return self._settings.period

    @property
    def stale_after(self) -> float:
        """Age, s, from which a target counts as missing."""
        return self._settings.stale_after

    @property
    def stop_within(self) -> float:
        """T, s."""
        return self._settings.stop_within

    @property
    def clock(self) -> Callable[[], float]:
        """Time, s, in which inputs are stamped."""
        return self._inputs.clock

    @clock.setter
    def clock(self, clock: Callable[[], float]) -> None:
        self._inputs.use(clock)

    # ------------------------------------------------------------------ inputs

    def track(
        self,
        pose: mink.SE3,
        twist: npt.ArrayLike | None = None,
        *,
        task: TwistTask | None = None,
        at: float | None = None,
    ) -> bool:
        """Take a pose as the newest target of a task.

        Args:
            pose: In the world, or in the frame that carries the target.
            twist: Velocity with which the target moves on until the next comes, along the same
                axes, m/s and rad/s, (6,); if ``None`` it is interpolated.
            task: Which task; may be left out where the controller has one.
            at: When the pose was right, s on the servo's clock; now if ``None``.

        Returns:
            Whether it was taken. One that is out of date, older than the last or of the future is
            counted in ``refused``, and the stream goes on without it.

        Raises:
            InvalidTarget: If the pose or the twist is not finite.
            InvalidInput: If the controller has no such task.
        """
        task = _chosen(self._streams, task)
        goal = np.frombuffer(checked_pose(task, pose))
        velocity = None
        if twist is not None:
            velocity = finite_array(f"{task.name} twist", twist, (6,), error=InvalidTarget)
        return self._inputs.put(task, at, pose=goal, twist=velocity)

    def jog(
        self,
        twist: npt.ArrayLike,
        *,
        axes: Literal["world", "tool"] = "world",
        task: TwistTask | None = None,
        at: float | None = None,
    ) -> bool:
        """Move a task's frame at a twist until the input is stale.

        It is the linear and angular velocity, m/s and rad/s, (6,), along the axes of the
        ``"world"``, or of the frame that carries the target, or of the ``"tool"``. Other arguments,
        result and errors are those of :meth:`track`.
        """
        task = _chosen(self._streams, task)
        moving = finite_array(f"{task.name} twist", twist, (6,), error=InvalidTarget)
        in_tool = one_of("axes", axes, ("world", "tool")) == "tool"
        return self._inputs.put(task, at, twist=moving, in_tool=in_tool)

    def move(self, velocity: npt.ArrayLike, *, at: float | None = None) -> bool:
        """Move the joints at a velocity (nv,), rad/s or m/s, inside the limits, without the tasks.

        ``at`` and result are those of :meth:`track`.

        Raises:
            InvalidInput: If the velocity is not finite.
        """
        wanted = finite_array("velocity", velocity, (self.controller.model.nv,))
        return self._inputs.put(None, at, velocity=wanted)

    def _take_inputs(self) -> None:
        for task, given in self._inputs.take().items():
            if task is None:
                self._by_joints.asked = given
                continue
            if self._by_joints.asked is not None:  # the joints have moved without the tasks
                self._by_joints.asked = None
                for stream in self._streams.values():
                    stream.stand(self.configuration)
            self._streams[task].take(given)

    # ------------------------------------------------------------------ ticks

    def tick(self) -> Tick:
        """Compute what to command for the next period.

        It raises nothing that a target, a limit or a singularity can cause: where no step is found
        the joints are brought to rest, and the tick says why.
        """
        began, worked, now = time.perf_counter(), time.thread_time(), self._inputs.tick()
        try:
            check_configuration(self.configuration)
            self._take_inputs()
            asked = self._by_joints.asked
            if asked is None or asked.velocity is None:
                tick = self._by_tasks(now)
            else:
                tick = self._by_joints.tick(asked.velocity, asked.stamp, now, self._velocity)
                self._secondary.share = 0.0
        except (QpTwistError, mink.MinkError) as error:
            tick = self._brake(now, str(error))
        self._velocity = tick.velocity
        self.times.add(time.perf_counter() - began, time.thread_time() - worked)
        return tick

    def _by_tasks(self, now: float) -> Tick:
        fresh, at_rest = False, True
        for stream in self._streams.values():
            moves = stream.advance(now, self.configuration, self._velocity, behind=self._behind)
            fresh |= moves
            at_rest &= not moves and stream.at_rest
        share, leaving = self._secondary.towards(fresh), self._exit
        step = self.controller.step(
            self.configuration,
            self.period,
            use_secondary=share * (1.0 - leaving.fade.share),
            displacement=leaving.displacement(),
        )
        self._by_joints.braking_since = None
        self._behind = step.status is not Status.SOLVED
        stuck = fresh and self._behind and _is_behind(self._streams, self.configuration)
        leaving.look(self.configuration, step if stuck else None)
        if stuck and leaving.joints:
            return Tick(step.velocity, ServoState.SINGULAR, step, exit_joints=leaving.joints)
        if stuck:
            state = ServoState.SLOWED if step.binding else ServoState.AT_THE_EDGE
        elif fresh:
            approaching = any(stream.approaching for stream in self._streams.values())
            state = ServoState.APPROACHING if approaching else ServoState.TRACKING
        elif at_rest and share == 0.0 and largest(step.velocity) < STILL:
            state = ServoState.HOLDING
        else:
            state = ServoState.STOPPING
        return Tick(step.velocity, state, step)

    def _brake(self, now: float, failure: str) -> Tick:
        """Bring the joints to rest, where no step was found."""
        self._secondary.share = 0.0
        tick = self._by_joints.brake(now, self._velocity, failure)
        self.controller.note(tick.velocity)
        if np.isfinite(self.configuration.q).all():
            for stream in self._streams.values():  # they go on from where the robot will be
                stream.wait(self.configuration)
        return tick


def _chosen(streams: Mapping[TwistTask, TargetStream], task: TwistTask | None) -> TwistTask:
    """The task that an input is for; the only one if it is not named."""
    if task is None:
        if len(streams) != 1:
            raise InvalidInput(
                f"Servo: the controller has {len(streams)} tasks with a target pose; name one by "
                "task=…."
            )
        return next(iter(streams))
    if not isinstance(task, TwistTask) or task not in streams:
        raise InvalidInput(
            f"Servo: expected as task one of the controller's with a target pose, got {task!r}."
        )
    return task


def _is_behind(tasks: Iterable[TwistTask], configuration: mink.Configuration) -> bool:
    """Whether a task is behind its reference by more than a tick of accelerating explains."""
    return any(beyond(error_of(task, configuration), _NOTICEABLE) for task in tasks)


def _pair(name: str, value: tuple[float, float]) -> tuple[float, float]:
    both = finite_array(name, value, (2,))
    if not (both > 0.0).all():
        raise InvalidInput(f"{name}: expected two numbers above 0 (linear, angular), got {value}.")
    return float(both[0]), float(both[1])


def _check_stopping(controller: Controller, within: float) -> None:
    fastest, hardest = controller.fastest, controller.hardest
    if fastest is None or hardest is None:
        return
    with np.errstate(invalid="ignore"):
        needed = fastest / hardest
    slowest = int(np.argmax(np.where(np.isfinite(needed), needed, 0.0)))
    if needed[slowest] > within:
        raise InvalidInput(
            f"Servo: {joint_names(controller.model)[slowest]} needs {needed[slowest]:.3g} s to "
            f"stop from its velocity limit at its acceleration limit; stop_within is {within:g} s. "
            f"Give stop_within={math.ceil(100.0 * needed[slowest]) / 100.0:g} or more."
        )

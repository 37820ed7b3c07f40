"""A controller closed around a simulated robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, number, one_of, whole_number
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, Servo, ServoState, Step
from qp_twist.errors import InvalidInput
from qp_twist.qp import NoSolutionFound
from qp_twist.simulation.plant import Plant
from qp_twist.simulation.push import Push
from qp_twist.simulation.record import Interval, Record, Recorder


class ClosedLoop:
    r"""A controller that commands servos at a fixed period, and its configuration estimate.

    At time :math:`t_i` the controller computes a step of length dt, the period, from the estimate
    :math:`\hat q_i`. The servos receive

    .. math::

        \dot q_i = \text{controller}(\hat q_i), \qquad
        q_i^{command} = \hat q_i + \dot q_i\,dt

    and hold this command for one period. Then

    .. math::

        \hat q_{i+1} = q_i^{command} + \beta\,(q^{measured}_{i+1} - q_i^{command}), \qquad
        q^{measured} = q^{true} + \text{noise},

    with β = 1 for ``feedback="measured"``, 0 for ``"integrated"``, and
    :math:`1-e^{-dt/T}` for ``"blended"``: a first-order filter with the time constant T that moves
    the commanded position towards the measured one.

    The first :math:`\hat q` is the start. A step without a solution does not end the loop: the
    controller then commands zero velocity for one period. Acceleration limits apply to the change
    from the previously commanded velocity, not from a measured one.

    Attributes:
        controller: The controller.
        plant: The robot and its servos.
        period: dt, s.
        feedback: How :math:`\hat q` is updated.
        configuration: The estimate :math:`\hat q`.
        time: Simulated time, s; :meth:`run` continues from there.

    Example:
        >>> import qp_twist as qt
        >>> from qp_twist.simulation import ClosedLoop, Servos
        >>> path_task = qt.load_task("deburring")
        >>> task = qt.TwistTask("tool", "site", path_task.projector, gain=0.1)
        >>> task.set_target(path_task.waypoints[0])
        >>> controller = qt.Controller(path_task.model, [task])
        >>> loop = ClosedLoop(controller, Servos(path_task.model), path_task.start)
        >>> bool(loop.run(0.5).position_error[-1] < 1e-4)
        True
    """

    def __init__(
        self,
        controller: Controller | Servo,
        plant: Plant,
        start: npt.ArrayLike,
        *,
        period: float | None = None,
        feedback: Literal["measured", "integrated", "blended"] = "integrated",
        time_constant: float = 0.1,
        noise: npt.ArrayLike = 0.0,
        seed: int = 0,
    ) -> None:
        """Close the loop, with the robot at rest.

        Args:
            controller: The controller, or a servo that is fed with targets; the servo's
                configuration becomes the estimate, and its clock the simulated time. The record
                contains the errors of the first :class:`~qp_twist.TwistTask`.
            plant: The robot and its servos, with the same joints. It is moved to ``start``. Plant
                and controller must not be used elsewhere while the loop uses them.
            start: Joint positions at time 0, rad or m, (nq,).
            period: dt, s; a multiple of the plant's time step. If ``None`` that of the servo, or
                0.01 s.
            feedback: ``"measured"``, ``"integrated"`` or ``"blended"``.
            time_constant: T of ``"blended"``, s.
            noise: Standard deviation of the measured joint positions, rad or m; one number or
                (nq,). Gaussian, independent for each period.
            seed: Seed of the noise.

        Raises:
            InvalidInput: If an argument has the wrong type or range, the two models have different
                joints, or the period is not a multiple of the time step.
        """
        self._servo = controller if isinstance(controller, Servo) else None
        if isinstance(controller, Servo):
            if period is not None and period != controller.period:
                raise InvalidInput(
                    f"period: the servo's is {controller.period:g} s, got {period!r}; leave it out."
                )
            period, controller = controller.period, controller.controller
        instance("controller", controller, Controller)
        instance("plant", plant, Plant)
        if _joints(controller.model) != _joints(plant.model):
            raise InvalidInput(
                "ClosedLoop: the controller's model and the plant's have different joints; make "
                "both from one model."
            )
        if not controller.twist_tasks:
            raise InvalidInput(
                "ClosedLoop: the controller has no TwistTask, whose error the record needs; add "
                "one."
            )
        self.controller = controller
        self.plant = plant
        self.period = number("period", 0.01 if period is None else period, above=0.0)
        self._substeps = _substeps(self.period, plant.timestep)
        self.feedback: str = one_of("feedback", feedback, ("measured", "integrated", "blended"))
        constant = number("time_constant", time_constant, above=0.0)
        self._feedback_gain = {
            "measured": 1.0,
            "integrated": 0.0,
            "blended": -math.expm1(-self.period / constant),
        }[self.feedback]
        nq = controller.model.nq
        given = np.asarray(noise)
        self.noise: Array = (
            np.full(nq, number("noise", float(given)))
            if given.ndim == 0 and given.dtype.kind in "iuf"
            else finite_array("noise", noise, (nq,))
        )
        if not (self.noise >= 0.0).all():
            raise InvalidInput(f"noise: expected no negative deviation, got {self.noise.min():g}.")
        self._rng = np.random.default_rng(whole_number("seed", seed, at_least=0))
        start = finite_array("start", start, (nq,))
        plant.start(start)
        controller.note(np.zeros(controller.model.nv))
        self._steps_done = 0
        if self._servo is None:
            self.configuration = mink.Configuration(controller.model, start)
        else:
            self.configuration = self._servo.configuration
            self.configuration.update(start)
            self._servo.clock = lambda: self.time
        self._truth = mink.Configuration(controller.model, start)
        self._recorder = Recorder(plant.ranges, _speeds(controller), self.period, plant.timestep)

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._steps_done * self.period

    def run(
        self,
        seconds: float,
        target: Callable[[float], None] | None = None,
        *,
        pushes: Sequence[Push] = (),
    ) -> Record:
        """Run the loop from its current state.

        Args:
            seconds: Duration, s; rounded to whole periods.
            target: Called once per period with the time, s, to set the targets of the tasks; if
                ``None`` the targets do not change.
            pushes: Wrenches that disturb the robot.

        Returns:
            The record of this run; it ends early if the robot diverges.

        Raises:
            InvalidInput: If an argument has the wrong type or range, the plant lacks the body of a
                push, or the robot has diverged before.
            mink.TargetNotSet: If a task has no target.
        """
        count = max(1, round(number("seconds", seconds, above=0.0) / self.period))
        if target is not None and not callable(target):
            raise InvalidInput(
                "run: expected as target a function of the time that sets the tasks' targets; got "
                f"{target!r}."
            )
        if not isinstance(pushes, Sequence):
            raise InvalidInput(f"run: expected as pushes a list of Push; got {pushes!r}.")
        for push in pushes:
            instance("pushes", push, Push)
            if mujoco.mj_name2id(self.plant.model, mujoco.mjtObj.mjOBJ_BODY, push.body) < 0:
                raise InvalidInput(f"run: the plant has no body {push.body!r} to push.")
        if self.plant.diverged:
            raise InvalidInput("run: the robot has diverged; make a new loop with softer servos.")
        intervals: list[Interval] = []
        for _ in range(count):
            if target is not None:
                target(self.time)
            intervals.append(self._interval(pushes))
            if self.plant.diverged:
                break
        return self._recorder.record(intervals, diverged=self.plant.diverged)

    def _interval(self, pushes: Sequence[Push]) -> Interval:
        """Run one period: measure, compute the step, command it, simulate."""
        plant, configuration, time = self.plant, self.configuration, self.time
        measured = plant.q + self.noise * self._rng.standard_normal(len(self.noise))
        if self._steps_done:
            estimate = configuration.q
            configuration.update(estimate + self._feedback_gain * (measured - estimate))
        command, step, state, failure = self._compute_step()
        self._truth.update(plant.q)
        error = self.controller.twist_tasks[0].state(self._truth).error
        configuration.integrate_inplace(command, self.period)
        states = [(plant.q, plant.velocity)]
        for _ in range(self._substeps):
            plant.advance(configuration.q, command, pushes)
            states.append((plant.q, plant.velocity))
        self._steps_done += 1
        return Interval(
            time=time,
            error=error,
            measured=measured,
            command=command,
            step=step,
            state=state,
            failure=failure,
            q=np.array([q for q, _ in states]),
            velocity=np.array([velocity for _, velocity in states]),
        )

    def _compute_step(self) -> tuple[Array, Step | None, ServoState | None, str]:
        """Commanded velocity, the step, the servo's state, and why there is no step."""
        if self._servo is not None:
            tick = self._servo.tick()
            return tick.velocity, tick.step, tick.state, tick.failure
        try:
            step = self.controller.step(self.configuration, self.period)
        except NoSolutionFound as error:
            rest = np.zeros(self.controller.model.nv)
            self.controller.note(rest)
            return rest, None, None, str(error)
        return step.velocity, step, None, ""


def _substeps(period: float, timestep: float) -> int:
    """Number of simulation time steps per period."""
    count = round(period / timestep)
    if count < 1 or abs(count * timestep - period) > 1e-9 * max(period, timestep):
        near = max(count, 1) * timestep
        raise InvalidInput(
            f"period: {period:g} s is no multiple of the simulation's time step of {timestep:g} s; "
            f"take {near:g} s, or another time step for the plant."
        )
    return count


def _joints(model: mujoco.MjModel) -> list[tuple[str, int]]:
    return [(model.joint(i).name, int(model.jnt_type[i])) for i in range(model.njnt)]


def _speeds(controller: Controller) -> Array:
    """The largest joint speeds that the controller's limits allow, (nv,); ∞ if unlimited."""
    speeds = np.full(controller.model.nv, np.inf)
    for limit in controller.limits:
        if isinstance(limit, MotionLimit):
            speeds = np.minimum(speeds, limit.max_velocity)
        elif isinstance(limit, mink.VelocityLimit):
            speeds[limit.indices] = np.minimum(speeds[limit.indices], limit.limit)
    return speeds

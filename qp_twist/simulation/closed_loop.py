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
from qp_twist.controller import Controller, Step
from qp_twist.errors import InvalidInput
from qp_twist.limits import MotionLimit
from qp_twist.qp import NoSolutionFound
from qp_twist.simulation.plant import Plant
from qp_twist.simulation.push import Push
from qp_twist.simulation.record import Interval, Record, Recorder


class ClosedLoop:
    r"""A controller that commands servos at a fixed period, and the configuration it believes in.

    At the instant :math:`t_i` the controller takes a step of the length of the period dt from the
    configuration :math:`\hat q_i`, and the servos get

    .. math::

        \dot q_i = \text{controller}(\hat q_i), \qquad
        q_i^{command} = \hat q_i + \dot q_i\,dt

    and hold the command until the next instant. Then

    .. math::

        \hat q_{i+1} = q_i^{command} + \beta\,(q^{measured}_{i+1} - q_i^{command}), \qquad
        q^{measured} = q^{true} + \text{noise},

    with β = 1 for ``feedback="measured"``, 0 for ``"integrated"``, and
    :math:`1-e^{-dt/T}` for ``"blended"``: what was commanded, pulled to what is measured with the
    time constant T.

    The first :math:`\hat q` is the start. A step without a solution does not end the loop: the
    joints are commanded to stand still for a period. Acceleration limits count from the velocity
    commanded before, not from a measured one.

    Attributes:
        controller: The controller.
        plant: The robot and its servos.
        period: dt, s.
        feedback: What the controller's configuration is made of.
        configuration: That configuration, :math:`\hat q`.
        time: The clock, s; :meth:`run` goes on from there.

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
        controller: Controller,
        plant: Plant,
        start: npt.ArrayLike,
        *,
        period: float = 0.01,
        feedback: Literal["measured", "integrated", "blended"] = "integrated",
        time_constant: float = 0.1,
        noise: npt.ArrayLike = 0.0,
        seed: int = 0,
    ) -> None:
        """Close the loop, with the robot at rest.

        Args:
            controller: The controller; its first :class:`~qp_twist.TwistTask` is what the record
                measures errors by.
            plant: The robot and its servos, of the same joints. It is put to the start, and belongs
                to this loop from then on, as the controller does.
            start: Joint positions at time 0, rad or m, (nq,).
            period: dt, s; a multiple of the plant's time step.
            feedback: ``"measured"``, ``"integrated"`` or ``"blended"``.
            time_constant: T of ``"blended"``, s.
            noise: Standard deviation of the measured joint positions, rad or m; one number or
                (nq,). Gaussian, independent at every instant.
            seed: Of the noise.

        Raises:
            InvalidInput: If an argument has the wrong type or range, the two models differ in their
                joints, or the period is no multiple of the time step.
        """
        instance("controller", controller, Controller)
        instance("plant", plant, Plant)
        if _joints(controller.model) != _joints(plant.model):
            raise InvalidInput(
                "ClosedLoop: the controller's model and the plant's have different joints; make "
                "both from one model."
            )
        if not controller.twist_tasks:
            raise InvalidInput(
                "ClosedLoop: the controller has no TwistTask, by which errors are measured; give "
                "it one."
            )
        self.controller = controller
        self.plant = plant
        self.period = number("period", period, above=0.0)
        self._substeps = _substeps(self.period, plant.timestep)
        self.feedback: str = one_of("feedback", feedback, ("measured", "integrated", "blended"))
        constant = number("time_constant", time_constant, above=0.0)
        self._pull = {
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
        self.configuration = mink.Configuration(controller.model, start)
        self._steps_done = 0
        self._truth = mink.Configuration(controller.model, start)
        self._recorder = Recorder(plant.ranges, _speeds(controller), self.period, plant.timestep)

    @property
    def time(self) -> float:
        """The clock, s."""
        return self._steps_done * self.period

    def run(
        self,
        seconds: float,
        target: Callable[[float], None] | None = None,
        *,
        pushes: Sequence[Push] = (),
    ) -> Record:
        """Let the loop run, from where it is.

        Args:
            seconds: How long, s; rounded to whole periods.
            target: Called at every instant with the time, s, to set the targets of the tasks; they
                stay as they are if ``None``.
            pushes: Wrenches that disturb the robot.

        Returns:
            What happened in this run, up to where the robot diverged if it did.

        Raises:
            InvalidInput: If an argument is of the wrong type or range, the plant lacks the body of
                a push, or the robot diverged before.
            mink.TargetNotSet: If a task has no target.
        """
        count = max(1, round(number("seconds", seconds, above=0.0) / self.period))
        if target is not None and not callable(target):
            raise InvalidInput(
                "run: target is a function of the time that sets the targets of the tasks; got "
                f"{target!r}."
            )
        if not isinstance(pushes, Sequence):
            raise InvalidInput(f"run: pushes is a list of Push; got {pushes!r}.")
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
        """One period: measure, decide, command, simulate."""
        plant, configuration, time = self.plant, self.configuration, self.time
        measured = plant.q + self.noise * self._rng.standard_normal(len(self.noise))
        if self._steps_done:
            believed = configuration.q
            configuration.update(believed + self._pull * (measured - believed))
        step, failure = self._decide()
        command = np.zeros(plant.model.nv) if step is None else step.velocity
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
            failure=failure,
            q=np.array([q for q, _ in states]),
            velocity=np.array([velocity for _, velocity in states]),
        )

    def _decide(self) -> tuple[Step | None, str]:
        """The controller's step, or why there is none."""
        try:
            return self.controller.step(self.configuration, self.period), ""
        except NoSolutionFound as error:
            self.controller.note(np.zeros(self.controller.model.nv))
            return None, str(error)


def _substeps(period: float, timestep: float) -> int:
    """How many time steps a period has."""
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
    """The largest joint speeds that the controller's limits allow, (nv,); ∞ where none is."""
    speeds = np.full(controller.model.nv, np.inf)
    for limit in controller.limits:
        if isinstance(limit, MotionLimit):
            speeds = np.minimum(speeds, limit.max_velocity)
        elif isinstance(limit, mink.VelocityLimit):
            speeds[limit.indices] = np.minimum(speeds[limit.indices], limit.limit)
    return speeds

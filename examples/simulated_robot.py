"""The loop closed around a robot in MuJoCo's dynamics: servos with lag, noise, pushes, a record.

    from simulated_robot import ClosedLoop, Servos     # with this file beside yours

    loop = ClosedLoop(controller, Servos(model, lag=0.02), start, feedback="measured")
    record = loop.run(2.0, target)

docs/streaming.md explains the loop; closed_loop.py and servo.py beside this file use it.
"""

import copy
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mink
import mujoco
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

Array = np.ndarray
_SAMPLES = 64
"""Configurations over which the inertia at a joint is averaged."""


@dataclass(frozen=True)
class Push:
    """A constant wrench on a body, at its centre of mass, in world axes: N, N m, s."""

    body: str
    force: Sequence[float] = (0.0, 0.0, 0.0)
    torque: Sequence[float] = (0.0, 0.0, 0.0)
    start: float = 0.0
    duration: float = 0.2


class Servos:
    r"""A robot in MuJoCo's dynamics, with a servo at every hinge and slide.

    The command reaches the servos through a first-order lag, τ u̇ = u_command − u. Their torque (or
    force) is

    .. math::

        \text{position:}\quad & \kappa\,(u - \theta) + \delta\,(c\,\dot u - \dot\theta), &
        \kappa &= I\omega^2,\; \delta = 2\zeta I\omega \\
        \text{velocity:}\quad & \delta\,(\dot u - \dot\theta), & \delta &= I\omega

    where I is the inertia at the joint: the mean of the diagonal of the mass matrix over random
    configurations, armature included. So one bandwidth ω suits large and small joints of any arm.

    In a steady motion a servo lags by its ``delay``, τ + 2ζ(1 − c)/ω or τ + 1/ω.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        kind: Literal["position", "velocity"] = "position",
        *,
        bandwidth: float = 20.0,
        damping_ratio: float = 1.0,
        feedforward: float = 0.0,
        lag: float = 0.0,
        gravity_compensation: float = 1.0,
        timestep: float | None = None,
    ) -> None:
        """Put servos on a copy of a model that has none.

        ``bandwidth`` is ω/2π, Hz; ``damping_ratio`` ζ; ``feedforward`` c; ``lag`` τ, s. With what
        is not compensated of the weight position servos sag and velocity servos sink.
        """
        self.model = copy.copy(model)
        options = self.model.opt
        options.timestep = timestep or options.timestep
        options.gravity *= 1.0 - gravity_compensation
        # Damping is then integrated implicitly: a stiff servo needs no short step.
        options.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        # Ranges are no stops, so that it shows how far beyond them a joint moves; and a diverged
        # state is not reset.
        options.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        options.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        # Where the model states no armature it gets the joint's mean inertia, which corresponds to
        # the usual choice of a gear ratio.
        links = mean_inertia(self.model) - self.model.dof_armature
        stated = self.model.dof_armature
        self.model.dof_armature[:] = np.where(stated > 0.0, stated, links)
        self.inertia = links + self.model.dof_armature
        omega, position = 2.0 * np.pi * bandwidth, kind == "position"
        self.stiffness = self.inertia * omega**2 * position
        self.damping = self.inertia * omega * (2.0 * damping_ratio if position else 1.0)
        self._feedforward = feedforward if position else 1.0
        self.delay = lag + (2.0 * damping_ratio * (1.0 - feedforward) if position else 1.0) / omega
        self.model.dof_damping += self.damping
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setConst(self.model, self.data)
        self.timestep = float(options.timestep)
        # The lag is integrated exactly over a time step with a constant command.
        self._share = -math.expm1(-self.timestep / lag) if lag else 1.0
        self.start(self.model.qpos0)

    @property
    def diverged(self) -> bool:
        """Whether the state is beyond any robot, or not finite."""
        return not np.abs(np.append(self.data.qpos, self.data.qvel)).max() < 1e6

    def start(self, q: Array) -> None:
        """Put the robot at rest at q, (nq,), with the servos commanded to hold it."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = q
        self._position, self._velocity = self.data.qpos.copy(), np.zeros(self.model.nv)
        mujoco.mj_forward(self.model, self.data)

    def advance(self, position: Array, velocity: Array, pushes: Sequence[Push] = ()) -> None:
        """One time step of the simulation under a commanded position and velocity."""
        data = self.data
        self._position += self._share * (position - self._position)
        self._velocity += self._share * (velocity - self._velocity)
        # The remaining torque, −δ θ̇, is joint damping of the model.
        data.qfrc_applied[:] = self.stiffness * (self._position - data.qpos)
        data.qfrc_applied += self._feedforward * self.damping * self._velocity
        data.xfrc_applied[:] = 0.0
        for push in pushes:
            if push.start <= data.time + 1e-9 < push.start + push.duration:
                data.xfrc_applied[self.model.body(push.body).id] += [*push.force, *push.torque]
        mujoco.mj_step(self.model, data)


def mean_inertia(model: mujoco.MjModel) -> Array:
    """Mean diagonal of the mass matrix over configurations in the joint ranges, (nv,)."""
    rng = np.random.default_rng(0)
    limited = model.jnt_limited.astype(bool)
    lower = np.where(limited, model.jnt_range[:, 0], model.qpos0 - np.pi)
    upper = np.where(limited, model.jnt_range[:, 1], model.qpos0 + np.pi)
    data, full, total = mujoco.MjData(model), np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for _ in range(_SAMPLES):
        data.qpos[:] = rng.uniform(lower, upper)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        total += np.diag(full)
    return total / _SAMPLES


class TimedPath:
    """Moves the target of a task along poses, with its twist as feed-forward.

    ``durations`` (N,) are the times from the previous pose to each pose, s, the first 0, as in a
    :class:`~qp_twist.PathTask`. Before the start the target rests at the first pose, after the end
    at the last.
    """

    def __init__(
        self,
        task: qt.TwistTask,
        poses: Sequence[mink.SE3],
        durations: Sequence[float] | Array,
        *,
        start: float = 0.0,
    ) -> None:
        self.task, self._poses = task, list(poses)
        self._times = start + np.cumsum(durations)

    def __call__(self, time: float) -> None:
        """Set the target to its pose at ``time``, s."""
        times, poses = self._times, self._poses
        if not times[0] <= time < times[-1]:
            self.task.set_target(poses[-1 if time >= times[-1] else 0], np.zeros(6))
            return
        k = int(np.searchsorted(times, time, side="right")) - 1
        before, after, span = poses[k], poses[k + 1], times[k + 1] - times[k]
        velocity = (after.translation() - before.translation()) / span
        rate = (after.rotation() @ before.rotation().inverse()).log() / span  # in world axes
        passed = time - times[k]
        pose = mink.SE3.from_rotation_and_translation(
            mink.SO3.exp(rate * passed) @ before.rotation(),
            before.translation() + velocity * passed,
        )
        self.task.set_target(pose, np.concatenate([velocity, rate]))


@dataclass(frozen=True)
class Record:
    """A run of a :class:`ClosedLoop`, one entry for each of its N periods.

    States are true states at the beginning of the period, when the controller computes its step;
    extremes are taken over the simulation's time steps in it. SI units.
    """

    time: Array  # beginning of each period (N,)
    q: Array  # (N, nq)
    velocity: Array  # (N, nv)
    measured: Array  # q with noise
    command: Array  # commanded joint velocities (N, nv)
    position_error: Array  # length of the linear part of UᵀΔt of the controller's first task (N,)
    angle_error: Array  # of the angular part
    margin: Array  # lowest 1 − |θ − θ̄|/half-range of all joints (N,); negative outside
    room: Array  # distance of the joint nearest to a limit (N,); negative outside
    acceleration_max: Array  # largest size of each joint's acceleration (N, nv)
    acceleration_rms: Array  # its root mean square
    scale: Array  # of each step (N,); 0 without a step
    statuses: tuple[qt.Status | None, ...]  # None without a step
    states: tuple[Any, ...]  # what the servo was doing; None where a controller runs without one
    failures: dict[float, str]  # why there was no step, by time
    period: float
    diverged: bool  # then the run ended early

    def summary(self, since: float = 0.0) -> dict[str, float]:
        """The record from a time on in numbers, SI units; a command's step is from the last one."""
        kept = self.time >= since - 1e-9
        errors = {"position_error": self.position_error, "angle_error": self.angle_error}
        errors["command_step"] = np.diff(self.command, axis=0, prepend=self.command[:1])
        found = {f"{name}_max": float(np.abs(v[kept]).max()) for name, v in errors.items()}
        errors["acceleration"] = self.acceleration_rms
        for name, values in errors.items():
            found[f"{name}_rms"] = float(np.sqrt((values[kept] ** 2).mean()))
        return found | {
            "acceleration_max": float(self.acceleration_max[kept].max()),
            "min_margin": float(self.margin[kept].min()),
            "min_room": float(self.room[kept].min()),
            "min_scale": float(self.scale[kept].min()),
        }

    def count(self) -> dict[str, int]:
        """Number of steps of each status; ``NO_STEP`` for periods without a step."""
        return dict(Counter("NO_STEP" if s is None else s.name for s in self.statuses))

    def figure(self, title: str = "") -> Figure:
        """Errors, margin, joint speeds and scale over time; a servo's states below."""
        curves: list[tuple[str, Any]] = [
            ("position error, mm", 1e3 * self.position_error),
            ("angle error, degrees", np.degrees(self.angle_error)),
            ("lowest margin of all joints (0: limit)", self.margin),
            ("commanded joint velocities, rad/s or m/s", self.command),
            ("scale of the task (0: no step)", self.scale),
        ]
        if any(state is not None for state in self.states):
            curves.append(("state of the servo", [getattr(s, "name", "") for s in self.states]))
        figure = Figure(figsize=(8.0, 1.6 * len(curves)), layout="constrained")
        for panel, (name, values) in zip(
            figure.subplots(len(curves), 1, sharex=True), curves, strict=True
        ):
            panel.step(self.time, values, where="post", linewidth=1.0)
            panel.set_title(name, loc="left", fontsize=9)
            panel.grid(alpha=0.3)
        panel.set_xlabel("time, s")
        figure.suptitle(title)
        return figure

    def __str__(self) -> str:
        end = ", diverged" if self.diverged else ""
        return f"{len(self.time)} periods of {self.period:g} s{end}, {self.count()}"


class ClosedLoop:
    r"""A controller that commands servos at a fixed period, and its configuration estimate.

    At time :math:`t_i` the controller computes a step of length dt, the period, from the estimate
    :math:`\hat q_i`. The servos receive the velocity and :math:`\hat q_i + \dot q_i\,dt` and hold
    them for the period. Then :math:`\hat q_{i+1} = \hat q_i + \dot q_i\,dt + \beta\,(q^{measured} -
    \hat q_i - \dot q_i\,dt)`, with β = 1 for ``"measured"``, 0 for ``"integrated"``, and
    :math:`1-e^{-dt/T}` for ``"blended"``.

    A step without a solution does not end the loop: the controller then commands zero velocity for
    one period. The estimate is ``configuration``.
    """

    def __init__(
        self,
        controller: qt.Controller | qt.Servo,
        plant: Servos,
        start: Array,
        *,
        period: float = 0.01,
        feedback: Literal["measured", "integrated", "blended"] = "integrated",
        time_constant: float = 0.1,
        noise: float | Array = 0.0,
        seed: int = 0,
    ) -> None:
        """Close the loop, with the robot at rest at ``start`` (nq,).

        A servo's period, configuration and clock become those of the loop. ``period`` is a multiple
        of the plant's time step; ``time_constant`` T of ``"blended"``, s; ``noise`` the standard
        deviation of the measured joint positions, rad or m, one or (nq,).
        """
        self._servo = controller if isinstance(controller, qt.Servo) else None
        self.period = self._servo.period if self._servo else period
        self.controller = self._servo.controller if self._servo else controller
        self._substeps = round(self.period / plant.timestep)
        if abs(self._substeps * plant.timestep - self.period) > 1e-9:
            raise ValueError(f"{self.period:g} s is no multiple of {plant.timestep:g} s.")
        self.plant, self.noise, self._rng = plant, noise, np.random.default_rng(seed)
        gains = {"measured": 1.0, "integrated": 0.0}
        gains["blended"] = -math.expm1(-self.period / time_constant)
        self._feedback_gain = gains[feedback]
        self._steps_done = 0
        plant.start(start)
        self.controller.note(np.zeros(plant.model.nv))
        if self._servo is None:
            self.configuration = mink.Configuration(self.controller.model, start)
        else:
            self.configuration = self._servo.configuration
            self.configuration.update(start)
            self._servo.clock = lambda: self.time
        self._truth = mink.Configuration(self.controller.model, start)
        self._ranges = qt.JointRanges.of(plant.model)

    @property
    def time(self) -> float:
        """Simulated time, s; :meth:`run` continues from there."""
        return self._steps_done * self.period

    def run(
        self,
        seconds: float,
        target: Callable[[float], None] = lambda time: None,
        *,
        pushes: Sequence[Push] = (),
    ) -> Record:
        """Run the loop from its current state; ``target(time)`` sets the targets in each period."""
        rows = []
        failures: dict[float, str] = {}
        for _ in range(max(1, round(seconds / self.period))):
            target(self.time)
            rows.append(self._interval(pushes, failures))
            if self.plant.diverged:
                break
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        statuses, states = (tuple(columns.pop(name)) for name in ("statuses", "states"))
        arrays = {name: np.array(values) for name, values in columns.items()}
        return Record(
            **arrays, statuses=statuses, states=states, failures=failures, period=self.period,
            diverged=self.plant.diverged,
        )  # fmt: skip

    def _interval(self, pushes: Sequence[Push], failures: dict[float, str]) -> dict[str, Any]:
        """Run one period: measure, compute the step, command it, simulate."""
        plant, data, configuration = self.plant, self.plant.data, self.configuration
        measured = data.qpos + self.noise * self._rng.standard_normal(len(data.qpos))
        if self._steps_done:
            estimate = configuration.q
            configuration.update(estimate + self._feedback_gain * (measured - estimate))
        step = state = None
        command, failure = np.zeros(plant.model.nv), ""
        if self._servo is not None:
            tick = self._servo.tick()
            command, step, state, failure = tick.velocity, tick.step, tick.state, tick.failure
        else:
            try:
                step = self.controller.step(configuration, self.period)
                command = step.velocity
            except qt.NoSolutionFound as error:
                failure = str(error)
                self.controller.note(command)
        if failure:
            failures[self.time] = failure
        self._truth.update(data.qpos.copy())
        error = self.controller.twist_tasks[0].state(self._truth).error
        time = self.time
        configuration.integrate_inplace(command, self.period)
        q, velocity = [data.qpos.copy()], [data.qvel.copy()]
        for _ in range(self._substeps):
            plant.advance(configuration.q, command, pushes)
            q.append(data.qpos.copy())
            velocity.append(data.qvel.copy())
        self._steps_done += 1
        acceleration = np.diff(velocity, axis=0) / plant.timestep
        return {
            "time": time,
            "q": q[0],
            "velocity": velocity[0],
            "measured": measured,
            "command": command,
            "position_error": np.linalg.norm(error[:3]),
            "angle_error": np.linalg.norm(error[3:]),
            "margin": self._ranges.margins(np.array(q)).min(),
            "room": self._ranges.room(np.array(q)).min(),
            "acceleration_max": np.abs(acceleration).max(axis=0),
            "acceleration_rms": np.sqrt((acceleration**2).mean(axis=0)),
            "scale": 0.0 if step is None else step.scale,
            "statuses": None if step is None else step.status,
            "states": state,
        }

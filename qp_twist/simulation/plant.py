"""A simulated robot whose joints follow commands: base of all kinds of servos."""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Sequence
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, number
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.simulation.push import Push

LARGEST_STATE = 1e6
"""A joint beyond this, in rad, m, rad/s or m/s, has diverged."""


class Plant(abc.ABC):
    r"""A robot in MuJoCo's dynamics, with a servo at every joint.

    The command reaches the servos through a first-order lag,

    .. math:: \tau\,\dot u = u_{command} - u,

    integrated exactly over a time step with a constant command. The model is copied; the original
    is not changed.

    Attributes:
        model: The copy that is simulated.
        data: Its state.
        kind: Command of the servos, ``"position"`` or ``"velocity"``.
        lag: τ, s.
        ranges: The joint ranges of the model.
    """

    kind: Literal["position", "velocity"]

    def __init__(
        self, model: mujoco.MjModel, *, lag: float, timestep: float | None, stops: bool
    ) -> None:
        """Copy the model and set up its simulation.

        Args:
            model: The robot. Every joint is a hinge or a slide.
            lag: τ, s; 0 for none.
            timestep: Time step of the simulation, s; the model's if ``None``.
            stops: Whether the ends of the joint ranges are mechanical stops, too. Without them the
                record shows how far beyond its range a joint moves.

        Raises:
            InvalidInput: If an argument has the wrong type or range, or a joint is a ball or free.
        """
        instance("model", model, mujoco.MjModel)
        self.ranges = JointRanges.of(model)
        for name, address in zip(self.ranges.names, self.ranges.qpos, strict=True):
            if address < 0:
                raise InvalidInput(
                    f"{type(self).__name__}: {name!r} is a ball or free joint; servos stand at "
                    "hinges and slides. Give a model of the arm alone."
                )
        self.model = copy.copy(model)
        options = self.model.opt
        if timestep is not None:
            options.timestep = number("timestep", timestep, above=0.0)
        # Damping is then integrated implicitly: a stiff servo needs no short step.
        options.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        # MuJoCo would reset a diverged state to qpos0.
        options.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if not stops:
            options.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self.data = mujoco.MjData(self.model)
        self.lag = number("lag", lag, at_least=0.0)
        self._share = 1.0 if self.lag == 0.0 else -math.expm1(-self.timestep / self.lag)
        self._position = self.q
        self._velocity = np.zeros(self.model.nv)

    @property
    def timestep(self) -> float:
        """Time step of the simulation, s."""
        return float(self.model.opt.timestep)

    @property
    def q(self) -> Array:
        """True joint positions, rad or m, (nq,)."""
        q: Array = self.data.qpos.copy()
        return q

    @property
    def velocity(self) -> Array:
        """True joint velocities, rad/s or m/s, (nv,)."""
        velocity: Array = self.data.qvel.copy()
        return velocity

    @property
    def diverged(self) -> bool:
        """Whether the state is beyond any robot, or not finite."""
        state = np.abs(np.concatenate([self.data.qpos, self.data.qvel]))
        return not float(state.max(initial=0.0)) < LARGEST_STATE

    def start(self, q: npt.ArrayLike) -> None:
        """Put the robot at rest at q, (nq,), with the servos commanded to hold it."""
        q = finite_array("q", q, (self.model.nq,))
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = q
        self._position = q.copy()
        self._velocity[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def advance(
        self, position: npt.ArrayLike, velocity: npt.ArrayLike, pushes: Sequence[Push] = ()
    ) -> None:
        """One time step of the simulation; a robot that has diverged stays where it is.

        Args:
            position: Commanded joint positions, (nq,); velocity servos do not see them.
            velocity: Commanded joint velocities, (nv,).
            pushes: Wrenches on bodies.
        """
        if self.diverged:
            return
        self._position += self._share * (np.asarray(position) - self._position)
        self._velocity += self._share * (np.asarray(velocity) - self._velocity)
        self._drive(self._position, self._velocity)
        self.data.xfrc_applied[:] = 0.0
        for push in pushes:
            if push.acts(self.data.time):
                self.data.xfrc_applied[self.model.body(push.body).id] += push.wrench
        mujoco.mj_step(self.model, self.data)

    @abc.abstractmethod
    def _drive(self, position: Array, velocity: Array) -> None:
        """Apply the lagged command to the servos."""

"""Servos for a model without actuators."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, number, one_of
from qp_twist.errors import InvalidInput
from qp_twist.simulation.plant import Plant

_SAMPLES = 64


class Servos(Plant):
    r"""A servo at every joint of a model that has none.

    With u the lagged command, the torque (or force) is

    .. math::

        \text{position:}\quad & \kappa\,(u - \theta) + \delta\,(c\,\dot u - \dot\theta), &
        \kappa &= I\omega^2,\; \delta = 2\zeta I\omega \\
        \text{velocity:}\quad & \delta\,(\dot u - \dot\theta), & \delta &= I\omega

    where I is the inertia at the joint: the mean of the diagonal of the mass matrix over random
    configurations, armature included. So one bandwidth ω suits large and small joints of any arm.
    In a steady motion a servo lags by its ``delay``, :math:`\tau + 2\zeta(1-c)/\omega` or
    :math:`\tau + 1/\omega`.

    Attributes:
        inertia: I, kg m² or kg, (nv,).
        stiffness: κ, N m/rad or N/m, (nv,); zeros for velocity servos.
        damping: δ, N m s/rad or N s/m, (nv,).
        feedforward: c.
        delay: Lag of a joint in a steady motion, s.

    Example:
        >>> import qp_twist as qt
        >>> from qp_twist.simulation import Servos
        >>> servos = Servos(qt.load_task("planar_line").model, kind="velocity", lag=0.02)
        >>> servos.kind, servos.damping.shape
        ('velocity', (3,))
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
        armature: npt.ArrayLike | None = None,
        stops: bool = False,
        timestep: float | None = None,
    ) -> None:
        """Put servos on a copy of the model.

        Args:
            model: The robot, without actuators, of hinges and slides.
            kind: Command of the servos: ``"position"`` or ``"velocity"``.
            bandwidth: ω/2π, Hz.
            damping_ratio: ζ of position servos.
            feedforward: c, the share of the commanded velocity that position servos receive.
            lag: τ of the first-order lag between command and servo, s.
            gravity_compensation: Share of the weight that is compensated; with the rest the arm
                sags on position servos, and sinks on velocity servos.
            armature: Inertia of the rotors as the joints see it, kg m² or kg, (nv,). If ``None``
                the model's, and the joint's mean inertia where the model has none, which
                corresponds to the usual choice of a gear ratio.
            stops: Whether the ends of the joint ranges are mechanical stops.
            timestep: Time step of the simulation, s; the model's if ``None``.

        Raises:
            InvalidInput: If an argument has the wrong type or range, the model has actuators, or a
                joint moves no mass.
        """
        super().__init__(model, lag=lag, timestep=timestep, stops=stops)
        if model.nu > 0:
            raise InvalidInput(
                f"Servos: the model has {model.nu} actuators of its own; use ModelServos(model)."
            )
        self.kind = one_of("kind", kind, ("position", "velocity"))  # type: ignore[assignment]
        omega = 2.0 * np.pi * number("bandwidth", bandwidth, above=0.0)
        zeta = number("damping_ratio", damping_ratio, above=0.0)
        self.feedforward = number("feedforward", feedforward, at_least=0.0, at_most=1.0)
        # Exactly compensated gravity is modelled as no gravity.
        compensated = number(
            "gravity_compensation", gravity_compensation, at_least=0.0, at_most=1.0
        )
        self.model.opt.gravity *= 1.0 - compensated
        self.inertia = self._inertia(armature)
        position = self.kind == "position"
        self.stiffness = self.inertia * omega**2 if position else np.zeros(model.nv)
        self.damping = self.inertia * omega * (2.0 * zeta if position else 1.0)
        late = 2.0 * zeta * (1.0 - self.feedforward) if position else 1.0
        self.delay = self.lag + late / omega
        self._told = self.feedforward if position else 1.0
        self.model.dof_damping += self.damping
        mujoco.mj_setConst(self.model, self.data)
        self.start(self.model.qpos0)

    def _inertia(self, armature: npt.ArrayLike | None) -> Array:
        """Set the armature, and return I."""
        seen = _mean_inertia(self.model) - self.model.dof_armature
        for name, value in zip(self.ranges.names, seen, strict=True):
            if not value > 0.0:
                raise InvalidInput(
                    f"Servos: {name!r} moves no mass; give its bodies inertia, or use the "
                    "kinematics alone."
                )
        if armature is None:
            stated = self.model.dof_armature
            self.model.dof_armature[:] = np.where(stated > 0.0, stated, seen)
        else:
            given = finite_array("armature", armature, (self.model.nv,))
            if not (given >= 0.0).all():
                raise InvalidInput(f"armature: expected no negative inertia, got {given.min():g}.")
            self.model.dof_armature[:] = given
        inertia: Array = seen + self.model.dof_armature
        return inertia

    def _drive(self, position: Array, velocity: Array) -> None:
        # The remaining torque, −δ θ̇, is modelled as joint damping.
        self.data.qfrc_applied[:] = (
            self.stiffness * (position - self.data.qpos) + self._told * self.damping * velocity
        )


def _mean_inertia(model: mujoco.MjModel) -> Array:
    """Mean diagonal of the mass matrix over configurations in the joint ranges, (nv,)."""
    rng = np.random.default_rng(0)
    limited = model.jnt_limited.astype(bool)
    lower = np.where(limited, model.jnt_range[:, 0], model.qpos0 - np.pi)
    upper = np.where(limited, model.jnt_range[:, 1], model.qpos0 + np.pi)
    data = mujoco.MjData(model)
    column, total = np.zeros(model.nv), np.zeros(model.nv)
    for _ in range(_SAMPLES):
        data.qpos[:] = rng.uniform(lower, upper)
        mujoco.mj_forward(model, data)
        for dof, unit in enumerate(np.eye(model.nv)):
            mujoco.mj_mulM(model, data, column, unit)
            total[dof] += column[dof]
    mean: Array = total / _SAMPLES
    return mean

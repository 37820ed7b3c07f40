"""Servos that are part of a model."""

from __future__ import annotations

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.simulation.plant import Plant


class ModelServos(Plant):
    """The model's own actuators, one position or velocity servo at every joint.

    MJCF's ``<position>`` and ``<velocity>`` actuators, with the model's gains, dynamics and
    gravity, and an additional ``lag``. The integrator is implicitfast, as for all plants.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        lag: float = 0.0,
        stops: bool = False,
        timestep: float | None = None,
    ) -> None:
        """Take the actuators of a model.

        Args:
            model: The robot, of hinges and slides.
            lag: τ of the first-order lag between command and actuator, s.
            stops: Whether the ends of the joint ranges are mechanical stops.
            timestep: Time step of the simulation, s; the model's if ``None``.

        Raises:
            InvalidInput: If an argument has the wrong type or range, a joint has no actuator or
                several, or they are not all position or all velocity servos.
        """
        super().__init__(model, lag=lag, timestep=timestep, stops=stops)
        self._dof = self._joints_moved()
        self._gear: Array = self.model.actuator_gear[:, 0].copy()
        kinds = {self._kind(actuator) for actuator in range(self.model.nu)}
        if kinds == {"position"}:
            self.kind = "position"
        elif kinds == {"velocity"}:
            self.kind = "velocity"
        else:
            raise InvalidInput(
                f"ModelServos: expected position servos only, or velocity servos only; the "
                f"actuators are {', '.join(sorted(kinds))}."
            )
        self.start(self.model.qpos0)

    def _joints_moved(self) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """The degree of freedom of each actuator, (nu,)."""
        model = self.model
        joint = int(mujoco.mjtTrn.mjTRN_JOINT)
        dofs = [
            int(model.jnt_dofadr[model.actuator_trnid[k, 0]])
            for k in range(model.nu)
            if model.actuator_trntype[k] == joint
        ]
        if len(dofs) != model.nu or sorted(dofs) != list(range(model.nv)):
            raise InvalidInput(
                f"ModelServos: expected one actuator at each of the {model.nv} joints; the model "
                f"has {model.nu} actuators, {len(set(dofs))} joints have one. Use "
                "Servos(model) on a model without actuators."
            )
        return np.array(dofs, dtype=np.intp)

    def _kind(self, actuator: int) -> str:
        """Kind of an actuator by its force law: MuJoCo's gain and bias."""
        model = self.model
        gain = float(model.actuator_gainprm[actuator, 0])
        stiffness, damping = -model.actuator_biasprm[actuator, 1:3]
        fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        if fixed and affine and gain > 0.0:
            if np.isclose(stiffness, gain):
                return "position"
            if stiffness == 0.0 and np.isclose(damping, gain):
                return "velocity"
        return "others"

    def start(self, q: object) -> None:
        """Put the robot at rest at q, (nq,), with the servos commanded to hold it."""
        super().start(q)  # type: ignore[arg-type]
        # Actuators with dynamics start in their steady state.
        command = self._position if self.kind == "position" else self._velocity
        for actuator in range(self.model.nu):
            address = self.model.actuator_actadr[actuator]
            if address >= 0:
                self.data.act[address] = self._gear[actuator] * command[self._dof[actuator]]

    def _drive(self, position: Array, velocity: Array) -> None:
        command = position if self.kind == "position" else velocity
        self.data.ctrl[:] = self._gear * command[self._dof]

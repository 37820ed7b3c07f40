"""Position, velocity and acceleration limits that remain feasible together in every step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, are_floats, checked, finite_array, float_array, number
from qp_twist.constraints.box import Box, Intersection
from qp_twist.constraints.couplings import JointCouplings, share_limits
from qp_twist.constraints.position_limit import PositionLimit, array_attribute
from qp_twist.constraints.stopping_speed import stopping_speed
from qp_twist.errors import InvalidInput
from qp_twist.kernel.constants import NOTICEABLE
from qp_twist.kinematics import JointRanges

FULL_SPEED_WITHIN = 0.05
"""s, within which a joint without a stated acceleration limit may reach its velocity limit: faster
than any robot, and 10 steps at 200 Hz, in which a joint cannot reverse from one to the next."""


def _joint_velocity(limit: Any, name: str, value: Any) -> Array:
    nv = len(limit.names)
    return value if are_floats(value, nv) else finite_array(name, value, (nv,))


class MotionLimit(PositionLimit):
    r"""Keep positions, velocities and accelerations of the joints inside their limits.

    A step moves the joints at the constant velocity :math:`\dot\theta`, after
    :math:`\dot\theta_{before}`:

    .. math::

        |\dot\theta - \dot\theta_{before}| \le a_{max}\,dt, \qquad
        |\dot\theta| \le v_{max}, \qquad
        -v(\theta - \theta_{min}) \le \dot\theta \le v(\theta_{max} - \theta)

    with v(d) the :func:`~qp_twist.constraints.stopping_speed`: the largest from which braking at
    :math:`a_{max}` in steps of dt stops within the room d. A state is viable if some velocity
    satisfies all three; then so is the state after the step, and the box never becomes empty
    (:doc:`/proofs`).

    From a state that is not viable (outside a range, too fast to stop before its end, faster than
    v_max), the joint brakes or returns at the fastest rate that the other limits allow:
    acceleration limits hold before velocity limits, and these before position limits. The speed of
    a return is v_max, or ``recovery_speed`` where there is none. :meth:`recovering` reports it.

    dt may change: a viable state remains viable with longer steps; with shorter ones a joint that
    can just stop may overshoot by less than :math:`\dot\theta\,dt/2`.

    Velocity and acceleration limits count for each degree of freedom of a ball or free joint.
    Joints that MJCF couples linearly share their limits
    (:func:`~qp_twist.constraints.share_limits`). Other equality constraints (connect, weld, tendon)
    are ignored: the limits hold, but braking may violate those constraints.

    Attributes:
        velocity: Joint velocity before the step, rad/s or m/s, (nv,), initially zero. This is
            state: use one limit object for each robot.
        max_velocity: v_max, rad/s or m/s, (nv,); ∞ without a limit.
        max_acceleration: a_max, rad/s² or m/s², (nv,); ∞ without a limit.
    """

    kind = "motion"
    only_configurations = False
    velocity: Array = checked(_joint_velocity)
    max_velocity: Array = array_attribute()
    max_acceleration: Array = array_attribute()

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        velocity: Mapping[str, float] | npt.ArrayLike | None = None,
        acceleration: Mapping[str, float] | npt.ArrayLike | Literal["default"] | None = "default",
        margin: float = 0.0,
        recovery_speed: float = 0.5,
    ) -> None:
        """Set the limits; position limits are the model's.

        Args:
            model: The robot.
            velocity: v_max by joint name, one number for all, or an array (nv,); rad/s or m/s.
            acceleration: a_max, in the same forms; rad/s² or m/s². By default full speed within
                50 ms, which steps near a singularity and at the edge of the reach need to be
                smooth; ``None``: no limit.
            margin: Distance by which the ranges are narrowed at either end, rad or m.
            recovery_speed: Speed at which a joint without a velocity limit returns, rad/s or m/s.

        Raises:
            InvalidInput: If a limit is not above 0 or names an unknown joint, a ball joint has a
                range, or a joint with an acceleration limit is coupled nonlinearly to another.
        """
        super().__init__(model, margin=margin, recovery_speed=recovery_speed)
        fastest = per_joint("velocity", velocity, self.ranges)
        if isinstance(acceleration, str) and acceleration == "default":
            hardest = fastest / FULL_SPEED_WITHIN
            couplings = JointCouplings(model)  # curved ones leave no fixed acceleration limit
            for joints in (couplings.first, couplings.second):
                hardest[joints[couplings.curved]] = np.inf
        else:
            hardest = per_joint("acceleration", acceleration, self.ranges)
        lower, upper = self.lower.copy(), self.upper.copy()
        share_limits(model, lower, upper, hardest, fastest, self._recovery)
        self._keep_between(lower, upper)
        self.max_velocity, self.max_acceleration = fastest, hardest
        self.velocity = np.zeros(model.nv)

    @property
    def _returning(self) -> Array:
        return np.where(np.isfinite(self.max_velocity), self.max_velocity, super()._returning)

    def note(self, velocity: npt.ArrayLike) -> None:
        """Store the joint velocity (nv,), commanded or measured, for the next step."""
        self.velocity = finite_array("velocity", velocity, (len(self.names),))

    def boxes(self, configuration: mink.Configuration, dt: float) -> tuple[Box, ...]:
        """The acceleration, velocity and position limits, one box each."""
        dt = number("dt", dt, above=0.0)
        change = self.max_acceleration * dt
        return (
            Box("acceleration", self.velocity - change, self.velocity + change),
            Box("velocity", -self.max_velocity, self.max_velocity),
            Box("position", *super().bounds(configuration, dt)),
        )

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """The intersection of the limits, rad/s or m/s, each (nv,)."""
        box = Intersection(self.boxes(configuration, dt), configuration.model)
        return box.lower, box.upper

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint outside its range, too fast, or too fast to stop in time."""
        dt = number("dt", dt, above=0.0)
        room = self._room(configuration.q)
        sentences = list(self._outside(room))
        speed = np.array((-self.velocity, self.velocity))
        braked = speed - self.max_acceleration * dt
        if (braked > 0.0).any():  # a joint that can stop in this step is not late
            within = self._fastest(np.maximum(room, 0.0) + NOTICEABLE, dt)
            for side, dof in np.argwhere((braked > within) & (room >= -NOTICEABLE)):
                unit = self.units[dof]
                sentences.append(
                    f"{self.names[dof]} moves at {speed[side, dof]:.3g} {unit}/s and cannot stop "
                    f"within the {room[side, dof]:.3g} {unit} to the {('lower', 'upper')[side]} "
                    "end of its range"
                )
        for dof in np.flatnonzero(np.abs(self.velocity) > self.max_velocity + NOTICEABLE):
            share = abs(self.velocity[dof]) / self.max_velocity[dof]
            sentences.append(f"{self.names[dof]} moves at {share:.3g} times its velocity limit")
        return tuple(sentences)

    def _fastest(self, room: Array, dt: float) -> Array:
        return stopping_speed(room, self.max_acceleration, dt)


def per_joint(
    name: str, value: Mapping[str, float] | npt.ArrayLike | None, ranges: JointRanges
) -> Array:
    """Limits above 0 by degree of freedom, (nv,); ∞ without a limit.

    They are stated by joint name (a ball or free joint's counts for each of its degrees of
    freedom), as a number for all, or as an array (nv,). Messages begin with ``name``.
    """
    nv, names = len(ranges.names), np.array(ranges.names)
    limits = np.full(nv, np.inf)
    if isinstance(value, Mapping):
        for joint, limit in value.items():
            dofs = names == joint
            if not dofs.any():
                raise InvalidInput(
                    "the model has no joint of that name; it has "
                    f"{', '.join(dict.fromkeys(ranges.names))}.",
                    key=f"{name}.{joint}",
                )
            limits[dofs] = _checked(f"{name}.{joint}", limit, ())
    elif value is not None:
        limits[:] = _checked(name, value, (nv,))
    return limits


def _checked(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    limits = float_array(name, value)
    if limits.shape not in ((), shape):
        raise InvalidInput(
            f"expected a number{f' or {shape[0]} of them' if shape else ''}, got an array "
            f"of shape {limits.shape}.",
            key=name,
        )
    if not (limits > 0.0).all():
        raise InvalidInput(f"expected numbers above 0, got {limits.tolist()}.", key=name)
    return limits

"""Joint position limits."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, number
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.limits.box_limit import BoxLimit

HAIR = 1e-12
"""How far inside its limit a joint stops, rad or m, so that q + q̇ dt is inside as rounded."""


class PositionLimit(BoxLimit):
    r"""Keep every joint in its range after the step.

    .. math:: (\theta_{min} - \theta)/dt \le \dot\theta \le (\theta_{max} - \theta)/dt

    A joint that starts outside has to come back at ``recovery_speed``, or faster if the task or a
    secondary wants it, instead of in one step: neither an error nor a snap. Velocity limits hold.
    """

    kind = "position"

    def __init__(self, model: mujoco.MjModel, *, recovery_speed: float = 0.5) -> None:
        """Read the ranges of a model.

        Args:
            model: The robot.
            recovery_speed: Speed at which a joint outside has to return, rad/s or m/s.

        Raises:
            InvalidInput: If a ball joint has a limit, which is not a bound on one velocity.
        """
        self.ranges = JointRanges.of(model)
        for joint in range(model.njnt):
            ball = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL
            if ball and model.jnt_limited[joint]:
                raise InvalidInput(
                    f"PositionLimit: ball joint {model.joint(joint).name!r} has a limit, which is "
                    "not a bound on one velocity; pass limits=[mink.ConfigurationLimit(model)]."
                )
        self.recovery_speed = number("recovery_speed", recovery_speed, above=0.0)

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """(θ_min − θ)/dt and (θ_max − θ)/dt, rad/s or m/s, each (nv,)."""
        q = self.ranges.positions(configuration.q)
        below, above = self.ranges.lower - q, self.ranges.upper - q
        # From inside, standing still is always allowed; from outside, the way back is not a jump.
        lower = np.where(below > 0.0, below / dt, np.minimum(below + HAIR, 0.0) / dt)
        upper = np.where(above < 0.0, above / dt, np.maximum(above - HAIR, 0.0) / dt)
        return np.minimum(lower, self.recovery_speed), np.maximum(upper, -self.recovery_speed)

"""Limits that keep each joint between two ends: its range, or a window for one waypoint."""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, checked, finite_array, float_array, number, read_only, revise
from qp_twist.constraints.box import BoxLimit
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kernel.constants import NOTICEABLE
from qp_twist.kinematics import JointRanges

STOPPING_CLEARANCE = 1e-12
"""Distance from its limit at which a joint stops, as a share of the limit (of 1 rad or m, if
larger), so that the rounded q + q̇ dt is inside."""


def array_attribute() -> Any:
    """An array (nv,) that may be infinite; read-only: assign another one to change it.

    Each assignment increments the limit's ``revision``, by which a compiled step notices it.
    """
    return checked(_copied)


def _copied(limit: Any, name: str, value: Any) -> Array:
    array, before = float_array(name, value), getattr(limit, f"_{name}", None)
    if before is not None and array.shape != before.shape:
        raise InvalidInput(f"{name}: expected an array of shape {before.shape}, got {array.shape}.")
    if np.isnan(array).any():
        raise InvalidInput(f"{name}: entries must be numbers or infinite, not NaN.")
    revise(limit)
    return read_only(array)


class JointRangeLimit(BoxLimit, Constraint):
    """Base of limits that keep each joint between two ends, rad or m, (nv,), which may be ±∞."""

    lower: Array
    upper: Array

    def __init__(self, model: mujoco.MjModel) -> None:
        self.ranges = JointRanges.of(model)
        self.names, self.units = self.ranges.names, self.ranges.units

    def margins(self, q: Array) -> Array:
        """Distance of each joint from the nearer end, rad or m, (N, nv)."""
        return np.asarray(self._room(q).min(axis=0))

    def gradients(self, q: Array) -> Array:
        """1 or −1 for each joint, (N, nv, nv)."""
        below, above = self._room(q)
        return np.where(below < above, 1.0, -1.0)[:, :, None] * np.eye(len(self.names))

    def change(self, q: Array, travel: Array) -> Array:
        """The travel of each joint, (N, nv)."""
        return travel

    def _room(self, q: Array) -> Array:
        """Distances from the lower and from the upper end, rad or m; negative outside."""
        positions = self.ranges.positions(q)
        return np.array((positions - self.lower, self.upper - positions))


class PositionLimit(JointRangeLimit):
    r"""Keep every joint in its range after the step.

    .. math:: (\theta_{min} - \theta)/dt \le \dot\theta \le (\theta_{max} - \theta)/dt

    A joint that starts outside returns at ``recovery_speed`` instead of in one step; this is not an
    error. Velocity and acceleration limits hold meanwhile.

    Attributes:
        lower: θ_min, rad or m, (nv,); −∞ without a limit. Another array may be assigned.
        upper: θ_max, (nv,), likewise; ∞ without a limit.
        rounding: Distance from θ_min and θ_max at which a joint stops, rad or m, (2, nv).
    """

    kind = "position"
    lower: Array = array_attribute()
    upper: Array = array_attribute()
    recovery_speed: float = checked(lambda _, name, value: number(name, value, above=0.0))
    revision: int

    def __init__(
        self, model: mujoco.MjModel, *, margin: float = 0.0, recovery_speed: float = 0.5
    ) -> None:
        """Read the ranges of a model; limited ball joints are refused.

        Args:
            model: The robot.
            margin: Distance by which the ranges are narrowed at either end, rad or m: a real joint
                lags behind its command, and overshoots.
            recovery_speed: Speed at which a joint outside returns, rad/s or m/s.
        """
        super().__init__(model)
        balls = (model.jnt_type == mujoco.mjtJoint.mjJNT_BALL) & (model.jnt_limited != 0)
        for joint in np.flatnonzero(balls).tolist():
            raise InvalidInput(
                f"{type(self).__name__}: ball joint {model.joint(joint).name!r} has a limit, which "
                "is not a bound on one velocity; pass limits=[mink.ConfigurationLimit(model)] "
                "instead."
            )
        self._recovery = np.ones(model.nv)
        self.recovery_speed = recovery_speed
        margin = number("margin", margin, at_least=0.0)
        lower, upper = self.ranges.lower + margin, self.ranges.upper - margin
        if (lower > upper).any():
            dof = int(np.argmax(lower > upper))
            raise InvalidInput(
                f"{type(self).__name__}: a margin of {margin:g} leaves nothing of the range of "
                f"{self.ranges.names[dof]}; give a smaller one."
            )
        self._keep_between(lower, upper)

    @property
    def _returning(self) -> Array:
        """Speed at which each joint returns from outside its range, rad/s or m/s, (nv,)."""
        return self._recovery * self.recovery_speed

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """(θ_min − θ)/dt and (θ_max − θ)/dt, rad/s or m/s, each (nv,)."""
        dt = number("dt", dt, above=0.0)
        room = self._room(configuration.q)
        # A joint inside its range, up to rounding, may always stand still.
        fastest = self._fastest(np.maximum(room - self.rounding, 0.0), dt)
        lower, upper = -fastest[0], fastest[1]
        if np.count_nonzero(room < -NOTICEABLE):
            (below, above), back = room < -NOTICEABLE, self._returning
            upper = np.where(below, np.minimum(upper, back), upper)
            lower = np.where(below, np.minimum(-room[0] / dt, upper), lower)
            lower = np.where(above, np.maximum(lower, -back), lower)
            upper = np.where(above, np.maximum(room[1] / dt, lower), upper)
        return lower, upper

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint outside its range."""
        return self._outside(self._room(configuration.q))

    def _outside(self, room: Array) -> tuple[str, ...]:
        """A sentence for each joint with a room below 0, (2, nv)."""
        if not np.count_nonzero(room < -NOTICEABLE):  # nearly always
            return ()
        return tuple(
            f"{self.names[dof]} is {-room[side, dof]:.3g} {self.units[dof]} "
            f"{('below', 'above')[side]} its range"
            for side, dof in np.argwhere(room < -NOTICEABLE)
        )

    def _keep_between(self, lower: Array, upper: Array) -> None:
        """Set θ_min and θ_max, (nv,), in place of the model's."""
        self.lower, self.upper = lower, upper
        ends = np.abs(np.array((lower, upper)))
        self.rounding = STOPPING_CLEARANCE * np.maximum(1.0, np.where(np.isfinite(ends), ends, 0.0))

    def _fastest(self, room: Array, dt: float) -> Array:
        """Largest speed towards a limit that is ``room`` (…, nv) away."""
        return room / dt


class DisplacementWindow(JointRangeLimit):
    r"""Keep :math:`|\theta - \theta_{ref}| \le w` for each joint.

    With w = v_max · Δt it is the velocity limit for a whole waypoint: all iterations of a waypoint
    together move a joint by at most w.
    """

    kind = "velocity"

    def __init__(
        self, model: mujoco.MjModel, q_ref: npt.ArrayLike, half_width: npt.ArrayLike
    ) -> None:
        """Open it at the last waypoint, q_ref (nq,), by w, rad or m, (nv,); ∞ without a limit."""
        super().__init__(model)
        self._nq = model.nq
        self.move(q_ref, half_width)

    def move(self, q_ref: npt.ArrayLike, half_width: npt.ArrayLike) -> None:
        """Move the window to ``q_ref``, for the next waypoint; arguments as above."""
        self.reference = self.ranges.positions(finite_array("q_ref", q_ref, (self._nq,)))
        self.half_width = float_array("half_width", half_width)
        if self.half_width.shape != self.reference.shape or not (self.half_width >= 0.0).all():
            raise InvalidInput(
                f"DisplacementWindow: half_width needs {len(self.reference)} numbers of at least "
                f"0, got {half_width!r}."
            )
        self.lower = self.reference - self.half_width
        self.upper = self.reference + self.half_width

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """(θ_ref ∓ w − θ)/dt, rad/s or m/s, each (nv,)."""
        below, above = self._room(configuration.q) / number("dt", dt, above=0.0)
        # Rounding may leave the joint an ulp outside its window: standing still is always allowed.
        return np.minimum(-below, 0.0), np.maximum(above, 0.0)

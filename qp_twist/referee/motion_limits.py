"""Speed, acceleration and jerk limits of the joints, and where each is from.

A limit is the task's, else that of the robot's data sheet in the package, else a default that has
its name in every verdict. It is never taken from the trajectory that is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask

RAMP_S = 0.25
"""Time from rest to the largest speed by default, s: what is assumed of a joint whose acceleration
limit nobody states. Industrial arms take 0.1 to 0.5 s."""
RISE_S = 0.05
"""Time in which an acceleration rises to its limit by default, s: what is assumed of a joint whose
jerk limit nobody states. It is a fifth of ``RAMP_S``."""
_SPEED = {"rad": np.pi, "m": 1.0}
"""Speed in place of an unknown limit for the default acceleration, rad/s and m/s."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Largest joint speeds, accelerations and jerks, (nv,); ∞ without a limit.

    ``speeds_of`` is the known robot whose data sheet some speeds are from; ``accelerations_of`` and
    ``jerks_of`` where the accelerations and jerks are from that the task does not state; else
    empty.
    """

    velocity: Array
    acceleration: Array
    speeds_of: str = ""
    accelerations_of: str = ""
    jerk: Array = None  # type: ignore[assignment]  # none: ∞
    jerks_of: str = ""

    def __post_init__(self) -> None:
        if self.jerk is None:
            object.__setattr__(self, "jerk", np.full_like(self.acceleration, np.inf))

    @classmethod
    def of(cls, path_task: PathTask) -> MotionLimits:
        """Those that the task states."""
        found = cls(path_task.velocity_limits, path_task.acceleration_limits)
        jerk = path_task.jerk_limits
        return found if jerk is None else replace(found, jerk=jerk)

    def filled(self, accelerations: Array, source: str) -> MotionLimits:
        """With accelerations, (nv,), in place of those that are not known."""
        if np.isfinite(self.acceleration).all():
            return self
        found = np.where(np.isfinite(self.acceleration), self.acceleration, accelerations)
        if (found == self.acceleration).all():
            return self
        sources = [name for name in (self.accelerations_of, source) if name]
        return replace(self, acceleration=found, accelerations_of=", ".join(sources))


def motion_limits(path_task: PathTask) -> MotionLimits:
    """The limits of a task (its file's, or its URDF's), else of its robot, if that is a known one.

    A known robot is one of the table ``known_robots.toml``, matched by name and geometry.
    """
    known = MotionLimits.of(path_task)
    finite = np.isfinite([known.velocity, known.acceleration])
    if finite.all() or path_task.known_limits is None:
        return known
    robot, speeds, accelerations = path_task.known_limits
    velocity = np.where(finite[0], known.velocity, speeds)
    if (velocity != known.velocity).any():
        known = replace(known, velocity=velocity, speeds_of=robot.name)
    return known.filled(accelerations, f"the {robot.name}'s data sheet")


def with_default_accelerations(limits: MotionLimits, ranges: JointRanges) -> MotionLimits:
    """The limits, with the largest speed within 0.25 s (``RAMP_S``) where no acceleration is known.

    A joint without a known speed counts as one of π rad/s or 1 m/s.
    """
    accelerations = speeds_or_default(limits, ranges) / RAMP_S
    return limits.filled(accelerations, f"the default: full speed within {RAMP_S:g} s")


def with_default_jerks(limits: MotionLimits) -> MotionLimits:
    """The limits, with full acceleration within 50 ms (``RISE_S``) where no jerk is known."""
    found = np.where(np.isfinite(limits.jerk), limits.jerk, limits.acceleration / RISE_S)
    if (found == limits.jerk).all():
        return limits
    source = f"the default: full acceleration within {1e3 * RISE_S:g} ms"
    return replace(limits, jerk=found, jerks_of=source)


def speeds_or_default(limits: MotionLimits, ranges: JointRanges) -> Array:
    """The largest speeds of the joints, π rad/s and 1 m/s where none is known, (nv,)."""
    unknown = np.array([_SPEED.get(unit, 1.0) for unit in ranges.units])
    return np.where(np.isfinite(limits.velocity), limits.velocity, unknown)

"""Smooth joint motions, and limits that are as tight as they can be without being in the way."""

from __future__ import annotations

import mujoco
import numpy as np

from qp_twist.bench.problem import DT, STEPS
from qp_twist.checks import Array

HAIR = 2e-3
"""What the ranges are wider than the motion, at either end, rad."""
SLACK = 1.15
"""Velocity limits, as multiples of each joint's largest speed on the motion."""
SMALLEST_SIGMA = 0.03
"""Least singular value of the task rows along a trajectory, m/rad or 1."""


def joint_motion(
    middle: Array, amplitude: float, rng: np.random.Generator, steps: int = STEPS
) -> Array:
    """A closed motion of two harmonics a joint around ``middle`` (n,), rad, (steps + 1, n)."""
    t = np.linspace(0.0, 2.0 * np.pi, steps + 1)[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(middle)))
    share = rng.uniform(0.15, 0.35, len(middle))
    wave = np.sin(t + phase[0]) + share * np.sin(2.0 * t + phase[1])
    size = amplitude * rng.uniform(0.6, 1.0, len(middle))
    motion: Array = middle + size * wave / (1.0 + share)
    return motion


def set_ranges(model: mujoco.MjModel, q: Array) -> None:
    """Narrow the ranges of all joints to what a motion takes, and a hair."""
    model.jnt_range[:, 0] = q.min(axis=0) - HAIR
    model.jnt_range[:, 1] = q.max(axis=0) + HAIR
    model.jnt_limited[:] = 1


def speeds_of(q: Array) -> Array:
    """Velocity limits a little above what a motion takes, rad/s, (n,)."""
    speeds: Array = SLACK * np.abs(np.diff(q, axis=0)).max(axis=0) / DT
    return speeds

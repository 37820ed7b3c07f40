"""The smooth curve of a path that lies on the end of a joint's range stays inside."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles.arms import planar_arm, random_arm
from oracles.joint_paths import joint_path
from scipy.interpolate import BPoly

import qp_twist as qt
from qp_twist.referee import MotionLimits, with_default_jerks
from qp_twist.trajectories import refine_trajectory, time_trajectory

FASTEST, HARDEST = 5.0, 20.0
"""rad/s and rad/s² of every joint."""


def on_a_limit(rng: np.random.Generator) -> qt.Trajectory:
    """A random arm along a random path, one joint of which is held up somewhere on its way."""
    in_plane = rng.uniform() < 0.5
    joints = int(rng.integers(3, 6)) + (not in_plane)
    model = random_arm(rng, joints)
    linear = qt.Projector.full()
    if in_plane:
        model = planar_arm(rng.uniform(0.3, 1.0, size=joints).tolist(), "tool")
        linear = qt.Projector.plane([0, 0, 1])
    count, start = int(rng.integers(12, 30)), rng.uniform(-1.0, 1.0, size=joints) + 1.0
    q = start + np.linspace(0.0, 1.0, count)[:, None] * rng.normal(size=joints)
    durations = np.append(0.0, np.full(count - 1, rng.uniform(0.03, 0.2)))
    position = qt.TwistProjector(linear=linear, angular=qt.Projector.none())
    task = joint_path(model, q, durations, FASTEST, HARDEST, position).path_task
    model.jnt_range[:] = [-9.0, 9.0]
    way = qt.follow(task, "qp_minimum_norm", slow_down=True).q[:, (joint := rng.integers(joints))]
    there = way[0] + rng.uniform(0.2, 0.8) * (way - way[0])[np.abs(way - way[0]).argmax()]
    model.jnt_range[joint] = (-9.0, there) if there > way[0] else (there, 9.0)
    task = dataclasses.replace(task, model=model)
    return refine_trajectory(qt.follow(task, "qp_minimum_norm", slow_down=True))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_a_curve_beside_the_end_of_a_range_keeps_it_and_all_else(seed: int) -> None:
    run = on_a_limit(np.random.default_rng(seed))
    task = run.path_task
    assume(run.passes and run.between.position.bound.max() <= 1e-4)
    limits = with_default_jerks(MotionLimits.of(task))
    timed = time_trajectory(run, limits=limits)
    rows = zip(timed.q, timed.velocities, timed.accelerations, strict=True)
    motion = BPoly.from_derivatives(timed.times, list(rows))
    q = motion(np.arange(0.0, timed.times[-1], 1e-3))
    allowed = np.radians(0.5e-4)  # half a unit of the fourth decimal of a degree in a program
    lower, upper = task.model.jnt_range.T
    assert np.maximum(lower - q, q - upper).max() <= allowed
    for order, most in enumerate((FASTEST, HARDEST, limits.jerk), start=1):
        assert (
            np.abs(np.diff(q, n=order, axis=0)) <= most * 1e-3**order * (1 + 1e-6) + 1e-14
        ).all()
    # The tool against the lines from waypoint to waypoint.
    data, tool = mujoco.MjData(task.model), []
    for row in q:
        data.qpos = row
        mujoco.mj_kinematics(task.model, data)
        tool.append(data.site("tool").xpos.copy())
    points = np.array([waypoint.translation() for waypoint in task.waypoints])
    a, d = points[:-1], np.diff(points, axis=0)
    from_a = np.array(tool)[:, None] - a
    along = np.clip((from_a * d).sum(axis=2) / (d**2).sum(axis=1), 0.0, 1.0)
    off = np.linalg.norm(from_a - along[:, :, None] * d, axis=2).min(axis=1)
    assert off.max() <= 1e-4

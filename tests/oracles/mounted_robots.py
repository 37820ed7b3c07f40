"""Known robots of the table in models of random zeros and signs, and their motions along paths."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np

import qp_twist as qt
from oracles.remodelled import remodelled
from qp_twist.robots import ControllerJoints, KnownRobot, named_robot
from qp_twist.trajectories import TimedPath, joints_of

Array = np.ndarray
FULL = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
AXIS = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="target"
)


class Mounted(NamedTuple):
    """A robot in a model, at a posture q, with its tool at ``start``."""

    robot: KnownRobot
    model: mujoco.MjModel
    q: Array
    start: mink.SE3

    def task(
        self, title: str, waypoints: Sequence[mink.SE3], durations: Array, **more: Any
    ) -> qt.PathTask:
        """A path of its tool, whose axis has to stay; ``more`` replaces what a task has."""
        given = {
            "projector": AXIS, "operational": FULL, "velocity_limits": self.robot.speeds,
            "acceleration_limits": np.full(6, np.inf), **more,
        }  # fmt: skip
        return qt.PathTask(
            name=title, title=title, source=None, scene=Path(f"{title}.xml"), model=self.model,
            frame_name="tool", frame_type="site", waypoints=tuple(waypoints),
            flipped_waypoints=None, start=self.q, durations=durations, **given,
        )  # fmt: skip


def mounted(name: str, theta: Sequence[float]) -> Mounted:
    """A robot at θ, degrees, with signs and zeros that are the same each time."""
    robot, rng = named_robot(name), np.random.default_rng(len(name))
    signs, offsets = rng.choice([-1.0, 1.0], 6), np.zeros(6)
    offsets[1:3] = np.radians(rng.choice([-90.0, 0.0, 90.0, 180.0], 2))
    model = remodelled(robot, signs, offsets, (0.1, -0.2, 0.3), "tool")
    q = (np.radians(theta) - offsets) * signs
    start = mink.Configuration(model, q).get_transform_frame_to_world("tool", "site")
    return Mounted(robot, model, q, start)


def timed_rows(task: qt.PathTask, name: str) -> tuple[TimedPath, ControllerJoints]:
    """A motion along the task, and how the controller counts its joints."""
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    rows = TimedPath.of(qt.time_trajectory(trajectory))
    return rows, joints_of(task, rows.joint_names, robot=name)


def beside(task: qt.PathTask, points: Array) -> tuple[Array, Array, Array]:
    """Of points (K, 3): distances from the path, how many waypoints on, and its axis there."""
    places = np.array([w.translation() for w in task.waypoints])
    axes = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])
    begin, ways = places[:-1], np.diff(places, axis=0)
    along = ((points[:, None] - begin) * ways).sum(axis=2) / (ways**2).sum(axis=1)
    along = np.clip(along, 0.0, 1.0)
    apart = np.linalg.norm(points[:, None] - begin - along[..., None] * ways, axis=2)
    k, rows = apart.argmin(axis=1), np.arange(len(points))
    u = along[rows, k]
    axis = (1.0 - u)[:, None] * axes[k] + u[:, None] * axes[k + 1]
    return apart[rows, k], k + u, axis

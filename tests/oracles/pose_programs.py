"""Programs of poses: tasks of robots by their data sheets, and how their controllers move."""

import re
from typing import NamedTuple

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import qp_twist as qt
from oracles.mounted_robots import beside, mounted, timed_rows
from oracles.program_simulator import N, angles_pose, rigid
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import TimedPath

Array = np.ndarray
ROBOTS = {
    "ABB IRB 120": (10.0, 20.0, 10.0, 5.0, 50.0, 20.0),
    "ABB IRB 4600-60/2.05": (-20.0, 20.0, 10.0, 95.0, -40.0, -20.0),
    "KUKA KR 16-2": (10.0, -70.0, 95.0, 5.0, 50.0, 200.0),
    "KUKA KR 6 R900 sixx": (-30.0, -70.0, 95.0, 5.0, -50.0, 20.0),
}


class Case(NamedTuple):
    """A task of a robot, its motion, and how its controller counts."""

    task: qt.PathTask
    rows: TimedPath
    joints: ControllerJoints
    name: str

    @property
    def suffix(self) -> str:
        return ".mod" if self.name.startswith("ABB") else ".src"


def case_of(name: str) -> Case:
    """A wave of 120 mm whose axis leans by up to 2°, about a posture of the robot."""
    arm = mounted(name, ROBOTS[name])
    waypoints = []
    for share in np.linspace(0.0, 1.0, 121):
        wave = np.sin(np.pi * share)
        turn = mink.SO3.exp(np.radians(2.0) * np.array([wave, share, 0.0]))
        move = np.array([0.06 * (2.0 * share - 1.0), 0.01 * wave, 0.0])
        waypoints.append(arm.start @ mink.SE3.from_rotation_and_translation(turn, move))
    durations = np.append(0.0, np.full(120, 0.015))
    task = arm.task("loop", waypoints, durations, acceleration_limits=np.full(6, 20.0))
    return Case(task, *timed_rows(task, name), name)


def krl_frame(text: str) -> Array:
    return angles_pose(*(float(re.search(rf"\b{key} ({N})", text)[1]) for key in "XYZABC"))  # type: ignore[index]


def site_of(data: mujoco.MjData) -> Array:
    return rigid(data.site("tool").xmat.reshape(3, 3), data.site("tool").xpos)


def corrected(
    model: mujoco.MjModel, data: mujoco.MjData, point: Array, R: Array, steps: int = 6
) -> None:
    """Newton's method to a pose nearby, by MuJoCo's Jacobian."""
    J = np.zeros((6, 6))
    for _ in range(steps):
        now = site_of(data)
        off = np.append(point - now[:3, 3], Rotation.from_matrix(R @ now[:3, :3].T).as_rotvec())
        if np.abs(off).max() < 1e-9:
            return
        mujoco.mj_jacSite(model, data, J[:3], J[3:], data.site("tool").id)
        data.qpos[:] += np.linalg.solve(J, off)
        mujoco.mj_forward(model, data)
    raise AssertionError("the joints do not follow")


def two_angles(begin: Array, end: Array, shares: Array, axis: Array) -> Array:
    """An axis of the tool swings on the great circle, the tool turns about it: KUKA's #VAR."""
    a, b = begin @ axis, end @ axis
    normal = np.cross(a, b)
    size = np.linalg.norm(normal)
    swing = np.arctan2(size, a @ b) * normal / max(size, 1e-15)
    swung = Rotation.from_rotvec(swing).as_matrix() @ begin
    twist = Rotation.from_matrix(swung.T @ end).as_rotvec()
    before = Rotation.from_rotvec(shares[:, None] * swing).as_matrix()
    return before @ begin @ Rotation.from_rotvec(shares[:, None] * twist).as_matrix()


def on_path(task: qt.PathTask, points: Array) -> Array:
    """The path's axis beside points (K, 3), (K, 3), which are on the path."""
    apart, _, axis = beside(task, points)
    assert apart.max() <= 1e-4
    return axis / np.linalg.norm(axis, axis=1)[:, None]

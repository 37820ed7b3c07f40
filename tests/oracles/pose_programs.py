"""Programs of poses: tasks of robots by their data sheets, and a reading of texts of its own."""

from __future__ import annotations

import re
from typing import NamedTuple

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import qp_twist as qt
from oracles.data_sheets import about
from oracles.mounted_robots import mounted, timed_rows
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import TimedPath

Array = np.ndarray
N = r"-?\d+\.?\d*"
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


def rigid(rotation: Rotation, position: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), position
    return pose


def krl_frame(text: str) -> Array:
    x, y, z, a, b, c = (float(re.search(rf"\b{key} ({N})", text)[1]) for key in "XYZABC")  # type: ignore[index]
    turn = about("z", a) @ about("y", b) @ about("x", c)
    turn[:3, 3] = 1e-3 * np.array([x, y, z])
    return turn


def rapid_frame(text: str) -> Array:
    x, y, z, qw, qx, qy, qz = (float(each) for each in re.findall(N, text)[:7])
    return rigid(Rotation.from_quat([qx, qy, qz, qw]), 1e-3 * np.array([x, y, z]))


class Written(NamedTuple):
    """A program, read by expressions of the test's own."""

    tool: Array | None
    frame: Array | None
    start: Array
    poses: list[Array]
    data: list[tuple[int, ...]]
    seconds: list[float | None]
    stops: list[bool]


def written(text: str) -> Written:
    """What a program states; times of moves are found when the way is known."""
    if "MODULE" in text:
        tool = re.search(r"tooldata \w+:=\[TRUE,(.*)", text)
        frame = re.search(r"wobjdata \w+:=\[FALSE,TRUE,\"\",(.*)", text)
        moves = re.findall(
            r"MoveL \[(\[.*?\],\[.*?\]),\[([-\d,]+)\],\[[9E,]+\]\],\[(.*?)\],(\w+)", text
        )
        first = re.search(r"MoveAbsJ \[\[(.*?)\]", text)
        assert first
        poses = [rapid_frame(pose) for pose, *_ in moves]
        data = [tuple(map(int, each.split(","))) for _, each, *_ in moves]
        speeds = [tuple(map(float, each.split(",")[:2])) for *_, each, _ in moves]
        speeds = [(1e-3 * v, np.radians(w)) for v, w in speeds]
        of = rapid_frame
        stops = [zone == "fine" for *_, zone in moves]
    else:
        tool = re.search(r"^\$TOOL=(\{.*)", text, re.M)
        frame = re.search(r"^\$BASE=(\{.*)", text, re.M)
        first = re.search(r"^PTP \{(.*)\}", text, re.M)
        assert first
        speeds, now, stops, poses, data = [], {}, [], [], []
        for line in text.splitlines():
            if found := re.fullmatch(rf"\$VEL\.(\w+)=({N})", line):
                now[found[1]] = float(found[2])
            elif line.startswith("LIN"):
                poses.append(krl_frame(line))
                data.append(tuple(map(int, re.search(r"S (\d+),T (\d+)", line).groups())))  # type: ignore[union-attr]
                assert now["ORI1"] == now["ORI2"]
                speeds.append((now["CP"], np.radians(now["ORI1"])))
                stops.append("C_DIS" not in line)
        of = krl_frame
    start = np.array([float(each) for each in re.findall(rf"(?:A\d )?({N})(?:,|$)", first[1])])
    return Written(
        of(tool[1]) if tool else None, of(frame[1]) if frame else None, start, poses, data,
        speeds, stops,  # type: ignore[arg-type]
    )  # fmt: skip


def site_of(data: mujoco.MjData) -> Array:
    return rigid(Rotation.from_matrix(data.site("tool").xmat.reshape(3, 3)), data.site("tool").xpos)


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
    places = np.array([w.translation() for w in task.waypoints])
    axes = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])
    begin, ways = places[:-1], np.diff(places, axis=0)
    along = ((points[:, None] - begin) * ways).sum(axis=2) / (ways**2).sum(axis=1)
    along = np.clip(along, 0.0, 1.0)
    apart = np.linalg.norm(points[:, None] - begin - along[..., None] * ways, axis=2)
    k = apart.argmin(axis=1)
    rows = np.arange(len(k))
    assert apart[rows, k].max() <= 1e-4
    u = along[rows, k][:, None]
    axis = (1.0 - u) * axes[k] + u * axes[k + 1]
    return axis / np.linalg.norm(axis, axis=1)[:, None]

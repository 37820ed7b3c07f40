"""Robots of data sheets, on a rail or beside a positioner, with a path: for all languages."""

from pathlib import Path
from typing import NamedTuple

import mink
import numpy as np

import qp_twist as qt
from oracles.mounted_robots import AXIS, FULL, beside
from oracles.program_simulator import Cell, Motion
from oracles.remodelled import remodelled
from qp_twist.referee import MotionLimits
from qp_twist.robots import ControllerJoints, named_robot
from qp_twist.trajectories import TimedPath, joints_of

Array = np.ndarray
SUFFIX = {"ABB": ".mod", "KUKA": ".src", "Fanuc": ".ls", "Universal": ".script"}
POSTURES = {
    "ABB": (10.0, 20.0, 10.0, 5.0, 50.0, 20.0),
    "KUKA": (10.0, -70.0, 95.0, 5.0, 50.0, 200.0),
    "Fanuc": (10.0, 10.0, -20.0, 20.0, -60.0, 20.0),
    "Universal": (10.0, -80.0, 100.0, -110.0, -80.0, 20.0),
}
"""θ at the start of the path, degrees."""
AXES = {
    ".mod": {"rail": ("eax_a",), "positioner": ("eax_a", "eax_b")},
    ".src": {"rail": ("E1",), "positioner": ("E1", "E2")},
    ".ls": {"rail": ("E1",), "positioner": ("GP2_J1", "GP2_J2")},
}
LENGTH, POINTS, SPEED = 0.2, 101, 0.1
"""Of the path, m, the number of its waypoints, and the tool's, m/s."""


class Job(NamedTuple):
    """A task, its motion, how its controller counts, and the cell for the simulator."""

    task: qt.PathTask
    rows: TimedPath
    joints: ControllerJoints
    cell: Cell
    suffix: str
    limits: MotionLimits


def job_of(name: str, extra: str = "", length: float = LENGTH, count: int = POINTS,
    acceleration: float = np.inf,
) -> Job:  # fmt: skip
    """A wave whose axis leans by up to 30° per m, with ``"rail"`` or ``"positioner"``.

    Timed within the defaults: full speed in 0.25 s, full acceleration in 50 ms; or within a limit
    of accelerations of the task.
    """
    maker, robot = name.split(maxsplit=1)[0], named_robot(name)
    rng = np.random.default_rng(len(name) + len(extra))
    signs, offsets = rng.choice([-1.0, 1.0], 6), np.zeros(6)
    offsets[1:3] = np.radians(rng.choice([-90.0, 0.0, 90.0, 180.0], 2))
    base = (0.1, -0.2, 0.3)
    q = (np.radians(POSTURES[maker]) - offsets) * signs
    plain = remodelled(robot, signs, offsets, base, "tool")
    start = mink.Configuration(plain, q).get_transform_frame_to_world("tool", "site")
    under = beside = ""
    others: Array = np.zeros(0)
    if extra == "rail":
        under = '<joint name="rail" type="slide" axis="0.6 0.8 0" range="-1 1"/><geom size="0.01"/>'
        others = np.array([0.25])
    if extra == "positioner":
        x, y, z = start.translation() + np.array([0.05, 0.1, -0.1])
        beside = (
            f'<body name="frame" pos="{x} {y} {z}"><joint name="tilt" axis="1 0 0" range="-1 1"/>'
            '<geom size="0.01"/><body name="plate"><joint name="turn" axis="0 0 1" range="-3 3"/>'
            '<geom size="0.01"/></body></body>'
        )
        others = np.array([0.2, -0.4])
    model = remodelled(robot, signs, offsets, base, "tool", under, beside)
    at = np.concatenate([others, q] if extra == "rail" else [q, others])
    here = mink.Configuration(model, at)
    begin = here.get_transform_frame_to_world("tool", "site")
    part = "plate" if extra == "positioner" else "world"
    if part == "plate":
        begin = here.get_transform_frame_to_world("plate", "body").inverse() @ begin
    waypoints = []
    for share in np.linspace(0.0, 1.0, count):
        wave = np.sin(2.0 * np.pi * share)
        turn = mink.SO3.exp(np.radians(30.0) * length * np.array([wave, share, 0.0]))
        move = length * np.array([share, 0.1 * wave, 0.0])
        waypoints.append(begin @ mink.SE3.from_rotation_and_translation(turn, move))
    ways = np.linalg.norm(np.diff([w.translation() for w in waypoints], axis=0), axis=1)
    fast = np.concatenate([np.ones(len(others)), robot.speeds] if extra == "rail"
                          else [robot.speeds, np.ones(len(others))])  # fmt: skip
    task = qt.PathTask(
        name="wave", title="wave", source=None, scene=Path("wave.xml"), model=model,
        frame_name="tool", frame_type="site", projector=AXIS, operational=FULL,
        waypoints=tuple(waypoints), flipped_waypoints=None, start=at,
        durations=np.append(0.0, ways / SPEED), velocity_limits=fast,
        acceleration_limits=np.full(model.nv, acceleration),
        relative_to="plate" if part == "plate" else None,
    )  # fmt: skip
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    of_task, limits = (
        MotionLimits(v, np.minimum(v / 0.25, acceleration), jerk=v / 0.0125)
        for v in (task.velocity_limits, fast)
    )
    rows = TimedPath.of(qt.time_trajectory(trajectory, limits=of_task))
    names = tuple(model.joint(k).name for k in range(model.njnt))
    suffix = SUFFIX[maker]
    degrees = float(np.degrees(1.0))
    of = {"rail": (("rail", 1e3),), "positioner": (("tilt", degrees), ("turn", degrees))}
    external = dict(zip(AXES.get(suffix, {}).get(extra, ()), of.get(extra, ()), strict=False))
    arm = tuple(f"joint_{k}" for k in range(1, 7))
    cell = Cell(name, model, arm, signs, offsets, external, part)
    return Job(task, rows, joints_of(task, names, robot=name), cell, suffix, limits)


class Found(NamedTuple):
    """Largest errors of a motion: m, rad, and shares of the joints' limits."""

    off_path: float
    off_axis: float
    off_ends: float
    speed: float
    acceleration: float


def measured(job: Job, motion: Motion) -> Found:
    """How far the tool is from the path, how far its axis leans, and how fast joints are.

    Also how far the ends of the path are from those of the motion, and whether it goes on along it.
    """
    points, axes = motion.poses[:, :3, 3], motion.poses[:, :3, 2]
    apart, on, axis = beside(job.task, points)
    assert (np.diff(on) > -1e-2).all(), "the tool goes back on its path"
    sines = np.linalg.norm(np.cross(axis / np.linalg.norm(axis, axis=1)[:, None], axes), axis=1)
    ends = points[[0, -1]] - job.task.positions[[0, -1]]
    spans = np.diff(motion.times)[:, None]
    rates = np.diff(motion.q, axis=0) / spans
    accelerations = np.diff(rates, axis=0) / (0.5 * (spans[:-1] + spans[1:]))
    return Found(
        float(apart.max()), float(np.arcsin(sines.max())),
        float(np.linalg.norm(ends, axis=1).max()),
        float((np.abs(rates) / job.limits.velocity).max()),
        float((np.abs(accelerations) / job.limits.acceleration).max()),
    )  # fmt: skip

"""Random joint trajectories for robot programs."""

import numpy as np

from qp_twist.robots import KNOWN_ROBOTS, ControllerJoints, KnownRobot
from qp_twist.trajectories import TimedPath

BY_PROGRAM: dict[str, list[KnownRobot]] = {}
for _robot in KNOWN_ROBOTS:
    if _robot.program:
        BY_PROGRAM.setdefault(_robot.program, []).append(_robot)
DECIMALS = {"urscript": (10, 11), "rapid": (5, 5), "krl": (5, 5), "ls": (4, 3)}
"""Digits after the point that a language prints: of angles in its unit, of times in s."""


def random_rows(
    seed: int, program: str, *, velocities: bool = False, step: float = 0.01
) -> tuple[TimedPath, ControllerJoints]:
    """A trajectory inside the ranges of a random robot of a language, and how joints are counted.

    Signs and the zero positions of shoulder and elbow of the model are random, too.
    """
    rng = np.random.default_rng(seed)
    robot = BY_PROGRAM[program][rng.integers(len(BY_PROGRAM[program]))]
    names = [f"joint_{k}" for k in range(1, 7)]
    signs = rng.choice([-1.0, 1.0], 6)
    offsets = np.zeros(6)
    offsets[1:3] = np.radians(rng.choice([-90.0, 0.0, 90.0, 180.0], 2))
    joints = ControllerJoints(
        tuple(names), signs, offsets, robot.coupling, robot.range_deg, robot.name, program, "test"
    )
    count = int(rng.integers(2, 40))
    low, high = np.radians(np.array(robot.range_deg or [[-60.0, 60.0]] * 6)).T
    start = rng.uniform(0.6 * low, 0.6 * high)
    theta = start + np.cumsum(rng.normal(scale=step, size=(count, 6)), axis=0)
    theta = np.clip(theta, low, high)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.004, 0.4, count - 1))])
    rates = rng.normal(scale=0.2, size=(count, 6)) if velocities else None
    metadata = {"task": f"task_{seed}", "units": dict.fromkeys(names, "rad"), "method": "none"}
    return TimedPath(tuple(names), signs * (theta - offsets), times, rates, metadata), joints

"""PlaCo's own step, on a robot that is written as URDF for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from qp_twist.bench.contender import Asked, Contender, StepOf, tool_axes
from qp_twist.bench.pink_steps import bench_urdf
from qp_twist.bench.problem import DT, Problem
from qp_twist.errors import InvalidInput
from qp_twist.following.peer import peer_module
from qp_twist.kinematics import JointRanges

POSTURE = {"hard": 1.0, "soft": 1e-6, "scaled": 1e-4}
"""Weight of the posture by the tasks' priority.

Beside soft tasks it is the square of pink's cost. A scale is itself a soft cost, of weight 1, which
PlaCo does not let anyone change: a posture of weight 1 buys motion with it where the whole task
fits. With 1e-4 the task is whole to 2e-7, and PlaCo's own regularisation of 1e-8 is still small.
"""


def placo_steps() -> list[Contender]:
    """Tasks hard, soft, and scaled down together."""
    return [
        Contender(
            f"placo:{priority}",
            f"KinematicsSolver.solve, {priority} tasks",
            Asked.COMMON if priority == "hard" else Asked.OTHER,
            partial(_prepare, priority),
            missing,
            tool_axes,
        )
        for priority in ("hard", "soft", "scaled")
    ]


def missing() -> str | None:
    """Why PlaCo cannot take part."""
    try:
        peer_module("placo", "placo")
    except InvalidInput as error:
        return str(error)
    return None


def _prepare(priority: str, problem: Problem) -> Callable[[], StepOf]:
    placo = peer_module("placo", "placo")
    robot: Any = placo.RobotWrapper("", placo.Flags.ignore_collisions, bench_urdf(problem))
    names = JointRanges.of(problem.model).names
    state = np.array([robot.get_joint_offset(name) for name in names])
    rates = np.array([robot.get_joint_v_offset(name) for name in names])
    places = [[pose.translation() for pose in poses] for poses in problem.targets]
    axes = [[pose.rotation().as_matrix()[:, 2] for pose in poses] for poses in problem.targets]
    wishes = [
        dict(zip(names, (q + problem.gain * (problem.middle - q)).tolist(), strict=True))
        for q in problem.q[:-1]
    ]
    z = np.array([0.0, 0.0, 1.0])

    def make() -> StepOf:
        solver = placo.KinematicsSolver(robot)
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        solver.dt = DT
        points, turns = [], []
        for i in range(len(problem.frames)):
            frame = f"frame_{i}"
            points.append(solver.add_position_task(frame, np.zeros(3)))
            points[-1].configure(f"position {i}", priority, 1.0)
            turns.append(solver.add_axisalign_task(frame, z, z))
            turns[-1].configure(f"axis {i}", priority, 1.0)
        wish = solver.add_joints_task()
        wish.configure("posture", "soft", POSTURE[priority])
        q_robot = robot.state.q.copy()

        def step(k: int) -> Any:
            q_robot[state] = problem.q[k]
            robot.state.q = q_robot
            robot.update_kinematics()
            for point, turn, place, axis in zip(points, turns, places[k], axes[k], strict=True):
                point.target_world = place
                turn.targetAxis_world = axis
            wish.set_joints(wishes[k])
            return solver.solve(True)[rates] / DT

        return step

    return make

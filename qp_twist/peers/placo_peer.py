"""PlaCo's own step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import Projector, ProjectorKind
from qp_twist.kinematics import JointRanges
from qp_twist.peers.peer import Peer, PeerFrame, PeerProblem, PeerStep
from qp_twist.peers.urdf import URDF_UNLIMITED, link_name, robot_urdf

KEPT = {ProjectorKind.PLANE: "xy", ProjectorKind.LINE: "z"}
"""The axes that a block keeps, where its own is z."""
Z = np.array([0.0, 0.0, 1.0])


class PlacoPeer(Peer):
    """``placo.KinematicsSolver``, the frames at any priority; it reads the robot from URDF.

    It has its own QP solver. An infeasible hard task raises; a scaled one is met at the reported
    scale. A weight is a squared cost.
    """

    failures = (RuntimeError,)
    needs = (("placo", "placo"),)
    priorities = ("soft", "hard", "scaled")

    def __init__(self, problem: PeerProblem) -> None:
        """Read the robot."""
        super().__init__(problem)
        [self.placo] = self.modules()
        self.robot: Any = self.placo.RobotWrapper(
            "",
            self.placo.Flags.ignore_collisions,
            robot_urdf(problem.model, problem.frames, problem.speeds),
        )
        self.names = JointRanges.of(problem.model).names
        self.costs = np.broadcast_to(np.asarray(problem.costs), len(self.names))
        # A PlaCo task has one weight: joints with the same cost share a task.
        self.alike = [np.flatnonzero(self.costs == cost) for cost in dict.fromkeys(self.costs)]

    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """Position, orientation or axis, and along which axes of the world they count."""
        goals: list[Any] = []
        rotation = target.rotation().as_matrix()
        world = frame.minimal.in_world(here.rotation().as_matrix(), rotation)
        if world.linear.rank:
            goals.append(target.translation())
            if world.linear.kind in KEPT:
                goals.append(_axes(world.linear))
        if world.angular.kind is ProjectorKind.PLANE:
            axis, direction = frame.axis(rotation)
            goals += [axis, direction] if frame.axis_in_world else [direction]
        elif world.angular.rank:
            goals.append(rotation)
            if world.angular.kind in KEPT:
                goals.append(_axes(world.angular))
        return goals

    def posture_goals(self, q: Array, gain: float) -> list[Any]:
        """Desired joint positions after the step, by name, for each of their tasks."""
        there = (q + gain * (self.problem.posture - q)).tolist()
        return [{self.names[i]: there[i] for i in joints} for joints in self.alike]

    def step(self) -> PlacoStep:
        """Tasks of position and orientation at one priority, a posture below, limits."""
        return PlacoStep(self)


class PlacoStep(PeerStep):
    """A ``placo.KinematicsSolver`` with its tasks."""

    def __init__(self, peer: PlacoPeer) -> None:
        """Create them, without immovable rows: PlaCo refuses these if they are hard."""
        problem = peer.problem
        self.robot, self.scaled = peer.robot, problem.priority == "scaled"
        self.solver: Any = peer.placo.KinematicsSolver(peer.robot)
        self.solver.mask_fbase(True)
        self.solver.enable_joint_limits(True)
        self.solver.enable_velocity_limits(problem.speeds is not None)
        self.setters: list[Callable[[Any], object]] = []
        for number, frame in enumerate(problem.frames):
            self._add_frame(link_name(number), frame, problem.priority)
        for joints in peer.alike:
            task = self.solver.add_joints_task()
            task.set_joints({peer.names[i]: 0.0 for i in joints})
            task.configure("posture", "soft", float(peer.costs[joints[0]]) ** 2)
            self.setters.append(task.set_joints)
        self.names = peer.names
        self._q = self.robot.state.q.copy()
        self._state = np.array([self.robot.get_joint_offset(name) for name in self.names])
        self._rates = np.array([self.robot.get_joint_v_offset(name) for name in self.names])

    def _add_frame(self, link: str, frame: PeerFrame, priority: str) -> None:
        linear, angular = frame.minimal.linear, frame.minimal.angular
        if linear.rank:
            place = self.solver.add_position_task(link, np.zeros(3))
            self.setters.append(partial(setattr, place, "target_world"))
            self._mask(place, linear)
            place.configure(f"position of {link}", priority, 1.0)
        if angular.kind is ProjectorKind.PLANE:
            axis = Z if frame.axis_in_world else frame.axis(np.eye(3))[0]
            turn = self.solver.add_axisalign_task(link, axis, Z)
            if frame.axis_in_world:
                self.setters.append(partial(setattr, turn, "axis_frame"))
            self.setters.append(partial(setattr, turn, "targetAxis_world"))
        elif angular.rank:
            turn = self.solver.add_orientation_task(link, np.eye(3))
            self.setters.append(partial(setattr, turn, "R_world_frame"))
            self._mask(turn, angular)
        if angular.rank:
            turn.configure(f"orientation of {link}", priority, 1.0)

    def _mask(self, task: Any, block: Projector) -> None:
        """Restrict a task to some axes."""
        if block.kind in KEPT:
            task.mask.set_axises(KEPT[block.kind], "custom")
            self.setters.append(partial(setattr, task.mask, "R_custom_world"))

    def update(self, state: Array) -> None:
        """PlaCo's kinematics."""
        self._q[self._state] = state
        self.robot.state.q = self._q
        self.robot.update_kinematics()

    def limit_speeds(self, speeds: Array) -> None:
        """Set the limits of all joints."""
        for name, speed in zip(self.names, speeds.tolist(), strict=True):
            self.robot.set_velocity_limit(name, min(speed, URDF_UNLIMITED))

    def velocity(self, dt: float) -> Array:
        """One call of ``KinematicsSolver.solve``, which returns a displacement."""
        if self.solver.dt != dt:
            self.solver.dt = dt
        velocity: Array = self.solver.solve(True)[self._rates] / dt
        if self.scaled:
            self.scale = float(self.solver.scale)
        return velocity


def _axes(block: Projector) -> Array:
    """Rotation (3, 3) from the world to axes of which :data:`KEPT` names those of a block."""
    assert block.axis is not None
    z = block.axis
    x = Projector.plane(z).basis[:, 0]
    return np.array([x, np.cross(z, x), z])

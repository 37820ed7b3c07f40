"""pink's own step."""

from __future__ import annotations

from functools import partial
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.peers.peer import Peer, PeerFrame, PeerProblem, PeerStep
from qp_twist.peers.urdf import URDF_UNLIMITED, link_name, robot_urdf


class PinkPeer(Peer):
    """``pink.solve_ik``, the frames as costs; it reads the robot from URDF.

    Not as constraints: those have all six rows of a frame task, so the roll would not be free.
    """

    needs = (("pinocchio", "pin-pink"), ("pink", "pin-pink"))

    def __init__(self, problem: PeerProblem) -> None:
        """Read the robot with pinocchio."""
        super().__init__(problem)
        self.pin, self.pink = self.modules()
        self.failures = (self.pink.exceptions.PinkError,)
        self.model = self.pin.buildModelFromXML(
            robot_urdf(problem.model, problem.frames, problem.speeds)
        )
        names = JointRanges.of(problem.model).names
        # pinocchio orders the joints of a tree by name.
        self.order = [names.index(name) for name in list(self.model.names)[1:]]

    def state(self, q: Array) -> Array:
        """In pinocchio's order."""
        return q[..., self.order]

    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """The pose."""
        goal = frame.facing(target, here)
        return [self.pin.SE3(goal.rotation().as_matrix(), goal.translation())]

    def step(self) -> PinkStep:
        """Tasks, posture, and limits of position and speed."""
        return PinkStep(self)


class PinkStep(PeerStep):
    """Arguments of ``pink.solve_ik``."""

    def __init__(self, peer: PinkPeer) -> None:
        """Create them, without a cost about a free axis."""
        problem, pink, order = peer.problem, peer.pink, peer.order
        posture = problem.posture[order]
        costs = problem.costs if isinstance(problem.costs, float) else problem.costs[order]
        self.robot = pink.Configuration(peer.model, peer.model.createData(), posture)
        self.tasks = [
            pink.FrameTask(
                link_name(number),
                position_cost=frame.position_costs(),
                orientation_cost=frame.orientation_costs(),
                lm_damping=problem.damping,
            )
            for number, frame in enumerate(problem.frames)
        ]
        self.setters = [task.set_target for task in self.tasks]
        self.tasks.append(pink.PostureTask(cost=costs))
        self.tasks[-1].set_target(posture)
        self.setters.append(partial(setattr, self.tasks[-1], "gain"))
        gain = {} if problem.limit_gain is None else {"config_limit_gain": problem.limit_gain}
        self.limits = [pink.limits.ConfigurationLimit(peer.model, **gain)]
        if problem.speeds is not None:
            self.limits.append(pink.limits.VelocityLimit(peer.model))
        self._solve, self._solver, self._settings = pink.solve_ik, problem.solver, problem.settings
        self._order, self._back = order, [order.index(i) for i in range(len(order))]

    def update(self, state: Array) -> None:
        """pinocchio's kinematics."""
        self.robot.update(state)

    def limit_speeds(self, speeds: Array) -> None:
        """Set the limits of all joints."""
        self.limits[1].velocity_limit = np.minimum(speeds[self._order], URDF_UNLIMITED)

    def velocity(self, dt: float) -> Array:
        """One call of ``pink.solve_ik``; outside a range it warns instead of raising."""
        velocity: Array = self._solve(
            self.robot, self.tasks, dt, self._solver, limits=self.limits, safety_break=False,
            **self._settings,
        )  # fmt: skip
        return velocity[self._back]

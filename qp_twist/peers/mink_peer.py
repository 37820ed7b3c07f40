"""mink's own step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.peers.peer import Peer, PeerFrame, PeerProblem, PeerStep


class MinkPeer(Peer):
    """``mink.solve_ik`` with mink's limits and posture.

    As costs the frames use mink's tasks. As constraints they use this package's
    :class:`~qp_twist.TwistTask`: mink's ``FrameTask`` fixes all six rows, and the three rows of its
    ``AxisAlignTask`` are inconsistent off the axis.
    """

    failures = (mink.MinkError,)
    priorities = ("soft", "hard")

    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """The pose, and the axis to align with its direction."""
        if self.problem.priority == "hard":
            return [target]
        goals: list[Any] = [frame.facing(target, here)]
        if aligns(self.problem, frame):
            goals += frame.axis(target.rotation().as_matrix())
        return goals

    def step(self) -> MinkStep:
        """Tasks, posture, and limits of position and speed."""
        return MinkStep(self.problem)


class MinkStep(PeerStep):
    """Arguments of ``mink.solve_ik``.

    Attributes:
        configuration: The configuration; may be replaced by one with computed kinematics.
        costs: Tasks of the cost; the posture is the last.
        rows: Tasks that are constraints.
        limits: The joint ranges and the finite speeds; mink has no acceleration limits.
        solve: ``mink.solve_ik``, or a replacement.
    """

    def __init__(self, problem: PeerProblem) -> None:
        """Create them."""
        self.configuration = mink.Configuration(problem.model)
        self.solve: Callable[..., Any] = mink.solve_ik
        self._solver, self._settings = problem.solver, problem.settings
        self.setters: list[Callable[[Any], object]] = []
        self.costs: list[mink.Task] = []
        self.rows: list[TwistTask] = []
        for frame in problem.frames:
            if problem.priority == "hard":
                self.rows.append(TwistTask(frame.name, frame.type, frame.projector))
                self.setters.append(self.rows[-1].set_target)
                continue
            pose = mink.FrameTask(
                frame.name,
                frame.type,
                position_cost=frame.position_costs(),
                orientation_cost=0.0 if aligns(problem, frame) else frame.orientation_costs(),
                lm_damping=problem.damping,
            )
            self.costs.append(pose)
            self.setters.append(pose.set_target)
            if aligns(problem, frame):
                align = mink.AxisAlignTask(frame.name, frame.type, cost=1.0)
                self.costs.append(align)
                self.setters += [align.set_axis, align.set_target]
        posture = mink.PostureTask(problem.model, cost=problem.costs)
        posture.set_target(problem.posture)
        self.costs.append(posture)
        self.setters.append(partial(setattr, posture, "gain"))
        gain = {} if problem.limit_gain is None else {"gain": problem.limit_gain}
        self.limits: list[mink.Limit] = [mink.ConfigurationLimit(problem.model, **gain)]
        if problem.speeds is not None and np.isfinite(problem.speeds).any():
            named = zip(JointRanges.of(problem.model).names, problem.speeds.tolist(), strict=True)
            finite = {name: speed for name, speed in named if np.isfinite(speed)}
            self.limits.append(mink.VelocityLimit(problem.model, finite))

    def update(self, state: Array) -> None:
        """mink's kinematics."""
        self.configuration.update(state)

    def limit_speeds(self, speeds: Array) -> None:
        """Set the limits of the joints that have one."""
        for limit in self.limits:
            if isinstance(limit, mink.VelocityLimit):
                limit.limit = speeds[limit.indices]

    def velocity(self, dt: float) -> Array:
        """One call of ``mink.solve_ik``."""
        return np.asarray(
            self.solve(
                self.configuration, self.costs, dt, self._solver, limits=self.limits,
                constraints=self.rows or None, **self._settings,
            )
        )  # fmt: skip


def aligns(problem: PeerProblem, frame: PeerFrame) -> bool:
    """Whether a frame's axis is aligned by a separate task."""
    return problem.aligned and frame.angular.kind is ProjectorKind.PLANE

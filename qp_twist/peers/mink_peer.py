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
from qp_twist.peers.peer import Peer, PeerFrame, PeerStep, Posed


class MinkPeer(Peer):
    """``mink.solve_ik`` with mink's limits and posture.

    As costs the frames have mink's own tasks. As constraints they have this package's
    :class:`~qp_twist.TwistTask`: of mink's own, a ``FrameTask`` fixes all six rows, and the three
    rows of an ``AxisAlignTask`` contradict each other off the axis.
    """

    failures = (mink.MinkError,)
    priorities = ("soft", "hard")

    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """The pose, and the axis to align with its direction."""
        if self.posed.priority == "hard":
            return [target]
        goals: list[Any] = [frame.facing(target, here)]
        if aligns(self.posed, frame):
            goals += frame.axis(target.rotation().as_matrix())
        return goals

    def step(self) -> MinkStep:
        """Tasks, posture, and limits of position and speed."""
        return MinkStep(self.posed)


class MinkStep(PeerStep):
    """Arguments of ``mink.solve_ik``.

    Attributes:
        configuration: Where it starts; replaced by whoever has one whose kinematics is done.
        costs: Tasks of the cost; the posture is the last.
        rows: Tasks that are constraints.
        limits: The joint ranges and the finite speeds; mink has none of acceleration.
        solve: ``mink.solve_ik``, or what takes its place.
    """

    def __init__(self, posed: Posed) -> None:
        """Make them."""
        self.configuration = mink.Configuration(posed.model)
        self.solve: Callable[..., Any] = mink.solve_ik
        self._solver, self._settings = posed.solver, posed.settings
        self.setters: list[Callable[[Any], object]] = []
        self.costs: list[mink.Task] = []
        self.rows: list[TwistTask] = []
        for frame in posed.frames:
            if posed.priority == "hard":
                self.rows.append(TwistTask(frame.name, frame.type, frame.projector))
                self.setters.append(self.rows[-1].set_target)
                continue
            pose = mink.FrameTask(
                frame.name,
                frame.type,
                position_cost=frame.position_costs(),
                orientation_cost=0.0 if aligns(posed, frame) else frame.orientation_costs(),
                lm_damping=posed.damping,
            )
            self.costs.append(pose)
            self.setters.append(pose.set_target)
            if aligns(posed, frame):
                align = mink.AxisAlignTask(frame.name, frame.type, cost=1.0)
                self.costs.append(align)
                self.setters += [align.set_axis, align.set_target]
        posture = mink.PostureTask(posed.model, cost=posed.costs)
        posture.set_target(posed.posture)
        self.costs.append(posture)
        self.setters.append(partial(setattr, posture, "gain"))
        gain = {} if posed.limit_gain is None else {"gain": posed.limit_gain}
        self.limits: list[mink.Limit] = [mink.ConfigurationLimit(posed.model, **gain)]
        if posed.speeds is not None and np.isfinite(posed.speeds).any():
            named = zip(JointRanges.of(posed.model).names, posed.speeds.tolist(), strict=True)
            finite = {name: speed for name, speed in named if np.isfinite(speed)}
            self.limits.append(mink.VelocityLimit(posed.model, finite))

    def update(self, state: Array) -> None:
        """mink's kinematics."""
        self.configuration.update(state)

    def limit_speeds(self, speeds: Array) -> None:
        """For the joints that have a limit."""
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


def aligns(posed: Posed, frame: PeerFrame) -> bool:
    """Whether a frame has an axis that is aligned by a task of its own."""
    return posed.aligned and frame.angular.kind is ProjectorKind.PLANE

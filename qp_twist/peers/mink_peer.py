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

    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """The pose, and the axis to align with its direction."""
        if self.posed.priority == "hard":
            return [target]
        goals: list[Any] = [frame.facing(target, here)]
        if self._aligns(frame):
            goals += frame.axis(target.rotation().as_matrix())
        return goals

    def _aligns(self, frame: PeerFrame) -> bool:
        return self.posed.aligned and frame.angular.kind is ProjectorKind.PLANE

    def step(self) -> MinkStep:
        """Tasks, posture, and limits of position and speed."""
        puts: list[Callable[[Any], object]] = []
        costs: list[mink.Task] = []
        rows: list[TwistTask] = []
        for frame in self.posed.frames:
            if self.posed.priority == "hard":
                rows.append(TwistTask(frame.name, frame.type, frame.projector))
                puts.append(rows[-1].set_target)
                continue
            aligns = self._aligns(frame)
            pose = mink.FrameTask(
                frame.name,
                frame.type,
                position_cost=frame.position_costs(),
                orientation_cost=0.0 if aligns else frame.orientation_costs(),
                lm_damping=self.posed.damping,
            )
            costs.append(pose)
            puts.append(pose.set_target)
            if aligns:
                align = mink.AxisAlignTask(frame.name, frame.type, cost=1.0)
                costs.append(align)
                puts += [align.set_axis, align.set_target]
        posture = mink.PostureTask(self.posed.model, cost=self.posed.costs)
        posture.set_target(self.posed.posture)
        puts.append(partial(setattr, posture, "gain"))
        return MinkStep(self.posed, [*costs, posture], rows, mink_limits(self.posed), puts)


class MinkStep(PeerStep):
    """Arguments of ``mink.solve_ik``.

    Attributes:
        configuration: Where it starts; replaced by whoever has one whose kinematics is done.
        costs: Tasks of the cost; the posture is the last.
        rows: Tasks that are constraints.
        limits: Limits.
        solve: ``mink.solve_ik``, or what takes its place.
    """

    def __init__(
        self,
        posed: Posed,
        costs: list[mink.Task],
        rows: list[TwistTask],
        limits: list[mink.Limit],
        puts: list[Callable[[Any], object]],
    ) -> None:
        self.costs, self.rows, self.limits, self.puts = costs, rows, limits, puts
        self.configuration = mink.Configuration(posed.model)
        self.solve: Callable[..., Any] = mink.solve_ik
        self._solver, self._settings = posed.solver, posed.settings

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


def mink_limits(posed: Posed) -> list[mink.Limit]:
    """The joint ranges and the finite speeds; mink has no limits of acceleration."""
    model, speeds = posed.model, posed.speeds
    gain = {} if posed.limit_gain is None else {"gain": posed.limit_gain}
    limits: list[mink.Limit] = [mink.ConfigurationLimit(model, **gain)]
    if speeds is not None and np.isfinite(speeds).any():
        names = JointRanges.of(model).names
        finite = {n: float(s) for n, s in zip(names, speeds, strict=True) if np.isfinite(s)}
        limits.append(mink.VelocityLimit(model, finite))
    return limits

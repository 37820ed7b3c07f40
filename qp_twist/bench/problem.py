"""A robot on a trajectory: the input of every contender at every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import mink
import mujoco
import numpy as np

from qp_twist.bench.program import StepProgram, Variant, basis, turn_error
from qp_twist.bench.record import Accuracy
from qp_twist.bench.reference import Reference, reference
from qp_twist.checks import Array
from qp_twist.errors import QpTwistError
from qp_twist.geometry import TwistProjector

DT = 0.01
"""Length of a step, s."""
STEPS = 200
"""Steps of a trajectory: one period of 2 s."""


@dataclass(frozen=True)
class Frame:
    """A site that follows its poses along the trajectory.

    Attributes:
        site: Its name.
        projector: T, its axes fixed to the frame.
    """

    site: str
    projector: TwistProjector


@dataclass(frozen=True, eq=False)
class Problem:
    r"""A trajectory whose poses are the targets, and the limits around it.

    At step k every contender starts at :math:`q_k` with the poses at :math:`q_{k+1}` as targets:
    the trajectory is fixed, whatever the contenders return. The desired velocity is a share of the
    distance to the middle, :math:`\dot q_0 = k\,(q_{mid} - q)/dt`.

    Attributes:
        group: Name of what varies: ``"step"``, or that of a series.
        x: Value of the series' parameter: joints, rows, levels or inequality rows.
        title: Title in tables.
        model: The robot, its ranges those of the bench.
        frames: The controlled frames.
        q: Configurations, (STEPS + 1, nq).
        speeds: Velocity limits, rad/s, (nv,).
        gain: k.
        levels: Indices of frames by priority; all in one level by default.
        half_spaces: Rows G of G q̇ ≤ g, (m, nv).
        ends: g at every step, (STEPS, m).
    """

    group: str
    x: int
    title: str
    model: mujoco.MjModel
    frames: tuple[Frame, ...]
    q: Array
    speeds: Array
    gain: float
    levels: tuple[tuple[int, ...], ...] = ()
    half_spaces: Array = field(default_factory=lambda: np.zeros((0, 0)))
    ends: Array = field(default_factory=lambda: np.zeros((STEPS, 0)))

    @cached_property
    def middle(self) -> Array:
        """The middle of the ranges, rad, (nv,)."""
        middle: Array = self.model.jnt_range.mean(axis=1)
        return middle

    @cached_property
    def targets(self) -> list[list[mink.SE3]]:
        """Pose of each frame at the end of each step."""
        configuration = mink.Configuration(self.model)
        found = []
        for q in self.q[1:]:
            configuration.update(q)
            found.append(
                [configuration.get_transform_frame_to_world(f.site, "site") for f in self.frames]
            )
        return found

    @property
    def rows(self) -> int:
        """Number of task rows."""
        return sum(frame.projector.rank for frame in self.frames)

    def jacobians(self, k: int) -> tuple[list[Array], list[Array], list[Array]]:
        """Rotation (3, 3), position (3,) and Jacobian (6, nv) of each frame at step k."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.q[k]
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        rotations, positions, jacobians = [], [], []
        for frame in self.frames:
            index = self.model.site(frame.site).id
            jacobian = np.empty((6, self.model.nv))
            mujoco.mj_jacSite(self.model, data, jacobian[:3], jacobian[3:], index)
            rotations.append(data.site_xmat[index].reshape(3, 3).copy())
            positions.append(data.site_xpos[index].copy())
            jacobians.append(jacobian)
        return rotations, positions, jacobians

    def program(self, k: int) -> StepProgram:
        """The program of a step, as arrays."""
        A, b = [], []
        for frame, target, R, p, J in zip(
            self.frames, self.targets[k], *self.jacobians(k), strict=True
        ):
            for block, rows, error in (
                (frame.projector.linear, J[:3], target.translation() - p),
                (
                    frame.projector.angular,
                    J[3:],
                    turn_error(frame.projector.angular, R, target.rotation().as_matrix()),
                ),
            ):
                U = basis(block, R)
                A.append(U.T @ rows)
                b.append(U.T @ error / DT)
        q = self.q[k]
        lower, upper = self.model.jnt_range.T
        return StepProgram(
            self.gain * (self.middle - q) / DT,
            np.vstack(A),
            np.concatenate(b),
            self.half_spaces.reshape(-1, self.model.nv),
            self.ends[k],
            np.maximum((lower - q) / DT, -self.speeds),
            np.minimum((upper - q) / DT, self.speeds),
        )


class NoProblem(QpTwistError):
    """No trajectory was found that is feasible at every step."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The programs of some steps of a problem, and their solutions."""

    programs: dict[int, StepProgram]
    solutions: dict[int, Reference]

    @classmethod
    def of(cls, problem: Problem, steps: Sequence[int]) -> Truth:
        """Solve them.

        Raises:
            NoReference: If a step has no solution.
        """
        programs = {k: problem.program(k) for k in steps}
        return cls(programs, {k: reference(program) for k, program in programs.items()})

    @property
    def active_share(self) -> float:
        """Share of the steps on which a bound or an inequality row has a multiplier above zero."""
        return sum(s.active > 0 for s in self.solutions.values()) / max(1, len(self.solutions))

    def accuracy(self, variant: Variant, velocities: Mapping[int, Array]) -> Accuracy | None:
        """Accuracy of a contender's velocities by step; ``None`` if there are none."""
        if not velocities:
            return None
        error = None
        if variant is not Variant.OTHER:
            right = {
                k: self.solutions[k]
                if variant is Variant.COMMON
                else reference(self.programs[k].of(variant))
                for k in velocities
            }
            error = max(float(np.abs(v - right[k].velocity).max()) for k, v in velocities.items())
        return Accuracy(
            residual=max(self.programs[k].residual(v) for k, v in velocities.items()),
            excess=max(self.programs[k].excess(v) for k, v in velocities.items()),
            error=error,
        )

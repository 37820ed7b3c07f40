"""A joint path as it is timed, written and read: rows of joint positions, by joint name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, finite_array, instance
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.notebook import html_table
from qp_twist.programs import Zone
from qp_twist.referee import (
    JointMotion,
    MotionLimits,
    PathErrors,
    State,
    Tolerances,
    path_errors,
)
from qp_twist.trajectories.corners import Corners
from qp_twist.trajectories.metadata import metadata_of

if TYPE_CHECKING:
    from qp_twist.following import Trajectory


@dataclass(frozen=True)
class Slowed:
    """A section of the path that is slower than the feed because of limits.

    Attributes:
        first: Index of its first waypoint, from 0.
        last: Index of its last waypoint.
        factor: Largest ratio of a piece's duration to that of the feed.
        longer: Additional time of the section, s.
        limits: The active limits, e.g. ``"velocity of joint_4"``, the most frequent first.
        stops: Indices of its waypoints at which the joints rest, from 0.
    """

    first: int
    last: int
    factor: float
    longer: float
    limits: tuple[str, ...]
    stops: tuple[int, ...]

    def __str__(self) -> str:
        """A line of text, rows counted from 1."""
        why = [", ".join(self.limits)] if self.limits else []
        if self.stops:
            word = "row" if len(self.stops) == 1 else "rows"
            why.append(f"at rest at {word} {', '.join(str(k + 1) for k in self.stops)}")
        return (
            f"rows {self.first + 1} to {self.last + 1}: up to {self.factor:.3g} times as "
            f"long, {self.longer:.3g} s in all ({'; '.join(why) or 'acceleration'})"
        )


@dataclass(frozen=True, eq=False)
class TimedPath:
    """Rows of joint positions, with or without times: what files hold, and what timing returns.

    Attributes:
        joint_names: Names of the columns.
        q: Positions, rad or m, (N, n).
        times: s, (N,), increasing; ``None`` without times.
        velocities: rad/s or m/s, (N, n); ``None`` if joints are interpolated linearly.
        metadata: Data of the task of these rows, if there are any.
        accelerations: rad/s² or m/s², (N, n); ``None`` if joints move on cubics. With accelerations
            they move on quintics (:class:`~qp_twist.trajectories.JointMotion`).
        notes: What else the file has, and what of it is not looked at.
        sources: Whose figures the positions depend on, e.g. the zero positions of a known robot.
        own_ramps: Whether joints move straight between the rows of a program, whose controller
            makes ramps of its own: the rows say nothing of its accelerations.
        points: Which of these rows are points of the program, (P,), the others being on its moves
            of the tool; ``None``: all.
        trajectory: The joint path that was timed, with further rows beside rounded corners;
            ``None`` of a file.
        path_rows: Which rows are those of ``trajectory``; the others are between them.
        limits: The limits for which it was timed.
        slowed: Sections slower than the feed, in the order of the path.
        stops: Indices of the intermediate rows at which the joints rest, of a program of the points
            at which the robot comes to rest, at both ends, too.
        zones: How a program rounds its points, P, else ``None``; empty without.
        unjudged: What of a program no check judges, in words for its verdict.
        corners: The tool at the points; ``None`` if no point is rounded, or no tool is known.
        ramps: Joint accelerations while speeds change as a program states it (``a``), on the moves
            to its points, rad/s² or m/s², (P, n); ``None`` without.
        at_rests: The least joint accelerations that moves of a program in stated times need which
            begin or end at rest, likewise; 0 of others.
        lines: Of a program, those of the moves to its points, (P,).
        program: Lines and points of the program that it was read from, in words; empty of others.
        beside: On which sides of the path a program of this package states that it goes beside it;
            ``None`` of others.
    """

    joint_names: tuple[str, ...]
    q: Array
    times: Array | None = None
    velocities: Array | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    accelerations: Array | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    own_ramps: bool = False
    points: Indices | None = None
    trajectory: Trajectory | None = None
    path_rows: Indices | None = None
    limits: MotionLimits | None = None
    slowed: tuple[Slowed, ...] = ()
    stops: tuple[int, ...] = ()
    program: str = ""
    beside: tuple[str, ...] | None = None
    zones: tuple[Zone | None, ...] = ()
    corners: Corners | None = None
    ramps: Array | None = None
    at_rests: Array | None = None
    lines: tuple[int, ...] = ()
    unjudged: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.joint_names)
        if len(set(self.joint_names)) < count:
            raise InvalidInput(f"joint_names: a name stands twice in {list(self.joint_names)}.")
        finite_array("q", self.q, (None, count))
        if self.times is not None:
            finite_array("times", self.times, (len(self.q),))
        for name in ("velocities", "accelerations"):
            if getattr(self, name) is not None:
                finite_array(name, getattr(self, name), self.q.shape)
        if self.accelerations is not None and self.velocities is None:
            raise InvalidInput(
                "the rows have accelerations, but no velocities: no curve between them is "
                "defined. Add the velocities, or leave the accelerations out."
            )

    def __repr__(self) -> str:
        clock = "untimed" if self.times is None else f"{self.times[-1] - self.times[0]:.6g} s"
        if self.trajectory is not None:
            clock += f", {len(self.slowed)} stretches slowed, {len(self.stops)} stops"
        return f"TimedPath({len(self.q)} rows of {list(self.joint_names)}, {clock})"

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        rows: list[tuple[str, object]] = [("rows", len(self.q))]
        caption, run = f"rows of {', '.join(self.joint_names)}", self.trajectory
        if self.times is not None:
            rows.append(("time, s", float(self.times[-1] - self.times[0])))
        if run is not None:
            caption = f"{run.method} along {run.path_task.name}, timed"
            rows += [
                ("stretches slower than the feed", len(self.slowed)),
                ("stops between the ends", len(self.stops)),
                ("position error at rows, mm", 1e3 * float(self.errors.position.at.max())),
                ("… between them, mm", 1e3 * float(self.errors.position.between.max())),
            ]
        return html_table(caption, rows)

    @classmethod
    def of(cls, path: Trajectory | TimedPath) -> TimedPath:
        """A trajectory as files hold it: joints in the order of the scene; rows of a file as read.

        With times and velocities if it is timed.
        """
        if isinstance(path, TimedPath):
            run, found = path.trajectory, path
            if run is None:
                return path
        else:
            from qp_twist.following import Trajectory  # and all planners

            instance("trajectory", path, Trajectory)
            run, ranges = path, JointRanges.of(path.path_task.model)
            found = cls(ranges.names, ranges.positions(path.q), metadata=metadata_of(path))
        return found.of_joints(JointRanges.of(run.path_task.shown.model).names)

    @cached_property
    def motion(self) -> JointMotion:
        """The motion through the rows; without times one row per second."""
        if self.times is None:
            return JointMotion(np.arange(len(self.q), dtype=np.float64), self.q)
        rates = self.velocities, self.accelerations
        return JointMotion(self.times, self.q, *rates, self.points)

    def at(self, t: npt.ArrayLike) -> State:
        """q, q̇ and q̈ at a time or at many, s: (nv,) or (K, nv) each."""
        return self.motion.at(t)

    @property
    def durations(self) -> Array:
        """Time from each row to the next, s, (N − 1,)."""
        return np.diff(self.motion.times)

    @cached_property
    def errors(self) -> PathErrors:
        """Task errors of a timed trajectory at its rows, and proven between them.

        Raises:
            InvalidInput: If it is of a file: :func:`~qp_twist.check_trajectory` measures it.
        """
        run = self.trajectory
        if run is None:
            raise InvalidInput("a file has no task; check_trajectory(…, task) has its errors.")
        tolerances = run.path_task.tolerances
        within = tolerances.position, tolerances.axis
        times = self.motion.times[self.path_rows]
        return path_errors(run.path_task, self.motion, times, s=run.s, tolerances=within)

    def of_joints(self, names: Sequence[str]) -> TimedPath:
        """The rows with the columns of these joints, in this order.

        A joint that is left out has to stand still, and gets a note.

        Raises:
            InvalidInput: If a joint is missing, or one that is left out moves.
        """
        missing = [name for name in names if name not in self.joint_names]
        if missing:
            raise InvalidInput(
                f"the trajectory has no column for {', '.join(missing)}; it has "
                f"{', '.join(self.joint_names)}."
            )
        others = [name for name in self.joint_names if name not in names]
        resting = []
        if others and len(self.q) > 1:
            lowest, highest = self._of(others).motion.extremes()
            travels = highest.max(axis=0) - lowest.min(axis=0)
            resting = [resting_axis(*pair) for pair in zip(others, travels, strict=True)]
        return replace(self._of(names), notes=(*self.notes, *resting))

    def _of(self, names: Sequence[str]) -> TimedPath:
        columns = [self.joint_names.index(name) for name in names]
        rates = (self.velocities, self.accelerations)
        velocities, accelerations = (None if x is None else x[:, columns] for x in rates)
        ramps, at_rests = (
            None if each is None else each[:, columns] for each in (self.ramps, self.at_rests)
        )
        return replace(
            self,
            joint_names=tuple(names),
            q=self.q[:, columns],
            velocities=velocities,
            accelerations=accelerations,
            ramps=ramps,
            at_rests=at_rests,
        )


_CARTESIAN = re.compile(
    r"""((actual|target|desired|commanded|measured)_)?
    (tcp|eef|end_effector|cartesian)
    (_(pose|position|orientation|speed|velocity|force|torque))?
    _([xyz]|r[xyz]|q[wxyz]|roll|pitch|yaw|[0-5])""",
    re.IGNORECASE | re.VERBOSE,
)
"""Names of a component of the tool centre point's pose, speed or force, which no axis has."""


def resting_axis(name: str, travel: float) -> str:
    """A note about an axis of a file that the robot's model lacks, and that moves by ``travel``.

    What is named as a component of the tool centre point (``tcp_x``) is no axis, and may change.

    Raises:
        InvalidInput: If it moves: then the motion is not that of the model.
    """
    if _CARTESIAN.fullmatch(re.sub(r"[\s./:-]+", "_", name)):
        return f"{name} is of the tool centre point, no joint of the robot: not looked at"
    if travel > Tolerances().joint_range:
        raise InvalidInput(
            f"{name} moves by {travel:.4g} (rad or m), but the robot's model has no such joint, so "
            "that the motion cannot be judged. Give a robot that has it; if it is no axis, leave "
            "its column out of the file."
        )
    return f"{name} stands still in the file, and the robot's model has no such joint"

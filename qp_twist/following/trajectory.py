"""A joint trajectory along a path, with its errors at every waypoint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Clearance, NearestPair
from qp_twist.control import Status
from qp_twist.kinematics import FramePair, JointRanges, frame_jacobian, largest_excess
from qp_twist.notebook import html_table
from qp_twist.paths import METHODS, PathTask, Waypoints
from qp_twist.planning import Plan
from qp_twist.planning.manifold_net import BOUNDED
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import PathErrors, RowVerdict, poses_of, straight_errors, task_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class RowSteps(NamedTuple):
    """How a row was reached."""

    scale: float = 1.0
    """The smallest of its iterations."""
    iterations: int = 0
    binding: tuple[str, ...] = ()
    """Names of the limits that were active, or because of which it took longer."""
    status: Status = Status.SOLVED
    """The worst of its iterations."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Result of :func:`~qp_twist.follow`, with N rows; row 0 is the start.

    There is a row for each waypoint, but those that a run did not reach which was stopped or could
    not go on; further rows are inside joint moves, or were inserted
    (:func:`~qp_twist.refine_trajectory`). ``s`` says to which point of the path each row belongs.
    The errors are those at the rows; ``between`` has proven bounds between them.

    Attributes:
        path_task: The task that was followed.
        method: Name of the method.
        q: Joint configurations, rad or m, (N, nq).
        steps: How each row was reached, (N,).
        seconds: Wall time of the whole run, without the start's correction, s.
        diverged_at: 1-based waypoint from which the method had no finite step, or ``None``.
        failure: Why and where there was no step; empty if there always was one.
        durations: Duration of each waypoint, s, (N,): the task's, or longer if
            :func:`~qp_twist.follow` slowed down; ``None`` if untimed.
        plan: The plan that was followed, if one was.
        compiled: Number of waypoints that were reached by compiled code; the rest by Python.
        blocked_by: Names of the limits, as far as known, because of which a run that may slow down
            ended before the next waypoint; ``None`` if none did.
        s: Parameter of the path at each row (``PathTask.at``), (N,): the number of a waypoint,
            from 0, plus the share of the way to the next one; ``None``: a row for each waypoint.
    """

    path_task: PathTask
    method: str
    q: Array
    durations: Array | None
    steps: tuple[RowSteps, ...] = ()
    seconds: float = 0.0
    diverged_at: int | None = None
    failure: str = ""
    plan: Plan | None = None
    compiled: int = 0
    blocked_by: tuple[str, ...] | None = None
    s: Array = None  # type: ignore[assignment]  # __post_init__ sets it

    def __post_init__(self) -> None:
        if self.s is None or len(self.s) != len(self.q):
            object.__setattr__(self, "s", np.arange(len(self.q), dtype=np.float64))
        if not self.steps:
            object.__setattr__(self, "steps", (RowSteps(),) * len(self.q))

    @cached_property
    def scale(self) -> Array:
        """Smallest scale of each waypoint's steps; 1 for closed forms, (N,)."""
        return np.array([row.scale for row in self.steps])

    @cached_property
    def iterations(self) -> npt.NDArray[np.int64]:
        """Iterations that each waypoint took, (N,)."""
        return np.array([row.iterations for row in self.steps])

    @cached_property
    def binding(self) -> tuple[tuple[str, ...], ...]:
        """Of each waypoint the limits active in its steps, or that extended its duration."""
        return tuple(row.binding for row in self.steps)

    @cached_property
    def statuses(self) -> tuple[Status, ...]:
        """The worst status of each waypoint's steps."""
        return tuple(row.status for row in self.steps)

    @property
    def interrupted_plan(self) -> Plan | None:
        """The plan that was followed, if Ctrl-C ended its search."""
        return self.plan if self.plan is not None and self.plan.interrupted else None

    @cached_property
    def z_bound(self) -> float | None:
        """Lower bound of the mean z of all motions from this start, if the followed plan has one.

        With more than three free degrees the bound knows too few local optima.
        """
        plan, task = self.plan, self.path_task
        if plan is None or plan.objective != "centering" or plan.joint_weights or task.joint_moves:
            return None
        return plan.bound if int(PathRows(task).freedom.max()) <= BOUNDED else None

    @cached_property
    def path(self) -> Waypoints:
        """The path at the rows."""
        return self.path_task.at(self.s)

    @property
    def at_waypoints(self) -> Mask:
        """Which rows are at waypoints, (N,)."""
        return np.asarray(self.s == np.floor(self.s))

    @property
    def ended(self) -> bool:
        """Whether there are rows up to the last waypoint."""
        return bool(self.s[-1] == len(self.path_task.waypoints) - 1)

    @property
    def feed(self) -> Array | None:
        """Least time from each row to the next, s, (N − 1,); ``None`` without a feed.

        On the path at the feed; in joint moves by the joints' speeds.
        """
        at_feed = self.path.durations
        if at_feed is None or self.durations is None:
            return None
        return np.where(self.path.moves, self.durations[1:], at_feed[1:])

    @property
    def least_times(self) -> Array | None:
        """Least time from each row to the next, s, (N − 1,); ``None`` without a feed or a plan's.

        That of the :attr:`feed`, or longer where the plan that was followed is slower.
        """
        feed = self.feed
        if self.plan is None or self.durations is None or not self.plan.is_slower:
            return feed
        return self.durations[1:] if feed is None else np.maximum(feed, self.durations[1:])

    @cached_property
    def _pairs(self) -> tuple[FramePair, FramePair]:
        """The frame with the method's target at each row, and with the path's own."""
        R, p = poses_of(self.path_task, self.q)
        path = self.path_task.at(self.s, flipped=METHODS[self.method].flipped)
        return (
            FramePair(R, p, path.rotations, path.positions),
            FramePair(R, p, self.path.rotations, self.path.positions),
        )

    @cached_property
    def _errors(self) -> Array:
        """Task errors, linear and angular, in the rows of the task only; 0 off the path, (N, 6)."""
        errors = task_errors(*self._pairs[0][:4], self.path.projectors)
        return np.where(self.path.on_path[:, None], errors, 0.0)

    @cached_property
    def position_error(self) -> Array:
        """Length of the linear task error, m, (N,)."""
        return np.asarray(np.linalg.norm(self._errors[:, :3], axis=1))

    @cached_property
    def axis_error(self) -> Array:
        """Length of the angular task error, in the rows of the task only, rad, (N,)."""
        return np.asarray(np.linalg.norm(self._errors[:, 3:], axis=1))

    @cached_property
    def band_excess(self) -> Array:
        """Largest violation of a band, soft ones too, rad or m, (N,); 0 inside all bands."""
        excess = largest_excess(self.path_task.bands, self._pairs[1])
        return np.where(self.path.on_path, excess, 0.0)

    @cached_property
    def sigma_min(self) -> Array:
        """Smallest singular value of the task rows UᵀJ, (N,); 0 where there are none."""
        configuration = mink.Configuration(self.path_task.model)
        frame = self.path_task.frame_name, self.path_task.frame_type
        pair, smallest = self._pairs[0], np.zeros(len(self.q))
        for k, projector in enumerate(self.path.projectors):
            configuration.update(self.q[k])
            T = projector.in_world(pair.rotation[k], pair.target_rotation[k])
            rows = T.basis.T @ frame_jacobian(configuration, *frame)
            smallest[k] = np.linalg.svd(rows, compute_uv=False)[-1:].sum()
        return smallest

    def with_rows(self, at: Indices, q: Array, s: Array, durations: Array | None) -> Trajectory:
        """The trajectory with rows q (K, nq) at parameters s (K,) before its rows ``at`` (K,).

        ``durations`` (N + K,) are those of all rows afterwards, s; ``None`` without a feed.
        """
        kept = np.insert(np.arange(len(self.q)), at, -1).tolist()
        return replace(
            self,
            q=np.insert(self.q, at, q, axis=0),
            s=np.insert(self.s, at, s),
            steps=tuple(RowSteps() if k < 0 else self.steps[k] for k in kept),
            durations=durations,
        )

    @cached_property
    def verdict(self) -> RowVerdict:
        """What it does not keep at its rows, by the tolerances of a check."""
        errors = self.position_error, self.axis_error
        excess = self.band_excess, self.constraint_excess
        return RowVerdict.of(self.path_task, self.path, self.q, errors, *excess)

    @property
    def passes(self) -> bool:
        """Whether it goes to the end of the path and keeps everything at its rows.

        Between them: ``between``, and :func:`~qp_twist.check_trajectory`.
        """
        return self.ended and self.keeps_rows

    @property
    def keeps_rows(self) -> bool:
        """Whether it keeps everything at the rows that it has, and no step failed."""
        return self.diverged_at is None and not self.failure and not self.verdict.fails.any()

    @property
    def rows_kept(self) -> int:
        """Number of rows, from the first one on, within the tolerances of a check."""
        off = self.verdict.off
        return int(np.argmax(off)) if off.any() else len(off)

    @property
    def kept(self) -> int:
        """Number of waypoints, from the first one on, within the tolerances of a check."""
        return int(self.at_waypoints[: self.rows_kept].sum())

    @property
    def held_by(self) -> str:
        """Why there is no step, or the active limits where the run leaves the path or ends."""
        left = self.rows_kept < len(self.q)
        names = self.binding[self.rows_kept] if left else self.blocked_by
        return self.failure or ", ".join(names or ())

    @property
    def ending(self) -> str:
        """Where the run ends or leaves the path, and why, in words; empty if it does neither."""
        return _ending(self)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, by degree of freedom."""
        return JointRanges.of(self.path_task.model).names

    @property
    def margins(self) -> Array:
        """``1 − |θ − θ̄| / half-range`` for every waypoint and joint, (N, nv)."""
        return JointRanges.of(self.path_task.model).margins(self.q)

    @property
    def z(self) -> Array:
        """z = ½‖W(θ̄ − θ)‖² at every waypoint, (N,)."""
        return JointRanges.of(self.path_task.model).centering(self.q)

    @cached_property
    def constraint_excess(self) -> Array:
        """Largest violation of the task's constraints at each waypoint, m or rad, (N,)."""
        return np.asarray(self.path_task.constraint_excess(self.q).max(axis=1, initial=0.0))

    @cached_property
    def between(self) -> PathErrors:
        """Proven deviation from the path between waypoints, with linearly interpolated joints.

        Raises:
            InvalidInput: If there are fewer than two rows, a row is not finite, or a joint is
                neither hinge nor slide.
        """
        return straight_errors(self.path_task, self.q, self.s)

    @cached_property
    def nearest(self) -> tuple[Clearance, NearestPair] | None:
        """Where the motion is nearest to what it must not touch, at and between waypoints.

        Joints go straight between waypoints. The nearest pair is that of the least margin, with the
        clearance that it belongs to; ``None`` if the task has none.
        """
        found = [
            (clearance, near)
            for clearance in self.path_task.clearances
            if (near := clearance.nearest(self.q)) is not None
        ]
        return min(found, key=lambda one: one[1].distance - one[0].distance, default=None)

    @property
    def summary(self) -> str:
        """Largest errors and smallest margin at the waypoints, and where it ends, in one line."""
        ending = self.ending
        return (
            f"position error ≤ {1e3 * self.position_error.max():.3g} mm, axis error ≤ "
            f"{np.degrees(self.axis_error.max()):.3g}°, smallest joint margin "
            f"{self.margins.min(initial=np.inf):.3g} (at the waypoints)"
            + (f"; {ending}" if ending else "")
        )

    def __repr__(self) -> str:
        return f"Trajectory({self.path_task.name!r}, {self.method!r}, {self.summary})"

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        return html_table(f"{self.method} along {self.path_task.name}", _extremes(self))

    def plot(self) -> Figure:
        """Each joint between its limits, and the errors at the waypoints with their tolerances.

        A Matplotlib figure, which notebooks display; ``figure.savefig("run.png")`` writes it.
        """
        from qp_twist.drawing.charts import run_figure  # with Matplotlib

        return run_figure(
            JointRanges.of(self.path_task.model),
            self.q,
            self.position_error,
            self.axis_error,
            (self.path_task.tolerances.position, self.path_task.tolerances.axis),
        )


def _extremes(run: Trajectory) -> list[tuple[str, object]]:
    """Largest errors and smallest margin with their names, and where the run ends."""
    rows: list[tuple[str, object]] = [
        ("waypoints", f"{run.at_waypoints.sum()} of {len(run.path_task.waypoints)}"),
        ("largest position error, mm", 1e3 * float(run.position_error.max())),
        ("largest axis error, °", float(np.degrees(run.axis_error.max()))),
        ("smallest joint margin", float(run.margins.min(initial=np.inf))),
        ("mean z", float(run.z.mean())),
    ]
    if run.path_task.bands:
        rows.append(("largest band excess, rad or m", float(run.band_excess.max())))
    if run.path_task.stated_constraints:
        most = float(run.constraint_excess.max())
        rows.append(("largest excess of a constraint, m or rad", most))
    if run.ending:
        rows.append(("the run", run.ending))
    return rows


def _ending(run: Trajectory) -> str:
    count, kept, rows = len(run.path_task.waypoints), run.kept, run.rows_kept
    if rows < len(run.q):
        held = ", ".join(run.binding[rows])
        where = f"leaves the path at waypoint {kept + 1} of {count}"
        return f"{where}, held by {held}" if held else where
    if kept == count:
        return ""
    if run.blocked_by is not None:
        held = ", ".join(run.blocked_by) or "a singularity"
        why = f"at no speed is the next one reached, held by {held}"
    else:
        why = run.failure
    where = f"ends at waypoint {kept} of {count}" if kept else f"meets none of {count} waypoints"
    return f"{where}: {why}" if why else where

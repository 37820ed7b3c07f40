"""Follow a path by the compiled kernel, for the methods and paths that it supports."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.constraints import PositionLimit
from qp_twist.control.limit_tables import table_of
from qp_twist.control.step_settings import SINGULARITY, UNSEEN_WEIGHT
from qp_twist.following.resolver import LARGEST_JOINT
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector, distinct_projectors
from qp_twist.kernel import follow_kernel
from qp_twist.kernel.step_record import STEP, Settings, Sizes, Step
from qp_twist.kinematics import JointCentering, JointRanges, SerialChain
from qp_twist.kinematics.compiled_rows import arm_of, rows_of
from qp_twist.paths import METHODS, MethodSettings, PathTask, Waypoints
from qp_twist.planning.starts import START_ITERATIONS

Counts = npt.NDArray[np.int64]
CLOSED_FORMS = ("rmr", "rmr_flipped", "minimum_norm", "gradient_projection")
"""Closed forms that the kernel supports, as programs without limits; it supports all QPs."""
STILL = np.concatenate([np.eye(3).ravel(), np.zeros(3)])[None]
"""The identity as a rigid motion of one run, (1, 12)."""


class CompiledWalk:
    """A method and a path in the kernel's arrays."""

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        path: Waypoints | None = None,
        references: Array | None = None,
    ) -> None:
        """Fill the arrays of a path for which :func:`walk_known` is true.

        Without ``path`` the rows are its waypoints, without ``references`` (K, nq) of the secondary
        the middles of the ranges.
        """
        kind, model = METHODS[method], path_task.model
        path = path_task.at(flipped=kind.flipped) if path is None else path
        ranges = JointRanges.of(model)
        self._arm = arm_of(SerialChain.of(model, path_task.frame_name, path_task.frame_type))
        held: list[TwistProjector | None] = list(path.projectors)
        for segment in path_task.segments:
            for k in np.flatnonzero(segment.blended(path.s)):
                held[k] = None
        if kind.whole_twist:
            held = [path_task.operational] * len(path.s)
        durations = np.ones(len(path.s)) if path.durations is None else path.durations
        if references is None:
            references = np.tile(ranges.middle, (len(path.s), 1))
        shown = (path.rotations, path.positions)
        self._path = follow_kernel.Path(
            rows_of(
                *distinct_projectors(held),
                *shown,
                max_linear_step=path_task.iteration.max_linear_step,
                max_angular_step=path_task.iteration.max_angular_step,
            ),
            rows_of(*distinct_projectors(path.projectors), *shown),
            np.where(durations > 0.0, durations, 1.0),
            np.ascontiguousarray(references),
        )
        self._way = self._way_of(path_task, method, settings, ranges)
        table, types = table_of([PositionLimit(model)] if kind.holds_limits else [], model.nv)
        floats, integers = _steps(
            table,
            types,
            np.ones(model.nv),
            np.zeros(model.nv),
            Settings(SINGULARITY, 1.0),
            None,
        )
        self._correction = self._way._replace(
            iterations=START_ITERATIONS,
            every_iteration=False,
            limits=table,
            floats=floats,
            integers=integers,
        )
        # Run on nothing, so that compiling or loading is not part of a run's time.
        self.on_from(ranges.middle, len(path.s))

    def on_from(self, start: Array, first: int) -> tuple[Array, Counts, Array]:
        """Follow the rows from ``first`` on, from ``start``, until the reference is needed.

        Returns configurations (K, nq), iterations (K,), and lengths of the task errors, m and rad,
        (K, 2).
        """
        q = np.zeros((1, len(self._path.durations), len(start)))
        q[0, first - 1] = start
        ends, iterations, errors = self._followed(self._way, self._path, STILL, q, first)
        done = slice(first, ends[0])
        return q[0, done], iterations[0, done], errors[0, done]

    def many(self, moves: Array, q: Array) -> tuple[Counts, Counts, Array]:
        """Follow K runs of moved paths (K, 12), from and into the rows of q (K, N, nq).

        Returns the first waypoints that are left to the reference, (K,), the iterations (K, N), and
        the lengths of the task errors, m and rad, (K, N, 2).
        """
        return self._followed(self._way, self._path, moves, q, 1)

    def corrected_starts(self, moves: Array, starts: Array) -> tuple[Array, Array]:
        """Starts (K, nq) corrected onto the first waypoints of moved paths.

        Also the lengths of the task errors before and after, m and rad, (K, 2, 2); NaN where the
        reference has to correct.
        """
        twice = np.zeros(2, dtype=np.intp)
        rows = self._path.rows
        rows = rows._replace(which=rows.which[twice], targets=rows.targets[twice])
        first = follow_kernel.Path(rows, rows, np.ones(2), self._path.references[twice])
        q = np.repeat(starts[:, None], 2, axis=1)
        ends, _, errors = self._followed(self._correction, first, moves, q, 1)
        errors[ends < 2, 1] = np.nan
        return q[:, 1], errors

    def _followed(
        self,
        way: follow_kernel.FollowSettings,
        path: follow_kernel.Path,
        moves: Array,
        q: Array,
        first: int,
    ) -> tuple[Counts, Counts, Array]:
        runs, count, nv = q.shape
        iterations, ends = np.zeros((runs, count), dtype=np.int64), np.zeros(runs, dtype=np.int64)
        errors, rows = np.zeros((runs, count, 2)), np.zeros((runs, count, 6, nv))
        follow_kernel.follow(self._arm, way, path, moves, first, q, iterations, errors, rows, ends)
        return ends, iterations, errors

    def _way_of(
        self, path_task: PathTask, method: str, settings: MethodSettings, ranges: JointRanges
    ) -> follow_kernel.FollowSettings:
        kind, model = METHODS[method], path_task.model
        stiffness, metric = np.zeros(model.nv), np.ones(model.nv)
        if settings.secondary == "centering":
            assert settings.weight != "equal"
            stiffness = settings.gain * JointCentering(model, settings.weight).stiffness
            if kind.constrained and settings.metric != "1":
                metric = ranges.metric
        elif settings.secondary == "plan":
            stiffness[:] = settings.gain
        limits = WaypointLimits(path_task, accelerations=False)
        if limits.window is not None:
            limits.window.half_width = path_task.velocity_limits
        table, types = table_of(limits.limits if kind.constrained else [], model.nv)
        twist_space = True if kind.constrained and kind.space == "twist" else None
        weight = UNSEEN_WEIGHT if twist_space else 1.0
        return follow_kernel.FollowSettings(
            twist_space,
            settings.iterations,
            settings.secondary == "plan",
            np.array([path_task.iteration.position_tolerance, path_task.iteration.angle_tolerance]),
            table,
            LARGEST_JOINT,
            *_steps(table, types, metric, stiffness, Settings(SINGULARITY, weight), twist_space),
        )


def _steps(
    table: Array,
    types: Counts,
    metric: Array,
    stiffness: Array,
    settings: Settings,
    twist_space: bool | None,
) -> tuple[Array, Counts]:
    """Steps of one task of 0 to 6 rows, as ``step_record.Step``: (7, F) and (7, I)."""
    nv = len(metric)
    free = 6 if twist_space else 0
    sizes = [Sizes(nv, m, 1, 1, len(types), free=free, others=0, k=0) for m in range(7)]
    layouts = [STEP.layout(size) for size in sizes]
    floats = np.zeros((7, max(layout.floats for layout in layouts)))
    integers = np.zeros((7, max(layout.integers for layout in layouts)), dtype=np.int64)
    for m, layout in enumerate(layouts):
        integers[m, : STEP.head] = layout.table
        s: Step = STEP.arrays(floats[m], integers[m])
        s.settings[:] = settings  # type: ignore[index]
        s.free_costs[:], s.metric[:], s.stiffness[:], s.limits[:] = 1.0, metric, stiffness, table
        s.ends[:], s.addresses[:], s.types[:] = m, range(nv), types
    return floats, integers


def walk_known(
    path_task: PathTask, method: str, settings: MethodSettings, *, accelerations: bool = True
) -> bool:
    """Whether :class:`CompiledWalk` supports a method on a path.

    It does not support tolerance bands, constraints, ball and free joints, secondaries other than
    centering and a plan, or, unless a run leaves them out, acceleration limits.
    """
    kind = METHODS[method]
    if kind.peer or not (kind.constrained or method in CLOSED_FORMS):
        return False
    known = settings.secondary in ("none", "centering", "plan") and settings.weight != "equal"
    timed = path_task.durations is not None
    return (
        known
        and not path_task.bands
        and not path_task.stated_constraints
        and not (accelerations and timed and np.isfinite(path_task.acceleration_limits).any())
        and JointRanges.of(path_task.model).only_hinges_and_slides
    )

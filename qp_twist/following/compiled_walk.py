"""Follow a path by the compiled kernel, for the methods and paths that it supports."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices
from qp_twist.constraints import PositionLimit
from qp_twist.control.controller import SINGULARITY, UNSEEN_WEIGHT
from qp_twist.control.step_tables import TOLERANCES, kernel_settings, table_of
from qp_twist.following.resolver import (
    LARGEST_JOINT,
    waypoints_of,
)
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector, distinct_projectors
from qp_twist.kernel import follow_kernel
from qp_twist.kernel.arm_kernel import Arm
from qp_twist.kernel.path_kernel import Rows
from qp_twist.kernel.step_kernel import STEP, Settings, StepInputs
from qp_twist.kernel.step_record import Sizes
from qp_twist.kinematics import JointCentering, JointRanges, SerialChain
from qp_twist.kinematics.compiled_rows import arm_of, rows_of
from qp_twist.paths import METHODS, MethodSettings, PathTask
from qp_twist.planning.starts import START_ITERATIONS

Counts = npt.NDArray[np.int64]
CLOSED_FORMS = ("rmr", "rmr_flipped", "minimum_norm", "gradient_projection")
"""Closed forms that the kernel supports; it supports all QPs."""


class CompiledWalk:
    """A method and a path in the kernel's arrays."""

    def __init__(self, path_task: PathTask, method: str, settings: MethodSettings) -> None:
        """Fill the arrays of a path for which :func:`walk_known` is true."""
        kind, model = METHODS[method], path_task.model
        ranges = JointRanges.of(model)
        self._weight, self._middle = ranges.weight, ranges.middle
        self._arm = arm_of(SerialChain.of(model, path_task.frame_name, path_task.frame_type))
        waypoints = waypoints_of(path_task, method)
        rotations = np.array([waypoint.rotation().as_matrix() for waypoint in waypoints])
        positions = np.array([waypoint.translation() for waypoint in waypoints])
        held: list[TwistProjector | None] = list(path_task.in_force)
        if kind.whole_twist:
            held = [path_task.operational] * len(waypoints)
        else:
            for segment in path_task.segments:
                held[segment.first : segment.first + segment.blend] = [None] * segment.blend
        durations = path_task.durations
        if durations is None:
            durations = np.ones(len(waypoints))
        self._path = follow_kernel.Path(
            rows_of(
                *distinct_projectors(held),
                rotations,
                positions,
                max_linear_step=path_task.iteration.max_linear_step,
                max_angular_step=path_task.iteration.max_angular_step,
            ),
            np.where(durations > 0.0, durations, 1.0),
            np.tile(ranges.middle, (len(waypoints), 1)),
        )
        self._way = self._way_of(path_task, method, settings, ranges)
        table, types = table_of([PositionLimit(model)] if kind.holds_limits else [], model.nv)
        floats, integers = _steps(
            table,
            types,
            np.ones(model.nv),
            np.zeros(model.nv),
            kernel_settings(SINGULARITY, 1),
            None,
        )
        self._correction = self._way._replace(
            iterations=START_ITERATIONS,
            every_iteration=False,
            limits=table,
            floats=floats,
            integers=integers,
        )
        self._measured = rows_of(*distinct_projectors(path_task.in_force), rotations, positions)
        self._ranks = np.array([projector.rank for projector in path_task.in_force])
        # Run on nothing, so that compiling or loading is not part of a run's time.
        self.on_from(ranges.middle, len(waypoints))

    def toward(self, references: Array) -> None:
        """Set the secondary's references (N, nq), one for each waypoint."""
        self._path = self._path._replace(references=np.ascontiguousarray(references))

    def on_from(self, start: Array, first: int) -> tuple[Array, Counts, Array, Array]:
        """Follow the waypoints from ``first`` on, from ``start``, until the reference is needed.

        Returns:
            Configurations (K, nq), iterations (K,), lengths of the task errors (K, 2), m and rad,
            and the smallest singular values of the rows (K,).
        """
        count = len(self._path.rows.which)
        q = np.zeros((count, len(start)))
        q[first - 1] = start
        iterations = np.zeros(count, dtype=np.int64)
        end = follow_kernel.follow(self._arm, self._way, self._path, first, q, iterations)
        q = q[first:end]
        return q, iterations[first:end], *self.measured(q, np.arange(first, end))

    def many(self, moves: Array, starts: Array, kept: Array, numbers: Array, ends: Counts) -> None:
        """Follow many runs; arguments as for ``follow_kernel.follow_many``."""
        follow_kernel.follow_many(
            self._arm, self._way, self._path, self._measured, moves, starts, self._weight,
            self._middle, kept, numbers, ends,
        )  # fmt: skip

    def correct_starts(self, moves: Array, starts: Array) -> None:
        """Correct q (K, nq), in place, to the first waypoints of moved paths."""
        follow_kernel.onto_start(self._arm, self._correction, self._path, moves, starts)

    def start_errors(self, moves: Array, starts: Array) -> Array:
        """Lengths of the task errors at the first waypoints of moved paths, (K, 2)."""
        count, target = len(starts), self._path.rows.targets[0]
        turns = moves[:, :9].reshape(-1, 3, 3)
        targets = np.zeros((count, 18))
        targets[:, :9] = (turns @ target[:9].reshape(3, 3)).reshape(-1, 9)
        targets[:, 9:12] = turns @ target[9:12] + moves[:, 9:]
        which = np.full(count, self._path.rows.which[0])
        held = self._path.rows._replace(which=which, targets=targets)
        return _measure(self._arm, held, starts)[0]

    def measured(self, q: Array, at: Indices) -> tuple[Array, Array]:
        """Lengths of the task errors (K, 2) and smallest singular values (K,) at waypoints."""
        seen = self._measured
        seen = seen._replace(which=seen.which[at], targets=seen.targets[at])
        errors, rows = _measure(self._arm, seen, q)
        sigma = np.zeros(len(q))
        ranks = self._ranks[at]
        for rank in np.unique(ranks[ranks > 0]):
            here = ranks == rank
            sigma[here] = np.linalg.svd(rows[here, :rank], compute_uv=False)[:, -1]
        return errors, sigma

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
        limits = WaypointLimits(path_task)
        if limits.window is not None:
            limits.window.half_width = path_task.velocity_limits
        table, types = table_of(limits.limits if kind.constrained else [], model.nv)
        twist_space = True if kind.constrained and kind.space == "twist" else None
        weight = UNSEEN_WEIGHT if twist_space else 1.0
        return follow_kernel.FollowSettings(
            kind.constrained,
            twist_space,
            settings.iterations,
            settings.secondary == "plan",
            np.array([path_task.iteration.position_tolerance, path_task.iteration.angle_tolerance]),
            table,
            LARGEST_JOINT,
            *_steps(
                table, types, metric, stiffness, kernel_settings(SINGULARITY, weight), twist_space
            ),
        )


def _steps(
    table: Array,
    types: Counts,
    metric: Array,
    stiffness: Array,
    settings: Settings,
    twist_space: bool | None,
) -> tuple[Array, Counts]:
    """Steps of one task of 0 to 6 rows, as ``step_kernel.StepArrays``: (7, F) and (7, I)."""
    nv = len(metric)
    free = 6 if twist_space else 0
    sizes = [Sizes(nv, m, 1, 1, len(types), free=free, others=0, k=0) for m in range(7)]
    ends = [STEP.layout(size, 0, STEP.head) for size in sizes]
    floats = np.zeros((7, max(end.floats for end in ends)))
    integers = np.zeros((7, max(end.integers for end in ends)), dtype=np.int64)
    for m, size in enumerate(sizes):
        STEP.resize(integers[m], size)
        g: StepInputs = STEP.arrays(floats[m], integers[m], integers[m]).inputs
        g.settings[:], g.tolerances[:] = settings, TOLERANCES  # type: ignore[index]
        g.free_costs[:], g.metric[:], g.stiffness[:], g.limits[:] = 1.0, metric, stiffness, table
        g.ends[:], g.addresses[:], g.types[:] = m, range(nv), types
    return floats, integers


def walk_known(path_task: PathTask, method: str, settings: MethodSettings) -> bool:
    """Whether :class:`CompiledWalk` supports a method on a path.

    It does not support tolerance bands, constraints, acceleration limits, ball and free joints, or
    secondaries other than centering and a plan.
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
        and not (timed and np.isfinite(path_task.acceleration_limits).any())
        and JointRanges.of(path_task.model).only_hinges_and_slides
    )


def _measure(arm: Arm, rows: Rows, q: Array) -> tuple[Array, Array]:
    """Lengths of the task errors (K, 2), m and rad, and the rows UᵀJ (K, 6, nv)."""
    errors, found = np.zeros((len(q), 2)), np.zeros((len(q), 6, q.shape[1]))
    follow_kernel.measure(arm, rows, q, errors, found)
    return errors, found

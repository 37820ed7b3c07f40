"""A controller's step as machine code, on arrays that are allocated once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.constraints import LimitRows, MotionLimit, Named
from qp_twist.control.composition import damps_by_error, rows_known
from qp_twist.control.kernel_result import StepLabels, attribute_of
from qp_twist.control.limit_tables import LimitTables
from qp_twist.control.mink_costs import mink_costs
from qp_twist.control.posing import EVERYTHING, Displacement, free_rows, in_words
from qp_twist.control.secondary_arrays import SecondaryArrays
from qp_twist.control.step import Status, Step
from qp_twist.control.step_tables import (
    TOLERANCES,
    kernel_settings,
    numbers_of_kinds,
    table_of,
    with_slacks,
)
from qp_twist.kernel import COMPILED
from qp_twist.kernel.compiling import bound
from qp_twist.kernel.live_step import (
    NO_EFFECT,
    PYTHON_JACOBIAN,
    live_edge_step,
    live_step,
)
from qp_twist.kernel.record import Integers
from qp_twist.kernel.step_kernel import (
    FROM_PYTHON,
    RAISE,
    RELAX,
    SCALE,
    STEP,
    STEP_INPUTS,
    StepInputs,
)
from qp_twist.kernel.step_record import PROGRAM, Program, Sizes
from qp_twist.kernel.verified_program import (
    AT_THE_EDGE,
    BRAKED,
    BRAKED_BELOW,
    DONE,
    FADED,
    INFEASIBLE,
    PRIORITIZED,
    REFUSED,
    RELAXED,
    SCALED,
)
from qp_twist.kinematics import BandRows, JointRanges, TwistTask
from qp_twist.kinematics.frame import frame_id
from qp_twist.kinematics.projector_shape import kinds_of, shape_of
from qp_twist.kinematics.serial_chain import dofs_above
from qp_twist.kinematics.twist_task import AT_REST
from qp_twist.qp import LostDirection, lost_directions

if TYPE_CHECKING:
    from qp_twist.control.controller import Controller

_NO_ROWS: tuple[Named, ...] = ()
_INFEASIBLE = {"raise": RAISE, "scale": SCALE, "relax": RELAX}
_SOLVED = Status.SOLVED  # looked up once: in each step it would take 0.1 µs
_STATUSES = {
    SCALED: Status.SCALED, RELAXED: Status.RELAXED,
    PRIORITIZED: Status.PRIORITIZED, BRAKED: Status.SCALED, BRAKED_BELOW: Status.PRIORITIZED,
    FADED: Status.DEGRADED,
}  # fmt: skip
_AS_POSED = DONE, BRAKED, BRAKED_BELOW, FADED
"""Outcomes of a program that was solved as posed, if for less than the tasks ask."""


class CompiledStep:
    """The kernel and its arrays for one controller that ``composition_known`` accepts.

    Limits of other classes, tolerance bands, tasks of derived classes or with a carried target, and
    the costs of other tasks are evaluated in Python. :meth:`__call__` returns ``None`` if the
    composition is no longer supported, or if the kernel could not solve or verify the step; the
    reference then computes it.

    Attributes:
        twist_space: ``True`` for the twist-space cost, else ``None``: see ``step_kernel``.
    """

    def __init__(self, composed: Controller) -> None:
        """Allocate the arrays for a composition that ``composition_known`` accepts."""
        model, tasks, limits = composed.model, composed.twist_tasks, list(composed.limits)
        self._model, self._tasks, self._limits = model, tasks, limits
        self._secondary, self._metric = composed.secondary, composed.metric
        self._space, self._soft_tasks = composed.secondary_space, composed.soft_tasks
        self.twist_space = True if self._space == "twist" and len(tasks) > 0 else None
        self._projectors = [task.projector for task in tasks]
        self._named = [(task.frame_name, task.frame_type) for task in tasks]
        ranges = self._ranges = JointRanges.of(model)
        self._ranks = tuple(task.projector.rank for task in tasks)
        self._row_ends: list[int] = np.cumsum(self._ranks).tolist()
        self._levels = composed.levels
        self._ends = np.array([0, *self._row_ends])[np.cumsum([len(v) for v in self._levels])]
        numbers = numbers_of_kinds(limits)
        self._labels = StepLabels(
            self._ranks, int(self._ends[0]), ranges.names,
            {number: name for name, number in numbers.items()},
        )  # fmt: skip
        self._frames = [
            (mink.FRAME_TO_JAC_FUNC[t.frame_type], frame_id(model, t.frame_name, t.frame_type))
            for t in tasks
        ]
        self._lay_out(composed, 0)

    def _lay_out(self, composed: Controller, capacity: int) -> None:
        """Allocate the two arrays for up to ``capacity`` inequality rows, and make views."""
        nv, limits = composed.model.nv, self._limits
        # Each soft band has a slack ε ≥ 0: an additional unknown that moves no joint.
        self._slacks = sum(band.weight is not None for task in self._tasks for band in task.bands)
        table, types = with_slacks(*table_of(limits, nv), self._slacks)
        n = nv + self._slacks
        self._size = size = Sizes(
            nv=n, m=sum(self._ranks), tasks=len(self._tasks), levels=len(self._ends),
            limits=len(types),
            free=6 * len(self._tasks) if self.twist_space else 0,
            others=n if self._soft_tasks else 0, k=capacity,
        )  # fmt: skip
        self._capacity = capacity
        self._floats, self._integers = STEP.allocate(size)
        self._by_rows: dict[int, tuple[Integers, StepInputs, Program, Array]] = {}
        self._take_rows(0)
        g = self._inputs
        self._python_tasks = [n for n, task in enumerate(self._tasks) if not rows_known(task)]
        for n, task in enumerate(self._tasks):
            known = n not in self._python_tasks
            g.kinds[n] = (
                kinds_of(task.projector) if known else (task.projector.rank, 0, FROM_PYTHON)
            )
        g.ends[:], g.types[:] = self._ends, types
        g.addresses[:nv], g.addresses[nv:] = self._ranges.qpos, -1
        g.tolerances[:] = TOLERANCES  # type: ignore[index]
        g.middle[:nv] = self._ranges.middle
        g.metric[:nv], g.metric[nv:], g.limits[:] = composed.metric, composed.metric.max(), table
        self._take_settings(composed)
        for shape, task in zip(g.shapes, self._tasks, strict=True):
            shape[:] = shape_of(task.projector, *_step_sizes(task))
        # Of the tasks and targets that are in the arrays now.
        self._known_tasks = [-1] * len(self._tasks)
        self._known_poses: list[Any] = [None] * len(self._tasks)
        self._objectives = SecondaryArrays(
            composed.secondary, self._ranges, g.stiffness[:nv], g.displacement[:nv]
        )
        self._tables = LimitTables(limits, g.limits[:, :nv])
        self._calls_python = bool(self._tables.evaluated or self._soft_tasks or self._python_tasks)
        self._banded = False
        self._data: mujoco.MjData | None = None
        self._jacs: list[tuple[Callable[..., None], Array, int, int]] = []
        self._lay_out_kinematics(composed.model)

    def _lay_out_kinematics(self, model: mujoco.MjModel) -> None:
        """Write which joints move which frame, and the numbers of MuJoCo's joints."""
        g = self._inputs
        g.links[:] = NO_EFFECT
        self._without_links: list[int] = []
        for number, task in enumerate(self._tasks):
            dofs = dofs_above(model, task.frame_name, task.frame_type)
            if number in self._python_tasks:
                continue
            if (self._ranges.qpos[dofs] < 0).any():  # a ball or free joint
                g.links[number] = PYTHON_JACOBIAN
                self._without_links.append(number)
                continue
            slides = ~self._ranges.hinge[dofs]
            g.links[number, dofs] = 2 * model.dof_jntid[dofs] + slides
        self._moving = [True] * len(self._tasks)
        g.sources[-2:] = model.nq, model.njnt

    def _take_rows(self, k: int) -> None:
        """Take the views for k inequality rows; they are made the first time."""
        self._size = self._size._replace(k=k)
        known = self._by_rows.get(k)
        if known is None:
            known = self._by_rows[k] = self._views()
        self._inputs: StepInputs
        self._program: Program
        table, self._inputs, self._program, self._result = known
        self._velocity = self._program.x[: self._model.nv]
        self._integers[: STEP.head] = table

    def _views(self) -> tuple[Integers, StepInputs, Program, Array]:
        """The table of the record at the present size, and views of a step's arrays."""
        size, integers = self._size, self._integers
        STEP.resize(integers, size)
        table = integers[: STEP.head].copy()
        stages = STEP.arrays(self._floats, integers, integers)
        first = STEP_INPUTS.layout(size).floats
        result = self._floats[first : first + PROGRAM.end(size, "sensitivity")]
        return table, stages.inputs, stages.program, result

    def __call__(
        self,
        composed: Controller,
        configuration: mink.Configuration,
        dt: float,
        h: Displacement,
    ) -> Step | None:
        """Compute the step; ``None`` if the reference has to compute it.

        The latter includes a controller whose composition has changed since it was prepared.

        Raises:
            mink.TargetNotSet: If a task has no target.
        """
        if composed.revision != self._revision or composed.limits != self._limits:
            if not self._is_of(composed):
                return None
            self._take_settings(composed)
        if not self._tasks_known():
            return None
        rows: Sequence[Named] = _NO_ROWS
        if self._calls_python or self._banded or self._size.k or self._slacks:
            updated = self._update_rows(composed, configuration, dt)
            if updated is None:
                return None
            rows = updated
        if configuration.data is not self._data:
            self._bind(configuration)
        use_secondary = h.acts
        if use_secondary:
            self._objectives.update(configuration, h)
        if self._tables.update():  # braking and damping depend on which limits there are
            self._take_settings(composed)
        if self._jacs:
            self._write_jacobians()
        status = self._live_step(self._floats, self._integers, dt, use_secondary, self.twist_space)
        if status in (AT_THE_EDGE, INFEASIBLE):
            status = self._edge_step(status, composed, dt, use_secondary)
        if status == REFUSED or (self._banded and self._relaxes_a_band(status)):
            return None
        known: dict[str, Any] = {
            "velocity": self._velocity.copy(), "scale": 1.0, "status": _SOLVED,
            "solver": COMPILED,
        }  # fmt: skip
        lost = tuple if status == DONE else self._describe(status, known, composed, configuration)
        if rows:
            outside = (getattr(source, "recovering", ()) for source in rows)
            known["recovering"] = tuple(chain.from_iterable(outside))
        # A ``KernelResult``, made when somebody asks.
        numbers, as_posed = self._result.tobytes(), status in _AS_POSED
        return Step.of(
            attribute_of, (numbers, self._size, self._labels, rows, as_posed, lost), known
        )

    def _edge_step(self, status: int, composed: Controller, dt: float, use_secondary: bool) -> int:
        """Compute what does not fit, or is near a singularity; return its outcome."""
        if composed.on_infeasible == "raise":
            return REFUSED
        outcome: int = live_edge_step(
            self._floats, self._integers, dt, use_secondary, self.twist_space, status == INFEASIBLE
        )
        return outcome

    def _describe(
        self,
        status: int,
        known: dict[str, Any],
        composed: Controller,
        configuration: mink.Configuration,
    ) -> Callable[[], tuple[LostDirection, ...]]:
        """Write what a step does not meet; return what computes the directions that it lacks."""
        known["status"], known["scale"] = _STATUSES[status], self._program.sensitivity.item(0)
        if len(self._levels) > 1 and status in (RELAXED, PRIORITIZED, SCALED):
            known["gaps"] = tuple(self._program.levels.gaps.tolist())
        if self._program.lacks[0] > 0.0:
            return self._losses(composed, configuration)
        return tuple

    @cached_property
    def _live_step(self) -> Callable[..., int]:
        return bound(live_step, self._floats, self._integers, 1.0, True, self.twist_space)

    def _write_jacobians(self) -> None:
        """Write the Jacobians of frames with ball or free joints."""
        for jac, rows_of_task, index, number in self._jacs:
            jac(self._model, self._data, rows_of_task[:3], rows_of_task[3:], index)
            self._inputs.jacobians[number, :, : self._model.nv] = rows_of_task

    def _relaxes_a_band(self, status: int) -> bool:
        """Whether a band is relaxed with its level, which the kernel treats as a limit."""
        return status in (RELAXED, PRIORITIZED) and (len(self._levels) > 1 or not self._smooth)

    def _make_room(self, composed: Controller, k: int) -> None:
        """Lay out the step for ``k`` inequality rows."""
        if k > self._capacity:
            self._lay_out(composed, 2 * k)
        self._take_rows(k)

    def load(self) -> None:
        """Load, or compile, what infeasible steps take; it overwrites the last step's program."""
        live_edge_step(self._floats, self._integers, 1.0, False, self.twist_space, False)

    def _losses(
        self, composed: Controller, configuration: mink.Configuration
    ) -> Callable[[], tuple[LostDirection, ...]]:
        """What computes the directions in which the step delivers less than is asked."""
        first, nv = int(self._ends[0]), self._model.nv
        A, b = self._program.A[:first, :nv].copy(), self._program.b[:first].copy()
        tasks, threshold, velocity = self._tasks, composed.singularity, self._velocity.copy()
        g, known = self._inputs, self._python_tasks
        turns = g.poses[:, :9].copy(), g.targets[:, :9].copy()
        states = [task.state(configuration) if n in known else None for n, task in enumerate(tasks)]

        def lost() -> tuple[LostDirection, ...]:
            bases = [
                task.projector.in_world(body.reshape(3, 3), target.reshape(3, 3)).basis
                if state is None
                else state.basis
                for task, body, target, state in zip(tasks, *turns, states, strict=True)
            ]
            return in_words(lost_directions(A, b, velocity, threshold), tasks, bases)

        return lost

    def _is_of(self, composed: Controller) -> bool:
        return (
            composed.limits == self._limits
            and composed.secondary is self._secondary
            and composed.metric is self._metric
            and composed.secondary_space == self._space
            and composed.levels is self._levels
            and composed.soft_tasks is self._soft_tasks
            and composed.solver == COMPILED
        )

    def _update_rows(
        self, composed: Controller, configuration: mink.Configuration, dt: float
    ) -> Sequence[Named] | None:
        """Evaluate limits of other classes, bands and other tasks' costs into the arrays.

        Returns:
            The sources of the inequality rows; ``None`` if the numbers of rows or slacks of the
            tasks have changed.
        """
        evaluated = self._tables.rows(configuration, dt)
        costs = mink_costs(self._soft_tasks, configuration, dt) if self._soft_tasks else None
        rows: list[LimitRows | BandRows] = [s for s in evaluated if s is not None]
        slacks = 0
        for task in self._tasks if self._banded else ():
            bands = task.band_rows(configuration, dt)
            slacks += sum(band.weight is not None for band in bands)
            rows += bands
        k = 0
        for source in rows:
            k += len(source.bounds)
        if k > self._capacity or slacks != self._slacks:
            self._lay_out(composed, max(2 * k, self._capacity))
            self._tasks_known()
        if slacks != self._slacks:
            return None
        if k != self._size.k:
            self._make_room(composed, k)
        self._tables.write_bounds(evaluated)
        hardest = 0.0
        if costs is not None:
            nv = composed.model.nv
            self._inputs.quadratic[:nv, :nv], self._inputs.linear[:nv] = costs
            hardest = float(np.abs(costs[0]).max())
        self._write_rows(rows, composed, hardest)
        if self._python_tasks and not self._update_python_rows(composed, configuration, dt):
            return None
        return rows

    def _write_rows(
        self, rows: list[LimitRows | BandRows], composed: Controller, hardest: float
    ) -> None:
        """Write the inequality rows; ``hardest`` is the largest quadratic cost of other tasks."""
        nv, metric = composed.model.nv, self._inputs.metric
        first, slack, G = 0, nv, self._program.G
        cost = 0.0
        if self._slacks:  # they are scaled so that their cost is about that of the joints
            cost = max(composed.joint_weight * float(metric[:nv].max()), hardest)
            metric[nv:] = cost / composed.joint_weight
            G[:, nv:] = 0.0
        for source in rows:
            end = first + len(source.bounds)
            G[first:end, :nv], self._program.g[first:end] = source.rows, source.bounds
            rooms = source.rooms if isinstance(source, LimitRows) else 0.0
            self._inputs.rooms[first:end] = rooms
            if isinstance(source, BandRows) and source.weight is not None:
                G[first:end, slack] = -np.sqrt(cost / source.weight)
                slack += 1
            first = end

    def _update_python_rows(
        self, composed: Controller, configuration: mink.Configuration, dt: float
    ) -> bool:
        """Write the rows of tasks evaluated in Python; return whether their number is unchanged."""
        for number in self._python_tasks:
            task, last = self._tasks[number], self._row_ends[number]
            first = last - self._ranks[number]
            A, b = task.velocity_rows(configuration, dt)
            if len(b) != last - first:
                return False
            self._inputs.python_rhs[first:last] = b
            if self._brakes and task.feedforward is not AT_REST:
                state = task.state(configuration)
                self._inputs.python_forward[first:last] = state.basis.T @ state.feedforward
            else:
                self._inputs.python_forward[first:last] = 0.0
            self._inputs.python_rows[first:last, : A.shape[1]] = A
            if self.twist_space:
                free = free_rows(task.state(configuration), composed.free_twist_costs)
                block = self._inputs.python_free[6 * number : 6 * number + 6]
                block[:], block[: len(free), : free.shape[1]] = 0.0, free
        return True

    def of_any_configuration(
        self, composed: Controller
    ) -> tuple[tuple[npt.NDArray[Any], ...], Array] | None:
        """Arrays laid out as ``step_record``, and the tasks' own targets (T, 18).

        The caller fills in poses, Jacobians and targets. ``None`` if Python has to evaluate
        something at each configuration: bands, limits of other classes, other tasks or secondaries.
        """
        if self._objectives.others or self._calls_python or any(task.bands for task in self._tasks):
            return None
        for number, task in enumerate(self._tasks):
            pose = task.target_wxyz_xyz
            if pose is not None:
                row = self._inputs.targets[number]
                mujoco.mju_quat2Mat(row[:9], pose[:4])
                row[9:12], row[12:] = pose[4:], task.feedforward
        self._objectives.update(None, EVERYTHING)
        if self._tables.update():
            self._take_settings(composed)
        return (self._floats, self._integers), self._inputs.targets

    def _tasks_known(self) -> bool:
        """Write what has changed in the tasks; return whether the kernel still supports them."""
        known, poses = self._known_tasks, self._known_poses
        for number, task in enumerate(self._tasks):
            if task.revision != known[number]:
                if (
                    task.projector is not self._projectors[number]
                    or rows_known(task) is (number in self._python_tasks)
                    or (task.frame_name, task.frame_type) != self._named[number]
                ):
                    return False
                self._inputs.shapes[number, 24:] = _step_sizes(task)
                self._banded = any(v.bands for v in self._tasks)
                # Of a derived class ``bands`` may be computed.
                known[number] = -1 if number in self._python_tasks else task.revision
            pose = task.target_wxyz_xyz
            if pose is not poses[number] or pose is None:
                if pose is None:
                    raise mink.TargetNotSet(task.name)
                if number not in self._python_tasks:
                    self._write_target(number, task)
                poses[number] = pose
        return True

    def _bind(self, configuration: mink.Configuration) -> None:
        """Write the addresses of another configuration's data."""
        self._data = data = configuration.data  # the reference keeps the addresses valid
        arrays = [data.qpos, data.xaxis, data.xanchor]
        self._jacs = []
        for number, (task, (jac, index)) in enumerate(zip(self._tasks, self._frames, strict=True)):
            arrays.append(getattr(data, mink.FRAME_TO_XMAT_ATTR[task.frame_type])[index])
            arrays.append(getattr(data, mink.FRAME_TO_POS_ATTR[task.frame_type])[index])
            if number in self._without_links:
                rows = np.zeros((6, self._model.nv))
                self._jacs.append((jac, rows, index, number))
        self._inputs.sources[:-2] = [_address(array) for array in arrays]

    def _write_target(self, number: int, task: TwistTask) -> None:
        """Write a task's target."""
        self._inputs.target_poses[number] = task.target_wxyz_xyz
        moves = task.feedforward is not AT_REST
        if moves or self._moving[number]:
            self._inputs.targets[number, 12:] = task.feedforward
            self._moving[number] = moves

    def _take_settings(self, composed: Controller) -> None:
        self._revision = composed.revision
        self._smooth = composed.smooth and composed.singularity > 0.0
        limited = any(
            np.isfinite(v.max_acceleration).any()
            for v in self._limits
            if isinstance(v, MotionLimit)
        )
        self._brakes = self._smooth and composed.braking and limited
        settings = kernel_settings(
            composed.singularity, composed.joint_weight, _INFEASIBLE[composed.on_infeasible],
            smooth=self._smooth,
            trusts=self._smooth and damps_by_error(self._limits, composed.on_infeasible),
            braking=self._brakes,
        )  # fmt: skip
        self._inputs.settings[:] = settings  # type: ignore[index]
        self._inputs.free_costs[:] = composed.free_twist_costs


_step_sizes = attrgetter("gain", "max_linear_step", "max_angular_step")
"""A task's gain and largest linear and angular step."""


def _address(array: npt.NDArray[Any]) -> int:
    assert array.flags.c_contiguous and array.dtype in (np.float64, np.int64)
    address: int = array.ctypes.data
    return address

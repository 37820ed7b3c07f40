"""A controller's step as machine code, on arrays that are allocated once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

import mink
import mujoco

from qp_twist.checks import changes
from qp_twist.constraints import LimitRows, Named
from qp_twist.control.kernel_result import StepLabels, attribute_of
from qp_twist.control.limit_tables import numbers_of_kinds
from qp_twist.control.mink_costs import is_elastic, mink_costs
from qp_twist.control.posing import Displacement, in_words
from qp_twist.control.sorted_limits import SortedLimits
from qp_twist.control.step import Status, Step
from qp_twist.control.step_arrays import StepArrays, is_soft
from qp_twist.control.task_arrays import address
from qp_twist.kernel import COMPILED
from qp_twist.kernel.compiling import bound
from qp_twist.kernel.live_step import live_edge_step, live_step
from qp_twist.kernel.step_record import (
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
from qp_twist.kinematics import BandRows
from qp_twist.kinematics.joint_ranges import joint_names
from qp_twist.qp import LostDirection, lost_directions

if TYPE_CHECKING:
    from qp_twist.control.controller import Controller

_NO_ROWS: Sequence[Named] = ()
_SOLVED = Status.SOLVED  # looked up once: in each step it would take 0.1 µs
_STATUSES = {
    SCALED: Status.SCALED, RELAXED: Status.RELAXED,
    PRIORITIZED: Status.PRIORITIZED, BRAKED: Status.SCALED, BRAKED_BELOW: Status.PRIORITIZED,
    FADED: Status.DEGRADED,
}  # fmt: skip
_AS_POSED = DONE, BRAKED, BRAKED_BELOW, FADED
"""Outcomes of a program that was solved as posed, if for less than the tasks ask."""


class CompiledStep:
    """The kernel's step for one controller that ``composition_known`` accepts.

    Limits of other classes, tolerance bands, tasks of derived classes or with a carried target, and
    the costs of other tasks are evaluated in Python.

    Attributes:
        free: Lock of the arrays, which only one thread may use at a time.
        revision: That of the controller; −1 if its arrays no longer fit its tasks.
        limits: The limits.
    """

    def __init__(self, composed: Controller, limits: SortedLimits) -> None:
        """Allocate the arrays for a composition that ``composition_known`` accepts."""
        self.free = threading.Lock()
        self.limits = limits
        self._twist_space = twist_space(composed)
        numbers, arrays = numbers_of_kinds(limits.limits), StepArrays(composed)
        self._labels = StepLabels(
            tuple(task.projector.rank for task in composed.twist_tasks),
            int(arrays.views.arrays.ends[0]),
            joint_names(composed.model),
            {number: name for name, number in numbers.items()},
        )
        self._use(arrays, composed)

    def _use(self, arrays: StepArrays, composed: Controller) -> StepArrays:
        """Compute with these arrays from now on."""
        self._arrays, self.revision = arrays, composed.revision
        self._memory = address(arrays.memory[0]), address(arrays.memory[1])
        self._followed: object = None
        self._data: mujoco.MjData | None = None
        return arrays

    def compute(
        self, composed: Controller, configuration: mink.Configuration, dt: float, h: Displacement
    ) -> Step | None:
        """Compute the step; ``None`` if the reference has to. A task without target is refused."""
        self._aim()
        latest, use_secondary, rows = changes.latest, h.acts, _NO_ROWS
        if (
            latest is not self._followed
            or (use_secondary and h is not self._arrays.secondary.h)
            or self._unsteady
        ):
            followed = self._follow(composed, configuration, dt, h)
            if followed is None:
                return None
            self._followed, rows = latest, followed
        arrays, data = self._arrays, configuration.data
        if data is not self._data:
            arrays.bind(data)
            self._data = data  # the reference keeps the addresses valid
        arrays.limits.write_velocities()
        status = self._live_step(*self._memory, dt, use_secondary, self._twist_space)
        lost: Callable[[], tuple[LostDirection, ...]] = tuple
        if status != DONE:  # seldom
            if status in (AT_THE_EDGE, INFEASIBLE):
                if composed.on_infeasible == "raise" or any(map(is_elastic, rows)):
                    return None
                status = live_edge_step(
                    *self._memory, dt, use_secondary, self._twist_space, status == INFEASIBLE
                )
            if status == REFUSED or (rows and self._relaxes_a_band(status, rows, composed)):
                return None
            lost = self._losses(composed, configuration)
        views, as_posed = arrays.views, status in _AS_POSED
        result = views.result.tobytes(), arrays.size, self._labels, rows, as_posed, lost
        step = Step.with_later(attribute_of, result)
        known = step.__dict__
        known["velocity"], known["scale"] = views.velocity.copy(), 1.0
        known["status"], known["solver"] = _SOLVED, COMPILED
        if status != DONE:
            self._describe(status, known)
        if rows:
            outside = (getattr(source, "recovering", ()) for source in rows)
            known["recovering"] = tuple(chain.from_iterable(outside))
        return step

    def load(self) -> None:
        """Load, or compile, what infeasible steps take; it overwrites the last step's program."""
        live_edge_step(*self._memory, 1.0, False, self._twist_space, False)

    @cached_property
    def _live_step(self) -> Callable[..., int]:
        return bound(live_step, *self._memory, 1.0, True, self._twist_space)

    def _aim(self) -> None:
        """Write the targets that are new."""
        for known in self._arrays.tasks:
            pose = known.task.target_floats
            if pose is not known.pose or pose is None:
                known.aim(pose)

    def _follow(
        self, composed: Controller, configuration: mink.Configuration, dt: float, h: Displacement
    ) -> Sequence[Named] | None:
        """Write what has been assigned, and what Python evaluates at each configuration.

        Returned are the sources of the inequality rows; ``None`` if the kernel no longer supports
        the tasks.
        """
        for known in self._arrays.tasks:
            if known.task.revision != known.revision and not known.update():
                self.revision = -1  # the arrays are made anew in the next step
                return None
        needed = self._arrays.evaluates
        rows = self._evaluated(composed, configuration, dt) if needed else _NO_ROWS
        arrays = self._arrays
        arrays.secondary.update(configuration, h)
        if arrays.limits.update():  # braking and damping depend on which limits there are
            arrays.take_settings(composed)
        for known in arrays.without_links:
            known.write_jacobian(configuration)
        self._unsteady = bool(
            arrays.evaluates or arrays.limits.uncounted or arrays.secondary.others
            or arrays.without_links
        )  # fmt: skip
        return rows

    def _evaluated(
        self, composed: Controller, configuration: mink.Configuration, dt: float
    ) -> Sequence[Named] | None:
        """Write limits of other classes, bands, and tasks and costs that Python states.

        Returned are the sources of the inequality rows; ``None`` if a task has other rows.
        """
        arrays = self._arrays
        limits = arrays.limits.rows(configuration, dt)
        rows: list[LimitRows | BandRows] = [source for source in limits if source is not None]
        for task in composed.twist_tasks:
            if task.bands:
                rows += task.band_rows(configuration, dt)
        costs = None
        if composed.soft_tasks:
            *costs, elastic = mink_costs(composed.soft_tasks, configuration, dt)
            rows += elastic
        k = sum([len(source.bounds) for source in rows])
        slacks = sum([is_soft(source) for source in rows])
        if k > arrays.capacity or slacks != arrays.slacks:
            arrays = self._use(StepArrays(composed, 2 * k, slacks), composed)
            self._aim()
        if k != arrays.size.k:
            arrays.resize(k)
        arrays.limits.write_bounds(limits)
        arrays.write_rows(rows, costs, composed.joint_weight)
        for known in arrays.tasks:
            if known.in_python and not known.evaluate(configuration, dt, composed.free_twist_costs):
                return None
        return rows

    def _relaxes_a_band(self, status: int, rows: Sequence[Named], composed: Controller) -> bool:
        """Whether a band is relaxed with its level, which the kernel treats as a limit."""
        return (
            status in (RELAXED, PRIORITIZED)
            and (len(composed.levels) > 1 or not composed.smooth or composed.singularity <= 0.0)
            and any(isinstance(source, BandRows) for source in rows)
        )

    def _describe(self, status: int, known: dict[str, object]) -> None:
        """Write what a step does not meet."""
        s = self._arrays.views.arrays
        known["status"], known["scale"] = _STATUSES[status], s.sensitivity.item(0)
        if len(s.gaps) > 1 and status in (RELAXED, PRIORITIZED, SCALED):
            known["gaps"] = tuple(s.gaps.tolist())

    def _losses(
        self, composed: Controller, configuration: mink.Configuration
    ) -> Callable[[], tuple[LostDirection, ...]]:
        """What computes the directions in which the step delivers less than is asked."""
        s, tasks = self._arrays.views.arrays, composed.twist_tasks
        if s.lacks[0] <= 0.0:
            return tuple
        first, nv = self._labels.first, composed.model.nv
        A, b = s.A[:first, :nv].copy(), s.b[:first].copy()
        threshold, velocity = composed.singularity, s.x[:nv].copy()
        bases = [task.basis(configuration) for task in self._arrays.tasks]

        def lost() -> tuple[LostDirection, ...]:
            found = lost_directions(A, b, velocity, threshold)
            return in_words(found, tasks, [basis() for basis in bases])

        return lost


def twist_space(composed: Controller) -> bool | None:
    """``True`` for the twist-space cost, else ``None``: see ``step_kernel.costs``."""
    return True if composed.secondary_space == "twist" and composed.twist_tasks else None

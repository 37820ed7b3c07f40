"""The arrays of a compiled step, allocated once, and what keeps their parts up to date."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import LimitRows
from qp_twist.control.composition import damps_by_error
from qp_twist.control.limit_tables import LimitTables, table_of
from qp_twist.control.secondary_arrays import SecondaryArrays
from qp_twist.control.task_arrays import TaskArrays, address
from qp_twist.kernel.record import Floats, Integers
from qp_twist.kernel.step_record import RAISE, RELAX, RESULT, SCALE, STEP, Settings, Sizes, Step
from qp_twist.kinematics import BandRows, JointRanges

if TYPE_CHECKING:
    from qp_twist.control.controller import Controller

_INFEASIBLE = {"raise": RAISE, "scale": SCALE, "relax": RELAX}


class Views(NamedTuple):
    """Named views of a step's arrays, for one number of inequality rows."""

    table: Integers
    """Offsets and shapes of all fields, at the head of the integers."""
    arrays: Step
    velocity: Array
    """q̇, (nv,)."""
    result: Floats
    """What a step's attributes are computed from later: see ``kernel_result``."""


class StepArrays:
    """Floats and integers of one controller's steps.

    Attributes:
        memory: The two arrays, as ``kernel.live_step`` takes them.
        size: The present sizes.
        capacity: Number of inequality rows that there is room for.
        slacks: Number of slacks ε ≥ 0, one for each soft band or elastic row: unknowns that move
            no joint.
        views: Views for the present number of inequality rows.
        tasks: The tasks in the arrays.
        without_links: Those of them whose Jacobians Python has to write at each configuration.
        secondary: The secondary objectives.
        limits: The limits.
    """

    def __init__(self, composed: Controller, capacity: int = 0, slacks: int = 0) -> None:
        """Allocate the arrays, and write the controller to them."""
        model, limits = composed.model, composed.limits
        nv, n, ranges = model.nv, model.nv + slacks, JointRanges.of(model)
        table, types = table_of(limits, nv, slacks)
        ranks = [task.projector.rank for task in composed.twist_tasks]
        self.size = Sizes(
            nv=n, m=sum(ranks), tasks=len(ranks), levels=len(composed.levels), limits=len(types),
            free=6 * len(ranks) if composed.secondary_space == "twist" else 0,
            others=n if composed.soft_tasks else 0, k=capacity,
        )  # fmt: skip
        self.memory = STEP.allocate(self.size)
        self.capacity, self.slacks = capacity, slacks
        self._views_by_rows: dict[int, Views] = {}
        self.resize(0)
        s = self.views.arrays
        starts = np.cumsum([0, *ranks])
        s.ends[:] = starts[np.cumsum([len(level) for level in composed.levels])]
        s.types[:], s.limits[:] = types, table
        s.addresses[:nv], s.addresses[nv:] = ranges.qpos, -1
        s.middle[:nv] = ranges.middle
        s.metric[:nv], s.metric[nv:] = composed.metric, composed.metric.max()
        s.sources[-2:] = model.nq, model.njnt
        self.tasks = [
            TaskArrays(task, i, int(starts[i]), model, s)
            for i, task in enumerate(composed.twist_tasks)
        ]
        self.without_links = [known for known in self.tasks if known.jacobian_in_python]
        self.secondary = SecondaryArrays(
            composed.secondary, ranges, s.stiffness[:nv], s.displacement[:nv]
        )
        self.limits = LimitTables(limits, s.limits[:, :nv])
        self.take_settings(composed)

    @property
    def evaluates(self) -> bool:
        """Whether Python has to evaluate something at each configuration."""
        return bool(
            self.limits.evaluated
            or self.size.others
            or self.size.k
            or self.slacks
            or any(known.in_python or known.task.bands for known in self.tasks)
        )

    def take_settings(self, composed: Controller) -> None:
        """Write the controller's settings, which may have changed."""
        smooth = composed.smooth and composed.singularity > 0.0
        s = self.views.arrays
        s.settings[:] = Settings(  # type: ignore[index]
            composed.singularity, composed.joint_weight, _INFEASIBLE[composed.on_infeasible],
            smooth, smooth and damps_by_error(composed.limits, composed.on_infeasible),
            smooth and composed.braking and composed.hardest is not None,
        )  # fmt: skip
        s.free_costs[:] = composed.free_twist_costs

    def resize(self, k: int) -> None:
        """Take the views for k inequality rows; they are made the first time."""
        self.size = size = self.size._replace(k=k)
        floats, integers = self.memory
        known = self._views_by_rows.get(k)
        if known is None:
            table = integers[: STEP.head] = STEP.layout(size).table
            arrays: Step = STEP.arrays(floats, integers)
            result = floats[STEP.span(size, *RESULT)]
            known = Views(table, arrays, arrays.x[: size.nv - self.slacks], result)
            self._views_by_rows[k] = known
        self.views = known
        integers[: STEP.head] = known.table

    def bind(self, data: mujoco.MjData) -> None:
        """Write where q, joint axes and frames are in MuJoCo's data, which have to stay alive."""
        for at, array in enumerate((data.qpos, data.xaxis, data.xanchor)):
            self.views.arrays.sources[at] = address(array)
        for task in self.tasks:
            task.bind(data)

    def write_rows(
        self,
        rows: Sequence[LimitRows | BandRows],
        costs: Sequence[Array] | None,
        joint_weight: float,
    ) -> None:
        """Write inequality rows with their slacks, and the costs of other tasks."""
        s, nv = self.views.arrays, self.size.nv - self.slacks
        metric, G, hardest = s.metric, s.G, 0.0
        if costs is not None:
            s.quadratic[:nv, :nv], s.linear[:nv] = costs
            hardest = float(np.abs(costs[0]).max())
        cost = 0.0
        if self.slacks:
            cost = max(joint_weight * float(metric[:nv].max()), hardest)
            G[:, nv:] = 0.0
        first, slack = 0, nv
        for source in rows:
            end = first + len(source.bounds)
            G[first:end, :nv], s.g[first:end] = source.rows, source.bounds
            if isinstance(source, BandRows) and source.weight is not None:
                quadratic, unit, linear = source.slack(cost)
                metric[slack], G[first:end, slack] = quadratic / joint_weight, -unit
                s.linear[slack : slack + 1] = linear  # none without other tasks
                slack += 1
            first = end

    def aims(self) -> Array:
        """R_d, p_d and the twist of each task's target, (T, 18), in the arrays themselves."""
        targets = self.views.arrays.targets
        for row, known in zip(targets, self.tasks, strict=True):
            pose = known.task.target_floats
            if pose is not None:
                pose = np.frombuffer(pose)
                mujoco.mju_quat2Mat(row[:9], pose[:4])
                row[9:12], row[12:] = pose[4:], known.task.feedforward
        return targets


def is_soft(source: LimitRows | BandRows) -> bool:
    """Whether these are the rows of a soft band, which has a slack."""
    return isinstance(source, BandRows) and source.weight is not None

"""Which way of solving a controller's plain steps have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qp_twist.controller.composition import composition_known
from qp_twist.controller.lean_step import LeanStep
from qp_twist.controller.prepared_step import PreparedStep
from qp_twist.fast import COMPILED
from qp_twist.qp.workspaces import workspace

if TYPE_CHECKING:
    from qp_twist.controller.controller import Controller


def prepare(controller: Controller, solver: str) -> PreparedStep | None:
    """The controller's step on preallocated arrays; ``None`` where there is none.

    That is so where its composition is another, or the solver keeps no memory.
    """
    if not composition_known(controller.levels, controller.limits):
        return None
    if solver == COMPILED:
        from qp_twist.controller.compiled_step import CompiledStep  # with numba

        return CompiledStep(controller, solver)
    rows = sum(task.projector.rank for task in controller.twist_tasks)
    backend = workspace(solver, controller.model.nv, rows)
    return None if backend is None else LeanStep(controller, solver, backend)

"""Which way of solving a controller's plain steps have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from qp_twist.controller.composition import composition_known
from qp_twist.controller.lean_step import LeanStep
from qp_twist.controller.posing import FASTEST, NEARLY_UNSEEN
from qp_twist.controller.prepared_step import PreparedStep
from qp_twist.fast import COMPILED
from qp_twist.qp.workspaces import workspace

if TYPE_CHECKING:
    from qp_twist.controller.controller import Controller


def prepare(controller: Controller, solver: str) -> PreparedStep | None:
    """The controller's step on preallocated arrays; ``None`` where there is none.

    That is so where its composition is another, or the solver keeps no memory.
    """
    if not composition_known(controller.levels, controller.soft_tasks, controller.limits):
        return None
    given = controller.model, controller.twist_tasks, controller.secondary, controller.limits
    settings: dict[str, Any] = {
        "solver": solver,
        "metric": controller.metric,
        "twist_space": controller.secondary_space == "twist",
        "free_costs": controller.free_twist_costs,
        "nearly_unseen": NEARLY_UNSEEN,
        "fastest": FASTEST,
    }
    if solver == COMPILED:
        from qp_twist.controller.compiled_step import CompiledStep  # with numba

        return CompiledStep(*given, **settings)
    rows = sum(task.projector.rank for task in controller.twist_tasks)
    backend = workspace(solver, controller.model.nv, rows)
    return None if backend is None else LeanStep(*given, **settings, backend=backend)

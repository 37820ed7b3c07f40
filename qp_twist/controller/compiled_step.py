"""A controller's plain step as machine code. Needs the extra ``fast``."""

from __future__ import annotations

from qp_twist.controller.prepared_step import PreparedStep
from qp_twist.fast import step_kernel


class CompiledStep(PreparedStep):
    """The arrays of one controller and the kernel on them."""

    def _solve(self, dt: float, use_secondary: bool) -> bool:
        status: int = step_kernel.step_kernel(
            self._floats, self._integers, self._qpos, dt, use_secondary
        )
        return status == step_kernel.DONE

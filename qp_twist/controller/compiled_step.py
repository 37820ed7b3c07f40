"""A controller's plain step as machine code. Needs the extra ``fast``."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.composition import Composition
from qp_twist.controller.prepared_step import PreparedStep
from qp_twist.fast.live_step import ELSEWHERE, GIVEN, live_step
from qp_twist.fast.step_kernel import DONE
from qp_twist.kinematics import TwistTask
from qp_twist.kinematics.serial_chain import dofs_above
from qp_twist.kinematics.twist_task import AT_REST


class CompiledStep(PreparedStep):
    """The arrays of one controller and the kernel on them."""

    def _lay_out(self, composed: Composition, room: int) -> None:
        super()._lay_out(composed, room)
        model, at = composed.model, self._at
        links = self._integers[at.links : at.sources].reshape(-1, model.nv)
        links[:] = ELSEWHERE
        self._given: list[int] = []
        for number, task in enumerate(self._tasks):
            dofs = dofs_above(model, task.frame_name, task.frame_type)
            if (self._ranges.qpos[dofs] < 0).any():  # a ball or free joint
                links[number] = GIVEN
                self._given.append(number)
                continue
            slides = ~self._ranges.hinge[dofs]
            links[number, dofs] = 2 * model.dof_jntid[dofs] + slides
        self._aims = self._floats[at.aims : at.jacobians].reshape(-1, 7)
        self._moving = [True] * len(self._tasks)
        self._sources = self._integers[at.sources : at.active - 2]
        self._integers[at.active - 2 : at.active] = model.nq, model.njnt

    def _aim(self, number: int, task: TwistTask) -> None:
        assert task.target is not None
        self._aims[number] = task.target.wxyz_xyz
        moves = task.feedforward is not AT_REST
        if moves or self._moving[number]:
            self._targets[number, 12:] = task.feedforward
            self._moving[number] = moves

    def _bind(self, configuration: mink.Configuration) -> None:
        super()._bind(configuration)
        data = configuration.data  # it is kept, and with it what is at these addresses
        arrays = [data.qpos, data.xaxis, data.xanchor]
        for _, rotation, _, position in self._views:
            arrays += [rotation, position]
        self._sources[:] = [_address(array) for array in arrays]
        self._jacs = [self._jacs[number] for number in self._given]

    def _solve(self, dt: float, use_secondary: bool) -> bool:
        self._read_jacobians()
        status: int = live_step(self._floats, self._integers, dt, use_secondary)
        return status == DONE


def _address(array: Array) -> int:
    assert array.flags.c_contiguous and array.dtype == np.float64
    address: int = array.ctypes.data
    return address

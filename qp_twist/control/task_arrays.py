"""A task of a compiled step, in its arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.control.composition import rows_known
from qp_twist.control.posing import free_rows
from qp_twist.kernel.live_step import NO_EFFECT, PYTHON_JACOBIAN
from qp_twist.kernel.step_record import FROM_PYTHON, Step
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.kinematics.compiled_rows import kinds_of, shape_of
from qp_twist.kinematics.frame import frame_id
from qp_twist.kinematics.serial_chain import dofs_above
from qp_twist.kinematics.twist_task import AT_REST


class _Frame(NamedTuple):
    """The frame that a task controls: its name or id as stated, its type, and its id."""

    name: str | int
    type: str
    id: int

    def controlled_by(self, task: TwistTask) -> bool:
        """Whether it still is the frame of the task."""
        return (task.frame_name, task.frame_type) == self[:2]


class TaskArrays:
    """Writes a task and its target where they have changed between two steps.

    Attributes:
        task: The task.
        rows: Its place among the rows of all tasks.
        in_python: Whether Python states its rows: of a derived class, or with a carried target.
        jacobian_in_python: Whether Python computes its Jacobian: a ball or free joint moves the
            frame.
        revision: That of the task as it stands in the arrays; −1 if it has to be written.
        pose: The target's as it stands in the arrays, by identity.
    """

    def __init__(
        self, task: TwistTask, number: int, first: int, model: mujoco.MjModel, s: Step
    ) -> None:
        """Write the task with this number, whose rows begin at ``first``."""
        self.task, self._number, self._arrays = task, number, s
        stated = task.frame_name, task.frame_type
        self._projector, self._frame = task.projector, _Frame(*stated, frame_id(model, *stated))
        self.rows = slice(first, first + task.projector.rank)
        self.in_python = not rows_known(task)
        self.revision, self._moves = -1, True
        self.pose: bytes | None = None
        self._target = memoryview(s.target_poses[number]).cast("B")
        s.shapes[number] = shape_of(task.projector, *_step_sizes(task))
        s.links[number] = NO_EFFECT  # which joints move the frame: see ``live_step``
        self.jacobian_in_python = False
        if self.in_python:
            s.kinds[number] = task.projector.rank, 0, FROM_PYTHON
            return
        s.kinds[number] = kinds_of(task.projector)
        ranges, dofs = JointRanges.of(model), dofs_above(model, *stated)
        if (ranges.qpos[dofs] < 0).any():
            self.jacobian_in_python, s.links[number] = True, PYTHON_JACOBIAN
            return
        slides = ~ranges.hinge[dofs]
        s.links[number, dofs] = 2 * model.dof_jntid[dofs] + slides

    def update(self) -> bool:
        """Write the task's settings; return whether its rows are still computed in the same way."""
        task = self.task
        if (
            task.projector is not self._projector
            or rows_known(task) is self.in_python
            or not self._frame.controlled_by(task)
        ):
            return False
        self._arrays.shapes[self._number, 24:] = _step_sizes(task)
        # Of a derived class ``bands`` may be computed.
        self.revision = -1 if self.in_python else task.revision
        return True

    def aim(self, pose: bytes | None) -> None:
        """Write the task's target; a task without one is refused."""
        task, self.pose = self.task, pose
        if pose is None:
            raise mink.TargetNotSet(task.name)
        if self.in_python:
            return
        self._target[:] = pose
        moves = task.feedforward is not AT_REST
        if moves or self._moves:
            self._arrays.targets[self._number, 12:] = task.feedforward
            self._moves = moves

    def bind(self, data: mujoco.MjData) -> None:
        """Write where the frame's pose is in MuJoCo's data, which have to stay alive."""
        frame, at = self._frame, 3 + 2 * self._number
        self._arrays.sources[at : at + 2] = [
            address(getattr(data, of[frame.type])[frame.id])
            for of in (mink.FRAME_TO_XMAT_ATTR, mink.FRAME_TO_POS_ATTR)
        ]

    def write_jacobian(self, configuration: mink.Configuration) -> None:
        """Write the frame's world-aligned Jacobian, as MuJoCo computes it."""
        model, data, frame = configuration.model, configuration.data, self._frame
        J = np.empty((6, model.nv))
        mink.FRAME_TO_JAC_FUNC[frame.type](model, data, J[:3], J[3:], frame.id)
        self._arrays.jacobians[self._number, :, : model.nv] = J

    def evaluate(
        self, configuration: mink.Configuration, dt: float, free_costs: tuple[float, float]
    ) -> bool:
        """Write the rows that the task states; return whether there are as many as before."""
        task, s, rows, nv = self.task, self._arrays, self.rows, configuration.model.nv
        A, b = task.velocity_rows(configuration, dt)
        if len(b) != rows.stop - rows.start:
            return False
        s.python_rows[rows, :nv], s.python_rhs[rows], s.python_forward[rows] = A, b, 0.0
        if task.feedforward is not AT_REST:
            state = task.state(configuration)
            s.python_forward[rows] = state.basis.T @ state.feedforward
        if len(s.python_free):
            free = free_rows(task.state(configuration), free_costs)
            block = s.python_free[6 * self._number : 6 * self._number + 6]
            block[:], block[: len(free), :nv] = 0.0, free
        return True

    def basis(self, configuration: mink.Configuration) -> Callable[[], Array]:
        """What computes U of this step later."""
        if self.in_python:
            basis = self.task.state(configuration).basis
            return lambda: basis
        s, projector = self._arrays, self._projector
        body, target = (
            poses[self._number, :9].reshape(3, 3).copy() for poses in (s.poses, s.targets)
        )
        return lambda: projector.in_world(body, target).basis


def _step_sizes(task: TwistTask) -> tuple[float, float, float]:
    """A task's gain and largest linear and angular step."""
    return task.gain, task.max_linear_step, task.max_angular_step


def address(array: npt.NDArray[np.float64] | npt.NDArray[np.int64]) -> int:
    """Where an array's numbers are in memory."""
    assert array.flags.c_contiguous and array.dtype in (np.float64, np.int64)
    return array.ctypes.data

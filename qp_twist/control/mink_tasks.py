"""Costs and rows of mink's own tasks, by machine code in a third of mink's time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter
from typing import Any
from weakref import WeakKeyDictionary

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics.frame import frame_id
from qp_twist.kinematics.serial_chain import dofs_above

_POSTURE = "cost gain lm_damping target_q _v_ids k nq"
_FRAME = "cost gain lm_damping frame_name frame_type {} position_cost orientation_cost {}"
_ATTRIBUTES: dict[Any, tuple[str, ...]] = {
    mink.FrameTask: tuple(_FRAME.format("", "transform_target_to_world").split()),
    mink.RelativeFrameTask: tuple(
        _FRAME.format("root_name root_type", "transform_target_to_root").split()
    ),
    mink.PostureTask: tuple(_POSTURE.split()),
    mink.DampingTask: tuple(_POSTURE.split()),
}
"""What an object of each class has. One with anything else, be it a method of its own or what a
newer mink adds, is asked for its cost."""
_READERS = (
    "get_frame_jacobian", "_get_transform_frame_to_world_wxyz_xyz", "_get_transform_wxyz_xyz",
)  # fmt: skip
_STATED = ("compute_qp_residual", "_weighted_residual", "compute_error", "compute_jacobian")
_METHODS = attrgetter(
    *(f"Configuration.{name}" for name in (*_READERS, "q", "nv")),
    *(f"{kind.__name__}.{name}" for kind in _ATTRIBUTES for name in _STATED),
    "FrameTask._error_and_jacobian", "RelativeFrameTask._error_and_jacobian",
)  # fmt: skip
_AS_MADE = _METHODS(mink)
"""The methods whose results are computed here; if one is replaced, all tasks are asked."""

_places: WeakKeyDictionary[mujoco.MjModel, dict[tuple[Any, ...], Indices]] = WeakKeyDictionary()
"""By the frames of a task what :func:`_place` returns."""


class OwnTasks:
    """mink's own tasks at a configuration, read from MuJoCo's data as mink reads them."""

    def __init__(self, configuration: mink.Configuration) -> None:
        """Look whether mink's methods are as they were made; otherwise no task is known."""
        self._model, data = configuration.model, configuration.data
        self._as_made = (
            type(configuration) is mink.Configuration
            and configuration.__dict__.keys().isdisjoint(_READERS)
            and _METHODS(mink) == _AS_MADE
        )
        self._places = _places.setdefault(self._model, {})
        self._nv, self._q = self._model.nv, data.qpos
        self._poses = (
            data.xpos, data.xmat, data.geom_xpos, data.geom_xmat, data.site_xpos, data.site_xmat,
            data.cdof, data.subtree_com,
        )  # fmt: skip

    def add_costs(self, tasks: Sequence[Any], H: Array, c: Array) -> tuple[float, list[bool]]:
        """Add the costs of known tasks to the lower half of H (nv, nv), and to c (nv,).

        Returned are the sum of their dampings μ, and which tasks they are; others are to be asked.
        """
        known, places = [False] * len(tasks), []
        numbers: list[Array] = []
        settings: list[float] = []
        for index, task in enumerate(tasks):
            stated = self._stated(task)
            if stated is not None:
                place, target, cost = stated
                places.append(place)
                numbers += target, cost
                settings += task.gain, task.lm_damping
                known[index] = True
        if not places:
            return 0.0, known
        mu: float = _machine_code()[0](
            np.concatenate(places), np.concatenate(numbers), np.array(settings, dtype=np.float64),
            self._q, *self._poses, np.empty((self._nv + 1, 6)), H, c,
        )  # fmt: skip
        return mu, known

    def rows(self, task: Any) -> tuple[Array, Array] | None:
        """Jacobian (6, nv) and error (6,) of a known task of frames; ``None`` of any other."""
        stated = self._stated(task) if hasattr(task, "frame_name") else None
        if stated is None:
            return None
        rows, J = np.empty((self._nv + 1, 6)), np.zeros((6, self._nv))
        sign = -1.0 if type(task) is mink.FrameTask else 1.0
        place, target = stated[0], np.array(stated[1])  # it may be a view of other numbers
        _machine_code()[1](place, target, *self._poses, sign, rows, J)
        return J, rows[-1]

    def _stated(self, task: Any) -> tuple[Indices, Array, Array] | None:
        """Place, target and cost of a task; ``None`` if it has to be asked."""
        kind = type(task)
        attributes = _ATTRIBUTES.get(kind) if self._as_made else None
        if attributes is None or tuple(task.__dict__) != attributes:
            return None
        frames: tuple[Any, ...] = ()
        target: Any
        shapes, cost = ((7,), (6,)), task.cost
        if kind is mink.FrameTask:
            frames = task.frame_name, task.frame_type, 0, "body"
            target = getattr(task.transform_target_to_world, "wxyz_xyz", None)
        elif kind is mink.RelativeFrameTask:
            frames = task.frame_name, task.frame_type, task.root_name, task.root_type
            target = getattr(task.transform_target_to_root, "wxyz_xyz", None)
        else:
            shapes = (self._q.shape, (self._nv,))
            target = self._q if kind is mink.DampingTask else task.target_q
        plain = (
            type(target) is type(cost) is np.ndarray
            and (target.shape, cost.shape) == shapes
            and target.dtype == cost.dtype == np.float64
            and isinstance(task.gain, (float, int))
            and isinstance(task.lm_damping, (float, int))
        )
        if not plain:
            return None
        place = self._places.get(frames)
        if place is None:
            place = self._places[frames] = _place(self._model, *frames)
        if not frames and task._v_ids is not None:
            cost = cost.copy()
            cost[task._v_ids] = 0.0
        return place, target, cost


def _place(model: mujoco.MjModel, *frames: Any) -> Indices:
    """Which joints a task is about, as ``kernel.task_costs`` has it; without frames, a posture."""
    if not frames:
        return _posture(model)
    ends = [
        (name if isinstance(name, str) else int(name), kind)
        for name, kind in (frames[:2], frames[2:])
    ]
    moving, carrying = (set(dofs_above(model, *end)) for end in ends)
    dofs = np.array(sorted(moving ^ carrying), dtype=np.int64)
    signs = np.where(np.isin(dofs, list(moving)), 1, -1)
    rows = [
        (mink.SUPPORTED_FRAMES.index(kind), frame_id(model, name, kind), 0) for name, kind in ends
    ]
    rows += zip(dofs, signs, model.body_rootid[model.dof_bodyid[dofs]], strict=True)
    return np.array([(len(ends), len(dofs), 0), *rows], dtype=np.int64)


def _posture(model: mujoco.MjModel) -> Indices:
    """The same of a posture: all joints, free and ball joints in parts."""
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    rows: list[tuple[int, int, int]] = []
    for at, dof, kind in zip(model.jnt_qposadr, model.jnt_dofadr, model.jnt_type, strict=True):
        slides = {free: 3, ball: 0}.get(int(kind), 1)
        rows += [(dof + k, at + k, 0) for k in range(slides)]
        if kind in (free, ball):
            rows.append((dof + slides, at + slides, 1))
    return np.array([(0, len(rows), 0), *rows], dtype=np.int64)


@cache
def _machine_code() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """``add_task_costs`` and ``write_frame_rows`` of ``kernel.task_costs``."""
    from qp_twist.kernel.compiling import bound  # with numba, which takes half a second
    from qp_twist.kernel.task_costs import add_task_costs, write_frame_rows

    one, row, some = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1), np.int64)
    return (
        bound(add_task_costs, some, one, one, one, *[row] * 10, one),
        bound(write_frame_rows, some, one, *[row] * 8, 1.0, row, row),
    )

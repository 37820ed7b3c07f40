"""Single steps of many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, number
from qp_twist.control import Controller, Step
from qp_twist.control.composition import composition_known
from qp_twist.errors import InvalidInput, QpTwistError
from qp_twist.following.batch.arrays import pose_of, rigid_motions, shared
from qp_twist.kinematics import SerialChain, TwistTask

Mask = npt.NDArray[np.bool_]
Targets = Sequence[mink.SE3] | npt.ArrayLike


@dataclass(frozen=True, eq=False)
class Steps:
    """K steps.

    Attributes:
        velocity: q̇ of each step, rad/s or m/s, (K, nv); NaN without a step.
        scale: Scale s of each step, (K,).
        by_reference: Which steps were computed by ``Controller.step``, not the kernel, (K,).
        failures: Exceptions of ``Controller.step``, by index of the row.
    """

    velocity: Array
    scale: Array
    by_reference: Mask
    failures: dict[int, str]


def step(
    controller: Controller,
    q: npt.ArrayLike,
    dt: float,
    targets: Targets | Sequence[Targets] | None = None,
    *,
    use_secondary: bool = True,
    velocity: npt.ArrayLike | None = None,
    others: bool = True,
    threads: int | None = None,
) -> Steps:
    """:meth:`Controller.step <qp_twist.Controller.step>` for many configurations, to 1e-9.

    Every result is verified. Steps near a singularity, or with joints outside their ranges, are
    computed afterwards by ``Controller.step``, one by one. The controller is not modified.

    Args:
        controller: TwistTasks (no GazeTasks, bands or carriers) in any levels, PositionLimits,
            MotionLimits and DisplacementWindows, JointCentering and, where all joints are hinges
            and slides, PostureReferences. Its ``solver`` computes the other steps.
        q: Configurations, rad or m, (K, nq).
        dt: Length of the steps, s.
        targets: For each row the target of the task: :class:`mink.SE3`, or matrices (K, 4, 4); for
            several tasks a sequence of these, in their order, without feed-forward. By default the
            tasks' own targets, with their feed-forward twists.
        use_secondary: Whether the secondary acts, as for a single step.
        velocity: Joint velocities before the steps, rad/s or m/s, (K, nv), which acceleration
            limits refer to; by default the one stored in the controller.
        others: Whether to compute the remaining steps by ``Controller.step``; if not, their
            velocity is NaN.
        threads: Number of threads; all cores by default.

    Raises:
        InvalidInput: If an argument is wrong, or the controller has no compiled form.
        mink.TargetNotSet: If no targets are given and a task has none.
    """
    from qp_twist.control.compiled_step import twist_space
    from qp_twist.control.step_arrays import StepArrays
    from qp_twist.kernel import batch_kernel
    from qp_twist.kinematics.compiled_rows import arm_of

    instance("batch.step(controller, …)", controller, Controller)
    given = np.ascontiguousarray(finite_array("q", q, (None, controller.model.nq)))
    dt = number("dt", dt, above=0.0)
    before = np.zeros((0, controller.model.nv))
    if velocity is not None:
        before = finite_array("velocity", velocity, (len(given), controller.model.nv))
        before = np.ascontiguousarray(before)
    arrays = None
    if composition_known(controller.levels, controller.limits):
        arrays = StepArrays(controller)
    if arrays is None or arrays.evaluates or arrays.secondary.others:
        raise InvalidInput(
            "batch.step: this controller has no compiled form. One has TwistTasks "
            "(no GazeTasks, bands or carriers), PositionLimits, MotionLimits and "
            "DisplacementWindows, JointCentering and, where all joints are hinges and slides, "
            "PostureReferences. Take the steps one by one with Controller.step."
        )
    arrays.limits.write_velocities()
    own, tasks = arrays.aims(), controller.twist_tasks
    arms = tuple(
        arm_of(SerialChain.of(controller.model, t.frame_name, t.frame_type)) for t in tasks
    )
    aims = _aims(tasks, own, targets, len(given))
    found, scale = np.zeros((len(given), controller.model.nv)), np.ones(len(given))
    done = np.zeros(len(given), dtype=bool)

    def some(part: slice) -> None:
        batch_kernel.steps(
            arms, *(array.copy() for array in arrays.memory), given[part], before[part],
            aims[part], dt, bool(use_secondary), twist_space(controller), found[part],
            scale[part], done[part],
        )  # fmt: skip

    shared(len(given), some, threads)
    failures = dict[int, str]()
    if not others:
        found[~done], scale[~done] = np.nan, np.nan
    for k in np.flatnonzero(~done) if others else ():
        try:
            moving = before[k] if len(before) else None
            options = {"use_secondary": bool(use_secondary), "velocity": moving}
            taken = _one(controller, given[k], aims[k], dt, **options)
        except QpTwistError as error:
            found[k], scale[k], failures[int(k)] = np.nan, np.nan, str(error)
        else:
            found[k], scale[k] = taken.velocity, taken.scale
    return Steps(found, scale, ~done, failures)


def _aims(tasks: Sequence[TwistTask], own: Array, targets: Any, rows: int) -> Array:
    """R_d (9), p_d (3) and twist (6) of every task, (K, T, 18)."""
    aims = np.tile(own, (rows, 1, 1))
    if targets is None:
        for task in tasks:
            if task.target is None:
                raise mink.TargetNotSet(task.name)
        return aims
    if not isinstance(targets, (Sequence, np.ndarray)):
        raise InvalidInput(
            "targets: expected a sequence of mink.SE3, one for each row, or matrices (K, 4, 4); "
            f"got {type(targets).__name__}."
        )
    # One pose for each row, or for each task a sequence of them.
    each_row = len(targets) and (isinstance(targets[0], mink.SE3) or np.ndim(targets[0]) == 2)
    several = [targets] if len(tasks) == 1 and (each_row or not len(targets)) else targets
    if len(several) != len(tasks):
        raise InvalidInput(
            f"targets: expected a sequence of targets for each of {len(tasks)} tasks, got "
            f"{len(several)}."
        )
    for k, poses in enumerate(several):
        motions = rigid_motions("targets", poses)
        if len(motions) != rows:
            raise InvalidInput(
                f"targets: expected one for each of {rows} rows, got {len(motions)}."
            )
        aims[:, k, :12], aims[:, k, 12:] = motions, 0.0
    return aims


def _one(controller: Controller, q: Array, aims: Array, dt: float, **options: Any) -> Step:
    """A step of the reference, which leaves the controller unchanged."""
    tasks = controller.twist_tasks
    before = [(task.target, task.feedforward) for task in tasks]
    velocities = [getattr(limit, "velocity", None) for limit in controller.limits]
    try:
        for task, aim in zip(tasks, aims, strict=True):
            task.set_target(pose_of(aim), aim[12:])
        return controller.step(mink.Configuration(controller.model, q), dt, **options)
    finally:
        for task, (target, twist) in zip(tasks, before, strict=True):
            if target is not None:
                task.set_target(target, twist)
        for limit, stored in zip(controller.limits, velocities, strict=True):
            if stored is not None:
                cast(Any, limit).velocity = stored

"""The controller: computes a joint velocity from tasks, limits and a backend."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, largest, number, refusing_unknown_names
from qp_twist.constraints import PositionLimit, couplings_of
from qp_twist.control.clear_velocity import step_clear
from qp_twist.control.composition import composition_known
from qp_twist.control.posing import EVERYTHING, Displacement, LevelItem, NamedProblem, pose
from qp_twist.control.solving import solved_step
from qp_twist.control.sorted_limits import SortedLimits
from qp_twist.control.step import Step
from qp_twist.control.step_settings import (
    TIE_BREAK,
    UNSEEN_WEIGHT,
    StepSettings,
    checked_limits,
    checked_tasks,
)
from qp_twist.errors import InvalidInput
from qp_twist.kernel import COMPILED
from qp_twist.kernel.constants import FASTEST
from qp_twist.kinematics import SecondaryObjective, TwistTask, check_configuration, same_structure
from qp_twist.qp import NoSolutionFound

if TYPE_CHECKING:
    from qp_twist.control.compiled_step import CompiledStep

_NOT_CHECKED: tuple[Any, Any, Any] = (object(), None, None)
"""Placeholder for the last checked (configuration, model, data) that no argument equals."""


class Controller(StepSettings):
    r"""A quadratic program at every step (the design of the package, in one formula).

    .. math::

        \min_{\dot{\mathbf q}}\;& \tfrac12\lVert(\mathbf 1-\mathbf T)
            (\mathbf J\dot{\mathbf q}-\mathbf J\dot{\mathbf h})\rVert_{\mathbf w}^2
            \;[\text{secondary\_space = "twist"}]
            + \tfrac\rho2\lVert\dot{\mathbf q}-\dot{\mathbf h}\rVert_{\mathbf M}^2
            + \text{costs of other mink tasks} \\
        \text{s.t.}\;& \mathbf U^T\mathbf J\dot{\mathbf q}
            = s\,(k\,\mathbf U^T\Delta\mathbf t/dt + \mathbf U^T\mathbf t_{ff}),\quad
            lower \le \dot{\mathbf q} \le upper,\quad \mathbf G\dot{\mathbf q}\le\mathbf g

    with :math:`\dot{\mathbf h} = \mathbf h/dt`. While no limit is active, "joint" gives gradient
    projection (minimum norm without a secondary) and "twist" the paper's decomposition, exactly
    :math:`\mathbf J^\dagger\mathbf T\Delta\mathbf t +
    (\mathbf 1-\mathbf J^\dagger\mathbf T\mathbf J)\mathbf h`: there the ρ term acts only in the
    null space of J, which the twist cost does not see.

    Attributes:
        joint_weight: ρ. By default 1 in joint space (1e-9 with other mink tasks and without a
            secondary), 0.01 in twist space.
        free_twist_costs: Square roots of w for the linear rows of 1 − T, s/m, and for the angular
            ones, s/rad, (1, 1) by default; their ratio is the length in m that 1 rad/s counts for.
        singularity: ε, singular value of the task rows below which a direction is left to the
            secondary; 0, or less than 1e-9: never. By default 0.005 if ``smooth``, else 0.001. With
            speed limits smooth steps take directions below 50 ε, at most 0.05, in several steps.
        smooth: Whether steps are smooth at the edge of the reach, through singularities and where
            limits stop the task (the docs' page *At the edge*); if not, they take the largest scale
            and the closest velocity, as the following of a path does.
        braking: Whether a smooth step asks, under an acceleration limit, for no more speed than
            the joints can stop from at the target. A target that moves then needs its twist.
        reference_steps: Number of steps by the uncompiled reference, which takes milliseconds (the
            docs' page *Performance*).

    Example:
        >>> import mink, qp_twist as qt
        >>> path_task = qt.load_task("deburring")
        >>> task = qt.TwistTask("tool", "site", path_task.projector)
        >>> task.set_target(path_task.waypoints[0])
        >>> controller = qt.Controller(path_task.model, tasks=[task],
        ...                            secondary=[qt.JointCentering(path_task.model)])
        >>> step = controller.step(mink.Configuration(path_task.model, path_task.start), dt=0.1)
        >>> step.status.name, step.velocity.shape
        ('SOLVED', (6,))
    """

    @refusing_unknown_names
    def __init__(
        self,
        model: mujoco.MjModel,
        tasks: Sequence[mink.tasks.BaseTask] = (),
        *,
        levels: Sequence[Sequence[LevelItem]] | None = None,
        secondary: Sequence[SecondaryObjective] = (),
        secondary_space: Literal["joint", "twist"] = "joint",
        limits: Sequence[mink.Limit] | None = None,
        solver: str | None = None,
        on_infeasible: Literal["scale", "relax", "raise"] = "scale",
        metric: npt.ArrayLike | None = None,
    ) -> None:
        """Compose a controller. Its attributes, which few need to set, may change between steps.

        Args:
            model: The robot.
            tasks: :class:`TwistTask` s become equality rows of one level; any other mink task adds
                its cost.
            levels: Strict priorities instead, most important first: lists of tasks (TwistTasks or
                any mink task with equality rows) and of limits, whose rows are then met in least
                squares at that level. ``tasks`` may then contain only mink tasks that add a cost.
            secondary: Objectives whose displacements add up to h.
            secondary_space: Whether the free motion follows h in joint space or in twist space.
            limits: Any mink limits; ``[]`` for none. If ``None`` the model's own limits: its joint
                ranges and, if it couples joints, its :class:`~qp_twist.JointCouplings`.
            solver: A qpsolvers backend, or ``"compiled"``; every result is verified. If ``None``
                the compiled step where it supports this composition, else daqp.
            on_infeasible: If the first level is infeasible: ``"scale"`` slows it down,
                ``"relax"`` takes a close velocity, ``"raise"`` raises
                :class:`~qp_twist.InfeasibleStep`. Lower levels are always relaxed.
            metric: Diagonal of M, positive, shape (nv,); ones if ``None``.

        Raises:
            InvalidInput: If an argument has the wrong type, shape or range.
            UnknownSolver: If the backend is not installed.
            mink.InvalidFrame: If the model lacks a task's frame.
        """
        instance("model", model, mujoco.MjModel)
        self._by_kind = checked_tasks(model, tasks, levels)
        super().__init__(model)
        self.secondary = secondary
        own = [PositionLimit(model), *couplings_of(model)] if limits is None else limits
        self.limits = own  # type: ignore[assignment]
        known = composition_known(self.levels, self.limits)
        self.solver = solver if solver is not None else COMPILED if known else "daqp"
        self.secondary_space, self.on_infeasible = secondary_space, on_infeasible
        if metric is not None:
            self.metric = metric  # type: ignore[assignment]
        if secondary_space == "twist":
            self.joint_weight = UNSEEN_WEIGHT
        elif self.soft_tasks and not self.secondary:
            self.joint_weight = TIE_BREAK
        self._seen, self._checked = SortedLimits([]), _NOT_CHECKED
        self.reference_steps = 0
        self._prepared = _compiled_step(self)

    @property
    def levels(self) -> tuple[tuple[LevelItem, ...], ...]:
        """The priority levels."""
        return self._by_kind.levels

    @property
    def tasks(self) -> tuple[mink.tasks.BaseTask, ...]:
        """The tasks of all levels."""
        return self._by_kind.of_levels

    @property
    def twist_tasks(self) -> tuple[TwistTask, ...]:
        """The TwistTasks among them."""
        return self._by_kind.twist

    @property
    def soft_tasks(self) -> tuple[mink.tasks.BaseTask, ...]:
        """The tasks that add a cost."""
        return self._by_kind.soft

    def step(
        self,
        configuration: mink.Configuration,
        dt: float,
        *,
        use_secondary: bool | float = True,
        displacement: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
    ) -> Step:
        """Compute the joint velocity for one step of length ``dt``.

        Args:
            configuration: The robot's configuration; it is not changed.
            dt: Length of the step, s.
            use_secondary: ``False`` sets h to zero, as in the later iterations of a waypoint, where
                the curvature of a secondary's motion would violate the task again and again. A
                number from 0 to 1 is the share of h with which a secondary fades in or out.
            displacement: Added to h in this step, rad or m, (nv,).
            velocity: Measured joint velocity before the step, (nv,), for acceleration limits; if
                ``None`` that of the last step, and zero before the first.

        Raises:
            InvalidInput: If the configuration is not finite or of another model, dt ≤ 0, or another
                argument has the wrong shape or range.
            mink.TargetNotSet: If a task has no target.
            InfeasibleStep: If the first level is infeasible within the limits, or the robot is
                singular in a direction that it needs, and ``on_infeasible`` is ``"raise"``.
            SolverInaccurate: If the backend's result of a feasible step could not be verified.
        """
        if not (type(dt) is float and 0.0 < dt < math.inf):  # seldom
            dt = number("dt", dt, above=0.0)
        # The user may replace the configuration's model or data between two steps; the compiled
        # step reads the data's memory.
        checked, model, data = self._checked
        if (
            configuration is not checked
            or getattr(configuration, "data", None) is not data
            or getattr(configuration, "model", None) is not model
        ):
            self._check_configuration(configuration)
        if velocity is not None:
            self.note(velocity)
        h = EVERYTHING  # nearly always
        if use_secondary is not True or displacement is not None:
            h = Displacement.of(use_secondary, displacement, self.model.nv)
        limits = self._seen
        if self.limits != limits.limits:
            limits = self._sorted_limits()
        if limits.clearances:
            solve = partial(self._solved, configuration, dt, h)
            step = step_clear(solve, limits, configuration, dt)
        else:
            step = self._solved(configuration, dt, h)
        limits.note(step.velocity)
        return step

    def build_ik(
        self,
        configuration: mink.Configuration,
        dt: float,
        *,
        use_secondary: bool | float = True,
        displacement: npt.ArrayLike | None = None,
    ) -> NamedProblem:
        """The program of a step for ``qpsolvers.solve_problem``, as ``mink.build_ik`` returns it.

        Arguments and errors are those of :meth:`step`, which solves it, verifies the result, and
        knows what to do where it has no solution.
        """
        dt = number("dt", dt, above=0.0)
        self._check_configuration(configuration)
        h = Displacement.of(use_secondary, displacement, self.model.nv)
        return NamedProblem(pose(self, configuration, dt, h))

    def _solved(self, configuration: mink.Configuration, dt: float, h: Displacement) -> Step:
        """The step by the kernel, or else by the reference."""
        # The arrays may be in use, by another thread or by a limit that itself calls step();
        # then the reference computes this step.
        prepared = self._prepared
        if prepared is not None and (
            prepared.revision != self.revision or prepared.limits is not self._seen
        ):
            prepared = self._prepared = _compiled_step(self)
        if prepared is not None and prepared.free.acquire(False):
            try:
                plain = prepared.compute(self, configuration, dt, h)
                if plain is not None:
                    return plain
            finally:
                prepared.free.release()
        self.__dict__["reference_steps"] += 1  # which is no change of the composition
        if not math.isfinite(sum(configuration.data.qpos.tolist())):
            self._check_configuration(configuration)  # raises, with the joint's name
        with np.errstate(over="ignore", invalid="ignore"):  # the result is checked below
            posed = pose(self, configuration, dt, h)
        return solved_step(posed, self.solver, self.on_infeasible)

    def load(self, configuration: mink.Configuration, dt: float) -> None:
        """Load, or compile, all machine code of the steps, so that none waits for it.

        One step is computed for that; the velocity that acceleration limits count from stays.
        """
        motions = self._sorted_limits().motions
        before = [limit.velocity for limit in motions]
        with contextlib.suppress(NoSolutionFound):
            self.step(configuration, dt)
        if self._prepared is not None:
            self._prepared.load()
        for limit, velocity in zip(motions, before, strict=True):
            limit.velocity = velocity

    def note(self, velocity: npt.ArrayLike) -> None:
        """Set the current joint velocity (nv,), as :meth:`step` does."""
        velocity = finite_array("velocity", velocity, (self.model.nv,))
        if largest(velocity) > FASTEST:
            raise InvalidInput(f"velocity: the joints cannot move faster than {FASTEST:g}.")
        self._sorted_limits().note(velocity)

    @property
    def hardest(self) -> Array | None:
        """The least acceleration limit of each joint, rad/s² or m/s², (nv,); ``None`` without."""
        return self._sorted_limits().hardest

    @property
    def fastest(self) -> Array | None:
        """The least velocity limit of each joint, rad/s or m/s, (nv,); ``None`` without."""
        return self._sorted_limits().fastest

    def _sorted_limits(self) -> SortedLimits:
        """The limits, which may have changed since the last step, by kind."""
        if self.limits != self._seen.limits:
            self._seen = SortedLimits(checked_limits(self, "limits", self.limits))
        return self._seen

    def _check_configuration(self, configuration: mink.Configuration) -> None:
        check_configuration(configuration)
        other, model = configuration.model, self.model
        if not same_structure(other, model):
            raise InvalidInput(
                f"step: the configuration's model has nq = {other.nq}, nv = {other.nv} and "
                f"{other.nbody} bodies, the controller's nq = {model.nq}, nv = {model.nv} and "
                f"{model.nbody}, or their names or joints differ; use a configuration of the same "
                "model."
            )
        for clearance in self._sorted_limits().clearances:
            clearance.check_model("step", configuration.model)
        finite_array("configuration.q", configuration.q, (self.model.nq,))
        self._checked = configuration, configuration.model, configuration.data

    def __getstate__(self) -> dict[str, Any]:
        """State without the compiled step: copies of its array views would not share memory."""
        return self.__dict__ | {"_prepared": None, "_checked": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state and make a new compiled step."""
        self.__dict__.update(state)
        self._checked = _NOT_CHECKED
        self._prepared = _compiled_step(self)

    def __repr__(self) -> str:
        return (
            f"Controller(levels={[list(level) for level in self.levels]!r}, "
            f"tasks={list(self.soft_tasks)!r}, "
            f"secondary={list(self.secondary)!r}, secondary_space={self.secondary_space!r}, "
            f"solver={self.solver!r}, on_infeasible={self.on_infeasible!r})"
        )


def _compiled_step(controller: Controller) -> CompiledStep | None:
    """The compiled step; ``None`` with another solver or an unsupported composition."""
    if controller.solver != COMPILED or not composition_known(controller.levels, controller.limits):
        return None
    from qp_twist.control.compiled_step import CompiledStep  # numba takes half a second

    return CompiledStep(controller, controller._sorted_limits())

"""An arm that follows a dragged target step by step."""

from __future__ import annotations

import copy
from typing import Literal

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import finite_array
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, Step
from qp_twist.following.resolver import secondary_objectives
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.paths import METHODS, MethodSettings, PathTask
from qp_twist.viewing.one_run import Moment
from qp_twist.viewing.projectors import Roll, with_projector
from qp_twist.viewing.settings import PageSettings

WAYPOINTS_PER_S = 20.0
"""A secondary's gain is per waypoint; here a second counts as this number of waypoints."""
TARGET_GAIN = 0.25
"""Share of the task error that a step removes."""
STEP_SHARE = 0.03
"""Largest linear error of a step, as a share of the scene's extent."""
STEP_ANGLE = np.radians(6.0)
"""Largest angular error of a step, rad."""


class LiveArm:
    """The QP of a method, driven by a target instead of a path.

    A closed form is represented by its QP, which has limits. Position, speed and acceleration
    limits are those of the task; the secondary acts as a velocity.

    Attributes:
        method: Name of the QP.
        configuration: The arm's configuration.
        target: Target pose of the frame.
        last: The last step; ``None`` before the first one, or without a step.
    """

    def __init__(
        self,
        path_task: PathTask,
        settings: PageSettings,
        q: npt.ArrayLike,
        *,
        dt: float = 0.025,
        on_infeasible: Literal["scale", "relax"] = "scale",
    ) -> None:
        """Put the arm at a configuration, with its target at its frame.

        Args:
            path_task: The task.
            settings: Settings of the page.
            q: Configuration, (nq,).
            dt: Time between two steps, s.
            on_infeasible: Whether an infeasible target slows the arm down (``"scale"``) or is
                approached in least squares (``"relax"``).
        """
        self.method = METHODS[settings.method].qp
        kind = METHODS[self.method]
        model = path_task.model
        self.path_task = with_projector(path_task, settings.projector)
        projector = path_task.operational if kind.whole_twist else self.path_task.projector
        self.dt = dt
        self.task = TwistTask(
            path_task.frame_name,
            path_task.frame_type,
            projector,
            gain=TARGET_GAIN,
            max_linear_step=STEP_SHARE * float(model.stat.extent),
            max_angular_step=STEP_ANGLE,
            bands=() if kind.whole_twist else self.path_task.bands,
        )
        method = self._method_settings(settings)
        self.ranges = JointRanges.of(model)
        self.controller = Controller(
            model,
            tasks=[self.task],
            secondary=secondary_objectives(path_task, self.task, method),
            secondary_space=kind.space,
            limits=_limits(path_task, held=settings.limits),
            solver=settings.solver,
            on_infeasible=on_infeasible,
            metric=None if method.metric == "1" else self.ranges.metric,
        )
        self.configuration = mink.Configuration(model, finite_array("LiveArm(q)", q, (model.nq,)))
        self.roll = Roll(path_task)
        self.target = self.pose
        self.last: Step | None = None

    @property
    def pose(self) -> mink.SE3:
        """Pose of the frame."""
        return self.configuration.get_transform_frame_to_world(
            self.path_task.frame_name, self.path_task.frame_type
        )

    def step(self) -> Moment:
        """Move towards the target for one time step; stand still if there is no step."""
        self.task.set_target(self.target)
        sentence = ""
        try:
            self.last = self.controller.step(self.configuration, self.dt)
            self.configuration.integrate_inplace(self.last.velocity, self.dt)
            sentence = self.last.message
        except mink.MinkError as error:
            self.last, sentence = None, str(error)
        return self._moment(sentence)

    def _moment(self, sentence: str) -> Moment:
        q = self.configuration.q.copy()
        error = self.task.state(self.configuration).error
        return Moment(
            q=q,
            scale=0.0 if self.last is None else self.last.scale,
            position_error=float(np.linalg.norm(error[:3])),
            axis_error=float(np.linalg.norm(error[3:])),
            sigma_min=0.0 if self.last is None else self.last.sigma_min,
            z=float(self.ranges.centring(q)),
            margins=self.ranges.margins(q),
            binding=() if self.last is None else tuple(str(b) for b in self.last.binding),
            roll=self.roll.at(self.configuration, self.target),
            sentence=sentence,
        )

    def _method_settings(self, settings: PageSettings) -> MethodSettings:
        """Settings of the QP, with the page's gain per step instead of per waypoint."""
        own = self.path_task.settings(self.method)
        if own.secondary == "plan":  # there is no plan here: use the plan's objective instead
            own = own.model_copy(
                update={"secondary": "centering", "weight": "natural", "gain": 0.05}
            )
        elif settings.has_weight:
            own = own.model_copy(update={"weight": settings.weight, "gain": settings.gain})
        return own.model_copy(update={"gain": own.gain * WAYPOINTS_PER_S * self.dt})


def _limits(path_task: PathTask, *, held: bool) -> list[mink.Limit]:
    motion = MotionLimit(
        path_task.model,
        velocity=path_task.velocity_limits,
        acceleration=path_task.acceleration_limits,
    )
    # A clearance remembers its last step, and a run may use the task's in another thread.
    constraints = map(copy.copy, path_task.constraints)
    return [motion, *constraints] if held else [*constraints]

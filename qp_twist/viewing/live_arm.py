"""An arm that follows a dragged target step by step."""

from __future__ import annotations

import copy
from typing import Literal

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import finite_array
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, Status, Step
from qp_twist.following.resolver import secondary_objectives
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.paths import METHODS, MethodSettings, PathTask
from qp_twist.viewing.one_run import Moment
from qp_twist.viewing.projectors import with_projector
from qp_twist.viewing.settings import PageSettings, effective

WAYPOINTS_PER_S = 20.0
"""A secondary's gain is per waypoint; here a second counts as this number of waypoints."""
TARGET_GAIN = 0.25
"""Share of the task error that a step removes."""
STEP_SHARE, STEP_ANGLE = 0.03, np.radians(6.0)
"""Largest linear error of a step, as a share of the scene's extent, and angular error, rad."""


class LiveArm:
    """The QP of a method, driven by a target instead of a path.

    A closed form is represented by its QP, which has limits. Position, speed and acceleration
    limits are those of the task; the secondary acts as a velocity.

    Attributes:
        path_task: The task, with the page's projector.
        method: Name of the QP.
        dt: Time between two steps, s.
        task: What the controller keeps.
        controller: The controller.
        configuration: The arm's configuration.
        target: Target pose of the frame.
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
        self.method, self.dt = METHODS[settings.method].qp, dt
        self.path_task = with_projector(path_task, settings.projector)
        kind, model = METHODS[self.method], path_task.model
        self.task = TwistTask(
            path_task.frame_name, path_task.frame_type,
            path_task.operational if kind.whole_twist else self.path_task.projector,
            gain=TARGET_GAIN, max_linear_step=STEP_SHARE * float(model.stat.extent),
            max_angular_step=STEP_ANGLE, bands=() if kind.whole_twist else self.path_task.bands,
        )  # fmt: skip
        method = self._method_settings(settings)
        # A clearance remembers its last step, and a run may use the task's in another thread.
        limits: list[mink.Limit] = [copy.copy(one) for one in path_task.constraints]
        if settings.limits:
            speeds, accelerations = path_task.velocity_limits, path_task.acceleration_limits
            limits.insert(0, MotionLimit(model, velocity=speeds, acceleration=accelerations))
        self.controller = Controller(
            model, tasks=[self.task], secondary=secondary_objectives(path_task, self.task, method),
            secondary_space=kind.space, limits=limits, solver=settings.solver,
            on_infeasible=on_infeasible,
            metric=None if method.metric == "1" else JointRanges.of(model).metric,
        )  # fmt: skip
        self.configuration = mink.Configuration(model, finite_array("LiveArm(q)", q, (model.nq,)))
        self.target = self.pose

    @property
    def pose(self) -> mink.SE3:
        """Pose of the frame."""
        return self.configuration.get_transform_frame_to_world(
            self.path_task.frame_name, self.path_task.frame_type
        )

    def step(self) -> Moment:
        """Move towards the target for one time step; stand still if there is no step."""
        self.task.set_target(self.target)
        step: Step | None = None
        try:
            step = self.controller.step(self.configuration, self.dt)
            self.configuration.integrate_inplace(step.velocity, self.dt)
            sentence = step.message
        except mink.MinkError as why:
            sentence = str(why)
        error = self.task.state(self.configuration).error
        return Moment.at(
            self.path_task, self.configuration.q.copy(), self.target,
            scale=0.0 if step is None else step.scale,
            position_error=float(np.linalg.norm(error[:3])),
            axis_error=float(np.linalg.norm(error[3:])),
            sigma_min=0.0 if step is None else step.sigma_min,
            binding=() if step is None else tuple(map(str, step.binding)), sentence=sentence,
            solved=step is not None and step.status is Status.SOLVED,
        )  # fmt: skip

    def _method_settings(self, settings: PageSettings) -> MethodSettings:
        """Settings of the QP, with the page's gain per step instead of per waypoint."""
        own = self.path_task.settings(self.method)
        if own.secondary == "plan":  # there is no plan here: use the plan's objective instead
            centering = {"secondary": "centering", "weight": "natural", "gain": 0.05}
            own = own.model_copy(update=centering)
        elif "weight" in effective(settings):
            own = own.model_copy(update={"weight": settings.weight, "gain": settings.gain})
        return own.model_copy(update={"gain": own.gain * WAYPOINTS_PER_S * self.dt})

"""The projectors that can be chosen on the page, and the roll that they may leave free."""

from __future__ import annotations

import dataclasses

import mink
import numpy as np

from qp_twist.checks import Array, one_of
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, twist_error
from qp_twist.kinematics import check_bands, frame_pose
from qp_twist.paths import PathTask

OWN = "as the task says"
WHOLE = "whole pose"
FREE_ROLL = "free roll"
FREE_TILT = "free tilt"
POSITION_ONLY = "position only"


def projector_choices(path_task: PathTask) -> dict[str, TwistProjector]:
    """The projectors for a task, by name, its own first.

    With e the tool's axis, fixed to the tool: the angular block is 1 for the whole pose,
    1 − e eᵀ for a free roll (the axis is held), e eᵀ for a free tilt (the roll is held) and O for
    the position only. A robot that turns about one direction only has just the first and the last.
    """
    operational = path_task.operational
    choices = {OWN: path_task.projector, WHOLE: operational}
    if operational.angular.kind is ProjectorKind.FULL and operational.linear.axis is None:
        e = tool_axis(path_task)
        for name, angular in ((FREE_ROLL, Projector.plane(e)), (FREE_TILT, Projector.line(e))):
            choices[name] = TwistProjector(linear=operational.linear, angular=angular, frame="body")
    if operational.angular.rank:
        choices[POSITION_ONLY] = TwistProjector(
            linear=operational.linear, angular=Projector.none(), frame=operational.frame
        )
    return choices


def tool_axis(path_task: PathTask) -> Array:
    """Unit vector (3,) of the free roll axis in the tool frame; else its z."""
    angular, frame = path_task.projector.angular, path_task.projector.frame
    if angular.kind is ProjectorKind.PLANE and frame == "body" and angular.axis is not None:
        return angular.axis
    return Projector.line([0.0, 0.0, 1.0]).basis[:, 0]


def with_projector(path_task: PathTask, choice: str) -> PathTask:
    """The task with another projector on its whole path.

    Without the task's segments. Its bands are kept if the projector leaves their directions free.

    Raises:
        InvalidInput: If there is no such choice.
    """
    choices = projector_choices(path_task)
    projector = choices[one_of("projector", choice, tuple(choices))]
    if choice == OWN:
        return path_task
    try:
        bands = check_bands("bands", path_task.bands, projector)
    except InvalidInput:
        bands = ()
    return dataclasses.replace(path_task, projector=projector, segments=(), bands=bands)


class Roll:
    r"""Rotation of the frame from its target about one axis, rad in (−π, π].

    For a robot with all rotations the axis is that of the tool; for one that rotates about a single
    direction it is that one; others have none.
    """

    def __init__(self, path_task: PathTask) -> None:
        operational = path_task.operational
        angular = operational.angular
        self._frame = (path_task.frame_name, path_task.frame_type)
        self._rows: TwistProjector | None = None
        if angular.kind is ProjectorKind.FULL:
            self._rows = TwistProjector(
                linear=Projector.none(), angular=Projector.line(tool_axis(path_task)), frame="body"
            )
        elif angular.kind is ProjectorKind.LINE:
            self._rows = TwistProjector(
                linear=Projector.none(), angular=angular, frame=operational.frame
            )

    def at(self, configuration: mink.Configuration, target: mink.SE3) -> float | None:
        """The roll of a configuration relative to a target; ``None`` without an axis."""
        if self._rows is None:
            return None
        rotation, position = frame_pose(configuration, *self._frame)
        wanted = target.rotation().as_matrix()
        error = twist_error(rotation, position, wanted, target.translation(), self._rows)
        axis = self._rows.resolved(body=rotation, target=wanted).angular.axis
        assert axis is not None
        return -float(np.dot(axis, error[3:]))

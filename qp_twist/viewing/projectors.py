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


def projector_choices(path_task: PathTask) -> dict[str, TwistProjector]:
    """The projectors for a task, by name, its own first.

    With e the tool's axis, fixed to the tool: the angular block is 1 for the whole pose,
    1 − e eᵀ for a free roll (the axis is held), e eᵀ for a free tilt (the roll is held) and O for
    the position only. A robot that turns about one direction only has just the first and the last.
    """
    operational = path_task.operational
    choices = {OWN: path_task.projector, "whole pose": operational}
    if operational.angular.kind is ProjectorKind.FULL and operational.linear.axis is None:
        e = tool_axis(path_task)
        for name, angular in (("free roll", Projector.plane(e)), ("free tilt", Projector.line(e))):
            choices[name] = TwistProjector(linear=operational.linear, angular=angular, frame="body")
    if operational.angular.rank:
        choices["position only"] = TwistProjector(
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


def roll(path_task: PathTask, configuration: mink.Configuration, target: mink.SE3) -> float | None:
    """Rotation of the frame from a target about one axis, rad in (−π, π].

    For a robot with all rotations the axis is that of the tool; for one that rotates about a single
    direction it is that one; others have none.
    """
    angular, frame = path_task.operational.angular, path_task.operational.frame
    if angular.kind is ProjectorKind.FULL:
        angular, frame = Projector.line(tool_axis(path_task)), "body"
    elif angular.kind is not ProjectorKind.LINE:
        return None
    rows = TwistProjector(linear=Projector.none(), angular=angular, frame=frame)
    rotation, position = frame_pose(configuration, path_task.frame_name, path_task.frame_type)
    desired = target.rotation().as_matrix()
    error = twist_error(rotation, position, desired, target.translation(), rows)
    axis = rows.resolved(body=rotation, target=desired).angular.axis
    assert axis is not None
    return -float(np.dot(axis, error[3:]))

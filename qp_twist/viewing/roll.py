"""The roll: the rotation about the axis that a task may leave free."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, twist_error
from qp_twist.kinematics import frame_pose
from qp_twist.paths import PathTask
from qp_twist.viewing.projectors import tool_axis


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

"""A task without a target pose: an axis of a frame points at a target point."""

from __future__ import annotations

from typing import Any

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import finite_array, unit_vector
from qp_twist.errors import InvalidInput, InvalidTarget
from qp_twist.geometry import Projector, TwistProjector, cross, geodesic
from qp_twist.kinematics.twist_task import TaskState, TwistTask, frames_of, jacobian_of

_NEAREST = 1e-6
"""Distance below which a target has no direction, m."""


class GazeTask(TwistTask):
    r"""Point an axis a of a frame at a target.

    With the line of sight :math:`\mathbf d = (\mathbf p_d - \mathbf p)/\ell`, which rotates as
    frame and target move, and :math:`\ell = \lVert\mathbf p_d - \mathbf p\rVert`, the task uses the
    twist of the frame relative to that line:

    .. math::

        \mathbf J_\omega \leftarrow \mathbf J_\omega + [\mathbf d]_\times \mathbf J_v / \ell, \qquad
        \Delta\boldsymbol\omega = \text{the shortest rotation taking } \mathbf a \text{ to }
        \mathbf d, \qquad \mathbf T = \mathrm{diag}(\mathbf O,\; \mathbf 1 - \mathbf a\mathbf a^T)

    Two rows, independent wherever the frame can rotate. Distance and roll about the axis are free.
    ``axis`` is a, in the axes of the frame, (3,); the others are those of TwistTask, except
    bands, which need a pose.

    Example:
        >>> import mink, qp_twist as qt
        >>> model = qt.load_task("deburring").model
        >>> task = qt.GazeTask("tool", "site")
        >>> task.set_point([1.0, 0.0, 0.0])
        >>> task.compute_jacobian(mink.Configuration(model)).shape
        (2, 6)
    """

    def __init__(
        self,
        frame_name: str | int,
        frame_type: str,
        axis: npt.ArrayLike = (0, 0, 1),
        gain: float = 1.0,
        **options: Any,
    ) -> None:
        if options.get("bands"):
            raise InvalidInput("GazeTask: bands are ranges of a pose; give them to a TwistTask.")
        axis = unit_vector(f"{type(self).__name__}(axis=…)", axis)
        T = TwistProjector(linear=Projector.none(), angular=Projector.plane(axis), frame="body")
        super().__init__(frame_name, frame_type, T, gain, **options)

    def set_point(self, point: npt.ArrayLike, velocity: npt.ArrayLike | None = None) -> None:
        """Set the target as a point in the world, or in the frame that carries it, m, (3,).

        ``velocity`` is that of the point, in the same axes, m/s, (3,); at rest if ``None``. What is
        not finite raises :class:`~qp_twist.InvalidTarget`.
        """
        at = finite_array(f"{self.name} point", point, (3,), error=InvalidTarget)
        moving = np.zeros(3) if velocity is None else velocity
        moving = finite_array(f"{self.name} velocity", moving, (3,), error=InvalidTarget)
        self.set_target(mink.SE3.from_translation(at), np.append(moving, np.zeros(3)))

    def state(self, configuration: mink.Configuration) -> TaskState:
        """As in :class:`TwistTask`; a target at the frame's origin has no direction, an error."""
        pair = frames_of(self, configuration)
        sight = pair.target_position - pair.position
        distance = float(np.linalg.norm(sight))
        if distance < _NEAREST:
            raise InvalidInput(
                f"{self.name}: the target is at the frame's own origin, so that there is no "
                "direction to look in; move either."
            )
        d = sight / distance
        world = self.projector.in_world(pair.rotation, pair.target_rotation)
        axis = world.angular.axis
        assert axis is not None
        jacobian = jacobian_of(self, configuration)
        jacobian[3:] += np.cross(d, jacobian[:3], axisb=0).T / distance
        error = np.concatenate([np.zeros(3), geodesic(axis, d)])
        ahead = np.concatenate([np.zeros(3), cross(d, pair.target_twist[:3]) / distance])
        return TaskState(world, world.basis, error, jacobian, ahead)

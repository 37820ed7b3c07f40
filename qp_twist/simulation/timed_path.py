"""A target that moves along poses in time."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import finite_array, instance, number
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask


class TimedPath:
    r"""Moves the target of a task along poses, each at its time, with its twist as feed-forward.

    Between two poses the position is interpolated linearly and the orientation by the shortest
    rotation, both at constant speed. Before the start the target rests at the first pose, after the
    end at the last.

    Attributes:
        task: The task whose target it sets.
        start: Beginning of the path, s.
        end: End of the path, s.
    """

    def __init__(
        self,
        task: TwistTask,
        poses: Sequence[mink.SE3],
        durations: npt.ArrayLike,
        *,
        start: float = 0.0,
        feedforward: bool = True,
    ) -> None:
        """Define a timed path.

        Args:
            task: The task whose target it sets.
            poses: Poses in the world, N ≥ 2.
            durations: Time from the previous pose to each pose, s, (N,); the first is not used (0
                in a :class:`~qp_twist.PathTask`).
            start: When the path begins, s.
            feedforward: Whether the target's twist is set, too.

        Raises:
            InvalidInput: If there are fewer than two poses, or a duration is not above 0.
        """
        instance("task", task, TwistTask)
        if len(poses) < 2:
            raise InvalidInput(f"TimedPath: expected at least two poses, got {len(poses)}.")
        for pose in poses:
            instance("poses", pose, mink.SE3)
        spans = finite_array("durations", durations, (len(poses),))[1:]
        if not (spans > 0.0).all():
            raise InvalidInput(
                "TimedPath: every duration after the first must be above 0 s; leave out poses that "
                "repeat the one before."
            )
        self.task = task
        self.start = number("start", start)
        self.feedforward = bool(feedforward)
        self._times = self.start + np.concatenate([[0.0], np.cumsum(spans)])
        self.end = float(self._times[-1])
        self._positions = np.array([pose.translation() for pose in poses])
        self._rotations = [pose.rotation() for pose in poses]
        self._velocities = np.diff(self._positions, axis=0) / spans[:, None]
        # About axes of the world: R₂ = exp(ω T) R₁.
        self._rates = np.array(
            [
                (after @ before.inverse()).log() / span
                for before, after, span in zip(
                    self._rotations[:-1], self._rotations[1:], spans, strict=True
                )
            ]
        )

    def __call__(self, time: float) -> None:
        """Set the target to its pose at ``time``, s."""
        if not self.start <= time < self.end:
            last = -1 if time >= self.end else 0
            self._set(self._rotations[last], self._positions[last], None)
            return
        k = int(np.searchsorted(self._times, time, side="right")) - 1
        passed = time - self._times[k]
        rotation = mink.SO3.exp(self._rates[k] * passed) @ self._rotations[k]
        twist = np.concatenate([self._velocities[k], self._rates[k]])
        position = self._positions[k] + self._velocities[k] * passed
        self._set(rotation, position, twist if self.feedforward else None)

    def _set(
        self, rotation: mink.SO3, position: npt.ArrayLike, twist: npt.ArrayLike | None
    ) -> None:
        pose = mink.SE3.from_rotation_and_translation(rotation, np.asarray(position))
        self.task.set_target(pose, twist)

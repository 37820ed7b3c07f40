"""A path at values of its parameter: poses, projectors, and where joint moves are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mink
import numpy as np

from qp_twist.checks import Array, Indices, Mask, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector, rotation_matrix, rotation_vector, with_fewer_rows
from qp_twist.paths.orientation import poses

if TYPE_CHECKING:
    from qp_twist.paths.path_task import PathTask


@dataclass(frozen=True, eq=False)
class Waypoints:
    """The path of a task at K values of its parameter s.

    s is the number of a waypoint, from 0, plus the share of the way to the next one. On this way
    the position goes straight and the orientation by the shortest rotation, both at the share.

    Attributes:
        s: The parameter, (K,).
        rotations: Orientations of the frame, (K, 3, 3).
        positions: Its positions, m, (K, 3).
        projectors: The projector in force; between two, that with fewer rows, (K,).
        on_path: Where a path holds: not inside a joint move, (K,).
        moves: Which of the intervals from each s to the next are part of a joint move, (K − 1,).
        feed_times: Times at the feed from the first waypoint on, s, (K,); ``None`` without a feed.
        durations: Time at the feed to each s from the one before, s, (K,); 0 for the first.
    """

    s: Array
    rotations: Array
    positions: Array
    projectors: tuple[TwistProjector, ...]
    on_path: Mask
    moves: Mask
    feed_times: Array | None
    durations: Array | None

    @classmethod
    def of(cls, path_task: PathTask, s: Array | None, *, flipped: bool = False) -> Waypoints:
        """The path of a task at parameters s (K,); see :meth:`PathTask.at`."""
        last = len(path_task.waypoints) - 1
        if s is None:
            s = np.arange(last + 1, dtype=np.float64)
        s = finite_array("s", np.atleast_1d(s), (None,))
        if s.size and not (s[0] >= 0.0 and s[-1] <= last and (np.diff(s) >= 0.0).all()):
            raise InvalidInput(
                f"expected ascending numbers from 0 to {last}, the last waypoint; got "
                f"{s.min():g} to {s.max():g}.",
                key="s",
            )
        rotations, positions = path_task.flipped_poses if flipped else path_task.poses
        after = np.ceil(s).astype(np.intp)
        before = np.maximum(after - 1, 0)
        share = s - before
        there = (share == 1.0) | (after == 0)  # the waypoints themselves, without rounding
        R, p, held = rotations[after], positions[after], path_task.in_force
        projectors = [held[k] for k in after.tolist()]
        between = np.flatnonzero(~there)
        if len(between):
            j, k, part = before[between], after[between], share[between, None]
            turns = rotation_vector(rotations[k] @ rotations[j].transpose(0, 2, 1))
            R[between] = rotation_matrix(part * turns) @ rotations[j]
            p[between] = positions[j] + part * (positions[k] - positions[j])
            for row, last in zip(between.tolist(), j.tolist(), strict=True):
                projectors[row] = with_fewer_rows(held[last], projectors[row])
        to = np.zeros(len(positions) + 1, dtype=bool)  # joint moves, by the waypoint they lead to
        to[list(path_task.joint_moves)] = True
        return cls(
            s, R, p, tuple(projectors), ~(to[after] & (~there | to[after + 1])), to[after[1:]],
            *_at_feed(path_task.durations, s, after),
        )  # fmt: skip

    def target(self, index: int) -> mink.SE3:
        """One of the poses."""
        return poses(self.positions[index : index + 1], self.rotations[index : index + 1])[0]


def _at_feed(
    durations: Array | None, s: Array, after: Indices
) -> tuple[Array, Array] | tuple[None, None]:
    """Times at the feed at parameters s (K,), and from each to the next, s, (K,) each."""
    if durations is None:
        return None, None
    times: Array = np.interp(s, np.arange(len(durations)), np.cumsum(durations))
    steps = np.diff(times, prepend=times[:1])
    # Between two waypoints a share of the time stated, without the rounding of sums.
    within = np.flatnonzero(np.floor(s[:-1]) == after[1:] - 1) + 1
    steps[within] = (s[within] - s[within - 1]) * durations[after[within]]
    return times, steps

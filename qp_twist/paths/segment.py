"""Sections of a path with their own projectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from qp_twist.checks import Array, Mask, instance
from qp_twist.errors import InvalidInput, about
from qp_twist.geometry import TwistProjector, task_redundancy


@dataclass(frozen=True, eq=False)
class Segment:
    """A section of a path with its own projector; it ends where the next one begins.

    Attributes:
        first: Index of its first waypoint, from 0 as in ``PathTask.waypoints`` (task files and
            tables count from 1).
        projector: T of its waypoints.
        blend: Number of waypoints, from ``first`` on, over which the change into it is spread.
            There the rows common to both projectors hold.
    """

    first: int
    projector: TwistProjector
    blend: int = 0

    def __post_init__(self) -> None:
        instance("Segment(first=…)", self.first, int)
        instance("Segment(projector=…)", self.projector, TwistProjector)
        instance("Segment(blend=…)", self.blend, int)

    def blended(self, s: Array) -> Mask:
        """Which parameters s (K,) of the path are in the blend, or on the way into it or out."""
        after: Mask = (s > self.first - 1) & (s < self.first + self.blend)
        return after & (self.blend > 0)


def projectors_in_force(
    projector: TwistProjector, segments: Sequence[Segment], count: int
) -> tuple[TwistProjector, ...]:
    """The projector in force at each of ``count`` waypoints; in blends the common one."""
    found = [projector] * count
    for segment in segments:
        common = found[segment.first - 1].intersection(segment.projector)
        found[segment.first :] = [segment.projector] * (count - segment.first)
        found[segment.first : segment.first + segment.blend] = [common] * segment.blend
    return tuple(found)


def check_segments(
    operational: TwistProjector,
    projector: TwistProjector,
    segments: Sequence[Segment],
    count: int,
    keys: Sequence[str] | None = None,
) -> None:
    """Refuse segments that do not fit a path of ``count`` waypoints, or the robot.

    ``keys`` are those of the segments in the task file, if not ``segments[0]`` and so on.

    Raises:
        InvalidInput: With the segment's key in the task file.
    """
    keys = [f"segments[{index}]" for index in range(len(segments))] if keys is None else keys
    before, begin = projector, 0
    for key, segment in zip(keys, segments, strict=True):
        instance(key, segment, Segment)
        if not begin < segment.first < count:
            raise InvalidInput(
                f"expected a waypoint after {begin + 1}, where the projector before it begins, up "
                f"to {count}, the last one; got {segment.first + 1}.",
                key=f"{key}.first",
            )
        begin = segment.first
    ends = [*(segment.first for segment in segments[1:]), count]
    for key, segment, end in zip(keys, segments, ends, strict=False):
        if not 0 <= segment.blend < end - segment.first:
            raise InvalidInput(
                f"the segment has waypoints {segment.first + 1} to {end}, and its "
                f"projector has to hold at one of them at least; got a blend over {segment.blend}.",
                key=f"{key}.blend",
            )
        with about(key):
            task_redundancy(operational, segment.projector)
            if segment.blend and before.intersection(segment.projector).rank == 0:
                raise InvalidInput(
                    "this projector has no row in common with the one before, so nothing "
                    "would be held in the blend; leave it out, or put a segment in between.",
                    key="blend",
                )
        before = segment.projector


def check_joint_moves(joint_moves: Sequence[int], segments: Sequence[Segment], count: int) -> None:
    """Refuse joint moves that do not fit the path.

    Raises:
        InvalidInput: If they are not increasing indices of waypoints after the first one, or one
            leads into a blend, whose rows would change on a stretch without a path.
    """
    instance("joint_moves", joint_moves, tuple)
    for index in joint_moves:
        instance("joint_moves", index, int)
    if list(joint_moves) != sorted(set(joint_moves)) or not all(0 < k < count for k in joint_moves):
        raise InvalidInput(
            f"expected increasing indices of waypoints from 1 to {count - 1}, got {joint_moves}.",
            key="joint_moves",
        )
    for segment in segments:
        inside = [k for k in joint_moves if segment.first <= k < segment.first + segment.blend]
        if inside:
            raise InvalidInput(
                f"a joint move leads to waypoint {inside[0] + 1}, inside the blend "
                f"from waypoint {segment.first + 1} on; begin the blend after it.",
                key="joint_moves",
            )

"""Paths with the interruptions at which the tool lifts off, and comes back after a joint move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import mink
import numpy as np

from qp_twist.checks import Indices, Mask, instance
from qp_twist.errors import InvalidInput
from qp_twist.paths.chosen_waypoints import with_waypoints
from qp_twist.paths.joint_moves import without_via_points
from qp_twist.paths.path_task import PathTask


@dataclass(frozen=True, eq=False)
class LiftOffs:
    """A path whose tool lifts off after some waypoints.

    On contact the tool lifts off, and comes back, as the path itself does: by the poses of its next
    retreat and of its last approach, relative to the frame where they begin or end. Elsewhere, and
    where the path has no retreat or approach, the joint move begins or ends at the waypoint.

    Attributes:
        path_task: The task without them, and without via points of its joint moves.
        after: The waypoints after which the tool lifts off, counted from 1, ascending.
        source: The waypoint that each one of the new path is made of, from 0, (M,).
        beside: The waypoint to which it belongs: itself, or that of which it is a retreat or an
            approach, (M,).
    """

    path_task: PathTask
    after: tuple[int, ...]
    source: Indices
    beside: Indices

    @classmethod
    def of(cls, path_task: PathTask, after: Sequence[int]) -> LiftOffs:
        """Place them.

        Raises:
            InvalidInput: If a waypoint is not one after which the path goes on along itself, or a
                piece has one waypoint only.
        """
        path_task = without_via_points(path_task)
        count = len(path_task.waypoints)
        for k in after:
            instance("cuts", k, int)
            if not 0 < k < count or k in path_task.joint_moves:
                raise InvalidInput(
                    f"{path_task.name}: the tool cannot lift off after waypoint {k}; expected one "
                    f"from 2 to {count - 2} without a joint move to the next."
                )
        if list(after) != sorted(set(after)):
            raise InvalidInput(f"cuts: expected ascending waypoints, got {list(after)}.")
        borders = sorted({0, *path_task.joint_moves, *after, count})
        for first, last in pairwise(borders):
            if last - first < 2 and not {first, last}.isdisjoint(after):
                raise InvalidInput(
                    f"{path_task.name}: with lift-offs after {list(after)} waypoint {last} is a "
                    "piece of its own; expected pieces of two waypoints at least."
                )
        source, beside = [np.arange(count)], [np.arange(count)]
        for k in reversed(after):
            retreat, approach = _leads(path_task.parts, k)
            source[0:1] = source[0][:k], retreat, approach, source[0][k:]
            ends = np.full(len(retreat), k - 1), np.full(len(approach), k)
            beside[0:1] = beside[0][:k], *ends, beside[0][k:]
        return cls(path_task, tuple(after), np.concatenate(source), np.concatenate(beside))

    @property
    def added(self) -> Mask:
        """Which waypoints of the new path are added, (M,)."""
        return np.asarray(self.source != self.beside)

    @cached_property
    def task(self) -> PathTask:
        """The task of the new path; the same if the tool never lifts off."""
        task, source, own = self.path_task, self.source, np.flatnonzero(~self.added)
        if not self.after:
            return task
        durations = task.durations
        if durations is not None:
            # From a copied approach to the path in the time of the approach it is copied from.
            arrives = np.flatnonzero(np.append(False, self.added[:-1]) & ~self.added)
            of = source.copy()
            of[arrives] = np.minimum(source[arrives - 1] + 1, len(durations) - 1)
            durations = durations[of]
        # A joint move leads to the first approaching waypoint, or to the next one of the path.
        moves = [int(np.searchsorted(self.beside, k)) for k in (*task.joint_moves, *self.after)]
        flipped = task.flipped_waypoints
        return replace(
            with_waypoints(task, source), waypoints=self._placed(task.waypoints),
            flipped_waypoints=None if flipped is None else self._placed(flipped),
            best_start=task.best_start, starts=task.starts, durations=durations,
            joint_moves=tuple(sorted(moves)),
            lines=None if task.lines is None else task.lines[self.beside],
            process=tuple((int(own[at]), text) for at, text in task.process), cuts=self.after,
        )  # fmt: skip

    def _placed(self, poses: Sequence[mink.SE3]) -> tuple[mink.SE3, ...]:
        """The poses of the new path."""
        found, parts = [], self.path_task.parts
        for k, beside in zip(self.source.tolist(), self.beside.tolist(), strict=True):
            pose = poses[beside]
            if k != beside:
                own = k
                while parts[own] != "contact":
                    own += 1 if parts[k] == "approach" else -1
                pose = pose @ poses[own].inverse() @ poses[k]
            found.append(pose)
        return tuple(found)


def _leads(parts: Sequence[str], k: int) -> tuple[Indices, Indices]:
    """The next retreat and the last approach of a path, if the interval before k is of contact."""
    none = np.zeros(0, dtype=np.intp)
    if not parts or not parts[k - 1] == parts[k] == "contact":
        return none, none

    def runs(part: str) -> list[Indices]:
        of = np.flatnonzero(np.array(parts) == part)
        return [run for run in np.split(of, np.flatnonzero(np.diff(of) > 1) + 1) if len(run)]

    retreats = (run for run in runs("retreat") if run[0] > k)
    approaches = (run for run in reversed(runs("approach")) if run[-1] < k)
    return next(retreats, none), next(approaches, none)

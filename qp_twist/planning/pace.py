"""Times along a joint path: at the feed, or as much longer as the joints' limits require."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.kernel.pace_kernel import fastest_paces
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, Waypoints
from qp_twist.planning.sentence import UNSAID, Sentence
from qp_twist.referee import motion_limits, with_default_accelerations

SLOWED = 1e-6
"""Share by which a time has to exceed that at the feed to count as slower."""


@dataclass(frozen=True, eq=False)
class Pace:
    r"""Short feasible times between waypoints, for :math:`\mathbf q_0 \dots \mathbf q_{N-1}`.

    .. math::

        t_k \ge \max\bigl(f_k,\; \max_j |\Delta\theta_{k,j}| / v_j\bigr), \qquad
        \left|\frac{\Delta\theta_{k+1,j}}{t_{k+1}} - \frac{\Delta\theta_{k,j}}{t_k}\right| \le
        \rho_k a_j\,\frac{2\,t_k\,t_{k+1}}{t_k + t_{k+1}}

    with the times f at the feed. Step k ends at waypoint k. Between waypoints velocities are
    constant; from one step to the next they change evenly, within the harmonic mean of both times
    (the last factor) at most. A change within a time τ rounds the corner by τ/8 of it, and the
    tolerance ε limits that: with unit directions e and lengths l of the steps only the share

    .. math:: \rho_k = \min\left(1,\; \frac{8\varepsilon}
        {|\mathbf e_{k+1} - \mathbf e_k|\,(l_k + l_{k+1})/2}\right)

    of that mean may be used for it.

    Attributes:
        feed: Times at the feed, s, (N − 1,); 0 without one.
        velocity: Speed limits v, rad/s or m/s, (nv,); ∞ without one.
        acceleration: Acceleration limits a, rad/s² or m/s², (nv,); ∞ likewise.
        room: The share ρ at the waypoint where each step begins, (N − 1,).
        rests: Whether the joints rest at both ends; otherwise their velocities there are free.
    """

    feed: Array
    velocity: Array
    acceleration: Array
    room: Array
    rests: bool = False

    @classmethod
    def stated(cls, path_task: PathTask, path: Waypoints | None = None) -> Pace:
        """By the speed limits of a task or its known robot, with free velocities at its ends.

        Of accelerations by those that the task states. Of a ``path`` through other points of the
        task than its waypoints, if there is one.
        """
        feed = _feed(path or path_task.at())
        velocity = motion_limits(path_task).velocity
        return cls(feed, velocity, path_task.acceleration_limits, np.ones_like(feed))

    @classmethod
    def of_run(cls, path_task: PathTask, path: Waypoints | None = None) -> Pace:
        """As a run is timed: from rest to rest, with default accelerations where none are known."""
        path = path or path_task.at()
        ranges = JointRanges.of(path_task.model)
        limits = with_default_accelerations(motion_limits(path_task), ranges)
        room = _room(path.positions, path_task.tolerances.position)
        return cls(_feed(path), limits.velocity, limits.acceleration, room, rests=True)

    def part(self, first: int, last: int) -> Pace:
        """That of the steps from one of the rows to another."""
        return replace(self, feed=self.feed[first:last], room=self.room[first:last])

    def seconds(self, q: Array) -> Array:
        """Short feasible times of a path q (N, nv), s, (N − 1,); not proven to be the shortest.

        Those of feed and speed limits; where accelerations are limited, lengthened by
        :func:`~qp_twist.kernel.pace_kernel.fastest_paces`.
        """
        moved = np.diff(q, axis=0)
        times: Array = np.maximum(
            self.feed, (np.abs(moved) / self.velocity).max(axis=1, initial=0.0)
        )
        lasting = times > 0.0  # what takes no time changes no speed
        h, limited = times[lasting], np.isfinite(self.acceleration)
        if not limited.any() or not len(h):
            return times
        D, pace = moved[lasting][:, limited] / h[:, None], np.ones(len(h))
        fastest_paces(h, D, self.acceleration[limited], self.room[lasting], self.rests, pace)
        times[lasting] = h / pace
        return times

    def shares(self, q: Array, times: Array) -> Array:
        """Of its limits the largest that each joint uses in each step, (N − 1, nv).

        Of accelerations those at both ends of the step.
        """
        lasting = np.maximum(times, np.finfo(float).tiny)[:, None]
        velocity = np.diff(q, axis=0) / lasting
        shares: Array = np.abs(velocity) / self.velocity
        mean = 2.0 * lasting[1:] * lasting[:-1] / (lasting[1:] + lasting[:-1])
        changes = np.abs(np.diff(velocity, axis=0)) / (self.room[1:, None] * mean)
        at_end = np.pad(changes / self.acceleration, ((1, 1), (0, 0)))
        most: Array = np.maximum(shares, np.maximum(at_end[1:], at_end[:-1]))
        return most


class PacedStretch(NamedTuple):
    """A stretch of a path between joint moves, and how it is timed."""

    first: int
    """Its first waypoint in the path, from 0."""
    pace: Pace
    q: Array
    """Its rows, one for each waypoint, (N, nv)."""


def slowest(stretches: Sequence[PacedStretch], names: tuple[str, ...]) -> tuple[float, Sentence]:
    """How many times longer than at the feed a path takes somewhere, and a sentence.

    The factor is 1 and the sentence empty if the feed is kept everywhere. Waypoints are those of
    the whole path; times are those of its stretches, without the joint moves between them.
    """
    seconds = [pace.seconds(q) for _, pace, q in stretches]
    feed, times = np.concatenate([of.pace.feed for of in stretches]), np.concatenate(seconds)
    before = np.concatenate([of.first + np.arange(len(of.q) - 1) for of in stretches])
    slow = np.flatnonzero((feed > 0.0) & (times > (1.0 + SLOWED) * feed))
    if not len(slow):
        return 1.0, UNSAID
    factors = times[slow] / feed[slow]
    worst = int(slow[np.argmax(factors)])
    shares = [of.pace.shares(of.q, times) for of, times in zip(stretches, seconds, strict=True)]
    joint = names[int(np.argmax(np.concatenate(shares)[worst]))]
    parts = np.split(slow, np.flatnonzero(np.diff(before[slow]) > 1) + 1)
    [longest] = [part for part in parts if worst in part]
    others = len(parts) - 1
    more = f", and at {others} more stretch{'es' if others > 1 else ''}" if others else ""
    between = ", outside joint moves" if len(stretches) > 1 else ""
    return float(factors.max()), Sentence(
        "between waypoints ", int(before[longest[0]]) + 1, " and ", int(before[longest[-1]]) + 2,
        ", after waypoint ", int(before[worst]) + 1,
        f" {factors.max():.3g} times because of {joint}{more}; in all it takes {times.sum():.4g} s "
        f"instead of {feed.sum():.4g} s{between}",
    )  # fmt: skip


def _feed(path: Waypoints) -> Array:
    if path.feed_times is None:
        return np.zeros(len(path.s) - 1)
    return np.where(path.moves, 0.0, np.diff(path.feed_times))


def _room(positions: Array, tolerance: float) -> Array:
    """The share ρ where each step between ``positions`` (N, 3), m, begins, (N − 1,)."""
    room, steps = np.ones(len(positions) - 1), np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = (lengths[1:] > 0.0) & (lengths[:-1] > 0.0)
    along = steps / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    corner = np.linalg.norm(np.diff(along, axis=0), axis=1) * 0.5 * (lengths[1:] + lengths[:-1])
    sharp = moving & (corner > 8.0 * tolerance)
    room[1:][sharp] = 8.0 * tolerance / corner[sharp]
    return room

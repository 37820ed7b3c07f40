"""The fastest timing of a joint path from rest to rest, within velocity, acceleration, jerk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.referee import JointMotion
from qp_twist.trajectories.joint_curve import JointCurve
from qp_twist.trajectories.timed_way import FeedShares, JointLimits, TimedWay


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Timing of a path.

    Attributes:
        motion: The joints in time, with rows between those of the path, (K,).
        rows: Which rows are those of the path, (N,).
        rests: At which of those the joints stand still, (N,).
        uses: Share of the velocity, acceleration and jerk limits that each piece uses, by name,
            (K − 1, nv).
    """

    motion: JointMotion
    rows: Indices
    rests: Mask
    uses: dict[str, Array]


def speed_profile(
    q: Array,
    feed: Array,
    max_velocity: Array,
    max_acceleration: Array,
    rests: Mask,
    most: Array | None = None,
    max_jerk: Array | None = None,
    shares: FeedShares | None = None,
) -> SpeedProfile:
    r"""The motion through the rows of a joint path, as fast as feed and limits permit.

    Let x be the time that the feed would take. The joints move on a curve q(x) with continuous
    second derivative (:class:`JointCurve`), at the pace :math:`\dot x`. The square
    :math:`y = \dot x^2` of the pace is what is chosen: with :math:`\ddot x = \tfrac12 y'`

    .. math::

        \ddot{\mathbf q} = \tfrac12\mathbf q'y' + \mathbf q''y, \qquad
        \dddot{\mathbf q} = \sqrt y\,\bigl(\tfrac12\mathbf q'y'' + \tfrac32\mathbf q''y'
        + \mathbf q'''y\bigr).

    *Without jerk limits* y is linear from cell to cell and as large as reachability analysis finds
    (``reachable``); the joints move on cubics in time. *With*
    them y is a quadratic spline, whose coefficients minimise the duration
    (``with_jerk_limits``); the joints move on quintics with the
    position, velocity and acceleration of each row, so that accelerations are continuous.

    Limits hold at places in each cell; by what they are exceeded between these, they are tightened
    in that cell, and all is computed again. Rows that change nothing are left out.

    Args:
        q: Joint positions, rad or m, (N, nv).
        feed: Least time of each piece, s, (N − 1,), above 0.
        max_velocity: rad/s or m/s, (nv,); ∞ without a limit.
        max_acceleration: rad/s² or m/s², (nv,); ∞ likewise.
        rests: Rows at which the joints stand still, (N,).
        most: Largest pace on each piece, above 0, (N − 1,); ∞ where limits alone count. If ``None``
            it is 1, and pieces that the velocity limits do not permit at the feed take longer from
            the outset.
        max_jerk: rad/s³ or m/s³, (nv,); ``None`` or ∞ without a limit.
        shares: What the tool has of its programmed speed at the pace 1: it is never faster, also
            where the curve is longer than its chords. ``None`` without a tool.
    """
    if max_jerk is None:
        max_jerk = np.full_like(max_velocity, np.inf)
    limits = JointLimits(max_velocity, max_acceleration, max_jerk)
    h = feed
    if most is None:
        h = np.maximum(feed, (np.abs(np.diff(q, axis=0)) / max_velocity).max(axis=1, initial=0.0))
        most = np.ones(len(h))
    x, stops = np.concatenate([[0.0], np.cumsum(h)]), np.flatnonzero(rests)
    motions, uses, rows, begin, count = [], [], [], 0.0, 0
    for first, last in pairwise(stops.tolist()):
        part = slice(first, last + 1)
        curve = JointCurve.through(x[part], q[part])
        way = TimedWay(curve, most[first:last], limits, shares and _from_row(shares, first))
        motion, kept = way.motion()
        uses.append(limits.uses(motion))
        rows.append(count + kept[:-1])
        motions.append(replace(motion, times=begin + motion.times))
        begin, count = float(motions[-1].times[-1]), count + len(motion.q) - 1
    motion, all_rows = _joined(motions), np.append(np.concatenate(rows), count)
    joined = {name: np.vstack([of[name] for of in uses]) for name in limits._fields}
    return SpeedProfile(motion, all_rows, rests, joined)


def _from_row(shares: FeedShares, first: int) -> FeedShares:
    """The shares on a part of the path that begins at this row."""
    return lambda q, rates, piece: shares(q, rates, first + piece)


def straight_profile(q: Array, floor: Array, max_velocity: Array) -> SpeedProfile:
    """Constant joint speeds from row to row: at the feed, or as fast as the velocity limits permit.

    ``floor`` (N − 1,) has the least time of each piece, s, above 0.
    """
    moved = np.abs(np.diff(q, axis=0))
    T = np.maximum(floor, (moved / max_velocity).max(axis=1, initial=0.0))
    motion = JointMotion(np.concatenate([[0.0], np.cumsum(T)]), q)
    uses, rests = {"velocity": moved / T[:, None] / max_velocity}, np.zeros(len(q), dtype=bool)
    rests[[0, -1]] = True
    return SpeedProfile(motion, np.arange(len(q)), rests, uses)


def _joined(motions: Sequence[JointMotion]) -> JointMotion:
    """Motions from rest to rest, one after the other."""
    found: list[Array | None] = []
    for name in ("times", "q", "velocities", "accelerations"):
        columns = [getattr(motion, name) for motion in motions]
        whole = [columns[0], *(None if c is None else c[1:] for c in columns[1:])]
        found.append(None if columns[0] is None else np.concatenate(whole))
    return JointMotion(*found)  # type: ignore[arg-type]

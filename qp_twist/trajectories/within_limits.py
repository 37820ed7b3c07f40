"""Times of a program's moves in which no joint exceeds its limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.programs import JointMoves
from qp_twist.referee import (
    EXCEEDED,
    JointMotion,
    motion_limits,
    with_default_accelerations,
)
from qp_twist.referee.joint_rates import largest_accelerations, largest_speeds

_ROOM = 0.01
"""Share of the limits that is left to printed digits: at a point between moves of 8 ms half a digit
of an angle, 0.9e-6 rad, is an acceleration of 0.03 rad/s², and near a singularity a pose's digits
are more."""
_ROUNDS = 200
"""Times at most that moves are made longer, so that a change of speed spreads to those beside."""


class Way(NamedTuple):
    """Joint positions on a move, behind where it begins: shares (K,) to 1 of its time, (K, n)."""

    shares: Array
    q: Array

    @classmethod
    def to(cls, q: Array) -> Way:
        """A joint move to positions (n,)."""
        return cls(np.ones(1), q[None])


class Ramp(NamedTuple):
    """Joint accelerations on a move of the tool, rad/s² or m/s², (n,) each.

    Attributes:
        per_unit: While the tool is accelerated, per m/s².
        steady: At constant speed of the tool.
    """

    per_unit: Array
    steady: Array

    @classmethod
    def of(cls, begin: Array, way: Way, seconds: float, length: float) -> Ramp:
        """On a move of ``length`` m from joint positions (n,) on.

        With q(s) of the way s, q̈ = q″ ṡ² + q′ s̈.
        """
        q, shares = np.vstack([begin, way.q]), np.append(0.0, way.shares)
        rates = np.abs(np.diff(q, axis=0)) / np.diff(shares)[:, None]
        steady = np.zeros(q.shape[1])
        if len(q) > 2:
            steady = largest_accelerations(JointMotion(seconds * shares, q))[1].max(axis=0)
        return cls(rates.max(axis=0) / length, steady)


class JointLimits(NamedTuple):
    """Largest speeds and accelerations of joints, (n,) each; ∞ without a limit."""

    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, path_task: PathTask, names: Sequence[str], *, ramps: bool = False) -> JointLimits:
        """Those that a check of a program asks, in the order of these joints.

        With ``ramps`` of a program that states accelerations, which the defaults limit, too.
        """
        limits, ranges = motion_limits(path_task), JointRanges.of(path_task.model)
        if ramps:
            limits = with_default_accelerations(limits, ranges)
        order = [ranges.names.index(name) for name in names]
        return cls(limits.velocity[order], limits.acceleration[order])

    def slower(self, begin: Array, ways: Sequence[Way], durations: Array) -> Array:
        """By which factors moves (M,) have to take longer, from joint positions (n,) on.

        A move that takes λ times as long has 1/λ of its speeds and 1/λ² of its accelerations; at a
        point, where the controller has half of both moves to change the speed, both take longer.
        """
        counts = np.array([len(way.q) for way in ways])
        owner = np.repeat(np.arange(len(ways)), counts)
        ends = np.cumsum(durations)
        shares = np.concatenate([way.shares for way in ways])
        times = np.append(0.0, (ends - durations)[owner] + shares * durations[owner])
        q = np.concatenate([begin[None], *(way.q for way in ways)])
        motion = JointMotion(times, q, points=np.append(0, np.cumsum(counts)))
        found = np.ones(len(ways))
        np.maximum.at(found, owner, (largest_speeds(motion) / self.velocity).max(axis=1))
        if len(q) > 2:
            most = (largest_accelerations(motion)[1] / self.acceleration).max(axis=1)
            for moves in (owner[:-1], owner[1:]):  # the same but at points
                np.maximum.at(found, moves, np.sqrt(most))
        return found


def within_limits(
    planned: JointMoves, begin: Array, ways: Sequence[Way], limits: JointLimits,
    written: Callable[[JointMoves], JointMoves],
) -> tuple[JointMoves, float]:  # fmt: skip
    """The moves as they are ``written``, as much slower than planned as the limits ask.

    Returns:
        The moves, and by how much all of them take longer for it, s.
    """
    moves = first = written(planned)
    limits = limits._replace(acceleration=(1.0 - _ROOM) * limits.acceleration)
    for _ in range(_ROUNDS):
        assert planned.durations is not None and moves.durations is not None
        factors = limits.slower(begin, ways, moves.durations)
        if factors.max() <= 1.0 + EXCEEDED:
            break
        planned = replace(planned, durations=planned.durations * factors * (1.0 + EXCEEDED))
        moves = written(planned)
    assert first.durations is not None and moves.durations is not None
    return moves, float(moves.durations.sum() - first.durations.sum())

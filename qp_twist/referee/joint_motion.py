"""Joints that move in time between the rows of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, finite_array, float_array
from qp_twist.errors import InvalidInput


class State(NamedTuple):
    """Where the joints are at a time, or at many: (nv,) or (K, nv) each."""

    q: Array
    """Positions, rad or m."""
    velocities: Array
    """Their first derivatives, rad/s or m/s."""
    accelerations: Array
    """Their second derivatives, rad/s² or m/s²."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    r"""Positions at times, and one interpolation between them.

    With velocities every joint moves on a cubic in time from row to row, with the position and the
    velocity of both. With :math:`T = t_{k+1} - t_k`, :math:`u = (t - t_k)/T` and
    :math:`D = (q_{k+1} - q_k)/T`

    .. math::

        \ddot q = (1 - u)\,\frac{6 D - 4\dot q_k - 2\dot q_{k+1}}{T}
            + u\,\frac{2\dot q_k + 4\dot q_{k+1} - 6 D}{T}.

    So velocities are continuous, accelerations are linear between rows and largest at one of them.
    Without velocities the joints move at constant speed from row to row. Both are what ROS'
    joint trajectory controller does with the same rows.

    Attributes:
        times: Of the rows, s, (N,), increasing.
        q: Joint positions, rad or m, (N, nv).
        velocities: Joint velocities at the rows, rad/s or m/s, (N, nv), or ``None``.

    Raises:
        InvalidInput: If a shape is wrong, there are fewer than two rows, or times do not increase.
    """

    times: Array
    q: Array
    velocities: Array | None = None

    def __post_init__(self) -> None:
        q = finite_array("q", self.q, (None, None))
        if len(q) < 2:
            raise InvalidInput(f"q: expected at least two rows, got {len(q)}.")
        times = finite_array("times", self.times, (len(q),))
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if len(late):
            k = int(late[0])
            raise InvalidInput(
                f"times: row {k + 2} is at {times[k + 1]:.9g} s, row {k + 1} at {times[k]:.9g} s; "
                "times have to increase."
            )
        if self.velocities is not None:
            finite_array("velocities", self.velocities, q.shape)

    def __repr__(self) -> str:
        rows, joints = self.q.shape
        span = self.times[-1] - self.times[0]
        return f"JointMotion({rows} rows, {joints} joints, {span:.6g} s, {self.interpolation})"

    @property
    def interpolation(self) -> str:
        """``"cubic"`` with velocities, else ``"linear"``."""
        return "linear" if self.velocities is None else "cubic"

    def at(self, t: npt.ArrayLike) -> State:
        """The joints at a time or at many, s; before the first row and after the last they rest.

        At a row the acceleration, and without velocities the velocity, is that of the piece which
        begins there; at the last row that of the piece which ends.
        """
        when = float_array("t", t)
        piece, u = self._places(np.atleast_1d(when))
        T = np.diff(self.times)[piece][:, None]
        q0, q1 = self.q[piece], self.q[piece + 1]
        D = (q1 - q0) / T
        if self.velocities is None:
            state = State(q0 + u * (q1 - q0), D, np.zeros_like(D))
        else:
            v0, v1 = self.velocities[piece], self.velocities[piece + 1]
            a0, a1 = _end_accelerations(D, v0, v1, T)
            tau = u * T
            jerk = (a1 - a0) / T
            state = State(
                # The same cubic from its nearer end, so that both ends come out as they are stored.
                np.where(
                    u <= 0.5,
                    q0 + tau * (v0 + tau * (a0 / 2.0 + tau * jerk / 6.0)),
                    q1 + (tau - T) * (v1 + (tau - T) * (a1 / 2.0 + (tau - T) * jerk / 6.0)),
                ),
                v0 + tau * (a0 + tau * jerk / 2.0),
                a0 + tau * jerk,
            )
        outside = (np.atleast_1d(when) < self.times[0]) | (np.atleast_1d(when) > self.times[-1])
        state.velocities[outside] = 0.0
        state.accelerations[outside] = 0.0
        return State(*(x[0] for x in state)) if when.ndim == 0 else state

    def extremes(self) -> tuple[Array, Array]:
        """Lowest and highest q of each piece, exactly, rad or m, (N − 1, nv) each."""
        ends = [self.q[:-1], self.q[1:]]
        if self.velocities is None:
            return np.min(ends, axis=0), np.max(ends, axis=0)
        T = np.diff(self.times)[:, None]
        v0 = self.velocities[:-1]
        a0, a1 = self.end_accelerations()
        # Where q̇ = v0 + a0 τ + (a1 − a0) τ²/2T is zero; both roots in forms that lose no digits.
        half = 0.5 * (a1 - a0) / T
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(a0**2 - 4.0 * half * v0)
            turning = -0.5 * (a0 + np.where(a0 < 0.0, -root, root))
            for tau in (turning / half, v0 / turning):
                inner = np.clip(np.where(np.isfinite(tau), tau, 0.0), 0.0, T)
                ends.append(self.q[:-1] + inner * (v0 + inner * (a0 / 2.0 + inner * half / 3.0)))
        return np.min(ends, axis=0), np.max(ends, axis=0)

    def largest_speeds(self) -> Array:
        """Largest |q̇| of each piece between two rows, exactly, rad/s or m/s, (N − 1, nv)."""
        T = np.diff(self.times)[:, None]
        if self.velocities is None:
            return np.abs(np.diff(self.q, axis=0) / T)
        v0, v1 = self.velocities[:-1], self.velocities[1:]
        a0, a1 = self.end_accelerations()
        turning = np.divide(-a0, a1 - a0, out=np.zeros_like(a0), where=a1 != a0)
        turning = np.clip(turning, 0.0, 1.0)
        between = v0 + turning * T * (a0 + turning * (a1 - a0) / 2.0)
        largest: Array = np.max(np.abs([v0, v1, between]), axis=0)
        return largest

    def largest_within(self, piece: Indices, begin: Array, end: Array) -> tuple[Array, Array]:
        """Largest |q̇| and |q̈| within parts of the pieces between rows, exactly, (K, nv) each.

        Args:
            piece: Index of the row before each part, (K,).
            begin: When the part begins, s, (K,), inside its piece.
            end: When it ends, s, (K,).
        """
        T = np.diff(self.times)[piece][:, None]
        D = (self.q[piece + 1] - self.q[piece]) / T
        if self.velocities is None:
            return np.abs(D), np.zeros_like(D)
        v0, v1 = self.velocities[piece], self.velocities[piece + 1]
        a0, a1 = _end_accelerations(D, v0, v1, T)
        jerk = (a1 - a0) / T
        with np.errstate(divide="ignore", invalid="ignore"):
            turning = -a0 / jerk  # where the speed is extreme
        first, last = ((t - self.times[piece])[:, None] for t in (begin, end))
        turning = np.clip(np.where(np.isfinite(turning), turning, first), first, last)
        speeds = [v0 + tau * (a0 + tau * jerk / 2.0) for tau in (first, turning, last)]
        accelerations = [a0 + tau * jerk for tau in (first, last)]
        return np.max(np.abs(speeds), axis=0), np.max(np.abs(accelerations), axis=0)

    def end_accelerations(self) -> tuple[Array, Array]:
        """q̈ at the begin and at the end of each piece, rad/s² or m/s², (N − 1, nv) each."""
        T = np.diff(self.times)[:, None]
        D = np.diff(self.q, axis=0) / T
        if self.velocities is None:
            return np.zeros_like(D), np.zeros_like(D)
        return _end_accelerations(D, self.velocities[:-1], self.velocities[1:], T)

    def largest_accelerations(self) -> Array:
        """Largest |q̈| of each piece, exactly, rad/s² or m/s², (N − 1, nv); 0 without velocities."""
        largest: Array = np.max(np.abs(self.end_accelerations()), axis=0)
        return largest

    def _places(self, when: Array) -> tuple[Indices, Array]:
        """Index of the piece at each time, (K,), and how much of it is over, (K, 1)."""
        last = len(self.times) - 2
        piece = np.clip(np.searchsorted(self.times, when, side="right") - 1, 0, last)
        begin, end = self.times[piece], self.times[piece + 1]
        return piece, np.clip((when - begin) / (end - begin), 0.0, 1.0)[:, None]


def _end_accelerations(D: Array, v0: Array, v1: Array, T: Array) -> tuple[Array, Array]:
    return (6.0 * D - 4.0 * v0 - 2.0 * v1) / T, (2.0 * v0 + 4.0 * v1 - 6.0 * D) / T

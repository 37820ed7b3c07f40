"""Record of a closed loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from qp_twist.checks import Array, number
from qp_twist.control import ServoState, Status, Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Record:
    """A run of a :class:`~qp_twist.simulation.ClosedLoop`, one entry for each of its N periods.

    States are true states at the beginning of the period, when the controller computes its step.
    Extremes between two such instants are taken over the simulation's time steps: margin, room,
    speed and accelerations.

    Attributes:
        time: Beginning of each period, s, (N,).
        q: Joint positions, rad or m, (N, nq).
        velocity: Joint velocities, rad/s or m/s, (N, nv).
        measured: Joint positions with noise, (N, nq).
        command: Commanded joint velocities, (N, nv).
        position_error: Length of the linear part of UᵀΔt, m, (N,), of the controller's first task.
        angle_error: Length of the angular part, rad, (N,).
        margin: Lowest 1 − |θ − θ̄|/half-range of all joints, (N,); negative outside.
        room: Distance of the joint nearest to a limit, rad or m, (N,); negative outside.
        acceleration_peak: Largest joint accelerations in size, rad/s² or m/s², (N, nv).
        acceleration_rms: Their root mean square, (N, nv).
        speed_share: Largest joint speed as a share of its limit, (N,); 0 without limits.
        scale: Scale of each step, (N,); 0 without a step.
        statuses: Status of each step, (N,); ``None`` without a step.
        states: What the servo was doing, (N,); ``None`` where a controller runs without one.
        failures: Why there was no step, by time.
        period: Length of a period, s.
        diverged: Whether the run ended early since the robot diverged.
    """

    time: Array
    q: Array
    velocity: Array
    measured: Array
    command: Array
    position_error: Array
    angle_error: Array
    margin: Array
    room: Array
    acceleration_peak: Array
    acceleration_rms: Array
    speed_share: Array
    scale: Array
    statuses: tuple[Status | None, ...]
    states: tuple[ServoState | None, ...]
    failures: dict[float, str]
    period: float
    diverged: bool

    def summary(self, since: float = 0.0) -> dict[str, float]:
        """The record in numbers, SI units.

        Root mean squares are over time and, for joints, over all of them; ``command_step`` is the
        change of a commanded velocity from one period to the next.

        Args:
            since: Leave out the periods that begin before this time, s.

        Raises:
            InvalidInput: If the record has fewer than two periods from then on.
        """
        kept = self.time >= number("since", since) - 1e-9
        if kept.sum() < 2:
            raise InvalidInput(
                f"summary: the record ends at {self.time[-1]:g} s; give an earlier since."
            )
        steps = np.diff(self.command[kept], axis=0)
        met = [
            status is not None and status.severity <= Status.PRIORITIZED.severity
            for status, k in zip(self.statuses, kept, strict=True)
            if k
        ]
        return {
            "position_error_rms": _rms(self.position_error[kept]),
            "position_error_max": float(self.position_error[kept].max()),
            "angle_error_rms": _rms(self.angle_error[kept]),
            "angle_error_max": float(self.angle_error[kept].max()),
            "min_margin": float(self.margin[kept].min()),
            "min_room": float(self.room[kept].min()),
            "acceleration_rms": _rms(self.acceleration_rms[kept]),
            "acceleration_max": float(self.acceleration_peak[kept].max()),
            "command_step_rms": _rms(steps),
            "command_step_max": float(np.abs(steps).max()),
            "speed_share_max": float(self.speed_share[kept].max()),
            "min_scale": float(self.scale[kept].min()),
            "steps_not_met": len(met) - sum(met),
        }

    def count(self) -> dict[str, int]:
        """Number of steps of each status; ``NO_STEP`` for periods without a step."""
        return dict(Counter("NO_STEP" if s is None else s.name for s in self.statuses))

    def figure(self, title: str = "") -> Figure:
        """Errors, margin, joint speeds and scale over time, in four panels."""
        from qp_twist.simulation.figure import draw  # matplotlib, which takes half a second

        return draw(self, title)

    def __repr__(self) -> str:
        end = ", diverged" if self.diverged else ""
        return f"Record({len(self.time)} periods of {self.period:g} s{end}, {self.count()})"


class Interval(NamedTuple):
    """One period of a loop: its beginning, the command, and the true states in it."""

    time: float
    error: Array
    """Δt of the task at the true state when the period begins, (6,)."""
    measured: Array
    command: Array
    step: Step | None
    state: ServoState | None
    failure: str
    q: Array
    """At each time step and at the end, (substeps + 1, nq)."""
    velocity: Array


class Recorder:
    """Collects intervals into a record."""

    def __init__(self, ranges: JointRanges, speeds: Array, period: float, timestep: float) -> None:
        self._ranges = ranges
        self._speeds = speeds
        self._period = period
        self._timestep = timestep

    def record(self, intervals: Sequence[Interval], *, diverged: bool) -> Record:
        """The intervals as arrays."""
        q = np.array([interval.q for interval in intervals])
        velocity = np.array([interval.velocity for interval in intervals])
        error = np.array([interval.error for interval in intervals])
        acceleration = np.diff(velocity, axis=1) / self._timestep
        ranges = self._ranges
        room = ranges.room(q)
        return Record(
            time=np.array([interval.time for interval in intervals]),
            q=q[:, 0],
            velocity=velocity[:, 0],
            measured=np.array([interval.measured for interval in intervals]),
            command=np.array([interval.command for interval in intervals]),
            position_error=np.linalg.norm(error[:, :3], axis=1),
            angle_error=np.linalg.norm(error[:, 3:], axis=1),
            margin=ranges.margins(q).min(axis=(1, 2)),
            room=room.min(axis=(1, 2)),
            acceleration_peak=np.abs(acceleration).max(axis=1),
            acceleration_rms=np.sqrt((acceleration**2).mean(axis=1)),
            speed_share=(np.abs(velocity) / self._speeds).max(axis=(1, 2)),
            scale=np.array([0.0 if i.step is None else i.step.scale for i in intervals]),
            statuses=tuple(None if i.step is None else i.step.status for i in intervals),
            states=tuple(i.state for i in intervals),
            failures={i.time: i.failure for i in intervals if i.failure},
            period=self._period,
            diverged=diverged,
        )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))

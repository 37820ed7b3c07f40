"""What a servo commands for one period, and what it is doing."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from qp_twist.checks import Array
from qp_twist.control.step import Status, Step


class ServoState(enum.Enum):
    """What a servo is doing; the value says it to a person."""

    HOLDING = "holding: no target is coming"
    TRACKING = "tracking the targets"
    APPROACHING = "approaching a target that is far away"
    SLOWED = "slowed by limits"
    SINGULAR = "singular"
    AT_THE_EDGE = "at the edge of the reach"
    STOPPING = "stopping: the targets have ceased"
    BLOCKED = "stopping: no step was found"


@dataclass(frozen=True, eq=False)
class Tick:
    """What a servo commands for one period.

    Attributes:
        velocity: q̇, rad/s or m/s, (nv,).
        state: What the servo is doing.
        step: The controller's step; ``None`` if it found none.
        failure: Why it found none.
        exit_joints: Names of the joints whose motion leads out of a singularity, if it is in one.
    """

    velocity: Array
    state: ServoState
    step: Step | None
    failure: str = ""
    exit_joints: tuple[str, ...] = ()

    @property
    def message(self) -> str:
        """The state in a sentence, with what causes it."""
        step, text = self.step, self.state.value
        if self.state is ServoState.BLOCKED:
            return f"{text}: {self.failure}"
        if step is None:
            return text
        by = ", ".join(str(limit) for limit in step.binding)
        if self.state is ServoState.SLOWED and by:
            share = f" to {100.0 * step.scale:.0f} %" if step.status is Status.SCALED else ""
            text = f"slowed{share} by {by}"
        lost = ", ".join(str(lost) for lost in step.lost)
        if self.state is ServoState.SINGULAR:
            joints = " and ".join(self.exit_joints)
            text += f": no joint moves {lost}; leaving by the motion of {joints}"
        if self.state is ServoState.AT_THE_EDGE and lost:
            text += f": {lost}"
        return text

    def __repr__(self) -> str:
        return f"Tick({self.message})"

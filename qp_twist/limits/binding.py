"""A limit that stands in the way, by name."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BindingLimit:
    """One limit that holds the step back.

    Attributes:
        joint: Joint name as in the scene, or for a general row a label such as
            ``"CollisionAvoidanceLimit row 2"``.
        kind: ``"position"``, ``"velocity"``, ``"acceleration"``, or the name of the limit's class.
        side: ``"lower"`` or ``"upper"``.
        multiplier: How much the objective (or, where the step was scaled, the scale) would gain for
            each unit of room; positive.
    """

    joint: str
    kind: str
    side: str
    multiplier: float

    def __str__(self) -> str:
        return f"{self.joint} ({self.side} {self.kind} limit)"

"""A limit that stands in the way, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qp_twist.checks import Array

DUST = 1e-7
"""A multiplier below this share of the largest, or of 1 where those are small, is none."""


@dataclass(frozen=True)
class BindingLimit:
    """One limit that holds the step back.

    Attributes:
        joint: Joint name as in the scene; for a collision the pair of geoms, for a tolerance band
            its name.
        kind: ``"position"``, ``"velocity"``, ``"acceleration"``, ``"collision"``, ``"band"``, or
            the name of the limit's class.
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


def binding_bounds(
    box: Array, dust: float, names: Sequence[str], lower_kind: Any, upper_kind: Any
) -> list[BindingLimit]:
    """The bounds whose multipliers (nv,) are above ``dust``, by joint; positive: the upper one.

    ``lower_kind`` and ``upper_kind`` are indexed by degree of freedom.
    """
    found = []
    for dof in np.flatnonzero(np.abs(box) > dust).tolist():
        side, kinds = ("upper", upper_kind) if box[dof] > 0.0 else ("lower", lower_kind)
        found.append(BindingLimit(names[dof], kinds[dof], side, float(abs(box[dof]))))
    return found

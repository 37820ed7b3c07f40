"""A limit that stands in the way, by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qp_twist.checks import Array, largest

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


def binding_limits(
    box: Array,
    rows: Array,
    floor: float,
    joints: Sequence[str],
    kinds: tuple[Any, Any],
    sources: Iterable[Any],
) -> tuple[BindingLimit, ...]:
    """The limits with a multiplier, by name.

    Args:
        box: Multipliers of the bounds, positive at an upper one, negative at a lower one, (nv,).
        rows: Those of inequality rows, (k,).
        floor: Multipliers are dust below a share of the largest, or of this if that is larger.
        joints: Names by degree of freedom.
        kinds: Of the lower and of the upper bounds, by degree of freedom.
        sources: What the rows come from, which knows their names.
    """
    # Interior-point and first-order backends leave dust on inactive limits.
    dust = DUST * max(largest(box), rows.max(initial=0.0), floor)
    found = []
    for dof in np.flatnonzero(np.abs(box) > dust).tolist():
        upper = bool(box[dof] > 0.0)
        side = "upper" if upper else "lower"
        found.append(BindingLimit(joints[dof], kinds[upper][dof], side, float(abs(box[dof]))))
    active = np.flatnonzero(rows > dust).tolist()
    if active:  # only then names are looked up
        names: list[tuple[str, str]] = [name for source in sources for name in source.names]
        found += [BindingLimit(*names[row], "upper", float(rows[row])) for row in active]
    return tuple(found)

"""Active limits of a step, by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qp_twist.checks import Array, largest
from qp_twist.kinematics.tolerance_band import ELASTIC

NEGLIGIBLE = 1e-7
"""Multipliers below this share of the largest one (or of 1, if larger) count as zero: some backends
return small multipliers for inactive limits."""
_OF_PAIRS = "clearance", "collision"


@dataclass(frozen=True)
class BindingLimit:
    """A limit that is active in a step.

    Attributes:
        joint: Joint name as in the scene; for a collision the pair of geoms, for a tolerance band
            its name.
        kind: ``"position"``, ``"velocity"``, ``"acceleration"``, ``"collision"``, ``"band"``, or
            the name of the limit's class.
        side: ``"lower"`` or ``"upper"``.
        multiplier: Gain of the objective (of the scale, if the step was scaled) per unit by which
            the limit is widened; positive.
    """

    joint: str
    kind: str
    side: str
    multiplier: float

    def __str__(self) -> str:
        if self.kind in _OF_PAIRS:  # which have no sides
            return f"{self.joint} ({self.kind})"
        return f"{self.joint} ({self.side} {self.kind} limit)"


def binding_limits(
    box: Array,
    rows: Array,
    floor: float,
    joints: Sequence[str],
    kinds: tuple[Any, Any],
    sources: Iterable[Any],
) -> tuple[BindingLimit, ...]:
    """The limits with a nonzero multiplier, by name; of the rows of one pair the largest.

    Args:
        box: Multipliers of the bounds, positive at an upper one, negative at a lower one, (nv,).
        rows: Multipliers of the inequality rows, (k,).
        floor: Multipliers count as zero below a share of the largest one, or of this if larger.
        joints: Names by degree of freedom.
        kinds: Kinds of the lower and of the upper bounds, by degree of freedom.
        sources: Limits and bands behind the rows, which have the rows' names.
    """
    names: list[tuple[str, str]] = []
    if rows.any():  # names are looked up only then
        names = [name for source in sources for name in source.names]
        # Those of elastic tasks are no limits, and their prices are far above all others.
        rows = np.where([kind == ELASTIC for _, kind in names], 0.0, rows)
    negligible = NEGLIGIBLE * max(largest(box), rows.max(initial=0.0), floor)
    found = []
    for dof in np.flatnonzero(np.abs(box) > negligible).tolist():
        upper = bool(box[dof] > 0.0)
        side = "upper" if upper else "lower"
        found.append(BindingLimit(joints[dof], kinds[upper][dof], side, float(abs(box[dof]))))
    pairs: dict[tuple[str, str], float] = {}
    for row in np.flatnonzero(rows > negligible).tolist():
        name, multiplier = names[row], float(rows[row])
        if name[1] in _OF_PAIRS:
            pairs[name] = max(pairs.get(name, 0.0), multiplier)
        else:
            found.append(BindingLimit(*name, "upper", multiplier))
    found += [BindingLimit(*name, "upper", most) for name, most in pairs.items()]
    return tuple(found)

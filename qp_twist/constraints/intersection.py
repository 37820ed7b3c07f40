"""Intersection of velocity boxes, and which limit is relaxed where two contradict each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices
from qp_twist.constraints.box_limit import Box, no_box
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.joint_ranges import joint_names

Kinds = npt.NDArray[np.object_]

_ORDER = {"acceleration": 0, "position": 2, "coupling": 2, "clearance": 3}
_ROUNDING, _FINITE = 1e-9, np.finfo(float).max


@dataclass(eq=False)
class Intersection:
    """Bounds common to several boxes; the limit behind each bound is computed on first access.

    Attributes:
        lower: Lower velocity bounds, rad/s or m/s, (nv,).
        upper: Upper velocity bounds, (nv,).
    """

    lower: Array
    upper: Array
    _boxes: Sequence[Box]
    _resolved: dict[int, tuple[str, str]]
    """Kinds of the lower and upper bound of each degree of freedom that had a conflict."""

    @cached_property
    def lower_kind(self) -> Kinds:
        """Kind of the limit that set each lower bound, (nv,); arbitrary where it is infinite."""
        return self._kinds(0, np.array([box.lower for box in self._boxes]).argmax(axis=0))

    @cached_property
    def upper_kind(self) -> Kinds:
        """Kind of the limit that set each upper bound, (nv,)."""
        return self._kinds(1, np.array([box.upper for box in self._boxes]).argmin(axis=0))

    def _kinds(self, side: int, origin: Indices) -> Kinds:
        kinds = np.array([box.kind for box in self._boxes], dtype=object)[origin]
        for dof, both in self._resolved.items():
            kinds[dof] = both[side]
        return kinds


def intersect(boxes: Sequence[Box], model: mujoco.MjModel) -> Intersection:
    """Bounds common to all boxes, (nv,).

    Two boxes may have no velocity in common (a start outside a range, a joint too fast to stop).
    Then a velocity limit yields to an acceleration limit, and a position limit, the coupling of a
    joint that does not move, or a clearance yields to any other kind: its bound becomes the nearest
    velocity that the other limit allows.

    Raises:
        InvalidInput: If a bound is not a number, or two limits contradict each other and neither
            yields.
    """
    nv = model.nv
    for box in boxes:
        if box.lower.shape != (nv,) or box.upper.shape != (nv,):
            raise InvalidInput(
                f"limits: a {box.kind} limit has bounds of shape {box.lower.shape} and "
                f"{box.upper.shape}, the model needs ({nv},)."
            )
    ordered = sorted(boxes, key=lambda box: _ORDER.get(box.kind, 1)) or [no_box("", nv)]
    lower, upper = ordered[0].lower.copy(), ordered[0].upper.copy()
    for box in ordered[1:]:
        np.maximum(lower, box.lower, out=lower)
        np.minimum(upper, box.upper, out=upper)
    # False for NaN, for a lower bound of +∞ and for an upper bound of −∞.
    consistent = np.maximum(lower, -_FINITE) <= np.minimum(upper, _FINITE)
    resolved: dict[int, tuple[str, str]] = {}
    if np.count_nonzero(consistent) < nv:
        for dof in np.flatnonzero(~consistent).tolist():
            lower[dof], upper[dof], *kinds = _resolve_conflict(ordered, dof, model)
            resolved[dof] = kinds[0], kinds[1]
    return Intersection(lower, upper, ordered, resolved)


def _resolve_conflict(
    ordered: Sequence[Box], dof: int, model: mujoco.MjModel
) -> tuple[float, float, str, str]:
    """Bounds and their kinds for one degree of freedom on which boxes contradict each other."""
    lower, upper, lower_kind, upper_kind = -np.inf, np.inf, "", ""
    for kind, lowers, uppers in ordered:
        low, high = float(lowers[dof]), float(uppers[dof])
        if not (low < np.inf and high > -np.inf):
            raise InvalidInput(
                f"limits: a {kind} limit has bounds of {low} and {high} for joint "
                f"{joint_names(model)[dof]!r}; expected numbers, or ∞ for none."
            )
        if low > upper:
            _check_yielding(kind, upper_kind, dof, model, (low, kind), (upper, upper_kind))
            lower, lower_kind = upper, upper_kind
        elif low > lower:
            lower, lower_kind = low, kind
        if high < lower:
            _check_yielding(kind, lower_kind, dof, model, (lower, lower_kind), (high, kind))
            upper, upper_kind = lower, lower_kind
        elif high < upper:
            upper, upper_kind = high, kind
    return lower, upper, lower_kind, upper_kind


def _check_yielding(
    kind: str,
    previous: str,
    dof: int,
    model: mujoco.MjModel,
    lower: tuple[float, str],
    upper: tuple[float, str],
) -> None:
    """Raise if a lower bound exceeds an upper one and ``kind`` does not yield to ``previous``."""
    yields = kind in ("position", "coupling", "clearance") or (kind, previous) == (
        "velocity",
        "acceleration",
    )
    if lower[0] - upper[0] > _ROUNDING and not (yields and kind != previous):
        raise InvalidInput(
            f"limits: joint {joint_names(model)[dof]!r} has a lower velocity bound of "
            f"{lower[0]:.6g} ({lower[1]}) above its upper bound of {upper[0]:.6g} ({upper[1]}); "
            "check the ranges and limits given."
        )

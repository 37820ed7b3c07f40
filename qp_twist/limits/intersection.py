"""The intersection of boxes, and which of them gives way where they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.joint_ranges import joint_names
from qp_twist.limits.box_limit import Box, no_box

Kinds = npt.NDArray[np.object_]

_ORDER = {"acceleration": 0, "position": 2, "coupling": 2}
_ROUNDING, _FINITE = 1e-9, np.finfo(float).max


@dataclass(eq=False)
class Intersection:
    """Bounds common to several boxes; which limit set each is worked out when it is asked for.

    Attributes:
        lower: Lower velocity bounds, rad/s or m/s, (nv,).
        upper: Upper velocity bounds, (nv,).
    """

    lower: Array
    upper: Array
    _boxes: Sequence[Box]
    _settled: dict[int, tuple[str, str]]

    @cached_property
    def lower_kind(self) -> Kinds:
        """Kind of the limit that set each lower bound, (nv,); where it is infinite, any."""
        return self._kinds(0, np.array([box.lower for box in self._boxes]).argmax(axis=0))

    @cached_property
    def upper_kind(self) -> Kinds:
        """Likewise of each upper bound."""
        return self._kinds(1, np.array([box.upper for box in self._boxes]).argmin(axis=0))

    def _kinds(self, side: int, origin: Indices) -> Kinds:
        kinds = np.array([box.kind for box in self._boxes], dtype=object)[origin]
        for dof, both in self._settled.items():
            kinds[dof] = both[side]
        return kinds


def intersect(boxes: Sequence[Box], model: mujoco.MjModel) -> Intersection:
    """Bounds common to all boxes, (nv,).

    Where no velocity satisfies two of them (a start outside a range, a joint too fast to stop) a
    velocity limit gives way to an acceleration limit, and a position limit, or the coupling of a
    joint that stays where it is, to any other: it takes the velocity that the other still allows
    and that is nearest to its own.

    Raises:
        InvalidInput: If a bound is not a number, or two limits contradict each other and neither
            gives way.
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
    meet = np.maximum(lower, -_FINITE) <= np.minimum(upper, _FINITE)  # NaN and ±∞ do not
    settled: dict[int, tuple[str, str]] = {}
    if np.count_nonzero(meet) < nv:
        for dof in np.flatnonzero(~meet).tolist():
            lower[dof], upper[dof], *kinds = _settle(ordered, dof, model)
            settled[dof] = kinds[0], kinds[1]
    return Intersection(lower, upper, ordered, settled)


def _settle(
    ordered: Sequence[Box], dof: int, model: mujoco.MjModel
) -> tuple[float, float, str, str]:
    """The bounds of one degree of freedom and their kinds where some box has to give way."""
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
    standing: str,
    dof: int,
    model: mujoco.MjModel,
    lower: tuple[float, str],
    upper: tuple[float, str],
) -> None:
    """Refuse a lower bound above an upper one unless the new kind gives way to the standing one."""
    yields = kind in ("position", "coupling") or (kind, standing) == ("velocity", "acceleration")
    if lower[0] - upper[0] > _ROUNDING and not (yields and kind != standing):
        raise InvalidInput(
            f"limits: joint {joint_names(model)[dof]!r} has a lower velocity bound of "
            f"{lower[0]:.6g} ({lower[1]}) above its upper bound of {upper[0]:.6g} ({upper[1]}); "
            "check the ranges and limits given."
        )

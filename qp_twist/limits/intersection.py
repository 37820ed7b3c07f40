"""The intersection of boxes, and which of them gives way where they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.limits.box_limit import Box

Kinds = npt.NDArray[np.object_]

_ORDER = {"acceleration": 0, "position": 2}
_ROUNDING = 1e-9


def intersect(boxes: Sequence[Box], model: mujoco.MjModel) -> tuple[Array, Array, Kinds, Kinds]:
    """Lower and upper bounds common to all boxes, and the kind that set each; all (nv,).

    Where no velocity satisfies two of them (a start outside a range, a joint too fast to stop) a
    velocity limit gives way to an acceleration limit, and a position limit to any other: it takes
    the velocity that the other still allows and that is nearest to its own. The kind of an infinite
    bound means nothing.

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
    ordered = [Box("", np.full(nv, -np.inf), np.full(nv, np.inf))]
    ordered += sorted(boxes, key=lambda box: _ORDER.get(box.kind, 1))
    names = np.array([box.kind for box in ordered], dtype=object)
    lowers, uppers = np.array([box.lower for box in ordered]), np.array([b.upper for b in ordered])
    lower_origin, upper_origin = lowers.argmax(axis=0), uppers.argmin(axis=0)
    lower, upper = lowers.max(axis=0), uppers.min(axis=0)
    lower_kind, upper_kind = names[lower_origin], names[upper_origin]
    for dof in np.flatnonzero(~((lower <= upper) & (lower < np.inf) & (upper > -np.inf))):
        lower[dof], upper[dof], lower_kind[dof], upper_kind[dof] = _settle(ordered, int(dof), model)
    return lower, upper, lower_kind, upper_kind


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
                f"{JointRanges.of(model).names[dof]!r}; expected numbers, or ∞ for none."
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
    yields = kind == "position" or (kind, standing) == ("velocity", "acceleration")
    if lower[0] - upper[0] > _ROUNDING and not (yields and kind != standing):
        raise InvalidInput(
            f"limits: joint {JointRanges.of(model).names[dof]!r} has a lower velocity bound of "
            f"{lower[0]:.6g} ({lower[1]}) above its upper bound of {upper[0]:.6g} ({upper[1]}); "
            "check the ranges and limits given."
        )

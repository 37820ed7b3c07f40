"""Bounds on single joint velocities, and which of them yields where two contradict each other."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.joint_ranges import joint_names

Kinds = npt.NDArray[np.object_]
_ORDER = {"acceleration": 0, "position": 2, "coupling": 2, "clearance": 3}
"""Kinds in the order in which they count, 1 for others; of two the later one may yield."""
_ROUNDING, _FINITE = 1e-9, np.finfo(float).max


class Box(NamedTuple):
    """lower ≤ q̇ ≤ upper, each (nv,), rad/s or m/s, and the kind of limit."""

    kind: str
    lower: Array
    upper: Array

    def check_shape(self, nv: int) -> None:
        """Refuse bounds of another number of joints."""
        if self.lower.shape != (nv,) or self.upper.shape != (nv,):
            raise InvalidInput(
                f"limits: a {self.kind} limit has bounds of shape {self.lower.shape} and "
                f"{self.upper.shape}, the model needs ({nv},)."
            )


@functools.lru_cache
def no_box(kind: str, nv: int) -> Box:
    """A box without bounds."""
    return Box(kind, np.full(nv, -np.inf), np.full(nv, np.inf))


class BoxLimit(mink.Limit):
    """Base of the limits lower ≤ q̇ ≤ upper; also a plain :class:`mink.Limit`.

    Attributes:
        kind: Its name in messages and in :class:`~qp_twist.constraints.BindingLimit`.
    """

    kind: str = "box"

    @abc.abstractmethod
    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """Lower and upper joint velocity, rad/s or m/s, each (nv,); ±∞ without a bound."""

    def boxes(self, configuration: mink.Configuration, dt: float) -> tuple[Box, ...]:
        """The bounds, one box for each kind of limit."""
        return (Box(self.kind, *self.bounds(configuration, dt)),)

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint that is outside the limit and returning."""
        return ()

    def note(self, velocity: Array) -> None:
        """Store the joint velocity (nv,) of the last step; called by the controller."""

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The bounds as mink's rows G Δq ≤ h."""
        box = Box(self.kind, *self.bounds(configuration, dt))
        box.check_shape(configuration.model.nv)
        _, lower, upper = box
        below, above = np.isfinite(lower), np.isfinite(upper)
        if not (below.any() or above.any()):
            return mink.Constraint()
        identity = np.eye(configuration.model.nv)
        return mink.Constraint(
            G=np.vstack([identity[above], -identity[below]]),
            h=np.hstack([upper[above], -lower[below]]) * dt,
        )


class Intersection:
    """Bounds common to all boxes; the limit behind each bound is looked up on first access.

    Two boxes may have no velocity in common (a start outside a range, a joint too fast to stop).
    Then a velocity limit yields to an acceleration limit, and a position limit, the coupling of a
    joint that does not move, or a clearance yields to any other kind: its bound becomes the nearest
    velocity that the other limit allows. Others that contradict each other are refused.

    Attributes:
        lower: Lower velocity bounds, rad/s or m/s, (nv,).
        upper: Upper velocity bounds, (nv,).
        model: The robot.
    """

    def __init__(self, boxes: Sequence[Box], model: mujoco.MjModel) -> None:
        """Intersect boxes of a model."""
        nv = model.nv
        for box in boxes:
            box.check_shape(nv)
        self.model = model
        self._boxes = sorted(boxes, key=lambda box: _ORDER.get(box.kind, 1)) or [no_box("", nv)]
        self.lower, self.upper = self._boxes[0].lower.copy(), self._boxes[0].upper.copy()
        for box in self._boxes[1:]:
            np.maximum(self.lower, box.lower, out=self.lower)
            np.minimum(self.upper, box.upper, out=self.upper)
        self._resolved: dict[int, tuple[str, str]] = {}
        # False for NaN, for a lower bound of +∞ and for an upper bound of −∞.
        consistent = np.maximum(self.lower, -_FINITE) <= np.minimum(self.upper, _FINITE)
        if np.count_nonzero(consistent) < nv:
            for dof in np.flatnonzero(~consistent).tolist():
                self._resolve(dof)

    @property
    def names(self) -> tuple[str, ...]:
        """Joint name of each degree of freedom."""
        return joint_names(self.model)

    @functools.cached_property
    def lower_kind(self) -> Kinds:
        """Kind of the limit that set each lower bound, (nv,); arbitrary where it is infinite."""
        return self._kinds(0, np.array([box.lower for box in self._boxes]).argmax(axis=0))

    @functools.cached_property
    def upper_kind(self) -> Kinds:
        """Kind of the limit that set each upper bound, (nv,)."""
        return self._kinds(1, np.array([box.upper for box in self._boxes]).argmin(axis=0))

    def _kinds(self, side: int, origin: Indices) -> Kinds:
        kinds = np.array([box.kind for box in self._boxes], dtype=object)[origin]
        for dof, both in self._resolved.items():
            kinds[dof] = both[side]
        return kinds

    def _resolve(self, dof: int) -> None:
        """Set the bounds of a degree of freedom on which boxes contradict each other."""
        value = operator.itemgetter(0)
        lower, upper = (-np.inf, ""), (np.inf, "")
        for kind, lowers, uppers in self._boxes:
            low, high = (float(lowers[dof]), kind), (float(uppers[dof]), kind)
            if not (low[0] < np.inf and high[0] > -np.inf):
                raise InvalidInput(
                    f"limits: a {kind} limit has bounds of {low[0]} and {high[0]} for joint "
                    f"{self.names[dof]!r}; expected numbers, or ∞ for none."
                )
            self._check_yielding(dof, kind, upper[1], low, upper)
            lower = max(lower, min(low, upper, key=value), key=value)
            self._check_yielding(dof, kind, lower[1], lower, high)
            upper = min(upper, max(high, lower, key=value), key=value)
        (self.lower[dof], below), (self.upper[dof], above) = lower, upper
        self._resolved[dof] = below, above

    def _check_yielding(
        self, dof: int, kind: str, previous: str, lower: tuple[float, str], upper: tuple[float, str]
    ) -> None:
        """Raise if a lower bound exceeds an upper one and ``kind`` does not yield."""
        yields = _ORDER.get(kind, 1) > 1 or (kind, previous) == ("velocity", "acceleration")
        if lower[0] - upper[0] > _ROUNDING and not (yields and kind != previous):
            raise InvalidInput(
                f"limits: joint {self.names[dof]!r} has a lower velocity bound of {lower[0]:.6g} "
                f"({lower[1]}) above its upper bound of {upper[0]:.6g} ({upper[1]}); check the "
                "ranges and limits given."
            )

"""Bounds on single joint velocities, and which of them yields where two contradict each other."""

from __future__ import annotations

import abc
import functools
from collections.abc import Sequence
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
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
        # False for NaN, for a lower bound of +∞ and for an upper bound of −∞.
        consistent = np.maximum(self.lower, -_FINITE) <= np.minimum(self.upper, _FINITE)
        if np.count_nonzero(consistent) < nv:
            (self.lower, below), _ = self._resolved
            self.upper = -below

    @property
    def names(self) -> tuple[str, ...]:
        """Joint name of each degree of freedom."""
        return joint_names(self.model)

    @property
    def lower_kind(self) -> Kinds:
        """Kind of the limit that set each lower bound, (nv,); arbitrary where it is infinite."""
        return np.asarray(self._resolved[1][0])

    @property
    def upper_kind(self) -> Kinds:
        """Kind of the limit that set each upper bound, (nv,)."""
        return np.asarray(self._resolved[1][1])

    @functools.cached_property
    def _resolved(self) -> tuple[Array, Kinds]:
        """Lower bounds and negative upper ones, (2, nv), and the kinds that set them, (2, nv).

        The boxes are taken in turn: each bound ends at the opposite ones of those before it.
        """
        ends = np.full((2, self.model.nv), -np.inf)
        kinds = np.full(ends.shape, "", dtype=object)
        for kind, lower, upper in self._boxes:
            for dof in np.flatnonzero(~((lower < np.inf) & (upper > -np.inf))):
                raise InvalidInput(
                    f"limits: a {kind} limit has bounds of {lower[dof]} and {upper[dof]} for joint "
                    f"{self.names[dof]!r}; expected numbers, or ∞ for none."
                )
            for side, values in enumerate((lower, -upper)):
                most, previous = -ends[1 - side], kinds[1 - side]
                yields = (kind == "velocity") & (previous == "acceleration")
                yields |= (_ORDER.get(kind, 1) > 1) & (previous != kind)
                for dof in np.flatnonzero((values - most > _ROUNDING) & ~yields):
                    two = [(values[dof], kind), (most[dof], previous[dof])]
                    (low, of_low), (high, of_high) = two if side == 0 else reversed(two)
                    sign = 1.0 if side == 0 else -1.0
                    raise InvalidInput(
                        f"limits: joint {self.names[dof]!r} has a lower velocity bound of "
                        f"{sign * low:.6g} ({of_low}) above its upper bound of {sign * high:.6g} "
                        f"({of_high}); check the ranges and limits given."
                    )
                allowed = np.minimum(values, most)
                rises = allowed > ends[side]
                kinds[side] = np.where(rises, np.where(values > most, previous, kind), kinds[side])
                ends[side] = np.where(rises, allowed, ends[side])
        return ends, kinds

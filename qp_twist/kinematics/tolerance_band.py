"""What lies between "must" and "free": a range that a frame has to keep, and no value in it."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, number
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, TwistProjector

HEAVIEST = 1e12
"""Largest weight of a soft band: beyond it the other costs are lost in the arithmetic."""


class FramePair(NamedTuple):
    """A frame and its target, in the world."""

    rotation: Array
    """R of the frame, shape (3, 3)."""
    position: Array
    """Origin of the frame, m, shape (3,)."""
    target_rotation: Array
    """R_d of the target, shape (3, 3)."""
    target_position: Array
    """Origin of the target, m, shape (3,)."""
    target_twist: Array
    """Twist of the target (linear, angular), world axes, m/s and rad/s, shape (6,)."""

    def axes(self, frame: str) -> Array:
        """Rotation to the world of what a band's vectors are fixed to, (3, 3)."""
        if frame == "world":
            return np.eye(3)
        return self.rotation if frame == "body" else self.target_rotation


class BandRows(NamedTuple):
    """What a band asks of a step: G q̇ ≤ g."""

    rows: Array
    """G, shape (k, nv)."""
    bounds: Array
    """g, rad/s or m/s, shape (k,)."""
    label: str
    """E.g. ``"roll band of TwistTask('tool', 'site')"``."""
    weight: float | None
    """``None``: hard. Otherwise ½·weight·ε² is the cost of G q̇ ≤ g + ε, one ε ≥ 0 for them all."""

    @property
    def names(self) -> list[tuple[str, str]]:
        """Name and kind of each row."""
        return [(self.label, "band")] * len(self.bounds)


class ToleranceBand(abc.ABC):
    r"""Base of the bands: a value φ(R, p) of a frame that has to stay in a range.

    A step of length dt from φ, with ∇φ acting on the frame's twist and φ̇_d what the target's own
    motion adds, asks

    .. math::

        \nabla\varphi^T\,\mathbf J\dot{\mathbf q} \le
        \frac{upper - \varphi}{dt} - \dot\varphi_d

    and the same for the lower end. Outside its range the value has to come back at
    ``recovery_speed``, or in one step where that is slower. The range holds after integration to
    second order in the step (:doc:`equations`).

    Attributes:
        kind: ``"roll"``, ``"cone"``, ``"slab"`` or ``"box"``.
        weight: ``None`` for a hard band, else the weight of the soft one.
        recovery_speed: Largest speed of return that is demanded outside, rad/s or m/s.
    """

    kind: str

    def __init__(self, weight: float | None, recovery_speed: float) -> None:
        name = type(self).__name__
        if weight is not None:
            weight = number(f"{name}(weight=…)", weight, above=0.0, at_most=HEAVIEST)
        self.weight = weight
        self.recovery_speed = number(f"{name}(recovery_speed=…)", recovery_speed, above=0.0)

    @abc.abstractmethod
    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """Rows on the frame's twist (linear, angular), world axes, and their bounds.

        Args:
            pair: Where the frame and its target are.
            dt: Length of the step, s.
            projector: T of the task; what it fixes by itself needs no row.

        Returns:
            Rows (k, 6) and bounds (k,), rad/s or m/s; k may be 0.
        """

    @abc.abstractmethod
    def excess(self, pair: FramePair) -> float:
        """How far the frame is outside the band, rad or m; 0 inside."""

    @abc.abstractmethod
    def contradiction(self, projector: TwistProjector) -> str | None:
        """Why a task with this T can never be inside the band, in words; ``None`` if it can."""


class Range(NamedTuple):
    """The range [lower, upper] of one value, and how it is kept."""

    lower: float
    upper: float

    @classmethod
    def checked(cls, name: str, lower: float, upper: float, unit: str) -> Range:
        """The range of a band called ``name``.

        Raises:
            InvalidInput: If an end is not finite, or they are in the wrong order.
        """
        lower, upper = number(f"{name}(lower=…)", lower), number(f"{name}(upper=…)", upper)
        if lower > upper:
            ends = [f"{end:g} {unit}" for end in (lower, upper)]
            if unit == "rad":  # task files give degrees
                ends = [f"{end:g} rad ({math.degrees(end):g}°)" for end in (lower, upper)]
            raise InvalidInput(f"{name}: lower = {ends[0]} is above upper = {ends[1]}.")
        return cls(lower, upper)

    def rooms(self, value: float, reach: float) -> tuple[float, float]:
        """How much the value may fall and rise in a step; negative: how much it has to come back.

        Args:
            value: Where it is, rad or m.
            reach: What recovery may demand in this step, rad or m.
        """
        return value - min(self.lower, value + reach), max(self.upper, value - reach) - value

    def excess(self, value: float) -> float:
        """Distance of a value from the range; 0 inside."""
        return max(self.lower - value, value - self.upper, 0.0)


def two_sided(
    gradient: Array, rooms: tuple[float, float], drift: float, dt: float
) -> tuple[Array, Array]:
    """Rows (2, 6) and bounds (2,) of a value with the given rooms, falling first.

    Args:
        gradient: ∇φ on the twist of the frame, shape (6,).
        rooms: How far it may fall and rise, rad or m.
        drift: φ̇_d, what the target's motion adds to φ̇, rad/s or m/s.
        dt: Length of the step, s.
    """
    fall, rise = rooms
    return np.stack([-gradient, gradient]), np.array([fall / dt + drift, rise / dt - drift])


def keeps(projector: Projector, axis: Array) -> bool:
    """Whether ``axis``, in the projector's own frame, lies in the subspace that it keeps."""
    return bool(np.abs(projector.matrix @ axis - axis).max() < 1e-9)


def check_bands(
    name: str, bands: Sequence[ToleranceBand], projector: TwistProjector
) -> tuple[ToleranceBand, ...]:
    """``bands`` of a task called ``name`` with the given T.

    Raises:
        InvalidInput: If one is no band, or contradicts what T fixes.
    """
    if not isinstance(bands, (list, tuple)):
        raise InvalidInput(f"{name}: bands: expected a list of bands, got {bands!r}.")
    for band in bands:
        if not isinstance(band, ToleranceBand):
            raise InvalidInput(
                f"{name}: bands: expected RollBand, ConeBand, SlabBand or BoxBand, got {band!r}."
            )
        why = band.contradiction(projector)
        if why is not None:
            raise InvalidInput(
                f"{name}: {band!r} contradicts the projector: {why}. Free that direction in the "
                "projector, or widen the band."
            )
    return tuple(bands)

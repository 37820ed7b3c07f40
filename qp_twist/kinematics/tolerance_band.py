"""Tolerance bands: ranges for values of a frame's pose, between fixed and free."""

from __future__ import annotations

import abc
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask, number, one_of
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.kernel.constants import STEEPEST
from qp_twist.kinematics.frame_pair import FramePair, Stretch

HEAVIEST = 1e12
"""Largest weight of a soft band: beyond it the other costs are lost in rounding."""
ELASTIC = "elastic"
"""Kind of the rows of elastic tasks, beside ``"band"``."""
_ROUNDING = 1e-9
"""A direction, or a value, that is fixed differs by less from what T fixes."""


class BandRows(NamedTuple):
    """Rows of a band for a step: G q̇ ≤ g."""

    rows: Array
    """G, shape (k, nv)."""
    bounds: Array
    """g, rad/s or m/s, shape (k,)."""
    label: str
    """Name, e.g. ``"roll band of TwistTask('tool', 'site')"``."""
    weight: float | None
    """``None`` for a hard band. Otherwise G q̇ ≤ g + ε with the cost ½·weight·ε² + price·ε, one
    ε ≥ 0 for all rows."""
    price: float = 0.0
    """Above 0 for a row of an elastic task: a band of no width."""

    @property
    def names(self) -> list[tuple[str, str]]:
        """Name and kind of each row."""
        return [(self.label, ELASTIC if self.price else "band")] * len(self.bounds)

    def slack(self, cost: float) -> tuple[float, float, float]:
        """Of z = ε/unit the quadratic cost, the unit and the linear cost, beside others of a size.

        The unknown is in units that give it a cost of the size of the others, whatever the weight:
        costs of one size are what the optimality of a result can be told by. Where the price is
        high beside them, the cost is larger, so that the linear one stays below ``STEEPEST``.
        """
        weight = self.weight or 1.0
        cost = max(cost, (100.0 * self.price / STEEPEST) ** 2 / weight)
        unit = math.sqrt(cost / weight)
        return cost, unit, self.price * unit


class Range(NamedTuple):
    """The range [lower, upper] of one value."""

    lower: float
    upper: float

    @classmethod
    def checked(cls, name: str, lower: float, upper: float, unit: str) -> Range:
        """The range of a band called ``name``; its ends are finite, and in this order."""
        lower, upper = number(f"{name}(lower=…)", lower), number(f"{name}(upper=…)", upper)
        if lower > upper:
            ends = [f"{end:g} {unit}" for end in (lower, upper)]
            if unit == "rad":  # task files give degrees
                ends = [f"{end:g} rad ({math.degrees(end):g}°)" for end in (lower, upper)]
            raise InvalidInput(f"lower = {ends[0]} is above upper = {ends[1]}.", key=name)
        return cls(lower, upper)


class ToleranceBand(abc.ABC):
    r"""Base of the bands: values φ(R, p) of a frame, each of which has to stay in a range.

    A step of length dt from φ, with ∇φ acting on the frame's twist and φ̇_d due to the target's
    motion, has the rows

    .. math::

        \nabla\varphi^T\,\mathbf J\dot{\mathbf q} \le
        \frac{upper - \varphi}{dt} - \dot\varphi_d

    and the same for the lower end. Outside its range the value has to return at ``recovery_speed``,
    or in one step if that is slower. The range holds after integration to second order in the step
    (:doc:`/equations`).

    All methods but :meth:`half_spaces` take one frame or N at once: shapes are those of one,
    preceded by N for N frames. Methods about the motion between two poses take K motions.

    Attributes:
        kind: ``"roll"``, ``"cone"``, ``"slab"`` or ``"box"``.
        unit: Unit of the values, ``"rad"`` or ``"m"``.
        ranges: The range of each of the k values, rad or m.
        frame: The frame that the band's axis, reference or normal is fixed to: ``"target"``,
            ``"world"`` or ``"body"``.
        weight: ``None`` for a hard band, else the weight of the soft one.
        recovery_speed: Outside the band, the largest required speed of return, rad/s or m/s.
    """

    kind: str
    unit: str
    frames: tuple[str, ...] = ("target", "world", "body")
    ranges: tuple[Range, ...]

    def __init__(self, weight: float | None, recovery_speed: float, frame: str = "target") -> None:
        name = type(self).__name__
        if weight is not None:
            weight = number(f"{name}(weight=…)", weight, above=0.0, at_most=HEAVIEST)
        self.weight = weight
        self.recovery_speed = number(f"{name}(recovery_speed=…)", recovery_speed, above=0.0)
        self.frame = one_of(f"{name}(frame=…)", frame, self.frames)

    @abc.abstractmethod
    def values(self, pair: FramePair) -> Array:
        """φ, rad or m, (k,)."""

    @abc.abstractmethod
    def gradients(self, pair: FramePair) -> Array:
        """∇φ on the frame's twist (linear, angular), world axes, (k, 6); 0 if φ is undefined."""

    @abc.abstractmethod
    def carried(self, pair: FramePair) -> Array:
        """The twist (6,) with which the frame keeps its values while its target moves."""

    @abc.abstractmethod
    def fixed(self, projector: TwistProjector) -> tuple[bool, ...]:
        """Which of the values a task with this T fixes."""

    @abc.abstractmethod
    def span(self, before: FramePair, after: FramePair, stretch: Stretch) -> tuple[Array, Array]:
        """Bounds of each φ from one pose to the next, rad or m, (K, k) each."""

    def contradiction(self, projector: TwistProjector) -> str | None:
        """A sentence if a task with this T can never be inside the band; else ``None``."""
        held = FramePair(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3))
        outside = np.array(self.fixed(projector)) & (self.margins(held) < -_ROUNDING)
        if not outside.any():
            return None
        k = int(outside.argmax())
        value = self.values(held)[k]
        along = f" along {'xyz'[k]}" if len(self.ranges) > 1 else ""
        shown = f"{math.degrees(value):.6g}°" if self.unit == "rad" else f"{value:.6g} m"
        return f"it holds the value{along} at {shown}, outside the range"

    def margins(self, pair: FramePair) -> Array:
        """Distance of each value from the nearer end of its range, rad or m, (k,); ≥ 0 inside."""
        values = self.values(pair)
        return self._room(values, values)

    def least(self, before: FramePair, after: FramePair, stretch: Stretch) -> Array:
        """Lower bound of each margin from one pose to the next, rad or m, (K, k)."""
        return self._room(*self.span(before, after, stretch))

    def may_hold(self, before: FramePair, after: FramePair, stretch: Stretch) -> Mask:
        """Whether each value may be in its range between one pose and the next, (K, k)."""
        return np.asarray(self._room(*self.span(before, after, stretch)[::-1]) >= 0.0)

    def _room(self, lowest: Array, highest: Array) -> Array:
        lower, upper = np.array(self.ranges).T
        return np.asarray(np.minimum(lowest - lower, upper - highest))

    def rows(self, pair: FramePair, reach: float = math.inf) -> tuple[Array, Array]:
        """Linear rows that keep the values in their ranges: rows · displacement ≤ rooms.

        Rows (k, s, 6) on a displacement of the frame (linear, angular), m and rad, and rooms
        (k, s), rad or m: s for each value, ∞ for inactive rows. A value outside its range has to
        return by ``reach``, rad or m, at most.
        """
        lower, upper = np.array(self.ranges).T
        values, gradients = self.values(pair), self.gradients(pair)
        rooms = np.maximum(np.stack([values - lower, upper - values], axis=-1), -reach)
        rooms[~gradients.any(axis=-1)] = math.inf
        return np.stack([-gradients, gradients], axis=-2), rooms

    def half_spaces(
        self, pair: FramePair, dt: float, projector: TwistProjector
    ) -> tuple[Array, Array]:
        """Rows (k, 6) on one frame's twist, world axes, and bounds (k,), rad/s or m/s, in dt s.

        Values that T fixes need no row, so k may be 0.
        """
        free = ~np.array(self.fixed(projector))
        rows, rooms = self.rows(pair, self.recovery_speed * dt)
        rows, rooms = rows[free].reshape(-1, 6), rooms[free].ravel()
        bounded = np.isfinite(rooms)
        rows, rooms = rows[bounded], rooms[bounded]
        return rows, rooms / dt + rows @ self.carried(pair)

    def excess(self, pair: FramePair) -> float:
        """Violation of the band by one frame, rad or m; 0 inside."""
        return max(0.0, -float(self.margins(pair).min()))

    def _named(self, what: str) -> str:
        """For messages: the band with ``what`` it is of, its range and its frame."""
        lower, upper = self.ranges[0]
        ends = f"{lower:.6g}…{upper:.6g} m"
        if self.unit == "rad":
            ends = f"{math.degrees(lower):.6g}°…{math.degrees(upper):.6g}°"
        return f"{type(self).__name__}({what}, {ends}, frame={self.frame!r})"


def largest_excess(bands: Iterable[ToleranceBand], pair: FramePair) -> Array:
    """Largest violation of any of the bands by each of N frames, rad or m, (N,); 0 inside all."""
    excess = np.zeros(len(pair.position))
    for band in bands:
        excess = np.maximum(excess, -band.margins(pair).min(axis=1))
    return excess


def keeps(projector: Projector, axis: Array) -> bool:
    """Whether ``axis``, in the projector's frame, lies in its range."""
    return bool(np.abs(projector.matrix @ axis - axis).max() < _ROUNDING)


def check_bands(
    name: str, bands: Sequence[ToleranceBand], projector: TwistProjector
) -> tuple[ToleranceBand, ...]:
    """The bands of a task of this name; what is none, or contradicts a value of T, is refused."""
    if not isinstance(bands, (list, tuple)):
        raise InvalidInput(f"bands: expected a list of bands, got {bands!r}.", key=name)
    for band in bands:
        if not isinstance(band, ToleranceBand):
            raise InvalidInput(
                f"bands: expected RollBand, ConeBand, SlabBand or BoxBand, got {band!r}.", key=name
            )
        why = band.contradiction(projector)
        if why is not None:
            raise InvalidInput(
                f"{band!r} contradicts the projector: {why}. Free that direction in the "
                "projector, or widen the band.",
                key=name,
            )
    return tuple(bands)

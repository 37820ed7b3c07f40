r"""Geometry of the axes of an arm: what does not depend on its configuration, and what does.

Each axis is an oriented line: a point and the direction of positive rotation. Between two
consecutive axes is their common normal, with the direction :math:`\mathbf x_i = \mathbf z_i \times
\mathbf z_{i+1}` (of parallel axes: from the first to the second). As in Denavit and Hartenberg's
parameters,

* its signed length a, the angle α between the axes about it, and the distance d along an axis
  between the normals to its neighbours do not depend on the configuration;
* the angle θ about an axis between these two normals is the joint's coordinate and a constant.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array

_NEAR = 2e-3
"""Lengths that differ by less count as equal, m: models are rounded or calibrated."""
_NEAR_DEG = 1.0
_PARALLEL = float(np.sin(np.radians(_NEAR_DEG)))
"""Sine of an angle below which axes have no single common normal."""


class Line(NamedTuple):
    """An axis: its direction (3,), unit, and a point on it (3,), m."""

    axis: Array
    point: Array


@dataclass(frozen=True, eq=False)
class AxisGeometry:
    """Invariants of n oriented axes, and the angles of their configuration.

    Attributes:
        lengths: a between consecutive axes, m, (n − 1,).
        twists_deg: α between them, 0° to 180°, (n − 1,).
        offsets: d along each axis but the first and last, m, (n − 2,); ``None`` where parallel
            axes leave it open, and then part of the next one.
        angles: θ about each axis but the first and last, rad, (n − 2,).
    """

    lengths: tuple[float, ...]
    twists_deg: tuple[float, ...]
    offsets: tuple[float | None, ...]
    angles: Array

    def is_like(self, other: AxisGeometry) -> bool:
        """Whether the invariants agree to 2 mm and 1°."""
        if len(self.lengths) != len(other.lengths):
            return False
        mine, others = (*self.lengths, *self.offsets), (*other.lengths, *other.offsets)
        for one, two in zip(mine, others, strict=True):
            if (one is None) != (two is None):
                return False
            if one is not None and two is not None and not abs(one - two) <= _NEAR:
                return False
        twists = zip(self.twists_deg, other.twists_deg, strict=True)
        return all(abs(one - two) <= _NEAR_DEG for one, two in twists)

    def turned(self, signs: Array) -> AxisGeometry:
        """The geometry of the same axes where some count the other way: ``signs`` ±1, (n,).

        A common normal of axes that are not parallel turns with either of its two axes.
        """
        both = signs[:-1] * signs[1:]
        twists = np.where(both > 0.0, self.twists_deg, 180.0 - np.array(self.twists_deg))
        normals = np.where(np.sin(np.radians(self.twists_deg)) < _PARALLEL, 1.0, both)
        offsets = zip(signs[1:-1], self.offsets, strict=True)
        about = normals[:-1] * normals[1:]  # how both normals of an axis turned
        return AxisGeometry(
            tuple((normals * self.lengths).tolist()),
            tuple(twists.tolist()),
            tuple(None if offset is None else float(sign) * offset for sign, offset in offsets),
            np.arctan2(about * signs[1:-1] * np.sin(self.angles), about * np.cos(self.angles)),
        )

    def orientations(self) -> Iterator[tuple[Array, AxisGeometry]]:
        """Every choice of signs, (n,), and the geometry of the axes with it."""
        for signs in itertools.product((1.0, -1.0), repeat=len(self.lengths) + 1):
            yield np.array(signs), self.turned(np.array(signs))


def axis_geometry(lines: Sequence[Line]) -> AxisGeometry:
    """The geometry of oriented axes, from the base on."""
    lengths: list[float] = []
    twists: list[float] = []
    offsets: list[float | None] = []
    normals: list[Array] = []
    at: float | None = None  # foot of the previous common normal, along the axis from its point
    for number, (one, two) in enumerate(itertools.pairwise(lines)):
        apart = two.point - one.point
        normal = np.cross(one.axis, two.axis)
        sine, cosine = float(np.linalg.norm(normal)), float(one.axis @ two.axis)
        twists.append(float(np.degrees(np.arctan2(sine, cosine))))
        if sine < _PARALLEL:
            # Any common normal will do: the one where the previous one ends.
            across = apart - (apart @ one.axis) * one.axis
            length = float(np.linalg.norm(across))
            lengths.append(length)
            normals.append(across / length if length > _NEAR else np.full(3, np.nan))
            if number:
                offsets.append(None)
            level = at if at is not None else 0.0
            foot = one.point + level * one.axis
            at = None if at is None else float((foot - two.point) @ two.axis)
            continue
        lengths.append(float(apart @ normal) / sine)
        normals.append(normal / sine)
        # From both points to the common normal: one.axis s − two.axis t + normal u = apart.
        s, t, _ = np.linalg.solve(np.array([one.axis, -two.axis, normal]).T, apart)
        if number:
            offsets.append(None if at is None else float(s) - at)
        at = float(t)
    angles = [
        np.arctan2(np.cross(before, after) @ line.axis, before @ after)
        for line, (before, after) in zip(lines[1:-1], itertools.pairwise(normals), strict=True)
    ]
    return AxisGeometry(tuple(lengths), tuple(twists), tuple(offsets), np.array(angles))

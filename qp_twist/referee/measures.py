"""Measures of a motion: their values at poses, and bounds between poses.

Each measure has nonnegative values at many instants, and bounds for the motion of joints, frame and
target from one instant to the next. So constraints can be proven between waypoints.
"""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import Constraint
from qp_twist.geometry import ProjectorKind, TwistProjector, resolved_twist_error
from qp_twist.kinematics import FramePair, Stretch, ToleranceBand, angle_of_chord, turn_about


class Poses(NamedTuple):
    """A motion at K instants."""

    q: Array
    """The joints, rad or m, (K, nv)."""
    pair: FramePair
    """The frame and its target."""


class Passage(NamedTuple):
    """The motion from one instant to the next, K times."""

    stretch: Stretch
    """Bounds for the motion of frame and target."""
    travel: Array
    """Bound of each joint's first derivative, with s from 0 to 1, rad or m, (K, nv)."""
    curve: Array
    """Bound of its second derivative, likewise."""


class Measure(abc.ABC):
    """Quantities to be bounded.

    Attributes:
        unit: ``"m"`` or ``"rad"``.
        width: Number of quantities.
    """

    unit: str
    width = 1

    @abc.abstractmethod
    def at(self, poses: Poses) -> Array:
        """Their values at each pose, at least 0, (K, width)."""

    @abc.abstractmethod
    def most(self, before: Poses, after: Poses, passage: Passage) -> Array:
        """Upper bounds from each pose to the next, (K, width)."""


class PositionError(Measure):
    r"""Length of the linear task error ‖M_v (p_d − p)‖, m."""

    unit = "m"

    def __init__(self, projector: TwistProjector) -> None:
        self.projector = projector
        # A rotation of the rows has no effect on full or empty rows.
        kind = projector.linear.kind
        whole = kind in (ProjectorKind.FULL, ProjectorKind.NONE)
        self._frame = "world" if whole else projector.frame

    def at(self, poses: Poses) -> Array:
        """‖M_v (p_d − p)‖, m, (K, 1)."""
        pair = poses.pair
        apart = (pair.target_position - pair.position)[:, None]
        seen = apart @ pair.axes(self._frame) @ self.projector.linear.basis
        norm: Array = np.linalg.norm(seen, axis=2)
        return norm

    def most(self, before: Poses, after: Poses, passage: Passage) -> Array:
        """The larger end plus the error's deviation from its chord."""
        if self.projector.linear.kind is ProjectorKind.NONE:
            return np.zeros((len(before.q), 1))
        ends, stretch = (before.pair, after.pair), passage.stretch
        away = stretch.off_chord(*ends, self._frame)
        if self._frame == "target":
            away = away + stretch.slipped(*ends, self._frame)
        return np.maximum(self.at(before), self.at(after)) + away[:, None]


class AxisError(Measure):
    r"""Length of the angular task error, rad.

    The whole error and the swing are angles θ between a frame and its target, or an axis of each.
    Their chord 2 sin(θ/2) is the length of a vector.
    """

    unit = "rad"

    def __init__(self, projector: TwistProjector) -> None:
        self.projector = projector

    def at(self, poses: Poses) -> Array:
        """The length, rad, (K, 1)."""
        if not self.projector.angular.rank:
            return np.zeros((len(poses.q), 1))
        error = resolved_twist_error(*poses.pair[:4], self.projector)[1]
        norm: Array = np.linalg.norm(error[:, 3:], axis=1, keepdims=True)
        return norm

    def most(self, before: Poses, after: Poses, passage: Passage) -> Array:
        """The larger end plus the error's deviation from its chord."""
        if not self.projector.angular.rank:
            return np.zeros((len(before.q), 1))
        if self.projector.angular.kind is ProjectorKind.LINE:
            axis, frame, poses = self.projector.angular.axis, self.projector.frame, before.pair
            assert axis is not None
            begin, end, away = turn_about(axis, frame, poses, after.pair, passage.stretch)
            return np.minimum(np.maximum(np.abs(begin), np.abs(end)) + away, np.pi)[:, None]
        ends = np.maximum(self.at(before), self.at(after))
        off = passage.stretch.off_chord_of_angle(target=True)
        return angle_of_chord(2.0 * np.sin(0.5 * ends) + off[:, None])


class BandExcess(Measure):
    """Violation of a band, rad or m."""

    def __init__(self, band: ToleranceBand) -> None:
        self.band, self.unit, self.width = band, band.unit, len(band.ranges)

    def at(self, poses: Poses) -> Array:
        """Violations of the margins, 0 inside."""
        return np.maximum(-self.band.margins(poses.pair), 0.0)

    def most(self, before: Poses, after: Poses, passage: Passage) -> Array:
        """Violations of the lower bounds of the margins, 0 inside."""
        least = self.band.least(before.pair, after.pair, passage.stretch)
        return np.maximum(-least, 0.0)


class ConstraintExcess(Measure):
    """Violation of a constraint, rad or m."""

    def __init__(self, constraint: Constraint) -> None:
        self.constraint = constraint
        self.unit, self.width = constraint.units[0], len(constraint.names)

    def at(self, poses: Poses) -> Array:
        """Violations of the margins, 0 inside."""
        return np.maximum(-self.constraint.bounded(poses.q, 0.0), 0.0)

    def most(self, before: Poses, after: Poses, passage: Passage) -> Array:
        """Violations of the lower bounds of the margins, 0 inside."""
        least = self.constraint.least(before.q, after.q, passage.travel, passage.curve)
        return np.maximum(-least, 0.0)

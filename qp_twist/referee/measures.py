"""Measures of a motion: their values at poses, and bounds between poses.

Each has nonnegative values at many instants, and bounds for the motion of joints, frame and target
from one instant to the next. So constraints can be proven between waypoints.
"""

from __future__ import annotations

from collections.abc import Callable
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


class Measure(NamedTuple):
    """Quantities to be bounded."""

    unit: str
    """``"m"`` or ``"rad"``."""
    width: int
    """Their number."""
    at: Callable[[Poses], Array]
    """Their values at each pose, at least 0, (K, width)."""
    most: Callable[[Poses, Poses, Passage], Array]
    """Upper bounds from each pose to the next, (K, width)."""


def position_error(projector: TwistProjector) -> Measure:
    """Length of the linear task error ‖M_v (p_d − p)‖, m."""
    kind, basis = projector.linear.kind, projector.linear.basis
    # A rotation of the rows has no effect on full or empty rows.
    whole = kind in (ProjectorKind.FULL, ProjectorKind.NONE)
    frame = "world" if whole else projector.frame

    def at(poses: Poses) -> Array:
        pair = poses.pair
        apart = (pair.target_position - pair.position)[:, None]
        return np.asarray(np.linalg.norm(apart @ pair.axes(frame) @ basis, axis=2))

    def most(before: Poses, after: Poses, passage: Passage) -> Array:
        if kind is ProjectorKind.NONE:
            return np.zeros((len(before.q), 1))
        ends, stretch = (before.pair, after.pair), passage.stretch
        away = stretch.off_chord(*ends, frame)
        if frame == "target":
            away = away + stretch.slipped(*ends, frame)
        return np.maximum(at(before), at(after)) + away[:, None]

    return Measure("m", 1, at, most)


def axis_error(projector: TwistProjector) -> Measure:
    """Length of the angular task error, rad.

    The whole error and the swing are angles θ between a frame and its target, or an axis of each.
    Their chord 2 sin(θ/2) is the length of a vector.
    """
    angular = projector.angular

    def at(poses: Poses) -> Array:
        if not angular.rank:
            return np.zeros((len(poses.q), 1))
        error = resolved_twist_error(*poses.pair[:4], projector)[1]
        return np.asarray(np.linalg.norm(error[:, 3:], axis=1, keepdims=True))

    def most(before: Poses, after: Poses, passage: Passage) -> Array:
        if not angular.rank:
            return np.zeros((len(before.q), 1))
        if angular.kind is ProjectorKind.LINE:
            assert angular.axis is not None
            ends = before.pair, after.pair
            turned = turn_about(angular.axis, projector.frame, *ends, passage.stretch)
            begin, end, away = turned
            return np.minimum(np.maximum(np.abs(begin), np.abs(end)) + away, np.pi)[:, None]
        largest = np.maximum(at(before), at(after))
        off = passage.stretch.off_chord_of_angle(target=True)
        return angle_of_chord(2.0 * np.sin(0.5 * largest) + off[:, None])

    return Measure("rad", 1, at, most)


def band_excess(band: ToleranceBand) -> Measure:
    """Violation of a band, rad or m; 0 inside."""

    def most(before: Poses, after: Poses, passage: Passage) -> Array:
        return np.maximum(-band.least(before.pair, after.pair, passage.stretch), 0.0)

    def at(poses: Poses) -> Array:
        return np.maximum(-band.margins(poses.pair), 0.0)

    return Measure(band.unit, len(band.ranges), at, most)


def constraint_excess(constraint: Constraint) -> Measure:
    """Violation of a constraint, rad or m; 0 inside."""

    def at(poses: Poses) -> Array:
        return np.maximum(-constraint.bounded(poses.q, 0.0), 0.0)

    def most(before: Poses, after: Poses, passage: Passage) -> Array:
        least = constraint.least(before.q, after.q, passage.travel, passage.curve)
        return np.maximum(-least, 0.0)

    return Measure(constraint.units[0], len(constraint.names), at, most)

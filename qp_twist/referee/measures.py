"""What a frame has to keep at and between the waypoints: its size at poses, and a bound between.

Each measure states its value for many poses at once, 0 or more, and how large it can become while
frame and target move from one pose to the next. So "kept between two waypoints" can be proven.
"""

from __future__ import annotations

import abc
import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import ProjectorKind, TwistProjector, many_twist_errors
from qp_twist.kinematics import BoxBand, ConeBand, RollBand, SlabBand, ToleranceBand


class Poses(NamedTuple):
    """A frame and its target, K times."""

    rotation: Array
    """R of the frame, (K, 3, 3)."""
    position: Array
    """Its origin, m, (K, 3)."""
    target_rotation: Array
    """R_d, (K, 3, 3)."""
    target_position: Array
    """p_d, m, (K, 3)."""


class Stretches(NamedTuple):
    r"""Bounds of what happens from one pose to the next, s going from 0 to 1; (K,) each.

    The target moves on a straight line and turns about a fixed axis, both evenly. That target may
    be another point of the path than the one that a pose is measured against: by so much the
    measure may differ.
    """

    turn: Array
    """‖ω‖ of the frame, rad."""
    turn_change: Array
    """Σ|q̈| of the hinges, rad."""
    bend: Array
    """‖p″‖, m."""
    target_turn: Array
    """‖ω_d‖, rad."""
    slip: Array
    """Distance to the target that a pose is measured against, m."""
    slip_turn: Array
    """The same in its orientation, rad."""

    @property
    def curl(self) -> Array:
        """Bound of the second derivative of a unit vector that turns with the frame, rad."""
        return self.turn**2 + self.turn_change


class Measure(abc.ABC):
    """One quantity that has to stay small.

    Attributes:
        unit: ``"m"`` or ``"rad"``.
    """

    unit: str

    @abc.abstractmethod
    def at(self, poses: Poses) -> Array:
        """Its value at each pose, at least 0, (K,)."""

    @abc.abstractmethod
    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """What it cannot exceed on the way from each pose to the next, (K,)."""


class PositionError(Measure):
    r"""Length of the linear task error ‖M_v (p_d − p)‖, m."""

    unit = "m"

    def __init__(self, projector: TwistProjector) -> None:
        self.projector = projector
        # Turning the rows changes nothing where they are all of them, or none.
        kind = projector.linear.kind
        whole = kind in (ProjectorKind.FULL, ProjectorKind.NONE)
        self._frame = "world" if whole else projector.frame
        self._slips = not whole and projector.frame == "target"

    def at(self, poses: Poses) -> Array:
        """‖M_v (p_d − p)‖, m, (K,)."""
        R, p, R_d, p_d = poses
        basis = self.projector.linear.basis
        seen = np.einsum("kji,kj->ki", _axes(self._frame, R, R_d), p_d - p) @ basis
        norm: Array = np.linalg.norm(seen, axis=1)
        return norm

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """The larger end and what the curve of the error is away from its chord."""
        if self.projector.linear.kind is ProjectorKind.NONE:
            return np.zeros(len(stretch.turn))
        ends = np.maximum(self.at(before), self.at(after))
        bound = ends + _distance_from_chord(self._frame, before, after, stretch)
        if self._slips:
            bound = bound + stretch.slip + _apart(before, after, stretch)[0] * stretch.slip_turn
        return bound


class AxisError(Measure):
    r"""Length of the angular task error, rad.

    The whole error and the swing are angles θ between a frame and its target, or an axis of each.
    Their chord 2 sin(θ/2) is the length of a vector.
    """

    unit = "rad"

    def __init__(self, projector: TwistProjector) -> None:
        self.projector = projector
        self._twist = None
        if projector.angular.kind is ProjectorKind.LINE:
            assert projector.angular.axis is not None
            self._twist = _Twist(projector.angular.axis, projector.frame)

    def at(self, poses: Poses) -> Array:
        """The length, rad, (K,)."""
        R, p, R_d, p_d = poses
        if not self.projector.angular.rank:
            return np.zeros(len(p))
        error = many_twist_errors(R, p, R_d, p_d, self.projector)[1]
        norm: Array = np.linalg.norm(error[:, 3:], axis=1)
        return norm

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """The larger end and what the error is away from its chord."""
        if not self.projector.angular.rank:
            return np.zeros(len(stretch.turn))
        if self._twist is not None:
            begin, end, margin = self._twist.between(before, after, stretch)
            return np.minimum(np.maximum(np.abs(begin), np.abs(end)) + margin, np.pi)
        ends = np.maximum(self.at(before), self.at(after))
        return _angle(2.0 * np.sin(0.5 * ends) + _apart_in_angle(stretch, targets=True))


class RollExcess(Measure):
    """How far the roll is outside a :class:`~qp_twist.RollBand`, rad."""

    unit = "rad"

    def __init__(self, band: RollBand) -> None:
        self.range = band.range
        self._middle = 0.5 * (band.range.lower + band.range.upper)
        self._twist = _Twist(band.axis, band.frame)

    def at(self, poses: Poses) -> Array:
        """The excess, rad, (K,)."""
        roll = self._twist.angles(poses)
        return np.maximum(_beyond(self._middle + _folded(roll - self._middle), *self.range), 0.0)

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """The larger end and what the roll is away from its chord; half a turn at most."""
        begin, end, margin = self._twist.between(before, after, stretch)
        shift = self._middle + _folded(begin - self._middle) - begin
        ends = [_beyond(roll + shift, *self.range) for roll in (begin, end)]
        farthest = np.pi - 0.5 * (self.range.upper - self.range.lower)
        return np.clip(np.maximum(*ends) + margin, 0.0, farthest)


class ConeExcess(Measure):
    """How far an angle is outside a :class:`~qp_twist.ConeBand`, rad.

    With unit vectors u and n at the angle θ, ‖u − n‖ = 2 sin(θ/2) bounds it from above, and
    ‖u + n‖ = 2 cos(θ/2) from below.
    """

    unit = "rad"

    def __init__(self, band: ConeBand) -> None:
        self.band = band

    def at(self, poses: Poses) -> Array:
        """The excess, rad, (K,)."""
        u, n = self._directions(poses)
        less, more = np.linalg.norm(u - n, axis=1), np.linalg.norm(u + n, axis=1)
        return np.maximum(_beyond(2.0 * np.arctan2(less, more), *self.band.range), 0.0)

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """The bounds of both chords."""
        lower, upper = self.band.range
        (u, n), (u_1, n_1) = self._directions(before), self._directions(after)
        away = _apart_in_angle(stretch, targets=self.band.frame == "target")
        excess = np.zeros(len(u))
        if upper < math.pi:
            chord = np.maximum(np.linalg.norm(u - n, axis=1), np.linalg.norm(u_1 - n_1, axis=1))
            excess = np.maximum(excess, _angle(chord + away) - upper)
        if lower > 0.0:
            chord = np.maximum(np.linalg.norm(u + n, axis=1), np.linalg.norm(u_1 + n_1, axis=1))
            excess = np.maximum(excess, lower - (np.pi - _angle(chord + away)))
        return excess

    def _directions(self, poses: Poses) -> tuple[Array, Array]:
        turned = _axes(self.band.frame, poses.rotation, poses.target_rotation)
        return poses.rotation @ self.band.axis, turned @ self.band.reference


class SlabExcess(Measure):
    """How far a distance is outside a :class:`~qp_twist.SlabBand`, m."""

    unit = "m"

    def __init__(self, band: SlabBand) -> None:
        self.band = band

    def at(self, poses: Poses) -> Array:
        """The excess, m, (K,)."""
        return np.maximum(self._beyond(poses), 0.0)

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """The larger end and what the distance is away from its chord."""
        bound = np.maximum(self._beyond(before), self._beyond(after)) + stretch.slip
        if self.band.frame == "target":
            bound = bound + _apart(before, after, stretch)[0] * stretch.slip_turn
        away = _distance_from_chord(self.band.frame, before, after, stretch)
        return np.maximum(bound + away, 0.0)

    def _beyond(self, poses: Poses) -> Array:
        """How far beyond the nearer end of the range, m, (K,); negative inside."""
        R, p, R_d, p_d = poses
        normals = _axes(self.band.frame, R, R_d) @ self.band.normal
        return _beyond(np.einsum("ki,ki->k", normals, p - p_d), *self.band.range)


class BoxExcess(Measure):
    """How far the position is outside a :class:`~qp_twist.BoxBand` along its worst axis, m."""

    unit = "m"

    def __init__(self, band: BoxBand) -> None:
        self._slabs = [SlabExcess(slab) for slab in band.slabs]

    def at(self, poses: Poses) -> Array:
        """The largest of the three slabs', m, (K,)."""
        return _largest([slab.at(poses) for slab in self._slabs])

    def most(self, before: Poses, after: Poses, stretch: Stretches) -> Array:
        """Likewise."""
        return _largest([slab.most(before, after, stretch) for slab in self._slabs])


def band_measure(band: ToleranceBand) -> Measure:
    """The measure of a band.

    Raises:
        InvalidInput: If it is of a kind that nothing here can prove.
    """
    match band:
        case RollBand():
            return RollExcess(band)
        case ConeBand():
            return ConeExcess(band)
        case SlabBand():
            return SlabExcess(band)
        case BoxBand():
            return BoxExcess(band)
    raise InvalidInput(
        f"bands: {band!r} cannot be checked along a path; expected a RollBand, ConeBand, SlabBand "
        "or BoxBand."
    )


class _Twist:
    """The angle φ by which a frame is turned about an axis a relative to its target.

    With the quaternion (η, ε) of the relative rotation φ/2 is the direction of (η, a·ε) in the
    plane. That vector stays near its chord; φ is bounded while the chord keeps away from 0.
    """

    def __init__(self, axis: Array, frame: str) -> None:
        self.axis, self.frame = axis, frame

    def angles(self, poses: Poses) -> Array:
        """φ in (−π, π], rad, (K,); 0 where it is undefined."""
        eta, s = self._vector(self._quaternion(poses)).T
        defined = np.hypot(eta, s) >= 1e-12
        return _folded(np.where(defined, 2.0 * np.arctan2(s, eta), 0.0))

    def between(
        self, before: Poses, after: Poses, stretch: Stretches
    ) -> tuple[Array, Array, Array]:
        """φ at both ends, without a jump between them, and how far it may be beyond them, rad."""
        one, two = self._quaternion(before), self._quaternion(after)
        two = np.where(np.einsum("ki,ki->k", one, two) < 0.0, -1.0, 1.0)[:, None] * two
        a, b = self._vector(one), self._vector(two)
        turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.einsum("ki,ki->k", a, b))
        begin = _folded(2.0 * np.arctan2(a[:, 1], a[:, 0]))
        total = stretch.turn + stretch.target_turn
        away = (0.25 * total**2 + 0.5 * stretch.turn_change) / 8.0 + 0.5 * stretch.slip_turn
        near = _nearest_to_zero(a, b)
        # Up to half a turn in all the quaternion at the end is the one that the motion leads to.
        held = (total < np.pi) & (away < near)
        sine = np.divide(away, near, out=np.ones_like(away), where=held)
        return begin, begin + 2.0 * turn, np.where(held, 2.0 * np.arcsin(sine), np.inf)

    def _quaternion(self, poses: Poses) -> Array:
        R, _, R_d, _ = poses
        inverse = R_d.transpose(0, 2, 1)
        relative = R @ inverse if self.frame == "world" else inverse @ R
        quaternion: Array = Rotation.from_matrix(relative).as_quat()
        return quaternion

    def _vector(self, quaternion: Array) -> Array:
        return np.column_stack([quaternion[:, 3], quaternion[:, :3] @ self.axis])


def _axes(frame: str, R: Array, R_d: Array) -> Array:
    """Rotations to the world of what vectors are fixed to, (K, 3, 3)."""
    if frame == "world":
        return np.broadcast_to(np.eye(3), R.shape)
    return R if frame == "body" else R_d


def _apart(before: Poses, after: Poses, stretch: Stretches) -> tuple[Array, Array]:
    """Bounds of ‖p_d − p‖ and of its first derivative, m, (K,) each."""
    ends = [pose.target_position - pose.position for pose in (before, after)]
    largest = np.maximum(*(np.linalg.norm(end, axis=1) for end in ends))
    change = np.linalg.norm(ends[1] - ends[0], axis=1)
    return largest + stretch.bend / 8.0, change + stretch.bend / 2.0


def _distance_from_chord(frame: str, before: Poses, after: Poses, stretch: Stretches) -> Array:
    """How far p_d − p, in the axes of a frame, is away from its chord, m, (K,)."""
    second = stretch.bend
    if frame != "world":
        apart, change = _apart(before, after, stretch)
        body = frame == "body"
        turn = stretch.turn if body else stretch.target_turn
        curl = stretch.curl if body else stretch.target_turn**2
        second = second + curl * apart + 2.0 * turn * change
    return second / 8.0


def _apart_in_angle(stretch: Stretches, *, targets: bool) -> Array:
    """How far a unit vector of the frame less one of the target is away from its chord, (K,)."""
    if not targets:
        return stretch.curl / 8.0
    return (stretch.curl + stretch.target_turn**2) / 8.0 + stretch.slip_turn


def _angle(chord: Array) -> Array:
    """The angle with a chord on the unit circle, rad."""
    angle: Array = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    return angle


def _beyond(values: Array, lower: float, upper: float) -> Array:
    """How far values are beyond the nearer end of a range; negative inside."""
    beyond: Array = np.maximum(lower - values, values - upper)
    return beyond


def _folded(angles: Array) -> Array:
    """Angles in [−π, π], rad."""
    folded: Array = angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi))
    return folded


def _nearest_to_zero(a: Array, b: Array) -> Array:
    """Least length on the chord from each a (K, 2) to b (K, 2)."""
    way = b - a
    square = np.einsum("ki,ki->k", way, way)
    along = -np.einsum("ki,ki->k", a, way)
    share = np.clip(along / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    least: Array = np.linalg.norm(a + share[:, None] * way, axis=1)
    return least


def _largest(values: list[Array]) -> Array:
    largest: Array = np.max(values, axis=0)
    return largest

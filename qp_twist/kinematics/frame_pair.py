"""A frame and its target, and bounds for the motion of both from one pose to the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, read_only

_WORLD = read_only(np.eye(3))
_REST = read_only(np.zeros(6))


class FramePair(NamedTuple):
    """A frame and its target, in the world; or N of them, with N before every shape."""

    rotation: Array
    """R of the frame, shape (3, 3)."""
    position: Array
    """Origin of the frame, m, shape (3,)."""
    target_rotation: Array
    """R_d of the target, shape (3, 3)."""
    target_position: Array
    """Origin of the target, m, shape (3,)."""
    target_twist: Array = _REST
    """Twist of the target (linear, angular), world axes, m/s and rad/s, shape (6,)."""

    def axes(self, frame: str) -> Array:
        """Rotation to the world of the frame that a band's vectors are fixed to, (3, 3)."""
        if frame == "world":
            return _WORLD
        return self.rotation if frame == "body" else self.target_rotation

    @property
    def error(self) -> Array:
        """E = R R_dᵀ, (3, 3)."""
        return self.rotation @ self.target_rotation.swapaxes(-1, -2)


class Stretch(NamedTuple):
    r"""Bounds of the motion from one pose to the next, with s from 0 to 1; (K,) each.

    The target moves on a straight line and rotates about a fixed axis, both at constant speed. It
    may differ from the target that a pose is measured against, by bounded distances. A vector x(s)
    differs from the chord between its ends by at most max‖x″‖/8.
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
    """Bound of the distance to the target that a pose is measured against, m."""
    slip_turn: Array
    """The same for its orientation, rad."""

    @property
    def curl(self) -> Array:
        """Bound of the second derivative of a unit vector that turns with the frame, rad."""
        return self.turn**2 + self.turn_change

    def apart(self, before: FramePair, after: FramePair) -> tuple[Array, Array]:
        """Bounds of ‖p_d − p‖ and of its first derivative, m, (K,) each."""
        ends = [pair.target_position - pair.position for pair in (before, after)]
        largest = np.maximum(*(np.linalg.norm(end, axis=1) for end in ends))
        change = np.linalg.norm(ends[1] - ends[0], axis=1)
        return largest + self.bend / 8.0, change + self.bend / 2.0

    def off_chord(self, before: FramePair, after: FramePair, frame: str) -> Array:
        """Bound of the deviation of p_d − p, in the axes of a frame, from its chord, m, (K,)."""
        second = self.bend
        if frame != "world":
            apart, change = self.apart(before, after)
            body = frame == "body"
            turn = self.turn if body else self.target_turn
            curl = self.curl if body else self.target_turn**2
            second = second + curl * apart + 2.0 * turn * change
        return second / 8.0

    def slipped(self, before: FramePair, after: FramePair, frame: str) -> Array:
        """Bound of the change of p_d − p by another target, in the axes of a frame, m, (K,)."""
        if frame != "target":
            return self.slip
        return self.slip + self.apart(before, after)[0] * self.slip_turn

    def off_chord_of_angle(self, *, target: bool) -> Array:
        """Bound for a unit vector of the frame minus one of the target or world, (K,)."""
        if not target:
            return self.curl / 8.0
        return (self.curl + self.target_turn**2) / 8.0 + self.slip_turn


def turn_about(
    axis: Array, frame: str, before: FramePair, after: FramePair, stretch: Stretch
) -> tuple[Array, Array, Array]:
    """The angle φ of a frame's rotation about an axis relative to its target, on K motions.

    With the quaternion (η, ε) of the relative rotation φ/2 is the argument of η + i a·ε. That
    number stays near its chord; φ is bounded while the chord keeps away from 0.
    Returned are φ at both ends, continuous between them, and the bound of its deviation, rad, (K,).
    """
    from scipy.spatial.transform import Rotation  # imported on demand: 0.1 s

    one, two = (
        Rotation.from_matrix(
            pair.error if frame == "world" else pair.target_rotation.swapaxes(1, 2) @ pair.rotation
        ).as_quat()
        for pair in (before, after)
    )
    two[(one * two).sum(axis=1) < 0.0] *= -1.0
    a, b = (q[:, 3] + 1j * (q[:, :3] @ axis) for q in (one, two))
    turn, begin = np.angle(a.conj() * b), 2.0 * np.angle(a)
    total = stretch.turn + stretch.target_turn
    away = (0.25 * total**2 + 0.5 * stretch.turn_change) / 8.0 + 0.5 * stretch.slip_turn
    # The least absolute value on the chord from a to b.
    along, square = -(a.conj() * (b - a)).real, np.abs(b - a) ** 2
    share = np.clip(along / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    near = np.abs(a + share * (b - a))
    # Up to half a turn in total, the quaternion at the end is the one that the motion reaches.
    held = (total < np.pi) & (away < near)
    sine = np.divide(away, near, out=np.ones_like(away), where=held)
    begin = begin - 2.0 * np.pi * np.round(begin / (2.0 * np.pi))
    return begin, begin + 2.0 * turn, np.where(held, 2.0 * np.arcsin(sine), np.inf)


def angle_of_chord(chord: Array) -> Array:
    """The angle with a chord on the unit circle, rad."""
    return 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))

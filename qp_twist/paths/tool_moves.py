"""Moves of the tool as controllers interpolate them, straight or on a circle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import rotate, rotation_matrix, rotation_vector
from qp_twist.paths.arcs import LARGEST_TURN, Arc
from qp_twist.programs import Turning
from qp_twist.robots.tool_chain import Poses

_SAME_TURN = float(np.radians(1e-3))
"""A turn up to which the tool does not turn, rad: that of printed digits."""


class ToolMove(NamedTuple):
    r"""A move from one pose to another, on which the share λ of the way is that of the turn.

    .. math:: \mathbf R(\lambda) = \exp(\lambda\, \boldsymbol\Omega)\, \mathbf R_0
        \exp(\lambda\, \mathbf d), \qquad
        \mathbf d = \log(\mathbf R_0^T \exp(-\boldsymbol\Omega)\, \mathbf R_1)

    Straight, and on a circle by the rule ``"space"``, Ω = 0. By ``"path"`` Ω is the turn of the
    circle's tangent, so that the tool turns in proportion as seen from the tangent. A point of the
    tool is on the line or circle, and the frame wherever that has it.

    Attributes:
        rotation: R₀, (3, 3).
        start: Of the point, m, (3,).
        end: Of the point, m, (3,).
        d: rad, (3,).
        omega: Ω, rad, (3,).
        arc: ``None``: straight.
        arm: The point in the frame, m, (3,).
    """

    rotation: Array
    start: Array
    end: Array
    d: Array
    omega: Array
    arc: Arc | None
    arm: Array

    @classmethod
    def between(cls, begin: Poses, end: Poses, arm: Array | None = None) -> ToolMove:
        """The straight move of a point ``arm``, (3,), m, of a frame from one pose to another."""
        return cls.of(begin, end, None, arm=arm)

    @classmethod
    def circular(
        cls, begin: Poses, via: Array, end: Poses, rule: Turning, arm: Array | None = None,
        sweep: float | None = None,
    ) -> ToolMove:  # fmt: skip
        """The circular move of a point ``arm`` of a frame, through a position ``via`` (3,), m.

        By the rule ``"tangent"`` the turn at the end is that of the tangent. With ``sweep``, rad,
        the point goes on as far as that, below 0 the other way round.

        Raises:
            InvalidInput: If the points are on a line or the same, or how the tool turns is open.
        """
        move = cls.of(begin, end, None, arm=arm)
        arc = Arc.through(move.start, via, move.end)
        if arc is None:
            raise InvalidInput("the three points of the circle are on a line.")
        found = cls.of(begin, end, arc, rule, arm)
        if sweep is None:
            return found
        if np.linalg.norm(found.d) > _SAME_TURN:
            raise InvalidInput(
                "the tool turns on the circle, and goes farther than its end or less far (CA): "
                "whether it turns in proportion is not known here. Write the end itself."
            )
        if not 0.0 < abs(sweep) <= np.radians(LARGEST_TURN):
            raise InvalidInput(f"a circle by {np.degrees(sweep):g} degrees.")
        share = sweep / arc.sweep
        arc = arc._replace(sweep=abs(sweep), axis=np.sign(sweep) * arc.axis)
        return found._replace(arc=arc, d=share * found.d, omega=share * found.omega)

    @classmethod
    def of(
        cls, begin: Poses, end: Poses, arc: Arc | None, rule: Turning = "space",
        arm: Array | None = None,
    ) -> ToolMove:  # fmt: skip
        """The move of a point of a frame along an arc, or straight."""
        arm = np.zeros(3) if arm is None else arm
        (R0, p0), (R1, p1) = begin, end
        omega = np.zeros(3)
        if arc is not None and rule != "space":
            omega = arc.sweep * arc.axis
        turned = rotation_matrix(omega) @ R0
        d = np.zeros(3) if rule == "tangent" else rotation_vector(turned.T @ R1)
        return cls(R0, p0 + R0 @ arm, p1 + R1 @ arm, d, omega, arc, arm)

    def at(self, shares: Array) -> Poses:
        """Poses of the frame at shares λ (K,)."""
        lead, turn = (rotation_matrix(shares[:, None] * each) for each in (self.omega, self.d))
        R = lead @ self.rotation @ turn
        if self.arc is None:
            p = self.start + shares[:, None] * (self.end - self.start)
        else:
            angles = shares[:, None] * self.arc.sweep * self.arc.axis
            away = self.start - self.arc.centre
            p = self.arc.centre + rotate(rotation_matrix(angles), away)
        return Poses(R, p - R @ self.arm)

    @property
    def length(self) -> float:
        """Of the way of the point, m."""
        if self.arc is None:
            return float(np.linalg.norm(self.end - self.start))
        return float(self.arc.sweep * np.linalg.norm(self.start - self.arc.centre))

    @property
    def turn(self) -> float:
        """How far the tool turns, rad: in proportion, since Ω seen from the tool turns about d."""
        return float(np.linalg.norm(self.turns()[0]))

    def tangents(self) -> Array:
        """Unit vectors of the point's way at both ends, (2, 3); 0 where it has no length."""
        if self.arc is None:
            way = self.end - self.start
            unit = way / max(float(np.linalg.norm(way)), 1e-12)
            return np.array([unit, unit])
        away = self.start - self.arc.centre
        unit = np.cross(self.arc.axis, away) / np.linalg.norm(away)
        turned = rotation_matrix(self.arc.sweep * self.arc.axis) @ unit
        return np.array([unit, turned])

    def turns(self) -> Array:
        """Turns per share at both ends in the tool's axes, rad, (2, 3)."""
        end = self.at(np.ones(1)).rotations[0]
        return np.array([self.rotation.T @ self.omega + self.d, end.T @ self.omega + self.d])

    def share(self, positions: Array) -> Array:
        """Shares λ (K,) of the point's way beside positions of the point (K, 3)."""
        if self.arc is None:
            way = self.end - self.start
            return (positions - self.start) @ way / float(way @ way)
        away, side = self.start - self.arc.centre, self.tangents()[0]
        out = positions - self.arc.centre
        # From half a turn before the middle of the arc to half a turn behind it.
        angles = np.arctan2(out @ side, out @ away / float(np.linalg.norm(away)))
        middle = 0.5 * self.arc.sweep
        near = np.mod(angles - middle + np.pi, 2.0 * np.pi) - np.pi + middle
        return np.asarray(near / self.arc.sweep)

    def off_turn(self, position: Array, rotation: Array) -> float:
        """How far the tool is turned, rad, from where the move has it beside a position."""
        turned = self.at(self.share(position[None])).rotations[0]
        return float(np.linalg.norm(rotation_vector(turned.T @ rotation)))

    def bends(self) -> Array:
        """Curvatures of the point's way at both ends, 1/m, towards the circle's centre, (2, 3)."""
        if self.arc is None:
            return np.zeros((2, 3))
        away = np.array([self.start, self.at(np.ones(1)).positions[0]]) - self.arc.centre
        return np.asarray(-away / (away**2).sum(axis=1, keepdims=True))

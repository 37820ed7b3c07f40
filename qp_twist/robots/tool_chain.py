"""The tool of an arm on moves from pose to pose, as controllers move it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import rotation_vector
from qp_twist.kinematics import SerialChain

_STEP = float(np.radians(0.25))
"""Largest joint step from sample to sample, rad. A joint moves straight between two, by which the
tool is off its line by at most r δ²/8 a joint: 2.4 µm for 0.25° at r = 1 m."""
_EVENLY = 0.7
"""Share of that step on average, so that none is larger where joints are faster."""
_SHORTEST = 1e-5
"""Share of a move from which a joint step that is still too large is that of a singularity."""
_NEWTON = 8
"""Steps of Newton's method; two or three suffice away from singularities."""
_MET = 1e-10
"""Residual, m and rad, at which a sample is met."""
_SAME = float(np.radians(1e-3))
"""Difference from the stated joint positions at the end that is rounding: ten units of the fourth
decimal of a degree, by which a pose near a singularity may turn two joints against each other."""


Part = Literal["", "positioner", "hand"]
"""What moves the part to which a path belongs: nothing, a positioner, or the robot itself, which
moves it along a tool that stands still."""


class Poses(NamedTuple):
    """Rotations (K, 3, 3) and positions (K, 3), m."""

    rotations: Array
    positions: Array


Way = Callable[[Array], Poses]
"""The poses of a tool at shares (K,) of a move."""


class ToolChain(NamedTuple):
    """The chain of a tool, and the joints that move it.

    Attributes:
        chain: From the world, or from a part that moves, to the tool's frame.
        names: Names of its joints, in the order of the chain.
        tool: Name of the frame.
        external: Places in ``names`` of external axes. On straight moves, on which the tool moves
            straight on the part, each moves in proportion to the way.
        part: What moves the part.
    """

    chain: SerialChain
    names: tuple[str, ...]
    tool: str
    external: tuple[int, ...] = ()
    part: Part = ""

    @property
    def own(self) -> list[int]:
        """Places in ``names`` of the arm's joints."""
        return [k for k in range(len(self.names)) if k not in self.external]

    @property
    def arm(self) -> ToolChain:
        """The arm alone: external axes stand still at the model's reference."""
        own, chain = self.own, self.chain
        screws, qpos = (tuple(of[k] for k in own) for of in (chain.screws, chain.qpos))
        alone = replace(chain, screws=screws, qpos=qpos)  # type: ignore[arg-type]
        return ToolChain(alone, tuple(self.names[k] for k in own), self.tool, (), self.part)

    def at_reference(self, pose: mink.SE3, q: Array) -> mink.SE3:
        """Where a pose would be for the arm if the external axes of q (n,) were at reference."""
        if not self.external:
            return pose
        (R, p), (R_arm, p_arm) = self.poses(q[None]), self.arm.poses(q[None, self.own])
        return se3(R_arm[0], p_arm[0]) @ se3(R[0], p[0]).inverse() @ pose

    def poses(self, q: Array) -> Poses:
        """Poses of the tool for positions of its joints (K, n)."""
        return Poses(*self.chain.poses(self._whole(q)))

    def twists(self, q: Array, change: Array) -> tuple[Array, Array]:
        """The tool's velocity and turning rate, (K, 3) each, at joint rates (K, n), at q (K, n)."""
        _, _, J = self.chain.poses_and_jacobians(self._whole(q))
        found = (J[:, :, [screw.dof for screw in self.chain.screws]] @ change[..., None])[..., 0]
        return found[:, :3], found[:, 3:]

    def axes(self, q: Array) -> list[tuple[Array, Array]]:
        """Direction and a point of each joint's axis at positions q (K, n), m, (K, 3) each."""
        return self.chain.frames(self._whole(q))[2]

    def towards(self, begin: Array, end: Array, at: Way) -> tuple[Array, Array]:
        """Joint positions on a move of the tool that leads from one configuration to another.

        Returns:
            λ (K,) from 0 to 1, and joint positions there, (K, n), from ``begin`` to ``end``.

        Raises:
            InvalidInput: If the joints do not follow, or arrive at other positions than ``end``.
        """
        shares, rows = self.along(begin, at, end)
        off = np.abs(rows[-1] - end)
        if off.max() > _SAME:
            joint = int(np.argmax(off))
            raise InvalidInput(
                f"on its move the tool has {self.names[joint]} arrive at "
                f"{np.degrees(rows[-1][joint]):.4f}°, and the program states "
                f"{np.degrees(end[joint]):.4f}°: another configuration."
            )
        rows[-1] = end
        return shares, rows

    def along(self, begin: Array, at: Way, end: Array | None = None) -> tuple[Array, Array]:
        """Joint positions on a move of the tool, which begins at joint positions (n,).

        Newton's method follows it, in steps of the joints so small that the branch stays, in parts
        as long as these allow.

        Args:
            begin: Joint positions at λ = 0, rad or m, (n,).
            at: The tool's poses at shares λ (K,) of the move.
            end: Joint positions (n,) to which external axes move, in proportion.

        Returns:
            λ (K,) from 0 to 1, and joint positions there, (K, n), from ``begin``.

        Raises:
            InvalidInput: If the joints do not follow.
        """
        moved = np.zeros(len(begin))
        external = list(self.external)
        moved[external] = (begin if end is None else end)[external] - begin[external]
        share, length = 0.0, 1.0
        shares, rows = [np.zeros(1)], [begin[None]]
        while share < 1.0:
            then = min(1.0, share + length)
            found = self._part(rows[-1][-1], at, share, then, moved)
            if found is None:
                length /= 2.0
                if length < _SHORTEST:
                    raise InvalidInput(
                        "the joints do not follow the move of the tool: it leads through a "
                        "singularity, or out of reach."
                    )
                continue
            share = then
            shares.append(found[0])
            rows.append(found[1])
            length *= 1.5
        return np.concatenate(shares), np.concatenate(rows)

    def _part(
        self, begin: Array, at: Way, share: float, then: float, moved: Array
    ) -> tuple[Array, Array] | None:
        """Part of a move, from a straight joint move, all samples at once; ``None`` if they jump.

        External axes go by ``moved`` on the whole move.
        """
        last = self.beside((begin + (then - share) * moved)[None], at(np.array([then])))
        if last is None:
            return None
        way = last[0] - begin
        count = 1 + int(np.abs(way).max() / (_EVENLY * _STEP))
        shares = np.linspace(share, then, count + 1)[1:]
        near = begin + ((shares - share) / (then - share))[:, None] * way
        rows = self.beside(near, at(shares))
        if rows is None or np.abs(np.diff(rows, axis=0, prepend=begin[None])).max() > _STEP:
            return None
        return shares, rows

    def beside(self, q: Array, poses: Poses) -> Array | None:
        """Joint positions (K, n) near q (K, n) with these poses, and its external axes.

        ``None`` without.
        """
        own, q = self.own, q.copy()
        dofs = [self.chain.screws[k].dof for k in own]
        for _ in range(_NEWTON):
            now, at, J = self.chain.poses_and_jacobians(self._whole(q))
            turns = rotation_vector(poses.rotations @ now.transpose(0, 2, 1))
            error = np.concatenate([poses.positions - at, turns], axis=1)
            if np.abs(error).max() < _MET:
                return q
            try:
                q[:, own] += np.linalg.solve(J[:, :, dofs], error[..., None])[..., 0]
            except np.linalg.LinAlgError:
                return None
        return None

    def _whole(self, q: Array) -> Array:
        """Positions of all joints of the model, of which only those of the chain count."""
        whole = np.zeros((len(q), self.chain.nv))
        whole[:, list(self.chain.qpos)] = q
        return whole


def se3(rotation: Array, position: Array) -> mink.SE3:
    """The pose of a rotation matrix (3, 3) and a position, m."""
    return mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position)

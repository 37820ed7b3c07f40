"""Poses and Jacobians of a frame for many configurations at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, instance
from qp_twist.errors import InvalidInput
from qp_twist.geometry import cross
from qp_twist.kinematics.frame import frame_pose, welded_to
from qp_twist.kinematics.joint_ranges import JointRanges


class Screw(NamedTuple):
    """A joint at the model's reference configuration, in the world."""

    axis: Array
    """Direction of the axis, (3,)."""
    anchor: Array
    """A point on it, m, (3,)."""
    dof: int
    """Index of its degree of freedom."""
    slides: bool
    """Whether it is a slide."""
    reference: float
    """Its reference coordinate, rad or m."""


@dataclass(frozen=True, eq=False)
class SerialChain:
    r"""The hinges and slides between the world and a frame, as a product of exponentials.

    .. math:: \mathbf x(\mathbf q) = e^{[\xi_1](q_1 - q_1^0)} \cdots e^{[\xi_n](q_n - q_n^0)}
        \,\mathbf x(\mathbf q^0)

    with the screws ξ of the joints at the reference configuration :math:`\mathbf q^0` (Lynch and
    Park, *Modern Robotics*, section 4.1), for arrays of configurations at once.

    Attributes:
        screws: The joints that move the frame, from the world on.
        rotation: The frame at the reference configuration, (3, 3).
        position: Its origin there, m, (3,).
        nv: Number of degrees of freedom of the model; those that do not move the frame have
            columns of zeros.
        qpos: Index in q of each screw's coordinate.
    """

    screws: tuple[Screw, ...]
    rotation: Array
    position: Array
    nv: int
    qpos: tuple[int, ...]

    @classmethod
    def of(cls, model: mujoco.MjModel, frame_name: str | int, frame_type: str) -> SerialChain:
        """Read the chain from a model; a ball or free joint that moves the frame is refused."""
        instance("model", model, mujoco.MjModel)
        configuration = mink.Configuration(model, model.qpos0)
        data = configuration.data
        rotation, position = frame_pose(configuration, frame_name, frame_type)
        ranges = JointRanges.of(model)
        screws, qpos = [], []
        for dof in dofs_above(model, frame_name, frame_type):
            joint, at = int(model.dof_jntid[dof]), int(ranges.qpos[dof])
            if at < 0:
                raise InvalidInput(
                    f"{ranges.names[dof]!r}, which moves the frame {frame_name!r}, is a ball or "
                    "free joint; only chains of hinges and slides are taken."
                )
            axis, anchor = data.xaxis[joint].copy(), data.xanchor[joint].copy()
            slides = not ranges.hinge[dof]
            screws.append(Screw(axis, anchor, dof, slides, float(model.qpos0[at])))
            qpos.append(at)
        return cls(tuple(screws), rotation, position, int(model.nv), tuple(qpos))

    def poses(self, q: Array) -> tuple[Array, Array]:
        """Rotations (K, 3, 3) and origins (K, 3) of the frame at configurations q (K, nq)."""
        return self.frames(q)[:2]

    def poses_and_jacobians(self, q: Array) -> tuple[Array, Array, Array]:
        """:meth:`poses`, and world-aligned Jacobians (linear, angular) of the frame, (K, 6, nv)."""
        rotation, origin, axes = self.frames(q)
        jacobians = np.zeros((len(q), 6, self.nv))
        for screw, (axis, anchor) in zip(self.screws, axes, strict=True):
            if screw.slides:
                jacobians[:, :3, screw.dof] = axis
            else:
                jacobians[:, :3, screw.dof] = cross(axis, origin - anchor)
                jacobians[:, 3:, screw.dof] = axis
        return rotation, origin, jacobians

    def levers(self, extent: Array) -> Array:
        """Largest distance of the frame's origin from each joint's axis, m; 1 for slides, (…, n).

        ``extent`` (…, n) is the largest distance of each slide's coordinate from its reference.
        """
        levers = np.ones(extent.shape)
        # Sum from the frame inwards: lengths of the links, and travels of the slides among them.
        beyond, after = np.zeros(extent.shape[:-1]), self.position
        for j in range(len(self.screws) - 1, -1, -1):
            screw = self.screws[j]
            link = after - screw.anchor
            if screw.slides:
                beyond = beyond + extent[..., j]
            else:
                levers[..., j] = float(np.linalg.norm(np.cross(screw.axis, link))) + beyond
            beyond = beyond + float(np.linalg.norm(link))
            after = screw.anchor
        return levers

    def path_length(self, q: Array, travel: Array) -> Array:
        """Largest path length of the frame's origin on motions that start at q (K, nq), m, (K,).

        ``travel`` (K, nv) is the largest path length of each degree of freedom, rad or m.
        """
        moved = travel[:, [screw.dof for screw in self.screws]]
        reference = np.array([screw.reference for screw in self.screws])
        extent = np.abs(q[:, list(self.qpos)] - reference) + moved
        return np.asarray((self.levers(extent) * moved).sum(axis=1))

    def frames(self, q: Array) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """:meth:`poses`, and each joint's axis and a point on it, m, (K, 3) each."""
        references, parts = self._constants
        travels = q[:, self.qpos] - references
        # Rodrigues' formula, as one product: numpy's is five times as fast as three broadcasts.
        shares = np.ones((*travels.T.shape, 3))
        shares[..., 1], shares[..., 2] = np.sin(travels.T), 2.0 * np.sin(0.5 * travels.T) ** 2
        turns = (shares @ parts).reshape(len(self.screws), len(q), 3, 3)
        rotation = np.tile(np.eye(3), (len(q), 1, 1))
        position = np.zeros((len(q), 3))
        axes = []
        for screw, travel, turn in zip(self.screws, travels.T, turns, strict=True):
            axis, anchor = _turned(rotation, screw.axis), _turned(rotation, screw.anchor) + position
            axes.append((axis, anchor))
            if not travel.any():  # at the reference
                continue
            if screw.slides:
                position = position + travel[:, None] * axis
            else:
                rotation = rotation @ turn
                position = anchor - _turned(rotation, screw.anchor)
        return rotation @ self.rotation, position + _turned(rotation, self.position), axes

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """The references (n,), and 1, [a] and [a]² of the axes, (n, 3, 9)."""
        skews = [np.cross(np.eye(3), screw.axis) for screw in self.screws]
        parts = np.array([[np.eye(3), skew, skew @ skew] for skew in skews]).reshape(-1, 3, 9)
        return np.array([screw.reference for screw in self.screws]), parts


def _turned(rotations: Array, vector: Array) -> Array:
    """R v for each R (K, 3, 3) of one v (3,), (K, 3), as one product of two matrices."""
    return (rotations.reshape(-1, 3) @ vector).reshape(-1, 3)


def largest_reach(chain: SerialChain, ranges: JointRanges) -> float:
    """An upper bound on the distance of a chain's frame from its first joint, m.

    The lengths of the links and the travels of the slides: infinite for a slide without a range, 0
    if no joint moves the frame.
    """
    if not chain.screws:
        return 0.0
    points = [*(screw.anchor for screw in chain.screws), chain.position]
    reach = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    for screw in chain.screws:
        if screw.slides:
            ends = np.array([ranges.lower[screw.dof], ranges.upper[screw.dof]])
            reach += float(np.abs(ends - screw.reference).max())
    return reach


def dofs_above(model: mujoco.MjModel, name: str | int, frame_type: str) -> list[int]:
    """Degrees of freedom between the world and a frame, from the world on."""
    body = welded_to(model, name, frame_type)
    dof = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1 if body else -1
    dofs = []
    while dof >= 0:
        dofs.append(dof)
        dof = int(model.dof_parentid[dof])
    return dofs[::-1]

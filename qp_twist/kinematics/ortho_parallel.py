"""All inverse-kinematics branches of industrial arms with a spherical wrist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
import py_opw_kinematics as opw

from qp_twist.checks import Array
from qp_twist.kinematics.serial_chain import Screw, SerialChain

BRANCHES = 8
"""Shoulder × elbow × wrist."""
_SAME = 1e-6
"""Lengths (m) and sines of angles below this count as zero; the lengths of a scene are rounded."""
_VERIFIED = 1e-6
"""Largest error of a solution in the model's own kinematics, m and rad."""
_NOWHERE = np.tile([1e6, 2e6], (6, 1))
"""Unsatisfiable limits: ``reach`` drops no branch for them, but skips the singular values of
configurations outside, which take most of its time."""


class _Poses(NamedTuple):
    """The part of scipy's RigidTransform that ``reach`` uses, without orthonormalisation."""

    matrices: Array

    def as_matrix(self) -> Array:
        """Homogeneous transforms, (K, 4, 4)."""
        return self.matrices


@dataclass(frozen=True, eq=False)
class OrthoParallelArm:
    r"""Six hinges: the first two axes perpendicular, the second and third parallel, then a wrist.

    The closed form is that of Brandstötter, Angerer and Hofbaur, *An analytical solution of the
    inverse kinematics problem of industrial serial manipulators with an ortho-parallel basis and a
    spherical wrist* (Austrian Robotics Workshop 2014), computed by ``py-opw-kinematics``; this
    class finds its parameters from a model's axes:

    .. math:: \mathbf x(\mathbf q) = \mathbf B\;\mathrm{opw}(\mathbf s \circ \mathbf q + \mathbf o)
        \;\mathbf F

    Attributes:
        chain: The arm and the frame.
        base: B, (4, 4).
        flange: F, (4, 4).
        signs: s, ±1, (6,).
        offsets: o, rad, (6,).
    """

    chain: SerialChain
    base: Array
    flange: Array
    signs: Array
    offsets: Array
    _solver: opw.Robot

    @classmethod
    def recognise(
        cls, model: mujoco.MjModel, frame_name: str | int, frame_type: str
    ) -> OrthoParallelArm | None:
        """The arm, if the model's axes are of this kind; else ``None``.

        The parameters are verified against the model at random configurations; if the closed form
        fails there, the result is ``None``, too.
        """
        chain = SerialChain.of(model, frame_name, frame_type)
        if len(chain.screws) != 6 or any(screw.slides for screw in chain.screws):
            return None
        one, two, three, four, five, six = chain.screws
        if (
            abs(one.axis @ two.axis) > _SAME
            or np.linalg.norm(np.cross(two.axis, three.axis)) > _SAME
            or abs(three.axis @ four.axis) > _SAME
            or abs(four.axis @ five.axis) > _SAME
            or abs(five.axis @ six.axis) > _SAME
        ):
            return None
        wrist = _meeting_point(four, five)
        if wrist is None or _distance(wrist, six) > _SAME:
            return None
        arm = cls._from_screws(chain, wrist)
        return arm if arm is not None and arm._agrees() else None

    @classmethod
    def _from_screws(cls, chain: SerialChain, wrist: Array) -> OrthoParallelArm | None:
        one, two, three, four, five, six = chain.screws
        z, y = one.axis, two.axis
        # In the base's axes: x forward, y along the second axis, z along the first.
        x = np.cross(y, z)
        shoulder = two.anchor - one.anchor
        origin = one.anchor + (shoulder @ z) * z
        forward = float(shoulder @ x)  # a1
        elbow = np.array([(three.anchor - origin) @ x - forward, (three.anchor - origin) @ z])
        upper = float(np.hypot(*elbow))  # c2
        if upper < _SAME:
            return None
        theta_2 = np.arctan2(elbow[0], elbow[1])
        # The forearm's own z is the fourth axis, towards the wrist; x' is z' turned by y.
        reach = wrist - origin
        to_wrist = np.array([reach @ x - forward, reach @ z]) - elbow
        along = np.array([four.axis @ x, four.axis @ z])
        along *= np.copysign(1.0, along @ to_wrist)
        pitch = np.arctan2(along[0], along[1])  # theta_2 + theta_3
        across = np.array([np.cos(pitch), -np.sin(pitch)])
        fore, aside = float(along @ to_wrist), float(across @ to_wrist)  # c3, a2
        forearm = along[0] * x + along[1] * z
        theta_4 = np.arctan2(five.axis @ np.cross(forearm, y), five.axis @ y)
        theta_5 = np.arctan2(six.axis @ np.cross(five.axis, forearm), six.axis @ forearm)
        theta = np.array([0.0, theta_2, pitch - theta_2, theta_4, theta_5, 0.0])
        signs = np.sign([1.0, 1.0, three.axis @ y, four.axis @ forearm, 1.0, 1.0])
        reference = np.array([screw.reference for screw in chain.screws])
        parameters = opw.KinematicModel(
            a1=forward, a2=aside, b=float(reach @ y), c1=0.0, c2=upper, c3=fore, c4=0.0,
            offsets=(0.0,) * 6, flip_axes=(False,) * 6,
        )  # fmt: skip
        across_wrist = np.cross(five.axis, six.axis)
        hand = homogeneous(np.column_stack([across_wrist, five.axis, six.axis]), wrist)
        return cls(
            chain,
            homogeneous(np.column_stack([x, y, z]), origin),
            np.linalg.inv(hand) @ homogeneous(chain.rotation, chain.position),
            signs,
            theta - signs * reference,
            opw.Robot(parameters, degrees=False),
        )

    def branches(self, rotations: Array, positions: Array) -> Array:
        """All solutions of the inverse kinematics for K poses of the frame, rad, (K, 8, 6).

        NaN where a branch is out of reach; an index keeps its branch along a motion. Whole turns
        are not included.

        Args:
            rotations: Rotations of the frame to the world, (K, 3, 3).
            positions: Positions of its origin in the world, m, (K, 3).
        """
        poses = np.linalg.inv(self.base) @ homogeneous(rotations, positions)
        hands = _Poses(poses @ np.linalg.inv(self.flange))
        found = self._solver.reach(hands, joint_limits=_NOWHERE)
        joints: Array = self.signs * (found.joints - self.offsets)
        return joints

    def _agrees(self) -> bool:
        """Whether the branches reproduce random configurations of the model, and no others."""
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (64, 6))
        every = np.zeros((len(q), max(self.chain.qpos) + 1))
        every[:, self.chain.qpos] = q
        rotations, positions = self.chain.poses(every)
        found = self.branches(rotations, positions)
        apart = np.abs(np.remainder(found - q[:, None] + np.pi, 2.0 * np.pi) - np.pi).max(axis=2)
        if not (np.nanmin(apart, axis=1, initial=np.inf) < _VERIFIED).all():
            return False
        row, branch = np.nonzero(np.isfinite(found).all(axis=2))
        every = np.zeros((len(row), every.shape[1]))
        every[:, self.chain.qpos] = found[row, branch]
        again = self.chain.poses(every)
        return bool(
            np.abs(again[0] - rotations[row]).max() < _VERIFIED
            and np.abs(again[1] - positions[row]).max() < _VERIFIED
        )


def homogeneous(rotations: Array, positions: Array) -> Array:
    """Homogeneous transforms (…, 4, 4) of rotations (…, 3, 3) and positions (…, 3)."""
    matrices = np.zeros((*positions.shape[:-1], 4, 4))
    matrices[..., :3, :3] = rotations
    matrices[..., :3, 3] = positions
    matrices[..., 3, 3] = 1.0
    return matrices


def _meeting_point(a: Screw, b: Screw) -> Array | None:
    """Intersection of two axes, m, (3,); ``None`` if there is none, or they coincide."""
    rows = np.vstack([np.eye(3) - np.outer(s.axis, s.axis) for s in (a, b)])
    sides = np.concatenate([s.anchor - (s.axis @ s.anchor) * s.axis for s in (a, b)])
    point, _, rank, _ = np.linalg.lstsq(rows, sides, rcond=1e-6)
    meets = rank == 3 and _distance(point, a) < _SAME and _distance(point, b) < _SAME
    return point if meets else None


def _distance(point: Array, screw: Screw) -> float:
    """Distance of a point from an axis, m."""
    return float(np.linalg.norm(np.cross(point - screw.anchor, screw.axis)))

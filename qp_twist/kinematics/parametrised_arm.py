"""All branches of the inverse kinematics of arms of six and more joints, the others given."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import rotate
from qp_twist.kinematics import offset_wrist, spherical_wrist
from qp_twist.kinematics.serial_chain import SerialChain
from qp_twist.kinematics.subproblems import NEARLY, Axes

_EXACT = 1e-6
"""Largest error of a solution that counts as exact, m and rad."""
_PROBES = 8
"""Number of random values of the parameters at which the axes are examined."""
_CHECKED, _FOUND = 64, 0.9
"""Number of random configurations for the verification, and the share of them that solutions must
come near to, if they are not exact."""
_NEAR_POSE, _NEAR_JOINTS = 4.0 * NEARLY, 0.3
"""Largest errors of solutions that are not exact: of the pose, m and rad, and of joints, rad."""
_WORTH, _AT_MOST = 0.05, 2
"""Least gain, in mean sine, for which a further choice of parameters is taken; most choices."""


@dataclass(frozen=True, eq=False)
class ParametrisedArm:
    r"""Six hinges of a serial chain in closed form, for given values of all other joints.

    A given joint may be between the six: those after it are moved with it,

    .. math::

        e^{[\xi_1]q_1}\,\mathbf E\,e^{[\xi_2]q_2} =
        e^{[\xi_1]q_1}\,e^{[\mathrm{Ad}_{\mathbf E}\xi_2]q_2}\,\mathbf E .

    Of the six, in their order in the chain or in the reverse one, either

    - the last three axes meet in a point, and of the other three two neighbours meet or are
      parallel (Pieper, *The kinematics of manipulators under computer control*, Stanford 1968):
      eight branches;
    - the last two meet, and the three before them are parallel: eight branches;
    - the last two meet, and the second and third meet or are parallel: the up to 16 real roots of
      a polynomial, in no order that lasts from pose to pose.

    What meets does not move with the axes that meet there: with t where the pose requires it and p
    where it is at the reference,
    :math:`e^{[\xi_1]q_1}e^{[\xi_2]q_2}e^{[\xi_3]q_3}\,\mathbf p = \mathbf t` gives the other three
    by the subproblems of Paden and Kahan (Murray, Li and Sastry, *A Mathematical Introduction to
    Robotic Manipulation*, section 3.3); the rest of the rotation gives the three themselves.

    Axes need to meet, or be parallel, to 5 mm and 5 mrad only: else the solutions are near those of
    the arm, to be corrected by Newton's method. For the roots they have to but for rounding, and
    the solutions are corrected.

    Attributes:
        chain: The chain up to the controlled frame.
        solved: Indices of the six hinges among the chain's screws.
        parameters: Degrees of freedom of the model that are given, (p,), also those that do not
            move the frame.
        exact: Whether the solutions are those of the arm, to 1e-6 m and rad.
    """

    chain: SerialChain
    solved: tuple[int, ...]
    parameters: tuple[int, ...]
    exact: bool
    _inverted: bool
    """Whether the first axes meet, not the last ones."""
    _wrist: ModuleType
    """What solves the six hinges."""
    _kind: str

    @classmethod
    def recognise(cls, chain: SerialChain) -> list[ParametrisedArm]:
        """Choices of parameters for a chain, at most two; none if no six hinges are of this kind.

        Each is verified against the chain at random configurations. Along a self-motion of the
        chain every joint may stand still for a while; a second choice is made where, on average
        over random configurations, it leaves other joints to move when the first's stand still.
        """
        if any(at != screw.dof for at, screw in zip(chain.qpos, chain.screws, strict=True)):
            return []  # of models with ball or free joints
        hinges = [k for k, screw in enumerate(chain.screws) if not screw.slides]
        near: list[ParametrisedArm] = []
        found: list[ParametrisedArm] = []
        for wrist in (spherical_wrist, offset_wrist):  # the first takes a hundredth of the time
            if not found:
                every = itertools.combinations(hinges, 6)
                arms = [cls._of(chain, solved, wrist) for solved in every]
                found = [arm for arm in arms if arm is not None and arm.exact]
                near = near or [arm for arm in arms if arm is not None]
        found = found or near
        q, chosen = _random(chain, _CHECKED), list[ParametrisedArm]()
        speeds = [(arm._sines(q), arm) for arm in found]
        reached = np.zeros(_CHECKED)
        while speeds and len(chosen) < _AT_MOST:
            speed, arm = max(speeds, key=lambda each: np.maximum(reached, each[0]).mean())
            reached, before = np.maximum(reached, speed), reached
            if chosen and reached.mean() - before.mean() < _WORTH:
                break
            chosen.append(arm)
        return chosen

    @classmethod
    def _of(
        cls, chain: SerialChain, solved: tuple[int, ...], wrist: ModuleType
    ) -> ParametrisedArm | None:
        own = {chain.screws[k].dof for k in solved}
        parameters = tuple(dof for dof in range(chain.nv) if dof not in own)
        probes = _random(chain, _PROBES)[:, list(parameters)]
        near = None
        for inverted in (False, True):
            arm = cls(chain, solved, parameters, False, inverted, wrist, "")
            for kind in wrist.kinds_of(arm._moved(probes)[0]):
                found = replace(arm, _kind=kind)
                exact = found._agrees()
                if exact:
                    return replace(found, exact=True)
                if exact is not None and near is None:
                    near = found
        return near

    def branches(
        self, rotations: Array, positions: Array, parameters: Array | None = None
    ) -> Array:
        """Solutions for poses (K, 3, 3), (K, 3), m, and given joints (K, p), if any, (K, B, nv).

        B is 8 or 16. In rad or m, without whole turns; NaN where a branch is out of reach. Where
        axes are aligned so that there are infinitely many solutions, one of them.
        """
        if parameters is None:
            parameters = np.zeros((len(rotations), 0))
        axes, rotation, position = self._moved(parameters)
        # e1 … e6 = X (E M)⁻¹
        turn = rotations @ rotation.swapaxes(1, 2)
        move = positions - rotate(turn, position)
        if self._inverted:
            turn = turn.swapaxes(1, 2)
            move = -rotate(turn, move)
        angles = self._wrist.solved(axes, self._kind, turn, move)
        if self._inverted:
            angles = angles[::-1]
        q = np.full((*angles.shape[1:], self.chain.nv), np.nan)
        q[:, :, list(self.parameters)] = parameters[:, None]
        for k, angle in zip(self.solved, angles, strict=True):
            screw = self.chain.screws[k]
            q[:, :, screw.dof] = screw.reference + angle
        q[~np.isfinite(angles).all(axis=0)] = np.nan
        if self._wrist is offset_wrist and self._kind != offset_wrist.NEARLY_PLANAR:
            moving = [self.chain.screws[k].dof for k in self.solved]
            from qp_twist.kinematics.branch_correction import corrected  # with numba: 0.2 s

            return corrected(self.chain, moving, q, rotations, positions)
        return q

    @property
    def labelled(self) -> bool:
        """Whether a branch has the same index at all poses; roots of a polynomial have not."""
        return self._wrist is spherical_wrist or self._kind.startswith(offset_wrist.PLANAR)

    def _moved(self, parameters: Array) -> tuple[Axes, Array, Array]:
        """The six screws moved by the given joints before them, and the frame moved by all.

        In the order in which the meeting axes are the last ones; one of each for any number of
        poses if no joint is given.
        """
        q = np.zeros((len(parameters) if self.parameters else 1, self.chain.nv))
        for screw in self.chain.screws:
            q[:, screw.dof] = screw.reference
        if self.parameters:
            q[:, list(self.parameters)] = parameters
        rotation, position, moved = self.chain.frames(q)
        screws = np.array([moved[k] for k in self.solved]).transpose(1, 0, 3, 2)
        directions, anchors = np.ascontiguousarray(screws)
        if self._inverted:
            directions, anchors = -directions[::-1], anchors[::-1]
        return Axes(directions, anchors), rotation, position

    def _agrees(self) -> bool | None:
        """Whether the solutions are exact; ``None`` if they are not even near.

        Random configurations of the chain have to be among the solutions of their poses, and all
        solutions have to lead to these poses.
        """
        q = _random(self.chain, _CHECKED)
        poses = self.chain.poses(q)
        found = self.branches(*poses, q[:, list(self.parameters)])
        hinges = [self.chain.screws[k].dof for k in self.solved]
        apart = np.remainder(found - q[:, None] + np.pi, 2.0 * np.pi) - np.pi
        apart = np.abs(apart[:, :, hinges]).max(axis=2)
        nearest = np.nanmin(apart, axis=1, initial=np.inf)
        row, branch = np.nonzero(np.isfinite(apart))
        again = self.chain.poses(found[row, branch])
        pairs = zip(again, poses, strict=True)
        off = max(np.abs(one - other[row]).max(initial=0.0) for one, other in pairs)
        if off < _EXACT and (nearest < 1e2 * _EXACT).all():
            return True
        return False if off < _NEAR_POSE and (nearest < _NEAR_JOINTS).mean() > _FOUND else None

    def _sines(self, q: Array) -> Array:
        """How far the parameters move along the self-motions at configurations q (K, nv), (K,).

        The size of the determinant of their rows of an orthonormal basis of the null space of the
        Jacobian: with one parameter its share of the motion, with none 1.
        """
        moving = [screw.dof for screw in self.chain.screws]
        jacobians = self.chain.poses_and_jacobians(q)[2][:, :, moving]
        basis = np.linalg.qr(jacobians.transpose(0, 2, 1), mode="complete").Q[:, :, 6:]
        given = [k for k, dof in enumerate(moving) if dof in self.parameters]
        return np.asarray(np.abs(np.linalg.det(basis[:, given])))


def _random(chain: SerialChain, count: int) -> Array:
    """Configurations (K, nv) within half a turn, or 1 m, of the reference."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (count, chain.nv))
    for screw in chain.screws:
        q[:, screw.dof] *= 1.0 if screw.slides else np.pi
        q[:, screw.dof] += screw.reference
    return q

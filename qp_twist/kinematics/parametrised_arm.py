"""All branches of the inverse kinematics of arms of six and more joints, the others given."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import rotate
from qp_twist.kinematics.serial_chain import SerialChain

BRANCHES = 8
"""Four places of the spherical joint's centre on the other three axes × two of its middle axis."""
NEARLY = 5e-3
"""Axes that miss each other by less than this are taken to meet, m, and to be parallel, rad."""
_EXACT = 1e-6
"""Largest error of a solution that counts as exact, m and rad."""
_OBLIQUE = 0.1
"""Smallest sine of the angle between axes of which the meeting point is used."""
_PROBES = 8
"""Number of random values of the parameters at which the axes are examined."""
_CHECKED, _FOUND = 64, 0.9
"""Number of random configurations for the verification, and the share of them that solutions must
come near to, if they are not exact."""
_NEAR_POSE, _NEAR_JOINTS = 4.0 * NEARLY, 0.3
"""Largest errors of solutions that are not exact: of the pose, m and rad, and of joints, rad."""
_EDGE = 1e-7
"""A cosine beyond ±1 by less is rounding at the edge of the reach."""
_WORTH, _AT_MOST = 0.05, 2
"""Least gain, in mean sine, for which a further choice of parameters is taken; most choices."""


class _Axes(NamedTuple):
    """Six screws for K values of the parameters."""

    directions: Array
    """(6, 3, K)."""
    anchors: Array
    """Points on them, m, (6, 3, K)."""


@dataclass(frozen=True, eq=False)
class ParametrisedArm:
    r"""Six hinges of a serial chain in closed form, for given values of all other joints.

    Of the six, in their order in the chain, the last three (or the first three) have axes that meet
    in a point, and of the other three two neighbours meet or are parallel (Pieper, *The kinematics
    of manipulators under computer control*, Stanford 1968). A given joint may be between the six:
    those after it are moved with it,

    .. math::

        e^{[\xi_1]q_1}\,\mathbf E\,e^{[\xi_2]q_2} =
        e^{[\xi_1]q_1}\,e^{[\mathrm{Ad}_{\mathbf E}\xi_2]q_2}\,\mathbf E .

    The centre of the meeting axes does not move with them: with t where the pose requires it and p
    where it is at the reference,
    :math:`e^{[\xi_1]q_1}e^{[\xi_2]q_2}e^{[\xi_3]q_3}\,\mathbf p = \mathbf t` gives the other three
    by the subproblems of Paden and Kahan (Murray, Li and Sastry, *A Mathematical Introduction to
    Robotic Manipulation*, section 3.3); the rest of the rotation gives the three themselves.

    Axes need to meet, or be parallel, to :data:`NEARLY` only: else the solutions are near those of
    the arm, to be corrected by Newton's method.

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
    """Whether the first three axes meet, not the last three."""
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
        found = [cls._of(chain, solved) for solved in itertools.combinations(hinges, 6)]
        every, chosen = _random(chain, _CHECKED), list[ParametrisedArm]()
        speeds = [(arm._sines(every), arm) for arm in found if arm is not None]
        reached = np.zeros(_CHECKED)
        while speeds and len(chosen) < _AT_MOST:
            speed, arm = max(speeds, key=lambda each: np.maximum(reached, each[0]).mean())
            reached, before = np.maximum(reached, speed), reached
            if chosen and reached.mean() - before.mean() < _WORTH:
                break
            chosen.append(arm)
        return chosen

    @classmethod
    def _of(cls, chain: SerialChain, solved: tuple[int, ...]) -> ParametrisedArm | None:
        own = {chain.screws[k].dof for k in solved}
        parameters = tuple(dof for dof in range(chain.nv) if dof not in own)
        probes = _random(chain, _PROBES)[:, list(parameters)]
        near = None
        for inverted in (False, True):
            arm = cls(chain, solved, parameters, False, inverted, "")
            for kind in _kinds_of(arm._moved(probes)[0]):
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
        """Solutions for poses (K, 3, 3), (K, 3), m, and given joints (K, p), if any, (K, 8, nv).

        In rad or m, without whole turns; NaN where a branch is out of reach. Where axes are aligned
        so that there are infinitely many solutions, one of them.
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
        angles = _solved(axes, self._kind, turn, move)
        if self._inverted:
            angles = angles[::-1]
        q = np.full((len(rotations), BRANCHES, self.chain.nv), np.nan)
        q[:, :, list(self.parameters)] = parameters[:, None]
        for k, angle in zip(self.solved, angles, strict=True):
            screw = self.chain.screws[k]
            q[:, :, screw.dof] = screw.reference + angle
        q[~np.isfinite(angles).all(axis=0)] = np.nan
        return q

    def _moved(self, parameters: Array) -> tuple[_Axes, Array, Array]:
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
        return _Axes(directions, anchors), rotation, position

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
        sines: Array = np.abs(np.linalg.det(basis[:, given]))
        return sines


def _random(chain: SerialChain, count: int) -> Array:
    """Configurations (K, nv) within half a turn, or 1 m, of the reference."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (count, chain.nv))
    for screw in chain.screws:
        q[:, screw.dof] *= 1.0 if screw.slides else np.pi
        q[:, screw.dof] += screw.reference
    return q


# ---------------------------------------------------------------- six axes
# Arrays of vectors are (3, K) or (3, K, B), of angles (K, B): B branches.


def _kinds_of(axes: _Axes) -> list[str]:
    """How the first three axes may be solved, if the last three meet in a point.

    ``"12"`` or ``"23"`` if these two meet, ``"1∥2"`` or ``"2∥3"`` if they are parallel.
    """
    centre = _meeting_point(axes, (3, 4, 5))
    oblique = all(_sine(axes, a, a + 1).min() > _OBLIQUE for a in (3, 4))
    if not oblique or max(_miss(axes, k, centre).max() for k in (3, 4, 5)) > NEARLY:
        return []
    kinds = []
    for a in (0, 1):
        sine = _sine(axes, a, a + 1)
        if sine.max() < NEARLY:
            if _sine(axes, 1 - a, 2 - a).min() > _OBLIQUE:
                kinds.append(f"{a + 1}∥{a + 2}")
        elif sine.min() > _OBLIQUE:
            centre = _meeting_point(axes, (a, a + 1))
            if max(_miss(axes, k, centre).max() for k in (a, a + 1)) < NEARLY:
                kinds.append(f"{a + 1}{a + 2}")
    return kinds


def _solved(axes: _Axes, kind: str, turn: Array, move: Array) -> Array:
    """Angles of the six hinges, (6, K, 8), for e1 … e6 = (turn (K, 3, 3), move (K, 3))."""
    z, centre = axes.directions[..., None], _meeting_point(axes, (3, 4, 5))
    target = (_turned(turn, centre) + move.T)[..., None]
    regional = _last_two_parallel if "∥" in kind else _last_two_meet
    if kind.startswith("2"):
        one, two, three = regional(axes, centre[..., None], target)  # (K, 4) each
    else:  # the first two: e3⁻¹ e2⁻¹ e1⁻¹ t = p is of the same form, with axes −ξ3, −ξ2, −ξ1
        mirrored = _Axes(-axes.directions[2::-1], axes.anchors[2::-1])
        three, two, one = regional(mirrored, target, centre[..., None])
    # What the last three have to add: R = (e1 e2 e3)⁻¹ turn, applied to two vectors.
    five, six = (_turned(turn, axes.directions[k])[..., None] for k in (4, 5))
    for j, angle in ((0, one), (1, two), (2, three)):
        five, six = (_rotated(z[j], -angle, vector) for vector in (five, six))
    bend = _each(_projected(z[4], z[5], z[3], _dot(z[3], six)))
    one, two, three = (np.repeat(angle, 2, axis=1) for angle in (one, two, three))
    five, six = (np.repeat(vector, 2, axis=2) for vector in (five, six))
    four = _about(z[3], _rotated(z[4], bend, z[5]), six)
    rest = _rotated(z[4], -bend, _rotated(z[3], -four, five))
    last = _about(z[5], z[4], rest)
    return np.stack([one, two, three, four, bend, last])


def _last_two_meet(axes: _Axes, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """The target's distance from where axes 2 and 3 meet depends on q₁ only."""
    z, a = axes.directions[..., None], axes.anchors[..., None]
    m = _meeting_point(axes, (1, 2))[..., None]
    one = _each(_distant(-z[0], a[0], t, m, _norm(p - m)))
    # R(z₂, q₂) R(z₃, q₃) v = u
    v, u = np.broadcast_arrays(p - m, _rotated(z[0], -one, t - a[0]) + a[0] - m)
    three = _each(_projected(z[2], v, z[1], _dot(z[1], u)))
    turned = _rotated(z[2], three, np.repeat(v, 2, axis=2))
    two = _about(z[1], turned, np.repeat(u, 2, axis=2))
    return np.repeat(one, 2, axis=1), two, three


def _last_two_parallel(axes: _Axes, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """The target's height along axes 2 and 3 depends on q₁ only."""
    z, a = axes.directions[..., None], axes.anchors[..., None]
    one = _each(_projected(-z[0], t - a[0], z[1], _dot(z[1], p - a[0])))
    y = np.repeat(_rotated(z[0], -one, t - a[0]) + a[0] - a[1], 2, axis=2)
    three = _each(_distant(z[2], a[2], p, a[1], _norm(y[..., ::2])))
    x = _rotated(z[2], three, p - a[2]) + a[2] - a[1]
    return np.repeat(one, 2, axis=1), _about(z[1], x, y), three


# ---------------------------------------------------------------- subproblems


def _distant(z: Array, a: Array, x: Array, m: Array, distance: Array) -> tuple[Array, Array]:
    """Both angles at which x, turned about the axis z through a, is so far from m."""
    x, m = x - a, m - a
    return _projected(z, x, m, 0.5 * (_dot(x, x) + _dot(m, m) - distance**2))


def _projected(z: Array, x: Array, d: Array, value: Array) -> tuple[Array, Array]:
    """Both angles q with d · R(z, q) x = value; NaN if there are none."""
    along = _dot(d, z) * _dot(x, z)
    cosine, sine = _dot(d, x) - along, _dot(d, _cross(z, x))
    size = np.hypot(cosine, sine)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (value - along) / np.maximum(size, 1e-300)
    # Where the size is rounding, x is on the axis, or d along it: any angle does, or none.
    share = np.where(size < 1e-12, np.where(np.abs(value - along) < 1e-9, 1.0, np.nan), share)
    share = np.where(np.abs(share) > 1.0 + _EDGE, np.nan, np.clip(share, -1.0, 1.0))
    middle, half = np.arctan2(sine, cosine), np.arccos(share)
    return middle - half, middle + half


def _about(z: Array, x: Array, y: Array) -> Array:
    """Angle about z from x to y, as seen along z."""
    angle: Array = np.arctan2(_dot(z, _cross(x, y)), _dot(x, y) - _dot(x, z) * _dot(y, z))
    return angle


def _rotated(z: Array, angle: Array, x: Array) -> Array:
    """R(z, angle) x, (3, K, B)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return x * cosine + _cross(z, x) * sine + z * (_dot(z, x) * (1.0 - cosine))


def _each(found: tuple[Array, Array]) -> Array:
    """Two solutions (K, B) for each branch as (K, 2B), those of a branch next to each other."""
    return np.stack(found, axis=-1).reshape(len(found[0]), 2 * found[0].shape[1])


def _cross(a: Array, b: Array) -> Array:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _dot(a: Array, b: Array) -> Array:
    dot: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return dot


def _norm(a: Array) -> Array:
    return np.sqrt(_dot(a, a))


def _turned(rotations: Array, vectors: Array) -> Array:
    """R v for each R (K, 3, 3), of vectors (3, K) or of one (3, 1), as (3, K) in memory, too."""
    turned: Array = np.einsum("kij,jk->ik", rotations, vectors)
    return turned


def _sine(axes: _Axes, a: int, b: int) -> Array:
    return _norm(_cross(axes.directions[a], axes.directions[b]))


def _meeting_point(axes: _Axes, which: tuple[int, ...]) -> Array:
    """The point nearest to some axes, in the sense of least squares, m, (3, K)."""
    z = axes.directions[list(which)].transpose(2, 0, 1)  # (K, axes, 3)
    across = np.eye(3) - z[..., None] * z[..., None, :]
    anchors = axes.anchors[list(which)].transpose(2, 0, 1)[..., None]
    normal = across.sum(axis=1)
    diagonal = np.einsum("kii->ki", normal)
    diagonal += 1e-14  # parallel axes, which the caller looks for
    point: Array = np.linalg.solve(normal, (across @ anchors).sum(axis=1))[..., 0].T
    return point


def _miss(axes: _Axes, k: int, point: Array) -> Array:
    """Distance of a point (3, K) from an axis, m, (K,)."""
    return _norm(_cross(point - axes.anchors[k], axes.directions[k]))

"""Task and coupling rows of a path, for many configurations at many waypoints."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import JointCouplings
from qp_twist.geometry import distinct_projectors, resolved_twist_error
from qp_twist.kernel import path_kernel
from qp_twist.kernel.arm_kernel import Arm
from qp_twist.kernel.path_kernel import Couplings, Rows
from qp_twist.kinematics import JointRanges, ParametrisedArm, SerialChain
from qp_twist.kinematics.compiled_rows import arm_of, rows_of
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import HardConstraints
from qp_twist.referee import Tolerances

Newton = tuple[int, float, float, float, float, float, float]
"""The settings of :func:`~qp_twist.kernel.path_kernel.correct`."""
Descent = tuple[int, float, float]
"""Largest number of rounds, largest step, smallest gain."""
ON_TASK = 1e-9
"""Task error at which a correction onto a waypoint ends, m and rad."""
REACHED = Tolerances()
"""Task errors up to which a configuration counts as on its waypoint where no correction ends at
:data:`ON_TASK`: what a check lets pass. Robot models have rounded angles."""
_NEAR = 0.03
"""Task error from which on it is minimised, m and rad."""
_ITERATIONS = 40
_LONGEST = 0.3
"""Largest joint displacement of a Newton step, rad or m: the rows hold only nearby."""
_TORN = 1e-6
"""Error of couplings up to which they count as kept in the nearest configuration, rad or m."""
_INSET = 1e-6
"""Distance inside a band to which configurations are corrected, rad or m."""
_RETURNS = 12
"""Largest number of steps into the bands."""
_ROUNDING = 1e-12
"""Damping as a share of the trace of AAᵀ: singular values below its root are not inverted."""


class Missed(NamedTuple):
    """The configuration that comes nearest to a waypoint."""

    q: Array
    """rad or m, (nv,)."""
    linear: float
    """Its linear task error, m."""
    angular: float
    """Its angular task error, rad."""
    shares: Array
    """These, and the error of the joint couplings, as shares of their tolerances, (3,)."""

    def __str__(self) -> str:
        also = "" if self.shares[2] <= 1.0 else ", its coupled joints apart"
        return f"{1e3 * self.linear:.3g} mm and {np.degrees(self.angular):.3g}°{also}"


class PathRows:
    """Residuals, Newton corrections and null spaces along a path.

    Joint couplings of the model are equality rows, like those of the task, and remove as many
    degrees of freedom; as narrow bands no random search would hit them. Dependent couplings are
    left out.

    Attributes:
        chain: The serial chain up to the controlled frame.
        couplings: The joint couplings.
        hard: The hard bands and the constraints of the path.
        freedom: Dimension of the null space at each waypoint, (N,).
    """

    def __init__(self, path_task: PathTask, s: Array | None = None) -> None:
        """Rows at the waypoints of a path, or at parameters s (N,) of it in their place."""
        self.chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        path = path_task.at(s)
        self.hard = HardConstraints(path_task, self.chain, path)
        self._rotations, self._positions = path.rotations, path.positions
        self._projectors, self._which = distinct_projectors(path.projectors)
        self.couplings = JointCouplings(path_task.model)
        self._coupled = self.couplings.independent()
        ranks = np.array([projector.rank for projector in self._projectors])
        free = path_task.model.nv - len(self._coupled) - ranks[self._which]
        self.freedom: Indices = np.maximum(free, 0)

    @cached_property
    def closed_forms(self) -> list[ParametrisedArm]:
        """Closed forms of the arm's inverse kinematics, for given values of some joints."""
        return ParametrisedArm.recognise(self.chain)

    @cached_property
    def _kernel(self) -> tuple[Arm, Rows, Couplings]:
        """The rows as the kernel reads them."""
        rows = rows_of(self._projectors, self._which, self._rotations, self._positions)
        return arm_of(self.chain), rows, _coupled_rows(self.couplings, self._coupled)

    def correct(
        self, q: Array, at: Indices, *, iterations: int = _ITERATIONS
    ) -> tuple[Array, Mask]:
        """Newton steps of least norm onto the waypoints.

        Where they do not converge, but come near, the task error is minimised: an arm of four or
        five joints whose model has rounded angles misses the task by as little as these, or reaches
        it exactly only far away in a joint that hardly changes the error.

        Args:
            q: Configurations, (K, nv).
            at: Index of each one's waypoint, (K,).
            iterations: Largest number of steps.

        Returns:
            The corrected configurations, (K, nv), and whether each one's task error is below
            :data:`ON_TASK`, or else within :data:`REACHED`.
        """
        q = np.array(q, order="C")
        return q, path_kernel.correct(*self._kernel, q, at, newton(iterations))

    def descend(self, q: Array, at: Indices, ranges: JointRanges, descent: Descent) -> Array:
        """Gauss-Newton steps of z from q (K, nv) along the null space; NaN where they fail."""
        q = np.array(q, order="C")
        path_kernel.centred_nearby(
            *self._kernel, q, at, ranges.weight, ranges.middle, newton(), descent
        )
        return q

    def correct_inside(
        self, q: Array, at: Indices, *, iterations: int = _ITERATIONS
    ) -> tuple[Array, Mask]:
        """As :meth:`correct`, and into the hard bands; also returns which are inside.

        Configurations outside a band take least-norm steps that keep the rows and bring the values
        back to the nearer end.
        """
        q, arrived = self.correct(q, at, iterations=iterations)
        if not self.hard:
            return q, arrived
        inside = arrived & self.hard.inside(q, at)
        left = np.flatnonzero(arrived & ~inside)
        for _ in range(_RETURNS):
            if not len(left):
                break
            back, sides = self.hard.returns(q[left], at[left], _INSET)
            step = np.zeros((len(left), q.shape[1]))
            for which, rows, errors in self._groups(q[left], at[left]):
                stacked = np.concatenate([rows, back[which]], axis=1)
                step[which] = _shortest(stacked, np.concatenate([errors, sides[which]], axis=1))
            longest = np.abs(step).max(axis=1, initial=_LONGEST)
            q[left] += step * (_LONGEST / longest)[:, None]
            q[left], arrived = self.correct(q[left], at[left], iterations=iterations)
            inside[left] = arrived & self.hard.inside(q[left], at[left])
            left = left[arrived & ~inside[left]]
        return q, inside

    def projected(self, rotations: Array, positions: Array, index: int) -> tuple[Array, Array]:
        """Poses (K, 3, 3), (K, 3) moved onto a waypoint by their task error, in what T leaves."""
        _, errors = resolved_twist_error(
            rotations,
            positions,
            np.broadcast_to(self._rotations[index], rotations.shape),
            np.broadcast_to(self._positions[index], positions.shape),
            self._projectors[self._which[index]],
        )
        turned: Array = Rotation.from_rotvec(errors[:, 3:]).as_matrix() @ rotations
        return turned, positions + errors[:, :3]

    def shortest(self, q: Array, at: Indices) -> Array:
        """The least-norm step that satisfies the rows at the waypoints, rad or m, (K, nv)."""
        steps = np.zeros(q.shape)
        for which, rows, errors in self._groups(q, at):
            steps[which] = _shortest(rows, errors)
        return steps

    def errors(self, q: Array, at: Indices) -> Array:
        """Norms of the task errors, m and rad, (K,)."""
        norms = np.zeros(len(q))
        for which, _, errors in self._groups(q, at):
            norms[which] = np.linalg.norm(errors, axis=1)
        return norms

    def nearest(self, index: int, q: Array) -> Missed:
        """The configuration nearest to a waypoint that is found from some (K, nv).

        Nearest is the one whose larger error is the least, relative to :data:`REACHED`.
        """
        q, at = np.array(q, order="C"), np.full(len(q), index)
        path_kernel.correct(*self._kernel, q, at, newton(near=np.inf))
        [(_, _, errors)] = self._groups(q, at)
        projector = self._projectors[self._which[index]]
        split, end = projector.linear.rank, projector.rank
        linear, angular, torn = (
            np.linalg.norm(part, axis=1)
            for part in (errors[:, :split], errors[:, split:end], errors[:, end:])
        )
        shares = np.array([linear / REACHED.position, angular / REACHED.axis, torn / _TORN])
        best = int(np.argmin(shares.max(axis=0)))
        return Missed(q[best], float(linear[best]), float(angular[best]), shares[:, best])

    def motions(self, q: Array, at: Indices) -> Array:
        """Orthonormal bases of the null space of the rows, (K, nv, d).

        Columns of zeros where the null space has fewer than d dimensions.
        """
        basis = np.zeros((*q.shape, int(self.freedom.max(initial=0))))
        for which, rows, _ in self._groups(q, at):
            rank = rows.shape[1]
            # The last columns of Q in Jᵀ = QR, whether or not the rows are independent.
            whole = np.linalg.qr(rows.transpose(0, 2, 1), mode="complete").Q
            basis[which, :, : max(q.shape[1] - rank, 0)] = whole[:, :, rank:]
        return basis

    def sigma_min(self, q: Array, at: Indices) -> Array:
        """Smallest singular value of the rows UᵀJ, (K,); 0 where there are none."""
        smallest = np.zeros(len(q))
        for which, rows, _ in self._groups(q, at):
            if rows.shape[1]:
                smallest[which] = np.linalg.svd(rows, compute_uv=False)[:, -1]
        return smallest

    def multipliers(self, q: Array, at: Indices, gradient: Array) -> tuple[Array, Array, Array]:
        """Sensitivity of a function with a gradient (K, nv) to the task error, at its minimum.

        Lengths of the linear and the angular multipliers and of those of couplings,
        (AAᵀ)⁻¹A · gradient with the rows A, in units of the function per m and rad, (K,) each.
        """
        linear, angular, coupled = np.zeros((3, len(q)))
        for which, rows, _ in self._groups(q, at):
            inverse = np.linalg.pinv(rows.transpose(0, 2, 1), rcond=1e-9)
            found = (inverse @ gradient[which][:, :, None])[:, :, 0]
            projector = self._projectors[self._which[at[which[0]]]]
            split, end = projector.linear.rank, projector.rank
            linear[which] = np.linalg.norm(found[:, :split], axis=1)
            angular[which] = np.linalg.norm(found[:, split:end], axis=1)
            coupled[which] = np.linalg.norm(found[:, end:], axis=1)
        return linear, angular, coupled

    def _groups(self, q: Array, at: Indices) -> list[tuple[Indices, Array, Array]]:
        """For each projector: its waypoints, and A and b of UᵀJ, UᵀΔt and the couplings."""
        found = []
        slopes = self.couplings.slopes(q)[:, self._coupled]
        torn = -self.couplings.residuals(q)[:, self._coupled]
        for number, projector in enumerate(self._projectors):
            which = np.flatnonzero(self._which[at] == number)
            if not len(which):
                continue
            rotations, positions, jacobians = self.chain.poses_and_jacobians(q[which])
            world, errors = resolved_twist_error(
                rotations,
                positions,
                self._rotations[at[which]],
                self._positions[at[which]],
                projector,
            )
            transposed = world.basis.swapaxes(-1, -2)
            found.append(
                (
                    which,
                    np.concatenate([transposed @ jacobians, slopes[which]], axis=1),
                    np.hstack([(transposed @ errors[:, :, None])[:, :, 0], torn[which]]),
                )
            )
        return found


def _coupled_rows(couplings: JointCouplings, which: Indices) -> Couplings:
    """The independent couplings, as the kernel reads them."""
    dofs = np.column_stack([couplings.first[which], couplings.second[which]]).astype(np.int64)
    return Couplings(dofs, couplings.start[which], couplings.coefficients[which])


def newton(iterations: int = _ITERATIONS, near: float = _NEAR) -> Newton:
    """Settings of Newton's method in the kernel."""
    return iterations, ON_TASK, _LONGEST, _ROUNDING, near, REACHED.position, REACHED.axis


def _shortest(rows: Array, sides: Array) -> Array:
    """Least-norm solutions (K, nv) of rows (K, r, nv) x = sides (K, r).

    Damped normal equations, x = Aᵀ(AAᵀ + λ1)⁻¹ b, in a seventh of the time of an SVD.
    """
    if not rows.size:
        return np.zeros((len(rows), rows.shape[2]))
    transposed = rows.transpose(0, 2, 1)
    normal = rows @ transposed
    diagonal = np.einsum("kii->ki", normal)
    trace = diagonal.sum(axis=1, keepdims=True)
    diagonal += np.where(trace > 0.0, _ROUNDING * trace, 1.0)  # rows of zeros
    shortest: Array = (transposed @ np.linalg.solve(normal, sides[:, :, None]))[:, :, 0]
    return shortest

"""Task and coupling rows of a path, for many configurations at many waypoints."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import JointCouplings
from qp_twist.geometry import distinct_projectors, resolved_twist_error, rotation_matrix
from qp_twist.kernel import path_kernel
from qp_twist.kernel.arm_kernel import Arm
from qp_twist.kernel.path_kernel import Couplings, Rows
from qp_twist.kinematics import JointRanges, ParametrisedArm, SerialChain
from qp_twist.kinematics.compiled_rows import arm_of, rows_of
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import HardConstraints
from qp_twist.referee import Tolerances

ON_TASK = 1e-9
"""Task error at which a correction onto a waypoint ends, m and rad."""
REACHED = Tolerances()
"""Task errors up to which a configuration counts as on its waypoint where no correction ends at
:data:`ON_TASK`: what a check lets pass. Robot models have rounded angles."""
_NEAR = 0.03
"""Task error from which on it is minimised, m and rad."""
ITERATIONS = 40
_LONGEST = 0.3
"""Largest joint displacement of a Newton step, rad or m: the rows hold only nearby."""
_TORN = 1e-6
"""Error of couplings up to which they count as kept in the nearest configuration, rad or m."""
_INSET, _RETURNS = 1e-6, 12
"""Distance inside a band to which configurations are corrected, rad or m, and steps at most."""
_ROUNDING = 1e-12
"""Damping as a share of the trace of AAᵀ: singular values below its root are not inverted."""
_ROUNDS, _LONGEST_DESCENT, _RESTARTS = 20, 0.2, 20
"""Steps of a descent of z, the largest of them, rad or m, and how often it may be restarted."""
SETTLED = 1e-9
"""A descent ends when a step would reduce z by less, to first order."""


class PathRows:
    """Residuals, Newton corrections and null spaces along a path.

    Joint couplings of the model are equality rows, like those of the task: as narrow bands no
    random search would hit them. Dependent couplings are left out.

    Attributes:
        chain: The serial chain up to the controlled frame.
        couplings: The joint couplings.
        hard: The hard bands and the constraints of the path.
        freedom: Dimension of the null space at each waypoint, (N,).
    """

    def __init__(
        self, path_task: PathTask, s: Array | None = None, moved: Array | None = None
    ) -> None:
        """Rows at the waypoints of a path, or at parameters s (N,) of it in their place.

        ``moved`` (N, 6) are small twists by which the targets are moved, m and rad; bands and
        constraints stay where they are.
        """
        self.chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        path = path_task.at(s)
        self.hard = HardConstraints(path_task, self.chain, path)
        self._rotations, self._positions = path.rotations, path.positions
        if moved is not None:
            self._positions = path.positions + moved[:, :3]
            self._rotations = rotation_matrix(moved[:, 3:]) @ path.rotations
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
        couplings, which = self.couplings, self._coupled
        dofs = np.column_stack([couplings.first[which], couplings.second[which]]).astype(np.int64)
        coupled = Couplings(dofs, couplings.start[which], couplings.coefficients[which])
        return arm_of(self.chain), rows, coupled

    def correct(
        self, q: Array, at: Indices, *, iterations: int = ITERATIONS, near: float = _NEAR
    ) -> tuple[Array, Mask]:
        """Newton steps of least norm from q (K, nv) onto the waypoints at indices (K,).

        Where they do not converge, but come ``near`` (m and rad), the task error is minimised: an
        arm of four or five joints whose model has rounded angles misses the task by as little as
        these, or reaches it exactly only far away in a joint that hardly changes the error.

        Returns:
            The corrected configurations, (K, nv), and whether each one's task error is below
            :data:`ON_TASK`, or else within :data:`REACHED`.
        """
        q = np.array(q, order="C")
        return q, path_kernel.correct(*self._kernel, q, at, _newton(iterations, near))

    def descend(
        self, q: Array, at: Indices, ranges: JointRanges, settled: float = SETTLED
    ) -> Array:
        """Local minima of z near q (K, nv), by Gauss-Newton steps along the null space, (K, nv).

        Restarted until they have converged. Joint limits are not enforced; NaN where a
        configuration has not reached its waypoint.
        """
        q, moving = np.array(q, order="C"), np.arange(len(q))
        before = np.full(len(q), np.inf)
        for _ in range(_RESTARTS):
            there = q[moving]
            path_kernel.centred_nearby(
                *self._kernel, there, at[moving], ranges.weight, ranges.middle, _newton(),
                (_ROUNDS, _LONGEST_DESCENT, settled),
            )  # fmt: skip
            q[moving] = there
            z = ranges.centering(there)
            gained = z < before - settled  # false for NaN
            moving, before = moving[gained], z[gained]
            if not len(moving):
                break
        return q

    def correct_inside(
        self, q: Array, at: Indices, *, iterations: int = ITERATIONS
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

    def correct_within(
        self, q: Array, at: Indices, lower: Array, upper: Array
    ) -> tuple[Array, Mask]:
        """As :meth:`correct_inside`, in steps that stay in a box, ``lower`` to ``upper`` (K, nv).

        Joints that would leave it stop at its end, and the others take least-norm steps.
        """
        q, arrived = np.clip(q, lower, upper), np.zeros(len(q), dtype=bool)
        left = np.arange(len(q))
        for _ in range(ITERATIONS):
            if not len(left):
                break
            back, sides = np.zeros((len(left), 0, q.shape[1])), np.zeros((len(left), 0))
            if self.hard:
                back, sides = self.hard.returns(q[left], at[left], _INSET)
            step, off = np.zeros((len(left), q.shape[1])), np.asarray(sides.any(axis=1))
            for which, rows, errors in self._groups(q[left], at[left]):
                off[which] |= np.linalg.norm(errors, axis=1) > ON_TASK
                stacked = np.concatenate([rows, back[which]], axis=1)
                within = (bound[left[which]] - q[left[which]] for bound in (lower, upper))
                aims = np.concatenate([errors, sides[which]], axis=1)
                step[which] = _shortest_within(stacked, aims, *within)
            arrived[left] = ~off
            left, step = left[off], step[off]
            longest = np.abs(step).max(axis=1, keepdims=True, initial=_LONGEST)
            q[left] = np.clip(q[left] + step * (_LONGEST / longest), lower[left], upper[left])
        return q, arrived

    def projected(self, rotations: Array, positions: Array, index: int) -> tuple[Array, Array]:
        """Poses (K, 3, 3), (K, 3) moved onto a waypoint by their task error, in what T leaves."""
        targets = (self._rotations[index], self._positions[index])
        R_d, p_d = map(np.broadcast_to, targets, (rotations.shape, positions.shape))
        projector = self._projectors[self._which[index]]
        errors = resolved_twist_error(rotations, positions, R_d, p_d, projector)[1]
        turned = rotation_matrix(errors[:, 3:]) @ rotations
        return turned, positions + errors[:, :3]

    def nearest(self, index: int, q: Array) -> tuple[float, str]:
        """By how much the nearest configuration that is found from some (K, nv) misses a waypoint.

        Its largest error relative to :data:`REACHED`, which is the least of all, and its errors in
        words.
        """
        at = np.full(len(q), index)
        q, _ = self.correct(q, at, near=np.inf)
        [(_, _, errors)] = self._groups(q, at)
        norms = self._norms(errors, index)
        shares = (norms.T / [REACHED.position, REACHED.axis, _TORN]).T
        best = int(np.argmin(shares.max(axis=0)))
        linear, angular, _ = norms[:, best]
        also = "" if shares[2, best] <= 1.0 else ", its coupled joints apart"
        words = f"{1e3 * linear:.3g} mm and {np.degrees(angular):.3g}°{also}"
        return float(shares[:, best].max()), words

    def on_task(self, q: Array, at: Indices) -> Mask:
        """Which of q (K, nv) are within :data:`REACHED` of the waypoints at indices (K,)."""
        reached = np.zeros(len(q), dtype=bool)
        for which, _, errors in self._groups(q, at):
            linear, angular, _ = self._norms(errors, int(at[which[0]]))
            reached[which] = (linear <= REACHED.position) & (angular <= REACHED.axis)
        return reached

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

    def multipliers(self, q: Array, at: Indices, gradient: Array) -> Array:
        """Sensitivity of a function with a gradient (K, nv) to the task error, at its minimum.

        Lengths of the linear and the angular multipliers and of those of couplings,
        (AAᵀ)⁻¹A · gradient with the rows A, in units of the function per m and rad, (3, K).
        """
        lengths = np.zeros((3, len(q)))
        for which, rows, _ in self._groups(q, at):
            inverse = np.linalg.pinv(rows.transpose(0, 2, 1), rcond=1e-9)
            multipliers = (inverse @ gradient[which][:, :, None])[:, :, 0]
            lengths[:, which] = self._norms(multipliers, int(at[which[0]]))
        return lengths

    def _norms(self, rows: Array, index: int) -> Array:
        """Norms of the linear, angular and coupling part of rows (K, r) of a waypoint, (3, K)."""
        projector = self._projectors[self._which[index]]
        parts = np.split(rows, [projector.linear.rank, projector.rank], axis=1)
        return np.array([np.linalg.norm(part, axis=1) for part in parts])

    def _groups(self, q: Array, at: Indices) -> Iterator[tuple[Indices, Array, Array]]:
        """For each projector: its waypoints, and A and b of UᵀJ, UᵀΔt and the couplings."""
        slopes = self.couplings.slopes(q)[:, self._coupled]
        torn = -self.couplings.residuals(q)[:, self._coupled]
        for number, projector in enumerate(self._projectors):
            which = np.flatnonzero(self._which[at] == number)
            if not len(which):
                continue
            rotations, positions, jacobians = self.chain.poses_and_jacobians(q[which])
            targets = self._rotations[at[which]], self._positions[at[which]]
            world, errors = resolved_twist_error(rotations, positions, *targets, projector)
            transposed = world.basis.swapaxes(-1, -2)
            rows = np.concatenate([transposed @ jacobians, slopes[which]], axis=1)
            yield which, rows, np.hstack([(transposed @ errors[:, :, None])[:, :, 0], torn[which]])


def _newton(iterations: int = ITERATIONS, near: float = _NEAR) -> tuple[int, *tuple[float, ...]]:
    """Settings of :func:`~qp_twist.kernel.path_kernel.correct`."""
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


def _shortest_within(rows: Array, sides: Array, lower: Array, upper: Array) -> Array:
    """Solutions x (K, nv) in a box: what least norm would take out of it is held at its end."""
    held, x = np.zeros(lower.shape, dtype=bool), np.zeros(lower.shape)
    for _ in range(lower.shape[1] + 1):
        left = sides - (rows @ np.where(held, x, 0.0)[:, :, None])[:, :, 0]
        x = np.where(held, x, _shortest(np.where(held[:, None], 0.0, rows), left))
        held, x = held | (x < lower) | (x > upper), np.clip(x, lower, upper)
    return x

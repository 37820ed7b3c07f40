"""A controller's plain step without compilation: NumPy for matrices, lists for vectors.

At six joints a NumPy call takes longer than six multiplications in a list.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.linalg import lapack

from qp_twist import fast
from qp_twist.checks import Array
from qp_twist.controller.composition import Composition
from qp_twist.controller.lean_bounds import bounds_of
from qp_twist.controller.lean_proof import Proof
from qp_twist.controller.lean_rows import BlockRows
from qp_twist.controller.posing import FASTEST, STEEPEST, unseen
from qp_twist.controller.prepared_step import PreparedStep
from qp_twist.kinematics.projector_shape import kinds_of
from qp_twist.qp.workspaces import Workspace

_BY_NUMBA = fast.installed()
"""Whether what runs with and without numba is compiled, and takes arrays instead of lists."""


class LeanStep(PreparedStep):
    """The arrays of one controller, and a backend that keeps its workspace.

    All constraints are lower ≤ Wq̇ ≤ upper, as :class:`Numbers` has them and daqp wants them.
    """

    def __init__(self, composed: Composition, solver: str, backend: Workspace) -> None:
        """As :class:`PreparedStep`; the backend is of its unknowns and rows."""
        self._backend = backend
        nv, m = composed.model.nv, sum(task.projector.rank for task in composed.twist_tasks)
        self._square, self._shift, self._threshold = np.zeros((m, m)), np.zeros((m, m)), 0.0
        self._dense = np.zeros((nv, nv))
        self._proof = Proof()
        super().__init__(composed, solver)

    def _lay_out(self, composed: Composition, room: int) -> None:
        super()._lay_out(composed, room)
        at = self._at
        addresses = self._integers[at.addresses : at.types]
        # Where every coordinate is a joint's, in the order of the joints, nothing is copied.
        self._in_order = np.array_equal(addresses, np.arange(len(self._qpos)))
        self._addresses, self._types = addresses, self._integers[at.types : at.links]
        self._costs = self._floats[at.free_costs : at.free_costs + 2].tolist()
        kinds = self._integers[at.kinds : at.ends].reshape(-1, 3)
        self._given: list[tuple[Any, ...]] = list(
            zip(kinds, self._shapes, self._poses, self._targets, strict=True)
        )
        self._blocks = [
            BlockRows(block, kind, shape, J, pose, target)
            for (kind, shape, pose, target), J in zip(self._given, self._jacobians, strict=True)
            for block in range(2)
        ]
        self._weight, self._asking = math.nan, (math.nan, math.nan)
        self._bounds = bounds_of(self._limits, self._table, self._types)

    def _take_rows(self, k: int) -> None:
        super()._take_rows(k)
        p, first = self._program, 0
        self._A, self._b = p.A, p.b
        self._equalities = slice(len(p.c), len(p.c) + p.m)
        p.lower_ends[self._equalities.stop :] = -np.inf
        self._bounding = p.lower, p.upper
        self._places: list[tuple[Array, Array]] = []
        for kinds in map(kinds_of, self._projectors):
            for kind in kinds[:2]:
                end = first + int(kind)
                self._places.append((self._A[first:end], self._b[first:end]))
                first = end

    def _take_wish(self) -> None:
        super()._take_wish()
        self._asking = math.nan, math.nan

    @np.errstate(all="ignore")  # what is not finite is refused
    def _solve(self, dt: float, use_secondary: bool) -> bool:
        q, p = self._qpos, self._program
        if not all(map(math.isfinite, q.tolist())):
            return False
        if not self._in_order:
            q = np.where(self._addresses >= 0, q[self._addresses], 0.0)
        self._state_rows(dt)
        if not self._bounds.is_current:
            self._bounds = bounds_of(self._limits, self._table, self._types)
        if not (
            self._b.dot(self._b) <= FASTEST**2
            and self._bounds.state(q, dt, *self._bounding)
            and self._well_conditioned()
        ):
            return False
        new_cost = self._state_cost(q, dt, use_secondary)
        if new_cost is None:
            return False
        found = self._backend.solve(
            self._dense, p.c, p.rows, p.lower_ends, p.upper_ends, new_cost=new_cost
        )
        if found is None:
            return False
        p.x[:], p.multipliers[:] = found
        if not self._proof.holds(p):
            return False
        if self._proof.on_bounds:
            p.lower_kind[:], p.upper_kind[:] = self._bounds.kinds()
        return True

    def tell(self, velocity: Array) -> None:
        """As :meth:`PreparedStep.tell`."""
        super().tell(velocity)
        for _, motion in self._motions:
            self._bounds.keeps(motion.velocity)

    def _state_rows(self, dt: float) -> None:
        """The rows and what they ask for."""
        self._read_jacobians()
        for turned, rotation, moved, position in self._views:
            turned[:] = rotation
            moved[:] = position
        given: list[tuple[Any, ...]] = self._given
        if not _BY_NUMBA:
            given = [tuple(array.tolist() for array in arrays) for arrays in given]
        for number, (rows, place) in enumerate(zip(self._blocks, self._places, strict=True)):
            rows.state(given[number // 2], dt, *place)
        self._program.lower_ends[self._equalities] = self._b

    def _well_conditioned(self) -> bool:
        """As the kernel of this name: AAᵀ − threshold²·1 ≻ 0, level by level."""
        A, square, threshold = self._A, self._square, self._singularity
        if len(A) > A.shape[1]:
            return False
        np.dot(A, A.T, out=square)
        if threshold != self._threshold:
            self._threshold, self._shift = threshold, threshold**2 * np.eye(len(A))
        if len(self._ends) == 1:
            square -= self._shift
            return _is_positive_definite(square)
        L, info = lapack.dpotrf(square, lower=1, clean=1)
        first, regular = 0, bool(info == 0)
        for end in self._ends.tolist():
            block = L[first:end, first:end]
            shift = self._shift[first:end, first:end]
            regular = regular and _is_positive_definite(block.dot(block.T) - shift)
            first = end
        return regular

    def _state_cost(self, q: Array, dt: float, use_secondary: bool) -> bool | None:
        """H and c = −Hḣ; whether H is another than before, ``None`` where the wish is too fast."""
        p = self._program
        if p.cost.ndim == 1:
            changed = self._weighs != self._weight
            if changed:
                self._take_weight()
            if not use_secondary:
                p.c[:] = 0.0
                return changed
            if self._others or self._asking != (dt, self._weight):
                self._asking = dt, self._weight
                self._slope = p.cost * self._pull / dt
                self._level = -p.cost * self._wish / dt - self._slope * self._ranges.middle
            np.multiply(self._slope, q, out=p.c)
            p.c[:] += self._level
            return changed if p.c.dot(p.c) <= self._steepest else None
        wish = np.zeros(len(q))
        if use_secondary:
            wish += (self._wish + self._pull * (self._ranges.middle - q)) / dt
        if not wish.dot(wish) <= FASTEST**2:
            return None
        H = self._dense
        if self._twist_space:
            self._twist_cost(wish, H)
        else:
            H[:] = np.diag(self._weighs * self._metric)
            p.c[:] = -self._weighs * self._metric * wish
        if self._soft_tasks:
            H += self._quadratic
            p.c[:] += self._linear
        p.cost[:] = H
        self._proof.take_cost(p.cost)
        steepest = float(np.abs(p.c).max())
        return True if steepest <= STEEPEST * self._proof.hardest else None

    def _take_weight(self) -> None:
        """Another ρ, and with it H = ρM."""
        p, self._weight = self._program, self._weighs
        p.cost[:] = self._weight * self._metric
        self._dense[:] = p.H
        self._proof.take_cost(p.cost)
        self._steepest = (FASTEST * float(p.cost.min())) ** 2

    def _twist_cost(self, wish: Array, H: Array) -> None:
        costs = self._costs
        free = np.vstack([rows.free_rows(costs[i % 2]) for i, rows in enumerate(self._blocks)])
        # As the reference has it: AᵀA changes no solution, but makes H better conditioned.
        np.dot(free.T, free, out=H)
        H += self._weighs * unseen(np.vstack((self._A, free)), self._metric)
        self._program.c[:] = -H.dot(wish)
        H += self._A.T.dot(self._A)


def _is_positive_definite(S: Array) -> bool:
    return bool(lapack.dpotrf(S, overwrite_a=1)[1] == 0)

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
from qp_twist.controller.posing import unseen
from qp_twist.controller.prepared_step import TOLERANCES, PreparedStep
from qp_twist.fast.bounds import bounds
from qp_twist.fast.twist_rows import BODY, FULL, LINE, NONE, PLANE, WORLD, wanted_twist
from qp_twist.qp.workspaces import Solution, Workspace

_EQUALITY, _OPTIMALITY, _GAIN, _GAP, _ROUNDING, _BOUND = TOLERANCES.tolist()
_BY_NUMBA = fast.installed()
"""Whether what runs with and without numba is compiled, and takes arrays instead of lists."""


class LeanStep(PreparedStep):
    """The arrays of one controller, and a backend that keeps its workspace."""

    def __init__(self, composed: Composition, solver: str, backend: Workspace) -> None:
        """As :class:`PreparedStep`; the backend is of its unknowns and rows."""
        super().__init__(composed, solver)
        self._backend = backend
        nv, m = composed.model.nv, sum(self._ranks)
        self._square, self._shift, self._threshold = np.zeros((m, m)), np.zeros((m, m)), 0.0
        self._dense = np.zeros((nv, nv))
        self._hardest = 0.0

    def _lay_out(self, composed: Composition, room: int) -> None:
        super()._lay_out(composed, room)
        nv, at = composed.model.nv, self._at
        fastest, noticeable, unlimited, steepest = self._settings[4:].tolist()
        self._fastest, self._steepest = fastest, steepest
        self._noticeable, self._unlimited = noticeable, unlimited
        self._addresses = self._integers[at.addresses : at.types]
        # Where every coordinate is a joint's, in the order of the joints, nothing is copied.
        self._in_order = np.array_equal(self._addresses, np.arange(len(self._qpos)))
        self._types = self._integers[at.types : at.links]
        self._middle = self._floats[at.middle : at.middle + nv]
        self._free_costs = self._floats[at.free_costs : at.free_costs + 2]
        self._kinds = self._integers[at.kinds : at.ends].reshape(-1, 3)
        self._blocks = [
            _Block(self, number, block) for number in range(len(self._ranks)) for block in range(2)
        ]
        self._weight = math.nan

    @np.errstate(over="ignore", invalid="ignore")  # what is not finite is refused
    def _solve(self, dt: float, use_secondary: bool) -> bool:
        self._read_jacobians()
        for turned, rotation, moved, position in self._views:
            turned[:] = rotation
            moved[:] = position
        p, q = self._program, self._qpos
        if not all(map(math.isfinite, q.tolist())):
            return False
        if not self._in_order:
            q = np.where(self._addresses >= 0, q[self._addresses], 0.0)
        self._wanted(dt)
        most = self._fastest**2
        if not (p.b.dot(p.b) <= most and self._bounds(q, dt) and self._well_conditioned()):
            return False
        p.c[:] = 0.0
        if use_secondary:
            p.c[:] = (self._wish + self._pull * (self._middle - q)) / dt
            if not p.c.dot(p.c) <= most:
                return False
        new_cost = self._cost()
        if len(self._linear) and not _largest(p.c) <= self._steepest * self._hardest:
            return False
        found = self._backend.solve(self._dense, p, new_cost=new_cost)
        return found is not None and self._verified(found)

    def _wanted(self, dt: float) -> None:
        """The rows and what they ask for."""
        for number, (pose, target) in enumerate(zip(self._poses, self._targets, strict=True)):
            given: tuple[Any, ...] = self._kinds[number], self._shapes[number], pose, target
            if not _BY_NUMBA:
                given = tuple(array.tolist() for array in given)
            for block in self._blocks[2 * number : 2 * number + 2]:
                block.state(given, dt)

    def _bounds(self, q: Array, dt: float) -> bool:
        p = self._program
        ends: tuple[Any, ...] = p.lower, p.upper, p.lower_kind, p.upper_kind
        given: tuple[Any, ...] = self._table, self._types, q
        if _BY_NUMBA:
            return bool(bounds(*given, dt, self._noticeable, self._unlimited, *ends))
        lists: list[list[float]] = [[0.0] * len(p.x) for _ in ends]
        given = tuple(array.tolist() for array in given)
        inside: bool = bounds(*given, dt, self._noticeable, self._unlimited, *lists)
        for end, numbers in zip(ends, lists, strict=True):
            end[:] = numbers
        return inside

    def _well_conditioned(self) -> bool:
        """As the kernel of this name: AAᵀ − threshold²·1 ≻ 0, level by level."""
        A, square = self._program.A, self._square
        if len(A) > A.shape[1]:
            return False
        np.dot(A, A.T, out=square)
        threshold = self._settings[1]
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

    def _cost(self) -> bool:
        """H, and −H ḣ in place of ḣ in c; whether H is another than in the step before."""
        p, weight, others = self._program, float(self._settings[2]), len(self._linear) > 0
        if p.cost.ndim == 1:
            changed = weight != self._weight
            if changed:
                self._weight = weight
                p.cost[:] = weight * self._metric
                self._dense[:] = p.H
                self._hardest = float(p.cost.max())
            np.multiply(p.c, -p.cost, out=p.c)
            return changed
        wish, H = p.c.copy(), self._dense
        if not self._twist_space:
            H[:] = np.diag(weight * self._metric)
            p.c[:] = -weight * self._metric * wish
        else:
            self._twist_cost(wish, H)
        if others:
            H += self._quadratic
            p.c[:] += self._linear
        p.cost[:] = H
        self._hardest = float(np.abs(H).max())
        return True

    def _twist_cost(self, wish: Array, H: Array) -> None:
        p = self._program
        free = np.vstack([block.free_rows() for block in self._blocks])
        # As the reference has it: AᵀA changes no solution, but makes H better conditioned.
        np.dot(free.T, free, out=H)
        H += self._settings[2] * unseen(np.vstack((p.A, free)), self._metric)
        p.c[:] = -H.dot(wish)
        H += p.A.T.dot(p.A)

    def _verified(self, found: Solution) -> bool:
        """Whether x, moved into the box to the last bit, is proved optimal by the multipliers.

        As ``step_kernel._excess``, and the reference's.
        """
        p = self._program
        lower, upper, box = p.lower.tolist(), p.upper.tolist(), found.box.tolist()
        # NaN is outside: the comparisons below are written so that it fails.
        x = [
            low if value < low else high if value > high else value
            for value, low, high in zip(found.x.tolist(), lower, upper, strict=True)
        ]
        p.x[:], p.box[:] = x, found.box
        pull = found.y.dot(p.A)
        residual = p.A.dot(p.x) - p.b
        explained = p.c + pull + found.box
        over = most = gain = lost = 0.0
        if len(p.g):
            np.maximum(found.rows, 0.0, out=p.lam)
            pushed = p.lam.dot(p.G)
            explained += pushed
            room = p.g - p.G.dot(p.x)
            over, most = -float(room.min()), _largest(pushed)
            gain = float(p.lam.dot(np.maximum(room, 0.0)))
            lost = _ROUNDING * float(p.lam.dot(np.abs(p.g) + np.abs(p.G).dot(np.abs(p.x))))
        if p.cost.ndim == 1:
            r = p.cost * p.x + explained
            gap = 0.5 * float(r.dot(r / p.cost))
        else:
            r = p.cost.dot(p.x) + explained
            _, solved, info = lapack.dposv(p.cost, r)
            gap = 0.5 * float(r.dot(solved)) if info == 0 else math.inf
        held = 0.0
        for value, low, high, force in zip(x, lower, upper, box, strict=True):
            if force > 0.0:
                held += force * (high - value)
            elif force < 0.0:
                held -= force * (value - low)
        gap += held - float(found.y.dot(residual))
        if len(p.g):
            gap += float(p.lam.dot(room))
            held += gain
        off, left, hardest = _largest(residual), _largest(r), self._hardest
        # All that is allowed grows with x, b and c: nearly always it is enough to take them for 0.
        if (
            off <= _EQUALITY
            and left <= _OPTIMALITY * hardest
            and held <= _GAIN * hardest
            and gap <= _GAP * hardest
            and over <= _BOUND
        ):
            return True
        steepest, reach = _largest(p.c), 1.0 + _largest(p.x)
        size = max(steepest, _largest(found.box), _largest(pull), most)
        cost = (hardest * reach + steepest) * reach
        return bool(
            off <= _EQUALITY * (1.0 + _largest(p.b))
            and left <= _OPTIMALITY * hardest * reach + _ROUNDING * size
            and held <= _GAIN * cost + lost
            and gap <= _GAP * cost + lost
            and over <= _BOUND * reach
        )


class _Block:
    """The linear (0) or angular (1) rows of one task."""

    def __init__(self, step: LeanStep, number: int, block: int) -> None:
        kinds = step._kinds[number]
        self._block, self._kind = block, int(kinds[block])
        shape = step._shapes[number, 12 * block : 12 * block + 9]
        self._basis = shape.reshape(3, 3)[:, : self._kind].copy()
        stays = kinds[2] == WORLD or self._kind in (NONE, FULL)
        turn = step._poses[number] if kinds[2] == BODY else step._targets[number]
        self._turn = None if stays else turn[:9].reshape(3, 3)
        self._J = step._jacobians[number, 3 * block : 3 * block + 3]
        first = sum(step._ranks[:number]) + (int(kinds[0]) if block else 0)
        rows = slice(first, first + self._kind)
        self._A, self._b = step._program.A[rows], step._program.b[rows]
        self._cost = float(step._free_costs[block])
        self._axis, self._velocity = (0.0, 0.0, 0.0), np.zeros(3)

    def state(self, given: tuple[Any, ...], dt: float) -> None:
        """The rows and what they ask for, from kinds, shape, pose and target of the task."""
        x, y, z, u, v, w, _ = wanted_twist(self._block, *given, dt)
        self._axis = x, y, z
        if self._kind == FULL:
            self._A[:] = self._J
            self._b[:] = u, v, w
        elif self._kind != NONE:
            basis = self._basis if self._turn is None else self._turn.dot(self._basis)
            np.dot(basis.T, self._J, out=self._A)
            self._velocity[:] = u, v, w
            self._velocity.dot(basis, out=self._b)

    def free_rows(self) -> Array:
        """√w (1 − M)J, whose squares are w Jᵀ(1 − M)J."""
        if self._kind == FULL:
            return self._J[:0]
        along = np.dot(self._axis, self._J)
        if self._kind == PLANE:
            return np.atleast_2d(self._cost * along)
        rows: Array = self._cost * self._J
        if self._kind == LINE:
            rows -= self._cost * np.outer(self._axis, along)
        return rows


def _largest(values: Array) -> float:
    """Of |values|."""
    return max(map(abs, values.tolist()), default=0.0)


def _is_positive_definite(S: Array) -> bool:
    return bool(lapack.dpotrf(S, overwrite_a=1)[1] == 0)

"""Rows of a task without compilation of the whole: scalars for errors, NumPy for matrices."""

from __future__ import annotations

from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.fast.twist_rows import BODY, FULL, LINE, NONE, PLANE, WORLD, wanted_twist


class BlockRows:
    """The linear (0) or angular (1) rows of one task."""

    def __init__(
        self, block: int, kinds: Any, shape: Array, J: Array, pose: Array, target: Array
    ) -> None:
        """For one of the two blocks.

        Args:
            block: 0 or 1.
            kinds: As ``twist_rows`` takes them.
            shape: The same.
            J: World-aligned Jacobian, (6, nv).
            pose: R (9) and p (3) of the frame.
            target: R_d (9), p_d (3) and the twist (6).
        """
        self._block, self._kind = block, int(kinds[block])
        basis = shape[12 * block : 12 * block + 9].reshape(3, 3)[:, : self._kind]
        self._basis = np.ascontiguousarray(basis.T)
        stays = kinds[2] == WORLD or self._kind in (NONE, FULL)
        turn = pose if kinds[2] == BODY else target
        self._turn = None if stays else turn[:9].reshape(3, 3).T
        self._J = J[3 * block : 3 * block + 3]
        self._axis, self._velocity = (0.0, 0.0, 0.0), np.zeros(3)

    def state(self, given: tuple[Any, ...], dt: float, A: Array, b: Array) -> None:
        """A q̇ = b from kinds, shape, pose and target of the task: UᵀJ and what is wanted of it."""
        x, y, z, u, v, w, _ = wanted_twist(self._block, *given, dt)
        self._axis = x, y, z
        if self._kind == FULL:
            A[:] = self._J
            b[:] = u, v, w
        elif self._kind != NONE:
            basis = self._basis if self._turn is None else self._basis.dot(self._turn)
            np.dot(basis, self._J, out=A)
            self._velocity[:] = u, v, w
            basis.dot(self._velocity, out=b)

    def free_rows(self, cost: float) -> Array:
        """√w (1 − M)J, whose squares are w Jᵀ(1 − M)J."""
        if self._kind == FULL:
            return self._J[:0]
        along = np.dot(self._axis, self._J)
        if self._kind == PLANE:
            return np.atleast_2d(cost * along)
        rows: Array = cost * self._J
        if self._kind == LINE:
            rows -= cost * np.outer(self._axis, along)
        return rows

"""Backends that keep their memory, and what was active, from one program to the next."""

from __future__ import annotations

import abc
import inspect
from typing import Any, NamedTuple

import numpy as np
import qpsolvers
from scipy import sparse

from qp_twist.checks import Array
from qp_twist.qp.backend import SETTINGS


class Solution(NamedTuple):
    """What a backend calls the solution, unverified, with Hx + c + Wᵀλ = 0."""

    x: Array
    multipliers: Array
    """λ, above 0 at an upper end, below at a lower one, (n + m + k,)."""


class Workspace(abc.ABC):
    """Minimise ½xᵀHx + cᵀx subject to lower ≤ Wx ≤ upper, again and again.

    Of n unknowns. W is the identity, whose ends are the bounds, with the ``rows`` below it: m
    equality rows, at least one, whose two ends are the same, and k others. With another k than
    before it begins anew.
    """

    def __init__(self, n: int, m: int) -> None:
        """Allocate; it is set up with the first program."""
        self._n, self._m, self._k = n, m, 0
        self._ready = False

    def solve(
        self, H: Array, c: Array, rows: Array, lower: Array, upper: Array, *, new_cost: bool
    ) -> Solution | None:
        """The solution as the backend has it, or ``None`` if it has none.

        ``new_cost`` tells whether H is another than in the program before.
        """
        k = len(rows) - self._m
        try:
            if self._ready and k == self._k:
                self._update(H if new_cost else None, c, rows, lower, upper)
            else:
                self._k = k
                self._set_up(H, c, rows, lower, upper)
            solution = self._solve()
        except Exception:  # each has its own, and none of them has solved it
            solution = None
        if solution is not None and not (
            _numbers(solution.x, self._n) and _numbers(solution.multipliers, len(lower))
        ):
            solution = None
        # After a program without a solution it begins anew.
        self._ready = solution is not None
        return solution

    @abc.abstractmethod
    def _set_up(self, H: Array, c: Array, rows: Array, lower: Array, upper: Array) -> None: ...

    @abc.abstractmethod
    def _update(
        self, H: Array | None, c: Array, rows: Array, lower: Array, upper: Array
    ) -> None: ...

    @abc.abstractmethod
    def _solve(self) -> Solution | None: ...


def _numbers(part: Any, size: int) -> bool:
    return isinstance(part, np.ndarray) and part.shape == (size,) and part.dtype == np.float64


class _Daqp(Workspace):
    """It has the same order: its simple bounds come first, then the rows."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        import daqp

        self._new = daqp.Model

    def _set_up(self, H: Array, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        kinds = [0] * self._n + [_DAQP_EQUALITY] * self._m + [0] * self._k
        self._model = self._new()
        self._model.setup(H, c, rows, upper, lower, np.array(kinds, dtype=np.int32))
        self._model.settings = {**self._model.settings, **SETTINGS["daqp"]}

    def _update(self, H: Array | None, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        self._model.update(H, c, rows, upper, lower)

    def _solve(self) -> Solution | None:
        x, _, status, told = self._model.solve()
        return Solution(x, told["lam"]) if status > 0 else None


_DAQP_EQUALITY = 5
"""DAQP's mark of a row that is always active, and stays so."""


class _ProxQp(Workspace):
    """The dense solver, with the bounds as a box."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        from proxsuite import proxqp

        self._proxqp = proxqp

    def _set_up(self, H: Array, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        self._model = self._proxqp.dense.QP(self._n, self._m, self._k, True)
        for name, value in SETTINGS["proxqp"].items():
            setattr(self._model.settings, name, value)
        guess = self._proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._model.settings.initial_guess = guess
        self._model.init(H, c, *self._parts(rows, lower, upper))

    def _update(self, H: Array | None, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        self._model.update(H, c, *self._parts(rows, lower, upper))

    def _parts(self, rows: Array, lower: Array, upper: Array) -> tuple[Array | None, ...]:
        """Equality rows with their right-hand side, inequality rows with theirs, bounds."""
        n, m = self._n, self._m
        between: tuple[Array | None, ...] = (rows[m:], lower[n + m :], upper[n + m :])
        if not self._k:
            between = (None, None, None)
        return rows[:m], upper[n : n + m], *between, lower[:n], upper[:n]

    def _solve(self) -> Solution | None:
        self._model.solve()
        results, k = self._model.results, self._k
        if results.info.status != self._proxqp.QPSolverOutput.PROXQP_SOLVED:
            return None
        # A copy, as the next solve overwrites them.
        multipliers = np.concatenate((results.z[k:], results.y, results.z[:k]))
        return Solution(results.x.copy(), multipliers)


class _Osqp(Workspace):
    """All constraints are rows, those of the bounds behind the others."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        import osqp

        self._osqp = osqp
        # Newer versions warn where they are not told that a status is enough.
        told = "raise_error" in inspect.signature(osqp.OSQP.solve).parameters
        self._quietly: dict[str, bool] = {"raise_error": False} if told else {}
        self._columns_of_upper, self._rows_of_upper = np.tril_indices(n)

    def _set_up(self, H: Array, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        count, n = rows.shape
        self._entries = np.ones((count + 1, n))
        pattern = sparse.vstack([sparse.csc_matrix(np.ones((count, n))), sparse.eye(n)], "csc")
        pattern.data[:] = self._columns(rows)
        cost = sparse.csc_matrix(np.triu(np.ones_like(H)))
        cost.data[:] = self._upper(H)
        self._model = self._osqp.OSQP()
        ends = self._turned(lower), self._turned(upper)
        self._model.setup(cost, c, pattern, *ends, verbose=False, **SETTINGS["osqp"])

    def _update(self, H: Array | None, c: Array, rows: Array, lower: Array, upper: Array) -> None:
        cost: dict[str, Any] = {} if H is None else {"Px": self._upper(H)}
        low, high = self._turned(lower), self._turned(upper)
        self._model.update(q=c, l=low, u=high, Ax=self._columns(rows), **cost)

    def _turned(self, ends: Array) -> Array:
        """Those of the bounds last."""
        return np.concatenate((ends[self._n :], ends[: self._n]))

    def _columns(self, rows: Array) -> Array:
        """Entries column by column, each with the one of its bound behind it."""
        self._entries[:-1] = rows
        return self._entries.T.ravel()

    def _upper(self, H: Array) -> Array:
        """Of the upper triangle, column by column."""
        entries: Array = H[self._rows_of_upper, self._columns_of_upper]
        return entries

    def _solve(self) -> Solution | None:
        result = self._model.solve(**self._quietly)
        if result.info.status != "solved":
            return None
        y, rows = result.y, self._m + self._k
        return Solution(result.x.copy(), np.concatenate((y[rows:], y[:rows])))


KNOWN: dict[str, type[Workspace]] = {"daqp": _Daqp, "proxqp": _ProxQp, "osqp": _Osqp}
"""Those that keep one, by name."""


def workspace(solver: str, n: int, m: int) -> Workspace | None:
    """One of a backend, or ``None`` where it keeps none."""
    if solver not in KNOWN or solver not in qpsolvers.available_solvers or m == 0:
        return None
    return KNOWN[solver](n, m)

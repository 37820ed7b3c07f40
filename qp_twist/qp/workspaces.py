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
    """What a backend calls the solution, unverified, with Hx + c + Aᵀy + μ = 0."""

    x: Array
    y: Array
    box: Array
    """μ, above 0 at an upper bound, below at a lower one, (n,)."""


class Workspace(abc.ABC):
    """Minimise ½xᵀHx + cᵀx subject to Ax = b, lower ≤ x ≤ upper, again and again.

    Of n unknowns and m rows, at least one.
    """

    def __init__(self, n: int, m: int) -> None:
        """Allocate; it is set up with the first program."""
        self._n, self._m = n, m
        self._ready = False

    def solve(
        self, H: Array, c: Array, A: Array, b: Array, lower: Array, upper: Array, *, new_cost: bool
    ) -> Solution | None:
        """The solution as the backend has it, or ``None`` if it has none.

        ``new_cost`` tells whether H is another than in the program before.
        """
        try:
            if self._ready:
                self._update(H if new_cost else None, c, A, b, lower, upper)
            else:
                self._set_up(H, c, A, b, lower, upper)
            solution = self._solve()
        except Exception:  # each has its own, and none of them has solved it
            solution = None
        if solution is not None and not self._is_one(solution):
            solution = None
        # After a program without a solution it begins anew.
        self._ready = solution is not None
        return solution

    def _is_one(self, solution: Solution) -> bool:
        """Whether it is made of numbers, as many as there are."""
        x, y, box = solution
        return _numbers(x, self._n) and _numbers(y, self._m) and _numbers(box, self._n)

    @abc.abstractmethod
    def _set_up(
        self, H: Array, c: Array, A: Array, b: Array, lower: Array, upper: Array
    ) -> None: ...

    @abc.abstractmethod
    def _update(
        self, H: Array | None, c: Array, A: Array, b: Array, lower: Array, upper: Array
    ) -> None: ...

    @abc.abstractmethod
    def _solve(self) -> Solution | None: ...


def _numbers(part: Any, size: int) -> bool:
    return isinstance(part, np.ndarray) and part.dtype == np.float64 and part.shape == (size,)


class _Daqp(Workspace):
    """Its simple bounds come first, then the rows."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        import daqp

        self._new = daqp.Model
        self._ends = np.zeros((2, n + m))
        self._sense = np.array([0] * n + [_DAQP_EQUALITY] * m, dtype=np.int32)

    def _set_up(self, H: Array, c: Array, A: Array, b: Array, lower: Array, upper: Array) -> None:
        self._model = self._new()
        above, below = self._between(b, lower, upper)
        self._model.setup(H, c, A, above, below, self._sense)
        self._model.settings = {**self._model.settings, **SETTINGS["daqp"]}

    def _update(
        self, H: Array | None, c: Array, A: Array, b: Array, lower: Array, upper: Array
    ) -> None:
        above, below = self._between(b, lower, upper)
        self._model.update(H, c, A, above, below)

    def _between(self, b: Array, lower: Array, upper: Array) -> Array:
        ends, n = self._ends, self._n
        ends[0, :n], ends[1, :n], ends[:, n:] = upper, lower, b
        return ends

    def _solve(self) -> Solution | None:
        x, _, status, told = self._model.solve()
        if status <= 0:
            return None
        multipliers = told["lam"]
        return Solution(x, multipliers[self._n :], multipliers[: self._n])


_DAQP_EQUALITY = 5
"""DAQP's mark of a row that is always active, and stays so."""


class _ProxQp(Workspace):
    """The dense solver, with the bounds as a box."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        from proxsuite import proxqp

        self._proxqp = proxqp

    def _set_up(self, H: Array, c: Array, A: Array, b: Array, lower: Array, upper: Array) -> None:
        self._model = self._proxqp.dense.QP(self._n, self._m, 0, True)
        for name, value in SETTINGS["proxqp"].items():
            setattr(self._model.settings, name, value)
        guess = self._proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._model.settings.initial_guess = guess
        self._model.init(H, c, A, b, None, None, None, lower, upper)

    def _update(
        self, H: Array | None, c: Array, A: Array, b: Array, lower: Array, upper: Array
    ) -> None:
        self._model.update(H, c, A, b, None, None, None, lower, upper)

    def _solve(self) -> Solution | None:
        self._model.solve()
        results = self._model.results
        if results.info.status != self._proxqp.QPSolverOutput.PROXQP_SOLVED:
            return None
        # Copies: the next solve overwrites them.
        return Solution(results.x.copy(), results.y.copy(), results.z[-self._n :].copy())


class _Osqp(Workspace):
    """All constraints are rows, those of the bounds behind the others."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        import osqp

        self._osqp = osqp
        # Newer versions warn where they are not told that a status is enough.
        told = "raise_error" in inspect.signature(osqp.OSQP.solve).parameters
        self._quietly: dict[str, bool] = {"raise_error": False} if told else {}
        self._entries = np.ones((m + 1, n))
        self._ends = np.zeros((2, m + n))
        self._columns_of_upper, self._rows_of_upper = np.tril_indices(n)
        self._pattern = sparse.vstack([sparse.csc_matrix(np.ones((m, n))), sparse.eye(n)], "csc")

    def _set_up(self, H: Array, c: Array, A: Array, b: Array, lower: Array, upper: Array) -> None:
        low, high = self._between(b, lower, upper)
        rows = self._pattern.copy()
        rows.data[:] = self._columns(A)
        cost = sparse.csc_matrix(np.triu(np.ones_like(H)))
        cost.data[:] = self._upper(H)
        self._model = self._osqp.OSQP()
        self._model.setup(cost, c, rows, low, high, verbose=False, **SETTINGS["osqp"])

    def _update(
        self, H: Array | None, c: Array, A: Array, b: Array, lower: Array, upper: Array
    ) -> None:
        low, high = self._between(b, lower, upper)
        cost: dict[str, Any] = {} if H is None else {"Px": self._upper(H)}
        self._model.update(q=c, l=low, u=high, Ax=self._columns(A), **cost)

    def _columns(self, A: Array) -> Array:
        """Entries column by column, each with the one of its bound behind it."""
        self._entries[:-1] = A
        return self._entries.T.ravel()

    def _upper(self, H: Array) -> Array:
        """Of the upper triangle, column by column."""
        entries: Array = H[self._rows_of_upper, self._columns_of_upper]
        return entries

    def _between(self, b: Array, lower: Array, upper: Array) -> Array:
        ends, m = self._ends, self._m
        ends[:, :m], ends[0, m:], ends[1, m:] = b, lower, upper
        return ends

    def _solve(self) -> Solution | None:
        result = self._model.solve(**self._quietly)
        if result.info.status != "solved":
            return None
        return Solution(result.x.copy(), result.y[: self._m].copy(), result.y[self._m :].copy())


KNOWN: dict[str, type[Workspace]] = {"daqp": _Daqp, "proxqp": _ProxQp, "osqp": _Osqp}
"""Those that keep one, by name."""


def workspace(solver: str, n: int, m: int) -> Workspace | None:
    """One of a backend, or ``None`` where it keeps none."""
    if solver not in KNOWN or solver not in qpsolvers.available_solvers or m == 0:
        return None
    return KNOWN[solver](n, m)

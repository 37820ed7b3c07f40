"""Backends that keep their memory, and what was active, from one program to the next."""

from __future__ import annotations

import abc
import inspect
from typing import Any, NamedTuple, Protocol

import numpy as np
import qpsolvers
from scipy import sparse

from qp_twist.checks import Array
from qp_twist.qp.backend import SETTINGS


class Solution(NamedTuple):
    """What a backend calls the solution, unverified, with Hx + c + Aᵀy + Gᵀλ + μ = 0."""

    x: Array
    y: Array
    rows: Array
    """λ, at least 0, (k,)."""
    box: Array
    """μ, above 0 at an upper bound, below at a lower one, (n,)."""


class Program(Protocol):
    """What is solved; the arrays may be the same ones every time, with other numbers."""

    @property
    def c(self) -> Array:
        """Linear cost, (n,)."""

    @property
    def A(self) -> Array:
        """Equality rows, (m, n)."""

    @property
    def b(self) -> Array:
        """Right-hand side, (m,)."""

    @property
    def G(self) -> Array:
        """Inequality rows, (k, n)."""

    @property
    def g(self) -> Array:
        """Right-hand side, (k,)."""

    @property
    def lower(self) -> Array:
        """Lower bounds, −∞ where there is none, (n,)."""

    @property
    def upper(self) -> Array:
        """Upper bounds, (n,)."""


class Workspace(abc.ABC):
    """Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper, again and again.

    Of n unknowns and m equality rows, at least one. With another number of inequality rows than
    before it begins anew.
    """

    def __init__(self, n: int, m: int) -> None:
        """Allocate; it is set up with the first program."""
        self._n, self._m, self._k = n, m, 0
        self._ready = False

    def solve(self, H: Array, p: Program, *, new_cost: bool) -> Solution | None:
        """The solution as the backend has it, or ``None`` if it has none.

        ``new_cost`` tells whether H is another than in the program before.
        """
        try:
            if self._ready and len(p.g) == self._k:
                self._update(H if new_cost else None, p)
            else:
                self._k = len(p.g)
                self._set_up(H, p)
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
        sizes = self._n, self._m, self._k, self._n
        return all(map(_numbers, solution, sizes))

    @abc.abstractmethod
    def _set_up(self, H: Array, p: Program) -> None: ...

    @abc.abstractmethod
    def _update(self, H: Array | None, p: Program) -> None: ...

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

    def _set_up(self, H: Array, p: Program) -> None:
        n, m, k = self._n, self._m, self._k
        self._ends, self._rows = np.full((2, n + m + k), -np.inf), np.zeros((m + k, n))
        sense = np.array([0] * n + [_DAQP_EQUALITY] * m + [0] * k, dtype=np.int32)
        self._model = self._new()
        above, below = self._between(p)
        self._model.setup(H, p.c, self._stacked(p), above, below, sense)
        self._model.settings = {**self._model.settings, **SETTINGS["daqp"]}

    def _update(self, H: Array | None, p: Program) -> None:
        above, below = self._between(p)
        self._model.update(H, p.c, self._stacked(p), above, below)

    def _stacked(self, p: Program) -> Array:
        if not self._k:
            return p.A
        self._rows[: self._m], self._rows[self._m :] = p.A, p.G
        return self._rows

    def _between(self, p: Program) -> Array:
        ends, n, end = self._ends, self._n, self._n + self._m
        ends[0, :n], ends[1, :n], ends[:, n:end] = p.upper, p.lower, p.b
        if self._k:
            ends[0, end:] = p.g
        return ends

    def _solve(self) -> Solution | None:
        x, _, status, told = self._model.solve()
        if status <= 0:
            return None
        multipliers, n, end = told["lam"], self._n, self._n + self._m
        return Solution(x, multipliers[n:end], multipliers[end:], multipliers[:n])


_DAQP_EQUALITY = 5
"""DAQP's mark of a row that is always active, and stays so."""


class _ProxQp(Workspace):
    """The dense solver, with the bounds as a box."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        from proxsuite import proxqp

        self._proxqp = proxqp

    def _set_up(self, H: Array, p: Program) -> None:
        self._model = self._proxqp.dense.QP(self._n, self._m, self._k, True)
        for name, value in SETTINGS["proxqp"].items():
            setattr(self._model.settings, name, value)
        guess = self._proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._model.settings.initial_guess = guess
        self._model.init(H, p.c, p.A, p.b, *self._inequalities(p), p.lower, p.upper)

    def _update(self, H: Array | None, p: Program) -> None:
        self._model.update(H, p.c, p.A, p.b, *self._inequalities(p), p.lower, p.upper)

    def _inequalities(self, p: Program) -> tuple[Array | None, Array | None, Array | None]:
        return (p.G, np.full(self._k, -np.inf), p.g) if self._k else (None, None, None)

    def _solve(self) -> Solution | None:
        self._model.solve()
        results = self._model.results
        if results.info.status != self._proxqp.QPSolverOutput.PROXQP_SOLVED:
            return None
        # Copies: the next solve overwrites them.
        z = results.z.copy()
        return Solution(results.x.copy(), results.y.copy(), z[: self._k], z[self._k :])


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

    def _set_up(self, H: Array, p: Program) -> None:
        n, count = self._n, self._m + self._k
        self._entries, self._ends = np.ones((count + 1, n)), np.full((2, count + n), -np.inf)
        rows = sparse.vstack([sparse.csc_matrix(np.ones((count, n))), sparse.eye(n)], "csc")
        rows.data[:] = self._columns(p)
        cost = sparse.csc_matrix(np.triu(np.ones_like(H)))
        cost.data[:] = self._upper(H)
        low, high = self._between(p)
        self._model = self._osqp.OSQP()
        self._model.setup(cost, p.c, rows, low, high, verbose=False, **SETTINGS["osqp"])

    def _update(self, H: Array | None, p: Program) -> None:
        low, high = self._between(p)
        cost: dict[str, Any] = {} if H is None else {"Px": self._upper(H)}
        self._model.update(q=p.c, l=low, u=high, Ax=self._columns(p), **cost)

    def _columns(self, p: Program) -> Array:
        """Entries column by column, each with the one of its bound behind it."""
        self._entries[: self._m], self._entries[self._m : -1] = p.A, p.G
        return self._entries.T.ravel()

    def _upper(self, H: Array) -> Array:
        """Of the upper triangle, column by column."""
        entries: Array = H[self._rows_of_upper, self._columns_of_upper]
        return entries

    def _between(self, p: Program) -> Array:
        ends, m, end = self._ends, self._m, self._m + self._k
        ends[:, :m], ends[1, m:end], ends[0, end:], ends[1, end:] = p.b, p.g, p.lower, p.upper
        return ends

    def _solve(self) -> Solution | None:
        result = self._model.solve(**self._quietly)
        if result.info.status != "solved":
            return None
        y, m, end = result.y.copy(), self._m, self._m + self._k
        return Solution(result.x.copy(), y[:m], y[m:end], y[end:])


KNOWN: dict[str, type[Workspace]] = {"daqp": _Daqp, "proxqp": _ProxQp, "osqp": _Osqp}
"""Those that keep one, by name."""


def workspace(solver: str, n: int, m: int) -> Workspace | None:
    """One of a backend, or ``None`` where it keeps none."""
    if solver not in KNOWN or solver not in qpsolvers.available_solvers or m == 0:
        return None
    return KNOWN[solver](n, m)

"""Any solver of qpsolvers by its name, at settings that suit a robot's step."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import qpsolvers

from qp_twist.checks import Array, did_you_mean, largest
from qp_twist.errors import InvalidInput, UnknownSolver
from qp_twist.kernel import COMPILED
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import Multipliers

# Defaults of first-order solvers are made for large problems: OSQP calls a step solved at 11 times
# its velocity limit, ProxQP stops at an error of 1e-3, and without its duality gap at points with
# 1e7 times the gradient allowed. DAQP says infeasible where rows fix a bound's unknown up to an
# angle of 3e-6 (``sing_tol`` is its square).
SETTINGS: dict[str, dict[str, Any]] = {
    "daqp": {"sing_tol": 1e-14},
    "proxqp": {
        "eps_abs": 1e-9,
        "eps_rel": 0.0,
        "max_iter": 200,
        "check_duality_gap": True,
        "eps_duality_gap_abs": 1e-9,
        # Its own 1e-4 calls 1.7 % of steps that have to be slowed down infeasible.
        "eps_primal_inf": 1e-9,
    },
    "osqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 20_000, "polishing": True},
    "clarabel": {"tol_feas": 1e-9, "tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9},
    "piqp": {"eps_abs": 1e-10, "eps_rel": 0.0},
}
DUST = 1e-12
"""Rows shorter than this share of the longest are rounding."""


class RawSolution(NamedTuple):
    """What a backend returned, before anybody has checked it."""

    x: Array | None
    """The unknowns, (n,); ``None`` where the backend gave nothing."""
    found: bool
    """Whether the backend calls it solved."""
    multipliers: Multipliers
    """What it claims for multipliers."""


def installed_solvers() -> list[str]:
    """Every backend that can be asked, our own compiled one among them."""
    return [*qpsolvers.available_solvers, COMPILED]


def check_solver(solver: str | None) -> str:
    """``solver`` if it can be asked; the compiled one if it is ``None``; else ``UnknownSolver``."""
    if solver is None:
        return COMPILED
    installed = installed_solvers()
    if not isinstance(solver, str) or solver not in installed:
        hint = did_you_mean(str(solver), installed)
        raise UnknownSolver(
            f"solver {solver!r} is not installed or not known{hint} Installed: "
            f"{', '.join(installed)}. Others come with qpsolvers' extras, e.g. pip install "
            "'qpsolvers[clarabel]'."
        )
    return solver


def solve_raw(
    problem: QuadraticProgram, solver: str, options: Mapping[str, Any] | None = None
) -> RawSolution:
    """Hand a problem to a backend, with rows of length one and costs of size one.

    DAQP drops equality rows shorter than 3e-6 and calls the rest solved; at length one a row cannot
    be dropped. A row of zeros cannot be scaled and is left to the verification. First-order
    backends need costs of a size that their tolerances were made for.

    ``options`` take the place of our settings; one that the backend does not know is refused.
    """
    size = problem.steepest or 1.0
    # Active-set methods take differences of terms of the size of c: 1e-14 of it is rounding. What
    # quadprog counts as zero cannot be set: it gets the unknowns in units in which c is one.
    steep = max(1.0, largest(problem.c) / size)
    A, b, equality_lengths = _unit_rows(problem.A, problem.b)
    G, g, row_lengths = _unit_rows(problem.G, problem.g)
    c, lower, upper, unit = problem.c / size, problem.lower, problem.upper, 1.0
    if solver == "quadprog" and steep > 1.0:
        unit = steep
        c, b, g, lower, upper = (values / unit for values in (c, b, g, lower, upper))
    posed = problem.H / size, c, A, b, G, g, lower, upper
    settings = dict(SETTINGS.get(solver, {}))
    if solver == "daqp":  # its own 1e-6 on bounds is a visible angle
        settings["primal_tol"] = settings["dual_tol"] = max(1e-11, 1e-14 * steep)
    if solver == "osqp" and not len(b):
        # Without an active row OSQP says on standard output that it has nothing to polish.
        settings["polishing"] = False
    settings |= options or {}
    if solver == COMPILED and settings:
        raise InvalidInput(f"solver 'compiled' has no options; got {settings}.")
    try:
        solution = _asked(posed, solver, settings)
    except Exception as error:
        if options and isinstance(error, (TypeError, ValueError, AttributeError)):
            raise InvalidInput(
                f"solver {solver!r} does not take the options {dict(options)}: {error}"
            ) from error
        # A backend that refuses a problem has not solved it; the caller decides what follows.
        # Each raises exceptions of its own (OSQP's are neither ValueError nor qpsolvers').
        return RawSolution(None, False, Multipliers.none(problem))
    y, cost = _multipliers(solution.y, len(b)), size * unit
    # Copies: some backends return views of memory that the next solve overwrites.
    multipliers = Multipliers(
        cost * y / equality_lengths,
        cost * _multipliers(solution.z, len(g)) / row_lengths if len(g) else g,
        cost * _multipliers(solution.z_box, problem.n),
    )
    x = _numbers(solution.x)
    if x is not None and unit != 1.0:
        x *= unit
    return RawSolution(x, bool(solution.found), multipliers)


def _asked(posed: tuple[Array, ...], solver: str, settings: dict[str, Any]) -> Any:
    """The backend's answer to a program of these arrays."""
    H, c, A, b, G, g, lower, upper = posed
    if solver == COMPILED:
        from qp_twist.kernel.one_program import solve_program  # with numba

        return solve_program(*map(np.ascontiguousarray, posed))
    if solver == "proxqp":
        return _proxqp(posed, settings)
    problem = qpsolvers.Problem(
        H, c, G if len(g) else None, g if len(g) else None, A if len(b) else None,
        b if len(b) else None, lower if np.count_nonzero(lower > -np.inf) else None,
        upper if np.count_nonzero(upper < np.inf) else None,
    )  # fmt: skip
    if solver != "osqp":
        return qpsolvers.solve_problem(problem, solver=solver, **settings)
    with warnings.catch_warnings():
        # OSQP's wrapper warns of its sparse conversion, and of each infeasible problem.
        warnings.simplefilter("ignore")
        return qpsolvers.solve_problem(problem, solver=solver, **settings)


def _proxqp(posed: tuple[Array, ...], settings: dict[str, Any]) -> Any:
    """ProxQP's answer; by qpsolvers its tolerance of infeasibility cannot be set."""
    from proxsuite import proxqp

    H, c, A, b, G, g, lower, upper = posed
    asked = proxqp.dense.QP(len(c), len(b), len(g), True)
    for name, value in settings.items():
        if not hasattr(asked.settings, name):
            raise AttributeError(f"ProxQP has no setting {name!r}")
        setattr(asked.settings, name, value)
    asked.init(H, c, A, b, G, np.full(len(g), -np.inf), g, lower, upper)
    asked.solve()
    of, solution = asked.results, qpsolvers.Solution(qpsolvers.Problem(H, c))
    solution.found = of.info.status == proxqp.QPSolverOutput.PROXQP_SOLVED
    solution.x, solution.y = of.x, of.y
    solution.z, solution.z_box = of.z[: len(g)], of.z[len(g) :]
    return solution


def _unit_rows(rows: Array, bounds: Array) -> tuple[Array, Array, Array]:
    """Rows and right-hand sides divided by the rows' lengths, and the lengths."""
    if not len(bounds):
        return rows, bounds, bounds
    lengths = np.sqrt(np.add.reduce(rows * rows, axis=1))
    # A row of rounding dust, such as that of a direction in which the arm cannot move, stays dust:
    # stretched to length one it would contradict the others.
    lengths[lengths <= DUST * largest(lengths)] = 1.0
    return rows / lengths[:, None], bounds / lengths, lengths


def _multipliers(values: Any, size: int) -> Array:
    numbers = _numbers(values)
    return np.zeros(size) if numbers is None or numbers.shape != (size,) else numbers


def _numbers(values: Any) -> Array | None:
    """A copy as numbers, ``None`` where a backend returned anything else."""
    try:
        return None if values is None else np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None

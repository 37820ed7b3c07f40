"""Strict priorities on arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, float_array, one_of, within
from qp_twist.constraints import BindingLimit
from qp_twist.errors import InvalidInput
from qp_twist.qp.backend import check_solver
from qp_twist.qp.directions import Directions
from qp_twist.qp.failures import InfeasibleStep, SolverInaccurate
from qp_twist.qp.levels import INNER, Cascade, Level
from qp_twist.qp.one_program import Found, first_level
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.solve import Refused, solve_within

OnInfeasible = Literal["scale", "relax", "raise"]

LARGEST = 1e12
"""Largest entry that is taken; a bound beyond it counts as none."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What :func:`solve_levels` returns."""

    x: Array
    """The unknowns, inside the bounds, (n,)."""
    scale: float
    """s of the first level; 1 where it is met, or was relaxed."""
    residuals: tuple[Array, ...]
    """For each level A x − s b (s = 1 below the first level), (m,) each."""
    binding: tuple[BindingLimit, ...]
    """The bounds that keep a level from being met; entry i of x is called ``"x[i]"``."""
    gaps: tuple[float, ...]
    """For each level, by how much its residual may be longer than at its optimum, in the unit of
    its rows."""
    proven: bool
    """Whether every gap is at most 1e-7 (longest row + max |b|) of its level. If not, a level has
    rows that nearly depend on each other, and what it leaves to the levels below is decided by
    rounding: state such rows once, or in one level."""


def solve_levels(
    levels: Sequence[Any],
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    on_infeasible: OnInfeasible = "scale",
    solver: str = "daqp",
    reference: npt.ArrayLike | None = None,
) -> Solution:
    r"""Lexicographic least squares inside bounds.

    .. math::

        \operatorname{lex\,min}\; \lVert\mathbf A_1 x - s\,\mathbf b_1\rVert,\;
        \lVert\mathbf A_2 x - \mathbf b_2\rVert, \dots,\; \lVert x - \mathbf x_{ref}\rVert
        \quad\text{s.t.}\quad lower \le x \le upper

    A level never changes what the levels above it achieved, under active bounds too (the hierarchy
    of Escande, Mansard and Wieber, IJRR 33(7), 2014, here by a cascade of quadratic programs in
    the null space of what is held). Without bounds it is the recursive null-space formula of
    Siciliano and Slotine (1991).

    Args:
        levels: ``(A, b)`` for each level, most important first, A (m, n) and b (m,); or
            ``(A, b, G, g)`` with rows G x ≤ g at the same level, whose excess counts like a
            residual.
        lower: Lower bounds, −∞ where there is none, (n,); so is one below −1e12.
        upper: Upper bounds, (n,).
        on_infeasible: Where the first level does not fit: ``"scale"`` finds the largest s in
            [0, 1], ``"relax"`` the closest point, ``"raise"`` raises :class:`InfeasibleStep`.
            Lower levels are always relaxed.
        solver: Backend of the program that is left after the levels, min ‖x − x_ref‖².
        reference: x_ref, (n,); zero if ``None``.

    Raises:
        InvalidInput: If an argument has the wrong shape, number or order.
        SolverInaccurate: If the backend's result could not be verified.

    Example:
        >>> import numpy as np, qp_twist as qt
        >>> up, sum_ = (np.eye(2)[:1], [1.0]), (np.ones((1, 2)), [3.0])
        >>> solution = qt.solve_levels([up, sum_], [-1.0, -1.0], [1.0, 1.0])
        >>> solution.x, solution.residuals[1]
        (array([1., 1.]), array([-1.]))
    """
    low, high = _bounds(lower, upper)
    n = len(low)
    parsed = _levels(levels, n)
    one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
    check_solver(solver)
    desired = np.zeros(n) if reference is None else _array("reference", reference, (n,))
    problem = QuadraticProgram(
        np.eye(n), -desired, parsed[0].A, parsed[0].b, parsed[0].G, parsed[0].g, low, high
    )
    scale, start, multipliers = 1.0, np.clip(desired, low, high), None
    if on_infeasible != "relax" and not parsed[0].met(Cascade(parsed[:1], low, high, start).x):
        unit = parsed[0].size or 1.0
        whole = Directions.as_stated(parsed[0].A / unit, parsed[0].b / unit)
        found = first_level(problem, whole, "scale", INNER, whole=False)
        if on_infeasible == "raise":
            raise InfeasibleStep(
                "infeasible: the first level does not fit inside the bounds"
                + (f"; {found.scale:.4g} of it does." if isinstance(found, Found) else "."),
                problem,
            )
        if isinstance(found, Found):
            scale, start, multipliers = found.scale, found.x, found.box
            parsed[0] = replace(parsed[0], b=scale * parsed[0].b)
    cascade = Cascade(parsed, low, high, start)
    result = solve_within(problem, cascade, solver)
    if isinstance(result, Refused):
        raise SolverInaccurate(f"solve_levels: {result.says}.", problem)
    gaps = cascade.gaps(result.x)
    return Solution(
        result.x,
        scale,
        tuple(level.A @ result.x - level.b for level in parsed),
        _binding(cascade.box_multipliers if multipliers is None else multipliers),
        gaps,
        all(level.proven(gap) for level, gap in zip(parsed, gaps, strict=True)),
    )


def _binding(box: Array) -> tuple[BindingLimit, ...]:
    active = np.flatnonzero(np.abs(box) > 1e-9 * np.abs(box).max(initial=0.0))
    return tuple(
        BindingLimit(f"x[{i}]", "bound", "upper" if box[i] > 0.0 else "lower", float(abs(box[i])))
        for i in active
    )


def _bounds(lower: npt.ArrayLike, upper: npt.ArrayLike) -> tuple[Array, Array]:
    low, high = float_array("lower", lower), float_array("upper", upper)
    if low.ndim != 1 or low.shape != high.shape or not len(low):
        raise InvalidInput(
            f"solve_levels: lower and upper need one shape (n,), got {low.shape} and {high.shape}."
        )
    sensible = (low <= high) & (low <= LARGEST) & (high >= -LARGEST)
    if not sensible.all():
        wrong = int(np.argmin(sensible))
        raise InvalidInput(
            f"solve_levels: bounds of x[{wrong}] are {low[wrong]:g} … {high[wrong]:g}; the lower "
            f"one must not be above the upper one, nor a bound beyond {LARGEST:g} exclude the rest."
        )
    return np.where(low < -LARGEST, -np.inf, low), np.where(high > LARGEST, np.inf, high)


def _array(name: str, value: npt.ArrayLike, shape: tuple[int | None, ...]) -> Array:
    return within(name, finite_array(name, value, shape), LARGEST)


def _levels(levels: Sequence[Any], n: int) -> list[Level]:
    if not isinstance(levels, (list, tuple)) or not levels:
        raise InvalidInput(f"solve_levels: expected a list of levels (A, b), got {levels!r}."[:300])
    parsed = []
    for k, level in enumerate(levels):
        if not isinstance(level, (list, tuple)) or len(level) not in (2, 4):
            raise InvalidInput(f"levels[{k}]: expected (A, b) or (A, b, G, g).")
        A = _array(f"levels[{k}] A", level[0], (None, n))
        b = _array(f"levels[{k}] b", level[1], (len(A),))
        G, g = np.zeros((0, n)), np.zeros(0)
        if len(level) == 4:
            G = _array(f"levels[{k}] G", level[2], (None, n))
            g = _array(f"levels[{k}] g", level[3], (len(G),))
        parsed.append(Level(A, b, G, g))
    return parsed

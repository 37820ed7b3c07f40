r"""The program of a step whose first level does not fit, or is near a singularity.

.. math::

    \min\ & \tfrac12\dot{\mathbf q}^T\mathbf H\dot{\mathbf q}
        + (\mathbf N\mathbf c)^T\dot{\mathbf q} + \tfrac12\sum_{\lambda_i > 0}\tfrac{h_i}{\lambda_i}
          \bigl(\sigma_i v_i^T\dot{\mathbf q} - (\varphi_i + s(1-\varphi_i))\,\beta_i\bigr)^2
        - g\,s + \tfrac12\delta\,g\,(1 - s)^2 \\
    \text{s.t. } & \sigma_i v_i^T\dot{\mathbf q} = s\,\beta_i\ (\lambda_i = 0),\quad
        lower \le \dot{\mathbf q} \le upper,\quad \mathbf G\dot{\mathbf q}\le\mathbf g,\quad
        0 \le s \le 1

with the directions of :mod:`qp_twist.qp.directions`, :math:`h_i = v_i^T\mathbf H v_i` and N the
null space of the level's rows. With s = 1 it is the step as posed, which is solved first; where
that fits, nothing else is done. Weak directions are asked for at any scale, so that they do not
hold the rest down. :math:`g = \gamma\,\dot{\mathbf p}^T\mathbf H\dot{\mathbf p}` is what the
whole speed is worth, with ṗ the joints' motion by the task alone. The task may also give way in all
directions (``relax``): λᵢ is then larger by a share of the largest σ², and there is no s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array, largest
from qp_twist.kernel import COMPILED
from qp_twist.kernel.constants import (
    BEYOND,
    CURVED,
    DEAD,
    LARGEST,
    LEAST_MOTION,
    OF_COSTS,
    SCALE_BACKOFF,
    SOFT,
    STILL,
    WHOLE,
    WORTH,
)
from qp_twist.qp.directions import Directions
from qp_twist.qp.problem import QuadraticProgram, widened
from qp_twist.qp.solve import Refused, Verified, solve


class Found(NamedTuple):
    """Solution of a first level."""

    x: Array
    """The unknowns of the step, (n,)."""
    scale: float
    """s; 1 if the task is relaxed."""
    relaxed: float
    """Share of the relaxed solution in it, 0 to 1."""
    box: Array
    """Multipliers of the bounds: of s by their width where it is scaled, (n,)."""
    rows: Array
    """The same of G x ≤ g, (k,)."""
    solver: str


class Programs:
    """The programs of one step: its costs and limits, and the directions of its first level."""

    def __init__(self, problem: QuadraticProgram, first: Directions) -> None:
        """Take a step's costs and limits, and the directions on all its unknowns."""
        self._problem, self._first = problem, first
        self._cost, self._c = costs_along(problem, first), first.free(problem.c)

    def posed(self, scale: float = 1.0) -> QuadraticProgram:
        """The program at a given scale: directions are met as stated, but for the weak ones."""
        p, first, hard = self._problem, self._first, self._first.slack == 0.0
        rate = (first.weakness + scale * (1.0 - first.weakness)) * first.rate
        H, c = with_weak_rows(p.H, self._c, first.rows, rate, first.slack, self._cost)
        return p.with_rows(H, c, first.rows[hard], rate[hard])

    def relaxed(self) -> QuadraticProgram:
        """The program in which all directions yield."""
        p, first = self._problem, self._first
        slack = first.slack + SOFT * max(first.size, 1e-6) ** 2
        H, c = with_weak_rows(p.H, self._c, first.rows, first.rate, slack, self._cost)
        return p.with_rows(H, c, first.rows[:0], first.rate[:0])

    def scaled(self, worth: float = WORTH) -> tuple[QuadraticProgram, float]:
        """The program with the scale for a γ, and its unit: s is the last unknown times it."""
        p, n, first = self._problem, self._problem.n, self._first
        size, phi, beta, hard = p.steepest or 1.0, first.weakness, first.rate, first.slack == 0.0
        motion, most = first.motion(), min(BEYOND * first.allowed(p.lower, p.upper), 1.0)
        worth *= max(most**2 * float(motion @ p.H @ motion), LEAST_MOTION * size)
        whole = math.sqrt(CURVED * worth / size)
        unit = most / whole
        rows = widened(first.rows, n + 1)
        rows[:, n] = -(1.0 - phi) * beta * unit
        wide = p.widened(1)
        wide.H[n, n], wide.lower[n], wide.upper[n] = size, 0.0, whole
        wide.c[:n], wide.c[n] = self._c, -worth * (1.0 + CURVED) / whole
        H, c = with_weak_rows(wide.H, wide.c, rows, phi * beta, first.slack, self._cost)
        return wide.with_rows(H, c, rows[hard], (phi * beta)[hard]), unit


def costs_along(problem: QuadraticProgram, first: Directions) -> Array:
    """hᵢ = vᵢᵀ H vᵢ, the cost of moving along each direction, (m,)."""
    square = first.sigma**2
    along: Array = ((first.rows @ problem.H) * first.rows).sum(axis=1)
    seen = square > 0.0
    return np.where(seen, along / np.where(seen, square, 1.0), problem.steepest or 1.0)


def with_weak_rows(
    H: Array, c: Array, rows: Array, rate: Array, slack: Array, cost: Array
) -> tuple[Array, Array]:
    """Add ½ hᵢ (rowᵢ x − rateᵢ)²/λᵢ of the rows with λᵢ > 0 to a cost."""
    weak = slack > 0.0
    if not np.count_nonzero(weak):
        return H, c
    weight = cost[weak] / slack[weak]
    return (
        H + rows[weak].T @ (weight[:, None] * rows[weak]),
        c - (weight * rate[weak]) @ rows[weak],
    )


def first_level(
    problem: QuadraticProgram,
    first: Directions,
    mode: str,
    solver: str,
    options: Mapping[str, Any] | None = None,
    *,
    whole: bool = True,
) -> Found | Refused | None:
    r"""Solve the first level, as posed or by ``mode``, "scale" or "relax".

    ``None`` if no scale fits, and weak directions are not damped or no velocity keeps the limits:
    then the levels are to be solved in order. Refused if the backend failed.

    .. math::

        \dot{\mathbf q} = \dot{\mathbf q}_s + \bigl(1 - \tfrac1\eta\max(s, p_s/p_r)\bigr)_+
        (\dot{\mathbf q}_r - \dot{\mathbf q}_s), \qquad
        p = \sum (1 - \varphi_i)\,\beta_i\,\sigma_i v_i^T\dot{\mathbf q}

    Where limits stop the regular part of a scaled task and not that of a relaxed one, the step
    passes over to the latter; both keep the limits, and so does what is between them.
    """
    n, first = problem.n, first.on(problem.n)
    scaled: Found | None = None
    programs = Programs(problem, first)
    if whole:
        posed = solve(programs.posed(), solver, options)
        if isinstance(posed, Verified):
            return Found(
                posed.x, 1.0, 0.0, posed.multipliers.box, posed.multipliers.rows, posed.solver
            )
    if mode == "scale" and not first.smooth:
        return _at_largest_scale(problem, first, programs, solver, options)
    if mode == "scale":
        program, unit = programs.scaled()
        found = solve(program, solver, options)
        if isinstance(found, Verified):
            scale, per_scale = min(float(found.x[n]) * unit, 1.0), unit / -float(program.c[n])
            scaled = Found(
                found.x[:n], scale, 0.0, per_scale * found.multipliers.box[:n],
                per_scale * found.multipliers.rows, found.solver,
            )  # fmt: skip
            if scale >= DEAD:
                return scaled
        elif found.claimed or rest_fits(problem):
            return found
    if not first.smooth:
        return None
    relaxed = solve(programs.relaxed(), solver, options)
    if isinstance(relaxed, Refused):
        return relaxed if relaxed.claimed or rest_fits(problem) else None
    x, share = relaxed.x, 1.0
    if scaled is not None:
        along = ((1.0 - first.weakness) * first.rate) @ first.rows
        slow, free = float(along @ scaled.x), float(along @ x)
        most = max(slow, free, STILL * float(first.rate @ first.rate), 1e-300)
        share = 1.0 - max(scaled.scale, slow / most) / DEAD
        if share <= 0.0:
            return scaled
        x = scaled.x + share * (x - scaled.x)
    x = np.clip(x, problem.lower, problem.upper)
    return Found(x, 1.0, share, relaxed.multipliers.box, relaxed.multipliers.rows, relaxed.solver)


def _at_largest_scale(
    problem: QuadraticProgram,
    first: Directions,
    programs: Programs,
    solver: str,
    options: Mapping[str, Any] | None,
) -> Found | Refused | None:
    """The solution at the largest scale less a share of 1e-8, clear of the very edge.

    Steps that are repeated until a waypoint is reached, and single ones, take the largest scale. Of
    a task that has to be slowed down, a backend that finds nothing so near the edge leaves the
    solution with the scale; one that fits it has to solve.
    """
    n = problem.n
    program, unit = programs.scaled(LARGEST)
    found = solve(program, COMPILED)  # no other backend solves costs of so different sizes
    if isinstance(found, Refused):
        return None
    per_scale, x = unit / -float(program.c[n]), found.x[:n]
    of_costs = OF_COSTS * per_scale * largest(problem.H @ x + first.free(problem.c))
    box, rows = per_scale * found.multipliers.box[:n], per_scale * found.multipliers.rows
    box, rows = (np.where(np.abs(v) > of_costs, v, 0.0) for v in (box, rows))
    scale = min(float(found.x[n]) * unit, 1.0)
    slower = solve(programs.posed(scale * (1.0 - SCALE_BACKOFF)), solver, options)
    if isinstance(slower, Refused):
        return Found(x, scale, 0.0, box, rows, found.solver) if scale < WHOLE else slower
    return Found(slower.x, scale * (1.0 - SCALE_BACKOFF), 0.0, box, rows, slower.solver)


def rest_fits(problem: QuadraticProgram) -> bool:
    """Whether joints at rest keep all limits: then a scaled and a relaxed task have a solution."""
    return bool(
        (problem.lower <= 0.0).all() and (problem.upper >= 0.0).all() and (problem.g >= 0.0).all()
    )

"""A step's quadratic program before it is solved, and the names of its rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, GatheredLimits, binding_limits
from qp_twist.control.posing import PosedLevels, stacked
from qp_twist.control.step import Status, Step
from qp_twist.qp import LostDirection, QuadraticProgram, lost_directions


@dataclass(eq=False)
class Posed:
    """A step before it is solved.

    Attributes:
        problem: The program with all levels as equality constraints; unknowns beyond nv are the
            slacks of soft bands. Its inequality rows are those of the limits, then those of soft
            bands, then the levels' own.
        levels: The priority levels.
        limits: The gathered limits.
    """

    problem: QuadraticProgram
    levels: PosedLevels
    limits: GatheredLimits

    @classmethod
    def of(cls, problem: QuadraticProgram, levels: PosedLevels, limits: GatheredLimits) -> Posed:
        """Add the levels' own inequality rows to a program."""
        own = [(_padded(G, problem.n), g) for G, g in levels.inequalities if len(g)]
        if own:
            G, g = stacked([(problem.G, problem.g), *own], problem.n)
            problem = replace(problem, G=G, g=g)
        return cls(problem, levels, limits)

    def hard(self, levels: int) -> QuadraticProgram:
        """The program without equality rows, and the inequality rows of so many levels."""
        own = [len(g) for _, g in self.levels.inequalities]
        k = len(self.problem.g) - sum(own[levels:])
        problem = self.problem
        return replace(problem, A=problem.A[:0], b=problem.b[:0], G=problem.G[:k], g=problem.g[:k])

    @cached_property
    def inequalities(self) -> list[tuple[Array, Array]]:
        """G and g of each level on all unknowns."""
        return [(_padded(G, self.problem.n), g) for G, g in self.levels.inequalities]

    def step(
        self,
        x: Array,
        status: Status,
        solver: str,
        multipliers: tuple[Array, Array, float],
        *,
        scale: float = 1.0,
        problem: QuadraticProgram | None = None,
        refused: tuple[str, ...] = (),
        gaps: tuple[float, ...] = (),
        proven: bool = True,
    ) -> Step:
        """The step of a solution x of the program, with arguments of :meth:`binding`."""
        levels = self.levels
        velocity = x[: len(self.limits.lower)].copy()  # of the joints alone
        A, b = levels.rows[0]
        lost: tuple[LostDirection, ...] = ()
        if not levels.directions[0].regular:
            lost = levels.where(lost_directions(A, scale * b, velocity, levels.threshold))
        if status is Status.SOLVED and lost:
            status = Status.DEGRADED
        elif levels.braked < 1.0 and status in (Status.SOLVED, Status.PRIORITIZED):
            status = Status.SCALED
        elif levels.braking is not None and status is Status.SOLVED:
            status = Status.PRIORITIZED
        return Step.of(
            {
                "binding": partial(self.binding, *multipliers),
                "residuals": partial(self.residuals, velocity.copy(), scale),
                "sigma_min": levels.sigma_min,
            },
            velocity=velocity,
            scale=scale * levels.braked,
            status=status,
            solver=solver,
            problem=self.problem if problem is None else problem,
            lost=lost,
            recovering=self.limits.recovering,
            refused=refused,
            gaps=gaps,
            proven=proven,
        )

    def residuals(self, velocity: Array, scale: float) -> tuple[Array, ...]:
        """A q̇ − s b of each task; s = 1 below the first level, b of the first one as braked."""
        return tuple(
            rows.A @ velocity - (1.0 if index else scale) * rows.b
            for index, tasks in enumerate(self.levels.tasks)
            for rows in tasks
        )

    def binding(self, box: Array, rows: Array, floor: float = 0.0) -> tuple[BindingLimit, ...]:
        """The limits with a multiplier above ``floor``: of bounds (n,) and of rows (k,)."""
        limits, levels = self.limits, self.levels
        found = binding_limits(
            box[: len(limits.lower)], rows, floor, limits.names,
            (limits.box.lower_kind, limits.box.upper_kind),
            [*limits.sources, *levels.soft_bands, *levels.sources],
        )  # fmt: skip
        if levels.braking is not None and not found:
            dof, side = levels.braking
            return (BindingLimit(limits.names[dof], "acceleration", side, 1.0),)
        return found


def _padded(rows: Array, n: int) -> Array:
    """Rows (k, nv) on n unknowns."""
    return np.pad(rows, ((0, 0), (0, n - rows.shape[1])))

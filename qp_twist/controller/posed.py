"""A step as posed, and the names of what is in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.posing import PosedLevels, stacked
from qp_twist.controller.step import Status, Step
from qp_twist.limits import DUST, BindingLimit, GatheredLimits, Named, binding_bounds
from qp_twist.qp import Level, QuadraticProgram


@dataclass(frozen=True, eq=False)
class Posed:
    """Everything about a step before it is solved.

    Attributes:
        problem: The program as if every level could be met; unknowns beyond nv are the slacks of
            soft bands.
        hard: The inequality rows that hold for all levels, on all unknowns.
        padded: The levels on all unknowns.
        levels: The levels as the tasks state them.
        limits: The gathered limits.
        sources: What the rows of ``problem.G`` come from, which knows their names.
    """

    problem: QuadraticProgram
    hard: Level
    padded: list[Level]
    levels: PosedLevels
    limits: GatheredLimits
    sources: list[Named]

    @classmethod
    def of(
        cls,
        problem: QuadraticProgram,
        levels: PosedLevels,
        limits: GatheredLimits,
        sources: list[Named],
    ) -> Posed:
        """Add the levels' own inequality rows to a program whose G holds the hard rows."""
        hard = Level(np.zeros((0, problem.n)), np.zeros(0), problem.G, problem.g)
        padded = [level.padded(problem.n) for level in levels.levels]
        own = [(level.G, level.g) for level in padded if len(level.g)]
        whole = problem
        if own:
            G, g = stacked([(problem.G, problem.g), *own], problem.n)
            whole = replace(problem, G=G, g=g)
        return cls(whole, hard, padded, levels, limits, sources + levels.sources)

    def step(
        self,
        x: Array,
        status: Status,
        solver: str,
        binding: tuple[BindingLimit, ...],
        *,
        scale: float = 1.0,
        problem: QuadraticProgram | None = None,
        refused: tuple[str, ...] = (),
        gaps: tuple[float, ...] = (),
        proven: bool = True,
    ) -> Step:
        """The step that goes with a solution of the program."""
        velocity = x[: len(self.limits.lower)]
        return Step(
            velocity=velocity,
            scale=scale,
            residuals=tuple(
                rows.A @ velocity - (scale if index == 0 else 1.0) * rows.b
                for index, tasks in enumerate(self.levels.tasks)
                for rows in tasks
            ),
            binding=binding,
            status=status,
            solver=solver,
            problem=self.problem if problem is None else problem,
            sigma_min=self.levels.sigma_min,
            lost=tuple(replace(d, missing=scale * d.missing) for d in self.levels.lost),
            recovering=self.limits.recovering,
            refused=refused,
            gaps=gaps,
            proven=proven,
        )

    def binding(self, box: Array, rows: Array, floor: float = 0.0) -> tuple[BindingLimit, ...]:
        """The limits with a multiplier, by name, from those of bounds (n,) and rows of G (k,).

        Multipliers are dust below a share of the largest, or of ``floor`` if that is larger.
        """
        limits = self.limits
        nv = len(limits.lower)
        box = box[:nv]
        largest = max(float(np.abs(box).max(initial=0.0)), float(rows.max(initial=0.0)))
        # Interior-point and first-order backends leave dust on inactive limits.
        dust = DUST * max(largest, floor)
        found = []
        if (np.abs(box) > dust).any():  # names are looked up, and so are kinds
            found = binding_bounds(
                box, dust, limits.names, limits.box.lower_kind, limits.box.upper_kind
            )
        if (rows > dust).any():
            names = [name for source in self.sources for name in source.names]
            for row in np.flatnonzero(rows > dust):
                found.append(BindingLimit(*names[row], "upper", float(rows[row])))
        return tuple(found)

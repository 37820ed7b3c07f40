"""A step as posed, and the names of what is in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.posing import PosedLevels
from qp_twist.controller.step import Status, Step
from qp_twist.limits import DUST, BindingLimit, GatheredLimits, RowName, binding_bounds
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
        labels: Name of each row of ``problem.G``.
    """

    problem: QuadraticProgram
    hard: Level
    padded: list[Level]
    levels: PosedLevels
    limits: GatheredLimits
    labels: list[RowName]

    @classmethod
    def of(
        cls,
        problem: QuadraticProgram,
        levels: PosedLevels,
        limits: GatheredLimits,
        labels: list[RowName],
    ) -> Posed:
        """Add the levels' own inequality rows to a program whose G holds the hard rows."""
        hard = Level(np.zeros((0, problem.n)), np.zeros(0), problem.G, problem.g)
        padded = [level.padded(problem.n) for level in levels.levels]
        whole = replace(
            problem,
            G=np.vstack([problem.G, *(level.G for level in padded)]),
            g=np.concatenate([problem.g, *(level.g for level in padded)]),
        )
        return cls(whole, hard, padded, levels, limits, labels + levels.labels)

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
        names = limits.names if (np.abs(box) > dust).any() else ()  # they are looked up
        found = binding_bounds(box, dust, names, limits.lower_kind, limits.upper_kind)
        for row in np.flatnonzero(rows > dust):
            found.append(BindingLimit(*self.labels[row], "upper", float(rows[row])))
        return tuple(found)

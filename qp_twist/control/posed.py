"""A step's quadratic program before it is solved, and the names of its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, GatheredLimits, binding_limits
from qp_twist.control.posing import PosedLevels, stacked
from qp_twist.control.step import Status, Step
from qp_twist.qp import Level, QuadraticProgram

INERTIA = 0.7
"""ζ: share of its velocity that a joint keeps where the task is not met."""


class Inertia(NamedTuple):
    """What joints keep of their velocity where the task is not met."""

    before: Array
    """q̇ of the last step, rad/s or m/s, (nv,)."""
    share: Array
    """ζ of each joint, (nv,)."""
    passed_over: float
    """ψ of the last step."""

    @classmethod
    def of(
        cls, before: Array, fastest: Array, hardest: Array, dt: float, passed_over: float
    ) -> Inertia:
        r"""ζ min(1, a dt/(2 v)): less where a joint cannot reverse in one step anyhow.

        Args:
            before: q̇ of the last step, (nv,).
            fastest: v, speed limits, (nv,); joints without one have no inertia.
            hardest: a, acceleration limits, (nv,).
            dt: Length of the step, s.
            passed_over: ψ of the last step.
        """
        share = np.zeros(len(before))
        limited = np.isfinite(fastest)
        share[limited] = np.minimum(1.0, 0.5 * hardest[limited] * dt / fastest[limited])
        return cls(before.copy(), INERTIA * share, passed_over)

    def lagging(self, passed_over: float) -> float:
        """ψ + ζ (ψ_before − ψ)₊ of this step's ψ, with the largest ζ.

        A path that was left is returned to with the same inertia as the joints have.
        """
        kept = float(self.share.max(initial=0.0))
        return passed_over + kept * max(0.0, self.passed_over - passed_over)


@dataclass(eq=False)
class Posed:
    """A step before it is solved.

    Attributes:
        problem: The program with all levels as equality constraints; unknowns beyond nv are the
            slacks of soft bands. Its inequality rows are those of the limits, then those of soft
            bands, then the levels' own.
        levels: The priority levels.
        limits: The gathered limits.
        longer: The bounds (nv,), (nv,) of a step that is so many times as long.
        inertia: What joints keep of their velocity where the task is not met; ``None`` for nothing.
    """

    problem: QuadraticProgram
    levels: PosedLevels
    limits: GatheredLimits
    longer: Callable[[float], tuple[Array, Array]]
    inertia: Inertia | None = None

    @classmethod
    def of(
        cls,
        problem: QuadraticProgram,
        levels: PosedLevels,
        limits: GatheredLimits,
        longer: Callable[[float], tuple[Array, Array]],
        inertia: Inertia | None = None,
    ) -> Posed:
        """Add the levels' own inequality rows to a program."""
        own = [level.padded(problem.n) for level in levels.levels if len(level.g)]
        if own:
            blocks = [(problem.G, problem.g), *((level.G, level.g) for level in own)]
            G, g = stacked(blocks, problem.n)
            problem = replace(problem, G=G, g=g)
        return cls(problem, levels, limits, longer, inertia)

    def eased(self, steps: float) -> tuple[Array, Array, Array]:
        """The bounds of this step that also hold for one ``steps`` times as long.

        A joint then approaches its position limit over several steps, as all do what must not
        touch; what they have to do in this one, to return or because they cannot stop sooner, they
        do.

        Returns:
            Lower and upper bounds, (nv,), and g of all inequality rows, (k,).
        """
        limits, (lower, upper) = self.limits, self.longer(steps)
        lower = np.minimum(np.maximum(limits.lower, lower), limits.upper)
        upper = np.maximum(np.minimum(limits.upper, upper), limits.lower)
        g = self.problem.g.copy()
        g[: len(limits.rooms)] -= limits.rooms * (1.0 - 1.0 / steps)
        return lower, np.maximum(lower, upper), g

    @cached_property
    def hard(self) -> Level:
        """The inequality rows common to all levels, on all unknowns."""
        n, own = self.problem.n, sum(len(level.g) for level in self.levels.levels)
        k = len(self.problem.g) - own
        return Level(np.zeros((0, n)), np.zeros(0), self.problem.G[:k], self.problem.g[:k])

    @cached_property
    def padded(self) -> list[Level]:
        """The levels on all unknowns."""
        return [level.padded(self.problem.n) for level in self.levels.levels]

    def step(
        self,
        x: Array,
        status: Status,
        solver: str,
        multipliers: tuple[Array, Array, float] | Step,
        *,
        scale: float = 1.0,
        problem: QuadraticProgram | None = None,
        refused: tuple[str, ...] = (),
        gaps: tuple[float, ...] = (),
        proven: bool = True,
        passed_over: float = 0.0,
    ) -> Step:
        """The step of a solution x of the program.

        ``multipliers``: as for :meth:`binding`, or the step whose active limits it has.
        """
        velocity = x[: len(self.limits.lower)].copy()  # of the joints alone
        if self.levels.braked < 1.0 and status in (Status.SOLVED, Status.PRIORITIZED):
            status = Status.SCALED
        elif self.levels.braking is not None and status is Status.SOLVED:
            status = Status.PRIORITIZED
        return Step.of(
            {
                "binding": partial(getattr, multipliers, "binding")
                if isinstance(multipliers, Step)
                else partial(self.binding, *multipliers),
                "residuals": partial(self.residuals, velocity.copy(), scale),
                "sigma_min": self.levels.sigma_min,
            },
            velocity=velocity,
            scale=scale * self.levels.braked,
            status=status,
            solver=solver,
            problem=self.problem if problem is None else problem,
            lost=tuple(replace(d, missing=scale * d.missing) for d in self.levels.lost),
            recovering=self.limits.recovering,
            refused=refused,
            gaps=gaps,
            proven=proven,
            passed_over=passed_over,
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

"""The closed forms on arrays; their kinematics is given."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from qp_twist.bench.contender import Asked, Contender, StepOf, tool_axes
from qp_twist.bench.problem import DT, Problem
from qp_twist.bench.program import turn_error
from qp_twist.checks import Array
from qp_twist.closed_form import gradient_projection, minimum_norm, resolved_motion_rate, twa
from qp_twist.geometry import Projector, TwistProjector

Formula = Callable[[Array, TwistProjector, Array, Array], Array]
"""J (6, n), T in world axes, Δt (6,), h (n,) → Δθ (n,)."""

_FORMULAS: dict[str, tuple[Asked, Formula]] = {
    "minimum_norm": (Asked.SHORTEST, lambda J, T, dt, h: minimum_norm(J, T, dt)),
    "gradient_projection": (Asked.UNLIMITED, gradient_projection),
    "rmr": (Asked.OTHER, lambda J, T, dt, h: resolved_motion_rate(J, dt)),
    "twa": (Asked.OTHER, twa),
}
_WHOLE = frozenset({"rmr"})
"""Formulas that are given the whole twist to the target; the others get what T asks of it."""


def closed_forms() -> list[Contender]:
    """Each formula, once for every arm of the robot."""
    return [
        Contender(
            f"closed:{name}",
            f"closed_form.{name if name != 'rmr' else 'resolved_motion_rate'}, on arrays",
            asked,
            partial(_prepare, formula, name in _WHOLE),
            applies=tool_axes,
        )
        for name, (asked, formula) in _FORMULAS.items()
    ]


def _prepare(formula: Formula, whole: bool, problem: Problem) -> Callable[[], StepOf]:
    cases = [_arrays(problem, k, whole) for k in range(len(problem.q) - 1)]
    nv = problem.model.nv

    def make() -> StepOf:
        velocity = np.zeros(nv)

        def step(k: int) -> Array:
            for dofs, J, T, error, h in cases[k]:
                velocity[dofs] = formula(J, T, error, h) / DT
            return velocity

        return step

    return make


def _arrays(
    problem: Problem, k: int, whole: bool
) -> list[tuple[np.ndarray[tuple[int], np.dtype[np.intp]], Array, TwistProjector, Array, Array]]:
    """Joints, J, T, Δt and h of each arm; arms that share a joint have no closed form here."""
    found = []
    h = problem.gain * (problem.middle - problem.q[k])
    for frame, target, R, p, J in zip(
        problem.frames, problem.targets[k], *problem.jacobians(k), strict=True
    ):
        R_d = target.rotation().as_matrix()
        dofs = np.flatnonzero(np.abs(J).max(axis=0) > 0.0)
        T = frame.projector.resolved(body=R, target=R_d)
        turned = turn_error(Projector.full() if whole else frame.projector.angular, R, R_d)
        error = np.concatenate([target.translation() - p, turned])
        found.append((dofs, J[:, dofs], T, error, h[dofs]))
    return found

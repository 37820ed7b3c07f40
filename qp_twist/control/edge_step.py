"""What a step does where its levels cannot all be met: slower, or as close as a smooth step is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.control.infeasible import inaccurate, infeasible_step, solved_as_posed
from qp_twist.control.posed import Inertia, Posed
from qp_twist.control.step import Status, Step
from qp_twist.qp import (
    SCALE_BACKOFF,
    Cascade,
    EdgeRows,
    LargestScale,
    Level,
    Multipliers,
    QuadraticProgram,
    Refused,
    Verified,
    largest_scale,
    lexicographic,
    solve,
    solve_within,
)
from qp_twist.qp.edge import ROUNDING
from qp_twist.qp.verification import EQUALITY_TOLERANCE

WORTH = 5.0
"""γ: what the task's speed is worth beside the joint motion that it costs."""
WORTH_CURVED = 1e-2
"""δ: share of it that makes the program strictly convex."""

AT_REST = 1e-7
"""Speed of the joints below which a scaled task is at rest, rad/s or m/s: s would be rounding."""

SPREAD = 20.0
"""Steps that the distance to a position limit is spread over where the task stops."""

MISSED = 0.1
"""ρ₀: share of a task that is not met, from which on joints have all of their inertia."""

LOOSE = 10.0
"""c: how much more a weak direction may give way for its joints' inertia than for their motion."""

DEAD = 0.03
"""η: share of the relaxed step's progress below which a scaled step passes over to it."""


def finished_at_the_edge(
    posed: Posed, result: Verified | Refused, solver: str, on_infeasible: str
) -> Step:
    """The step for a backend's result, of levels with the rows of :mod:`qp_twist.qp.edge`.

    Args:
        posed: The step's program.
        result: The backend's result.
        solver: The backend's name.
        on_infeasible: ``"scale"``, ``"relax"`` or ``"raise"``.

    Raises:
        InfeasibleStep: If the first level is infeasible and ``on_infeasible`` is ``"raise"``.
        SolverInaccurate: If the step is feasible and no backend solved it.
    """
    step, relaxed = _without_inertia(posed, result, solver, on_infeasible)
    if posed.inertia is None:
        return step
    return _with_inertia(posed, posed.inertia, step, solver, relaxed)


def _without_inertia(
    posed: Posed, result: Verified | Refused, solver: str, on_infeasible: str
) -> tuple[Step, float]:
    """The step, and ψ: how much of it is a relaxed one; 1 with ``on_infeasible="relax"``."""
    strained, always = 0.0, 0.0
    if on_infeasible == "relax":
        strained, always = strain(posed), 1.0
    if isinstance(result, Verified):
        if strained == 0.0:
            step = solved_as_posed(posed, result)
            if on_infeasible == "scale" and left_of(posed.levels.edges[0], 1.0) < DEAD:
                relaxed = _in_order(posed, solver, Status.RELAXED, start=result.x, relaxing=True)
                return _going_on(posed, step, relaxed, 1.0)
            return step, always
        step = _in_order(
            posed, solver, Status.RELAXED, strained=strained, start=result.x, before=result.refused
        )
        return step, always
    first = posed.padded[0]
    # The residual decides if the first level is feasible, because it has a unit: for a task that is
    # met up to rounding, the largest scale is arbitrary.
    closest = lexicographic([posed.hard, first], posed.problem.lower, posed.problem.upper)
    if posed.hard.met(closest.x) and first.met(closest.x):
        return _feasible(posed, result, solver, closest.x, strained), always
    pace = largest_pace(posed)
    if pace is not None and pace.largest.scale >= 1.0 - SCALE_BACKOFF:
        return _feasible(posed, result, solver, pace.largest.x, strained), always
    if on_infeasible == "raise":
        raise infeasible_step(posed, None if pace is None else pace.largest)
    start = np.zeros(posed.problem.n) if pace is None else pace.largest.x
    if on_infeasible == "scale" and pace is not None:
        scaled = _scaled(posed, solver, pace)
        scale = scaled.scale / posed.levels.braked
        if left_of(posed.levels.edges[0], scale) >= DEAD:
            return scaled, 0.0
        relaxed = _in_order(posed, solver, Status.RELAXED, start=start, relaxing=True)
        multipliers = pace.largest.box_multipliers, pace.largest.row_multipliers, 0.0
        return _going_on(posed, scaled, relaxed, scale, multipliers)
    return _in_order(posed, solver, Status.RELAXED, strained=strained, start=start), 1.0


def _with_inertia(posed: Posed, inertia: Inertia, step: Step, solver: str, relaxed: float) -> Step:
    r"""The step with a share of the last one's velocity, as far as the task is not met.

    .. math::

        \min\ \tfrac12\lVert\dot{\mathbf q} - \mathbf y\rVert_H^2
        + \tfrac12\lVert\mathbf z\rVert^2
        + \tfrac12\,\delta\,\lVert\dot{\mathbf q}^*\rVert_H^2\,(1-u)^2, \qquad
        \mathbf y = \dot{\mathbf q}^* + \zeta\,\min(1,\ \rho/\rho_0)\,
        (\dot{\mathbf q}_{before} - \dot{\mathbf q}^*), \\
        k_i u_i^T\mathbf A(\dot{\mathbf q} - u\,\dot{\mathbf q}^*)
        = (1 - k_i)\,c\,\max(\sigma_i, \varepsilon)\,z_i, \\
        k_i = (1-\varphi_i)(1-\psi), \qquad 1 - (1-s)/\rho_0 \le u \le 1

    over q̇, u and z inside the limits, with q̇* the step,
    :math:`\rho = \lVert\mathbf A\dot{\mathbf q}^* - \mathbf b\rVert/\lVert\mathbf b\rVert`, φ the
    weakness of a direction, ψ how much of the step is a relaxed one and s its scale. Where all of
    the task is met, ρ is 0 and the step remains. A regular direction of a scaled task keeps the
    path, at a share u of its speed; what is weak, and all of a relaxed task, keeps only the limits.
    ψ falls from step to step no faster than a joint's velocity does: a limit that stops the task
    in one step and not in the next would otherwise call the joints back to the path at once.

    Where a task cannot be met, q̇* may turn round from step to step, as a regulator does whose gain
    is above 2. With ζ of the last velocity and 1 − ζ of the new one, the loop stands a gain of
    2 (1 + ζ)/(1 − ζ).

    Args:
        posed: The step's program.
        inertia: The last velocity, and ζ of each joint.
        step: The step without.
        solver: The backend to ask first.
        relaxed: ψ.
    """
    rows, problem, fastest = posed.levels.edges[0], posed.problem, step.velocity
    n, m = len(fastest), len(rows.goal)
    reached, asked = rows.left.T @ (rows.rows() @ fastest), float(np.linalg.norm(rows.goal))
    none = EQUALITY_TOLERANCE * (rows.size + asked)
    missed = max(0.0, float(np.linalg.norm(reached - rows.goal)) - none)
    if missed == 0.0:
        return step
    share = min(1.0, missed / max(asked, none) / MISSED) * inertia.share
    aim = fastest + share * (inertia.before - fastest)
    H = problem.H[:n, :n]
    speed = float(fastest @ H @ fastest)
    relaxed = inertia.lagging(relaxed)
    kept = (1.0 - rows.weakness) * (1.0 - relaxed)
    scale = step.scale / posed.levels.braked if step.status is Status.SCALED else 1.0
    wide = np.zeros((n + m + 1, n + m + 1))
    wide[:n, :n] = H
    wide[range(n, n + m), range(n, n + m)] = float(np.abs(H).max())
    wide[-1, -1] = WORTH_CURVED * speed if speed > 0.0 else 1.0
    free = np.full(m, np.inf)
    program = QuadraticProgram(
        wide, np.concatenate([-H @ aim, np.zeros(m), [-wide[-1, -1]]]),
        np.column_stack([
            kept[:, None] * (rows.left.T @ rows.rows()),
            np.diag((kept - 1.0) * LOOSE * np.sqrt(rows.floor)), -kept * reached,
        ]),
        np.zeros(m),
        np.pad(problem.G[:, :n], ((0, 0), (0, m + 1))), problem.g,
        np.concatenate([problem.lower[:n], -free, [max(0.0, 1.0 - (1.0 - scale) / MISSED)]]),
        np.concatenate([problem.upper[:n], free, [1.0]]),
    )  # fmt: skip
    result = solve(program, solver)  # where limits leave no room but by rounding, the step remains
    if isinstance(result, Refused):
        return replace(step, passed_over=relaxed)
    slower = float(result.x[-1]) if step.status is Status.SCALED else 1.0
    velocity = np.clip(result.x[:n], posed.limits.lower, posed.limits.upper)
    return posed.step(
        velocity, step.status, result.solver, step, scale=slower * scale,
        problem=step.problem, refused=step.refused, gaps=step.gaps, proven=step.proven,
        passed_over=relaxed,
    )  # fmt: skip


def _feasible(posed: Posed, result: Refused, solver: str, start: Array, strained: float) -> Step:
    """The step where the first level fits: a lower one does not, or the solver failed."""
    single = not any(len(level.b) + len(level.g) for level in posed.padded[1:])
    if single and strained == 0.0:
        again = solve(posed.problem, solver, persist=True)
        if isinstance(again, Verified):
            return solved_as_posed(posed, again)
        if again.claimed:
            raise inaccurate(posed, again)
    status = Status.RELAXED if strained > 0.0 else Status.PRIORITIZED
    return _in_order(posed, solver, status, strained=strained, start=start, before=result.says)


class Pace(NamedTuple):
    """The largest scale of the first level, and its right-hand side at rest and its slope."""

    largest: LargestScale
    at_rest: Array
    """b at s = 0: what weak directions are asked for at any scale, (m,)."""
    slope: Array
    """Its derivative by the scale, (m,)."""


def largest_pace(posed: Posed) -> Pace | None:
    """The largest scale of the first level; ``None`` if not even rest is feasible."""
    first, problem, hard = posed.padded[0], posed.problem, posed.hard
    G, g = np.vstack([hard.G, first.G]), np.concatenate([hard.g, first.g])
    asked = posed.levels.edges[0].asked
    at_rest = asked(0.0)
    slope = asked(1.0) - at_rest
    largest = largest_scale(replace(problem, A=first.A, b=slope, G=G, g=g), offset=at_rest)
    return None if largest is None else Pace(largest, at_rest, slope)


def strain(posed: Posed) -> float:
    r"""How much of the first level the limits touch near a singularity, m and rad.

    .. math:: \Bigl(1 - \frac{\sigma_{min}^2}{d_{min}}\Bigr)\,
        \lVert\mathbf A(\text{clip}(\dot{\mathbf q}_0) - \dot{\mathbf q}_0)\rVert\,dt

    with q̇₀ the step without limits. Where directions are damped, joints that are driven to their
    limits to make up for others would change from step to step: the task gives way before. It is 0
    for a regular task.
    """
    rows, level, problem = posed.levels.edges[0], posed.padded[0], posed.problem
    share = rows.degraded
    if share == 0.0 or not len(level.b):
        return 0.0
    n, m = problem.n, len(level.b)
    matrix = np.block([[problem.H, level.A.T], [level.A, np.zeros((m, m))]])
    x = np.linalg.lstsq(matrix, np.concatenate([-problem.c, level.b]), rcond=None)[0][:n]
    beyond = level.A @ (np.clip(x, problem.lower, problem.upper) - x)
    short = share * rows.dt * float(np.linalg.norm(beyond))
    return short if rows.bend * short > ROUNDING * rows.size**2 else 0.0


def _scaled(posed: Posed, solver: str, pace: Pace) -> Step:
    """The step at a large scale: the largest, less what only joints at their limits would buy."""
    largest = pace.largest
    scale, found = _worthwhile(posed, solver, pace)
    multipliers = largest.box_multipliers, largest.row_multipliers, 0.0
    if found is not None and len(posed.padded) == 1:
        problem = posed.problem.with_rows(posed.levels.edges[0].asked(scale))
        return posed.step(
            found.x, Status.SCALED, found.solver, multipliers, scale=scale, problem=problem,
            refused=found.refused,
        )  # fmt: skip
    start = largest.x if found is None else found.x
    return _in_order(
        posed, solver, Status.SCALED, scale=scale, start=start, multipliers=multipliers
    )


def left_of(rows: EdgeRows, scale: float) -> float:
    """The smaller one of s and of what is left of the weakest direction, 1 − φ (1 − θ)."""
    return min(scale, 1.0 - rows.degraded * (1.0 - rows.fitting))


def stopped(rows: EdgeRows, scale: float, velocity: Array) -> float:
    r"""What limits leave of the regular part of a task, or of its weak part, the smaller one.

    .. math::

        \max\Bigl(s,\ \frac{s\,p}{p^r}\Bigr), \qquad
        \max\Bigl(1 - \varphi(1 - \theta),\ \frac{\theta\,p_w}{p_w^r}\Bigr), \qquad
        p = \sum (1-\varphi_i)^2\beta_i u_i^T\mathbf b, \quad
        p_w = \sum \varphi_i^2\beta_i u_i^T\mathbf b

    with β what the damped rows ask for, and :math:`p^r`, :math:`p_w^r` the progress of a relaxed
    velocity in these parts. What the step does of one part does not hide that the other is stopped.
    Progress of 10⁻⁹ is none, so that rounding decides nothing where both are.

    Args:
        rows: The first level.
        scale: s.
        velocity: q̇ of the relaxed step, (n,).
    """
    weak, goal, theta = rows.weakness, rows.goal, rows.fitting
    whole, reached = rows.met * goal, rows.left.T @ (rows.rows() @ velocity)
    none = ROUNDING * float(goal @ goal)

    def lag(slow: float, free: float) -> float:
        most = max(free, slow, none)
        return max(0.0, slow - none) / most if most > 0.0 else 1.0

    regular = lag(
        scale * float((1.0 - weak) ** 2 * whole @ goal),
        float((1.0 - weak) * goal @ (reached - theta * weak * whole)),
    )
    of_weak = lag(
        theta * float(weak**2 * whole @ goal),
        float(weak * goal @ (reached - scale * (1.0 - weak) * whole)),
    )
    return min(max(regular, scale), max(of_weak, left_of(rows, 1.0)))


def _going_on(
    posed: Posed,
    scaled: Step,
    relaxed: Step,
    scale: float,
    multipliers: tuple[Array, Array, float] | None = None,
) -> tuple[Step, float]:
    r"""Between the scaled and the relaxed step, where a limit would stop the scaled one.

    .. math::

        \dot{\mathbf q} = \dot{\mathbf q}_s + \psi\,(\dot{\mathbf q}_r - \dot{\mathbf q}_s),\qquad
        \psi = \Bigl(1 - \frac1\eta \text{stopped}(s)\Bigr)_+

    Both keep the limits, and so does what is between them. While the scaled step does more than a
    share η of the task, or of the relaxed one's progress, it is returned as it is, and ψ with it.

    Args:
        posed: The step's program.
        scaled: The step that is scaled, or whose weak directions are.
        relaxed: The relaxed step.
        scale: s of the scaled step.
        multipliers: Of the limits in the way; those of the relaxed step if ``None``.
    """
    share = 1.0 - stopped(posed.levels.edges[0], scale, relaxed.velocity) / DEAD
    if share <= 0.0:
        return scaled, 0.0
    velocity = scaled.velocity + share * (relaxed.velocity - scaled.velocity)
    velocity = np.clip(velocity, posed.limits.lower, posed.limits.upper)
    step = posed.step(
        velocity, Status.RELAXED, relaxed.solver, relaxed if multipliers is None else multipliers,
        problem=relaxed.problem, refused=relaxed.refused,
    )  # fmt: skip
    return step, share


def _worthwhile(posed: Posed, solver: str, pace: Pace) -> tuple[float, Verified | None]:
    r"""The scale s = u s* that is worth its joint motion, and the motion.

    .. math::

        \min_{\dot{\mathbf q},\,u}\ \text{cost}(\dot{\mathbf q}) - g\,u
        + \tfrac12\,\delta g\,(1-u)^2, \qquad u \le 1, \qquad
        g = \frac{\gamma}{1 - s^*}\,\lVert\dot{\mathbf q}_{task}(s^*)\rVert_H^2

    The optimum of the linear program alone would spend any speed in the null space on a little more
    of s; where that turns round from step to step, so would the joints. This program is strictly
    convex, so that its optimum is continuous. Where nothing is to be gained in the null space u is
    1; it tends to 1 where s* does, as the task is then met.
    """
    problem, rows, largest = posed.problem, posed.levels.edges[0], pace.largest
    top, n = largest.scale * (1.0 - SCALE_BACKOFF), problem.n
    if largest.scale * float(np.linalg.norm(rows.motion() - rows.motion(0.0))) <= AT_REST:
        top = 0.0
    H, first = problem.H, posed.padded[0]
    motion = np.zeros(n)
    motion[: rows.A.shape[1]] = rows.motion(top)
    # What the secondary wants beyond the limits shall not outweigh the task.
    free = np.clip(-np.linalg.solve(H, problem.c), problem.lower, problem.upper)
    lower, upper, eased = posed.eased(1.0 + (SPREAD - 1.0) * (1.0 - top))
    nv = len(lower)
    g = WORTH * float(motion @ H @ motion) / (1.0 - top)
    wide = np.pad(H, (0, 1))
    wide[n, n] = WORTH_CURVED * g or 1.0
    extended = QuadraticProgram(
        wide, np.append(-H @ free, -g - wide[n, n]),
        np.column_stack([first.A, -top * pace.slope]), pace.at_rest,
        np.pad(problem.G, ((0, 0), (0, 1))), eased,
        np.concatenate([lower, problem.lower[nv:], [0.0]]),
        np.concatenate([upper, problem.upper[nv:], [1.0]]),
    )  # fmt: skip
    result = solve(extended, solver, persist=True)
    if isinstance(result, Refused):
        # Joints that move already may not be able to slow down as the eased bounds ask; and where
        # they leave a single velocity, it is that of s* itself.
        lower = np.append(problem.lower, 0.0)
        upper = np.append(problem.upper, 1.0 + 2.0 * SCALE_BACKOFF)
        all_of_it = replace(extended, lower=lower, upper=upper, g=problem.g)
        result = solve(all_of_it, solver, persist=True)
    if isinstance(result, Refused):
        return top, None
    y, of_rows, box = result.multipliers
    multipliers = Multipliers(y, of_rows, box[:n])
    return top * float(result.x[n]), replace(result, x=result.x[:n], multipliers=multipliers)


def _in_order(
    posed: Posed,
    solver: str,
    status: Status,
    *,
    start: Array,
    scale: float = 1.0,
    strained: float = 0.0,
    relaxing: bool = False,
    multipliers: tuple[Array, Array, float] | None = None,
    before: tuple[str, ...] = (),
) -> Step:
    """The levels in order, each met as far as the limits and those above leave room.

    Args:
        posed: The step's program.
        solver: The backend to ask first.
        status: What happened so far.
        start: A point to start from.
        scale: Of the first level.
        strained: Of the first level, as :func:`strain` says.
        relaxing: Whether the first level is relaxed also where it is met at its θ.
        multipliers: Of the limits that held the scale down.
        before: What was tried before.
    """
    problem = posed.problem
    descent = _Descent(
        posed, solver, lexicographic([posed.hard], problem.lower, problem.upper, start, refine=True)
    )
    if not posed.hard.met(descent.cascade.x):
        status = Status.RELAXED
    for index in range(len(posed.padded)):
        met = descent.meet(
            index, scale if index == 0 else 1.0, 0.0 if index else strained,
            relaxing=relaxing and index == 0,
        )  # fmt: skip
        if not met and status in (Status.SOLVED, Status.PRIORITIZED, Status.DEGRADED):
            status = Status.PRIORITIZED if index else Status.RELAXED
    result, cascade, asked = descent.finish(), descent.cascade, descent.asked
    gaps: tuple[float, ...] = ()
    if descent.exact:
        gaps = cascade.gaps(result.x)[1:]
    if multipliers is None:
        multipliers = descent.multipliers or _multipliers(cascade)
    if status is Status.PRIORITIZED and posed.levels.lost:
        status = Status.DEGRADED
    elif status is Status.PRIORITIZED and not descent.relaxed and not posed.levels.lower_lost:
        status = Status.SOLVED
    return posed.step(
        result.x,
        status,
        result.solver,
        multipliers,
        scale=scale,
        problem=problem.with_rows(np.concatenate([level.b for level in asked])),
        refused=before + result.refused,
        gaps=gaps,
        proven=all(level.proven(gap) for level, gap in zip(asked, gaps, strict=bool(gaps))),
    )


@dataclass(eq=False)
class _Descent:
    """From level to level.

    A level that does not fit is replaced by its damped least squares
    (:meth:`~qp_twist.qp.EdgeRows.relaxed`) and then held as it was achieved. What fades of a level
    is decided before the levels below it are asked, so that these cannot move it.
    """

    posed: Posed
    solver: str
    cascade: Cascade
    asked: list[Level] = field(default_factory=list)
    """The levels with what was asked of them."""
    relaxed: bool = False
    """Whether a level was not met."""
    exact: bool = True
    """Whether the cascade knows the optimum of every level."""
    multipliers: tuple[Array, Array, float] | None = None
    """Of the limits that were in the way of the first level that did not fit."""
    last: Verified | None = None
    """The result of the last level, where that was replaced: the secondary is part of it."""

    def meet(self, index: int, scale: float, strained: float, *, relaxing: bool = False) -> bool:
        """Ask the next level; whether it was met."""
        nv, problem = len(self.posed.limits.lower), self.posed.problem
        rows, is_last = self.posed.levels.edges[index], index == len(self.posed.padded) - 1
        if index:
            rows = rows.beneath(self.cascade.x[:nv])
        level = replace(self.posed.padded[index], b=rows.asked(scale))
        self.asked.append(level)
        self.last = None
        trial = _copy(self.cascade)
        trial.minimise(level)
        met = level.met(trial.x) and strained == 0.0 and not relaxing
        if met or len(level.g) or not len(level.b):
            self.cascade = trial
            self.relaxed = self.relaxed or not met
            if rows.fades and not is_last:
                self._hold(rows, level, self._solved(problem).x)
            self.multipliers = self.multipliers or (None if met else _multipliers(trial))
            return met
        self.multipliers = self.multipliers or _multipliers(trial)
        short = rows.dt * float(np.linalg.norm(level.A @ trial.x - level.b))
        H, c = rows.relaxed(problem.H, problem.c, max(short, strained))
        self.last = self._solved(replace(problem, H=H, c=c))
        self.relaxed = True
        self._hold(rows, level, self.last.x)
        return False

    def finish(self) -> Verified:
        """The secondary in what the levels leave."""
        return self._solved(self.posed.problem) if self.last is None else self.last

    def _solved(self, problem: QuadraticProgram) -> Verified:
        """The minimum of a cost on what the cascade leaves."""
        result = solve_within(problem, self.cascade, self.solver)
        if isinstance(result, Refused):
            raise inaccurate(self.posed, result)
        return result

    def _hold(self, rows: EdgeRows, level: Level, x: Array) -> None:
        """Hold a level where it was achieved at x, its slacks included."""
        n, nv = self.posed.problem.n, len(self.posed.limits.lower)
        held = _copy(self.cascade)
        held.x = x.copy()
        own = np.flatnonzero(np.abs(level.A[:, nv:]).max(axis=0, initial=0.0)) + nv
        fixed = np.vstack([np.pad(rows.rows(), ((0, 0), (0, n - nv))), np.eye(n)[own]])
        none = np.zeros((0, n))
        held.minimise(Level(fixed, fixed @ x, none, none[:, 0]))
        self.cascade, self.exact = held, False


def _multipliers(cascade: Cascade) -> tuple[Array, Array, float]:
    return cascade.box_multipliers, np.array(cascade.row_multipliers), 0.0


def _copy(cascade: Cascade) -> Cascade:
    """A copy that does not share what :meth:`Cascade.minimise` changes."""
    return replace(
        cascade,
        x=cascade.x.copy(),
        row_origins=list(cascade.row_origins),
        row_multipliers=list(cascade.row_multipliers),
        achieved=list(cascade.achieved),
        box_multipliers=cascade.box_multipliers.copy(),
        pinned=cascade.pinned.copy(),
    )

"""Random steps, up to a billion: is any called solved that is not?

    python benchmarks/random_steps.py [random_steps] [--pieces 20] [--steps 50000] [--first 0]
                                      [--solver compiled] [--jobs 1] [--keep FOLDER] [--write]
    python benchmarks/random_steps.py inequalities [--rows 3] [--write]

Configurations anywhere inside the limits, singular ones among them, targets from a hair to a
decimetre away, speed limits that are often active, of several robots, tasks and costs. What is
called solved, at a reduced scale too, is judged by code that shares nothing with the
package (`tests/oracles/step_referee.py`, which states the tolerances).

Piece p has so many steps of the case SCHEDULE[p mod 20], drawn from
`numpy.random.default_rng([SEED, p])`. With `--keep` its result is a file in the folder, and is not
computed again; results of another version of the code have to be removed by hand. The million steps
of the default take half a minute, and the billion of `--pieces 1004 --steps 1000000` two hours, on
one core; those of another solver are taken one by one, a million in an hour, and those near a
singularity, where a direction is slowed down, count as left to the reference.

Where the referee's own multipliers do not prove a step, those of quadprog and HiGHS are tried in
the same test, with the rare cost on motion that the rows of twist space hardly see
(`qp_twist.control.posing.unseen`) stated again. The table counts these steps as proved by
others; what they do not prove counts as refused, too.

*inequalities*: each step has random inequality rows, too, and what is called solved is compared
with quadprog's solution of the program as the referee states it.
"""

from page import ROOT, command, each, markdown_table

# isort: split
import sys
from functools import cache
from typing import NamedTuple

import mink
import numpy as np
import qpsolvers
from oracles.step_referee import (
    AXIS,
    BOUNDS,
    GRADIENT,
    POINT,
    POSE,
    ROWS,
    SLACK,
    Chain,
    chain_of,
    judge,
    random_problems,
    stated,
)
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist.control.step_settings import SINGULARITY

Array = np.ndarray
SEED, SPEED, GAIN, DT = 20, 0.6, 0.3, 0.05
CHUNK = 20_000
UNSEEN, JOINT_WEIGHT = 1e-4, 0.01
"""Share of the largest singular value below which motion counts as unseen in twist space, and what
it costs there; as the controller's documentation states them."""


class Case(NamedTuple):
    """A robot with a task and a cost."""

    name: str
    scene: str
    site: str
    kind: int
    twist_space: bool = False


CASES = (
    Case("6 joints, axis free", "m16ib_deburring", "tool", AXIS),
    Case("7 joints, axis free", "seven_axis_arm", "tool", AXIS),
    Case("6 joints, point", "m16ib_deburring", "tool", POINT),
    Case("6 joints, axis free, cost in twist space", "m16ib_deburring", "tool", AXIS, True),
    Case("7 joints, pose", "seven_axis_arm", "tool", POSE),
    Case("10 joints (mobile arm), axis free", "mobile_arm", "arm_tool", AXIS),
)
SCHEDULE = (0, 1) * 8 + (2, 3, 4, 5)
COUNTS = (
    "steps", "full speed", "scaled", "left", "active", "asked again", "off the rows",
    "outside the bounds", "not optimal", "scale not the largest",
)  # fmt: skip
LARGEST = ("residual", "gradient", "slack")


@cache
def composed(case: Case, solver: str = "compiled") -> tuple[qt.Controller, Chain]:
    """The controller, and what the referee knows of its robot."""
    model = qt.load_robot(ROOT / "scenes" / f"{case.scene}.xml").model
    full, none = qt.Projector.full(), qt.Projector.none()
    angular = {POINT: none, AXIS: qt.Projector.plane([0, 0, 1]), POSE: full}[case.kind]
    projector = qt.TwistProjector(linear=full, angular=angular, frame="body")
    controller = qt.Controller(
        model,
        [qt.TwistTask(case.site, "site", projector)],
        secondary=[qt.JointCentering(model, "natural", gain=GAIN)],
        secondary_space="twist" if case.twist_space else "joint",
        limits=[qt.MotionLimit(model, velocity=SPEED, acceleration=None)],
        solver=solver,
    )
    controller.smooth = False  # the referee looks for the largest scale
    return controller, chain_of(model, case.site)


def proved_by_others(
    case: Case, chain: Chain, q: Array, target: Array, x: Array, s: float
) -> tuple[float, float]:
    """Gradient and slack of the referee with multipliers of quadprog and HiGHS."""
    n, m = len(q), case.kind
    A, b, _, (lower, upper), h, F = stated(chain, m, SPEED, GAIN, DT, q, target)
    H, steady = np.eye(n), np.zeros((n, n))
    if case.twist_space:
        H = np.outer(F, F)
        _, sigma, right = np.linalg.svd(np.vstack([A, F]))
        unseen = np.ones(n)
        unseen[: len(sigma)] -= np.minimum(1.0, (sigma / (UNSEEN * sigma[0])) ** 2)
        H += JOINT_WEIGHT * right.T @ (unseen[:, None] * right)
        steady = A.T @ A  # the same on all solutions of the rows; makes the program convex
    problem = qpsolvers.Problem(
        H + steady, -H @ h - s * A.T @ b * case.twist_space, None, None, A, s * b, lower, upper
    )
    solution = qpsolvers.solve_problem(problem, "quadprog")
    gradient, slack = np.inf, 0.0
    if solution.found:
        pull = H @ (x - h) + A.T @ solution.y
        aim = np.clip(x - pull / np.abs(H).max(), lower, upper)
        gradient = np.abs(x - aim).max() / (1.0 + np.abs(x).max())
    if s < 1.0:
        slack = np.inf
        # Unknowns x and s.
        found = linprog(
            np.append(np.zeros(n), -1.0), A_eq=np.column_stack([A, -b]), b_eq=np.zeros(m),
            bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
        )  # fmt: skip
        if found.status == 0:
            y = found.eqlin.marginals
            along = float(b @ y)
            if along != 0.0:
                v = A.T @ y / along
                slack = (np.maximum(v * lower, v * upper).sum() - s) / s
    return float(gradient), float(slack)


def taken(
    controller: qt.Controller, q: Array, targets: Array, solver: str
) -> tuple[Array, Array, Array]:
    """Velocities, scales, and which steps are called solved."""
    if solver == "compiled":
        done = qt.batch.step(controller, q, DT, targets, others=False, threads=1)
        return done.velocity, done.scale, ~done.by_reference
    [task], [limit] = controller.twist_tasks, controller.limits
    configuration = mink.Configuration(controller.model)
    velocity, scale, solved = np.zeros(q.shape), np.ones(len(q)), np.zeros(len(q), dtype=bool)
    for k, (here, target) in enumerate(zip(q, targets, strict=True)):
        configuration.update(here)
        task.set_target(mink.SE3.from_matrix(target))
        limit.note(np.zeros(len(here)))
        step = controller.step(configuration, DT)
        velocity[k], scale[k] = step.velocity, step.scale
        # Near a singularity a direction is slowed down, so that its rows are not met on purpose.
        fine = step.sigma_min >= SINGULARITY
        solved[k] = fine and step.status in (qt.Status.SOLVED, qt.Status.SCALED)
    return velocity, scale, solved


def run(piece: int, steps: int, solver: str) -> dict[str, object]:
    """The counts of a piece, what is largest in it, and which steps were refused."""
    case = CASES[SCHEDULE[piece % len(SCHEDULE)]]
    rng, (controller, chain) = np.random.default_rng([SEED, piece]), composed(case, solver)
    counts, largest = np.zeros(len(COUNTS), dtype=np.int64), np.zeros(len(LARGEST))
    refused = []
    for first in range(0, steps, CHUNK):
        count = min(CHUNK, steps - first)
        q, targets = random_problems(chain, count, rng)
        velocity, scale, solved = taken(controller, q, targets, solver)
        found = judge(
            chain, case.kind, case.twist_space, SPEED, GAIN, DT, q, targets, velocity, scale, solved
        )
        for k in np.flatnonzero(solved & (found[:, 0] > ROWS)):
            A = stated(chain, case.kind, SPEED, GAIN, DT, q[k], targets[k])[0]
            # Near a singularity a direction is slowed down: its rows are not met on purpose.
            solved[k] = np.linalg.svd(A, compute_uv=False)[-1] >= SINGULARITY
        again = np.flatnonzero(solved & ~((found[:, 2] <= GRADIENT) & (found[:, 3] <= SLACK)))
        for k in again:
            gradient, slack = proved_by_others(
                case, chain, q[k], targets[k], velocity[k], float(scale[k])
            )
            found[k, 2], found[k, 3] = min(found[k, 2], gradient), min(found[k, 3], slack)
        # Written so that NaN is refused.
        wrong = solved[:, None] & ~(found[:, :4] <= [ROWS, BOUNDS, GRADIENT, SLACK])
        refused += [
            [first + int(k), *found[k, :4].tolist()] for k in np.flatnonzero(wrong.any(axis=1))
        ]
        scaled = solved & (scale != 1.0)
        counts += [
            count, solved.sum() - scaled.sum(), scaled.sum(), count - solved.sum(),
            int(found[solved, 4].sum()), len(again), *wrong.sum(axis=0),
        ]  # fmt: skip
        largest = np.maximum(largest, found[solved][:, [0, 2, 3]].max(axis=0, initial=0.0))
    return {
        "case": case.name, "piece": piece, "seed": [SEED, piece],
        "counts": dict(zip(COUNTS, counts.tolist(), strict=True)),
        "largest": dict(zip(LARGEST, largest.tolist(), strict=True)), "refused": refused[:100],
    }  # fmt: skip


def random_steps(
    first: int, pieces: int, steps: int, solver: str, jobs: int, keep: str
) -> tuple[str, int]:
    """The results of the pieces, a line for each case; how many steps were refused."""
    chosen = range(first, first + pieces)
    results = list(each(run, chosen, jobs, keep, steps=steps, solver=solver))
    headings = (
        "case", "steps", "called solved", "at a reduced scale", "left to the reference",
        "a limit active, %", "proved by others", "not on their rows", "outside their bounds",
        "not optimal", "a larger scale exists", "largest residual", "largest gradient",
        "largest slack",
    )  # fmt: skip
    refused, rows = 0, []
    for name in [*(case.name for case in CASES), "all"]:
        chosen = [result for result in results if name in (result["case"], "all")]
        if not chosen:
            continue
        counts = dict(zip(COUNTS, sum(
            np.array([result["counts"][key] for key in COUNTS]) for result in chosen
        ).tolist(), strict=True))  # fmt: skip
        largest = [max(result["largest"][key] for result in chosen) for key in LARGEST]
        solved = counts["full speed"] + counts["scaled"]
        shown = [counts["steps"], solved, counts["scaled"], counts["left"]]
        rows.append((
            name, *(f"{number:,}" for number in shown),
            f"{100 * counts['active'] / max(1, solved):.0f}",
            *(f"{counts[key]:,}" for key in COUNTS[5:]), *(f"{number:.0e}" for number in largest),
        ))  # fmt: skip
        refused = sum(counts[key] for key in COUNTS[6:])
    return markdown_table(headings, rows), refused


class Rows(mink.Limit):
    """G q̇ ≤ g."""

    def __init__(self, nv: int) -> None:
        self.G, self.g = np.zeros((0, nv)), np.zeros(0)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=self.g * dt)


def inequalities(rows: int, steps: int, solver: str) -> tuple[str, int]:
    """Steps of the first two cases with random inequality rows, beside quadprog's solutions."""
    lines, wrong = [], 0
    for case in CASES[:2]:
        controller, chain = composed(case, solver)
        model, [task], [motion] = controller.model, controller.twist_tasks, controller.limits
        rng, limit = np.random.default_rng([model.nv, rows]), Rows(model.nv)
        controller = qt.Controller(
            model, [task], secondary=controller.secondary, limits=[motion, limit], solver=solver,
        )  # fmt: skip
        controller.smooth = False
        configuration, one = mink.Configuration(model), np.eye(model.nv)
        solved = active = 0
        false, worst = np.zeros(3, dtype=int), np.zeros(2)
        for q, target in zip(*random_problems(chain, steps, rng), strict=True):
            configuration.update(q)
            task.set_target(mink.SE3.from_matrix(target))
            motion.note(np.zeros(model.nv))
            limit.G, limit.g = rng.normal(size=(rows, model.nv)), rng.uniform(0.0, 0.5, rows)
            step = controller.step(configuration, DT)
            if step.status is not qt.Status.SOLVED:
                continue
            x = step.velocity
            A, b, (low, high), box, h, _ = stated(chain, case.kind, SPEED, GAIN, DT, q, target)
            exact = qpsolvers.solve_qp(one, -h, limit.G, limit.g, A, b, *box, solver="quadprog")
            size = 1.0 + np.abs(x).max()
            residual = np.abs(A @ x - b).max()
            excess = max((low - x).max(), (x - high).max(), (limit.G @ x - limit.g).max())
            error = np.inf if exact is None else np.abs(x - exact).max()
            sigma = np.linalg.svd(A, compute_uv=False)
            solved, active = solved + 1, active + any(x.kind == "Rows" for x in step.binding)
            # Where the rows nearly depend on each other quadprog's solution is no better.
            fine = sigma[0] / sigma[-1] <= 1e6
            false += [
                residual > ROWS * (1.0 + np.abs(b).max()), excess > BOUNDS * size,
                fine and error > GRADIENT * size,
            ]  # fmt: skip
            worst = np.maximum(worst, [residual, error if fine else 0.0])
        wrong += int(false.sum())
        lines.append((
            model.nv, f"{steps:,}", f"{solved:,}", f"{100 * active / solved:.0f}", *false,
            *(f"{value:.0e}" for value in worst),
        ))  # fmt: skip
    headings = (
        "joints", "steps", "called solved", "a row active, %", "not on their rows",
        "outside their bounds", "not optimal", "largest residual",
        "largest error where cond ≤ 10⁶",
    )  # fmt: skip
    return markdown_table(headings, lines, left=0), wrong


OPTIONS = {
    "first": 0, "pieces": 20, "steps": 50_000, "solver": "compiled", "jobs": 1, "keep": "",
    "rows": 3,
}  # fmt: skip


def main() -> int:
    """Take the steps, and print the tables."""
    parts = {"random_steps": random_steps, "inequalities": inequalities}
    return command(__doc__, parts, **OPTIONS)


if __name__ == "__main__":
    sys.exit(main())

"""What one step takes: calls of this package and of mink, with what is added to a step.

    python benchmarks/steps.py [calls] [prepared_steps] [named_backends] [--write]

*calls*: six joints, the tool's position and axis, the ranges of the joints, a secondary:
`deburring` at its start, the second waypoint as target; kinematics and target are given. The table
has the median, and the ratio to the call that is named: its median, 10th and 90th percentile over
the blocks.

*prepared_steps*: the same step with limits, bands, levels or other tasks added, compiled and with a
backend by name. The last rows are steps that do not fit inside the limits of 0.5 rad/s.

*named_backends*: whole steps with a backend by name beside ``mink.solve_ik`` with the same one, on
the robots and trajectories of ``qp-twist bench``: 6, 7 and 14 joints, tool positions and axes as
constraints, ranges and speeds as limits, of which some are active. *Ours* has ``MotionLimit`` and
``PostureReference``, *mink's terms* the limits and the ``PostureTask`` that mink has. mink's
backends run at their defaults, ours at settings at which their results can be verified; *same
settings* hands these to mink, too.

Everything is timed in turns by the timer of ``qp-twist bench``; the first two by the processor's
clock. A minute, half a minute, two minutes.
"""

from page import command, in_turns, markdown_table, micro

# isort: split
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mink
import numpy as np
import qpsolvers
from contenders import mink_step, own_step
from step_problems import STEPS, Problem, table
from timer import StepOf, blocks_of, interleaved

import qp_twist as qt
from qp_twist.qp.backend import SETTINGS

DT = 0.01
PATH = qt.load_task("deburring")
MODEL = PATH.model

# ---------------------------------------------------------------- calls

HARD, SOFT, STEP = "hard, once", "soft, once", "compiled"
"""The calls that the ratios are taken to."""


@dataclass(frozen=True)
class Call:
    """One call.

    Attributes:
        words: What it is, in the table.
        call: Makes it.
        against: Key of the call whose time is 1.
    """

    words: str
    call: Callable[[], object]
    against: str


def calls_by_key() -> dict[str, Call]:
    """Every call, those that are compared beside each other."""
    path, model = PATH, MODEL
    ranges = qt.JointRanges.of(model)
    configuration = mink.Configuration(model, path.start)
    tool = qt.TwistTask.axis_free("tool", "site")
    tool.set_target(path.waypoints[1])
    frame = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=(1.0, 1.0, 0.0))
    frame.set_target(path.waypoints[1])
    posture = mink.PostureTask(model, cost=1e-3, gain=0.05)
    posture.set_target(ranges.middle)
    made = [mink.ConfigurationLimit(model)]
    state = tool.state(configuration)
    J, T, error = state.jacobian, state.projector, state.error
    h = 0.05 * (ranges.middle - configuration.q)
    rows, rate = state.basis.T @ J, state.basis.T @ error

    found: dict[str, Call] = {}
    for kind, tasks, constraints, base in (
        ("soft", [frame, posture], None, SOFT), ("hard", [posture], [tool], HARD)
    ):  # fmt: skip
        words = "a `FrameTask` as cost" if kind == "soft" else "a `TwistTask` as constraint"
        for name, solve_ik in (("mink", mink.solve_ik), ("qt", qt.solve_ik)):
            for when, limits in (("each", None), ("once", made)):
                default = " (its default)" if when == "each" else ""
                found[f"{kind}, {when}" if name == "mink" else f"{name} {kind}, {when}"] = Call(
                    f"`{name}.solve_ik`, {words}, limits made "
                    f"{'in each call' if when == 'each' else 'once'}{default}",
                    lambda solve_ik=solve_ik, tasks=tasks, limits=limits, rows=constraints: (
                        solve_ik(configuration, tasks, DT, "daqp", limits=limits, constraints=rows)
                    ),
                    base,
                )
    for solver, space, words in (
        ("daqp", "joint", "by name (daqp)"), ("compiled", "joint", "compiled"),
        ("compiled", "twist", 'compiled, `secondary_space="twist"`'),
        ("quadprog", "joint", "by name (quadprog)"),
    ):  # fmt: skip
        if solver in qt.qp.installed_solvers():
            centering = qt.JointCentering(model, weight="natural", gain=0.05)
            controller = qt.Controller(
                model, [tool], secondary=[centering], secondary_space=space, solver=solver,
                metric=ranges.metric,
            )  # fmt: skip
            assert controller.step(configuration, DT).status is qt.Status.SOLVED
            found[solver if space == "joint" else space] = Call(
                f"`controller.step`, {words}",
                lambda controller=controller: controller.step(configuration, DT),
                HARD,
            )

    def bare() -> np.ndarray:
        inverse = rows.T @ np.linalg.inv(rows @ rows.T)
        return inverse @ (rate - rows @ h) + h

    np.testing.assert_allclose(bare(), qt.closed_form.gradient_projection(J, T, error, h))
    found["closed"] = Call(
        "`closed_form.gradient_projection` on arrays: `np.linalg.pinv`, arguments checked",
        lambda: qt.closed_form.gradient_projection(J, T, error, h),
        STEP,
    )
    found["bare"] = Call(
        "the same formula on the five rows: `np.linalg.inv`, nothing checked", bare, STEP
    )
    found["update"] = Call(
        "`configuration.update()`, MuJoCo's kinematics", configuration.update, STEP
    )
    found["target"] = Call(
        "`tool.set_target(pose)`", lambda: tool.set_target(path.waypoints[1]), STEP
    )
    return found


def calls() -> str:
    """Ours, mink's with limits made in each call or once, closed forms."""
    everyone = calls_by_key()
    timed = in_turns({key: one.call for key, one in everyone.items()}, 120, 10, time.thread_time_ns)
    bases = {HARD: "`mink`, constraint, once", SOFT: "`mink`, cost, once", STEP: "compiled step"}
    rows = []
    for key, one in everyone.items():
        middle, low, high = timed[key].ratio_to(timed[one.against])
        rows.append((
            one.words, micro(1e-3 * float(np.median(timed[key].warm))), f"{middle:.2g}",
            f"{low:.2g}–{high:.2g}", bases[one.against],
        ))  # fmt: skip
    return markdown_table(("call", "µs", "ratio", "p10–p90", "to"), rows)


# ---------------------------------------------------------------- what is added to a step

GIVES_WAY = "two levels, the lower one gives way"
HINDERED = {
    "scaled": qt.Status.SCALED, "relaxed": qt.Status.RELAXED, GIVES_WAY: qt.Status.PRIORITIZED,
}  # fmt: skip
ADDED = (
    "bounds alone", "two levels", "four rows of a limit", "a `mink.PostureTask` as a cost",
    "a roll band", "a soft roll band", "mink's `ConfigurationLimit` and `VelocityLimit`", *HINDERED,
)  # fmt: skip


class HalfSpaces(mink.Limit):
    """Four rows G q̇ ≤ 1, as any app's own limit may state them."""

    def __init__(self) -> None:
        self.G = np.random.default_rng(0).normal(size=(4, MODEL.nv))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=np.full(4, dt))


def controller(added: str, solver: str) -> qt.Controller:
    """Position limits, a tool axis and centering, with something added."""
    tool = qt.TwistTask.axis_free("tool", "site")
    tasks: list[Any] = [tool]
    limits: list[mink.Limit] = [qt.PositionLimit(MODEL)]
    options: dict[str, Any] = {}
    if added in ("two levels", GIVES_WAY):
        none = qt.Projector.none()
        parts = [
            qt.TwistProjector(linear=qt.Projector.full(), angular=none),
            qt.TwistProjector(linear=none, angular=qt.Projector.plane((0, 0, 1)), frame="body"),
        ]
        tasks, options = [], {"levels": [[qt.TwistTask("tool", "site", part)] for part in parts]}
    elif added == "four rows of a limit":
        limits.append(HalfSpaces())
    elif added == "a `mink.PostureTask` as a cost":
        tasks.append(mink.PostureTask(MODEL, cost=1.0))
        tasks[-1].set_target(PATH.start)
    elif added == "a roll band":
        tool.bands = [qt.RollBand((0, 0, 1), -0.5, 0.5)]
    elif added == "a soft roll band":
        tool.bands = [qt.RollBand((0, 0, 1), -0.5, 0.5, weight=1.0)]
    elif added == "mink's `ConfigurationLimit` and `VelocityLimit`":
        limits = [mink.ConfigurationLimit(MODEL), mink.VelocityLimit(MODEL, {"joint_1": 1.0})]
    if added in HINDERED:
        limits = [qt.MotionLimit(MODEL, velocity=0.5, acceleration=None)]
        options |= {"on_infeasible": "relax" if added == "relaxed" else "scale"}
    composed = qt.Controller(
        MODEL, tasks, secondary=[qt.JointCentering(MODEL)], limits=limits, solver=solver, **options
    )
    for task in composed.twist_tasks:
        task.set_target(PATH.waypoints[1])
    return composed


def prepared_steps() -> str:
    """Limits, bands, levels and other tasks."""
    configuration = mink.Configuration(MODEL, PATH.start)
    solvers = ("compiled", "daqp")
    steps: dict[str, Callable[[], object]] = {}
    for added in ADDED:
        for solver in solvers:
            composed = controller(added, solver)
            step = composed.step(configuration, DT)
            assert step.status is HINDERED.get(added, qt.Status.SOLVED), step.message
            steps[f"{added}, {solver}"] = lambda composed=composed: composed.step(configuration, DT)
    timed = in_turns(steps, 20, 20, time.thread_time_ns)
    rows = [
        (added, *(micro(1e-3 * float(np.median(timed[f"{added}, {s}"].warm))) for s in solvers))
        for added in ADDED
    ]
    return markdown_table(("µs", "compiled", "by name (daqp)"), rows)


# ---------------------------------------------------------------- backends by name


def minks_terms(problem: Problem, solver: str) -> StepOf:
    """This package's step, by mink's limits and cost."""

    def solve(configuration: Any, costs: Any, dt: float, solver: str, **kwargs: Any) -> Any:
        nonlocal controller
        if controller is None:
            tasks, limits = [*kwargs["constraints"], *costs], kwargs["limits"]
            controller = qt.Controller(problem.model, tasks, limits=limits, solver=solver)
        return controller.step(configuration, dt).velocity

    controller: qt.Controller | None = None
    return mink_step(problem, solver=solver, solve=solve)()


def named_backends(rounds: int, solvers: str) -> str:
    """Whole steps of mink and of this package with the same backend."""
    headings = (
        "backend", "joints", "`mink.solve_ik`, µs", "same settings", "ours", "mink's terms",
        "ours : mink", "mink's terms : mink", "mink's terms : same settings",
    )  # fmt: skip
    rows = []
    warnings.simplefilter("ignore", qpsolvers.warnings.SparseConversionWarning)
    problems = [planned.make(range(0, STEPS, 20))[0] for planned in table(0)]
    for solver in solvers.split(","):
        if solver not in qt.qp.installed_solvers():
            continue
        for problem in problems:
            steps: dict[str, StepOf] = {
                "mink": mink_step(problem, solver=solver)(),
                "settings": mink_step(problem, solver=solver, **SETTINGS.get(solver, {}))(),
                "ours": own_step(solver, "joint", problem)(),
                "terms": minks_terms(problem, solver),
            }
            blocks = rounds * blocks_of(STEPS, length=16, count=12)
            timed = interleaved(steps, blocks, np.random.default_rng(0))
            ratios = [
                timed[a].ratio_to(timed[b])
                for a, b in (("ours", "mink"), ("terms", "mink"), ("terms", "settings"))
            ]
            rows.append((
                solver, problem.model.nv,
                *(f"{1e-3 * float(np.median(timed[name].warm)):.0f}" for name in steps),
                *(f"{middle:.2f} ({low:.2f}–{high:.2f})" for middle, low, high in ratios),
            ))  # fmt: skip
            print(*rows[-1], file=sys.stderr)
    return markdown_table(headings, rows)


if __name__ == "__main__":
    parts = {f.__name__: f for f in (calls, prepared_steps, named_backends)}
    sys.exit(command(__doc__, parts, rounds=5, solvers="daqp,quadprog,proxqp,osqp"))

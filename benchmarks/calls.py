"""What one call costs: ours, mink's with limits made in each call or once, closed forms.

    python benchmarks/calls.py [--markdown FILE]

Six joints, the tool's position and axis, the ranges of the joints, a secondary: `deburring` at its
start, the second waypoint as target; kinematics and target are given. All contenders take their
turn in every round, in an order drawn anew, so that what disturbs the machine disturbs all; time is
that of the processor. The table has the best round, and over the rounds the median, 10th and 90th
percentile of the ratio to the call that is named, in the same round. A minute.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import time
from collections.abc import Callable
from dataclasses import dataclass

import mink
import numpy as np
from publishing import command

import qp_twist as qt

ROUNDS, WARM, BLOCK, DT = 120, 5, 10, 0.01
HARD, SOFT, STEP = "hard, once", "soft, once", "compiled"
"""The calls that the ratios are taken to."""


@dataclass(frozen=True)
class Contender:
    """One call.

    Attributes:
        words: What it is, in the table.
        call: Makes it.
        against: Key of the contender whose time is 1.
    """

    words: str
    call: Callable[[], object]
    against: str


def contenders() -> dict[str, Contender]:
    """Every contender, ready to be called, those that are compared beside each other."""
    path = qt.load_task("deburring")
    model = path.model
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

    found: dict[str, Contender] = {}
    for kind, tasks, constraints, base in (
        ("soft", [frame, posture], None, SOFT), ("hard", [posture], [tool], HARD)
    ):  # fmt: skip
        words = "a `FrameTask` as cost" if kind == "soft" else "a `TwistTask` as constraint"
        for name, solve_ik in (("mink", mink.solve_ik), ("qt", qt.solve_ik)):
            for when, limits in (("each", None), ("once", made)):
                default = " (its default)" if when == "each" else ""
                found[f"{kind}, {when}" if name == "mink" else f"{name} {kind}, {when}"] = (
                    Contender(
                        f"`{name}.solve_ik`, {words}, limits made "
                        f"{'in each call' if when == 'each' else 'once'}{default}",
                        lambda solve_ik=solve_ik, tasks=tasks, limits=limits, rows=constraints: (
                            solve_ik(
                                configuration, tasks, DT, "daqp", limits=limits, constraints=rows
                            )
                        ),
                        base,
                    )
                )
    for solver, space, words in (
        ("daqp", "joint", "daqp"), ("compiled", "joint", "compiled"),
        ("compiled", "twist", 'compiled, `secondary_space="twist"`'),
        ("quadprog", "joint", "posed anew (quadprog)"),
    ):  # fmt: skip
        if solver in qt.qp.installed_solvers():
            centering = qt.JointCentering(model, weight="natural", gain=0.05)
            controller = qt.Controller(
                model, [tool], secondary=[centering], secondary_space=space, solver=solver,
                metric=ranges.metric,
            )  # fmt: skip
            assert controller.step(configuration, DT).status is qt.Status.SOLVED
            found[solver if space == "joint" else space] = Contender(
                f"`controller.step`, {words}",
                lambda controller=controller: controller.step(configuration, DT),
                HARD,
            )

    def bare() -> np.ndarray:
        inverse = rows.T @ np.linalg.inv(rows @ rows.T)
        return inverse @ (rate - rows @ h) + h

    np.testing.assert_allclose(bare(), qt.closed_form.gradient_projection(J, T, error, h))
    found["closed"] = Contender(
        "`closed_form.gradient_projection` on arrays: `np.linalg.pinv`, arguments checked",
        lambda: qt.closed_form.gradient_projection(J, T, error, h),
        STEP,
    )
    found["bare"] = Contender(
        "the same formula on the five rows: `np.linalg.inv`, nothing checked", bare, STEP
    )
    found["update"] = Contender(
        "`configuration.update()`, MuJoCo's kinematics", configuration.update, STEP
    )
    found["target"] = Contender(
        "`tool.set_target(pose)`", lambda: tool.set_target(path.waypoints[1]), STEP
    )
    return found


def page() -> list[str]:
    everyone, rng = contenders(), np.random.default_rng(0)
    times = {key: np.zeros(ROUNDS) for key in everyone}
    for turn in range(ROUNDS):
        for key in rng.permutation(list(everyone)):
            call = everyone[key].call
            for _ in range(WARM):
                call()
            began = time.thread_time()
            for _ in range(BLOCK):
                call()
            times[key][turn] = (time.thread_time() - began) / BLOCK
    bases = {HARD: "`mink`, constraint, once", SOFT: "`mink`, cost, once", STEP: "compiled step"}
    lines = ["| call | µs | ratio | p10–p90 | to |", "| :-- | --: | --: | --: | :-- |"]
    for key, one in everyone.items():
        micro = 1e6 * times[key].min()
        base = one.against if one.against in everyone else "daqp"
        low, middle, high = np.quantile(times[key] / times[base], [0.1, 0.5, 0.9])
        lines.append(
            f"| {one.words} | {micro:.{1 if micro < 20 else 0}f} | {middle:.2g} "
            f"| {low:.2g}–{high:.2g} | {bases.get(base, base)} |"
        )
    return lines


if __name__ == "__main__":
    command(__doc__, page)

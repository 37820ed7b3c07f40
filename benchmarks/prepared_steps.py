"""What a step takes where limits, bands, levels or other tasks are added to it.

    python benchmarks/prepared_steps.py [--markdown FILE]

The call alone, at one configuration of `deburring`, the best of many; prepared, compiled and with
daqp, and posed anew by a backend that keeps no memory. Half a minute. The last rows are steps that
do not fit inside the limits of 0.5 rad/s.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import timeit
from typing import Any

import mink
import numpy as np
from publishing import command

import qp_twist as qt

PATH = qt.load_task("deburring")
MODEL = PATH.model
GIVES_WAY = "two levels, the lower one gives way"
HINDERED = {
    "scaled": qt.Status.SCALED, "relaxed": qt.Status.RELAXED, GIVES_WAY: qt.Status.PRIORITIZED,
}  # fmt: skip
SOLVERS = {"compiled": 1000, "daqp": 60}
"""Backends, and how many calls are timed at once."""


class HalfSpaces(mink.Limit):
    """Four rows G q̇ ≤ 1, as any app's own limit may state them."""

    def __init__(self) -> None:
        self.G = np.random.default_rng(0).normal(size=(4, MODEL.nv))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=np.full(4, dt))


def controller(added: str, solver: str) -> qt.Controller:
    """Position limits, a tool axis and centring, with something added."""
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
        limits = [qt.MotionLimit(MODEL, velocity=0.5)]
        options |= {"on_infeasible": "relax" if added == "relaxed" else "scale"}
    composed = qt.Controller(
        MODEL, tasks, secondary=[qt.JointCentering(MODEL)], limits=limits, solver=solver, **options
    )
    for task in composed.twist_tasks:
        task.set_target(PATH.waypoints[1])
    return composed


def page() -> list[str]:
    solvers = {s: n for s, n in SOLVERS.items() if s in qt.qp.installed_solvers()}
    lines = [
        f"| µs | {' | '.join(solvers)} |".replace("daqp", "by name (daqp)"),
        f"| :-- |{' --: |' * len(solvers)}",
    ]
    configuration = mink.Configuration(MODEL, PATH.start)
    for added in (
        "bounds alone", "two levels", "four rows of a limit", "a `mink.PostureTask` as a cost",
        "a roll band", "a soft roll band", "mink's `ConfigurationLimit` and `VelocityLimit`",
        *HINDERED,
    ):  # fmt: skip
        cells = []
        for solver, count in solvers.items():
            composed = controller(added, solver)
            step = composed.step(configuration, 0.01)
            assert step.status is HINDERED.get(added, qt.Status.SOLVED), step.message
            call = timeit.Timer(lambda composed=composed: composed.step(configuration, 0.01))
            seconds = min(call.repeat(15, count)) / count
            cells.append(f"{1e6 * seconds:.1f}" if seconds < 1e-5 else f"{1e6 * seconds:.0f}")
        lines.append(f"| {added} | {' | '.join(cells)} |")
    return lines


if __name__ == "__main__":
    command(__doc__, page)

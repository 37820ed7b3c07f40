"""Plans of arms without a spherical wrist, and of arms of seven joints, beside an independent net.

    python benchmarks/arms.py [plan_arms] [--samples 60] [--jobs 2] [--write]
    python benchmarks/arms.py [solutions] [--write]

*plan_arms*: plans, and certificates where there are none.
Six waypoints of a half-circle at random places about each arm, no joint moving more than 10° to
the next one, from any start and from a random one. Six joints: the roll is free; seven: all six
directions are prescribed; so that one degree is free. The search does without closed forms: at each
waypoint a net grows along the self-motions from 600 random configurations that Newton's method
brings onto it. Its motions are motions: where it has one, a plan that is missing is a fault, and
a certificate of "none" wrong.

*solutions*: how many of 3,000 random configurations are among the solutions of their poses, how far
the solutions are from these, and what a pose takes.
"""

from page import command, in_processes, markdown_table

# isort: split
import dataclasses
import json
import sys
import time
from typing import Any

import mink
import mujoco
import numpy as np
from oracles.cobots import COBOTS, cobot
from plans import LARGEST_STEP, searched

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.kinematics import ParametrisedArm, SerialChain
from qp_twist.planning.manifold_net import ManifoldNet
from qp_twist.planning.path_rows import PathRows

SEEDS, SPACING = 600, np.radians(5.0)
"""Of the nets: random configurations at each waypoint, and the distance of their nodes."""
COUNT = 6
"""Number of waypoints."""
ARMS = ["M-16iB", *(name for name in COBOTS if name != "xArm6")]


def placed(name: str, index: int) -> qt.PathTask:
    """The half-circle at a random place about an arm."""
    task, rng = qt.load_task("deburring"), np.random.default_rng([12, index])
    model, reach = (task.model, 1.6) if name == "M-16iB" else (cobot(name), COBOTS[name][3])
    away = rng.normal(size=3)
    away *= rng.uniform(0.3, 1.1) * reach / np.linalg.norm(away)
    turn = mink.SO3.from_z_radians(rng.uniform(-np.pi, np.pi))
    turn = turn @ mink.SO3.from_x_radians(rng.uniform(0.5, 1.5) * np.pi)
    place = mink.SE3.from_rotation_and_translation(turn, away + np.array([0.0, 0.0, 0.3]))
    angles = np.linspace(-0.5, 0.5, 19)[:COUNT] * np.pi
    circle = 0.08 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(COUNT)])
    full, nothing = qt.Projector.full(), np.full(model.nv, np.inf)
    whole = qt.TwistProjector(linear=full, angular=full)
    return dataclasses.replace(
        task, name=name, model=model, flipped_waypoints=None, constraints=(), durations=None,
        waypoints=tuple(place @ mink.SE3.from_translation(point) for point in circle),
        projector=task.projector if model.nv == 6 else whole, start=np.zeros(model.nv),
        velocity_limits=nothing, acceleration_limits=nothing,
    )  # fmt: skip


def fault_of(task: qt.PathTask, q: Array, start: Array | None) -> str:
    """What is wrong with a plan, by MuJoCo at its waypoints; nothing if it is right."""
    data, worst = mujoco.MjData(task.model), 0.0
    for row, waypoint in zip(q, task.waypoints, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        frame = getattr(data, task.frame_type)(task.frame_name)
        target, now = waypoint.rotation().as_matrix(), frame.xmat.reshape(3, 3)
        worst = max(worst, np.abs(frame.xpos - waypoint.translation()).max())
        kept = slice(2, 3) if task.model.nv == 6 else slice(3)
        worst = max(worst, np.abs((now - target)[:, kept]).max())
    lower, upper = task.model.jnt_range.T
    faults = {
        "off the path": worst > 1e-8,
        "outside the limits": bool(((q < lower) | (q > upper)).any()),
        "too fast": np.abs(np.diff(q, axis=0)).max() > np.radians(LARGEST_STEP) + 1e-9,
        "elsewhere at first": start is not None and not np.array_equal(q[0], start),
    }
    return ", ".join(name for name, wrong in faults.items() if wrong)


def placement(job: tuple[str, int]) -> list[dict[str, Any]]:
    """A place, from any start and from a random one: the search, the plan, and its faults."""
    name, index = job
    task, rows = placed(name, index), []
    seeded = PathRows(task)
    seeded.closed_forms = []
    net = ManifoldNet(task, seeded, SPACING, seeds=SEEDS)
    layers: list[Array] = []
    for k in range(COUNT):
        layers.append(net.layer(k).q)
        if not len(layers[-1]):
            break
    starts = [None]
    if len(layers[0]):
        starts.append(layers[0][np.random.default_rng([13, index]).integers(len(layers[0]))])
    for start in starts:
        began = time.process_time()
        plan = qt.plan(task, start=start, max_step_deg=LARGEST_STEP)
        took = time.process_time() - began
        rows.append(
            {
                "arm": name, "index": index, "fixed": start is not None, "s": took,
                "search": searched(layers, start, np.radians(LARGEST_STEP)),
                "plan": plan.q is not None, "certificate": str(plan.certificate),
                "proved": plan.q is None and plan.certificate.covered,
                "fault": "" if plan.q is None else fault_of(task, plan.q, start),
            }
        )  # fmt: skip
    return rows


def plan_arms(samples: int, jobs: int) -> tuple[str, int]:
    """So many places for each arm; the number of wrong results."""
    found: list[dict[str, Any]] = []
    todo = [(name, index) for index in range(samples) for name in ARMS]
    for rows in in_processes(placement, todo, jobs):
        print(*map(json.dumps, rows), sep="\n", file=sys.stderr, flush=True)
        found += rows
    return table_of(found)


def table_of(found: list[dict[str, Any]]) -> tuple[str, int]:
    """The table, and the number of plans that are missing or wrong."""
    table, wrong = [], 0
    for name in ARMS:
        for fixed in (False, True):
            own = [row for row in found if (row["arm"], row["fixed"]) == (name, fixed)]
            possible = [row for row in own if row["search"]]
            missing = sum(not row["plan"] for row in possible)
            faulty = sum(bool(row["fault"]) for row in own)
            wrong += missing + faulty
            none = [row for row in own if not row["plan"]]
            seconds = sorted(row["s"] for row in own)
            numbers = (
                len(own), len(possible), missing, sum(row["plan"] for row in own), faulty,
                len(none), sum(row["search"] for row in none if row["proved"]),
            )  # fmt: skip
            times = f"{np.median(seconds):.2f}", f"{seconds[-1]:.1f}"
            table.append(
                (f"{name}, {'random' if fixed else 'any'} start", *map(str, numbers), *times)
            )
    headings = ("arm", "paths", "net has a motion", "not planned of these", "planned in all",
                "wrong plans", "none", "wrong certificates", "median, s", "longest, s")  # fmt: skip
    return markdown_table(headings, table), wrong


def solutions() -> tuple[str, int]:
    """A row for each arm; the number of configurations that are not found."""
    table, lost = [], 0
    for name in COBOTS:
        chain = SerialChain.of(cobot(name), "tool", "site")
        arm = ParametrisedArm.recognise(chain)[0]
        q = np.random.default_rng(5).uniform(-np.pi, np.pi, (3000, chain.nv))
        (R, p), given = chain.poses(q), q[:, list(arm.parameters)]
        arm.branches(R[:9], p[:9], given[:9])  # compiles
        began = time.process_time()
        found = arm.branches(R, p, given)
        took = time.process_time() - began
        apart = np.abs(np.remainder(found - q[:, None] + np.pi, 2.0 * np.pi) - np.pi).max(axis=2)
        pose, branch = np.nonzero(np.isfinite(apart))
        again = zip(chain.poses(found[pose, branch]), (R, p), strict=True)
        off = max(np.abs(now - target[pose]).max() for now, target in again)
        missed = int((np.nanmin(apart, axis=1, initial=np.inf) > 1e-5).sum())
        counts = np.bincount(pose, minlength=len(q))
        lost += missed
        numbers = f"{counts.mean():.1f}", str(counts.max()), str(missed), f"{off:.0e}"
        table.append((name, *numbers, f"{1e6 * took / len(q):.0f}"))
    headings = ("arm", "solutions of a pose, mean", "most", "not found, of 3,000",
                "largest error, m and rad", "a pose, µs")  # fmt: skip
    return markdown_table(headings, table), lost


if __name__ == "__main__":
    parts = {"plan_arms": plan_arms, "solutions": solutions}
    sys.exit(command(__doc__, parts, samples=60, jobs=2))

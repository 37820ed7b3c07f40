"""Plans beside an independent search, and what they take.

    python benchmarks/plans.py [plan_costs] [--write]
    python benchmarks/plans.py [plan_optimality] [--samples 40] [--roll-step 2] [--write]
    python benchmarks/plans.py [no_plan] --folder out/random [--roll-step 2] [--write]
    python benchmarks/plans.py [plan_placements] [--samples 75] [--write]
    python benchmarks/plans.py [plan_layers] [--samples 40] [--write]
    python benchmarks/plans.py [table_run] [--write]
    python benchmarks/plans.py [plan_times] [--starts 10] [--tasks NAME,FILE.toml,…] [--write]

*plan_costs*: time and memory over waypoints, steps and redundancy. Each plan is made by a process
of its own, which reports its wall time, its processor time, and how much its peak of memory is
above that before the plan. A few minutes.

*plan_optimality*: how far a run along a plan is from the least mean z that there is. Places the
deburring part as a study does, plans from the best start, follows the plan with qp_planned, and
compares the run's mean z with the shortest way through all in-limit joint positions at rolls so
many degrees apart. That search shares nothing with the plan: it has the inverse kinematics of
benchmarks/placements.py, every waypoint, every branch, every full turn. A way on a grid is never
better than the best motion, so the ratio can be below 1.

*no_plan*: whether a study's samples without a plan have none by that search, too. Reads a study of
`qp_planned` on `deburring`. For every sample that has a motion from some start but no plan from its
own, the search goes from there waypoint by waypoint, and says at which it ends; about two seconds a
sample. What it found is kept beside the results.

*plan_placements*: short paths at random places, for the arm of seven joints and for the arm on a
rail, from free and from random fixed starts; and whether an independent search finds a motion. It
has closed-form inverse kinematics on a grid of the free coordinates (for the seven joints, whose
first three axes meet in one point as its last three do: of the elbow's angle about the line from
shoulder to wrist), and the same largest step. Its motions are motions, so a plan that is missing
where it finds one is a fault. Where it finds none there may be one between its nodes.

*plan_layers*: which pieces of self-motion manifolds inside the limits the layers of waypoints have,
in closed form and from random seeds, at the poses of random configurations. All pieces are those of
these two layers and of a third one, from 5,000 random seeds. Nodes are of one piece if they lead to
each other in steps of two spacings; a layer misses a piece of which it has no node.

*table_run*: what ``qp-twist run`` does, for the part on a turn-tilt table: plan, follow, insert
rows until straight joint motion keeps the path, time from rest to rest, check. Between rows MuJoCo
measures the tool's distance from the path, too, at 20 points each.

*plan_times*: plans in time without a feed, at 50 mm/s and at 0.5 m/s, beside the least times of the
plans for centering and for travel weighted by 1/v, the best of a local search from so many other
plans (travel with random weights), and the smooth run along the plan. Of tasks with a feed.
"""

from __future__ import annotations

from page import command, each, in_processes, markdown_table

# isort: split
import dataclasses
import itertools
import json
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import mink
import mujoco
import numpy as np
from placements import MAX_STEP, InverseKinematics, dead_end
from scipy.spatial import cKDTree
from timer import once

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.planning.manifold_net import SEEDS, ManifoldNet
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import Problem
from qp_twist.planning.problem import motion_limits as path_limits
from qp_twist.planning.smooth import smooth
from qp_twist.referee import JointMotion, PathErrors, motion_limits, with_default_accelerations
from qp_twist.studies import Study
from qp_twist.studies.judge import Judge
from qp_twist.studies.sample import draw_sample

# ---------------------------------------------------------------- what a plan takes

SEVEN = "".join(
    f'<body name="link_{k}" pos="0 0 {length}"><joint name="joint_{k}" axis="{axis}" '
    f'range="{-limit} {limit}"/><geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.04"/>'
    for k, (axis, length, limit) in enumerate(
        [("0 0 1", 0.2, 2.9), ("0 1 0", 0.15, 2.0), ("0 0 1", 0.2, 2.9), ("0 -1 0", 0.2, 2.0),
         ("0 0 1", 0.2, 2.9), ("0 1 0", 0.2, 2.0), ("0 0 1", 0.1, 3.0)],
        start=1,
    )
)  # fmt: skip
SEVEN = (
    '<mujoco model="seven"><compiler angle="radian" autolimits="true"/><worldbody>'
    f'{SEVEN}<site name="tool" pos="0 0 0.1"/>{"</body>" * 7}</worldbody></mujoco>'
)


def deburring(every: int) -> qt.PathTask:
    """The run at every n-th of its waypoints."""
    task = qt.load_task("deburring")
    assert task.flipped_waypoints is not None
    return dataclasses.replace(
        task, waypoints=task.waypoints[::every], flipped_waypoints=task.flipped_waypoints[::every],
        durations=None,
    )  # fmt: skip


def seven(count: int) -> qt.PathTask:
    """A half-circle on a table with a free roll, for an arm of seven joints."""
    model = mujoco.MjModel.from_xml_string(SEVEN)
    angles = np.linspace(-0.5, 0.5, count) * np.pi
    down = mink.SO3.from_x_radians(np.pi)
    waypoints = tuple(
        mink.SE3.from_rotation_and_translation(
            down, np.array([0.45 + 0.1 * np.cos(a), 0.1 * np.sin(a), 0.3])
        )
        for a in angles
    )
    return dataclasses.replace(
        qt.load_task("deburring"), name="seven", model=model, waypoints=waypoints,
        flipped_waypoints=None, start=np.array([0.0, 0.6, 0.0, -1.2, 0.0, 1.3, 0.0]),
        durations=None, velocity_limits=np.full(7, np.inf), acceleration_limits=np.full(7, np.inf),
    )  # fmt: skip


def on_a_rail(every: int) -> qt.PathTask:
    """The deburring run at every n-th of its waypoints, the arm on 2 m of rail beside it."""
    task = deburring(every)
    spec = mujoco.MjSpec.from_file(str(task.scene))
    spec.body("base").add_joint(
        name="rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0], range=[-1.0, 1.0],
        limited=1,
    )  # fmt: skip
    none = np.full(7, np.inf)
    return dataclasses.replace(
        task, name="rail", model=spec.compile(), start=np.append(0.0, task.start),
        flipped_waypoints=None, velocity_limits=none, acceleration_limits=none,
    )  # fmt: skip


def on_a_table(every: int) -> qt.PathTask:
    """The deburring run, the part on a table that turns by 180° and tilts by 60° to either side.

    The path stands still in the plate that carries the part. A path task is fixed to the world, so
    the plate is the world here, and the arm's base moves against it: first about the plate's axis,
    then about the tilting one, each the other way round. Joint values are those of the cell.
    """
    task = deburring(every)
    spec = mujoco.MjSpec.from_file(str(task.scene))
    for name, axis, most in (("turn", [0.0, 0.0, -1.0], 180.0), ("tilt", [-1.0, 0.0, 0.0], 60.0)):
        spec.body("base").add_joint(
            name=name, axis=axis, pos=[0.0, 1.0, 0.3], range=np.radians([-most, most]), limited=1
        )
    none = np.full(8, np.inf)
    return dataclasses.replace(
        task, name="table", model=spec.compile(), start=np.append([0.0, 0.0], task.start),
        flipped_waypoints=None, velocity_limits=none, acceleration_limits=none,
    )  # fmt: skip


def out_of_reach(count: int) -> qt.PathTask:
    """The half-circle of the arm of seven joints, too far away at its end."""
    task = seven(count)
    far = mink.SE3.from_translation(np.array([0.6, 0.0, 0.0]))
    waypoints = (*task.waypoints[: count - 3], *(far @ w for w in task.waypoints[count - 3 :]))
    return dataclasses.replace(task, waypoints=waypoints)


def planar(count: int) -> qt.PathTask:
    """The line at so many of its waypoints."""
    task = qt.load_task("planar_line")
    chosen = np.linspace(0, 100, count).round().astype(int)
    return dataclasses.replace(task, waypoints=tuple(task.waypoints[k] for k in chosen))


CASES = {
    **{
        f"6R, roll free, {400 // every + 1} waypoints, steps of {step}°": (deburring, every, step)
        for every, step in ((8, 24), (4, 12), (2, 6), (1, 3), (1, 1.5), (1, 6), (1, 15))
    },
    **{f"3R, one free, {n} waypoints": (planar, n, 15) for n in (26, 51, 101)},
    **{f"7R, two free, {n} waypoints": (seven, n, 15) for n in (6, 21, 101, 401)},
    "6R on a rail, two free, 401 waypoints": (on_a_rail, 1, 15),
    **{
        f"6R, part on a turn-tilt table, three free, {400 // every + 1} waypoints": (
            on_a_table,
            every,
            15,
        )
        for every in (8, 1)
    },
    "7R, two free, three of 401 waypoints out of reach": (out_of_reach, 401, 15),
}


def cost(case: str) -> tuple[float, float, float, float, float]:
    """Seconds, processor seconds, memory, MB, value and bound of a plan in this process."""
    make, argument, step = CASES[case]
    task = make(argument)
    before, cpu = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    took, plan = once(partial(qt.plan, task, "centering", max_step_deg=step))
    cpu = time.process_time() - cpu
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
    return 1e-9 * took, cpu, memory, plan.value, plan.bound


def plan_costs() -> str:
    """Each plan in a process of its own."""
    rows = []
    for case in CASES:
        [(wall, cpu, memory, value, bound)] = in_processes(cost, [case], 1)
        found = ("none" if np.isnan(number) else f"{number:.4f}" for number in (value, bound))
        numbers = f"{wall:.1f}", f"{cpu:.1f}", f"{memory:.0f}", *found
        rows.append((case, *numbers))
        print(*rows[-1], file=sys.stderr, flush=True)
    headings = ("arm and path", "time, s", "processor, s", "memory, MB", "mean z", "bound")
    return markdown_table(headings, rows)


# ---------------------------------------------------------------- from a plan to a run

TABLE_SPEED = 1.0
"""Assumed speed limit of the table's axes, rad/s; the arm's are those of the task."""
_BETWEEN = 20
"""Number of points between two rows at which the tool is measured."""


def table_run() -> tuple[str, int]:
    """The steps from a plan with three free degrees to a checked trajectory."""
    task, arm = on_a_table(1), qt.load_task("deburring")
    speeds = np.append([TABLE_SPEED, TABLE_SPEED], arm.velocity_limits)
    task = dataclasses.replace(task, durations=arm.durations, velocity_limits=speeds)
    limits = with_default_accelerations(motion_limits(task), qt.JointRanges.of(task.model))
    rows = []

    def step(name: str, make: Callable[[], Any]) -> Any:
        cpu = time.process_time()
        took, made = once(make)
        rows.append((name, f"{1e-9 * took:.1f}", f"{time.process_time() - cpu:.1f}", "", "", ""))
        return made

    def errors(count: int, motion: JointMotion, proven: PathErrors) -> None:
        rows[-1] = (
            *rows[-1][:3],
            str(count),
            f"{1e3 * measured_off(task, motion):.3f}",
            f"{1e3 * proven.position.bound.max():.3f} and "
            f"{np.degrees(proven.axis.bound.max()):.3f}°",
        )

    qt.plan(on_a_table(100), max_step_deg=30.0)  # machine code is compiled, or loaded
    plan = step("plan", lambda: qt.plan(task))
    times = np.arange(len(plan.q), dtype=np.float64)
    errors(len(plan.q), JointMotion(times, plan.q), plan.between)
    run = step("follow", lambda: qt.follow(task, "qp_planned", plan=plan, slow_down=True))
    fine = step("rows between", lambda: qt.refine_trajectory(run))
    motion = JointMotion(np.arange(len(fine.q), dtype=np.float64), fine.q)
    errors(len(fine.q), motion, fine.between)
    timed = step("times", lambda: qt.time_trajectory(fine, limits=limits))
    check = step("check", lambda: qt.check_trajectory(timed, task))
    errors(len(timed.q), check.motion, check.errors)
    headings = ("", "time, s", "processor, s", "rows", "measured, mm", "proven, mm and °")
    text = f"{markdown_table(headings, rows)}\nThe check {check.verdict}.\n"
    return text, int(not check.passes)


FEEDS = {"none": None, "50 mm/s": 0.05, "0.5 m/s": 0.5}


def in_time(task: qt.PathTask, starts: int) -> Iterator[tuple[str, ...]]:
    """The rows of *plan_times* for a task."""
    assert task.durations is not None
    lengths = np.linalg.norm(np.diff(task.positions, axis=0), axis=1)
    own = float((lengths / task.durations[1:]).max())  # corners may turn more slowly
    free = dataclasses.replace(task, durations=None)
    ranges, rows, rng = qt.JointRanges.of(task.model), PathRows(task), np.random.default_rng(0)
    inverse = 1.0 / motion_limits(task).velocity

    def travelling(weights: Array) -> Array:
        named = dict(zip(ranges.names, weights.tolist(), strict=True))
        return qt.plan(free, "travel", joint_weights=named, seeds=()).motion()

    others = qt.plan(free, seeds=()).motion(), travelling(inverse)
    begins = [
        travelling(inverse * np.exp(rng.normal(scale=0.7, size=len(inverse))))
        for _ in range(starts)
    ]
    for feed, speed in FEEDS.items():
        durations = None if speed is None else task.durations * (own / speed)
        timed_task = dataclasses.replace(task, durations=durations)
        cpu = time.process_time()
        plan = qt.plan(timed_task, "time")
        cpu = time.process_time() - cpu
        goal = Objective.of(ranges, "time").along(timed_task)
        limits = path_limits(timed_task, ranges, None, rows.hard, slow_down=True)
        near = [smooth(Problem(timed_task, rows, limits, goal), q) for q in begins]
        best = min((path.value for path in near if path.feasible), default=np.nan)
        run = qt.follow(timed_task, "qp_planned", plan=plan, slow_down=True, fine=True)
        with_default = with_default_accelerations(motion_limits(task), ranges)
        timed = qt.time_trajectory(qt.refine_trajectory(run), limits=with_default)
        passes = qt.check_trajectory(timed, timed_task).passes
        seconds = [*map(goal.value, others), plan.value, plan.bound, best, float(timed.times[-1])]
        words = ("–" if np.isnan(t) else f"{t:.2f}" for t in seconds)
        verdict = "passes" if passes else "does not pass"
        yield f"{task.name}, {feed}", *words, verdict, f"{cpu:.1f}"


def plan_times(tasks: str, starts: int) -> str:
    """Plans in time beside others."""
    rows = []
    for name in tasks.split(","):
        for row in in_time(qt.load_task(name), starts):
            rows.append(row)
            print(*row, file=sys.stderr, flush=True)
    headings = ("path, feed", "centering, s", "travel/v, s", "time, s", "bound, s",
                f"best of {starts} starts, s", "run, s", "its check", "processor, s")  # fmt: skip
    return markdown_table(headings, rows)


def measured_off(task: qt.PathTask, motion: JointMotion) -> float:
    """Largest distance of the tool from the polygon of the waypoints between rows, m, by MuJoCo."""
    data, corners, worst = mujoco.MjData(task.model), task.positions, 0.0
    begin, along = corners[:-1], np.diff(corners, axis=0)
    shares = np.arange(_BETWEEN) / _BETWEEN
    for first, last in itertools.pairwise(motion.times):
        for q in motion.at(first + shares * (last - first)).q:
            data.qpos[:] = q
            mujoco.mj_kinematics(task.model, data)
            off = data.site("tool").xpos - begin
            share = np.clip((off * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
            near = np.linalg.norm(off - share[:, None] * along, axis=1).min()
            worst = max(worst, float(near))
    return worst


# ---------------------------------------------------------------- how good a plan is

CELL = np.radians(2.0)
"""Of joint positions this near to each other the one of least z stands for all."""


def least_mean_z(task: qt.PathTask, roll_step: float) -> float:
    """Mean z of the grid's best way, no joint moving more than 15° to the next waypoint."""
    arm = InverseKinematics(task)
    rolls = np.radians(np.arange(0.0, 360.0, roll_step))
    before: Array | None = None
    sums = np.zeros(0)
    for pose in task.waypoints:
        layer = arm.layer(pose, rolls)
        z = arm.ranges.centering(layer)
        layer, z = layer[np.argsort(z)], np.sort(z)
        _, first = np.unique(np.round(layer / CELL), axis=0, return_index=True)
        layer, z = layer[first], z[first]
        if before is None:
            sums = z
        else:
            near = cKDTree(layer).query_ball_tree(cKDTree(before), MAX_STEP, p=np.inf)
            counts = np.array([len(rows) for rows in near])
            layer, z = layer[counts > 0], z[counts > 0]
            begins = np.cumsum(counts[counts > 0]) - counts[counts > 0]
            if not len(layer):
                return np.nan
            sums = z + np.minimum.reduceat(sums[np.concatenate(near).astype(np.intp)], begins)
        before = layer
    return float(sums.min()) / len(task.waypoints)


def optimality(index: int, roll_step: float) -> dict[str, Any]:
    """One sample."""
    task = qt.load_task("deburring")
    task = draw_sample(task, ("placement",), index, start="best", methods=("qp_planned",)).path_task
    plan = qt.plan(task)
    if plan.q is None:
        return {"sample": index, "feasible": False}
    run = qt.follow(task, "qp_planned", plan=plan)
    return {
        "sample": index,
        "feasible": True,
        "fault": str(Judge(task).fault(run) or ""),
        "mean_z": float(run.z.mean()),
        "plan": plan.value,
        "bound": plan.bound,
        "grid": least_mean_z(task, roll_step),
    }


def plan_optimality(samples: int, first: int, jobs: int, roll_step: float) -> str:
    """Ratios of the mean z of runs along plans."""
    runs = []
    work = partial(optimality, roll_step=roll_step)
    for row in in_processes(work, range(first, first + samples), jobs):
        print(json.dumps(row), file=sys.stderr, flush=True)
        if row["feasible"]:
            runs.append(row)
    rows = []
    for key, what in (
        ("plan", "the plan's value"),
        ("grid", f"an independent search's, rolls {roll_step:g}° apart"),
        ("bound", "the plan's bound: every waypoint for itself"),
    ):
        ratios = np.array([row["mean_z"] / row[key] for row in runs])
        numbers = (f"{value:.4f}" for value in np.percentile(ratios, [50, 90, 100]))
        rows.append((what, *numbers, f"{100.0 * (ratios <= 1.02).mean():.0f} %"))
    table = markdown_table(("", "median", "90 %", "largest", "at most 1.02"), rows)
    return f"{len(runs)} runs. Mean z of the run, divided by …\n\n{table}"


# ---------------------------------------------------------------- where there is no plan


def ends_at(sample: int, folder: str, roll_step: float) -> int | None:
    """Waypoint, from 1, that the search does not get to; None if it gets to all."""
    task = Study.open(folder, qt.load_task("deburring")).sample(sample).path_task
    return dead_end(task, InverseKinematics(task), task.start, roll_step=roll_step)


def no_plan(folder: str, jobs: int, roll_step: float) -> str:
    """The study's samples, and what the search finds of those without a plan."""
    table = Study.open(folder, qt.load_task("deburring")).table()
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    rows = [row for row in rows if row["method"] == "qp_planned"]
    feasible = [row for row in rows if row["feasible"]]
    done = [row for row in feasible if row["success"]]
    missing = [row["sample"] for row in feasible if row["fault"] == "no plan"]
    other = Counter(row["fault"] for row in feasible if row["fault"] not in ("", "no plan"))
    ends = list(each(ends_at, missing, jobs, folder, folder=folder, roll_step=roll_step))
    planned = len(feasible) - len(missing)
    lines = [
        f"{len(rows):5,} random placements, each with a random start inside the limits",
        f"{len(feasible):5,} of them have a motion from some start",
        f"{planned:5,} of these have a plan from their own start",
        f"{len(done):5,} of those are followed to the end: {100 * len(done) / planned:.1f} %",
        f"{len(missing):5,} have no plan from their own start; for "
        f"{sum(end is not None for end in ends):,} of these the independent search has no way "
        "either",
    ]
    if other:
        faults = ", ".join(f"{count} {fault}" for fault, count in other.items())
        lines.append(f"      other faults: {faults}")
    lines += [
        "",
        f"of the runs followed: least margin {min(r['min_margin'] for r in done):.1g}, largest "
        f"step {max(r['max_step_deg'] for r in done):.2f}°, largest error "
        f"{max(r['position_error_max_m'] for r in done):.0e} m",
    ]
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- short paths at random places

LARGEST_STEP = 10.0
"""Of a joint to the next waypoint, degrees."""


def placed_seven(index: int) -> qt.PathTask:
    """13 waypoints of a half-circle of 19 at a random place about the arm of seven joints."""
    rng, task = np.random.default_rng([7, index]), seven(19)
    task.model.geom_contype[:] = 0  # the independent search knows of no clearance
    away = rng.normal(size=3)
    away *= rng.uniform(0.2, 0.7) / np.linalg.norm(away)
    turn = mink.SO3.from_z_radians(rng.uniform(-np.pi, np.pi))
    turn = turn @ mink.SO3.from_x_radians(rng.uniform(-0.5, 0.5) * np.pi)
    place = mink.SE3.from_rotation_and_translation(turn, away + np.array([0.0, 0.0, 0.35]))
    here = place @ mink.SE3.from_translation(np.array([-0.45, 0.0, -0.3]))
    waypoints = tuple(here @ w for w in task.waypoints[:13])
    return dataclasses.replace(task, waypoints=waypoints, constraints=())


def placed_rail(index: int) -> qt.PathTask:
    """13 waypoints of the deburring run at a random place along 2 m of rail."""
    rng, task = np.random.default_rng([8, index]), on_a_rail(2)
    first = rng.integers(len(task.waypoints) - 12)
    part = task.waypoints[first : first + 13]
    turn = mink.SO3.from_z_radians(rng.uniform(-np.pi, np.pi))
    turn = turn @ mink.SO3.from_x_radians(rng.uniform(-0.5, 0.5) * np.pi)
    place = mink.SE3.from_rotation_and_translation(
        turn, rng.uniform([-2.0, 0.4, -0.4], [2.0, 2.2, 1.6])
    )
    here = place @ mink.SE3.from_translation(-part[6].translation())
    return dataclasses.replace(task, waypoints=tuple(here @ w for w in part))


class SevenKinematics:
    """Configurations of the arm of seven joints, the last one at rest: it only turns the tool."""

    def __init__(self, task: qt.PathTask, last: float) -> None:
        self.limits, self.last = task.model.jnt_range[:6], last

    def layer(self, pose: mink.SE3) -> Array:
        """Eight configurations at each angle of the elbow that are inside the limits, (K, 7)."""
        shoulder, upper, along = np.array([0.0, 0.0, 0.35]), 0.4, pose.rotation().as_matrix()[:, 2]
        line = pose.translation() - 0.2 * along - shoulder
        reach = np.linalg.norm(line)
        if not 1e-6 < reach < 2.0 * upper:
            return np.zeros((0, 7))
        line /= reach
        side = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
        side /= np.linalg.norm(side)
        angle, half = np.radians(np.arange(0.0, 360.0)), 0.5 * reach / upper
        around = np.outer(np.cos(angle), side) + np.outer(np.sin(angle), np.cross(line, side))
        first = half * line + np.sqrt(1.0 - half**2) * around  # along the upper arm
        second = 2.0 * half * line - first  # along the forearm, which is as long
        found = []
        for a, b, c in np.array(np.meshgrid(*3 * [[1.0, -1.0]])).reshape(3, -1).T:
            q = np.zeros((len(angle), 7))
            q[:, 6] = self.last
            turned = np.tile(np.eye(3), (len(angle), 1, 1))
            # A turn about z, then one about y: the direction of z decides both.
            for at, direction, sign in ((0, first, a), (2, second, b), (4, along, c)):
                x, y, z = np.moveaxis(np.einsum("kji,...j->ki" if direction.ndim == 1 else
                                                "kji,kj->ki", turned, direction), 1, 0)  # fmt: skip
                q[:, at] = np.arctan2(sign * y, sign * x)
                bend = sign * np.arccos(np.clip(z, -1.0, 1.0))
                q[:, at + 1] = -bend if at == 2 else bend  # the elbow's axis is -y
                turned = turned @ _about_z(q[:, at]) @ _about_y(bend)
            found.append(q)
        every = np.concatenate(found)
        kept = (every[:, :6] >= self.limits[:, 0]) & (every[:, :6] <= self.limits[:, 1])
        return every[kept.all(axis=1)]


def _about_z(angles: Array) -> Array:
    turn = np.tile(np.eye(3), (len(angles), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
    turn[:, 1, 0] = np.sin(angles)
    turn[:, 0, 1] = -turn[:, 1, 0]
    return turn


def _about_y(angles: Array) -> Array:
    turn = np.tile(np.eye(3), (len(angles), 1, 1))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(angles)
    turn[:, 0, 2] = np.sin(angles)
    turn[:, 2, 0] = -turn[:, 0, 2]
    return turn


class RailKinematics:
    """Configurations of the arm on its rail: those of the arm, with the pose moved against it."""

    def __init__(self, task: qt.PathTask) -> None:
        self.arm = InverseKinematics(qt.load_task("deburring"))
        lower, upper = task.model.jnt_range[0]
        self.places = np.linspace(lower, upper, 41)
        self.rolls = np.radians(np.arange(0.0, 360.0, 4.0))

    def layer(self, pose: mink.SE3) -> Array:
        found = []
        for place in self.places:
            moved = mink.SE3.from_translation(np.array([-place, 0.0, 0.0])) @ pose
            own = self.arm.inside_with_turns(self.arm.branches(moved, self.rolls))
            found.append(np.column_stack([np.full(len(own), place), own]))
        return np.concatenate(found)


def searched(layers: list[Array], start: Array | None, step: float) -> bool:
    """Whether a motion leads through the layers, none of its steps longer than ``step``, rad."""
    alive = layers[0] if start is None else start[None]
    for layer in layers[1:]:
        if not len(alive) or not len(layer):
            return False
        near, _ = cKDTree(alive).query(layer, p=np.inf, distance_upper_bound=step)
        alive = layer[np.isfinite(near)]
    return len(alive) > 0


def fault_of(task: qt.PathTask, q: Array, start: Array | None) -> str:
    """What is wrong with a plan, by MuJoCo at its waypoints; nothing if it is right."""
    data, worst = mujoco.MjData(task.model), 0.0
    for row, waypoint in zip(q, task.waypoints, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        site, target = data.site("tool"), waypoint.rotation().as_matrix()[:, 2]
        worst = max(worst, np.abs(site.xpos - waypoint.translation()).max())
        worst = max(worst, np.abs(site.xmat[2::3] - target).max())
    lower, upper = task.model.jnt_range.T
    faults = {
        "off the path": worst > 1e-8,
        "outside the limits": bool(((q < lower) | (q > upper)).any()),
        "too fast": np.abs(np.diff(q, axis=0)).max() > np.radians(LARGEST_STEP) + 1e-9,
        "elsewhere at first": start is not None and not np.array_equal(q[0], start),
    }
    return ", ".join(name for name, wrong in faults.items() if wrong)


PLACED = {"7R": placed_seven, "6R on a rail": placed_rail}


def placement_of(job: tuple[str, bool, int]) -> dict[str, Any]:
    """One path: whether it is planned, what is wrong with the plan, and what the search says."""
    arm, fixed, index = job
    task, rng = PLACED[arm](index), np.random.default_rng([9, index])
    last = rng.uniform(-2.0, 2.0)
    kinematics = SevenKinematics(task, last) if arm == "7R" else RailKinematics(task)
    layers, start = [kinematics.layer(pose) for pose in task.waypoints], None
    row: dict[str, Any] = {"arm": arm, "fixed": fixed, "index": index}
    if fixed:
        if not len(layers[0]):
            return {**row, "search": False, "plan": None, "fault": "", "certificate": "", "s": 0.0}
        start = layers[0][rng.integers(len(layers[0]))]
    found = searched(layers, start, np.radians(LARGEST_STEP))
    began = time.process_time()
    plan = qt.plan(task, start=start, max_step_deg=LARGEST_STEP)
    took = time.process_time() - began
    fault = "" if plan.q is None else fault_of(task, plan.q, start)
    return {
        **row, "search": found, "plan": plan.q is not None, "fault": fault,
        "certificate": str(plan.certificate), "s": round(took, 2),
    }  # fmt: skip


def plan_placements(samples: int, first: int, jobs: int) -> tuple[str, int]:
    """So many placements for each arm, from free and from fixed starts."""
    rows = []
    todo = [
        (arm, fixed, index)
        for index in range(first, first + samples) for arm in PLACED for fixed in (False, True)
    ]  # fmt: skip
    for row in in_processes(placement_of, todo, jobs):
        print(json.dumps(row), file=sys.stderr, flush=True)
        rows.append(row)
    return placements_table(rows)


def placements_table(rows: list[dict[str, Any]]) -> tuple[str, int]:
    """The table, and how many plans are missing or wrong."""
    table, wrong = [], 0
    for arm in PLACED:
        for fixed in (False, True):
            own = [r for r in rows if (r["arm"], r["fixed"]) == (arm, fixed)]
            own = [r for r in own if r["plan"] is not None]
            possible = [r for r in own if r["search"]]
            missing, faulty = (
                sum(not r["plan"] for r in possible), sum(bool(r["fault"]) for r in own)
            )  # fmt: skip
            wrong += missing + faulty
            planned = sum(r["plan"] for r in own)
            seconds = np.median([r["s"] for r in own]) if own else np.nan
            name = f"{arm}, {'random start' if fixed else 'any start'}"
            numbers = len(own), len(possible), len(possible) - missing, planned, faulty
            table.append((name, *map(str, numbers), f"{seconds:.1f}"))
    headings = ("arm", "paths", "search finds a motion", "of these planned", "planned in all",
                "wrong plans", "median, s")  # fmt: skip
    return markdown_table(headings, table), wrong


# ---------------------------------------------------------------- what layers miss

SPACING = np.radians(8.0)
"""Of the nodes of layers."""
DENSE = 5000
"""Number of random seeds of the layers that the others are compared with."""


def at_random_poses(task: qt.PathTask, whole: bool, samples: int) -> qt.PathTask:
    """The task with poses of random configurations inside the limits as waypoints."""
    ranges, configuration = qt.JointRanges.of(task.model), mink.Configuration(task.model)
    poses = []
    for q in ranges.random(samples, np.random.default_rng(5)):
        configuration.update(q)
        poses.append(configuration.get_transform_frame_to_world("tool", "site"))
    full = qt.Projector.full()
    projector = qt.TwistProjector(linear=full, angular=full) if whole else task.projector
    return dataclasses.replace(
        task, waypoints=tuple(poses), projector=projector, constraints=(), flipped_waypoints=None
    )


def plan_layers(samples: int) -> str:
    """Pieces that layers miss, and what these take."""
    rows = []
    for name, task, whole in (
        ("7R, all six directions prescribed", seven(2), True),
        ("7R, roll free", seven(2), False),
        ("6R on a rail, roll free", on_a_rail(400), False),
    ):
        path = at_random_poses(task, whole, samples)
        closed, seeded = PathRows(path), PathRows(path)
        seeded.closed_forms = []
        nets = {
            "dense": ManifoldNet(path, seeded, SPACING, seeds=DENSE),
            "random": ManifoldNet(path, seeded, SPACING),
            "closed": ManifoldNet(path, closed, SPACING),
        }
        nets["closed"].layer(0)
        pieces, missing, seconds = 0, Counter[str](), Counter[str]()
        for index in range(samples):
            layers = {}
            for kind, net in nets.items():
                began = time.process_time()
                layers[kind] = net.layer(index).q
                seconds[kind] += time.process_time() - began
            every = np.concatenate(list(layers.values()))
            piece = nets["closed"].pieces(every)
            ends = np.cumsum([len(q) for q in layers.values()])[:-1]
            own = dict(zip(layers, np.split(piece, ends), strict=True))
            pieces += len(np.unique(piece))
            for kind in layers:
                missing[kind] += len(np.unique(piece)) - len(np.unique(own[kind]))
        numbers = (f"{missing[k]}" for k in ("dense", "random", "closed"))
        times = (f"{1e3 * seconds[k] / samples:.0f}" for k in ("random", "closed"))
        rows.append((name, str(pieces), *numbers, *times))
        print(*rows[-1], file=sys.stderr, flush=True)
    headings = ("arm and task", "pieces", f"missed by {DENSE:,} random seeds",
                f"by {SEEDS} random seeds", "in closed form", f"{SEEDS} seeds, ms",
                "closed form, ms")  # fmt: skip
    return markdown_table(headings, rows)


OPTIONS = {
    "samples": 40, "first": 0, "jobs": 2, "roll_step": 2.0, "folder": "out/random", "starts": 10,
    "tasks": "deburring,dome_seams,part_in_hand,turn_tilt",
}  # fmt: skip

if __name__ == "__main__":
    parts = {
        f.__name__: f
        for f in (
            plan_costs,
            plan_optimality,
            no_plan,
            plan_placements,
            plan_layers,
            table_run,
            plan_times,
        )
    }
    sys.exit(command(__doc__, parts, **OPTIONS))

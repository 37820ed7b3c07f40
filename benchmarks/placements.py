"""Which methods finish the deburring run wherever the part stands?

    python benchmarks/placements.py [placements] [--placements 1000] [--methods a,b] [--starts 3]
        [--jobs 2] [--seed 0] [--keep DIR] [--write]
    python benchmarks/placements.py [placements_gains] [placements_gains_mink] [--write]
    python benchmarks/placements.py best_placement [--placements 1000]
        [--objectives centering,travel] [--jobs 2] [--keep DIR] [--write]
    python benchmarks/placements.py part_tolerance [--placements 1000] [--tasks deburring,…]
        [--methods qp_planned,…] [--jobs 2] [--keep DIR] [--write]

Places the part at random, starts where the joints are nearest to the middle of their ranges, and
follows the run with every method. A run is over at its first fault: a joint outside its range, an
error above 0.1 mm or 0.05°, a joint step above 15°. A placement is feasible if some sequence of
joint positions has none of these faults; where no method finds one, a search over the roll, all
branches of the inverse kinematics and all full turns decides. Needs py-opw-kinematics.

*placements_gains*: every method that has a secondary runs at each of some gains; the table has each
at its default and at the best of them, held against ``qp_gradient`` placement by placement.

*best_placement*: what ``qt.best_placement`` finds within a minute in a box around the part, beside
the best whole plan of so many random placements in it.

*part_tolerance*: the boxes of ``qt.part_tolerance``, and how many of so many random placements in
each fail: none may in the proven one.

With ``--keep DIR`` each result is kept in a file of its own, and is not computed again.
"""

from page import command, each, markdown_table

# isort: split
import collections
import dataclasses
import functools
import statistics
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import mink
import numpy as np
import py_opw_kinematics as opw
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.following.mink_step import posture
from qp_twist.paths.orientation import roll_by_plane
from qp_twist.studies.part_tolerance import Judge as PartJudge
from qp_twist.studies.part_tolerance import half_widths
from qp_twist.studies.placing import placing
from qp_twist.studies.summary import Rate


class Options(NamedTuple):
    """Of a study: how many placements, starts of each, its seed, processes, folder of results."""

    placements: int
    starts: int
    seed: int
    jobs: int
    keep: str


# ---------------------------------------------------------------- what counts as success

MAX_POSITION_ERROR = 1e-4  # m
MAX_AXIS_ERROR = np.radians(0.05)
MAX_STEP = np.radians(15.0)  # of a joint, from one waypoint to the next
OUTSIDE = 1e-9  # rad: a joint is outside its range from here on

# Waypoints count as reached at a fifth of the errors allowed. Nothing adds up: the loop is closed.
REACHED = {"position_tolerance": 2e-5, "angle_tolerance_deg": 1e-2}

# ---------------------------------------------------------------- where the part stands

CENTER_FROM, CENTER_TO = (-0.5, 0.6, 0.0), (0.5, 1.3, 0.8)  # of the sphere, m
MAX_TILT = np.radians(45.0)

# ---------------------------------------------------------------- where the robot starts

STARTS = 3  # the least z of each branch of the inverse kinematics, in this many branches
NO_START = {"fault": "start", "waypoint": 1, "seconds": 0.0}


def placement(seed: int, index: int) -> tuple[Array, Array]:
    """Centre of the sphere (3,), m, and rotation of the cap (3, 3): a yaw, then a tilt."""
    rng = np.random.default_rng([seed, index])
    center = rng.uniform(CENTER_FROM, CENTER_TO)
    yaw, azimuth = rng.uniform(-np.pi, np.pi, size=2)
    tilt = rng.uniform(0.0, MAX_TILT)
    horizontal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return center, (mink.SO3.exp(tilt * horizontal) @ mink.SO3.from_z_radians(yaw)).as_matrix()


def placed(task: qt.PathTask, center: Array, rotation: Array) -> qt.PathTask:
    """The task with its part moved, and the largest joint step as its speed limit."""
    assert task.source is not None
    file = tomllib.loads(task.source.read_text("utf-8"))
    positions = center + (task.positions - file["path"]["center"]) @ rotation.T
    axes = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints]) @ rotation.T
    normal = np.array(file["roll"]["plane_normal"])  # the roll rule speaks of the robot's base

    def waypoints(rotations: Array) -> tuple[mink.SE3, ...]:
        return tuple(
            mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(r), p)
            for r, p in zip(np.ascontiguousarray(rotations), positions, strict=True)
        )

    return dataclasses.replace(
        task,
        waypoints=waypoints(roll_by_plane(axes, normal)),
        flipped_waypoints=waypoints(roll_by_plane(axes, normal, flip=True)),
        # A waypoint a second: speeds are steps. The hair keeps rounding out of the judgement.
        durations=np.concatenate([[0.0], np.ones(len(positions) - 1)]),
        velocity_limits=np.full(task.model.nv, MAX_STEP - 1e-6),
        iteration=task.iteration.model_copy(update=REACHED),
    )


# ---------------------------------------------------------------- all joint positions of a pose


class InverseKinematics:
    """Every joint position of the M-16iB that holds the tool in a pose."""

    def __init__(self, task: qt.PathTask) -> None:
        self.ranges = qt.JointRanges.of(task.model)
        # Lengths of the scene; tests/robots/test_scenes.py compares the two chains.
        lengths = opw.KinematicModel(
            a1=0.15, a2=-0.10, b=0.0, c1=0.525, c2=0.77, c3=0.74, c4=0.10,
            offsets=(0.0, 0.0, -np.pi / 2, 0.0, 0.0, np.pi),
            flip_axes=(False, False, True, True, True, True),
        )  # fmt: skip
        self.robot = opw.Robot(lengths, degrees=False)
        at_zero = mink.Configuration(task.model, np.zeros(task.model.nq))
        tool = at_zero.get_transform_frame_to_world(task.frame_name, task.frame_type)
        flange = at_zero.get_transform_frame_to_world("flange", "site")
        self.flange_in_tool = (tool.inverse() @ flange).as_matrix()

    def branches(self, pose: mink.SE3, rolls: Array) -> Array:
        """Joint positions (len(rolls), 8, 6), NaN where a branch does not reach."""
        turn = np.zeros((len(rolls), 4, 4))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(rolls)
        turn[:, 1, 0] = np.sin(rolls)
        turn[:, 0, 1] = -turn[:, 1, 0]
        turn[:, 2, 2] = turn[:, 3, 3] = 1.0
        poses = pose.as_matrix() @ turn @ self.flange_in_tool
        joints: Array = self.robot.reach(opw.RigidTransform.from_matrix(poses)).joints
        return joints

    def centred(self, q: Array) -> Array:
        """Full turns taken off so that every joint is nearest to the middle of its range."""
        turns: Array = np.round((q - self.ranges.middle) / (2.0 * np.pi))
        return q - 2.0 * np.pi * turns

    def inside_with_turns(self, q: Array) -> Array:
        """All in-limit joint positions (k, 6) that differ from a row of q (…, 6) by full turns."""
        q = self.centred(q[np.isfinite(q).all(axis=-1)])
        lower, upper = self.ranges.lower, self.ranges.upper
        for joint in np.argsort(upper - lower):  # those without a second turn first: fewer rows
            if upper[joint] - lower[joint] > 2.0 * np.pi:
                turn = 2.0 * np.pi * np.eye(6)[joint]
                q = np.concatenate([q - turn, q, q + turn])
            q = q[(q[:, joint] >= lower[joint]) & (q[:, joint] <= upper[joint])]
        return q

    def layer(self, pose: mink.SE3, rolls: Array, finer: int = 16) -> Array:
        """All in-limit joint positions (k, 6) on a grid of rolls, finer where the joints run."""
        grid = self.branches(pose, rolls)
        change = np.diff(grid, axis=0, append=grid[:1])
        change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
        fast = (np.abs(change) > MAX_STEP / 3.0).any(axis=(1, 2))  # near a straight wrist
        between = (rolls[1] - rolls[0]) * np.arange(1, finer) / finer
        more = self.branches(pose, (rolls[fast, None] + between).ravel())
        return self.inside_with_turns(np.concatenate([grid, more]))

    def starts(self, pose: mink.SE3, *, roll_is_free: bool = True) -> list[Array]:
        """In-limit joint positions (6,): of each branch the one of least z, the least first."""
        rolls = np.radians(np.arange(0.0, 360.0, 0.5)) if roll_is_free else np.zeros(1)
        q, z = self._centred_branches(pose, rolls)
        found = []
        for branch in range(8):
            row = int(np.argmin(z[:, branch]))
            best_z, best_q = float(z[row, branch]), q[row, branch]
            if not np.isfinite(best_z):
                continue
            if roll_is_free:
                at, step = rolls[row], rolls[1] - rolls[0]
                refined = minimize_scalar(
                    lambda roll, branch=branch: self._z_of(pose, roll, branch),
                    bounds=(at - step, at + step),
                    method="bounded",
                )
                if refined.fun < best_z:
                    q_there, _ = self._centred_branches(pose, np.array([refined.x]))
                    best_z, best_q = float(refined.fun), q_there[0, branch]
            found.append((best_z, best_q))
        return [best_q for _, best_q in sorted(found, key=lambda pair: pair[0])]

    def _centred_branches(self, pose: mink.SE3, rolls: Array) -> tuple[Array, Array]:
        """The branches at their most central turn, and their z; infinite outside the limits."""
        q = self.centred(self.branches(pose, rolls))
        with np.errstate(invalid="ignore"):
            inside = ((q >= self.ranges.lower) & (q <= self.ranges.upper)).all(axis=-1)
        z = np.full(q.shape[:2], np.inf)
        z[inside] = self.ranges.centering(q[inside])
        return q, z

    def _z_of(self, pose: mink.SE3, roll: float, branch: int) -> float:
        _, z = self._centred_branches(pose, np.array([roll]))
        return min(float(z[0, branch]), 1e3)  # the minimiser wants a number outside, too


def dead_end(
    task: qt.PathTask, arm: InverseKinematics, start: Array | None = None, *, roll_step: float = 2.0
) -> int | None:
    """Waypoint (from 1) that no joint motion without a fault gets to; ``None`` if all are reached.

    Layer by layer: all in-limit joint positions at the waypoint, at rolls ``roll_step`` degrees
    apart, that are within 15° of one reached at the waypoint before.
    """
    rolls = np.radians(np.arange(0.0, 360.0, roll_step))
    reached = None if start is None else start[None]
    for index, pose in enumerate(task.waypoints):
        if index == 0 and reached is not None:
            continue
        layer = arm.layer(pose, rolls)
        if reached is not None and len(layer):
            near = (layer >= reached.min(axis=0) - MAX_STEP) & (
                layer <= reached.max(axis=0) + MAX_STEP
            )
            layer = layer[near.all(axis=1)]
            step, _ = cKDTree(reached).query(layer, p=np.inf, distance_upper_bound=MAX_STEP)
            layer = layer[np.isfinite(step)]
        if not len(layer):
            return index + 1
        reached = layer
    return None


# ---------------------------------------------------------------- judging


class Judge:
    """Watches a run waypoint by waypoint and says what is wrong with it."""

    def __init__(self, task: qt.PathTask, start: Array) -> None:
        self.ranges = qt.JointRanges.of(task.model)
        self.before = start
        self.waypoints = 1
        self.fault: str | None = None

    def __call__(self, q: Array, position_error: float, axis_error: float) -> bool:
        """Whether the run is over: called at each waypoint after the first."""
        self.waypoints += 1
        self.fault = self._fault(q, position_error, axis_error)
        self.before = q.copy()
        return self.fault is not None

    def _fault(self, q: Array, position_error: float, axis_error: float) -> str | None:
        if not np.isfinite([*q, position_error, axis_error]).all():
            return "diverged"
        names = self.ranges.names
        room = np.minimum(q - self.ranges.lower, self.ranges.upper - q)
        step = np.abs(q - self.before)
        if (room < -OUTSIDE).any():
            return f"limit {names[int(np.argmin(room))]}"
        if (step > MAX_STEP).any():
            return f"jump {names[int(np.argmax(step))]}"
        if position_error > MAX_POSITION_ERROR or axis_error > MAX_AXIS_ERROR:
            held = [n for n, r, s in zip(names, room, step, strict=True)
                    if r < 1e-4 or s > MAX_STEP - 1e-4]  # fmt: skip
            return f"held {'+'.join(held)}" if held else "error"
        return None


# ---------------------------------------------------------------- methods

Follower = Callable[[qt.PathTask, Judge], None]
ITERATIONS = 20


def library(method: str, **options: Any) -> Follower:
    """A method of the library."""

    def run(task: qt.PathTask, judge: Judge) -> None:
        trajectory = qt.follow(task, method, stop=judge, **options)
        if trajectory.diverged_at is not None:
            judge.fault = "diverged"
        elif trajectory.failure:
            judge.fault = "no step"

    return run


def mink_equality(gain: float) -> Follower:
    """``mink.solve_ik`` with the task in ``constraints=``, as the five rows of a twist task.

    mink's own frame task would constrain the roll, too. Limits and posture are those of the method
    ``mink``.
    """

    def run(task: qt.PathTask, judge: Judge) -> None:
        settings = task.settings("mink").model_copy(update={"gain": gain, "posture_cost": 1.0})
        target, costs = posture(task, settings, qt.METHODS["mink"])
        pull = mink.PostureTask(task.model, costs)
        pull.set_target(target)
        rows = qt.TwistTask(task.frame_name, task.frame_type, task.projector)
        limits: list[mink.Limit] = [mink.ConfigurationLimit(task.model)]
        if task.durations is not None:
            speeds = dict(
                zip(qt.JointRanges.of(task.model).names, task.velocity_limits, strict=True)
            )
            limits.append(mink.VelocityLimit(task.model, speeds))
        configuration = mink.Configuration(task.model, task.start)
        for waypoint in task.waypoints[1:]:
            rows.set_target(waypoint)
            for iteration in range(ITERATIONS):
                # Repeated, the pull of the posture would break the task.
                pull.gain = gain if iteration == 0 else 0.0
                velocity = mink.solve_ik(
                    configuration, [pull], 1.0, "daqp", limits=limits, constraints=[rows]
                )
                configuration.integrate_inplace(velocity, 1.0)
                error = rows.state(configuration).error
                position_error, axis_error = map(float, np.linalg.norm(error.reshape(2, 3), axis=1))
                if (
                    position_error <= task.iteration.position_tolerance
                    and axis_error <= task.iteration.angle_tolerance
                ):
                    break
            if judge(configuration.q, position_error, axis_error):
                return

    return run


# The settings of the task file, but with iterations for everyone: none shall fail by the curvature
# of the path alone. The paper's twa takes one iteration at gain 1. The tuned ones have the best of
# a few gains that were tried; --gains tries the same for every method.
FOLLOWERS: dict[str, Follower] = {
    **{name: library(name, iterations=ITERATIONS) for name, m in qt.METHODS.items() if not m.peer},
    "twa": library("twa"),
    "twa_tuned": library("twa", iterations=ITERATIONS, gain=0.1),
    "mink_soft": library("mink", iterations=ITERATIONS),
    "mink_tuned": library("mink", iterations=ITERATIONS, gain=0.1),
    "mink_equality": mink_equality(gain=0.05),
}
TUNED: dict[str, tuple[float, Callable[[float], Follower]]] = {
    **{
        name: (
            qt.METHODS[method].defaults.gain,
            lambda gain, method=method: library(method, iterations=ITERATIONS, gain=gain),
        )
        for name, method in (
            ("gradient_projection", "gradient_projection"),
            ("qp_gradient", "qp_gradient"),
            ("twa", "twa"),
            ("qp", "qp"),
            ("mink_soft", "mink"),
        )
    },
    "mink_equality": (0.05, mink_equality),
}
"""Gain by default, and the method at a gain: what has a secondary. ``NAME@GAIN`` runs it."""
GAINS = (0.01, 0.05, 0.1, 0.3, 1.0)
REFERENCE = "qp_gradient"
"""What the others are held against."""


def follower(name: str) -> Follower:
    """A method by name, or at a gain.

    Raises:
        KeyError: If there is none.
    """
    method, at, gain = name.partition("@")
    return TUNED[method][1](float(gain)) if at else FOLLOWERS[name]


# ---------------------------------------------------------------- one placement


def fixes_roll(name: str) -> bool:
    """Whether a method cannot leave the roll free, so that its start has the rule's roll."""
    return name in qt.METHODS and qt.METHODS[name].whole_twist


def flipped(name: str) -> bool:
    """Whether a method takes the roll rule's other sign."""
    return name in qt.METHODS and qt.METHODS[name].flipped


def starts_of(name: str, task: qt.PathTask, arm: InverseKinematics) -> list[Array]:
    """Where a method may start, the least z first."""
    poses = task.flipped_waypoints if flipped(name) else task.waypoints
    assert poses is not None
    return arm.starts(poses[0], roll_is_free=not fixes_roll(name))[:STARTS]


def run_once(task: qt.PathTask, name: str, start: Array) -> dict[str, Any]:
    """One method from one start: its fault and where, or none; processor time, s."""
    judge = Judge(task, start)
    began = time.process_time()
    try:
        follower(name)(dataclasses.replace(task, start=start), judge)
    except (qt.QpTwistError, mink.MinkError) as error:
        judge.fault, judge.waypoints = type(error).__name__, judge.waypoints + 1
    seconds = round(time.process_time() - began, 4)
    return {"fault": judge.fault, "waypoint": judge.waypoints, "seconds": seconds}


@functools.cache
def study() -> tuple[qt.PathTask, InverseKinematics]:
    """The task as shipped and the arm: once a process."""
    task = qt.load_task("deburring")
    return task, InverseKinematics(task)


def run_placement(
    index: int, seed: int, names: Sequence[str], count: int = STARTS
) -> dict[str, Any]:
    """One placement: whether it is feasible, and runs by method.

    A run from the start of least z; where it has a fault though the placement is feasible, others
    from the next of ``count`` starts, until one has none.
    """
    shipped, arm = study()
    task = placed(shipped, *placement(seed, index))
    runs: dict[str, list[dict[str, Any]]] = {}
    result: dict[str, Any] = {"index": index, "runs": runs}
    looked: dict[tuple[bool, bool], list[Array]] = {}

    def starts(name: str) -> list[Array]:
        """The same for all methods that leave the roll free: looked for once."""
        kind = fixes_roll(name), flipped(name)
        if kind not in looked:
            looked[kind] = starts_of(name, task, arm)
        return looked[kind]

    for name in names:
        runs[name] = [run_once(task, name, start) for start in starts(name)[:1]] or [NO_START]
    # A run without a fault proves it feasible; the search is for the others.
    solved = {name for name in names if runs[name][0]["fault"] is None}
    free = starts(REFERENCE)[:1]
    result["feasible_from_start"] = any(not fixes_roll(name) for name in solved) or any(
        dead_end(task, arm, start) is None for start in free
    )
    result["feasible"] = (
        bool(solved)
        or result["feasible_from_start"]
        or (bool(free) and dead_end(task, arm) is None)
    )
    for name in names if result["feasible"] and count > 1 else ():
        for start in starts(name)[len(runs[name]) : count]:
            if runs[name][-1]["fault"] is None:
                break
            runs[name].append(run_once(task, name, start))
    return result


# ---------------------------------------------------------------- all of them


def results_of(names: Sequence[str], options: Options) -> list[dict[str, Any]]:
    """Results of the placements."""
    indices = range(options.placements)
    return list(
        each(
            run_placement, indices, options.jobs, options.keep, seed=options.seed,
            names=tuple(names), count=options.starts,
        )
    )  # fmt: skip


def placements(placements: int, starts: int, seed: int, methods: str, jobs: int, keep: str) -> str:
    """What every method finishes, under a line on what was feasible."""
    names = methods.split(",") if methods else list(FOLLOWERS)
    results = results_of(names, Options(placements, starts, seed, jobs, keep))
    feasible = [r for r in results if r["feasible"]]
    from_start = [r for r in feasible if r["feasible_from_start"]]
    rows = []
    for name in names:
        first = [r["runs"][name][0] for r in feasible]
        solved = [run for run in first if run["fault"] is None]
        rows.append((
            f"`{name}`",
            share_within(r["runs"][name][0] for r in from_start),
            share_within(first),
            share_within(r["runs"][name][-1] for r in feasible),
            faults(run["fault"] for run in first),
            f"{statistics.median(run['seconds'] for run in solved):.2f}" if solved else "–",
        ))  # fmt: skip
    headings = (
        "method", "of feasible from the start %", "of feasible %",
        f"of feasible, {starts} starts %", "what failed", "s a run",
    )  # fmt: skip
    return (
        f"{len(results)} placements. A motion without a fault exists for {len(feasible)} of them; "
        f"from the start of least z for {len(from_start)}.\n\n{markdown_table(headings, rows)}"
    )


def placements_gains(placements: int, seed: int, jobs: int, keep: str) -> str:
    """Each method at its default and at its best of some gains, held against the reference."""
    names = "minimum_norm,qp_minimum_norm,gradient_projection,qp_gradient,qp,twa"
    return at_gains(names.split(","), Options(min(placements, 177), 1, seed, jobs, keep))


def placements_gains_mink(placements: int, seed: int, jobs: int, keep: str) -> str:
    """The same for mink's soft step."""
    return at_gains([REFERENCE, "mink_soft"], Options(min(placements, 120), 1, seed, jobs, keep))


def at_gains(methods: Sequence[str], options: Options) -> str:
    """Runs finished by methods at their default and at each of the gains."""
    tried = sorted({TUNED[name][0] for name in methods if name in TUNED} | {*GAINS})
    at = {
        method: {gain: f"{method}@{gain:g}" for gain in tried} if method in TUNED else {0.0: method}
        for method in methods
    }
    names = [name for gains in at.values() for name in gains.values()]
    results = results_of(names, options)
    counted = [r for r in results if r["feasible_from_start"]]
    done = {n: np.array([r["runs"][n][0]["fault"] is None for r in counted]) for n in names}
    default = {m: at[m][TUNED[m][0] if m in TUNED else 0.0] for m in at}
    best = {  # where several are, the default
        m: max(at[m].values(), key=lambda name, m=m: (done[name].sum(), name == default[m]))
        for m in at
    }
    rows = []
    for method in at:
        cells = [f"`{method}`"]
        for chosen in (default, best):
            mine, reference = done[chosen[method]], done[chosen[REFERENCE]]
            cells += [
                chosen[method].partition("@")[2] or "–",
                str(Rate(int(mine.sum()), len(mine))),
                "–" if method == REFERENCE else pairs(mine, reference),
            ]
        rows.append(cells)
    headings = ("method", *("default gain", "finishes %", "won : lost"),
                *("best gain", "finishes %", "won : lost"))  # fmt: skip
    by_gain = [
        (f"`{method}`", *(int(done[name].sum()) for name in gains.values()))
        for method, gains in at.items()
        if method in TUNED
    ]
    gains = [f"{gain:g}" for gain in tried]
    return (
        f"{len(results)} placements, of which {len(counted)} are feasible from the start of least "
        f"z. Gains tried: {', '.join(gains)}.\n\n{markdown_table(headings, rows)}\n"
        "Runs finished of the same placements, by gain:\n\n"
        f"{markdown_table(('method', *gains), by_gain)}"
    )


BOX = np.array([0.3, 0.15, 0.15])  # m, to either side of where the part is


def best_placement(placements: int, seed: int, objectives: str, jobs: int, keep: str) -> str:
    """The best of a search within a minute beside the best of random placements."""
    task, rows = qt.load_task("deburring"), []
    shifts = np.random.default_rng(seed).uniform(-BOX, BOX, (placements, 3)).tolist()
    for objective in objectives.split(","):
        sign = -1.0 if objective == "margin" else 1.0
        began = time.process_time()
        found = qt.best_placement(task, -BOX, BOX, objective, seconds=60.0)
        spent = time.process_time() - began
        assert found.plan is not None and found.here is not None
        options = {"objective": objective, "shifts": shifts, "about": found.about.tolist()}
        values, seconds = np.transpose([*each(plan_at, range(placements), jobs, keep, **options)])
        best = sign * np.nanmin(sign * values), sign * np.nanmedian(sign * values)
        row = (found.here.value, best[1], best[0], found.plan.value)
        cells = [f"{value:.4g}" for value in row] + [f"{t:.0f}" for t in (seconds.sum(), spent)]
        rows.append((objective, *cells))
    head = (
        "objective", "here", f"median of {placements} at random", "best of them", "the search",
        "processor s of them", "of the search",
    )  # fmt: skip
    return markdown_table(head, rows)


def plan_at(
    index: int, objective: str, shifts: list[list[float]], about: list[float]
) -> tuple[float, float]:
    """Value of the best whole plan at a shift of the part, NaN if there is none; seconds."""
    shifted = at_shift(qt.load_task("deburring"), np.array(about), np.array(shifts[index]))
    began = time.process_time()
    return float(qt.plan(shifted, objective).value), time.process_time() - began


def at_shift(task: qt.PathTask, about: Array, shift: Array) -> qt.PathTask:
    """The task with its path and its part's body shifted."""
    return qt.paths.placed(task, mink.SO3.identity(), about, about + shift, "part")


def part_tolerance(
    placements: int, seed: int, tasks: str, methods: str, jobs: int, keep: str
) -> str:
    """Failures at random placements in the boxes that are proven, and that were sampled."""
    asked = (methods or "qp_planned,qp_gradient").split(",")
    cases, rows = [f"{t}-{m}" for t in tasks.split(",") for m in asked], []
    for case, found in zip(cases, each(boxes_of, cases, jobs, keep), strict=True):
        boxes, failed = (found["proven"], found["sampled"]), []
        for number, box in enumerate(boxes):
            chunks = range(-(-placements // CHUNK))
            options = {"case": case, "box": box, "count": placements, "seed": [seed + 1, number]}
            failed.append(sum(each(failures_in, chunks, jobs, keep, **options)))
        rows.append((
            *case.split("-"), *(half_widths(np.array(box)) for box in boxes), *map(str, failed),
            f"{found['seconds']:.0f}",
        ))  # fmt: skip
    head = (
        "task", "method", "proven", "sampled", f"failed of {placements} in the proven box",
        "in the sampled one", "processor s",
    )  # fmt: skip
    return markdown_table(head, rows)


CHUNK = 250
"""Random placements of a box that a process judges at a time."""


@functools.cache
def followed(case: str) -> qt.Trajectory:
    """The motion of ``TASK-METHOD``: once a process."""
    task, method = case.split("-")
    return qt.follow(qt.load_task(task), method)


def boxes_of(case: str) -> dict[str, Any]:
    """How far the part may be off by ``qt.part_tolerance``, and its processor time, s."""
    run, began = followed(case), time.process_time()
    found = qt.part_tolerance(run)
    spent = time.process_time() - began
    return {
        "proven": found.proven.tolist(), "sampled": found.sampled.tolist(), "seconds": spent
    }  # fmt: skip


def failures_in(chunk: int, case: str, box: list[float], count: int, seed: list[int]) -> int:
    """How many of a chunk of random placements in a box fail."""
    judge = PartJudge(followed(case), placing(followed(case).path_task))
    size = min(CHUNK, count - chunk * CHUNK)
    drawn = np.random.default_rng([*seed, chunk]).uniform(-1.0, 1.0, (size, 6))
    return sum(bool(judge(x)) for x in drawn * box)


def pairs(mine: Array, reference: Array) -> str:
    """Placements that one finishes and the other does not; bold where that is no coincidence.

    McNemar's test, exact: of the placements on which they differ each is as likely to win, were
    there no difference. Bold is p < 0.05, two-sided.
    """
    from scipy.stats import binomtest  # imported on demand: half a second

    won, lost = int((mine & ~reference).sum()), int((reference & ~mine).sum())
    p = binomtest(won, won + lost).pvalue if won + lost else 1.0
    return f"**{won} : {lost}**" if p < 0.05 else f"{won} : {lost}"


def share_within(runs: Iterable[dict[str, Any]]) -> str:
    """Runs without a fault, in per cent, with the interval."""
    done = [run["fault"] is None for run in runs]
    return str(Rate(sum(done), len(done)))


def faults(found: Iterable[str | None]) -> str:
    """Faults by kind, the most frequent first, with their counts and the joints."""
    kinds: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for fault in found:
        if fault is not None:
            kind, _, where = fault.partition(" ")
            kinds[kind][where] += 1
    parts = []
    for kind, where in sorted(kinds.items(), key=lambda item: -item[1].total()):
        joints = ", ".join(f"{name} {count}" for name, count in where.most_common(3) if name)
        parts.append(f"{kind} {where.total()}" + (f" ({joints})" if joints else ""))
    return "; ".join(parts) or "–"


if __name__ == "__main__":
    made = placements, placements_gains, placements_gains_mink, best_placement, part_tolerance
    parts = {part.__name__: part for part in made}
    options = {
        "placements": 1000, "starts": STARTS, "seed": 0, "methods": "", "jobs": 2, "keep": "",
        "objectives": "centering,travel,margin", "tasks": "deburring,dome_seams",
    }  # fmt: skip
    sys.exit(command(__doc__, parts, **options))

"""How long a timed path takes, beside toppra, ruckig and lower bounds, and how smooth it is.

    python benchmarks/timing.py [timing] [--paths 20] [--repeats 3] [--write]
    python benchmarks/timing.py [timing_moves] [--moves 100] [--write]
    python benchmarks/timing.py [timing_jumps] [--write]
    python benchmarks/timing.py [timing_roll] [--write]
    python benchmarks/timing.py [timing_seam] [--write]
    python benchmarks/timing.py [timing_constant] [--tasks NAME,FILE.toml,…] [--write]

*timing*: shipped tasks at 20 times their feed, and random paths of six joints, each as one curve
through its rows. toppra (limits of speed and acceleration, the same curve, as many grid points as
the package has cells) is the peer; its parametrisation of constant acceleration from point to point
is looked at 20 times in each. The *bound* takes at each place the largest pace that the limits of
speed and acceleration permit there alone, however it be reached: no motion is faster.

*timing_moves*: straight joint moves from rest to rest, beside ruckig's, synchronised in phase.

*timing_jumps*: of twenty motions the largest change of a joint's acceleration from one millisecond
to the next, over jerk limit × 1 ms, of the positions in the file by scipy.

*timing_roll*: the free roll of shipped tasks as ``follow`` leaves it, and as a constant feed moves
it together with the speed, on the same rows: its third derivative with respect to the time at the
feed, by MuJoCo, nine tenths of it and the largest, which is at corners; and the time.

*timing_seam*: a weld seam, where a pipe meets a wider one, at 200 mm/s, by a tool of free roll: the
part of the path at that speed, within the default limits of jerk, too, without and with a constant
feed; and the dips of the latter. *timing_constant*: likewise of tasks, at their own feed.
*timing_kinks*: at waypoints the rate changes at which a path turns its tool's axis: the angular
acceleration that this needs at the feed within the tolerances, beside that of all hinges together,
as if their axes were parallel. Where it needs more, every motion is slower (products of joint
speeds aside).

Needs toppra and ruckig (``pip install toppra ruckig``).
"""

from __future__ import annotations

from page import command, markdown_table

# isort: split
import itertools
import pathlib
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import mink
import mujoco
import numpy as np
from scipy.interpolate import BPoly, CubicSpline
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent / "tests"))

from oracles.mounted_robots import Mounted, mounted

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.referee import (
    JointMotion,
    MotionLimits,
    motion_limits,
    with_default_accelerations,
    with_default_jerks,
)
from qp_twist.trajectories import (
    JointCurve,
    refine_trajectory,
    speed_profile,
    steady_trajectory,
    time_trajectory,
)
from qp_twist.trajectories.steady_speed import _dense
from qp_twist.trajectories.task_run import run_task

TASKS = ("deburring", "deburring_bands", "dome_seams", "turn_tilt", "part_in_hand")
FASTER = 20.0
"""Times the feed: the joints' limits count everywhere."""
LOOKS = 20
TASKS_OF_ROLL = "deburring,dome_seams"
SEAMS = {
    "Fanuc M-20iA": (-20.0, 20.0, -10.0, -60.0, 40.0, 170.0),
    "Universal Robots UR10e": (-100.0, -120.0, 90.0, -50.0, 70.0, -150.0),
}
"""Robots, and where they begin, degrees."""
_APART = 0.02
"""Of samples of the roll, s at the task's feed: as far as its rows at a constant feed."""


class Path(NamedTuple):
    """A curve to be passed from rest to rest, and the limits of its joints."""

    name: str
    x: Array
    q: Array
    limits: MotionLimits

    def timed(self, *, jerk: bool) -> JointMotion:
        """The package's motion."""
        rests, free = np.zeros(len(self.x), dtype=bool), np.full(len(self.x) - 1, np.inf)
        rests[[0, -1]] = True
        rates = self.limits.velocity, self.limits.acceleration
        most = self.limits.jerk if jerk else None
        return speed_profile(self.q, np.diff(self.x), *rates, rests, free, most).motion

    @property
    def curve(self) -> JointCurve:
        return JointCurve.through(self.x, self.q)


def _at(curve: JointCurve, s: Array) -> Array:
    """q, q′, q″ and q‴ of a curve, (K, 4, nv)."""
    last = len(curve.x) - 2
    return curve.at(s, np.clip(np.searchsorted(curve.x, s, "right") - 1, 0, last))


def _by_toppra(path: Path, points: int) -> tuple[float, float]:
    """Its time, s, and the largest share of a limit that its motion uses anywhere."""
    import toppra  # of no extra

    toppra.setup_logging("ERROR")

    class _OfToppra(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        """The same curve for toppra."""

        waypoints = None

        def __init__(self, curve: JointCurve) -> None:
            self.curve = curve

        @property
        def dof(self) -> int:
            return self.curve.q.shape[1]

        @property
        def path_interval(self) -> Array:
            return self.curve.x[[0, -1]]

        def __call__(self, s: Array, order: int = 0) -> Array:
            values = _at(self.curve, np.atleast_1d(np.asarray(s, dtype=float)))[:, order]
            return values[0] if np.ndim(s) == 0 else values

    curve = _OfToppra(path.curve)
    ends = curve.curve.x  # so that cubics end at grid points
    parts = np.maximum(2, np.ceil(points * np.diff(ends) / (ends[-1] - ends[0]))).astype(int)
    shares = [
        a + (b - a) * np.arange(n) / n for a, b, n in zip(ends[:-1], ends[1:], parts, strict=True)
    ]
    grid = np.append(np.concatenate(shares), ends[-1])
    v, a = path.limits.velocity, path.limits.acceleration
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.stack([-v, v], axis=1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-a, a], axis=1)),
    ]
    found = toppra.algorithm.TOPPRA(constraints, curve, gridpoints=grid, solver_wrapper="seidel")
    found.compute_parameterization(0, 0)
    pace = np.asarray(found.problem_data.sd_vec)
    shares = np.linspace(0.0, 1.0, LOOKS)
    at = _at(curve.curve, (grid[:-1, None] + np.diff(grid)[:, None] * shares).ravel())
    y = ((1.0 - shares) * pace[:-1, None] ** 2 + shares * pace[1:, None] ** 2).ravel()[:, None]
    change = np.repeat(np.diff(pace**2) / np.diff(grid) / 2.0, LOOKS)[:, None]
    speed = np.abs(at[:, 1]) * np.sqrt(y) / v
    used = max(speed.max(), (np.abs(at[:, 1] * change + at[:, 2] * y) / a).max())
    return float((2.0 * np.diff(grid) / (pace[1:] + pace[:-1])).sum()), float(used)


def _bound(path: Path) -> float:
    """The time at the largest pace that each place permits alone, s."""
    s = np.linspace(path.x[0], path.x[-1], 200_001)
    _, first, second, _ = np.moveaxis(_at(path.curve, s), 1, 0)
    with np.errstate(divide="ignore"):
        pace = (path.limits.velocity / np.abs(first)).min(axis=1)
        # With |½q′y′ + q″y| ≤ a of two joints y′ can be eliminated: (|q″₁q′₂ − q″₂q′₁|) y ≤ …
        for i in range(first.shape[1]):
            a = path.limits.acceleration
            cross = np.abs(second[:, i, None] * first - second * first[:, i, None])
            reach = a[i] * np.abs(first) + a * np.abs(first[:, i, None])
            cross[:, i] = 0.0
            pace = np.minimum(pace, np.sqrt((reach / cross).min(axis=1)))
    return float(np.trapezoid(1.0 / pace, s))


def _of_tasks() -> list[Path]:
    found = []
    for name in TASKS:
        task = qt.load_task(name)
        rows = refine_trajectory(qt.follow(task, slow_down=True))
        limits = with_default_jerks(
            with_default_accelerations(motion_limits(task), JointRanges.of(task.model))
        )
        run = time_trajectory(rows, limits=limits).trajectory  # rows beside corners
        assert run is not None and run.feed is not None
        x = np.concatenate([[0.0], np.cumsum(run.feed / FASTER)])
        found.append(Path(f"`{name}`", x, run.q, limits))
    return found


def _random(seed: int) -> Path:
    """A cubic spline through random points, as 60 to 300 rows."""
    rng = np.random.default_rng(seed)
    points, rows = int(rng.integers(4, 12)), int(rng.integers(60, 300))
    spline = CubicSpline(np.linspace(0.0, 1.0, points), rng.normal(size=(points, 6)))
    v = rng.uniform(1.0, 6.0, size=6)
    limits = MotionLimits(v, v / 0.25, jerk=v / 0.25 / 0.05)
    x = np.linspace(0.0, 1.0, rows)
    return Path(f"random {seed}", x, spline(x), limits)


def timing(paths: int = 20, repeats: int = 3) -> str:
    """Times and processor times beside toppra's."""
    rows, ratios = [], []
    for path in [*_of_tasks(), *map(_random, range(paths))]:
        smooth, plain = path.timed(jerk=True), path.timed(jerk=False)
        points = max(101, int(np.ceil(plain.times[-1] / 0.008)) + 1)
        calls = (
            partial(path.timed, jerk=False), partial(path.timed, jerk=True),
            partial(_by_toppra, path, points),
        )  # fmt: skip
        took: list[list[float]] = [[], [], []]
        for _, (of, call) in itertools.product(range(repeats), zip(took, calls, strict=True)):
            begin = time.process_time()
            call()
            of.append(time.process_time() - begin)
        theirs, used = _by_toppra(path, points)
        T = float(plain.times[-1])
        least = [min(of) for of in took]
        ratios.append(
            (T / theirs, used, least[0] / least[2], least[1] / least[2], T / _bound(path),
             smooth.times[-1] / T)
        )  # fmt: skip
        rows.append((path.name, f"{T:.3f}", *map("{:.4f}".format, ratios[-1])))
    worst = np.array(ratios).max(axis=0)
    rows += [
        ("largest", "", *map("{:.4f}".format, worst)),
        ("median", "", *map("{:.4f}".format, np.median(ratios, axis=0))),
    ]
    return markdown_table(
        ["path", "s", "over toppra's", "limits used by toppra", "processor", "with jerk limits",
         "over the bound", "cost of jerk limits"],
        rows,
    )  # fmt: skip


def timing_moves(moves: int = 100) -> str:
    """Joint moves beside ruckig's."""
    import ruckig  # of no extra

    rng, ratios = np.random.default_rng(0), []
    for _ in range(moves):
        n = int(rng.integers(1, 8))
        way, v = rng.normal(size=n) * 10.0 ** rng.uniform(-2.0, 0.5), rng.uniform(1.0, 6.0, size=n)
        limits = MotionLimits(v, v / 0.25, jerk=v / 0.25 / 0.05)
        asked = ruckig.InputParameter(n)
        asked.target_position = way.tolist()
        asked.max_velocity, asked.max_acceleration = v.tolist(), limits.acceleration.tolist()
        asked.max_jerk = limits.jerk.tolist()
        asked.synchronization = ruckig.Synchronization.Phase
        theirs = ruckig.Trajectory(n)
        ruckig.Ruckig(n).calculate(asked, theirs)
        ours = Path("", np.array([0.0, 1.0]), np.stack([0.0 * way, way]), limits).timed(jerk=True)
        ratios.append(float(ours.times[-1]) / theirs.duration)
    return markdown_table(
        ["joint moves", "largest of ruckig's time", "median", "least"],
        [(moves, *map("{:.4f}".format, (max(ratios), statistics.median(ratios), min(ratios))))],
    )


def timing_jumps() -> str:
    """The largest change of an acceleration within a millisecond."""
    rows = []
    paths = [*_of_tasks(), *map(_random, range(20 - len(TASKS)))]
    for path in paths:
        motion = path.timed(jerk=True)
        of = zip(motion.q, motion.velocities, motion.accelerations, strict=True)
        spline = BPoly.from_derivatives(motion.times, list(of))
        changes = np.abs(np.diff(spline(np.arange(0.0, motion.times[-1], 1e-3), 2), axis=0))
        rows.append((changes / 1e-3 / path.limits.jerk).max())
    return markdown_table(
        ["motions", "largest jump", "median"],
        [(len(rows), f"{max(rows):.4f}", f"{statistics.median(rows):.4f}")],
    )


def _roll_jerks(run: qt.Trajectory, apart: float) -> Array:
    """Third derivative of the turn about the tool's z: nine tenths are below, and the largest."""
    task, feed = run.path_task, run.feed
    assert feed is not None
    curve = JointCurve.through(np.append(0.0, np.cumsum(feed)), run.q)
    data, turns = mujoco.MjData(task.model), []
    for q in _at(curve, np.arange(0.0, curve.x[-1], apart))[:, 0]:
        data.qpos[:] = q
        mujoco.mj_kinematics(task.model, data)
        turns.append(getattr(data, task.frame_type)(task.frame_name).xmat.reshape(3, 3).copy())
    R = Rotation.from_matrix(turns)
    rates = (R[:-1].inv() * R[1:]).as_rotvec()[:, 2] / apart
    return np.asarray(np.percentile(np.abs(np.diff(rates, 2)) / apart**2, (90.0, 100.0)))


def _seam(arm: Mounted, radius: float, wide: float, points: int) -> qt.PathTask:
    """Where a pipe of ``radius`` m meets one of radius ``wide``: the tool halves their angle."""
    poses = []
    for t in np.linspace(0.0, 1.5 * np.pi, points):
        x, y = radius * np.cos(t), radius * np.sin(t)
        z = np.sqrt(wide**2 - x**2)
        axis = -np.array([np.cos(t), np.sin(t), 0.0]) - np.array([x, 0.0, z]) / wide
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        turn = mink.SO3.from_matrix(np.column_stack([side, np.cross(axis, side), axis]))
        poses.append(mink.SE3.from_rotation_and_translation(turn, np.array([x, y, z])))
    placed = arm.start @ poses[0].inverse()
    waypoints = [placed @ pose for pose in poses]
    ways = np.linalg.norm(np.diff([w.translation() for w in waypoints], axis=0), axis=1)
    return arm.task("seam", waypoints, np.append(0.0, ways / 0.2))


def _at_speed(tasks: dict[str, qt.PathTask]) -> str:
    """The part of paths at their speed, without and with a constant feed."""
    rows = []
    for name, task in tasks.items():
        speeds, times = [], []
        with tempfile.TemporaryDirectory() as folder:
            for constant in (False, True):
                run = run_task(
                    replace(task, constant_speed=constant),
                    "qp_gradient",
                    pathlib.Path(folder) / "m.csv",
                )
                assert run.check is not None and run.check.speed is not None
                assert run.check.passes, run.check.verdict
                speeds.append(run.check.speed)
                times.append(float(run.check.motion.times[-1]))
        dips = "; ".join(map(str, speeds[1].longest_dips[:3]))
        shares = [
            f"{100.0 * speed.at_speed:.1f} %, {seconds:.2f} s"
            for speed, seconds in zip(speeds, times, strict=True)
        ]
        rows.append((name, *shares, len(speeds[1].dips), dips))
    return markdown_table(["path", "without", "constant", "dips", "the longest"], rows)


def timing_seam() -> str:
    """A weld seam of two robots."""
    return _at_speed(
        {name: _seam(mounted(name, theta), 0.05, 0.08, 151) for name, theta in SEAMS.items()}
    )


def timing_constant(tasks: str = TASKS_OF_ROLL) -> str:
    """Shipped tasks, or task files."""
    return _at_speed({name: qt.load_task(name) for name in tasks.split(",")})


def timing_kinks(tasks: str = TASKS_OF_ROLL) -> str:
    """Where no configuration of a robot's hinges turns its tool's axis fast enough at the feed."""
    rows = []
    for name in tasks.split(","):
        task = qt.load_task(name)
        assert task.durations is not None
        ranges, epsilon = JointRanges.of(task.model), task.tolerances.axis
        limits = with_default_accelerations(motion_limits(task), ranges)
        most = float(limits.acceleration[ranges.hinge].sum())
        h = task.durations[1:]
        axes = task.poses[0][:, :, 2]
        turns = np.cross(axes[:-1], axes[1:])
        sines = np.linalg.norm(turns, axis=1)
        angles = np.arctan2(sines, (axes[:-1] * axes[1:]).sum(axis=1))
        rates = turns * (angles / np.where(sines > 0.0, sines, 1.0) / h)[:, None]
        kinks = np.linalg.norm(np.diff(rates, axis=0), axis=1)
        # An axis that is off by ε at most turns over τ on both sides of a kink Δω by Δω τ − 4 ε
        # more than straight on: with accelerations of (Δω τ − 4 ε)/τ², which 8 ε/Δω makes largest.
        tau = np.minimum(8.0 * epsilon / np.maximum(kinks, 1e-9), np.minimum(h[:-1], h[1:]))
        needed = np.maximum(kinks * tau - 4.0 * epsilon, 0.0) / tau**2
        short = int((needed > most).sum())
        large = np.percentile(needed, (75.0, 90.0, 100.0))
        rows.append((name, len(axes), *map("{:.3g}".format, (*large, most)), short))
    headings = ["path", "waypoints", "needed there, rad/s²: 75 %", "90 %", "largest"]
    return markdown_table([*headings, "all hinges together", "waypoints that need more"], rows)


def timing_roll(tasks: str = TASKS_OF_ROLL) -> str:
    """Smoothness of the roll without and with a constant feed, and the times."""
    rows = []
    for name, faster in itertools.product(tasks.split(","), (1.0, FASTER)):
        task = qt.load_task(name)
        assert task.durations is not None
        task = replace(task, durations=task.durations / faster)
        limits = with_default_jerks(
            with_default_accelerations(motion_limits(task), JointRanges.of(task.model))
        )
        followed = _dense(refine_trajectory(qt.follow(task, slow_down=True)))
        runs = followed, steady_trajectory(followed, limits)
        jerks = np.array([_roll_jerks(run, _APART / faster) for run in runs])
        times = [
            time_trajectory(run, limits=limits, curved=run is not followed).times[-1]
            for run in runs
        ]
        found = [*map("{:.3g}".format, jerks.T.ravel()), *map("{:.2f}".format, times)]
        rows.append((f"`{name}`", f"{faster:g}", *found))
    headings = [
        f"{of}, {how}" for of in ("90 %, rad/s³", "largest, rad/s³", "time, s")
        for how in ("as followed", "with the speed")
    ]  # fmt: skip
    return markdown_table(["task", "times its feed", *headings], rows)


if __name__ == "__main__":
    parts = {
        "timing": timing, "timing_moves": timing_moves, "timing_jumps": timing_jumps,
        "timing_roll": timing_roll, "timing_seam": timing_seam,
        "timing_constant": timing_constant, "timing_kinks": timing_kinks,
    }  # fmt: skip
    raise SystemExit(command(__doc__, parts, paths=20, moves=100, repeats=3, tasks=TASKS_OF_ROLL))

"""What runs take: method by method, many at once, and the first of each on a machine.

    python benchmarks/runs.py [run_times] [batch] [cold_start] [commands] [--runs 10000] [--write]

*run_times*: `deburring` by each method, three times, the fastest counts. A minute.

*batch*: many runs in one call. The workpiece of `deburring` stands in a random place for every run,
up to 50 mm and 3 degrees from the task's; each run has 401 waypoints. Two minutes for 10,000 runs
on two cores. The last table has verified steps at random configurations: every target is within a
degree of the tool, and the secondary asks for more than the speed limits give.

*cold_start*: processor seconds of a whole process, imports included, with an empty folder for
numba's cache, then the same once more with the folder as it was left.

*commands*: processor seconds of whole commands after a first one; the least and the median of nine.
"""

from page import ROOT, command, markdown_table

# isort: split
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial

import mink
import mujoco
import numpy as np
from timer import once

import qp_twist as qt

# ---------------------------------------------------------------- one run

METHODS = {
    "minimum_norm": "closed form",
    "gradient_projection": "closed form",
    "twa": "closed form",
    "sns": "closed form with limits",
    "mink": "mink's step, unverified",
    "qp_minimum_norm": "",
    "qp_gradient": "",
    "qp": "secondary in twist space",
}


def run_times() -> str:
    """A run, method by method."""
    task, rows = qt.load_task("deburring"), []
    solvers = [s for s in ("daqp", "compiled") if s in qt.qp.installed_solvers()]
    for method, words in METHODS.items():
        cells = []
        for solver in solvers:
            runs = [qt.follow(task, method, solver=solver) for _ in range(3)]
            seconds = min(run.seconds for run in runs)
            cells.append(f"{seconds:.3f}" if seconds < 0.1 else f"{seconds:.2f}")
        rows.append((f"`{method}`", int(runs[0].iterations.sum()), *cells, words))
    headings = ("method", "steps", *(f"s a run, {solver}" for solver in solvers), "")
    return markdown_table(headings, rows)


# ---------------------------------------------------------------- many runs


def moves(task: qt.PathTask, count: int) -> list[mink.SE3]:
    rng = np.random.default_rng(0)
    middle = mink.SE3.from_translation(task.positions.mean(axis=0))
    size = np.array([0.05] * 3 + [np.radians(3.0)] * 3)
    return [
        middle @ mink.SE3.exp(size * rng.uniform(-1.0, 1.0, 6)) @ middle.inverse()
        for _ in range(count)
    ]


def microseconds(call: Callable[[], object], count: int) -> float:
    """Time of a call, for each of so many."""
    return 1e-3 * once(call)[0] / count


def floor(task: qt.PathTask, times: int = 20_000) -> float:
    """MuJoCo's kinematics and Jacobian, one configuration after the other, µs."""
    model, data = task.model, mujoco.MjData(task.model)
    data.qpos[:] = task.start
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    site = model.site(task.frame_name).id

    def all_of_them() -> None:
        for _ in range(times):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, linear, angular, site)

    return microseconds(all_of_them, times)


def kinematics(task: qt.PathTask, count: int = 400_000) -> float:
    """The same for many at once, on one thread."""
    q = task.start + np.random.default_rng(0).normal(scale=0.3, size=(count, task.model.nq))
    at = partial(qt.batch.kinematics, task.model, task.frame_name, task.frame_type)
    at(q[:10])  # compiles, or loads
    return microseconds(partial(at, q, threads=1), count)


def followed(
    task: qt.PathTask, method: str, count: int, threads: int
) -> tuple[float, qt.batch.Trajectories]:
    """Seconds, and the runs."""
    carried = moves(task, count)
    follow = partial(qt.batch.follow, task, method, keep=False)
    follow(moves=carried[:2])
    took, done = once(partial(follow, moves=carried, threads=threads))
    return 1e-9 * took, done


def single_steps(count: int = 100_000) -> str:
    """Verified QPs of single configurations, on one thread, for two arms."""
    rows = []
    seven = qt.load_robot(ROOT / "scenes" / "seven_axis_arm.xml").model
    for model in (qt.load_task("deburring").model, seven):
        rng = np.random.default_rng(0)
        ranges = qt.JointRanges.of(model)
        room = 0.35 * (ranges.upper - ranges.lower)
        q = ranges.middle + room * rng.uniform(-1.0, 1.0, (count, model.nq))
        found = qt.batch.kinematics(model, "tool", "site", q)
        # Near a singularity a step is the reference's, which is another figure.
        regular = np.linalg.svd(found.jacobians, compute_uv=False)[:, -1] > 0.02
        q, found = q[regular], qt.batch.Kinematics(*(part[regular] for part in found))
        targets = np.tile(np.eye(4), (len(q), 1, 1))
        targets[:, :3, :3], targets[:, :3, 3] = found.rotations, found.positions
        targets[:, :3, 3] += rng.normal(scale=1e-4, size=(len(q), 3))
        task = qt.TwistTask.axis_free("tool", "site")
        speed = 0.5  # rad/s
        controller = qt.Controller(
            model, [task], secondary=[qt.JointCentering(model, "natural", gain=0.3)],
            limits=[qt.MotionLimit(model, velocity=speed)],
        )  # fmt: skip
        qt.batch.step(controller, q[:9], 0.1, targets[:9])
        took, done = once(partial(qt.batch.step, controller, q, 0.1, targets, threads=1))
        active = (np.abs(np.abs(done.velocity) - speed) < 1e-9).any(axis=1)
        rows.append((
            model.nv, f"{1e-3 * took / len(q):.2f}", f"{100 * active.mean():.0f}",
            f"{int(done.by_reference.sum()):,} of {len(q):,}",
        ))  # fmt: skip
    headings = (
        "joints", "verified QP with kinematics, µs", "a limit active, %",
        "left to `Controller.step`",
    )  # fmt: skip
    return markdown_table(headings, rows, left=0)


def batch(runs: int) -> str:
    """Configurations, runs and steps in batches."""
    task = qt.load_task("deburring")
    each = [
        ("MuJoCo's kinematics and Jacobian, one by one", f"{floor(task):.1f}"),
        ("`batch.kinematics`, one thread", f"{kinematics(task):.2f}"),
    ]
    for method in ("minimum_norm", "gradient_projection", "qp_minimum_norm", "qp_gradient", "qp"):
        seconds, done = followed(task, method, max(20, runs // 50), 1)
        words = " (some runs by the reference)" if done.by_reference.any() else ""
        name = f"a step of `{method}` in `batch.follow`, one thread{words}"
        each.append((name, f"{1e6 * seconds / done.steps.sum():.2f}"))
    rows = []
    for count, threads in ((runs // 10, 1), (runs // 10, 2), (runs, 2)):
        seconds, done = followed(task, "qp_gradient", count, threads)
        steps = int(done.steps.sum())
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append((
            f"{count:,}", threads, f"{seconds:.1f}", f"{steps:,}", f"{1e6 * seconds / steps:.2f}",
            f"{memory:.0f}", f"{int((~done.by_reference).sum()):,}",
        ))  # fmt: skip
    headings = (
        "runs of `qp_gradient`", "threads", "s", "verified steps", "µs a step", "peak memory, MB",
        "completed by the kernel",
    )  # fmt: skip
    return "\n".join((
        markdown_table(("per configuration", "µs"), each), markdown_table(headings, rows, left=0),
        single_steps(),
    ))  # fmt: skip


# ---------------------------------------------------------------- the first one

STEP = """
import mink, qp_twist as qt
model = qt.load_task("deburring").model
task = qt.TwistTask.axis_free("tool", "site")
configuration = mink.Configuration(model, qt.JointRanges.of(model).middle)
task.set_target_from_configuration(configuration)
limits = [qt.MotionLimit(model, velocity=1.0)]
controller = qt.Controller(
    model, [task], secondary=[qt.JointCentering(model, "natural", gain=0.05)], limits=limits
)
controller.step(configuration, 0.005)
"""
TRAJECTORY = "import qp_twist as qt; qt.follow(qt.load_task('deburring'))"
PLAN = "import qp_twist as qt; qt.plan(qt.load_task('deburring'))"
SOLVE_IK = """
import mink, qp_twist as qt
model = qt.load_task("deburring").model
task = mink.FrameTask("tool", "site", 1.0, 1.0)
configuration = mink.Configuration(model, qt.JointRanges.of(model).middle)
task.set_target_from_configuration(configuration)
qt.solve_ik(configuration, [task], 0.005, "daqp")
"""
FIRST = {
    "imports": "import mink, qp_twist",
    "`Controller.step`": STEP,
    "`qt.solve_ik`": SOLVE_IK,
    "`qt.follow`": TRAJECTORY,
    "`qt.plan`": PLAN,
}


def processor_seconds(words: list[str], **variables: str) -> float:
    """Of a Python process with these arguments and variables of its environment."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    given = os.environ | variables
    given.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    subprocess.run([sys.executable, *words], check=True, env=given, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def cold_start() -> str:
    """The first step, trajectory and plan of a machine, and of a process."""
    rows = []
    for words, program in FIRST.items():
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = (
                processor_seconds(["-c", program], NUMBA_CACHE_DIR=folder) for _ in range(2)
            )
        rows.append((words, f"{cold:.1f}", f"{warm:.2f}"))
        print(*rows[-1], file=sys.stderr, flush=True)
    return markdown_table(("the first", "nothing compiled, s", "compiled before, s"), rows)


def commands() -> str:
    """Commands, warm."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/m.csv"
        for words in ("--help", f"run deburring --out {file}", f"check {file} deburring"):
            arguments = ["-m", "qp_twist", *words.split()]
            processor_seconds(arguments)  # writes bytecode and machine code
            took = sorted(processor_seconds(arguments) for _ in range(9))
            shown = words.replace(f"{folder}/", "")
            rows.append((f"`qp-twist {shown}`", f"{took[0]:.2f}", f"{took[4]:.2f}"))
    return markdown_table(("processor time of", "least, s", "median, s"), rows)


if __name__ == "__main__":
    parts = {f.__name__: f for f in (run_times, batch, cold_start, commands)}
    sys.exit(command(__doc__, parts, runs=10_000))

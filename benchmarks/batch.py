"""What a configuration costs when many runs are followed at once.

    python benchmarks/batch.py [--runs 10000] [--markdown FILE]

The workpiece of `deburring` stands in a random place for every run, up to 50 mm and 3 degrees from
the task's; each run has 401 waypoints. Two minutes for 10,000 runs on two cores.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import resource
import time
from pathlib import Path

import mink
import mujoco
import numpy as np
from publishing import command

import qp_twist as qt

SEVEN = Path(__file__).parent.parent / "scenes" / "seven_axis_arm.xml"


def moves(task: qt.PathTask, count: int) -> list[mink.SE3]:
    rng = np.random.default_rng(0)
    middle = mink.SE3.from_translation(task.positions.mean(axis=0))
    size = np.array([0.05] * 3 + [np.radians(3.0)] * 3)
    return [
        middle @ mink.SE3.exp(size * rng.uniform(-1.0, 1.0, 6)) @ middle.inverse()
        for _ in range(count)
    ]


def floor(task: qt.PathTask, times: int = 20_000) -> float:
    """MuJoCo's kinematics and Jacobian, one configuration after the other, microseconds."""
    model, data = task.model, mujoco.MjData(task.model)
    data.qpos[:] = task.start
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    site = model.site(task.frame_name).id
    began = time.perf_counter()
    for _ in range(times):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, linear, angular, site)
    return 1e6 * (time.perf_counter() - began) / times


def kinematics(task: qt.PathTask, count: int = 400_000) -> float:
    """The same for many at once, on one thread."""
    q = task.start + np.random.default_rng(0).normal(scale=0.3, size=(count, task.model.nq))
    qt.batch.kinematics(task.model, task.frame_name, task.frame_type, q[:10])
    began = time.perf_counter()
    qt.batch.kinematics(task.model, task.frame_name, task.frame_type, q, threads=1)
    return 1e6 * (time.perf_counter() - began) / count


def followed(
    task: qt.PathTask, method: str, count: int, threads: int
) -> tuple[float, qt.batch.Trajectories]:
    """Seconds, and the runs."""
    carried = moves(task, count)
    qt.batch.follow(task, method, moves=carried[:2], keep=False)  # compiles, or loads
    began = time.perf_counter()
    done = qt.batch.follow(task, method, moves=carried, keep=False, threads=threads)
    return time.perf_counter() - began, done


def single_steps(count: int = 100_000) -> list[str]:
    """Closed forms and verified QPs of single configurations, on one thread, for two arms.

    Every target is within a degree of the tool, and the secondary asks for more than the speed
    limits give: at nearly every step one of them is active.
    """
    lines = []
    for model in (qt.load_task("deburring").model, qt.load_robot(SEVEN).model):
        rng = np.random.default_rng(0)
        ranges = qt.JointRanges.of(model)
        room = 0.35 * (ranges.upper - ranges.lower)
        q = ranges.middle + room * rng.uniform(-1.0, 1.0, (count, model.nq))
        found = qt.batch.kinematics(model, "tool", "site", q)
        # Near a singularity a step is the reference's, which is another figure.
        regular = np.linalg.svd(found.jacobians, compute_uv=False)[:, -1] > 0.02
        q, found = q[regular], qt.batch.Kinematics(*(part[regular] for part in found))
        count = len(q)
        targets = np.tile(np.eye(4), (count, 1, 1))
        targets[:, :3, :3], targets[:, :3, 3] = found.rotations, found.positions
        targets[:, :3, 3] += rng.normal(scale=1e-4, size=(count, 3))
        task = qt.TwistTask.axis_free("tool", "site")
        desired = 0.1 * (ranges.middle - q)
        qt.batch.closed_form(model, task, q[:9], targets[:9], "gradient_projection", h=desired[:9])
        began = time.perf_counter()
        qt.batch.closed_form(model, task, q, targets, "gradient_projection", h=desired, threads=1)
        closed = 1e6 * (time.perf_counter() - began) / count
        speed = 0.5  # rad/s
        controller = qt.Controller(
            model, [task], secondary=[qt.JointCentering(model, "natural", gain=0.3)],
            limits=[qt.MotionLimit(model, velocity=speed)],
        )  # fmt: skip
        qt.batch.step(controller, q[:9], 0.1, targets[:9])
        began = time.perf_counter()
        done = qt.batch.step(controller, q, 0.1, targets, threads=1)
        seconds = time.perf_counter() - began
        plain = ~done.by_reference
        active = (np.abs(np.abs(done.velocity) - speed) < 1e-9).any(axis=1)
        lines.append(
            f"| {model.nv} | {closed:.2f} | {1e6 * seconds / count:.2f} | "
            f"{100.0 * active.mean():.0f} | {int((~plain).sum()):,} of {count:,} |"
        )
    return lines


def memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def page(runs: int) -> list[str]:
    task = qt.load_task("deburring")
    lines = [
        f"| MuJoCo's kinematics and Jacobian, one by one | {floor(task):.1f} |",
        f"| `batch.kinematics`, one thread | {kinematics(task):.2f} |",
    ]
    for method in ("minimum_norm", "gradient_projection", "qp_minimum_norm", "qp_gradient", "qp"):
        seconds, done = followed(task, method, max(20, runs // 50), 1)
        plain = ~done.by_reference
        lines.append(
            f"| a step of `{method}` in `batch.follow`, one thread"
            f"{'' if plain.all() else ' (some runs by the reference)'} | "
            f"{1e6 * seconds / done.steps.sum():.2f} |"
        )
    lines = ["| per configuration | µs |", "| :-- | --: |", *lines, ""]
    lines += [
        "| runs of `qp_gradient` | threads | s | verified steps | µs a step | peak memory, MB | "
        "completed by the kernel |",
        "| --: | --: | --: | --: | --: | --: | --: |",
    ]
    for count, threads in (
        (runs // 10, 1), (runs // 10, 2), (runs, 2),
    ):  # fmt: skip
        seconds, done = followed(task, "qp_gradient", count, threads)
        steps = int(done.steps.sum())
        lines.append(
            f"| {count:,} | {threads} | {seconds:.1f} | {steps:,} | {1e6 * seconds / steps:.2f} | "
            f"{memory_mb():.0f} | {int((~done.by_reference).sum()):,} |"
        )
    lines += [
        "",
        "| joints | closed form with kinematics, µs | verified QP with kinematics, µs | a limit "
        "active, % | left to `Controller.step` |",
        "| --: | --: | --: | --: | --: |",
        *single_steps(),
    ]
    return lines


if __name__ == "__main__":
    command(__doc__, page, runs=10_000)

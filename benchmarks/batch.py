"""What a configuration costs when many laps are followed at once.

    python benchmarks/batch.py [--laps 10000] [--markdown FILE]

The workpiece of `deburring` stands in a random place for every lap, up to 50 mm and 3 degrees from
the task's; each lap has 401 waypoints. Two minutes for 10,000 laps on two cores.
"""

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import resource
import sys
import time
from pathlib import Path

import mink
import mujoco
import numpy as np

import qp_twist as qt


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


def laps(task: qt.PathTask, method: str, count: int, threads: int) -> tuple[float, qt.batch.Laps]:
    """Seconds, and the laps."""
    carried = moves(task, count)
    qt.batch.follow(task, method, moves=carried[:2], keep=False)  # compiles, or loads
    began = time.perf_counter()
    done = qt.batch.follow(task, method, moves=carried, keep=False, threads=threads)
    return time.perf_counter() - began, done


def memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--laps", type=int, default=10_000)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    task = qt.load_task("deburring")
    lines = [
        f"| MuJoCo's kinematics and Jacobian, one by one | {floor(task):.1f} |",
        f"| `batch.kinematics`, one thread | {kinematics(task):.2f} |",
    ]
    for method in ("minimum_norm", "gradient_projection", "qp_minimum_norm", "qp_gradient", "qp"):
        seconds, done = laps(task, method, max(20, given.laps // 50), 1)
        plain = ~done.by_reference
        lines.append(
            f"| a step of `{method}` in `batch.follow`, one thread"
            f"{'' if plain.all() else ' (some laps by the reference)'} | "
            f"{1e6 * seconds / done.steps.sum():.2f} |"
        )
    lines = ["| per configuration | µs |", "| :-- | --: |", *lines, ""]
    lines += [
        "| laps of `qp_gradient` | threads | s | verified steps | µs a step | peak memory, MB | "
        "completed by the kernel |",
        "| --: | --: | --: | --: | --: | --: | --: |",
    ]
    for count, threads in (
        (given.laps // 10, 1), (given.laps // 10, 2), (given.laps, 2),
    ):  # fmt: skip
        seconds, done = laps(task, "qp_gradient", count, threads)
        steps = int(done.steps.sum())
        lines.append(
            f"| {count:,} | {threads} | {seconds:.1f} | {steps:,} | {1e6 * seconds / steps:.2f} | "
            f"{memory_mb():.0f} | {int((~done.by_reference).sum()):,} |"
        )
    text = "\n".join(lines) + "\n"
    print(text)
    if given.markdown is not None:
        given.markdown.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

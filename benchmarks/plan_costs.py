"""Time and memory of a plan, over waypoints, steps and redundancy.

    python benchmarks/plan_costs.py [--markdown FILE]

Each plan is made by a process of its own, which reports its wall time, its processor time, and how
much its peak of memory is above that before the plan. A few minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import mink
import mujoco
import numpy as np

import qp_twist as qt

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
    """The run at every so manieth of its waypoints."""
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
    **{f"7R, two free, {n} waypoints": (seven, n, 15) for n in (6, 11, 21)},
}


def measure(case: str) -> dict[str, float]:
    """One plan, in this process."""
    make, argument, step = CASES[case]
    task = make(argument)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    wall, cpu = time.perf_counter(), time.process_time()
    plan = qt.plan(task, "centering", max_step_deg=step)
    return {
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "memory_mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0,
        "value": plan.value,
        "bound": plan.bound,
    }


def main() -> None:
    """Measure all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--markdown", type=Path, help="write the table here, too")
    parser.add_argument("--case", help="measure one case here, and print it as JSON")
    args = parser.parse_args()
    if args.case:
        print(json.dumps(measure(args.case)))
        return
    lines = [
        "| arm and path | time, s | processor, s | memory, MB | mean z | bound |",
        "| :-- | --: | --: | --: | --: | --: |",
    ]
    for case in CASES:
        command = [sys.executable, __file__, "--case", case]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found = json.loads(done.stdout)
        lines.append(
            f"| {case} | {found['wall_s']:.1f} | {found['cpu_s']:.1f} | {found['memory_mb']:.0f} | "
            f"{found['value']:.4f} | {found['bound']:.4f} |"
        )
        print(lines[-1], flush=True)
    if args.markdown:
        args.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""What the first step, trajectory and plan on a machine cost, with nothing compiled before.

    python benchmarks/cold_start.py [--markdown FILE]

Each is a process of its own with an empty folder for numba's cache, then the same once more with
the folder as it was left. Processor seconds of the whole process, imports included, of all threads.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile

from publishing import command

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


def processor_seconds(program: str, folder: str) -> float:
    """Of a process that keeps its machine code in ``folder``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    surroundings = os.environ | {"NUMBA_CACHE_DIR": folder}
    subprocess.run([sys.executable, "-c", program], check=True, env=surroundings)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def page() -> list[str]:
    lines = ["| the first | nothing compiled, s | compiled before, s |", "| :-- | --: | --: |"]
    for words, program in FIRST.items():
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = (processor_seconds(program, folder) for _ in range(2))
        lines.append(f"| {words} | {cold:.1f} | {warm:.2f} |")
        print(lines[-1], flush=True)
    return lines


if __name__ == "__main__":
    command(__doc__, page)

"""Random trajectories through every robot program: there, back, and through the check.

python benchmarks/programs.py [COUNT]

For each of COUNT seeds (1,000) and each language: a trajectory of a random robot of the table, in a
model with random zero positions and signs; written, read back, compared with the printed digit, and
checked against a task whose waypoints are where the trajectory leads. Bags are read by rosbags.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from oracles.joint_paths import joint_path
from oracles.program_rows import DECIMALS, random_rows
from oracles.remodelled import remodelled

from qp_twist.programs import DIALECTS
from qp_twist.robots import controller_joints, named_robot
from qp_twist.trajectories import check_trajectory, read_trajectory, write_trajectory


def main(count: int) -> None:
    print(
        "| language | trajectories | recognised | equal to the digit | pass | largest error, mm |"
    )
    print("| :-- | --: | --: | --: | --: | --: |")
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for program in [*DIALECTS, "mcap"]:
            print(_row(program, count, Path(folder)), flush=True)
    print(f"\n{time.perf_counter() - started:.0f} s")


def _row(program: str, count: int, folder: Path) -> str:
    recognised = equal = passed = 0
    worst = 0.0
    for seed in range(count):
        rows, joints = random_rows(seed, "krl" if program == "mcap" else program, step=0.002)
        robot = named_robot(joints.robot)
        model = remodelled(robot, joints.signs, joints.offsets, (0.1, 0.2, 0.3), "tool")
        found = controller_joints(model, "tool", "site", robot)
        assert rows.times is not None
        durations = np.concatenate([[0.0], np.diff(rows.times)])
        task = joint_path(model, rows.q, durations).path_task
        if program == "mcap":
            back = read_trajectory(write_trajectory(rows, folder / "bag.mcap"))
            same = bool((back.q == rows.q).all()) and _as_rosbags_reads(folder / "bag.mcap", rows.q)
            recognised += 1
        else:
            suffix = DIALECTS[program].suffix
            path = write_trajectory(rows, folder / f"prog{suffix}", found)
            back = read_trajectory(path, rows.joint_names, found)
            unit = 1.0 if program == "urscript" else np.degrees(1.0)
            off = unit * np.abs(joints.shown(back.q) - joints.shown(rows.q))
            same = bool(off.max() <= 0.5 * 10.0 ** -DECIMALS[program][0] + 1e-12)
            recognised += bool((found.signs == joints.signs)[1:].all())
        check = check_trajectory(back, task)
        equal += same
        passed += check.passes
        worst = max(worst, check.findings[0].value)
    return f"| {program} | {count} | {recognised} | {equal} | {passed} | {worst:.2g} |"


def _as_rosbags_reads(path: Path, q: np.ndarray) -> bool:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        [(connection, _, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    return bool((np.array([point.positions for point in message.points]) == q).all())


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)

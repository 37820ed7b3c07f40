"""Random trajectories through every robot program: there, back, and through the check.

python benchmarks/programs.py [COUNT] [--poses]

For each of COUNT seeds (1,000) and each language: a trajectory of a random robot of the table, in a
model with random zero positions and signs; written, read back, compared with the printed digit, and
checked against a task whose waypoints are where the trajectory leads. Bags are read by rosbags.

With --poses instead straight moves to poses, in RAPID and KRL: through the rows of COUNT random
trajectories, there and back; and COUNT changed texts of one program each, by the changes of
``toolpath_mutations.py``. What still passes is read once more by the expressions of the tests'
simulator, which has to find every pose on the path.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from oracles.joint_paths import joint_path
from oracles.pose_programs import Case, case_of, on_path, written
from oracles.program_rows import DECIMALS, random_rows
from oracles.remodelled import remodelled
from toolpath_mutations import mutated

from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.programs import DIALECTS
from qp_twist.robots import ToolChain, controller_joints, named_robot
from qp_twist.trajectories import (
    check_trajectory,
    read_trajectory,
    write_checked,
    write_trajectory,
)
from qp_twist.trajectories.linear_moves import LinearMotion


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


POSES = LinearMotion(points="poses")


def poses(count: int) -> None:
    print("| language | trajectories | written | refused | points equal to 0.001° | largest, ° |")
    print("| :-- | --: | --: | --: | --: | --: |")
    with tempfile.TemporaryDirectory() as folder:
        for program in ("rapid", "krl"):
            print(_there_and_back(program, count, Path(folder)), flush=True)
        print("\n| changed | texts | refused | fail | pass | of these off the path | traceback |")
        print("| :-- | --: | --: | --: | --: | --: | --: |")
        for name in ("ABB IRB 4600-60/2.05", "KUKA KR 16-2"):
            print(_changed(case_of(name), count, Path(folder)), flush=True)


def _there_and_back(program: str, count: int, folder: Path) -> str:
    done = refused = equal = 0
    worst, seed = 0.0, -1
    while done + refused < count:
        seed += 1
        rows, joints = random_rows(seed, program, step=0.002)
        robot = named_robot(joints.robot)
        if robot.coupling is not None:  # for which there is no rule
            continue
        model = remodelled(robot, joints.signs, joints.offsets, (0.1, 0.2, 0.3), "tool")
        chain = SerialChain.of(model, "tool", "site")
        tool = ToolChain(chain, JointRanges.of(model).names, "tool")
        found = controller_joints(model, "tool", "site", robot).with_tool(tool, robot)
        assert rows.times is not None
        task = joint_path(model, rows.q, np.append(0.0, np.diff(rows.times))).path_task
        path = folder / f"prog{DIALECTS[program].suffix}"
        try:
            _, was = write_checked(rows, path, task, found, linear=POSES, force=True)
            back = read_trajectory(path, rows.joint_names, found) if was else rows
        except InvalidInput as refusal:
            refused += 1
            print(seed, refusal, file=sys.stderr)
            continue
        done += 1
        ends = [np.abs(back.q - row).max(axis=1).min() for row in rows.q[[0, -1]]]
        worst = max(worst, float(np.degrees(max(ends))))
        equal += bool(np.degrees(max(ends)) < 1e-3)
    return f"| {program} | {count} | {done} | {refused} | {equal} | {worst:.2g} |"


def _changed(case: Case, count: int, folder: Path) -> str:
    path = folder / f"loop{case.suffix}"
    write_checked(case.rows, path, case.task, case.joints, linear=POSES)
    text, rng = path.read_text(), random.Random(0)
    right = written(text)
    refused = fails = passes = off = wrong = 0
    for _ in range(count):
        changed = mutated(text, [text], rng)
        path.write_text(changed)
        try:
            check = check_trajectory(read_trajectory(path, None, case.joints), case.task)
        except InvalidInput:
            refused += 1
            continue
        except Exception:  # the traceback that is looked for
            wrong += 1
            print(f"---\n{traceback.format_exc(limit=-3)}", file=sys.stderr)
            continue
        if not check.passes:
            fails += 1
            continue
        passes += 1
        try:
            now = written(changed)
            assert right.tool is not None and right.frame is not None
            assert now.tool is not None and now.frame is not None
            # Poses of the task's frame in the world, if base and tool are those of the first text.
            points = np.array([
                (now.frame @ pose @ np.linalg.inv(now.tool) @ right.tool)[:3, 3]
                for pose in now.poses
            ])  # fmt: skip
            world = np.linalg.inv(right.frame)
            on_path(case.task, points @ world[:3, :3].T + world[:3, 3])
        except Exception as error:
            off += 1
            print(f"passes: {error!r}", *difference(text, changed), sep="\n", file=sys.stderr)
    name = case.joints.robot
    return f"| {name} | {count} | {refused} | {fails} | {passes} | {off} | {wrong} |"


def difference(text: str, changed: str) -> list[str]:
    """Lines of one text that the other one does not have."""
    before, after = text.split("\n"), changed.split("\n")
    lost = [f"- {line[:150]}" for line in before if line not in after]
    return [*lost, *(f"+ {line[:150]}" for line in after if line not in before)]


def _as_rosbags_reads(path: Path, q: np.ndarray) -> bool:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        [(connection, _, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    return bool((np.array([point.positions for point in message.points]) == q).all())


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    poses(number) if "--poses" in sys.argv else main(number)

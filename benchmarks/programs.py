"""Random trajectories through every robot program: there, back, and through the check.

python benchmarks/programs.py [COUNT] [--poses | --circles]; or grid (``program_grid.py``)

For each of COUNT seeds (1,000) and each language: a trajectory of a random robot of the table, in a
model with random zero positions and signs; written, read back, compared with the printed digit, and
checked against a task whose waypoints are where the trajectory leads. Bags are read by rosbags.

With --poses instead straight moves, to poses (URScript: to joint angles): through the rows of COUNT
random trajectories, there and back; and COUNT changed texts of one program each, by the changes of
``toolpath_mutations.py``. What still passes is read and moved once more by the tests' own simulator
(``tests/oracles/program_simulator.py``): *off the path*, or *unread*, if it finds other moves. In
rows with *forms* the changes are of zones, tools, frames, groups, speeds and accelerations.

With --circles COUNT random circles of others in each language, against formulas of the tests' own;
and the points per metre of a hole's edge and of a seam about a cone, with circles and without.
"""

from __future__ import annotations

import itertools
import random
import re
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from oracles import circle_programs
from oracles.joint_paths import joint_path
from oracles.program_cells import Job, job_of, measured
from oracles.program_rows import DECIMALS, random_rows
from oracles.program_simulator import Controller, read, rounded
from oracles.remodelled import remodelled
from program_grid import grid
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


CHANGED = {
    "ABB IRB 120": "poses", "KUKA KR 16-2": "poses", "Fanuc LR Mate 200iD": "poses",
    "Universal Robots UR5e": "joints",
}  # fmt: skip
"""Robots whose programs are changed, and the points of their straight moves."""


def poses(count: int) -> None:
    print("| language | trajectories | written | refused | points equal to 0.001° | largest, ° |")
    print("| :-- | --: | --: | --: | --: | --: |")
    with tempfile.TemporaryDirectory() as folder:
        for program in DIALECTS:
            print(_there_and_back(program, count, Path(folder)), flush=True)
        print("\n| changed | texts | refused | fail | pass | off the path | unread | traceback |")
        print("| :-- | --: | --: | --: | --: | --: | --: | --: |")
        for (name, points), forms in itertools.product(CHANGED.items(), (False, True)):
            job = job_of(name, "", 0.03, 31)
            print(_changed(job, points, count, Path(folder), forms=forms), flush=True)


def _there_and_back(program: str, count: int, folder: Path) -> str:
    done = refused = equal = 0
    worst, seed = 0.0, -1
    while done + refused < count:
        seed += 1
        rows, joints = random_rows(seed, program, step=0.002)
        robot = named_robot(joints.robot)
        model = remodelled(robot, joints.signs, joints.offsets, (0.1, 0.2, 0.3), "tool")
        chain = SerialChain.of(model, "tool", "site")
        tool = ToolChain(chain, JointRanges.of(model).names, "tool")
        found = controller_joints(model, "tool", "site", robot).with_tool(tool, robot)
        assert rows.times is not None
        task = joint_path(model, rows.q, np.append(0.0, np.diff(rows.times))).path_task
        path = folder / f"prog{DIALECTS[program].suffix}"
        linear = LinearMotion(points="joints" if program == "urscript" else "poses")
        try:
            _, was = write_checked(rows, path, task, found, linear=linear, force=True)
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


def _changed(job: Job, points: str, count: int, folder: Path, *, forms: bool) -> str:
    path = folder / f"loop{job.suffix}"
    linear = LinearMotion(points=points)  # type: ignore[arg-type]
    write_checked(job.rows, path, job.task, job.joints, linear=linear)
    text, rng = path.read_text(), random.Random(0)
    whole = len(read(text, job.suffix).moves)
    refused = fails = passes = off = unread = wrong = 0
    for _ in range(count):
        changed = _form(text, job.suffix, rng) if forms else mutated(text, [text], rng)
        path.write_text(changed)
        try:
            check = check_trajectory(read_trajectory(path, None, job.joints), job.task)
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
        # What passes is moved once more, as the tests' own simulator reads the text.
        try:
            program = read(changed, job.suffix)
            if len(program.moves) != whole:
                raise ValueError("other moves")
            motion = Controller(job.cell, program).run(most=40)
            found, cut = measured(job, motion), rounded(motion, program.moves)
            assert max(found.off_path, cut) <= 1e-4 and found.off_axis <= np.radians(0.05), found
        except AssertionError as error:
            off += 1
            print(f"passes: {error!r}", *difference(text, changed), sep="\n", file=sys.stderr)
        except Exception as error:
            unread += 1
            print(f"unread: {error!r}", *difference(text, changed), sep="\n", file=sys.stderr)
    counts = (count, refused, fails, passes, off, unread, wrong)
    return f"| {job.cell.name}{', forms' * forms} | {' | '.join(map(str, counts))} |"


FORMS = {
    ".mod": {r"\bz0\b": ("z1", "z10", "z200", "fine"), r"\btask_tool\b": ("tool0", "tool7"),
             r"\btask_wobj\b": ("wobj0", "wobj7"),
             r"(?<=\],\[)[\d.]+(?=,[\d.]+,5000)": ("1", "900")},
    ".src": {r"CDIS=[\d.]+": ("CDIS=1", "CDIS=200"), r" C_DIS": ("", " C_VEL", " C_PTP"),
             r"VEL\.CP=[\d.]+": ("VEL.CP=0.001", "VEL.CP=2"), r"#VAR": ("#JOINT", "#CONSTANT"),
             r"(?<=[$]TOOL=).*": ("TOOL_DATA[3]",), r"(?<=[$]BASE=).*": ("BASE_DATA[3]",)},
    ".ls": {r"CNT\d+": ("CNT0", "CNT50", "CNT100", "FINE"), r"(?<=UTOOL_NUM=)\d": ("2", "9"),
            r"(?<=UFRAME_NUM=)\d": ("2", "9"), r"(?<=UT : )\d": ("2", "9"),
            r"(?<=UF : )\d": ("3", "9"),
            r"(?<=GROUP\t= )1,\*": ("*,1", "1,1"), r"\d+(?=mm/sec)": ("1", "900")},
    ".script": {r"(?<=r=)[\d.]+": ("0", "0.01", "0.5"), r"(?<=a=)[\d.]+": ("0.01", "15"),
                r"(?<=v=)[\d.]+": ("0.01", "1"), r"movel": ("movep", "movej")},
}  # fmt: skip
"""Changes of zones, tools, frames, groups, speeds and accelerations."""


def _form(text: str, suffix: str, rng: random.Random) -> str:
    """A text with one such change, in one place or all; in half of them without a header."""
    pattern, others = rng.choice(list(FORMS[suffix].items()))
    found, other = [*re.finditer(pattern, text)], rng.choice(others)
    if not found:
        return text
    at = rng.choice(found)
    changed = f"{text[: at.start()]}{other}{text[at.end() :]}"
    changed = changed if rng.random() < 0.5 else re.sub(pattern, other, text)
    bare = suffix != ".ls" and rng.random() < 0.5  # whose lines are counted
    return re.sub(r"(?m)^ *[!;#].*\n", "", changed) if bare else changed


def circles(count: int) -> None:
    print("| robot | circles | refused | position, mm | turn, ° | time, s |")
    print("| :-- | --: | --: | --: | --: | --: |")
    with tempfile.TemporaryDirectory() as folder:
        for name in circle_programs.POSTURES:
            print(_followed(name, count, Path(folder)), flush=True)
        print("\n| robot | path | moves to | points per m, straight | with circles | circles |")
        print("| :-- | :-- | :-- | --: | --: | --: |")
        for name in circle_programs.POSTURES:
            for kind in ("hole", "seam"):
                print(_per_metre(name, kind, Path(folder)), flush=True)


def _followed(name: str, count: int, folder: Path) -> str:
    joints = circle_programs.case_of(name, "hole").joints
    rng, path = np.random.default_rng(0), folder / f"other{circle_programs.SUFFIXES[name]}"
    worst, done, refused = np.zeros(3), 0, 0
    while done + refused < count:
        circle = circle_programs.random_circle(name, rng)
        if circle is None:
            continue
        path.write_text(circle.text)
        try:
            back = read_trajectory(path, None, joints)
        except InvalidInput as refusal:
            refused += 1
            print(name, refusal, file=sys.stderr)
            continue
        done += 1
        assert back.times is not None
        theta = np.degrees(joints.shown(back.q))
        if name.startswith("Fanuc"):  # which shows the forearm's angle to the floor
            theta[:, 2] += theta[:, 1]
        points, R = circle.at(back.times / back.times[-1])
        found = np.array([circle_programs.flange(name, each) @ circle.tool for each in theta])
        off = np.linalg.norm(found[:, :3, 3] - points, axis=1).max()
        turn = Rotation.from_matrix(R.transpose(0, 2, 1) @ found[:, :3, :3]).magnitude().max()
        late = abs(back.times[-1] - circle.seconds)
        worst = np.maximum(worst, [1e3 * off, np.degrees(turn), late])
    errors = " | ".join(f"{each:.1g}" for each in worst)
    return f"| {name} | {done} | {refused} | {errors} |"


def _per_metre(name: str, kind: str, folder: Path) -> str:
    case, suffix = circle_programs.case_of(name, kind), circle_programs.SUFFIXES[name]
    points, counts, found = "poses" if suffix == ".src" else "joints", list[float](), 0
    length = circle_programs.RADIUS * np.radians(360.0 if kind == "hole" else circle_programs.SEAM)
    for on_circles in (False, True):
        linear = LinearMotion(points=points, circles=on_circles)
        check, _ = write_checked(
            case.rows, path := folder / f"path{suffix}", case.task, case.joints, linear=linear
        )
        assert check.passes, check.verdict
        text = path.read_text()
        counts.append(int(text.split("points: ")[1].split()[0]) / length)
        found = sum(text.count(word) for word in ("MoveC ", "\nCIRC ", ":C P[", "movec("))
    return f"| {name} | {kind} | {points} | {counts[0]:.0f} | {counts[1]:.0f} | {found} |"


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
    if "grid" in sys.argv:
        grid()
    else:
        number = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
        modes = {"--poses": poses, "--circles": circles}
        next((run for word, run in modes.items() if word in sys.argv), main)(number)

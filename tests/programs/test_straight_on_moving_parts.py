"""Programs of robots on a rail, with parts on a positioner and in the hand, simulated here.

The whole grid, six robots of each language, is ``benchmarks/programs.py grid``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from oracles.data_sheets import RODS
from oracles.program_cells import Job, job_of, measured
from oracles.program_simulator import Cell, Controller, read

import qp_twist as qt
from qp_twist.kinematics import JointRanges
from qp_twist.referee import MotionLimits
from qp_twist.trajectories import (
    TimedPath,
    check_trajectory,
    joints_of,
    read_trajectory,
    write_checked,
)
from qp_twist.trajectories.linear_moves import LinearMotion

ABB, KUKA, FANUC = "ABB IRB 4600-60/2.05", "KUKA KR 16-2", "Fanuc M-20iA"
UR = "Universal Robots UR5e"
JOBS: dict[tuple[str, str], Job] = {}
TEXTS: dict[tuple[int, LinearMotion | None], str] = {}
DATA = ',TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n  PROC'


def job(name: str, extra: str) -> Job:
    if (name, extra) not in JOBS:
        length = 0.06 if name == RODS else 0.03
        JOBS[name, extra] = in_hand() if extra == "hand" else job_of(name, extra, length, 31)
    return JOBS[name, extra]


def in_hand() -> Job:
    """The shipped task, whose arm counts as its controller does, up to the coupling."""
    task = qt.load_task("part_in_hand").part(slice(0, 8))
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    rows = TimedPath.of(qt.time_trajectory(trajectory))
    scene = task.shown.model
    names = JointRanges.of(scene).names
    cell = Cell("Fanuc M-16iB/20", scene, names, np.ones(6), np.zeros(6), {}, "part", "wheel")
    order = [JointRanges.of(task.model).names.index(n) for n in names]
    limits = MotionLimits(task.velocity_limits[order], task.acceleration_limits[order])
    return Job(task, rows, joints_of(task, names), cell, ".ls", limits)


def program(of: Job, linear: LinearMotion | None, folder: Path) -> Path:
    path, key = folder / f"wave{of.suffix}", (id(of), linear)
    if key not in TEXTS:
        check, done = write_checked(of.rows, path, of.task, of.joints, linear=linear)
        assert done and check.passes, check.verdict
        TEXTS[key] = path.read_text()
    path.write_text(TEXTS[key])
    return path


@pytest.mark.parametrize(
    ("name", "extra", "linear", "words"),
    [
        (ABB, "rail", LinearMotion(2), r"CalcRobT\(\[\[.*?\],\[-?\d+\.\d+,9E9,.*\],tool2\),"),
        (ABB, "positioner", LinearMotion(2, 5), r"tool2\\WObj:=wobj5\),.*tool2\\WObj:=wobj5;"),
        (ABB, "positioner", LinearMotion(None, 5, "poses"), r"\],\[.*,9E9\]\],.*WObj:=wobj5;"),
        (KUKA, "rail", LinearMotion(2, 5), r"BASE=BASE_DATA\[5\](.|\n)*LIN \{.*,T \d+,E1 -?\d"),
        (KUKA, "positioner", LinearMotion(None, 5),
         r"\$BASE=EK\(MACHINE_DEF\[2\].ROOT,MACHINE_DEF\[2\].MECH_TYPE,BASE_DATA\[5\]\)"),
        (FANUC, "rail", LinearMotion(2, 5, "poses"), r"R= \S+ deg,\n\tE1= \S+ mm\n"),
        (FANUC, "positioner", LinearMotion(2), r"L P\[2\] \S+ CNT\d+ COORD ;"),
        ("", "hand", LinearMotion(2, 5), r"UFRAME_NUM=5 (.|\n)*L P\[2\] \S+ (CNT\d+|FINE) RTCP ;"),
    ],
)  # fmt: skip
def test_the_tool_moves_straight_on_the_part_and_axes_in_proportion(
    name: str, extra: str, linear: LinearMotion, words: str, tmp_path: Path
) -> None:
    of = job(name, extra)
    path = program(of, linear, tmp_path)
    text = path.read_text()
    assert re.search(words, text), text
    steps = read(text, of.suffix)
    assert len(steps.moves) < 0.9 * len(of.rows.q)
    assert all(move.straight for move in steps.moves[1:])
    assert {move.on_part for move in steps.moves[1:]} == {extra in ("positioner", "hand")}
    motion = Controller(of.cell, steps).run()
    found = measured(of, motion)
    assert found.off_path <= 1e-4 and found.off_axis <= np.radians(0.05)
    assert found.off_ends <= 1e-5 and found.speed <= 1.0
    # The check sees the same motion.
    back = read_trajectory(path, None, of.joints)
    names = [of.cell.model.joint(k).name for k in range(of.cell.model.njnt)]
    assert back.times is not None
    q = back.of_joints(tuple(names)).q
    same = [np.interp(motion.times, back.times, column) for column in q.T]
    assert back.times[-1] == pytest.approx(motion.times[-1], rel=1e-6)
    assert np.abs(np.array(same).T - motion.q).max() < 1e-4
    if extra in ("rail", "positioner"):
        moved = [of.cell.model.joint(joint).qposadr[0] for joint, _ in of.cell.external.values()]
        assert (np.ptp(motion.q[:, moved], axis=0) > 1e-3).all()


@pytest.mark.parametrize(
    ("name", "extra", "linear"),
    [
        (ABB, "rail", None), (KUKA, "positioner", None), (FANUC, "positioner", None),
        (UR, "", None), (UR, "", LinearMotion()), (RODS, "", None),
        (RODS, "", LinearMotion(points="poses")),
    ],
)  # fmt: skip
def test_joint_moves_and_robots_alone_keep_path_and_limits(
    name: str, extra: str, linear: LinearMotion | None, tmp_path: Path
) -> None:
    of = job(name, extra)
    steps = read(program(of, linear, tmp_path).read_text(), of.suffix)
    found = measured(of, Controller(of.cell, steps).run())
    assert found.off_path <= 1e-4 and found.off_axis <= np.radians(0.05)
    assert found.off_ends <= 1e-5 and found.speed <= 1.0
    if name == UR and linear is None:  # whose program has its own curves between points
        assert found.acceleration <= 1.01


@pytest.mark.parametrize(
    ("name", "extra", "linear", "change", "words"),
    [
        (FANUC, "positioner", LinearMotion(2), (" COORD", ""),
         r"line \d+: the tool moves straight in a frame that stands still; the part of the task is "
         "on a positioner"),
        (FANUC, "positioner", LinearMotion(2), (" COORD", " RTCP"),
         "on a part that the robot holds"),
        (FANUC, "rail", LinearMotion(2), (r"(L P.* CNT\d+)", r"\1 COORD"),
         "on a part that a positioner moves; the part of the task stands still"),
        (FANUC, "rail", LinearMotion(2, 5, "poses"), (r"(L P.* CNT\d+)", r"\1 COORD"),
         "on a part that moves, points are read as joint angles alone"),
        (FANUC, "positioner", LinearMotion(2), (r"J (P\[1\].*FINE)", r"J \1 COORD"),
         "J is not read"),
        (ABB, "positioner", LinearMotion(2), (r"\\WObj:=wobj1", ""),
         "in a frame that stands still"),
        (ABB, "positioner", LinearMotion(2), (r"\\WObj:=wobj1;", r"\\WObj:=wobj2;"),
         "expected the tool tool2 and the work object wobj1"),
        (ABB, "positioner", LinearMotion(2),
         ("  PROC", f"  PERS wobjdata wobj1:=[FALSE{DATA}"), "in a frame that stands still"),
        (ABB, "positioner", LinearMotion(2),
         ("  PROC", f"  PERS wobjdata wobj1:=[TRUE{DATA}"), "on a part that the robot holds"),
        (KUKA, "positioner", LinearMotion(None, 5), (r"EK\(.*(BASE_DATA\[5\])\)", r"\1"),
         "in a frame that stands still"),
        (KUKA, "positioner", LinearMotion(None, 5), (r"MACHINE_DEF\[2\].R", "MACHINE_DEF[3].R"),
         "a call in an expression"),
        (KUKA, "rail", LinearMotion(2, 5), (r"BASE_DATA\[5\]", "{X 0,Y 0,Z 0,A 0,B 0,C 0}"),
         "are not read of a robot on a rail"),
    ],
)  # fmt: skip
def test_a_part_that_moves_otherwise_is_refused(
    name: str, extra: str, linear: LinearMotion, change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    of = job(name, extra)
    path = program(of, linear, tmp_path)
    text = path.read_text()
    changed = re.sub(*change, text)
    assert changed != text
    if name != FANUC:  # whose lines are counted; else numbers that the header states are missed
        changed = re.sub(r"(?m)^\s*[!;].*\n", "", changed)
    path.write_text(changed)
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, of.joints)


def test_changed_values_of_external_axes_do_not_pass(tmp_path: Path) -> None:
    for name, extra, linear, value in (
        (ABB, "positioner", LinearMotion(2), r"CalcRobT\(\[\[[^\]]*\],\["),
        (ABB, "rail", LinearMotion(2), r"CalcRobT\(\[\[[^\]]*\],\["),
        (FANUC, "positioner", LinearMotion(2), r"P\[9\][^;]*GP2:[^;]*J1= "),
    ):
        of = job(name, extra)
        path = program(of, linear, tmp_path)
        text = path.read_text()
        place = re.search(rf"{value}(-?\d+\.\d+)", text)
        assert place
        more = f"{float(place[1]) + 0.5:.4f}"
        path.write_text(text[: place.start(1)] + more + text[place.end(1) :])
        try:
            check = check_trajectory(read_trajectory(path, None, of.joints), of.task)
        except qt.InvalidInput as refusal:
            assert re.search("singularity|configuration|seconds|speeds", str(refusal))
        else:
            assert not check.passes


@pytest.mark.parametrize("key", ["UF", "UT"])
@pytest.mark.parametrize("point", ["9", r"\d+"])
def test_the_numbers_of_the_positioners_group_are_those_in_force(
    point: str, key: str, tmp_path: Path
) -> None:
    of = job(FANUC, "positioner")
    path = program(of, LinearMotion(2), tmp_path)
    changed, count = re.subn(
        rf"(P\[{point}\][^;]*GP2:[^;]*{key} : )\d+", r"\g<1>7", path.read_text()
    )
    assert count == 1 or point != "9"
    path.write_text(changed)
    with pytest.raises(qt.InvalidInput, match=rf"line \d+: P\[\d+\] has {key} : 7 of group 2"):
        read_trajectory(path, None, of.joints)


def test_a_unit_that_the_file_states_is_read(tmp_path: Path) -> None:
    of = job(ABB, "positioner")
    path = program(of, LinearMotion(2), tmp_path)
    data = 'PERS wobjdata wobj1:=[FALSE,FALSE,"STN_1",[[0,0,0],[1,0,0,0]],[[9,0,0],[1,0,0,0]]];'
    path.write_text(path.read_text().replace("  PROC", f"  {data}\n  PROC"))
    assert check_trajectory(read_trajectory(path, None, of.joints), of.task).passes


@pytest.mark.parametrize(
    ("name", "extra", "suffix", "linear", "words"),
    [
        (ABB, "rail", ".mod", LinearMotion(points="poses"), r"state the number of the frame"),
        (KUKA, "positioner", ".src", LinearMotion(), r"state the number of the frame"),
        (ABB, "rail", ".mod", LinearMotion(frame=2), "of points that are poses"),
        (FANUC, "positioner", ".ls", LinearMotion(1, 1, "poses"),
         "to poses on a part on a positioner are not written in a TP program; write joints"),
        ("", "hand", ".ls", LinearMotion(1, 1, "poses"), "in the robot's hand are not written"),
        ("", "hand", ".script", LinearMotion(), "write joint moves"),
        ("", "hand", ".src", LinearMotion(frame=1), "write joint moves"),
    ],
)  # fmt: skip
def test_what_is_not_written(
    name: str, extra: str, suffix: str, linear: LinearMotion, words: str, tmp_path: Path
) -> None:
    of = job(name, extra)
    joints = of.joints
    if extra == "hand" and suffix != ".ls":
        joints = joints_of(of.task, joints.joint_names, as_modelled=True)
    with pytest.raises(qt.InvalidInput, match=words):
        write_checked(of.rows, tmp_path / f"a{suffix}", of.task, joints, linear=linear)

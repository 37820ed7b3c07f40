"""What a program states of its tool, its stops and its speeds counts, whatever its header says."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from oracles.program_cells import Job, job_of
from oracles.program_simulator import read
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist.referee import DIP
from qp_twist.trajectories import (
    Check,
    TimedPath,
    check_trajectory,
    read_trajectory,
    write_checked,
)
from qp_twist.trajectories.linear_moves import LinearMotion

IN_HEADER = r"frame in the flange: (set_tcp\(p\[.*?\]\))"


def written(name: str, folder: Path, **options: object) -> tuple[Job, str]:
    job = job_of(name, length=0.1, count=51)
    job = job._replace(task=dataclasses.replace(job.task, **options))
    path = folder / f"wave{job.suffix}"
    linear = LinearMotion(tool=None if job.suffix == ".script" else 3)
    check, done = write_checked(job.rows, path, job.task, job.joints, linear=linear)
    assert done and check.passes, check.verdict
    return job, path.read_text()


def checked(job: Job, text: str, folder: Path) -> Check:
    path = folder / f"changed{job.suffix}"
    path.write_text(text)
    return check_trajectory(read_trajectory(path, joints=job.joints), job.task)


def stated_tool(text: str) -> str:
    """The tool as the header states it."""
    found = re.search(IN_HEADER, text)
    assert found
    return found[1]


def without_header(text: str) -> str:
    return re.sub(r"(?m)^\s*[#!].*\n", "", text)


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, str]:
    return written("Universal Robots UR5e", tmp_path_factory.mktemp("script"))


def test_a_tool_that_a_script_states_moves_straight_and_at_the_speed(
    script: tuple[Job, str], tmp_path: Path
) -> None:
    job, text = script
    own = stated_tool(text)
    begin = text.index("  movej(")
    right = text[:begin] + f"  {own}\n" + text[begin:]
    assert checked(job, right, tmp_path).passes
    values = [float(each) for each in re.findall(r"-?\d+\.\d+", own)]
    values[2] += 0.5  # the flange is then nearer to the path's turns than the tool
    other = f"set_tcp(p[{', '.join(f'{each:.6f}' for each in values)}])"
    wrong = checked(job, text[:begin] + f"  {other}\n" + text[begin:], tmp_path)
    assert not wrong.passes and "feed" in wrong.verdict


def test_the_tool_of_the_header_is_that_of_the_task(
    script: tuple[Job, str], tmp_path: Path
) -> None:
    job, text = script
    own = stated_tool(text)
    number = re.findall(r"\d+\.\d+", own)[0]
    changed = text.replace(own, own.replace(number, "0.123456", 1))
    with pytest.raises(qt.InvalidInput, match=r"the header says flange: 0\.123456"):
        checked(job, changed, tmp_path)


def test_points_that_are_not_rounded_are_stops(tmp_path: Path) -> None:
    job, text = written("Universal Robots UR5e", tmp_path, constant_speed=True, max_dip=0.5)
    stopping = without_header(re.sub(r", r=0[0-9.]*", "", text))
    check = checked(job, stopping, tmp_path)
    (dip,) = (finding for finding in check.findings if finding.name == DIP)
    assert not check.passes and dip.value == pytest.approx(100.0) and "a stop" in dip.where


def test_a_dip_that_no_time_tells_does_not_pass(tmp_path: Path) -> None:
    job, text = written("ABB IRB 120", tmp_path, constant_speed=True, max_dip=0.5)
    untimed = re.sub(r"(?m)^( *)MoveL", r"\1AccSet 50,50;\n\1MoveL", text, count=1)
    check = checked(job, without_header(untimed), tmp_path)
    assert not check.passes
    assert "no times" in check.verdict


def test_a_speed_in_place_of_a_time_counts(tmp_path: Path) -> None:
    job, text = written("ABB IRB 120", tmp_path)
    moves = list(re.finditer(r"v1000\\T:=[\d.]+", text))
    middle = moves[len(moves) // 2]
    fast = without_header(text[: middle.start()] + "v5000" + text[middle.end() :])
    check = checked(job, fast, tmp_path)
    assert not check.passes and "feed" in check.verdict
    own = np.linalg.norm(np.diff([w.translation() for w in job.task.waypoints], axis=0), axis=1)
    assert own.max() < 5.0 * job.task.durations[1]  # which is far below 5 m/s


@pytest.mark.parametrize("faster", [1.0, 1.006, 1.015])
def test_a_feed_that_is_a_little_too_fast_counts_over_many_waypoints(
    script: tuple[Job, str], faster: float, tmp_path: Path
) -> None:
    """Between two waypoints 2 % would not, since their times are searched."""
    job, text = script
    scaled = re.sub(
        r"(?<= v=)0\.0[89]\d+|(?<= v=)0\.1\d+", lambda m: f"{faster * float(m[0]):.6f}", text
    )
    check = checked(job, without_header(scaled), tmp_path)
    (feed,) = (finding for finding in check.findings if finding.name == "feed")
    assert feed.passes == check.passes == (faster == 1.0), check.verdict
    if not feed.passes:
        assert feed.value == pytest.approx(100.0 * faster, abs=0.15) and feed.limit is not None
        first, last = map(int, re.findall(r"\d+", feed.where))
        assert feed.limit == pytest.approx(100.0 + min(2.0, max(4.0 / (last - first), 0.2)))


def test_data_of_the_file_hide_those_of_the_system(tmp_path: Path) -> None:
    """``v100`` is 0.1 m/s, the feed, and ``z0`` no stop, unless the module has others."""
    job, text = written("ABB IRB 120", tmp_path)
    moves = list(re.finditer(r"v1000\\T:=[\d.]+", text))
    middle = moves[len(moves) // 2]
    named = without_header(f"{text[: middle.start()]}v100{text[middle.end() :]}")
    assert checked(job, named, tmp_path).passes
    own = named.replace("  PROC", "  CONST speeddata v100:=[5000,500,5000,1000];\n  PROC", 1)
    check = checked(job, own, tmp_path)
    assert not check.passes and "feed" in check.verdict
    own = named.replace("  PROC", "  CONST zonedata z0:=[TRUE,0,0,0,0,0,0];\n  PROC", 1)
    checked(job, own, tmp_path)
    back = read_trajectory(tmp_path / "changed.mod", joints=job.joints)
    assert len(back.stops) == 1 + len(moves) and ",z0," in own


def test_a_number_where_the_header_has_values_is_refused(tmp_path: Path) -> None:
    job = job_of("KUKA KR 16-2", length=0.03, count=16)
    path = tmp_path / "wave.src"
    write_checked(job.rows, path, job.task, job.joints, linear=LinearMotion(points="poses"))
    text = path.read_text()
    for pattern, put in ((r"(?m)^LIN", "BAS(#BASE,3)\nLIN"), (r"(?<=\$TOOL=).*", "TOOL_DATA[4]")):
        with pytest.raises(
            qt.InvalidInput, match=r"the header says (frame: none.* 3|tool: none.* 4);"
        ):
            checked(job, re.sub(pattern, put, text, count=1), tmp_path)


def test_jerks_that_a_controller_makes_are_named(tmp_path: Path) -> None:
    job, text = written("ABB IRB 120", tmp_path)
    limited = dataclasses.replace(job.task, jerk_limits=np.full(6, 1000.0))
    check = checked(job._replace(task=limited), text, tmp_path)
    assert check.passes and "joint jerks not checked" in check.verdict


def test_a_start_beside_the_path_is_no_approach_unless_the_header_says_so(
    script: tuple[Job, str], tmp_path: Path
) -> None:
    """The first axis is 2 mrad, some 1.5 mm, off; a point later the tool is at waypoint 1."""
    job, text = script
    first = re.search(r"  movej\(\[([-\d.]+)", text)
    assert first
    off = text[: first.start(1)] + f"{float(first[1]) + 0.002:.10f}" + text[first.end(1) :]
    check = checked(job, off, tmp_path)
    assert not check.passes and "rows beside the path" in check.verdict
    alone = checked(job, without_header(off), tmp_path)
    assert "before the first waypoint: judged for limits" in "; ".join(alone.unchecked)


def test_an_exported_approach_is_stated(script: tuple[Job, str], tmp_path: Path) -> None:
    rows, path = script[0].rows, tmp_path / "approach.script"
    assert rows.times is not None
    above = np.vstack([rows.q[0] + 0.01, rows.q])
    approach = TimedPath(rows.joint_names, above, np.append(0.0, 0.5 + rows.times))
    check, done = write_checked(approach, path, script[0].task, script[0].joints)
    assert done and check.passes, check.verdict
    assert "# beside: before the first waypoint" in path.read_text()
    assert checked(script[0], path.read_text(), tmp_path).passes


def test_a_misspelled_attribute_is_named(tmp_path: Path) -> None:
    job, text = written("Fanuc LR Mate 200iD", tmp_path)
    number = 1 + text[: text.index("DEFAULT_GROUP")].count("\n")
    check = checked(job, text.replace("DEFAULT_GROUP", "DEFAULT_GRUOP"), tmp_path)
    assert f"DEFAULT_GRUOP under /ATTR, line {number}, is not known" in check.notes
    assert "/ATTR" not in "; ".join(checked(job, text, tmp_path).notes)


def test_a_move_that_stands_where_nothing_runs_is_refused(tmp_path: Path) -> None:
    job, text = written("Fanuc LR Mate 200iD", tmp_path)
    lines = text.replace("/MN\n", "/APPL\n  AUTO_SINGULARITY_HEADER;\n/MN\n").split("\n")
    assert checked(job, "\n".join(lines), tmp_path).passes
    move = next(line for line in lines if ":L P[5]" in line)
    for above in ("/PROG", "/ATTR", "OWNER", "TCD", "CONTROL_CODE", "/APPL", "/POS", "P[7]{"):
        at = 1 + next(k for k, line in enumerate(lines) if line.startswith(above))
        for pasted in (move, move.partition(":")[2], " 12:  UTOOL_NUM=9 ;"):
            with pytest.raises(qt.InvalidInput, match=r"stands under|is left|not read"):
                checked(job, "\n".join([*lines[:at], pasted, *lines[at:]]), tmp_path)


def least_acceleration(*, to_rest: bool) -> float:
    """Of all accelerations, constant on 200 pieces, from rest over a way of 1 in a time of 1."""
    middles = (np.arange(200) + 0.5) / 200
    bounds = np.vstack([np.eye(200), -np.eye(200)])
    ends = np.vstack([1.0 - middles, np.ones(200)]) / 200  # the way, and the speed at the end
    keep = 2 if to_rest else 1
    found = linprog(
        np.append(np.zeros(200), 1.0), np.hstack([bounds, np.full((400, 1), -1.0)]), np.zeros(400),
        np.hstack([ends, np.zeros((2, 1))])[:keep], np.array([1.0, 0.0])[:keep],
        bounds=(None, None),
    )  # fmt: skip
    return float(found.fun)


@pytest.fixture(scope="module")
def joint_moves(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, str]:
    """With a call in the middle of the path, where the robot stops."""
    job = job_of("ABB IRB 120", length=0.1, count=51, acceleration=10.0)
    process = {"process": ((25, "SPINDL/ON"),), "calls": {"SPINDL/ON": "SpindleOn"}}
    job = job._replace(task=dataclasses.replace(job.task, **process))
    path = tmp_path_factory.mktemp("moves") / "wave.mod"
    check, done = write_checked(job.rows, path, job.task, job.joints)
    assert done and check.passes, check.verdict
    return job, path.read_text()


@pytest.mark.parametrize("stops", ["at all points", "at the ends"])
def test_joint_moves_that_are_too_short_for_their_stops_do_not_pass(
    joint_moves: tuple[Job, str], stops: str, tmp_path: Path
) -> None:
    job, text = joint_moves
    lines = without_header(text).split("\n")
    moves = [k for k, line in enumerate(lines) if "MoveAbsJ" in line]
    if stops == "at the ends":  # as if the ramp from rest had been lost
        lines = [line for k, line in enumerate(lines) if k not in moves[1:12]]
    text = "\n".join(lines).replace("SpindleOn;", "! none")
    text = text.replace(",z0,", ",fine,") if stops == "at all points" else text
    lines = [line for line in text.split("\n") if "MoveAbsJ" in line]
    angles = [re.search(r"\[\[([^\]]*)\]", line)[1].split(",") for line in lines]  # type: ignore[index]
    ways = np.abs(np.diff(np.radians(np.array(angles, dtype=float)), axis=0)).max(axis=1)
    times = np.array([float(each) for each in re.findall(r"T:=([\d.]+)", text)])
    rests = np.array(["fine" in line for line in lines]).astype(int)
    least = np.array([0.0, *(least_acceleration(to_rest=each) for each in (False, True))])
    expected = least[rests[:-1] + rests[1:]] * ways / times**2
    check = checked(job, text, tmp_path)
    (found,) = (each for each in check.findings if each.name == "accelerations at stops, at least")
    assert not found.passes and found.value == pytest.approx(10.0 * expected.max(), rel=1e-6)
    line = 1 + text.split("\n").index(lines[1 + int(np.argmax(expected))])
    assert f"line {line}, {times[np.argmax(expected)]:.4g} s: it takes longer" in found.where
    assert found.name in check.verdict


@pytest.mark.parametrize("wait", [r"WaitTime \InPos,0;", r"WaitRob \InPos;", "WaitRob\\ZeroSpeed;"])
def test_a_wait_until_the_robot_rests_is_a_stop(
    joint_moves: tuple[Job, str], wait: str, tmp_path: Path
) -> None:
    """As if the zone of the point were ``fine``, which the simulator reads."""
    job, text = joint_moves[0], joint_moves[1].replace("SpindleOn;", "! none")
    move = list(re.finditer(r"(?m)^.*\\T:=.*z0.*\n", text))[7]
    fine = text[: move.start()] + move[0].replace("z0", "fine") + text[move.end() :]
    found = checked(job, f"{text[: move.end()]}    {wait}\n{text[move.end() :]}", tmp_path)
    stops = [k for k, each in enumerate(read(fine, ".mod").moves[:-1]) if each.zone == 0.0]
    assert not found.passes and "accelerations at stops" in found.verdict
    back = read_trajectory(tmp_path / "changed.mod", joints=job.joints)
    assert [*back.stops[:-1]] == stops and 8 in stops and back.times is not None


def test_a_step_of_the_controller_is_a_stop(script: tuple[Job, str], tmp_path: Path) -> None:
    job, text = script
    moves = list(re.finditer(r"(?m)^  move.*\n", text))
    path = tmp_path / "synchronous.script"
    path.write_text(f"{text[: moves[8].end()]}  sync()\n{text[moves[8].end() :]}")
    back = read_trajectory(path, joints=job.joints)
    assert back.points is not None and back.points[8] in back.stops and back.times is not None


def test_a_move_in_no_time_is_refused_with_its_line(
    script: tuple[Job, str], tmp_path: Path
) -> None:
    job, text = script
    lines = without_header(text).split("\n")
    k = [k for k, line in enumerate(lines) if "movel(" in line or "movep(" in line][20]
    twice = "\n".join([*lines[: k + 1], *lines[k:]])
    with pytest.raises(qt.InvalidInput, match=rf"changed\.script, line {k + 2}: the move takes no"):
        checked(job, twice, tmp_path)
    for t in ("-1", "1e20"):
        target = lines[k][: lines[k].index("]") + 1]
        timed = "\n".join([*lines[:k], f"{target}, t={t})", *lines[k + 1 :]])
        at = k + 1 if t == "-1" else k + 2  # the next move is lost in the digits
        with pytest.raises(qt.InvalidInput, match=rf"line {at}: the move takes (-1 s|no)"):
            checked(job, timed, tmp_path)


def test_what_no_move_uses_passes(script: tuple[Job, str], tmp_path: Path) -> None:
    job, text = script
    k = text.index("\n", text.index("  move", text.index("  move") + 1))
    assert checked(job, f"{text[:k]}\n  x = 3{text[k:]}", tmp_path).passes
    other = text.replace("# task: ", "# task: another ")
    assert any("'another " in note for note in checked(job, other, tmp_path).notes)
    job, text = written("Fanuc LR Mate 200iD", tmp_path)
    with pytest.raises(qt.InvalidInput, match="the header says tool: 3, but here it is 5"):
        checked(
            job, re.sub(r"\bUT : 3|(?<=UTOOL_NUM=)3", lambda m: m[0][:-1] + "5", text), tmp_path
        )
    done = write_checked(job.rows, tmp_path / "joints.ls", job.task, job.joints)[1]
    joints = (tmp_path / "joints.ls").read_text()
    assert done and "UT : 1" in joints
    assert checked(job, joints.replace("UT : 1", "UT : 5"), tmp_path).passes

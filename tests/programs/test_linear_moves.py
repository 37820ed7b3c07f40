"""Straight moves of the tool: written through few points, followed by inverse kinematics."""

from __future__ import annotations

import dataclasses
import itertools
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.programs import DIALECTS
from qp_twist.robots import ControllerJoints
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories import (
    TimedPath,
    check_trajectory,
    joints_of,
    read_trajectory,
    write_checked,
    write_trajectory,
)
from qp_twist.trajectories.linear_moves import LinearMotion

NUMBER = r"-?\d+\.\d+"


def pose(model: mujoco.MjModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return data.site("tool").xpos.copy(), data.site("tool").xmat.reshape(3, 3).copy()


def points_of(program: str, text: str) -> tuple[np.ndarray, list[bool]]:
    """The model's angles at each point, rad, and whether the move to it is straight."""
    if program == "ls":
        rows = [re.findall(rf"J\d= ({NUMBER})", p) for p in re.findall(r"\{(.*?)\};", text, re.S)]
        straight = [word == "L" for word in re.findall(r":([JL]) P\[", text)]
    else:
        moves = re.findall(r"(MoveAbsJ|MoveL CalcRobT\() ?\[\[(.*?)\],", text)
        rows, straight = [m[1].split(",") for m in moves], ["MoveL" in m[0] for m in moves]
    q = np.radians(np.array(rows, dtype=float))
    if program == "ls":
        q[:, 2] += q[:, 1]  # the forearm's angle to the floor
    return q, straight


@pytest.fixture(scope="module")
def motion() -> tuple[qt.PathTask, TimedPath]:
    task = qt.load_task("deburring").part(slice(0, 101))
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    return task, TimedPath.of(qt.time_trajectory(trajectory))


def joints_for(program: str, motion: tuple[qt.PathTask, TimedPath]) -> ControllerJoints:
    return joints_of(motion[0], motion[1].joint_names, as_modelled=program != "ls")


@pytest.mark.parametrize("program", ["ls", "rapid"])
def test_the_tool_keeps_the_path_on_straight_lines_through_few_points(
    program: str, motion: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> None:
    task, rows = motion
    path = tmp_path / f"line{DIALECTS[program].suffix}"
    check, written = write_checked(
        rows, path, task, joints_for(program, motion), linear=LinearMotion(3)
    )
    assert written and check.passes, check.verdict
    assert re.search(r"\d+ straight moves of tool ?3: its TCP", "; ".join(check.notes))
    text = path.read_text()
    assert ("UTOOL_NUM=3 ;" in text and "UT : 3," in text) if program == "ls" else "tool3)" in text
    q, straight = points_of(program, text)
    assert sum(straight) == len(q) - 1 < 0.7 * len(rows.q)
    # Lines and turns by scipy between MuJoCo's poses; the path by its waypoints.
    poses = [pose(task.model, each) for each in q]
    places = np.array([w.translation() for w in task.waypoints])
    axes = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])
    begin, ways = places[:-1], np.diff(places, axis=0)
    for (p, R), (p_next, R_next) in itertools.pairwise(poses):
        turns = Slerp([0.0, 1.0], Rotation.from_matrix([R, R_next]))
        for share in np.linspace(0.0, 1.0, 6):
            at = (1.0 - share) * p + share * p_next
            along = np.clip(((at - begin) * ways).sum(axis=1) / (ways**2).sum(axis=1), 0.0, 1.0)
            off = np.linalg.norm(at - begin - along[:, None] * ways, axis=1)
            k = int(np.argmin(off))
            axis = (1.0 - along[k]) * axes[k] + along[k] * axes[k + 1]
            turned = turns(share).as_matrix()[:, 2]
            assert off[k] <= 1e-4
            assert np.linalg.norm(np.cross(axis / np.linalg.norm(axis), turned)) <= np.radians(0.05)


def test_the_joints_follow_straight_lines_on_their_branch() -> None:
    task = qt.load_task("deburring")
    joints = joints_of(task, qt.JointRanges.of(task.model).names)
    assert joints.tool is not None
    rng, done = np.random.default_rng(0), 0
    low, high = task.model.jnt_range.T
    data = mujoco.MjData(task.model)

    def determinant(q: np.ndarray) -> float:
        data.qpos[:] = q
        mujoco.mj_forward(task.model, data)
        J = np.zeros((6, task.model.nv))
        mujoco.mj_jacSite(task.model, data, J[:3], J[3:], data.site("tool").id)
        return float(np.linalg.det(J))

    for _ in range(40):
        begin = rng.uniform(0.6 * low, 0.6 * high)
        end = begin + rng.uniform(-0.3, 0.3, 6)
        try:
            here, there = (
                Poses(*(each[0] for each in joints.tool.poses(q[None]))) for q in (begin, end)
            )
            shares, rows = joints.tool.towards(begin, end, ToolMove.between(here, there).at)
        except qt.InvalidInput as refusal:
            # Then the branches differ, or the line leads close to a singularity.
            assert re.search("singularity|another configuration", str(refusal))
            continue
        done += 1
        assert (np.diff(shares) > 0.0).all() and shares[[0, -1]].tolist() == [0.0, 1.0]
        assert np.abs(np.diff(rows, axis=0)).max() <= np.radians(0.25) + 1e-12
        assert len({determinant(q) > 0.0 for q in rows}) == 1
        (p, R), (p_end, R_end) = pose(task.model, begin), pose(task.model, end)
        turns = Slerp([0.0, 1.0], Rotation.from_matrix([R, R_end]))
        middles = 0.5 * (shares[:-1] + shares[1:]), 0.5 * (rows[:-1] + rows[1:])
        for (at, q), most in [
            *((each, 1e-8) for each in zip(shares, rows, strict=True)),
            *((each, 2e-5) for each in zip(*middles, strict=True)),
        ][:: max(1, len(rows) // 10)]:
            place, turned = pose(task.model, q)
            assert np.abs(place - (1.0 - at) * p - at * p_end).max() <= most
            assert np.abs(turned - turns(at).as_matrix()).max() <= most
    assert done >= 20


def test_changed_straight_moves_are_refused_or_fail(
    motion: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> None:
    task, rows = motion
    joints = joints_for("ls", motion)
    path = tmp_path / "line.ls"
    write_checked(rows, path, task, joints, linear=LinearMotion(1))
    text = path.read_text()
    place = text.index(f"P[{len(re.findall('P.[0-9]+.{', text)) // 2}]{{")
    values = list(re.finditer(rf"J([456])= ({NUMBER}) deg", text[place:]))[:3]
    shown = [float(value[2]) for value in values]

    def with_values(new: list[float]) -> str:
        changed = text[place:]
        for value, number in zip(reversed(values), reversed(new), strict=True):
            changed = f"{changed[: value.start(2)]}{number:.4f}{changed[value.end(2) :]}"
        return text[:place] + changed

    # The other wrist: the same pose, so that the tool would be on its line.
    other = [shown[0] - np.sign(shown[0]) * 180.0, -shown[1], shown[2] - np.sign(shown[2]) * 180.0]
    for changed, words in (
        (with_values(other), "another configuration|singularity"),
        (text.replace("J P[1] 10% FINE", "L P[1] 10msec FINE"), "a joint move first"),
        (text.replace("UT : 1", "UT : 2", 2).replace("UT : 2", "UT : 1", 1),
         r"P\[2\] has UT : 2, but UTOOL_NUM.* has 1"),
        (re.sub(r"(L P\[5\]) \w+/\w+", r"\1 20%", text), "L is not read"),
    ):  # fmt: skip
        path.write_text(changed)
        with pytest.raises(qt.InvalidInput, match=words) as refusal:
            read_trajectory(path, None, joints)
        assert "line" in str(refusal.value)
    path.write_text(with_values([shown[0], shown[1] + 0.5, shown[2]]))
    assert not check_trajectory(read_trajectory(path, None, joints), task).passes
    path.write_text(text)
    with pytest.raises(qt.InvalidInput, match="read with the task of the robot"):
        read_trajectory(path, None, dataclasses.replace(joints, tool=None))
    with pytest.raises(qt.InvalidInput, match="straight moves need a trajectory with times"):
        write_checked(
            dataclasses.replace(rows, times=None),
            path,
            task,
            joints,
            linear=LinearMotion(1),
            force=True,
        )
    modelled = joints_for("krl", motion)
    for suffix, words in (
        (".src", r"as modelled there are only joint angles"),
        (".script", r"URScript has no tools by number"),
    ):
        with pytest.raises(qt.InvalidInput, match=words):
            write_checked(rows, path.with_suffix(suffix), task, modelled, linear=LinearMotion(1))
    module = write_trajectory(rows, path.with_suffix(".mod"), modelled)
    assert "MoveL" not in module.read_text()


def test_linear_moves_on_the_command_line(
    motion: tuple[qt.PathTask, TimedPath], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, rows = motion
    way = write_trajectory(rows, tmp_path / "way.csv")
    words = ["export", str(way), "deburring", "--to", "ls", "--motion", "linear"]
    with pytest.raises(SystemExit):  # a fourth of the path
        main([*words, "--tool-number", "2", "--force"])
    assert "UTOOL_NUM=2" in (tmp_path / "way.ls").read_text()
    capsys.readouterr()
    for extra, sentence in (
        (["--motion", "circular"], "expected one of joint, linear"),
        (["--motion", "linear", "--to", "mcap"], "are for programs"),
        (["--motion", "linear", "--tool-number", "0", "--to", "ls"], "a --tool-number from 1"),
        (["--tool-number", "3", "--to", "ls"], "--tool-number is of --motion linear"),
    ):
        with pytest.raises(SystemExit):
            main(["export", str(way), "deburring", *extra])
        assert sentence in capsys.readouterr().err

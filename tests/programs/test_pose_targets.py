"""Straight moves to poses with configuration data: written, simulated here, read, and refused."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.data_sheets import about, data_of, links
from oracles.pose_programs import (
    ROBOTS,
    Case,
    N,
    case_of,
    corrected,
    krl_frame,
    on_path,
    rigid,
    site_of,
    two_angles,
)
from oracles.program_simulator import read
from scipy.spatial.transform import Rotation, Slerp

import qp_twist as qt
from qp_twist.programs import DIALECTS
from qp_twist.programs.krl_values import pose_text
from qp_twist.trajectories import (
    check_trajectory,
    read_trajectory,
    write_checked,
)
from qp_twist.trajectories.linear_moves import LinearMotion

Array = np.ndarray


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    return {name: case_of(name) for name in ROBOTS}


@pytest.mark.parametrize(("name", "number"), [*zip(ROBOTS, (None, 2, None, 2), strict=True)])
def test_a_controller_keeps_the_path_and_the_branch(
    name: str, number: int | None, cases: dict[str, Case], tmp_path: Path
) -> None:
    task, rows, joints, _ = cases[name]
    path = tmp_path / f"loop{cases[name].suffix}"
    linear = LinearMotion(number, None if number is None else 7, "poses")
    check, done = write_checked(rows, path, task, joints, linear=linear)
    assert done and check.passes, check.verdict
    text = path.read_text()
    found = read(text, path.suffix)
    first, *moves = found.moves
    assert first.theta is not None and len(moves) < 0.75 * len(rows.q)
    assert ("wobj7" in text or "BASE_DATA[7]" in text) == (number is not None)
    # The controller's base and flange by the data sheet, the tool's place by MuJoCo.
    model, data = task.model, mujoco.MjData(task.model)
    assert joints.arm is not None
    signs, offsets = joints.signs, joints.offsets

    def put(theta: Array) -> None:
        data.qpos[:] = (np.radians(theta) - offsets) * signs
        mujoco.mj_forward(model, data)

    put(first.theta)
    base = rigid(data.body("base").xmat.reshape(3, 3), data.body("base").xpos)
    own_tool = np.linalg.inv(base @ links(name, first.theta)[-1]) @ site_of(data)
    tool = own_tool if found.tool is None else found.tool
    frame = np.linalg.inv(base) if found.frame is None else found.frame
    assert np.abs(tool - own_tool).max() < 1e-6
    at, theta, whole = site_of(data), first.theta, 0.0
    for move in moves:
        v, w = move.speeds
        end = base @ frame @ move.pose @ np.linalg.inv(tool) @ own_tool
        turn = Rotation.from_matrix(at[:3, :3].T @ end[:3, :3]).magnitude()
        seconds = max(np.linalg.norm(end[:3, 3] - at[:3, 3]) / v, turn / w)
        whole += seconds
        shares = np.linspace(0.0, 1.0, 1 + int(np.ceil(seconds / 1e-3)))
        slerp = Slerp([0.0, 1.0], Rotation.from_matrix([at[:3, :3], end[:3, :3]]))
        turns = slerp(shares).as_matrix()
        others = [two_angles(at[:3, :3], end[:3, :3], shares[::20], axis) for axis in np.eye(3)]
        points = at[:3, 3] + shares[:, None] * (end[:3, 3] - at[:3, 3])
        wanted = on_path(task, points)
        for each, of in [(turns, wanted), *((o, wanted[::20]) for o in others if "KUKA" in name)]:
            assert np.linalg.norm(np.cross(of, each[:, :, 2]), axis=1).max() <= np.radians(0.05)
        for point, R in zip(points[1:], turns[1:], strict=True):
            corrected(model, data, point, R, steps=5)
            step = np.degrees(signs * data.qpos + offsets)
            assert np.abs(step - theta).max() < 0.5  # in a millisecond
            theta = step
        assert data_of(name, theta) == move.data
        at = end
    stated = re.search(rf"seconds: ({N})", text)
    assert stated and whole == pytest.approx(float(stated[1]), rel=1e-4)
    # As long as planned, but for moves that take a whole period of the controller.
    longer = re.search(r"(\d+) moves longer: none is below the controller's (\d+) ms", text)
    more = int(longer[1]) * 1e-3 * int(longer[2]) if longer else 0.0
    assert -1e-3 <= whole / rows.times[-1] - 1.0 <= 1e-3 + more / rows.times[-1]  # type: ignore[index]
    assert moves[-1].zone == 0.0 < max(move.zone for move in moves)


def test_programs_of_others_with_poses(cases: dict[str, Case], tmp_path: Path) -> None:
    """Joint moves to poses, named targets, frames of the file and offsets are read, too."""
    for name, program in (("ABB IRB 120", rapid_text), ("KUKA KR 16-2", krl_text)):
        joints = cases[name].joints
        theta = np.array(ROBOTS[name])
        flange = links(name, theta)[-1]
        path = tmp_path / f"other{cases[name].suffix}"
        path.write_text(program(flange, data_of(name, theta)))
        back = read_trajectory(path, None, joints)
        shown = np.degrees(joints.shown(back.q))
        assert shown[0] == pytest.approx(theta, abs=2e-3)
        end = links(name, shown[-1])[-1]
        moved = flange[:3, :3] @ np.array([0.0, 0.0, 0.0]) + np.array([0.0, 0.02, 0.01])
        assert end[:3, 3] - flange[:3, 3] == pytest.approx(moved, abs=1e-6)
        assert end[:3, :3] == pytest.approx(flange[:3, :3], abs=1e-6)
        assert back.times is not None
        assert back.times[-1] == pytest.approx(np.hypot(0.02, 0.01) / 0.05)
        assert "where the program states it" in "; ".join(back.notes)


def rapid_text(flange: Array, data: tuple[int, ...]) -> str:
    tool = about("x", 30.0)
    tool[:3, 3] = 0.01, 0.02, 0.1
    frame = about("z", 40.0)
    frame[:3, 3] = 0.1, -0.2, 0.3
    at = np.linalg.inv(frame) @ flange @ tool

    def text(pose: Array) -> str:
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        values = ",".join(f"{1e3 * each:.6f}" for each in pose[:3, 3])
        return f"[{values}],[{w:.9f},{x:.9f},{y:.9f},{z:.9f}]"

    turned = np.linalg.inv(frame)[:3, :3] @ np.array([0.0, 20.0, 10.0])
    offset = ",".join(f"{each:.6f}" for each in turned)
    return f"""MODULE other
PERS tooldata gun:=[TRUE,[{text(tool)}],[1,[0,0,50],[1,0,0,0],0,0,0]];
TASK PERS wobjdata jig:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[{text(frame)}]];
CONST robtarget p1:=[{text(at)},{list(data)},[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST speeddata slow:=[50,500,5000,1000];
PROC main()
  ConfL\\On;
  MoveJ p1,v100,fine,gun\\WObj:=jig;
  MoveL Offs(p1,{offset}),slow,fine,gun\\WObj:=jig;
ENDPROC
ENDMODULE
"""


def krl_text(flange: Array, data: tuple[int, ...]) -> str:
    tool = about("x", 30.0)
    tool[:3, 3] = 0.01, 0.02, 0.1
    frame = about("z", 40.0)
    frame[:3, 3] = 0.1, -0.2, 0.3
    at = np.linalg.inv(frame) @ flange @ tool

    def text(pose: Array, more: str = "") -> str:
        a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
        x, y, z = 1e3 * pose[:3, 3]
        return f"{{X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.8f},B {b:.8f},C {c:.8f}{more}}}"

    moved = at.copy()
    moved[:3, 3] += np.linalg.inv(frame)[:3, :3] @ np.array([0.0, 0.02, 0.01])
    return f"""DEF other( )
TOOL_DATA[3]={text(tool)}
BASE_DATA[2]={text(frame)}
BAS(#TOOL,3)
BAS(#BASE,2)
$VEL.CP=0.05
PTP {text(at, f",S {data[0]},T {data[1]}")}
LIN {text(moved)}
END
"""


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("ABB IRB 120", (r"MoveL (.*?)\],\[0,0,0,0\]", r"MoveL \1],[0,0,0,1]"),
         r"line \d+: the robot arrives with the configuration \[0, 0, 0, 0\], .* \[0, 0, 0, 1\]"),
        ("ABB IRB 120", (r"\[0,0,0,0\],\[9E9", "[0,0,0.5,0],[9E9"), "expected whole numbers cf1"),
        ("ABB IRB 120", (r"MoveL \[\[(\d+\.\d)", r"MoveL [[\g<1>%9"), "no expression of RAPID"),
        ("ABB IRB 120", ("MoveL ", "MoveC "), r"line \d+: .*expected 2 targets"),
        ("ABB IRB 120", (r"tooldata task_tool:=\[TRUE", "tooldata task_tool:=[FALSE"),
         "carries the part"),
        ("ABB IRB 120", (r"wobj:=\[FALSE,TRUE", "wobj:=[FALSE,FALSE"),
         r"line \d+: the tool moves straight on a part that a positioner moves; .* stands still"),
        ("ABB IRB 120", (r"fine,task_tool\\", r"fine,task_tool\\Corr\\"), "no other arguments"),
        ("ABB IRB 120", (r"MoveAbsJ.*\n", ""), "a joint move first"),
        ("KUKA KR 16-2", ("S 2,T 2}", "S 2,T 3}"), r"line \d+: the robot arrives with .*\[2, 2\]"),
        ("KUKA KR 16-2", ("S 2,T 2}", "S 2}"), "both S and T"),
        ("KUKA KR 16-2", ("LIN ", "CIRC "), "expected one target|CIRC is not read"),
        ("KUKA KR 16-2", (r"C_DIS\n", "C_DIS WITH $VEL.CP=1\n"), "WITH"),
        ("KUKA KR 16-2", (r"C_DIS\n", "C_DI\n"), "C_DI is none of C_DIS"),
        ("KUKA KR 16-2", (r"(LIN {X -?\d+\.\d)\d", r"\1$"), "number as the language writes it"),
        ("KUKA KR 16-2", (r"(LIN {X )(-?\d+\.\d+)", r"\1'\2'"), "number as the language writes it"),
        ("ABB IRB 120", (r"MoveL \[\[(-?\d+\.\d+)", r"MoveL [['\1'"), "number as the language"),
        ("KUKA KR 16-2", (r"\$VEL\.CP=0\.0\d+\n", ""), "how fast|seconds|no time"),
        ("ABB IRB 120", (r"  LOCAL PERS tooldata.*\n", ""), "does not state the pose of task_tool"),
        ("ABB IRB 120", (r"wobj:=\[FALSE,TRUE,", "wobj:=[FALSE,"), "pose of task_wobj"),
        ("KUKA KR 16-2", (r"(?m)^\$TOOL=.*\n", ""), "expected .TOOL and .BASE before it"),
        ("KUKA KR 16-2", (r"(?m)^\$BASE=.*\n", ""), "expected .TOOL and .BASE before it"),
        ("KUKA KR 16-2", (r"(?s)^(.*LIN [^B]*),B ", r"\1,B1 "), "b1 is no component"),
        ("KUKA KR 16-2", ("ORI_TYPE=#VAR", "ORI_TYPE=#CONSTANT"), "CONSTANT.*are not read"),
        ("KUKA KR 16-2", ("IPO_MODE=#BASE", "IPO_MODE=#TCP"), "TCP.*straight moves are not read"),
        ("KUKA KR 16-2", (r"\$BASE=\{X ", "$BASE={Y 1,X "), "stands twice|expected .X"),
        ("KUKA KR 16-2", (r"\$ORI", "BASE_DATA[I]={X 0,Y 0,Z 0,A 0,B 0,C 0}\n$ORI"), "BASE_DATA"),
        ("KUKA KR 16-2", (r"LIN .*\n", "LIN_REL {X 1}\n"), "LIN_REL"),
    ],
)  # fmt: skip
def test_what_is_refused(
    name: str, change: tuple[str, str], words: str, cases: dict[str, Case], tmp_path: Path
) -> None:
    task, rows, joints, _ = cases[name]
    path = tmp_path / f"loop{cases[name].suffix}"
    write_checked(rows, path, task, joints, linear=LinearMotion(points="poses"))
    text = path.read_text()
    changed = re.sub(change[0], change[1], text, count=1)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, joints)


def test_changed_values_fail(cases: dict[str, Case], tmp_path: Path) -> None:
    for name, change in (
        ("ABB IRB 120", (r"wobjdata task_wobj:=\[FALSE,TRUE,\"\",\[\[", r"\g<0>1")),
        ("KUKA KR 16-2", (r"\$TOOL=\{X ", r"\g<0>1")),
    ):
        task, rows, joints, _ = cases[name]
        path = tmp_path / f"loop{cases[name].suffix}"
        write_checked(rows, path, task, joints, linear=LinearMotion(points="poses"))
        text = path.read_text()
        path.write_text(re.sub(change[0], change[1], text, count=1))
        try:
            assert not check_trajectory(read_trajectory(path, None, joints), task).passes
        except qt.InvalidInput as refusal:
            assert re.search("configuration|out of reach|seconds", str(refusal))
        path.write_text(text)
        with pytest.raises(qt.InvalidInput, match="known robots"):
            read_trajectory(path, None, dataclasses.replace(joints, arm=None))


def test_options_that_do_not_fit(cases: dict[str, Case], tmp_path: Path) -> None:
    task, rows, joints, _ = cases["KUKA KR 16-2"]
    with pytest.raises(qt.InvalidInput, match="straight moves to joints are not written in KRL"):
        write_checked(rows, tmp_path / "a.src", task, joints, linear=LinearMotion(points="joints"))
    task, rows, joints, _ = cases["ABB IRB 120"]
    with pytest.raises(qt.InvalidInput, match="of points that are poses"):
        write_checked(rows, tmp_path / "a.mod", task, joints, linear=LinearMotion(frame=2))
    assert DIALECTS["rapid"].points == ("joints", "poses")


def test_joint_moves_between_straight_ones(cases: dict[str, Case], tmp_path: Path) -> None:
    """From one wave to the next the joints move: in KRL by a second spline with its times."""
    for name in ("ABB IRB 120", "KUKA KR 16-2"):
        task, rows, joints, _ = cases[name]
        away = rows.q[-1] + np.radians([3.0, -2.0, 2.0, 5.0, -5.0, 4.0])
        assert rows.times is not None
        times = rows.times[-1]
        back = rows.motion.at(times - 0.1).q
        way = dataclasses.replace(
            rows, q=np.vstack([rows.q, away, rows.q[-1], back]), velocities=None,
            times=np.append(rows.times, [times + 1.0, times + 2.0, times + 2.1]),
            accelerations=None,
        )  # fmt: skip
        waypoints = list(task.waypoints)
        for q in way.q[-3:]:
            place = mink.Configuration(task.model, q)
            waypoints.append(place.get_transform_frame_to_world("tool", "site"))
        longer = dataclasses.replace(
            task, waypoints=tuple(waypoints), joint_moves=(len(waypoints) - 3, len(waypoints) - 2),
            durations=np.append(task.durations, [1.0, 1.0, 0.1]),
        )  # fmt: skip
        path = tmp_path / f"twice{cases[name].suffix}"
        check, done = write_checked(way, path, longer, joints, linear=LinearMotion(1, 1, "poses"))
        assert done and check.passes, check.verdict
        text = path.read_text()
        back = read_trajectory(path, None, joints)
        assert np.abs(back.q - away).max(axis=1).min() < 1e-5
        if name.startswith("KUKA"):
            words = (
                r"^(PTP_SPLINE|TIME_BLOCK END = 2\.0000|SPTP|LIN)"  # the whole takes whole ticks
            )
            assert re.findall(words, text, re.M)[-5:] == [
                "PTP_SPLINE", "SPTP", "SPTP", "TIME_BLOCK END = 2.0000", "LIN"
            ]  # fmt: skip


@given(vector=st.tuples(*[st.floats(-4.0, 4.0)] * 3), bent=st.sampled_from([None, -90.0, 90.0]))
@settings(max_examples=200, deadline=None)
def test_a_position_of_krl_is_its_pose(
    vector: tuple[float, float, float], bent: float | None
) -> None:
    """By the matrices of the test, also where two of the angles turn about one axis."""
    turn = Rotation.from_rotvec(vector).as_matrix()
    if bent is not None:
        turn = (about("z", 30.0 * vector[0]) @ about("y", bent) @ about("x", 30.0 * vector[1]))[
            :3, :3
        ]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, vector
    back = krl_frame(pose_text(mink.SE3.from_matrix(pose)))
    assert np.abs(back[:3, :3] - turn).max() < 1e-7
    assert np.abs(back[:3, 3] - vector).max() < 1e-7

"""Straight moves of LS and URScript: simulated here as a controller moves, read, and refused."""

from __future__ import annotations

import dataclasses
import itertools
import re
from pathlib import Path
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import pytest
from oracles.data_sheets import about, data_of, links
from oracles.mounted_robots import mounted, timed_rows
from oracles.pose_programs import corrected, site_of
from oracles.ur_flange import flange_of
from scipy.spatial.transform import Rotation, Slerp

import qp_twist as qt
from qp_twist.robots import ControllerJoints, named_robot
from qp_twist.trajectories import (
    TimedPath,
    check_trajectory,
    read_trajectory,
    write_checked,
)
from qp_twist.trajectories.linear_moves import LinearMotion

Array = np.ndarray
N = r"-?\d+\.?\d*"
POSTURES = {
    "Fanuc LR Mate 200iD": (10.0, 10.0, -20.0, 20.0, -60.0, 20.0),
    "Fanuc M-20iA": (-20.0, 20.0, -10.0, -60.0, 40.0, 170.0),
    "Universal Robots UR5e": (10.0, -80.0, 100.0, -110.0, -80.0, 20.0),
    "Universal Robots UR10e": (-100.0, -120.0, 90.0, -50.0, 70.0, -150.0),
}
SPEED = {name: 0.06 if "UR10e" in name else 0.12 for name in POSTURES}


def flange(name: str, theta: Array) -> Array:
    """The flange in the controller's base, at θ, degrees."""
    return links(name, theta)[-1] if name.startswith("Fanuc") else flange_of(name, theta)


class Case(NamedTuple):
    """A task of a robot, its motion, and how its controller counts."""

    name: str
    task: qt.PathTask
    rows: TimedPath
    joints: ControllerJoints


def case_of(name: str) -> Case:
    """A round of 80 by 60 mm whose axis leans by up to 8°, and but for the UR10e a corner."""
    arm = mounted(name, POSTURES[name])
    waypoints, durations = [], [0.0]
    for angle in np.linspace(0.0, 1.5 * np.pi, 40):
        s, c = np.sin(angle), 1.0 - np.cos(angle)
        turn = mink.SO3.exp(np.radians(8.0) * np.array([s, 0.5 * c, 0.0]))
        move = np.array([0.04 * s, 0.03 * c, 0.0])
        waypoints.append(arm.start @ mink.SE3.from_rotation_and_translation(turn, move))
    ahead = (0.0, -1.0, 0.0) if "UR10e" in name else (-0.8, -0.6, 0.0)
    for share in np.linspace(0.0, 1.0, 11)[1:]:
        move = 0.05 * share * np.array(ahead)
        there = mink.SE3.from_rotation_and_translation(mink.SO3.identity(), move)
        waypoints.append(waypoints[39] @ there)
    places = np.array([w.translation() for w in waypoints])
    durations += (np.linalg.norm(np.diff(places, axis=0), axis=1) / SPEED[name]).tolist()
    task = arm.task("round", waypoints, np.array(durations))
    return Case(name, task, *timed_rows(task, name))


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    return {name: case_of(name) for name in POSTURES}


class Move(NamedTuple):
    """A move as the program has it: to θ, degrees, or a pose; a speed, m/s, or a time, s."""

    theta: Array | None
    pose: Array | None
    data: tuple[int, ...]
    speed: float
    seconds: float
    reach: float
    cnt: float
    constant: bool


def moves_of(text: str) -> list[Move]:
    """The moves of a program, read by expressions of the test's own; CNT in shares."""
    found = []
    if "/PROG" in text:
        points = dict(re.findall(r"^P\[(\d+)\]\{(.*?)\};", text, re.S | re.M))
        for number, how, end in re.findall(r":[JL] P\[(\d+)\] (\S+) (\w+) ;", text):
            values = dict(re.findall(rf"(\w+)= ({N}) ", points[number]))
            theta = pose = None
            data: tuple[int, ...] = ()
            if "J1" in values:
                theta = np.array([float(values[f"J{k}"]) for k in range(1, 7)])
                theta[2] += theta[1]
            else:
                x, y, z, w, p, r = (float(values[key]) for key in "XYZWPR")
                pose = about("z", r) @ about("y", p) @ about("x", w)
                pose[:3, 3] = 1e-3 * np.array([x, y, z])
                letters, *turns = re.search(r"CONFIG : '([^']*)'", points[number])[1].split(",")  # type: ignore[index]
                places = (each in "FDB" for each in letters.split())
                data = (*map(int, places), *map(int, turns))
            value = float(re.match(N, how)[0])  # type: ignore[index]
            unit = how.lstrip("0123456789.")
            speed = value * {"mm/sec": 1e-3, "cm/min": 1e-2 / 60.0}.get(unit, np.nan)
            seconds = value * {"msec": 1e-3, "sec": 1.0}.get(unit, np.nan)
            cnt = 0.0 if end == "FINE" else float(end[3:]) / 100.0
            found.append(Move(theta, pose, data, speed, seconds, np.nan, cnt, False))
        return found
    body = text[text.index("\n  end\n  start(") if "  start(" in text else 0 :]
    for word, angles, rest in re.findall(r"^  (move[jlp])\(\[(.*?)\](.*)\)$", body, re.M):
        theta = np.degrees([float(each) for each in angles.split(",")])
        given = {key: float(value) for key, value in re.findall(rf"(\w)=({N})", rest)}
        found.append(
            Move(theta, None, (), given.get("v", np.nan), given.get("t", np.nan),
                 given.get("r", 0.0), np.nan, word == "movep")
        )  # fmt: skip
    return found


def off_path(task: qt.PathTask, points: Array, axes: Array) -> tuple[float, float]:
    """How far points are from the path, m, and axes from its axes beside them, rad, at most."""
    places = np.array([w.translation() for w in task.waypoints])
    own = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])
    begin, ways = places[:-1], np.diff(places, axis=0)
    along = ((points[:, None] - begin) * ways).sum(axis=2) / (ways**2).sum(axis=1)
    along = np.clip(along, 0.0, 1.0)
    apart = np.linalg.norm(points[:, None] - begin - along[..., None] * ways, axis=2)
    k, rows = apart.argmin(axis=1), np.arange(len(points))
    u = along[rows, k][:, None]
    axis = (1.0 - u) * own[k] + u * own[k + 1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    sines = np.linalg.norm(np.cross(axis, axes), axis=1)
    return float(apart[rows, k].max()), float(np.arcsin(sines.max()))


def corners_of(case: Case, text: str, data: mujoco.MjData) -> list[Array]:
    """Poses of the tool at the points: base by MuJoCo, flange by the maker's lengths.

    The tool is where the first point has it; ``data`` is left there.
    """
    first, *moves = moves_of(text)
    assert first.theta is not None
    data.qpos[:] = (np.radians(first.theta) - case.joints.offsets) * case.joints.signs
    mujoco.mj_forward(case.task.model, data)
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = data.body("base").xmat.reshape(3, 3), data.body("base").xpos
    if case.name.startswith("Fanuc"):  # whose base is at the height of the second axis
        base[:3, 3] += base[:3, 2] * named_robot(case.name).lines[1].point[2]
    tool = np.linalg.inv(base @ flange(case.name, first.theta)) @ site_of(data)
    found = [site_of(data)]
    for move in moves:
        if move.theta is not None:
            found.append(base @ flange(case.name, move.theta) @ tool)
        else:
            assert move.pose is not None
            found.append(base @ move.pose)
    return found


def between(begin: Array, end: Array, count: int) -> tuple[Array, Array]:
    """Positions and rotations on a straight move."""
    shares = np.linspace(0.0, 1.0, count)
    turns = Slerp([0.0, 1.0], Rotation.from_matrix([begin[:3, :3], end[:3, :3]]))(shares)
    return begin[:3, 3] + shares[:, None] * (end[:3, 3] - begin[:3, 3]), turns.as_matrix()


WAYS = [
    ("Fanuc LR Mate 200iD", "joints"), ("Fanuc M-20iA", "joints"),
    ("Fanuc LR Mate 200iD", "poses"), ("Fanuc M-20iA", "poses"),
    ("Universal Robots UR5e", "joints"), ("Universal Robots UR10e", "joints"),
]  # fmt: skip


WRITTEN: dict[tuple[str, ...], str] = {}


def program_of(case: Case, points: str, folder: Path, **numbers: int) -> Path:
    suffix = ".ls" if case.name.startswith("Fanuc") else ".script"
    path, key = folder / f"round{suffix}", (case.name, points, str(numbers))
    if key not in WRITTEN:
        linear = LinearMotion(points=points, **numbers)  # type: ignore[arg-type]
        check, done = write_checked(case.rows, path, case.task, case.joints, linear=linear)
        assert done and check.passes, check.verdict
        WRITTEN[key] = path.read_text()
    path.write_text(WRITTEN[key])
    return path


@pytest.mark.parametrize(("name", "points"), WAYS)
def test_a_controller_keeps_path_and_branch_at_few_points_and_stops(
    name: str, points: str, cases: dict[str, Case], tmp_path: Path
) -> None:
    case = cases[name]
    task, rows, joints = case.task, case.rows, case.joints
    text = program_of(case, points, tmp_path).read_text()
    first, *moves = moves_of(text)
    assert len(moves) < 0.9 * len(rows.q)
    data = mujoco.MjData(task.model)
    corners = corners_of(case, text, data)
    theta, whole, ways = first.theta, 0.0, []
    for move, at, end in zip(moves, corners[:-1], corners[1:], strict=True):
        way = float(np.linalg.norm(end[:3, 3] - at[:3, 3]))
        seconds = move.seconds if np.isnan(move.speed) else way / move.speed
        whole += seconds
        spots, R = between(at, end, 1 + int(np.ceil(seconds / 1e-3)))
        apart, leant = off_path(task, spots, R[:, :, 2])
        assert apart <= 1e-4 and leant <= np.radians(0.05)
        for spot, turn in zip(spots[1:], R[1:], strict=True):
            corrected(task.model, data, spot, turn)
            step = np.degrees(joints.signs * data.qpos + joints.offsets)
            assert np.abs(step - theta).max() < 0.5  # in a millisecond: the branch stays
            theta = step
        if move.theta is not None:
            assert theta == pytest.approx(move.theta, abs=2e-3)
        else:
            assert data_of(name, theta) == move.data
        ways.append(way)
    stated = re.search(rf"seconds: ({N})", text)
    assert stated and whole == pytest.approx(float(stated[1]), abs=6e-4)
    assert rows.times is not None and rows.times[-1] <= whole * 1.001 <= rows.times[-1] * 1.03
    check_corners(case, moves, corners, ways)


def check_corners(case: Case, moves: list[Move], corners: list[Array], ways: list[float]) -> None:
    """Points are rounded by arcs (URScript) or parabolas (LS) that stay on the path, few stops."""
    stops = 0
    for k, move in enumerate(moves[:-1]):
        half = 0.5 * min(ways[k], ways[k + 1])
        reach = move.reach if np.isnan(move.cnt) else move.cnt * half
        assert reach <= half * (1.0 + 1e-9)
        if not np.isnan(move.reach) and k:  # no blend overlaps the next
            assert moves[k - 1].reach + move.reach <= ways[k]
        if reach == 0.0:
            stops += 1
            continue
        before, at, after = corners[k : k + 3]
        u = (at[:3, 3] - before[:3, 3]) / ways[k]
        v = (after[:3, 3] - at[:3, 3]) / ways[k + 1]
        s = np.linspace(-reach, reach, 41)[:, None]
        # Two parabolas in s are one polynomial; an arc is farther by its tangents' angle alone.
        turn = np.arccos(np.clip(u @ v, -1.0, 1.0))
        bend = (s**2 + reach**2) / (4.0 * reach)
        rounded = at[:3, 3] + 0.5 * s * (u + v) + bend * (v - u) / np.cos(0.25 * turn) ** 2
        R = at[:3, :3]
        w_before = Rotation.from_matrix(before[:3, :3].T @ R).as_rotvec() / ways[k]
        w_after = Rotation.from_matrix(R.T @ after[:3, :3]).as_rotvec() / ways[k + 1]
        turned = 0.5 * s * (w_before + w_after) + bend * (w_after - w_before)
        axes = R @ Rotation.from_rotvec(turned).as_matrix()
        middle = slice(15, 26)  # the arc's ends are those of the parabola
        apart, leant = off_path(case.task, rounded[middle], axes[middle, :, 2])
        assert apart <= 1e-4 and leant <= np.radians(0.05)
    assert stops <= 2


def test_numbers_of_tool_and_frame(cases: dict[str, Case], tmp_path: Path) -> None:
    case = cases["Fanuc LR Mate 200iD"]
    path = program_of(case, "poses", tmp_path, tool=3, frame=7)
    text = path.read_text()
    assert "UFRAME_NUM=7 ;" in text and "UTOOL_NUM=3 ;" in text
    assert text.count("UF : 7, UT : 3,") == len(moves_of(text))
    # Points are then in the world of the task: the first straight one is there.
    _, move, *_ = moves_of(text)
    assert move.pose is not None
    apart, _ = off_path(case.task, move.pose[None, :3, 3], move.pose[None, :3, 2])
    assert apart < 1e-4
    for key, number, word in (("UT : ", 3, "UTOOL_NUM="), ("UF : ", 7, "UFRAME_NUM=")):
        others = text.replace(f"{key}{number}", f"{key}9").replace(f"{word}{number}", f"{word}9")
        path.write_text(others)
        with pytest.raises(qt.InvalidInput, match=rf"says \w+: {number}, but here it is 9"):
            read_trajectory(path, None, case.joints)
    for change, words in (
        (
            ("UTOOL_NUM=3", "UTOOL_NUM=4"),
            r"line \d+: P\[1\] has UT : 3, but UTOOL_NUM.* has 4",
        ),
        (
            ("UF : 7, UT : 3,\tC", "UF : 6, UT : 3,\tC"),
            r"has UF : 6, but UFRAME_NUM.* has 7",
        ),
    ):
        path.write_text(text.replace(*change, 1))
        with pytest.raises(qt.InvalidInput, match=words):
            read_trajectory(path, None, case.joints)


@pytest.mark.parametrize(
    ("name", "points", "change", "words"),
    [
        ("Fanuc M-20iA", "poses", (r"CONFIG : '\w", "CONFIG : 'X"), "expected CONFIG : 'N U T, 0"),
        ("Fanuc M-20iA", "poses", (r"'(F|N) (U|D) T, (.*)'", r"'\1 \2 B, \3'"),
         r"line \d+: the robot arrives with the configuration"),
        ("Fanuc M-20iA", "poses", (r"(T|B), -?\d, ", r"\1, 1, "), "arrives with the configuration"),
        ("Fanuc M-20iA", "poses", (r":L (P\[5\])", r":C \1"), r"line \d+.* is not read"),
        ("Fanuc M-20iA", "joints", (r"\d+mm/sec CNT\d+", "100% CNT50"), "L is not read"),
        ("Fanuc M-20iA", "joints", (r"(L P\[4\] )\d+(mm/sec)", r"\g<1>30\2"), "a speed or a time"),
        ("Fanuc M-20iA", "joints", (r"(L P\[4\] )\d+(mm/sec)", r"\g<1>0\2"), "positive"),
        ("Universal Robots UR5e", "joints", (r"movel\((.*), r=0.00.*\n", ""), "a line was lost"),
        ("Universal Robots UR5e", "joints", (r"v=0\.1[12]\d+", "v=0.03"), "a speed or a time"),
        ("Universal Robots UR5e", "joints", (r"v=0\.1[12]\d+", "v=-1"), "positive"),
        ("Universal Robots UR5e", "joints", (r"(movel.*)a=[^,]*", r"\1a=20"), "an acceleration"),
        ("Universal Robots UR5e", "joints", (r"(movel.*)a=[^,]*", r"\1a=0"), "positive"),
        ("Fanuc M-20iA", "poses", (r"(P\[5\]\{\s+GP1:\s+UF : 0, UT : )1", r"\g<1>2"), "UT : 2"),
        ("Fanuc M-20iA", "joints", (r"CNT\d+", "CNT101"), "CNT0 to CNT100, .*got CNT101"),
        ("Fanuc M-20iA", "joints", (r":L P\[5\]", ":L P[5}]"), r"line \d+.*P\[5\}\]"),
        ("Universal Robots UR5e", "joints", (r"(movel\(\[-?\d\.\d)\d", r"\1_"), "constants"),
        ("Fanuc M-20iA", "joints", (r"(GROUP\s*= )1,\*", r"\1*,1"), "points are of motion group 1"),
        ("Universal Robots UR5e", "joints", (r"movel\(\[", "movec(["), r"line \d+: .*movec"),
        ("Universal Robots UR5e", "joints", (r"movel\(\[.*?\]", "movel(get_pose()"), "get_pose"),
        ("Universal Robots UR5e", "joints", (r"r=0.00\d+\)", "r=0.001, s=1)"), "arguments"),
        ("Universal Robots UR5e", "joints", (r"(?s)(\n  movel.*)(\n  movel.*)",
         r"\n  set_tcp(p[0,0,0.1,0,0,0])\1\n  set_tcp(p[0,0,0.2,0,0,0])\2"), "moves the tool"),
    ],
)  # fmt: skip
def test_what_is_refused(
    name: str, points: str, change: tuple[str, str], words: str, cases: dict[str, Case],
    tmp_path: Path,
) -> None:  # fmt: skip
    path = program_of(cases[name], points, tmp_path)
    text = path.read_text()
    changed = re.sub(change[0], change[1], text, count=1)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, cases[name].joints)


def test_scripts_of_others_with_poses(cases: dict[str, Case], tmp_path: Path) -> None:
    """Straight moves to poses in the robot's base, from where it stands; the TCP as stated."""
    case = cases["Universal Robots UR5e"]
    theta = np.array(POSTURES[case.name])
    tcp = about("x", 30.0)
    tcp[:3, 3] = 0.01, 0.02, 0.1
    at = flange(case.name, theta) @ tcp
    there = at.copy()
    there[:3, 3] += 0.03, -0.02, 0.04
    there[:3, :3] = about("y", 10.0)[:3, :3] @ there[:3, :3]

    def text(pose: Array) -> str:
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        return f"p[{', '.join(f'{x:.9f}' for x in [*pose[:3, 3], *turn])}]"

    angles = ", ".join(f"{x:.9f}" for x in np.radians(theta))
    script = f"""def other():
  set_tcp({text(tcp)})
  start_q = [{angles}]
  movej(start_q, a=1, v=1)
  movel({text(there)}, a=1.2, v=0.1)
  movep({text(at)}, a=1.2, v=0.05, r=0)
end
"""
    path = tmp_path / "other.script"
    path.write_text(script)
    back = read_trajectory(path, None, case.joints)
    shown = np.degrees(case.joints.shown(back.q))
    assert back.times is not None
    way = float(np.linalg.norm([0.03, 0.02, 0.04]))
    assert back.times[-1] == pytest.approx(way / 0.1 + way / 0.05)
    middle = shown[int(np.argmin(np.abs(back.times - way / 0.1)))]
    assert flange(case.name, middle) @ tcp == pytest.approx(there, abs=1e-6)
    assert shown[-1] == pytest.approx(theta, abs=1e-4)
    assert "where the program states it" in "; ".join(back.notes)
    path.write_text(script.replace("movel(", "movej("))
    with pytest.raises(qt.InvalidInput, match=r"line 5.*numbers or constants|Cartesian"):
        read_trajectory(path, None, case.joints)


def test_changed_points_fail_or_are_refused(cases: dict[str, Case], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name, points in WAYS[1:5]:
        case = cases[name]
        path = program_of(case, points, tmp_path)
        text = path.read_text()
        begin = text.index("/POS") if "/POS" in text else text.index("  movel")
        numbers = [m for m in re.finditer(r"(?<=[ \[])-?\d+\.\d{4,}", text) if m.start() > begin]
        for _ in range(8):
            at = numbers[rng.integers(len(numbers))]
            value = float(at[0]) + rng.choice([-1.0, 1.0]) * (0.01 if "scri" in path.name else 0.6)
            path.write_text(f"{text[: at.start()]}{value:.6f}{text[at.end() :]}")
            try:
                check = check_trajectory(read_trajectory(path, None, case.joints), case.task)
            except qt.InvalidInput:
                continue
            if check.passes:  # rightly?
                corners = corners_of(case, path.read_text(), mujoco.MjData(case.task.model))
                for begin, end in itertools.pairwise(corners):
                    spots, R = between(begin, end, 20)
                    apart, leant = off_path(case.task, spots, R[:, :, 2])
                    assert apart <= 1.05e-4 and leant <= np.radians(0.0525)


def test_movep_holds_one_speed_from_stop_to_stop(cases: dict[str, Case], tmp_path: Path) -> None:
    case = cases["Universal Robots UR10e"]
    text = program_of(case, "joints", tmp_path).read_text()
    _, *moves = moves_of(text)
    assert all(move.constant and move.speed == moves[0].speed for move in moves)
    assert moves[0].speed == pytest.approx(SPEED[case.name], rel=0.02)
    assert "movep" not in program_of(cases["Universal Robots UR5e"], "joints", tmp_path).read_text()
    none = dataclasses.replace(cases["Universal Robots UR5e"].joints, tool=None, arm=None)
    with pytest.raises(qt.InvalidInput, match="read with the task of the robot"):
        read_trajectory(tmp_path / "round.script", None, none)

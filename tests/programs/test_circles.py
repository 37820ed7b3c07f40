"""Circles of programs: simulated here as controllers move, read, written, and refused."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from oracles.circle_programs import (
    POSTURES,
    RADIUS,
    SEAM,
    SUFFIXES,
    Case,
    RandomCircle,
    case_of,
    flange,
    random_circle,
)
from oracles.data_sheets import data_of
from oracles.pose_programs import corrected, site_of
from oracles.program_simulator import Cell, Controller, Move, N, read
from oracles.tool_circles import length_of, moved
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import (
    TimedPath,
    check_trajectory,
    read_trajectory,
    write_checked,
)
from qp_twist.trajectories.linear_moves import LinearMotion

Array = np.ndarray


def shown(joints: ControllerJoints, q: Array) -> Array:
    """θ of data sheets, degrees."""
    return np.degrees(joints.signs * q + joints.offsets)


WAYS = [
    (name, kind, points)
    for name in POSTURES
    for kind in ("hole", "seam")
    for points in ("joints", "poses")
    if points in {"KUKA": ("poses",), "Univ": ("joints",)}.get(name[:4], ("joints", "poses"))
]


def program_of(case: Case, points: str, folder: Path, *, circles: bool = True) -> Path:
    numbers = {} if points == "joints" else {"tool": 2, "frame": 7}  # then in the world
    linear = LinearMotion(points=points, circles=circles, **numbers)  # type: ignore[arg-type]
    path = folder / f"round{SUFFIXES[case.name]}"
    check, done = write_checked(case.rows, path, case.task, case.joints, linear=linear)
    assert done and check.passes, check.verdict
    return path


@pytest.mark.parametrize(("name", "kind", "points"), [*{w[:2]: w for w in WAYS}.values()])
def test_straight_moves_alone_have_more_points(
    name: str, kind: str, points: str, tmp_path: Path
) -> None:
    path = program_of(case_of(name, kind), points, tmp_path, circles=False)
    assert len(read(path.read_text(), path.suffix).moves) > 21


@pytest.mark.parametrize(("name", "kind", "points"), WAYS)
def test_a_controller_keeps_the_path_on_few_circles(
    name: str, kind: str, points: str, tmp_path: Path
) -> None:
    case = case_of(name, kind)
    task, joints = case.task, case.joints
    path = program_of(case, points, tmp_path)
    program = read(text := path.read_text(), path.suffix)
    first, *moves = program.moves
    circles = [move for move in moves if move.via is not None]
    assert 1 <= len(circles) <= 4 and len(moves) <= len(circles) + 4
    assert sum(min(move.zone, move.share) == 0.0 for move in moves) == 1  # at the end
    assert f"points: {1 + len(moves) + len(circles)}" in text
    assert not re.search("mode=[^0]", text)
    names, data = qt.JointRanges.of(task.model).names, mujoco.MjData(task.model)
    at_ends = Controller(Cell(name, task.model, names, joints.signs, joints.offsets, {}), program)
    assert program.tool is None and program.frame is None  # a pose is one of the task's tool

    def pose_at(move: Move) -> Array:
        return at_ends.end(move, at_ends.joints(move, data.qpos), np.eye(4))

    data.qpos[:] = at_ends.joints(first, data.qpos)
    mujoco.mj_forward(task.model, data)
    at, theta, whole, covered = site_of(data), shown(joints, data.qpos), 0.0, 0.0
    axis = np.array(task.waypoints[0].rotation().as_matrix()[:, 2])
    for move in moves:
        end, via = pose_at(move), None
        if move.via is not None:
            of_pose = move.via.ndim == 2
            between = {
                "theta": None if of_pose else move.via,
                "pose": move.via if of_pose else None,
            }
            via = pose_at(move._replace(**between))[:3, 3]
        way, speed = length_of(at, end, via), move.speeds[0]
        seconds = move.seconds if np.isnan(speed) else way / speed
        whole, covered = whole + seconds, covered + way
        shares = np.linspace(0.0, 1.0, 1 + int(np.ceil(seconds / 10e-3)))
        spots, R = moved(at, end, shares, via, move.rule)
        # The path is a circle; its axis, and the tool's if that turns with it, are the first ones.
        assert np.abs(np.linalg.norm(spots - case.centre, axis=1) - RADIUS).max() <= 1e-4
        for spot, turn in zip(spots[1:], R[1:], strict=True):
            corrected(task.model, data, spot, turn)
            step = shown(joints, data.qpos)
            assert np.abs(step - theta).max() < 3.0  # in ten milliseconds: the branch stays
            theta = step
            place = int(np.argmin([np.linalg.norm(w.translation() - spot) for w in task.waypoints]))
            wanted = task.waypoints[place].rotation().as_matrix()
            if kind == "hole":
                assert np.linalg.norm(np.cross(axis, turn[:, 2])) <= np.radians(0.05)
            else:  # that of the nearest waypoint, half of their distance beside
                off = Rotation.from_matrix(turn.T @ wanted).magnitude()
                assert off <= np.radians(0.5 * SEAM / 180.0 + 0.05)
        if move.theta is not None:
            assert np.degrees(data.qpos - at_ends.joints(move, data.qpos)) == pytest.approx(
                0, abs=2e-3
            )
        elif move.data:
            assert data_of(name, theta) == move.data
        at = end
    assert covered == pytest.approx(
        RADIUS * np.radians(360.0 if kind == "hole" else SEAM), rel=1e-3
    )
    stated = re.search(rf"seconds: ({N})", text)
    assert stated and whole == pytest.approx(float(stated[1]), rel=1e-3)
    assert case.rows.times is not None
    assert whole == pytest.approx(case.rows.times[-1], rel=0.03)


@pytest.mark.parametrize("name", POSTURES)
def test_random_circles_of_others_are_followed(name: str, tmp_path: Path) -> None:
    joints = case_of(name, "hole").joints
    rng, path, done, seen = np.random.default_rng(7), tmp_path / f"other{SUFFIXES[name]}", 0, set()
    while done < 50:
        circle = random_circle(name, rng)
        if circle is None:
            continue
        path.write_text(circle.text)
        back = read_trajectory(path, None, joints)
        done += 1
        seen.add(circle.rule)
        assert_followed(name, circle, back, joints)
    assert len(seen) == (1 if name.startswith("Fanuc") else 2)


def assert_followed(
    name: str, circle: RandomCircle, back: TimedPath, joints: ControllerJoints
) -> None:
    theta = np.degrees(joints.shown(back.q))
    if name.startswith("Fanuc"):
        theta[:, 2] += theta[:, 1]
    assert back.times is not None
    assert back.times[-1] == pytest.approx(circle.seconds, rel=1e-6)
    if circle.rule != "tangent":
        assert theta[-1] == pytest.approx(circle.theta, abs=1e-4)
    rows = np.linspace(0, len(theta) - 1, 4).astype(int)
    points, R = circle.at(back.times[rows] / back.times[-1])
    for row, point, turn in zip(rows, points, R, strict=True):
        pose = flange(name, theta[row]) @ circle.tool
        assert pose[:3, 3] == pytest.approx(point, abs=1e-7)
        assert pose[:3, :3] == pytest.approx(turn, abs=1e-6)


def text_of(name: str) -> str:
    """A random circle that is the same each time."""
    rng = np.random.default_rng(3)
    found = next(filter(None, (random_circle(name, rng) for _ in range(20))))
    return found.text


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("ABB IRB 120", (r"PROC main\(\)\n", r"\g<0>  CirPathMode\\CirPointOri;\n"),
         "CirPathMode is not read"),
        ("ABB IRB 120", (r"PROC main\(\)\n", r"\g<0>  SingArea\\Wrist;\n"),
         r"line \d+: .*behind SingArea \\Wrist"),
        ("ABB IRB 120", (r"MoveC (\[.*?9E9\]\]),\n.*?9E9\]\],", r"MoveC \1,\1,"), "are the same"),
        ("ABB IRB 120", (r",fine,gun;\nENDPROC", r",fine;\nENDPROC"), r"line \d+: .*2 targets"),
        ("KUKA KR 16-2", (r"\$CIRC_TYPE.*\n", ""), r"line \d+: .*expected \$CIRC_TYPE"),
        ("KUKA KR 16-2", (r"CIRC_TYPE=#\w+", "CIRC_TYPE=#ELSE"), r"line \d+: .*expected \$CIRC"),
        ("KUKA KR 16-2", (r"CIRC (\{.*\}),\{.*\}", r"CIRC \1"), "two of an arc"),
        ("KUKA KR 16-2", (r"CIRC (.*)", r"CIRC \1,CA 20"), r"line \d+: .*turns on the circle"),
        ("KUKA KR 16-2", ("CIRC {", "SCIRC {"), "SCIRC is not read"),
        ("Fanuc LR Mate 200iD", (r":C P\[2\]\n    :  P\[3\]", ":C P[2]\n    :  P[2]"),
         "no line moves to P.3.|are the same"),
        ("Fanuc LR Mate 200iD", (r":C P\[2\]\n    : ", ":C"), "no line moves to|is not read"),
        ("Fanuc LR Mate 200iD", (r"(P\[2\]\{[^}]*W= )", r"\g<1>1"),
         r"line \d+: at the point between, the tool is turned by"),
        ("Universal Robots UR10e", (r"r=0.*\)", "r=0, mode=2)"), r"line \d+: .*mode 0 or 1"),
        ("Universal Robots UR10e", (r"r=0.*\)", "r=0, mode=get_mode())"), "get_mode"),
        ("Universal Robots UR10e", (r"movec\((p\[.*?\])", "movec([0, 1]"), r"line \d+: "),
    ],
)  # fmt: skip
def test_what_is_refused(name: str, change: tuple[str, str], words: str, tmp_path: Path) -> None:
    text = text_of(name)
    changed = re.sub(change[0], change[1], text, count=1)
    assert changed != text
    path = tmp_path / f"other{SUFFIXES[name]}"
    path.write_text(changed)
    with pytest.raises(qt.InvalidInput, match=words):
        read_trajectory(path, None, case_of(name, "hole").joints)


def test_points_on_a_line_are_refused_and_an_angle_goes_on(tmp_path: Path) -> None:
    """A tool that keeps its orientation: to the middle of the chord; and by CA beyond the end."""
    name = "KUKA KR 16-2"
    joints, path = case_of(name, "hole").joints, tmp_path / "other.src"
    theta = np.array(POSTURES[name])
    at = flange(name, theta)
    a, b, c = Rotation.from_matrix(at[:3, :3]).as_euler("ZYX", degrees=True)

    def text(via: Array, end: Array, more: str = "") -> str:
        axes = ",".join(f"A{k} {x}" for k, x in enumerate(theta, start=1))
        via_text, end_text = (
            "{" + ",".join(f"{k} {x:.8f}" for k, x in zip("XYZABC", [*(1e3 * p), a, b, c],
                                                          strict=True)) + "}"
            for p in (via, end)
        )  # fmt: skip
        return (
            "DEF other( )\n$TOOL={X 0,Y 0,Z 0,A 0,B 0,C 0}\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n"
            f"$CIRC_TYPE=#BASE\n$VEL.CP=0.1\nPTP {{{axes}}}\n"
            f"CIRC {via_text},{end_text}{more}\nEND\n"
        )

    start, u, v = at[:3, 3], np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    path.write_text(text(start + 0.02 * u, start + 0.04 * u))
    with pytest.raises(qt.InvalidInput, match=r"line 7.*are on a line"):
        read_trajectory(path, None, joints)
    path.write_text(text(start + 0.04 * u, start + 0.02 * u))
    with pytest.raises(qt.InvalidInput, match=r"line 7.*on a line, and not in its order"):
        read_trajectory(path, None, joints)
    # A fourth of a circle of 30 mm about start + 30 mm v, as far as stated.
    half = np.sqrt(0.5)
    via, end = start + 0.03 * (v - half * v + half * u), start + 0.03 * (v + u)
    for degrees in (120.0, 30.0, -45.0):
        path.write_text(text(via, end, f",CA {degrees:g}"))
        back = read_trajectory(path, None, joints)
        last = flange(name, np.degrees(joints.shown(back.q[-1:]))[0])
        t = np.radians(degrees)
        wanted = start + 0.03 * (v - np.cos(t) * v + np.sin(t) * u)
        assert last[:3, 3] == pytest.approx(wanted, abs=1e-7)
        assert back.times is not None
        assert back.times[-1] == pytest.approx(abs(t) * 0.03 / 0.1)


@pytest.mark.parametrize("name", POSTURES)
def test_a_changed_point_between_fails(name: str, tmp_path: Path) -> None:
    """By half a millimetre, or a tenth of a degree of an axis."""
    case = case_of(name, "seam")
    points = "joints" if name.startswith("Univ") else "poses"
    path = program_of(case, points, tmp_path)
    text = path.read_text()
    change = {
        ".mod": (r"(MoveC \[\[)(-?\d+\.\d+)", 0.5), ".src": (r"(CIRC \{X )(-?\d+\.\d+)", 0.5),
        ".ls": (r"(P\[2\]\{[^}]*X= )(-?\d+\.\d+)", 0.5),
        ".script": (r"(movec\(\[)(-?\d+\.\d+)", 2e-3),
    }[path.suffix]  # fmt: skip
    changed = re.sub(change[0], lambda m: f"{m[1]}{float(m[2]) + change[1]:.6f}", text, count=1)
    assert changed != text
    path.write_text(changed)
    try:
        assert not check_trajectory(read_trajectory(path, None, case.joints), case.task).passes
    except qt.InvalidInput as refusal:
        assert "line" in str(refusal)

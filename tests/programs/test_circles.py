"""Circles of programs: simulated here as controllers move, read, written, and refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

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
from oracles.pose_programs import N, corrected, krl_frame, rapid_frame, site_of
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


class Move(NamedTuple):
    """To θ, degrees, or a pose in the world, straight or through one, by a rule; in seconds."""

    to: Array
    via: Array | None
    rule: str
    speed: float
    seconds: float
    stops: bool
    data: tuple[int, ...] = ()


def moves_of(text: str) -> tuple[Array, list[Move]]:
    """The first θ and the moves, read by expressions of the test's own."""
    found = list[Move]()
    if "MODULE" in text:
        first = re.search(r"MoveAbsJ \[\[(.*?)\]", text)
        for word, rest in re.findall(r"^    (Move[LC]) (.*);$", text, re.M):
            joint = re.findall(r"CalcRobT\(\[\[(.*?)\]", rest)
            poses = re.findall(r"\[(\[[^\]]*\],\[[^\]]*\]),\[([^\]]*)\],\[9E9", rest)
            places = [np.array(each.split(","), float) for each in joint]
            places += [rapid_frame(each) for each, _ in poses]
            time, speed = re.search(rf"T:=({N})", rest), re.search(rf"\]\],\[({N}),", rest)
            seconds = float(time[1]) if time else np.nan
            v = 1e-3 * float(speed[1]) if speed else np.nan
            data = tuple(map(int, poses[-1][1].split(","))) if poses else ()
            assert len(places) == 1 + (word == "MoveC")
            via = places[0] if word == "MoveC" else None
            found.append(Move(places[-1], via, "path", v, seconds, ",fine," in rest, data))
    elif "DEF " in text:
        first, now, rule = re.search(r"^PTP \{(.*)\}", text, re.M), np.nan, ""
        for line in text.splitlines():
            if speed := re.fullmatch(rf"\$VEL.CP=({N})", line):
                now = float(speed[1])
            elif turn := re.fullmatch(r"\$CIRC_TYPE=#(\w+)", line):
                rule = {"PATH": "path", "BASE": "space"}[turn[1]]
            elif line[:4] in ("LIN ", "CIRC"):
                places = [krl_frame(each) for each in re.findall(r"\{.*?\}", line)]
                via = places[0] if line[:4] == "CIRC" else None
                data = tuple(map(int, re.search(r"S (\d+),T (\d+)", line).groups()))  # type: ignore[union-attr]
                stops = not line.endswith("C_DIS")
                found.append(Move(places[-1], via, rule, now, np.nan, stops, data))
    elif "/PROG" in text:
        points = dict(re.findall(r"^P\[(\d+)\]\{(.*?)\};", text, re.S | re.M))
        places_of = {k: _fanuc_point(each) for k, each in points.items()}
        first_theta = places_of["1"]
        pattern = r":([JLC]) P\[(\d+)\]\s+(?::\s+P\[(\d+)\] )?(\S+) (\w+) ;"
        for word, one, two, how, end in re.findall(pattern, text)[1:]:
            value, unit = float(re.match(N, how)[0]), how.lstrip("0123456789.")  # type: ignore[index]
            speed = value * {"mm/sec": 1e-3, "cm/min": 1e-2 / 60.0}.get(unit, np.nan)
            seconds = value * {"msec": 1e-3, "sec": 1.0}.get(unit, np.nan)
            assert bool(two) == (word == "C")
            via = places_of[one] if two else None
            found.append(Move(places_of[two or one], via, "space", speed, seconds, end == "FINE"))
        return first_theta, found
    else:
        first = re.search(r"movej\(\[(.*?)\]", text)
        for word, rest in re.findall(r"^  (move[lpc])\((.*)\)$", text, re.M):
            places = [
                np.degrees(np.array(x.split(","), float)) for x in re.findall(r"\[(.*?)\]", rest)
            ]
            given = {key: float(value) for key, value in re.findall(rf"(\w+)=({N})", rest)}
            assert given.get("mode", 0.0) == 0.0 and len(places) == 1 + (word == "movec")
            via = places[0] if word == "movec" else None
            found.append(Move(places[-1], via, "space", given.get("v", np.nan),
                              given.get("t", np.nan), "r" not in given))  # fmt: skip
    assert first
    theta = np.array([float(x) for x in re.findall(rf"(?:A\d )?({N})(?:,|$)", first[1])])
    return np.degrees(theta) if "movej" in text else theta, found


def _fanuc_point(inside: str) -> Array:
    values = {k: float(v) for k, v in re.findall(rf"(\w+)= ({N}) ", inside)}
    if "J1" in values:
        theta = np.array([values[f"J{k}"] for k in range(1, 7)])
        theta[2] += theta[1]
        return theta
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [values[k] for k in "RPW"], degrees=True).as_matrix()
    pose[:3, 3] = [1e-3 * values[k] for k in "XYZ"]
    return pose


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
    text = program_of(case_of(name, kind), points, tmp_path, circles=False).read_text()
    assert len(moves_of(text)[1]) > 20


@pytest.mark.parametrize(("name", "kind", "points"), WAYS)
def test_a_controller_keeps_the_path_on_few_circles(
    name: str, kind: str, points: str, tmp_path: Path
) -> None:
    case = case_of(name, kind)
    task, joints = case.task, case.joints
    text = program_of(case, points, tmp_path).read_text()
    first, moves = moves_of(text)
    circles = [move for move in moves if move.via is not None]
    assert 1 <= len(circles) <= 4 and len(moves) <= len(circles) + 4
    assert sum(move.stops for move in moves) == 1  # at the end
    assert f"points: {1 + len(moves) + len(circles)}" in text
    data = mujoco.MjData(task.model)

    def pose_at(place: Array) -> Array:
        """Of the tool, at θ by MuJoCo; a pose is one in the world."""
        if place.ndim == 2:
            return place
        other = mujoco.MjData(task.model)
        other.qpos[:] = (np.radians(place) - joints.offsets) * joints.signs
        mujoco.mj_forward(task.model, other)
        return site_of(other)

    data.qpos[:] = (np.radians(first) - joints.offsets) * joints.signs
    mujoco.mj_forward(task.model, data)
    at, theta, whole, covered = site_of(data), first, 0.0, 0.0
    axis = np.array(task.waypoints[0].rotation().as_matrix()[:, 2])
    for move in moves:
        end = pose_at(move.to)
        via = None if move.via is None else pose_at(move.via)[:3, 3]
        way = length_of(at, end, via)
        seconds = move.seconds if np.isnan(move.speed) else way / move.speed
        whole, covered = whole + seconds, covered + way
        shares = np.linspace(0.0, 1.0, 1 + int(np.ceil(seconds / 10e-3)))
        spots, R = moved(at, end, shares, via, move.rule)
        # The path is a circle; its axis, and the tool's if that turns with it, are the first ones.
        assert np.abs(np.linalg.norm(spots - case.centre, axis=1) - RADIUS).max() <= 1e-4
        for spot, turn in zip(spots[1:], R[1:], strict=True):
            corrected(task.model, data, spot, turn)
            step = np.degrees(joints.signs * data.qpos + joints.offsets)
            assert np.abs(step - theta).max() < 3.0  # in ten milliseconds: the branch stays
            theta = step
            place = int(np.argmin([np.linalg.norm(w.translation() - spot) for w in task.waypoints]))
            wanted = task.waypoints[place].rotation().as_matrix()
            if kind == "hole":
                assert np.linalg.norm(np.cross(axis, turn[:, 2])) <= np.radians(0.05)
            else:  # that of the nearest waypoint, half of their distance beside
                off = Rotation.from_matrix(turn.T @ wanted).magnitude()
                assert off <= np.radians(0.5 * SEAM / 180.0 + 0.05)
        if move.to.ndim == 1:
            assert theta == pytest.approx(move.to, abs=2e-3)
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

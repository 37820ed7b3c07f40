"""Robot programs as a controller moves, at 1 ms: texts read by expressions of this file, kinematics
by MuJoCo and by data sheets, of robots on a rail and of parts on a positioner or in the hand, too.
"""

import re
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from oracles.data_sheets import about, links
from oracles.tool_circles import length_of, moved

Array = np.ndarray
N = r"-?(?:\d+\.?\d*|\.\d+)(?:[eE]-?\d+)?"
_SHOWN = rf"(\w+)\s*=\s*\+?({N})\s*(?:mm|deg)"
"""An axis or a component of a position in LS."""
FASTEST = np.radians(0.5)
"""Largest step of a joint in a millisecond, rad: with more the arm jumps to another branch."""
MS = 1e-3


class Cell(NamedTuple):
    """A robot in its scene, as its controller counts: θ = signs · q + offsets; external axes alike.

    ``external``: of each axis of the controller the joint, and mm or degrees for one m or rad.
    ``part``: the body that carries the path, else the world. ``tool``: a site.
    """

    name: str
    model: mujoco.MjModel
    joints: tuple[str, ...]
    signs: Array
    offsets: Array
    external: dict[str, tuple[str, float]]
    part: str = "world"
    tool: str = "tool"


class Move(NamedTuple):
    """To shown angles (rad in URScript, else degrees) or a pose, straight or not.

    In seconds, or at speeds in m/s and rad/s; with rates at its end each joint is on a cubic; on a
    circle ``via`` shown angles or a pose. From rest to rest it has two ramps of a ``ramp`` of the
    time each. Its end is rounded from ``zone`` m on, at most from the
    ``share`` of half of the shorter move.
    """

    straight: bool
    theta: Array | None
    pose: Array | None
    external: dict[str, float]
    data: tuple[int, ...] = ()
    seconds: float = np.nan
    speeds: tuple[float, float] = (np.nan, np.inf)
    rates: Array | None = None
    on_part: bool = False
    via: Array | None = None
    rule: str = "space"
    zone: float = 0.0
    share: float = 1.0
    ramp: float = 0.0


class Text(NamedTuple):
    """A program: moves, and tool and frame if it states their values."""

    moves: list[Move]
    tool: Array | None = None
    frame: Array | None = None


class Motion(NamedTuple):
    """Samples at most 1 ms apart: time, all joints (K, n), poses of the tool on the part (K, 4, 4).

    ``corners``: the sample at each point of the program.
    """

    times: Array
    q: Array
    poses: Array
    corners: list[int]


def numbers(text: str) -> list[float]:
    return [float(each) for each in re.findall(N, text)]


def rigid(turn: Array, place: object) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def angles_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Array:
    """Of mm and angles about z, y', x'', degrees."""
    pose = about("z", a) @ about("y", b) @ about("x", c)
    pose[:3, 3] = MS * np.array([x, y, z])
    return pose


def quaternion_pose(x: float, y: float, z: float, w: float, i: float, j: float, k: float) -> Array:
    return rigid(Rotation.from_quat([i, j, k, w]).as_matrix(), MS * np.array([x, y, z]))


def read(text: str, suffix: str) -> Text:
    return {".mod": _rapid, ".src": _krl, ".ls": _ls, ".script": _urscript}[suffix](text)


def _rapid(text: str) -> Text:
    tool = re.search(r"tooldata \w+:=\[TRUE,(.*?\]\])", text)
    frame = re.search(r'wobjdata \w+:=\[FALSE,TRUE,"",(.*?\]\])', text)
    found = []
    for word, rest in re.findall(r"^\s*(MoveAbsJ|MoveL|MoveC) (.*);$", text, re.M):
        time = re.search(rf"\\T:=({N})", rest)
        seconds = float(time[1]) if time else np.nan
        groups, via = re.findall(r"\[([^\[\]]*)\]", rest), None
        if word == "MoveC" and "CalcRobT" in rest:
            via, groups = np.array(numbers(groups[0])), groups[2:]
        elif word == "MoveC":
            via = quaternion_pose(*numbers(groups[0]), *numbers(groups[1]))
            groups = groups[4:]
        if word == "MoveAbsJ" or "CalcRobT" in rest:
            theta, others = groups[0], groups[1]
            pose, data, speeds = None, (), (np.nan, np.inf)
        else:
            theta, others = None, groups[3]
            pose = quaternion_pose(*numbers(groups[0]), *numbers(groups[1]))
            data = tuple(int(each) for each in groups[2].split(","))
            v, w = numbers(groups[4])[:2]
            speeds = MS * v, np.radians(w)
        zone = re.search(r",z(\d+),", rest)
        given = zip("abcdef", others.split(","), strict=True)
        external = {f"eax_{key}": float(value) for key, value in given if value.strip() != "9E9"}
        found.append(
            Move(word != "MoveAbsJ", None if theta is None else np.array(numbers(theta)), pose,
                 external, data, seconds, speeds, None, "WObj" in rest and "task_wobj" not in rest,
                 via, "path", MS * (float(zone[1]) or 0.3) if zone else 0.0)
        )  # fmt: skip
    return Text(found, *(None if m is None else quaternion_pose(*numbers(m[1])[:7])
                         for m in (tool, frame)))  # fmt: skip


def _krl(text: str) -> Text:
    stated = [re.search(rf"^\${word}=\{{(.*)\}}", text, re.M) for word in ("TOOL", "BASE")]
    coupled, speeds, found = "EK(" in text, {"CP": np.nan, "ORI1": np.inf}, list[Move]()
    rule, zone = "space", np.inf
    for written in text.splitlines():
        line, via = written, None
        places = re.findall(r"\{.*?\}", written)
        if written.startswith("CIRC "):
            via_fields = dict(re.findall(rf"\b([A-Z]) ({N})", places[0]))
            via = angles_pose(*(float(via_fields[key]) for key in "XYZABC"))
            line = f"LIN {places[1]}"
        elif apo := re.fullmatch(rf"\$APO\.CDIS=({N})", line):
            zone = MS * float(apo[1])
        elif turn := re.fullmatch(r"\$CIRC_TYPE=#(\w+)", line):
            rule = {"PATH": "path", "BASE": "space"}[turn[1]]
        fields = {key: float(value) for key, value in re.findall(rf"\b([A-Z]\d?) ({N})", line)}
        external = {key: value for key, value in fields.items() if key[0] == "E"}
        if setting := re.fullmatch(rf"\$VEL\.(\w+)=({N})", line):
            speeds[setting[1]] = float(setting[2])
        elif re.match(r"PTP |SPTP ", line):
            found.append(
                Move(False, np.array([fields[f"A{k}"] for k in range(1, 7)]), None, external)
            )
        elif time := re.fullmatch(rf"TIME_BLOCK PART = ({N})", line):
            found[-1] = found[-1]._replace(seconds=float(time[1]))
        elif line.startswith("LIN "):
            assert speeds["ORI1"] == speeds.get("ORI2", speeds["ORI1"])
            data = int(fields["S"]), int(fields["T"])
            pose = angles_pose(*(fields[key] for key in "XYZABC"))
            both = speeds["CP"], np.radians(speeds["ORI1"])
            found.append(
                Move(True, None, pose, external, data, np.nan, both, None, coupled, via, rule,
                     {"": 0.0, "C_DIS": zone}.get(written.rpartition("}")[2].strip(), np.inf))
            )  # fmt: skip
    return Text(found, *(None if m is None else angles_pose(*numbers(re.sub("[A-Z]", "", m[1])))
                         for m in stated))  # fmt: skip


def _ls(text: str) -> Text:
    points = dict(re.findall(r"^P\[(\d+)\]\{(.*?)\};", text, re.S | re.M))
    in_base, found = "UFRAME_NUM=0" in text, list[Move]()
    pattern = (
        r":\s*([JLC])\s*(?:P\[(\d+)\]\n\s*:\s*)?P\[(\d+)\]\s*\+?(\S+?)\s*(FINE|CNT\d+)\s*"
        r"(COORD|RTCP|)\s*;"
    )
    for word, between, number, how, end, option in re.findall(pattern, text):
        assert bool(between) == (word == "C")
        via = _fanuc_place(points[between]) if between else None
        first, _, second = points[number].partition("GP2:")
        fields = {key: float(value) for key, value in re.findall(_SHOWN, first)}
        external = {key: value for key, value in fields.items() if key[0] == "E"}
        more = re.findall(_SHOWN, second)
        external |= {f"GP2_{key}": float(value) for key, value in more}
        value, unit = float(re.match(N, how)[0]), how.lstrip("0123456789.")  # type: ignore[index]
        speed = value * {"mm/sec": MS, "cm/min": 1e-2 / 60.0}.get(unit, np.nan)
        seconds = value * {"msec": MS, "sec": 1.0}.get(unit, np.nan)
        theta = pose = None
        data: tuple[int, ...] = ()
        if "J1" in fields:
            theta = _fanuc_place(first)
        else:
            pose = _fanuc_place(first)
            letters, *turns = re.search(r"CONFIG\s*:\s*'([^']*)'", first)[1].split(",")  # type: ignore[index]
            data = (*(int(each in "FDB") for each in letters.split()), *map(int, turns))
        found.append(Move(word != "J", theta, pose, external, data, seconds, (speed, np.inf), None,
                          bool(option), via, "space", np.inf,
                          0.0 if end == "FINE" else int(end[3:]) / 100.0))  # fmt: skip
    of_poses = in_base and any(move.pose is not None for move in found)
    return Text(found, None, np.eye(4) if of_poses else None)


def _fanuc_place(inside: str) -> Array:
    """Shown angles, or a pose."""
    fields = {key: float(value) for key, value in re.findall(_SHOWN, inside)}
    if "J1" in fields:
        return np.array([fields[f"J{k}"] for k in range(1, 7)])
    return angles_pose(*(fields[key] for key in "XYZRPW"))


def _urscript(text: str) -> Text:
    found = list[Move]()
    words = r"^ +(move[jlpc]|start|cubic|line)\((\[.*)\) *$"
    for word, rest in re.findall(words, re.sub(" *#.*", "", text), re.M):
        groups = [numbers(each) for each in re.findall(r"\[([^\]]*)\]", rest)]
        given = {key: float(value) for key, value in re.findall(rf"(\w)=({N})", rest)}
        seconds, v = given.get("t", np.nan), given.get("v", np.nan)
        if word in ("cubic", "line"):
            seconds = float(rest.rpartition(",")[2])
        if word == "start" and found:  # where the robot is
            continue
        rates = np.array(groups[1]) if word in ("start", "cubic") else None
        via = np.array(groups[0]) if word == "movec" else None
        theta, ramp = np.array(groups[word == "movec"]), 0.0
        if word == "movej" and found and np.isnan(seconds):  # a trapezoid, or a triangle
            way = np.abs(theta - found[-1].theta).max()  # type: ignore[operator]
            reached = min(v, np.sqrt(given["a"] * way))
            seconds = way / reached + reached / given["a"]
            ramp = reached / given["a"] / seconds
        found.append(Move(word in ("movel", "movep", "movec"), theta, None, {}, (), seconds,
                          (v, np.inf), rates, False, via, "space",
                          given.get("r", 0.0), 1.0, ramp))  # fmt: skip
    return Text(found)


def along(s: float, ramp: float) -> float:
    """The share of the way at a share of the time, at constant acceleration on both ramps."""
    if s > 0.5:
        return 1.0 - along(1.0 - s, ramp)
    return (s - 0.5 * ramp if s >= ramp else 0.5 * s**2 / ramp) / (1.0 - ramp)


class Controller:
    """Executes the moves of a program."""

    def __init__(self, cell: Cell, program: Text) -> None:
        self.cell, self.model, self.program = cell, cell.model, program
        self.data = mujoco.MjData(cell.model)
        joint = [cell.model.joint(name) for name in cell.joints]
        self.own = [int(each.qposadr[0]) for each in joint]
        self.places = {
            axis: (int(cell.model.joint(name).qposadr[0]), scale)
            for axis, (name, scale) in cell.external.items()
        }

    def put(self, q: Array) -> None:
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)

    def frame(self, name: str) -> Array:
        body = self.data.body(name)
        return rigid(body.xmat.reshape(3, 3), body.xpos)

    @property
    def part(self) -> Array:
        return self.frame(self.cell.part)

    @property
    def site(self) -> Array:
        site = self.data.site(self.cell.tool)
        return rigid(site.xmat.reshape(3, 3), site.xpos)

    def joints(self, move: Move, q: Array) -> Array:
        """All joints at the point of a move: those of the arm, if it has a pose, as they are."""
        q = q.copy()
        for axis, value in move.external.items():
            place, scale = self.places[axis]
            q[place] = value / scale
        if move.theta is not None:
            theta = move.theta.copy()
            if self.cell.name.startswith("Fanuc"):
                theta[2] += theta[1]
            if self.cell.name == "ABB IRB 2400":
                theta[2] -= theta[1]
            theta = theta if self.cell.name.startswith("Universal") else np.radians(theta)
            q[self.own] = (theta - self.cell.offsets) * self.cell.signs
        return q

    def end(self, move: Move, q: Array, own_tool: Array) -> Array:
        """The pose of the tool on the part at the end of a move to joints q."""
        self.put(q)
        if move.pose is None:
            return np.linalg.inv(self.part) @ self.site
        tool, frame = self.program.tool, self.program.frame
        if tool is None and frame is None:
            return move.pose
        place = move.pose @ (np.eye(4) if tool is None else np.linalg.inv(tool) @ own_tool)
        return place if frame is None else self.base @ frame @ place

    @property
    def base(self) -> Array:
        """The controller's: of Fanuc at the height of the second axis."""
        base = self.frame("base")
        if self.cell.name.startswith("Fanuc"):
            base[:3, 3] += MS * HEIGHTS[self.cell.name] * base[:3, 2]
        return base

    def reach(self, q: Array, pose: Array) -> Array:
        """Newton's method of the arm's joints to a pose on the part, by MuJoCo's Jacobian."""
        J, of_part, q = np.zeros((6, self.model.nv)), np.zeros((6, self.model.nv)), q.copy()
        site, part = self.data.site(self.cell.tool).id, self.data.body(self.cell.part).id
        for _ in range(8):
            self.put(q)
            there, now = self.part @ pose, self.site
            turn = Rotation.from_matrix(there[:3, :3] @ now[:3, :3].T).as_rotvec()
            off = np.append(there[:3, 3] - now[:3, 3], turn)
            if np.abs(off).max() < 1e-9:
                return q
            mujoco.mj_jacSite(self.model, self.data, J[:3], J[3:], site)
            mujoco.mj_jac(self.model, self.data, of_part[:3], of_part[3:], there[:3, 3], part)
            q[self.own] += np.linalg.solve((J - of_part)[:, self.own], off)
        raise AssertionError("the joints do not follow")

    def run(self, most: int = 1_000_000) -> Motion:
        """At 1 ms, or at ``most`` instants of each move: a path is the same however slow it is."""
        first, *moves = self.program.moves
        q = self.joints(first, np.zeros(self.model.nq))
        self.put(q)
        own_tool = np.eye(4)
        if self.program.tool is not None:
            theta = np.degrees(self.cell.signs * q[self.own] + self.cell.offsets)
            own_tool = np.linalg.inv(self.base @ links(self.cell.name, theta)[-1]) @ self.site
        at, rates, clock = np.linalg.inv(self.part) @ self.site, first.rates, 0.0
        times, rows, poses, corners = [0.0], [q], [at], [0]
        for move in moves:
            there = self.joints(move, q)
            end = self.end(move, there, own_tool)
            via = None
            if move.via is not None:
                is_pose = move.via.ndim == 2
                between = move._replace(theta=None if is_pose else move.via,
                                        pose=move.via if is_pose else None)  # fmt: skip
                via = self.end(between, self.joints(between, q), own_tool)[:3, 3]
            way = length_of(at, end, via)
            first_turns = moved(at, end, np.array([0.0, 1e-3]), via, move.rule)[1]
            turn = 1e3 * Rotation.from_matrix(first_turns[0].T @ first_turns[1]).magnitude()
            seconds = move.seconds
            if np.isnan(seconds):
                seconds = max(way / move.speeds[0], turn / move.speeds[1])
            shares = np.linspace(0.0, 1.0, 1 + min(int(np.ceil(seconds / MS)), most))[1:]
            begin = q
            spots, turns = moved(at, end, shares, via, move.rule)
            for k, s in enumerate(shares):
                if move.straight:
                    near = q.copy()
                    for place, _ in self.places.values():
                        near[place] = begin[place] + s * (there[place] - begin[place])
                    pose = rigid(turns[k], spots[k])
                    then = self.reach(near, pose)
                else:
                    then = begin + along(s, move.ramp) * (there - begin)
                    if move.rates is not None and rates is not None:
                        then = begin + s**2 * (3.0 - 2.0 * s) * (there - begin)
                        one, two = s * (1.0 - s) ** 2, -(s**2) * (1.0 - s)
                        signs = self.cell.signs
                        then[self.own] += seconds * (one * rates + two * move.rates) * signs
                    self.put(then)
                    pose = np.linalg.inv(self.part) @ self.site
                assert np.abs(then - q)[self.own].max() < FASTEST, "the branch changes"
                q = then
                times.append(clock + s * seconds)
                rows.append(q)
                poses.append(pose)
            if move.straight and move.theta is not None:  # the configuration with all its turns
                assert np.abs(q - there).max() < np.radians(2e-3), "another configuration"
            clock += seconds
            corners.append(len(rows) - 1)
            at, rates = poses[-1], move.rates
        return Motion(np.array(times), np.array(rows), np.array(poses), corners)


def rounded(motion: Motion, moves: list[Move]) -> float:
    """How far a parabola about a corner passes it at most, m: within any zone it is nearest."""
    most, places = 0.0, motion.poses[:, :3, 3]
    for k, move in enumerate(moves[1:-1], start=1):
        sides = places[motion.corners[k] :: -1], places[motion.corners[k] :]
        counts = np.diff(motion.corners)[k - 1 : k + 1] + 1
        ways = [
            np.append(0.0, np.cumsum(np.linalg.norm(np.diff(side[:count], axis=0), axis=1)))
            for side, count in zip(sides, counts, strict=True)
        ]
        reach = move.share * min(move.zone, *(0.5 * way[-1] for way in ways))
        ends = [
            [np.interp(reach, way, side[:count, axis]) for axis in range(3)]
            for side, count, way in zip(sides, counts, ways, strict=True)
        ]
        most = max(most, 0.5 * float(np.linalg.norm(0.5 * np.sum(ends, axis=0) - sides[1][0])))
    return most


HEIGHTS = {
    "Fanuc LR Mate 200iD": 330.0, "Fanuc M-20iA": 525.0, "Fanuc M-710iC/50": 565.0,
    "Fanuc M-16iB/20": 525.0,
}  # fmt: skip
"""Of the second axis of data sheets, mm."""

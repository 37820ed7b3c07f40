"""Exported programs judged without this package: angles back from the text, poses by pinocchio.

python benchmarks/judged_programs.py FOLDER [ROBOTS]

With ROBOTS, a folder with checkouts of Universal_Robots_ROS2_Description and of ros-industrial's
abb, fanuc and kuka_experimental, it first runs qp-twist new, run and export for five robots and the
four toolpaths of benchmarks/toolpaths, in FOLDER; pairs that are there already stay as they are.

The judge imports nothing of qp_twist. It needs ``pip install pin xacro mcap`` in any environment.
It expands the robot's xacro file, reads joint values from the program by expressions of its own,
computes the poses of the task's frame by pinocchio's forward kinematics, reads the toolpath
(points, arcs, tool axes) from its file, and puts the placement, the approaches and the retreats of
the task file on it.
For each pair it prints the largest distance of the tool from the toolpath and the largest angle
between tool and stated axis, at the program's points and at nine places between every two, and the
largest distance of a point of the toolpath from the tool's path, so that nothing was left out.
"""

import csv
import itertools
import re
import shutil
import struct
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ENDINGS = (".script", ".mod", ".src", ".ls", ".mcap")
BETWEEN = 10
"""Parts of each step of the program."""
FINE = 5e-4
"""Spacing of points of the toolpath, m."""
TOOLPATHS = Path(__file__).parent / "toolpaths"
ROBOTS = {
    "ur": ("Universal_Robots_ROS2_Description/urdf/ur.urdf.xacro", "urscript", "-0.5,0,0.2"),
    "abb": ("abb/abb_irb2400_support/urdf/irb2400.xacro", "rapid", "1.0,0,0.8"),
    "kuka": ("kuka_experimental/kuka_kr16_support/urdf/kr16_2.xacro", "krl", "1.1,0,0.8"),
    "fanuc": ("fanuc/fanuc_m20ia_support/urdf/m20ia.xacro", "ls", "1.1,0,0.6"),
    "iiwa": (
        "kuka_experimental/kuka_lbr_iiwa_support/urdf/lbr_iiwa_14_r820.xacro",
        "mcap",
        "0.55,0,0.4",
    ),
}
"""File of a robot, language of its program, and place of the toolpath, m."""
COUPLED = {"ABB IRB 2400": (2, 1, -1.0), "Fanuc M-20iA": (2, 1, 1.0)}
"""Joint of the URDF = axis + factor · other axis: rods of the maker, as in ros-industrial."""


# ---------------------------------------------------------------- pairs


def made(folder: Path, robots: Path) -> None:
    """Write tasks, trajectories and programs that are missing."""
    folder.mkdir(exist_ok=True, parents=True)
    for toolpath in sorted(TOOLPATHS.iterdir()):
        shutil.copy(toolpath, folder)
        for name, (file, language, place) in ROBOTS.items():
            pair = f"{name}_{toolpath.stem}"
            if any((folder / f"{pair}{ending}").exists() for ending in ENDINGS):
                continue
            more = ["--rotary", "head-bc"] if toolpath.suffix == ".nc" else []
            if name == "ur":
                more += ["--arg", "name:=ur5e", "--arg", "ur_type:=ur5e", "--package",
                         f"ur_description={robots / file.partition('/')[0]}"]  # fmt: skip
            for words in (
                ["new", str(robots / file), "--frame", "tool0", "--path", toolpath.name,
                 f"--place={place}", "--out", f"{pair}.toml", "--force", *more],
                ["run", f"./{pair}.toml", "--out", f"{pair}.csv"],
                ["export", f"{pair}.csv", f"./{pair}.toml", "--to", language],
            ):  # fmt: skip
                subprocess.run(["qp-twist", *words, "--quiet"], cwd=folder, check=True)


# ---------------------------------------------------------------- robots


def urdf_of(task: dict[str, Any], folder: Path) -> str:
    """The text of the task's robot file, expanded."""
    import xacro
    import xacro.substitution_args

    robot = task["robot"]
    file = (folder / robot["scene"]).resolve()
    packages = {name: (folder / at).resolve() for name, at in robot.get("packages", {}).items()}

    def found(name: str) -> str:
        if name in packages:
            return str(packages[name])
        for parent in file.parents:
            for near in (parent, *parent.glob("*")):
                if near.name == name and (near / "package.xml").exists():
                    return str(near)
        raise SystemExit(f"{file}: package {name} is not beside it")

    xacro.substitution_args._eval_find = found
    arguments = {key: str(value) for key, value in robot.get("arguments", {}).items()}
    text: str = xacro.process_file(str(file), mappings=arguments).toxml()
    return text


# ---------------------------------------------------------------- programs


def rows_of(file: Path) -> tuple[Array, str]:
    """Joint values as the controller shows them, rad, (N, n), and the robot of the header."""
    if file.suffix == ".mcap":
        return bag_rows(file), ""
    text = file.read_text("utf-8")
    robot = re.search(r"robot: (.+?)\s*;?\s*$", text, re.M)
    number = r"(-?\d+\.?\d*)"
    rows: list[Any]
    if file.suffix == ".script":
        rows = re.findall(r"^  (?:start|cubic|line)\(\[([^\]]+)\]", text, re.M)
        rows = [[float(x) for x in row.split(",")] for row in rows]
        return np.array(rows), robot[1] if robot else ""
    if file.suffix == ".mod":
        rows = [row.split(",") for row in re.findall(r"MoveAbsJ \[\[([^\]]+)\]", text)]
    elif file.suffix == ".src":
        rows = re.findall(rf"^S?PTP \{{A1 {number},A2 {number},A3 {number},A4 {number},A5 {number},"
                          rf"A6 {number}\}}", text, re.M)  # fmt: skip
    else:
        points = dict(re.findall(r"^P\[(\d+)\]\{(.*?)^\};", text, re.M | re.S))
        order = re.findall(r"^J P\[(\d+)\]", re.sub(r"^\s*\d+:\s*", "", text, flags=re.M), re.M)
        rows = [re.findall(rf"J\d= *{number} deg", points[k]) for k in order]
    return np.radians(np.array(rows, dtype=np.float64)), robot[1] if robot else ""


def bag_rows(file: Path) -> Array:
    """Positions of the one JointTrajectory in a bag, from its bytes (CDR, little endian)."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        (data,) = (message.data for _, _, message in make_reader(stream).iter_messages())
    at = 4 + 8  # encapsulation, stamp; alignment counts from byte 4

    def integer() -> int:
        nonlocal at
        at += -(at - 4) % 4
        at += 4
        return int(struct.unpack_from("<I", data, at - 4)[0])

    def string() -> None:
        nonlocal at
        length = integer()
        at += length

    def numbers() -> list[float]:
        nonlocal at
        count = integer()
        if not count:
            return []
        at += -(at - 4) % 8
        at += 8 * count
        return list(struct.unpack_from(f"<{count}d", data, at - 8 * count))

    string()
    for _ in range(integer()):
        string()
    rows = []
    for _ in range(integer()):
        rows.append(numbers())
        for _ in range(3):
            numbers()
        integer(), integer()
    return np.array(rows)


# ---------------------------------------------------------------- toolpaths


def curves_of(file: Path) -> list[Array]:
    """The curves of a toolpath: x, y, z in m, and the direction from the tip to the holder."""
    text = file.read_text("utf-8")
    if file.suffix == ".apt":
        return [apt(text)]
    if file.suffix == ".nc":
        return [gcode(text)]
    curves: list[list[list[float]]] = [[]]
    marks = ";" if ";" in text else ","
    for row in csv.reader(text.splitlines(), delimiter=marks):
        if not row:
            curves.append([])
        elif re.fullmatch(r"-?[\d.]+", row[0]):
            curves[-1].append([float(x) for x in row[:6]])
    return [np.array(c) * [1e-3, 1e-3, 1e-3, 1, 1, 1] for c in curves if c]


def apt(text: str) -> Array:
    """GOTO and CIRCLE with a GOTO after it, in mm."""
    points: list[Array] = []
    axis, circle = np.array([0.0, 0.0, 1.0]), None
    for word, rest in re.findall(r"^(GOTO|CIRCLE)/(.*)$", text, re.M):
        numbers = np.array([float(x) for x in rest.split(",")])
        if word == "CIRCLE":
            circle = numbers
            continue
        axis = numbers[3:] if len(numbers) == 6 else axis
        if circle is not None:
            centre, up = circle[:3], circle[3:6]
            begin, end = points[-1][:3] - centre, numbers[:3] - centre
            angle = np.arctan2(up @ np.cross(begin, end), begin @ end) % (2.0 * np.pi)
            for t in np.linspace(0.0, angle, 200)[1:-1]:
                turned = np.cos(t) * begin + np.sin(t) * np.cross(up, begin)
                points.append(np.concatenate([centre + turned, axis]))
            circle = None
        points.append(np.concatenate([numbers[:3], axis]))
    return np.array(points) * [1e-3, 1e-3, 1e-3, 1, 1, 1]


def gcode(text: str) -> Array:
    """G0 and G1 in mm with a head that turns about z (C), then y (B)."""
    now, points = dict.fromkeys("XYZBC", np.nan) | {"B": 0.0, "C": 0.0}, []
    for line in text.splitlines():
        words = re.findall(r"([XYZBC])(-?\d+\.?\d*)", re.sub(r"\(.*?\)", "", line))
        if not words or line.startswith("O"):
            continue
        last = dict(now)
        now |= {key: float(value) for key, value in words}
        if np.isnan([now[key] for key in "XYZ"]).any():
            continue
        for share in np.linspace(0.0, 1.0, 51)[1:] if points else [1.0]:
            x, y, z, b, c = (last[k] + share * (now[k] - last[k]) if share < 1 else now[k]
                             for k in "XYZBC")  # fmt: skip
            b, c = np.radians([b, c])
            axis = np.array([np.cos(c) * np.sin(b), np.sin(c) * np.sin(b), np.cos(b)])
            points.append(np.concatenate([1e-3 * np.array([x, y, z]), axis]))
    return np.array(points)


def about(axis: int, angle: float) -> Array:
    """The rotation about a coordinate axis, (3, 3)."""
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return turn


def path_of(task: dict[str, Any], folder: Path) -> Array:
    """The toolpath in the robot's world, every ``FINE``, with leads: position and tool's z."""
    section = task["path"]
    legs: list[Array] = []
    for curve in curves_of(folder / section["file"]):
        first, last = curve[:1].copy(), curve[-1:].copy()
        if "approach" in section:
            first[:, :3] += section["approach"]["distance"] * first[:, 3:]
            last[:, :3] += section["retreat"]["distance"] * last[:, 3:]
            legs += [first, curve, last]
        else:
            legs.append(curve)
    rough = np.concatenate(legs)
    placement = section.get("placement", {})
    r, p, y = np.radians(placement.get("rpy_deg", [0.0, 0.0, 0.0]))
    turn = about(2, y) @ about(1, p) @ about(0, r)
    positions = rough[:, :3] @ turn.T + np.array(placement.get("position", [0.0, 0.0, 0.0]))
    axes = -rough[:, 3:] / np.linalg.norm(rough[:, 3:], axis=1)[:, None] @ turn.T
    found = [np.concatenate([positions[:1], axes[:1]], axis=1)]
    for k in range(1, len(positions)):
        parts = max(1, int(np.ceil(np.linalg.norm(positions[k] - positions[k - 1]) / FINE)))
        u = np.arange(1, parts + 1)[:, None] / parts
        begin, end = axes[k - 1], axes[k]
        angle = np.arctan2(np.linalg.norm(np.cross(begin, end)), begin @ end)
        shares = (1.0 - u, u)
        if angle > 1e-6:  # along the great circle
            shares = (np.sin((1.0 - u) * angle) / np.sin(angle), np.sin(u * angle) / np.sin(angle))
        axis = shares[0] * begin + shares[1] * end
        place = positions[k - 1] + u * (positions[k] - positions[k - 1])
        found.append(np.concatenate([place, axis], axis=1))
    return np.concatenate(found)


# ---------------------------------------------------------------- the judgement


def apart(points: Array, line: Array) -> tuple[Array, Array]:
    """Distance, m, and angle, rad, of points (N, 6) from a fine line (M, 6).

    Where the line passes a place twice, the pass whose direction fits.
    """
    a, b = line[:-1], line[1:]
    along = b[:, :3] - a[:, :3]
    squares = np.maximum((along**2).sum(axis=1), 1e-18)
    distance, angle = np.empty(len(points)), np.empty(len(points))
    for k, point in enumerate(points):
        u = np.clip(((point[:3] - a[:, :3]) * along).sum(axis=1) / squares, 0.0, 1.0)[:, None]
        off = np.linalg.norm(point[:3] - a[:, :3] - u * along, axis=1)
        axis = a[:, 3:] + u * (b[:, 3:] - a[:, 3:])
        sine = np.linalg.norm(np.cross(axis, point[3:]), axis=1)
        turned = np.arctan2(sine, axis @ point[3:])
        best = int(np.argmin((off / 1e-4) ** 2 + (turned / np.radians(0.05)) ** 2))
        distance[k], angle[k] = off[best], turned[best]
    return distance, angle


def judged(file: Path) -> str:
    """The line of the table for a task file."""
    import pinocchio

    task = tomllib.loads(file.read_text("utf-8"))
    program = next(p for e in ENDINGS if (p := file.with_suffix(e)).exists())
    model = pinocchio.buildModelFromXML(urdf_of(task, file.parent))
    data = model.createData()
    frame = model.getFrameId(task["robot"]["frame"])
    rows, robot = rows_of(program)
    if robot in COUPLED:
        joint, other, factor = COUPLED[robot]
        rows[:, joint] += factor * rows[:, other]
    u = np.arange(BETWEEN)[:, None] / BETWEEN
    q = np.concatenate([*(a + u * (b - a) for a, b in itertools.pairwise(rows)), rows[-1:]])
    poses = []
    for row in q:
        pinocchio.framesForwardKinematics(model, data, row)
        pose = data.oMf[frame]
        poses.append(np.concatenate([pose.translation, pose.rotation[:, 2]]))
    tool, path = np.array(poses), path_of(task, file.parent)
    distance, angle = apart(tool, path)
    left_out = apart(path[::2], tool)[0]
    at = slice(None, None, BETWEEN)
    return (
        f"| {robot or file.stem.partition('_')[0]} | {task['path']['file']} | `{program.suffix}` | "
        f"{len(rows)} | {1e3 * distance[at].max():.4f} | {1e3 * distance.max():.4f} | "
        f"{np.degrees(angle.max()):.4f} | {1e3 * left_out.max():.4f} |"
    )


def main(folder: Path) -> None:
    """Print the table of all task files of a folder that have a program."""
    print("| robot | toolpath | program | points | off at points, mm | off between, mm | axis, ° | "
          "left out, mm |\n| :-- | :-- | :-- | --: | --: | --: | --: | --: |")  # fmt: skip
    for file in sorted(folder.glob("*.toml")):
        print(judged(file), flush=True)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        made(Path(sys.argv[1]), Path(sys.argv[2]).resolve())
    main(Path(sys.argv[1]))

"""Points and poses of other programs: robots' tables, recorders, point clouds.

The positions and rotations are those from which the text is written, in metres; Euler angles are
products of rotations about single axes, and rotations from quaternions and vectors are scipy's.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import Array, TruePath, case

T = np.linspace(0.0, 1.0, 12)
BENT = np.column_stack([0.7 + 0.1 * np.sin(3.0 * T), 0.3 * T - 0.1, 0.4 + 0.05 * T**2])
"""Positions, m."""
NORMALS = np.column_stack([0.3 * np.sin(2.0 * T), 0.4 * np.cos(3.0 * T), 0.9 + 0.0 * T])
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
DOWN = np.column_stack([178.0 + 4.0 * T, 20.0 * T - 5.0, 40.0 * T - 90.0])
"""Angles about x, y, z of a tool that points down, degrees."""
SLOPE = np.column_stack([3.0 * T, 10.0 * T, 30.0 * T])
"""The same of one that points up."""


def about(axis: str, degrees: Array) -> Array:
    """Rotations about a coordinate axis, (N, 3, 3)."""
    return Rotation.from_euler(axis, degrees[:, None], degrees=True).as_matrix()


def zyx(angles: Array) -> Array:
    """R = Rz Ry Rx of angles about x, y, z, degrees."""
    return about("z", angles[:, 2]) @ about("y", angles[:, 1]) @ about("x", angles[:, 0])


def rows(*columns: Array, digits: int = 7, mark: str = ",") -> str:
    """The lines of a table."""
    table = np.column_stack(columns)
    return "".join(mark.join(f"{v:.{digits}f}" for v in row) + "\n" for row in table)


XYZW = Rotation.from_matrix(zyx(DOWN)).as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]
UPRIGHT = Rotation.from_matrix(zyx(SLOPE)).as_quat()


def poses(angles: Array = DOWN) -> list[TruePath]:
    return [TruePath(BENT, rotations=zyx(angles))]


@case("RoboDK", "Import-CSV-XYZWPR.csv", rows(1e3 * BENT, DOWN, np.arange(12), mark=", "))
def robodk_poses() -> list[TruePath]:
    return poses()


SPEEDS = ["100"] + [""] * 11


@case("RoboDK", "LineXYZS.csv", "".join(f"{line},{speed}\n" for line, speed in zip(
    rows(1e3 * BENT, digits=4).splitlines(), SPEEDS, strict=True)))  # fmt: skip
def robodk_speeds() -> list[TruePath]:
    # mm and mm/s, and a speed holds until the next one: RoboDK's macro for such files.
    return [TruePath(BENT, feed=0.1)]


@case("RoboDK", "points.csv", rows(1e3 * BENT, digits=3, mark=" "))
def robodk_points() -> list[TruePath]:
    return [TruePath(np.round(BENT, 6))]


@case("CloudCompare", "section.asc", "//X,Y,Z,Nx,Ny,Nz\n" + rows(1e3 * BENT, NORMALS))
def cloudcompare_header() -> list[TruePath]:
    return [TruePath(BENT, NORMALS)]


@case("CloudCompare", "section.txt", "12\n" + rows(1e3 * BENT, NORMALS, mark=" "))
def cloudcompare_count() -> list[TruePath]:
    return [TruePath(BENT, NORMALS)]


@case("CloudCompare", "section.xyz", rows(
    1e3 * BENT, 255.0 * (T[:, None] > 0.5) + 0.0 * BENT, NORMALS, mark=" "))  # fmt: skip
def cloudcompare_colours() -> list[TruePath]:
    return [TruePath(BENT, NORMALS)]


@case("KUKA", "points.csv", "Name;X;Y;Z;A;B;C\n" + "".join(
    f"P{k};{line}\n" for k, line in enumerate(
        rows(1e3 * BENT, DOWN[:, ::-1], mark=";").replace(".", ",").splitlines())))  # fmt: skip
def kuka_points() -> list[TruePath]:
    # A turns about z, B about y, C about x.
    return poses()


ABC = DOWN[:, ::-1]


@case("KUKA", "recorder.csv", "Timestamp,X_RIst,Y_RIst,Z_RIst,A_RIst,B_RIst,C_RIst,"
      "X_RSol,Y_RSol,Z_RSol,A_RSol,B_RSol,C_RSol\n" + "".join(
    f"2026-01-01 10:00:{k:02},{line}\n" for k, line in enumerate(
        rows(1e3 * BENT, ABC, 1e3 * BENT + 0.2, ABC + 0.1).splitlines())))  # fmt: skip
def kuka_recorder() -> list[TruePath]:
    # RIst is where the robot was, RSol where it was meant to be.
    return poses()


@case("ABB", "targets.csv", "x,y,z,q1,q2,q3,q4\n" + rows(1e3 * BENT, WXYZ, digits=9))
def abb_targets() -> list[TruePath]:
    return poses()


@case("FANUC", "points.csv", "X,Y,Z,W,P,R\n" + rows(1e3 * BENT, DOWN))
def fanuc_points() -> list[TruePath]:
    return poses()


@case("Universal Robots", "record.csv", "timestamp "
      + " ".join(f"actual_TCP_pose_{k}" for k in range(6)) + " "
      + " ".join(f"target_TCP_pose_{k}" for k in range(6)) + "\n" + rows(
    0.008 * np.arange(12), BENT, Rotation.from_matrix(zyx(DOWN)).as_rotvec(),
    BENT + 1e-4, Rotation.from_matrix(zyx(DOWN)).as_rotvec() + 1e-3, mark=" "))  # fmt: skip
def universal_robots_record() -> list[TruePath]:
    return poses()


ROS = "field.pose.position.x,field.pose.position.y,field.pose.position.z," + ",".join(
    f"field.pose.orientation.{c}" for c in "xyzw"
)


@case("ROS", "echo.csv", f"%time,field.header.seq,field.header.stamp,{ROS}\n" + "".join(
    f"{1609060336768428032 + 10**8 * k},{k},{1609060336768428032 + 10**8 * k},{line}\n"
    for k, line in enumerate(rows(BENT, XYZW, digits=12).splitlines())))  # fmt: skip
def ros_echo() -> list[TruePath]:
    return poses()


@case("ROS", "juggler.csv", "__time," + ",".join(
    [f"/tool_path/pose/position/{c}" for c in "xyz"]
    + [f"/tool_path/pose/orientation/{c}" for c in "xyzw"]) + "\n" + rows(
    1.7e9 + 0.1 * np.arange(12), BENT, XYZW))  # fmt: skip
def ros_plotjuggler() -> list[TruePath]:
    return poses()


@case("IKLink", "input.csv", "time," + ",".join(
    [f"target-POS_{c}" for c in "XYZ"] + [f"target-ROT_{c}" for c in "XYZW"]) + "\n" + rows(
    T, BENT, XYZW))  # fmt: skip
def iklink() -> list[TruePath]:
    return poses()


START = BENT - BENT[0]


@case("Stampede", "motion", "".join(
    f"{t};{','.join(f'{v:.9f}' for v in p)};{','.join(f'{v:.9f}' for v in q)}\n"
    for t, p, q in zip(0.02 * T, START, UPRIGHT[:, [3, 0, 1, 2]], strict=True)))  # fmt: skip
def stampede() -> list[TruePath]:
    return [TruePath(START, rotations=zyx(SLOPE))]


@case("TUM", "groundtruth.txt", "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n"
      + rows(1.305e9 + T, BENT, XYZW, mark=" "))  # fmt: skip
def tum_header() -> list[TruePath]:
    return poses()


@case("TUM", "estimate.tum", rows(1.305e9 + T**2, BENT, XYZW, mark=" "))
def tum_bare() -> list[TruePath]:
    return poses()


@case("KITTI", "poses.txt", "".join(
    " ".join(f"{v:.9e}" for v in np.column_stack([turn, at]).ravel()) + "\n"
    for turn, at in zip(zyx(DOWN), BENT, strict=True)))  # fmt: skip
def kitti() -> list[TruePath]:
    return poses()


@case("Descartes", "puzzle.csv", " Line 1,,,,,,\n Line 2,,,,,,\n" + "".join(
    f"{k},{line}\n" for k, line in enumerate(
        rows(1e3 * BENT, NORMALS).splitlines(), start=1)))  # fmt: skip
def descartes() -> list[TruePath]:
    return [TruePath(BENT, NORMALS)]


@case("MATLAB", "up.csv", rows(1e3 * BENT, UPRIGHT))
def scalar_last_of_little_turned_frames() -> list[TruePath]:
    return [TruePath(BENT, rotations=zyx(SLOPE))]

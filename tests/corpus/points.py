"""Points and poses of other programs: robots' tables, recorders, point clouds.

The positions and rotations are those from which the text is written, in metres; Euler angles are
products of rotations about single axes, and rotations from quaternions and vectors are scipy's.
"""

import json

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


case("RoboDK", "Import-CSV-XYZWPR.csv", rows(1e3 * BENT, DOWN, np.arange(12), mark=", "), poses())
SPEEDS = ["100"] + [""] * 11
# mm and mm/s, and a speed holds until the next one: RoboDK's macro for such files.
case("RoboDK", "LineXYZS.csv", "".join(f"{line},{speed}\n" for line, speed in zip(
     rows(1e3 * BENT, digits=4).splitlines(), SPEEDS, strict=True)), [TruePath(BENT, feed=0.1)]
)  # fmt: skip
case("RoboDK", "points.csv", rows(1e3 * BENT, digits=3, mark=" "), [TruePath(np.round(BENT, 6))])
case("CloudCompare", "section.asc", "//X,Y,Z,Nx,Ny,Nz\n" + rows(1e3 * BENT, NORMALS),
     [TruePath(BENT, NORMALS)])  # fmt: skip
case("CloudCompare", "section.txt", "12\n" + rows(1e3 * BENT, NORMALS, mark=" "),
     [TruePath(BENT, NORMALS)])  # fmt: skip
case("CloudCompare", "section.xyz", rows(
     1e3 * BENT, 255.0 * (T[:, None] > 0.5) + 0.0 * BENT, NORMALS, mark=" "),
     [TruePath(BENT, NORMALS)])  # fmt: skip
# A turns about z, B about y, C about x.
case("KUKA", "points.csv", "Name;X;Y;Z;A;B;C\n" + "".join(
     f"P{k};{line}\n" for k, line in enumerate(
     rows(1e3 * BENT, DOWN[:, ::-1], mark=";").replace(".", ",").splitlines())), poses()
)  # fmt: skip


ABC = DOWN[:, ::-1]
# RIst is where the robot was, RSol where it was meant to be.
case("KUKA", "recorder.csv", "Timestamp,X_RIst,Y_RIst,Z_RIst,A_RIst,B_RIst,C_RIst,"
     "X_RSol,Y_RSol,Z_RSol,A_RSol,B_RSol,C_RSol\n" + "".join(
     f"2026-01-01 10:00:{k:02},{line}\n" for k, line in enumerate(
     rows(1e3 * BENT, ABC, 1e3 * BENT + 0.2, ABC + 0.1).splitlines())), poses())  # fmt: skip
case("ABB", "targets.csv", "x,y,z,q1,q2,q3,q4\n" + rows(1e3 * BENT, WXYZ, digits=9), poses())
# Angles about x, y, z of a tool that points down.
case("FANUC", "bare.txt", rows(1e3 * BENT, DOWN, mark=" "), poses())
# Angles about z, y, x of a tool that points down.
case("KUKA", "bare.txt", rows(1e3 * BENT, DOWN[:, ::-1], mark=" "), poses())
# Vectors of a tool that points down.
case("Universal Robots", "bare.txt", rows(BENT, Rotation.from_matrix(zyx(DOWN)).as_rotvec()),
     poses())  # fmt: skip
case("FANUC", "points.csv", "X,Y,Z,W,P,R\n" + rows(1e3 * BENT, DOWN), poses())
case("Universal Robots", "record.csv", "timestamp "
     + " ".join(f"actual_TCP_pose_{k}" for k in range(6)) + " "
     + " ".join(f"target_TCP_pose_{k}" for k in range(6)) + "\n" + rows(
     0.008 * np.arange(12), BENT, Rotation.from_matrix(zyx(DOWN)).as_rotvec(),
     BENT + 1e-4, Rotation.from_matrix(zyx(DOWN)).as_rotvec() + 1e-3, mark=" "), poses()
)  # fmt: skip


ROS = "field.pose.position.x,field.pose.position.y,field.pose.position.z," + ",".join(
    f"field.pose.orientation.{c}" for c in "xyzw"
)
case("ROS", "echo.csv", f"%time,field.header.seq,field.header.stamp,{ROS}\n" + "".join(
     f"{1609060336768428032 + 10**8 * k},{k},{1609060336768428032 + 10**8 * k},{line}\n"
     for k, line in enumerate(rows(BENT, XYZW, digits=12).splitlines())), poses())  # fmt: skip
case("ROS", "juggler.csv", "__time," + ",".join([f"/tool_path/pose/position/{c}" for c in "xyz"]
     + [f"/tool_path/pose/orientation/{c}" for c in "xyzw"]) + "\n" + rows(
     1.7e9 + 0.1 * np.arange(12), BENT, XYZW), poses())  # fmt: skip
case("IKLink", "input.csv", "time," + ",".join(
     [f"target-POS_{c}" for c in "XYZ"] + [f"target-ROT_{c}" for c in "XYZW"]) + "\n" + rows(
     T, BENT, XYZW), poses())  # fmt: skip
START = BENT - BENT[0]
case("Stampede", "motion", "".join(
     f"{t};{','.join(f'{v:.9f}' for v in p)};{','.join(f'{v:.9f}' for v in q)}\n"
     for t, p, q in zip(0.02 * T, START, UPRIGHT[:, [3, 0, 1, 2]], strict=True)),
     [TruePath(START, rotations=zyx(SLOPE))])  # fmt: skip
case("TUM", "groundtruth.txt", "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n"
     + rows(1.305e9 + T, BENT, XYZW, mark=" "), poses())  # fmt: skip
case("TUM", "estimate.tum", rows(1.305e9 + T**2, BENT, XYZW, mark=" "), poses())
case("KITTI", "poses.txt", "".join(
     " ".join(f"{v:.9e}" for v in np.column_stack([turn, at]).ravel()) + "\n"
     for turn, at in zip(zyx(DOWN), BENT, strict=True)), poses())  # fmt: skip
case("Descartes", "puzzle.csv", " Line 1,,,,,,\n Line 2,,,,,,\n" + "".join(
     f"{k},{line}\n" for k, line in enumerate(rows(1e3 * BENT, NORMALS).splitlines(), start=1)),
     [TruePath(BENT, NORMALS)])  # fmt: skip
# Scalar last of little turned frames.
case("MATLAB", "up.csv", rows(1e3 * BENT, UPRIGHT), [TruePath(BENT, rotations=zyx(SLOPE))])


# ---------------------------------------------------------------- point clouds


def ply(kind: str, names: str, types: str, body: bytes, count: int = 12) -> bytes:
    """A PLY file with the header of CloudCompare."""
    fields = "".join(
        f"property {form} {name}\n" for form, name in zip(types.split(), names.split(), strict=True)
    )
    head = f"ply\nformat {kind} 1.0\ncomment made by hand\nelement vertex {count}\n{fields}"
    return f"{head}end_header\n".encode() + body


def packed(types: str, *columns: Array) -> bytes:
    """Records of some numpy types, one after the other."""
    table = np.column_stack(columns)
    form = np.dtype([(f"f{k}", one) for k, one in enumerate(types.split())])
    return np.array([tuple(row) for row in table], form).tobytes()


NAMES = "x y z nx ny nz"
FLOATS = "float float float float float float"
FIELDS = f"x y z {' '.join(f'normal_{c}' for c in 'xyz')} curvature"
case("PLY", "text.ply", ply("ascii", NAMES, FLOATS, rows(1e3 * BENT, NORMALS, mark=" ").encode())
     .decode() + "\n", [TruePath(BENT, NORMALS)])  # fmt: skip
case("PLY", "little.ply", ply(
     "binary_little_endian", f"{NAMES} red", "double double double float float float uchar",
     packed("<f8 <f8 <f8 <f4 <f4 <f4 u1", 1e3 * BENT, NORMALS, 200.0 * T)),
     [TruePath(BENT, NORMALS)])  # fmt: skip
case("PLY", "big.ply", ply("binary_big_endian", NAMES, FLOATS,
     packed(">f4 >f4 >f4 >f4 >f4 >f4", BENT, NORMALS)), [TruePath(BENT, NORMALS)])  # fmt: skip


def pcd(kind: str, body: bytes, count: int = 12) -> bytes:
    """A PCD file with the header of the Point Cloud Library."""
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {FIELDS}\n"
        f"SIZE 4 4 4 4 4 4 4\nTYPE F F F F F F F\nCOUNT 1 1 1 1 1 1 1\nWIDTH {count}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {kind}\n"
    ).encode() + body


# A point that is not a number is none.
case("PCD", "text.pcd", pcd("ascii", (
     "nan nan nan nan nan nan nan\n" + rows(BENT, NORMALS, 0.0 * T, mark=" ")).encode(), 13)
     .decode(), [TruePath(BENT, NORMALS)])  # fmt: skip
case("PCD", "binary.pcd", pcd("binary", packed("<f4 " * 7, BENT, NORMALS, T)),
     [TruePath(BENT, NORMALS)])  # fmt: skip


def lzf(data: bytes) -> bytes:
    """Data packed by LZF without a copy, but for zeros: one, and a copy of it as far as they go."""
    out, at = bytearray(), 0
    while at < len(data):
        run = len(data[at : at + 100]) - len(data[at : at + 100].lstrip(b"\0"))
        if run > 9:
            out += bytes([0, 0, 7 << 5, run - 1 - 9, 0])
            at += run
        else:
            part = data[at : at + 8]
            out += bytes([len(part) - 1]) + part
            at += len(part)
    return bytes(out)


FIELD_AFTER_FIELD = np.column_stack([BENT, NORMALS, 0.0 * T]).T.astype("<f4").tobytes()
case("PCD", "compressed.pcd", pcd("binary_compressed", np.array(
     [len(lzf(FIELD_AFTER_FIELD)), len(FIELD_AFTER_FIELD)], "<u4").tobytes()
     + lzf(FIELD_AFTER_FIELD)), [TruePath(BENT, NORMALS)])  # fmt: skip


# ---------------------------------------------------------------- YAML and JSON


def pose_yaml(at: Array, turn: Array, indent: str = "") -> str:
    """A pose as ROS prints it."""
    lines = ["position:", *(f"  {c}: {v:.12f}" for c, v in zip("xyz", at, strict=True))]
    lines += ["orientation:", *(f"  {c}: {v:.12f}" for c, v in zip("xyzw", turn, strict=True))]
    return "".join(f"{indent}{line}\n" for line in lines)


HEADER = "header:\n  stamp:\n    sec: 12\n    nanosec: 5\n  frame_id: part\n"
case("YAML", "array.yaml", HEADER + "poses:\n"
     + "".join("- " + pose_yaml(at, turn, "  ")[2:] for at, turn in zip(BENT, XYZW, strict=True))
     + "---\n", poses())  # fmt: skip
case("YAML", "stamped.txt", "".join(f"{HEADER}pose:\n{pose_yaml(at, turn, '  ')}---\n"
     for at, turn in zip(BENT, XYZW, strict=True)), poses())  # fmt: skip
case("YAML", "path.yml", HEADER + "poses:\n" + "".join(
     "- header:\n    frame_id: part\n  pose:\n" + pose_yaml(at, turn, "    ")
     for at, turn in zip(BENT, XYZW, strict=True)), poses())  # fmt: skip
case("YAML", "rasters.yaml", "tool_paths:\n" + "".join("- poses:\n" + "".join(
     "  - " + pose_yaml(at, turn, "    ")[4:]
     for at, turn in zip(BENT[part], XYZW[part], strict=True))
     for part in (slice(0, 6), slice(6, 12))),
     [TruePath(BENT[part], rotations=zyx(DOWN)[part]) for part in (slice(0, 6), slice(6, 12))]
)  # fmt: skip
case("JSON", "points.json", json.dumps({"name": "edge", "points": (1e3 * BENT).tolist()}),
     [TruePath(BENT)])  # fmt: skip
case("JSON", "waypoints.json", json.dumps([
     {"id": k, "position": at.tolist(), "rpy": angles.tolist(), "speed_mm/s": 20.0}
     for k, (at, angles) in enumerate(zip(1e3 * BENT, DOWN, strict=True))], indent=2),
     [TruePath(BENT, rotations=zyx(DOWN), feed=0.02)])  # fmt: skip
case("JSON", "frames.json", json.dumps({f"target_{k}": np.vstack(
     [np.column_stack([turn, 1e3 * at]), [0, 0, 0, 1]]).tolist()
     for k, (turn, at) in enumerate(zip(zyx(DOWN), BENT, strict=True))}), poses())  # fmt: skip
case("JSON", "columns.json", json.dumps({"path": dict(zip(
     ["x", "y", "z", "qx", "qy", "qz", "qw"], np.column_stack([BENT, XYZW]).T.tolist(),
     strict=True)), "source": "planner"}), poses())  # fmt: skip
case("JSON", "lists.json", json.dumps(
     {"poses": np.column_stack([1e3 * BENT, UPRIGHT]).tolist()}, indent="\t"),
     [TruePath(BENT, rotations=zyx(SLOPE))])  # fmt: skip

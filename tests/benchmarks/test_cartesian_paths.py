"""The reader and the judge of public problems, on a problem of two joints with known answers."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from qp_twist.checks import Array

FOLDER = Path(__file__).parents[2] / "benchmarks"
COUNT = 11
JOINTS = np.column_stack([np.linspace(0.0, 0.5, COUNT), np.full(COUNT, 0.4)])
"""Two links of 1 m that turn about z: steps of 0.05 rad, which are 2.86 degrees."""
OFFSET = np.array([0.0, 0.0, 0.3])
RADIUS = 0.05
JOINT = (
    '<joint name="{name}" type="{type}"><parent link="{parent}"/><child link="{child}"/>'
    '<origin xyz="{at} 0 0"/><axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>'
)


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")
    monkeypatch.syspath_prepend(FOLDER)
    yield import_module("cartesian_paths")


def poses(q: Array) -> tuple[Array, Array]:
    """Positions (N, 3) of the tip and its angles about z (N,)."""
    a, b = q[:, 0], q.sum(axis=1)
    return np.column_stack([np.cos(a) + np.cos(b), np.sin(a) + np.sin(b), 0.0 * a]), b


def write_problem(folder: Path, *, box_y: float, frame: str = "world") -> None:
    """Two links and a fixed tip; a box of 0.2 m beside the first link's end, its face at box_y."""
    robot = [f'<link name="{name}"/>' for name in ("base", "upper", "lower", "tip", "finger")]
    robot += [
        JOINT.format(name="shoulder", type="continuous", parent="base", child="upper", at=0),
        JOINT.format(name="elbow", type="revolute", parent="upper", child="lower", at=1),
        JOINT.format(name="wrist", type="fixed", parent="lower", child="tip", at=1),
        JOINT.format(name="grip", type="prismatic", parent="tip", child="finger", at=0),
    ]
    position, angle = poses(JOINTS)
    # The problem's own turn, by a quarter about z, and its offset lead to the poses of JOINTS.
    half = 0.5 * (angle - 0.5 * np.pi)
    if frame != "world":
        position = position - [2.0, 0.0, 0.0]  # where the tip is at 0
    rows = ["time,x,y,z,qw,qx,qy,qz"]
    for k, (point, h) in enumerate(zip(position - OFFSET, half, strict=True)):
        numbers = [*point, np.cos(h), 0.0, 0.0, np.sin(h)]
        rows.append(",".join([str(k), *map(repr, map(float, numbers))]))
    files = {
        "cppflow/cppflow/problems/two__arc.yaml": f"""
robot: "two"
path_name: "arc"
path_offset_frame: "{frame}"
path_xyz_offset: [0, 0, 0.3]
path_R_offset: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
obstacle_xyz_offset: [0.9, 0, 0]
obstacles:
    [[size_x: 0.2, size_y: 0.2, size_z: 0.2, x: 0.1, y: {box_y + 0.1}, z: 0,
      roll: 0.0, pitch: 0.0, yaw: 0.0]]
""",
        "cppflow/cppflow/paths/arc.csv": "\n".join(rows),
        "jrl/jrl/urdfs/two.urdf": f'<robot name="two">{"".join(robot)}</robot>',
        "jrl/jrl/urdfs/link.txt": f"0.0, 0.0, 0.0, 1.0, 0.0, 0.0, {RADIUS}",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def read(script: ModuleType, folder: Path, **options: object) -> object:
    write_problem(folder, **options)
    return script.read_problem(folder / "cppflow", folder / "jrl", "two__arc", arms(script))


def arms(script: ModuleType) -> dict[str, object]:
    links = {"base": "link.txt", "upper": "link.txt", "lower": "link.txt"}
    arm = script.Arm("two.urdf", "tip", ("shoulder", "elbow"), links, (("base", "lower"),))
    return {"two": arm}


def judge(script: ModuleType, folder: Path, q: Array, *, box_y: float) -> dict[str, object]:
    return script.judged(read(script, folder, box_y=box_y), q)


@pytest.mark.parametrize("frame", ["world", "tip"])
def test_a_problem_is_read(script: ModuleType, tmp_path: Path, frame: str) -> None:
    problem = read(script, tmp_path, box_y=-0.4, frame=frame)
    task, model = problem.task, problem.task.model
    assert [model.joint(k).name for k in range(model.nq)] == ["shoulder", "elbow"]
    np.testing.assert_allclose(model.jnt_range, [[-np.pi, np.pi], [-2.0, 2.0]])
    position, angle = poses(JOINTS)
    np.testing.assert_allclose(task.positions, position, atol=1e-12)
    turns = np.array([w.rotation().as_matrix() for w in task.waypoints])
    np.testing.assert_allclose(turns[:, 0, 0], np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(turns[:, 1, 0], np.sin(angle), atol=1e-12)
    names = {frozenset(model.geom(g).name for g in pair) for pair in problem.pairs}
    assert names == {frozenset((f"{link} capsule", "box 1")) for link in ("upper", "lower")}
    assert {frozenset(name.split(" to ")) for name in task.constraints[0].names} <= names


def test_the_judge_measures_a_motion(script: ModuleType, tmp_path: Path) -> None:
    """At the start the upper link lies on the x-axis, 0.1 m and its radius above the box."""
    found = judge(script, tmp_path, JOINTS, box_y=-0.2 - 0.1 - RADIUS)
    assert found["valid"] and found["valid_between"]
    assert found["min_clearance_m"] == pytest.approx(0.1, abs=1e-6)
    assert found["length_rad"] == pytest.approx(0.5)
    assert found["max_step_deg"] == pytest.approx(np.degrees(0.05))
    moved = judge(script, tmp_path, JOINTS + np.array([0.0, 1e-3]), box_y=-0.4)
    assert moved["position_error_m"] == pytest.approx(1e-3, rel=1e-3) and not moved["valid"]
    assert moved["angle_error_deg"] == pytest.approx(np.degrees(1e-3))
    turned = judge(script, tmp_path, JOINTS + np.array([2.0 * np.pi, 0.0]), box_y=-0.4)
    assert turned["position_error_m"] < 1e-9 and not turned["valid"]  # out of its range


def test_what_touches_between_two_poses_is_noticed(script: ModuleType, tmp_path: Path) -> None:
    """The same poses with a joint that goes to the other side and back: the box is in the way."""
    problem = read(script, tmp_path, box_y=0.1)
    task = problem.task
    ends = np.array([[-0.4, 0.0], [0.9, 0.0]])
    data = script.mujoco.MjData(task.model)
    assert all(script._least_distance(problem, data, q) > 0.0 for q in ends)
    position, angle = poses(ends)
    turns = [script.mink.SO3.from_z_radians(a) for a in angle]
    waypoints = tuple(
        script.mink.SE3.from_rotation_and_translation(turn, point)
        for turn, point in zip(turns, position, strict=True)
    )
    problem = script.Problem(script.replace(task, waypoints=waypoints), problem.pairs)
    found = script.judged(problem, ends)
    assert found["position_error_m"] < 1e-9 and found["min_clearance_m"] < -0.05
    assert not found["valid"] and found["max_step_deg"] == pytest.approx(np.degrees(1.3))

"""Programs with external axes: rails and columns under the robot, positioners under the part."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.program_rows import random_rows
from oracles.railed_arm import railed_arm

import qp_twist as qt
from qp_twist.programs import DIALECTS
from qp_twist.robots import ExternalAxis, as_stated
from qp_twist.trajectories import TimedPath, check_trajectory, joints_of, read_trajectory
from qp_twist.trajectories import write_trajectory as write

NUMBER = r"-?\d+\.\d+"
AXES = {
    "rapid": ("eax_a", "eax_b"),
    "krl": ("E1", "E2"),
    "ls": ("E1", "GP2_J1"),  # of the robot, and of the part
}


def values_of(program: str, text: str) -> np.ndarray:
    """All axes of each target, by expressions of the test's own."""
    if program == "rapid":
        targets = re.findall(r"MoveAbsJ \[\[(.*?)\],\[(.*?),9E9,9E9,9E9,9E9\]\]", text)
        rows = [f"{own},{external}".split(",") for own, external in targets]
    elif program == "krl":
        rows = [
            re.findall(rf"(?:A|E)\d ({NUMBER})", target)
            for target in re.findall(r"\{(A1 .*?E2 .*?)\}", text)
        ]
    else:
        rows = [
            re.findall(rf"[JE]\d= ({NUMBER})", point)
            for point in re.findall(r"P\[\d+\]\{(.*?)\};", text, re.DOTALL)
        ]
    return np.array(rows, dtype=float)


@pytest.mark.parametrize("program", AXES)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_random_rails_and_positioners_there_and_back(
    tmp_path_factory: pytest.TempPathFactory, program: str, seed: int
) -> None:
    rows, joints = random_rows(seed, program)
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], 2)
    offsets = np.array(
        [round(rng.uniform(-2.0, 2.0), 3), np.radians(rng.choice([-90.0, 0.0, 45.0]))]
    )
    names = ("rail", "turn")
    joints = joints.with_external([
        ExternalAxis(name, slides, not slides, "", sign, offset)
        for name, slides, sign, offset in zip(names, (True, False), signs, offsets, strict=True)
    ])  # fmt: skip
    more = np.cumsum(rng.normal(scale=0.02, size=(len(rows.q), 2)), axis=0)
    rows = dataclasses.replace(
        rows, joint_names=(*rows.joint_names, *names), q=np.column_stack([rows.q, more])
    )
    path = tmp_path_factory.mktemp("external") / f"prog{DIALECTS[program].suffix}"
    text = write(rows, path, joints).read_text()
    shown = (signs * more + offsets) * [1e3, np.degrees(1.0)]
    assert np.abs(values_of(program, text)[:, 6:] - shown).max() <= 0.51e-4
    back = read_trajectory(path, rows.joint_names, joints)
    assert np.abs((back.q - rows.q) * np.array([*[np.degrees(1.0)] * 6, 1e3, 57.3])).max() < 1.01e-4
    # The header says which joint is which axis, where nothing else does.
    plain = joints.with_external([each._replace(sign=1.0, offset=0.0) for each in joints.external])
    same = read_trajectory(path, rows.joint_names, plain)
    assert same.q == pytest.approx(back.q, abs=1e-12)
    other = joints.with_external(as_stated(joints.external, ("E2 = rail", "E1 = turn")))
    with pytest.raises(qt.InvalidInput, match=r"no external axis|the header says"):
        read_trajectory(path, rows.joint_names, other)


def on_a_rail() -> qt.PathTask:
    """The deburring task with its arm on a rail, every fourth waypoint."""
    task = qt.load_task("deburring")
    none = np.full(7, np.inf)
    return dataclasses.replace(
        task, model=railed_arm(task), waypoints=task.waypoints[::8], flipped_waypoints=None,
        durations=np.append(0.0, task.durations[8::8] * 8.0), start=np.append(0.0, task.start),
        velocity_limits=none, acceleration_limits=none,
    )  # fmt: skip


def test_a_rail_is_written_and_checked(tmp_path: Path) -> None:
    task = on_a_rail()
    assert task.known_limits is not None  # the arm behind the rail is recognised
    robot, speeds, _ = task.known_limits
    assert robot.name == "Fanuc M-16iB/20"
    assert speeds[0] == np.inf
    joints = joints_of(task, ("rail",))
    assert joints.external == (ExternalAxis("rail", slides=True, on_part=False),)
    trajectory = qt.refine_trajectory(qt.follow(task, "qp_gradient", slow_down=True))
    rows = TimedPath.of(qt.time_trajectory(trajectory))
    assert np.ptp(rows.q[:, 0]) > 0.01
    path = write(rows, tmp_path / "rail.ls", joints)
    text = path.read_text()
    behind = 1e-3 * np.abs(np.diff(rows.q[:, 0]) / np.diff(rows.times)).max()  # a millisecond
    assert values_of("ls", text)[:, 6] == pytest.approx(1e3 * rows.q[:, 0], abs=1e3 * behind + 1e-4)
    check = check_trajectory(read_trajectory(path, None, joints), task)
    assert check.passes, check.verdict
    assert "E1 = rail in mm" in "; ".join(check.notes)
    for change, words in (
        (lambda t: re.sub(rf"(E1= {NUMBER}) mm", r"\1 deg", t), "slides: expected mm"),
        (lambda t: re.sub(rf",\s*E1= {NUMBER} mm", "", t), "does not state the external axis E1"),
        (lambda t: t.replace("E1 = rail in mm", "E1 = -rail in mm"), None),
        (lambda t: re.sub(rf"E1= ({NUMBER}) mm", "E1= 0.0000 mm", t), None),
    ):
        path.write_text(change(text))
        if words is not None:
            with pytest.raises(qt.InvalidInput, match=words):
                read_trajectory(path, None, joints)
        else:
            assert not check_trajectory(read_trajectory(path, None, joints), task).passes
    path.write_text(text)
    stated = joints_of(task, ("rail",), external=["E2 = rail"])
    with pytest.raises(qt.InvalidInput, match=r"the header says E1 = rail in mm, .* E2 = rail"):
        read_trajectory(path, None, stated)
    modelled = joints_of(task, ("rail",), as_modelled=True)
    with pytest.raises(qt.InvalidInput, match="moves the robot's 6 joints alone"):
        write(rows, tmp_path / "rail.script", modelled)
    assert "eax_a = rail in mm" in write(rows, tmp_path / "rail.mod", modelled).read_text()


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        (["E1 = rails"], "the joints besides those of the arm that the path needs are rail"),
        (["E1 = rail + 5 deg"], r"perhaps with \+ NUMBER mm"),
        (["E1 rail"], "expected AXIS = JOINT"),
        (["E1 = rail", "E2 = rail"], "no external axis E2|one stands twice"),
        (["E9 = rail"], r"no external axis E9, .* E1, E2, E3, GP2_J1"),
    ],
)
def test_equations_of_external_axes_that_are_none(
    stated: list[str], words: str, tmp_path: Path
) -> None:
    with pytest.raises(qt.InvalidInput, match=words):
        joints = joints_of(on_a_rail(), ("rail",), external=stated)
        write(
            TimedPath(("rail",), np.zeros((2, 1)), np.array([0.0, 1.0])), tmp_path / "a.ls", joints
        )
        pytest.fail("joints were taken")

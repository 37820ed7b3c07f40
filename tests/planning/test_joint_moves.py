"""Joint moves between stretches of a path: clear of what is in the way, and inside all limits."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.joint_paths import joint_path
from oracles.walled_cell import CLEARANCE, SPEEDS, walled_task

import qp_twist as qt
from qp_twist.planning import JointMoveSearch, NoJointMove
from qp_twist.robots import controller_joints, named_robot
from qp_twist.trajectories import run_task
from qp_twist.trajectories.task_run import TaskRun

RAMP = 0.25
"""Time from rest to full speed that is assumed where no acceleration limit is known, s."""


def distances(task: qt.PathTask, q: np.ndarray) -> np.ndarray:
    """Distance of the nearest pair that may not touch, by MuJoCo, at rows q (N, nv), m, (N,)."""
    (clearance,) = task.clearances
    data = mujoco.MjData(task.model)
    found = []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        found.append(
            min(
                mujoco.mj_geomDistance(task.model, data, a, b, 0.05, None)
                for a, b in clearance.pairs
            )
        )
    return np.array(found)


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> qt.PathTask:
    return qt.load_task(walled_task(tmp_path_factory.mktemp("wall")))


@pytest.fixture(scope="module")
def run(task: qt.PathTask, tmp_path_factory: pytest.TempPathFactory) -> TaskRun:
    return run_task(task, "qp_gradient", tmp_path_factory.mktemp("run") / "wall.csv")


def test_the_joint_move_begins_at_the_retreat_and_ends_at_the_approach(task: qt.PathTask) -> None:
    assert task.joint_moves == (21,)
    assert task.positions[20] == pytest.approx([-0.25, 1.0, 0.47], abs=1e-12)
    assert task.positions[21] == pytest.approx([0.25, 1.0, 0.47], abs=1e-12)
    # 0.05 + 0.1 + 0.05 m on each side at 0.05 m/s.
    assert task.feed_time == pytest.approx(8.0)


def test_the_joints_would_hit_the_wall_if_they_moved_straight(run: TaskRun) -> None:
    q = run.trajectory.q
    first, last = 20, len(q) - 21
    u = np.linspace(0.0, 1.0, 200)[:, None]
    assert distances(run.trajectory.path_task, q[first] + u * (q[last] - q[first])).min() < -0.05


def test_the_motion_keeps_clear_at_20_points_a_step(run: TaskRun) -> None:
    assert run.timed is not None
    times = run.timed.times
    u = np.arange(20) / 20.0
    dense = (times[:-1, None] + u * np.diff(times)[:, None]).ravel()
    least = distances(run.trajectory.path_task, run.timed.at(dense).q).min()
    assert least >= CLEARANCE - 1e-4  # the tolerance of a check between rows


def test_the_motion_keeps_speeds_and_accelerations_at_every_millisecond(run: TaskRun) -> None:
    assert run.timed is not None
    t = np.arange(0.0, run.timed.times[-1], 1e-3)
    q = run.timed.at(t).q
    speeds = np.abs(np.diff(q, axis=0)) / 1e-3
    assert (speeds <= np.array(SPEEDS) * (1.0 + 1e-6)).all()
    # A mean over two milliseconds is no larger than the largest acceleration.
    accelerations = np.abs(np.diff(q, 2, axis=0)) / 1e-6
    assert (accelerations <= np.array(SPEEDS) / RAMP * (1.0 + 1e-3)).all()


def test_the_joint_move_is_from_rest_to_rest_and_as_fast_as_one_joint_may(run: TaskRun) -> None:
    assert run.timed is not None
    moves = np.flatnonzero(run.timed.trajectory.path.moves)
    first, last = run.timed.path_rows[[moves[0], moves[-1] + 1]]
    assert np.abs(run.timed.velocities[[first, last]]).max() < 1e-12
    took = run.timed.times[last] - run.timed.times[first]
    moved = np.abs(run.timed.q[last] - run.timed.q[first])
    a = np.array(SPEEDS) / RAMP
    least = float(np.max(2.0 * np.sqrt(moved / a)))  # straight, bang-bang: no speed limit is met
    assert (moved < np.array(SPEEDS) ** 2 / a).all()
    assert least < took < 2.0 * least


def test_the_file_passes_its_check_against_the_task(run: TaskRun, task: qt.PathTask) -> None:
    assert run.check is not None
    assert run.check.passes, run.check.problems
    assert run.timed is not None
    check = qt.check_trajectory(run.timed, task)
    assert check.passes, check.problems
    found = {finding.name: finding for finding in check.findings}
    assert found["time of joint moves"].where == "1 joint move"
    assert 0.3 < found["time of joint moves"].value < 1.2
    assert found["time"].where == "whole path, 8 s at the feed"


def test_a_program_of_it_keeps_clear_of_the_wall(task: qt.PathTask, tmp_path: Path) -> None:
    """Its angles read from the text; joints move straight from point to point."""
    joints = controller_joints(task.model, "tool", "site", named_robot("M-16iB/20"))
    program = tmp_path / "wall.ls"
    done = run_task(task, "qp_gradient", program, joints=joints)
    assert done.passes, done.check
    points = re.findall(r"^P\[\d+\]\{(.*?)^\};", program.read_text(), re.M | re.S)
    q = np.radians([[float(x) for x in re.findall(r"J\d= *(\S+) deg", p)] for p in points])
    q[:, 2] += q[:, 1]  # the forearm's angle to the floor
    u = np.arange(10)[:, None, None] / 10.0
    dense = (q[:-1] + u * np.diff(q, axis=0)).reshape(-1, 6)
    assert distances(task, dense).min() >= CLEARANCE - 1e-4
    assert np.abs(np.diff(q[:, 0])).sum() > np.radians(25.0)  # to the other side of the wall


def test_the_file_says_which_rows_are_a_joint_move(run: TaskRun, tmp_path: Path) -> None:
    assert run.timed is not None
    rows = qt.read_trajectory(qt.write_trajectory(run.timed, tmp_path / "wall.json"))
    [[first, last]] = rows.metadata["joint_moves"]
    data = mujoco.MjData(run.trajectory.path_task.model)
    tips = []
    for q in rows.q[[first - 1, last - 1]]:
        data.qpos[:] = q
        mujoco.mj_kinematics(run.trajectory.path_task.model, data)
        tips.append(data.site("tool").xpos.copy())
    assert np.array(tips) == pytest.approx(np.array([[-0.25, 1, 0.47], [0.25, 1, 0.47]]), abs=1e-6)


def test_a_check_finds_the_wall_on_a_straight_joint_move(run: TaskRun, task: qt.PathTask) -> None:
    q = run.trajectory.q[run.trajectory.at_waypoints]
    motion = qt.trajectories.JointMotion(np.arange(len(q), dtype=float), q)
    straight = dataclasses.replace(task, durations=None)
    found = {f.name: f for f in qt.referee.examine(straight, motion)}
    assert found["position error between"].passes
    assert not found["outside clearance between"].passes
    assert found["outside clearance between"].where.endswith(" to wall, waypoints 21 to 22")


def test_a_check_still_sees_the_path_beside_a_joint_move(run: TaskRun, task: qt.PathTask) -> None:
    q = run.trajectory.q.copy()
    q[20] += 1e-3  # the end of the retreat
    wrong = dataclasses.replace(run.trajectory, q=q)
    check = qt.check_trajectory(wrong, task)
    assert not check.passes
    assert any("position error" in problem for problem in check.problems)


def test_what_is_in_the_way_is_named_where_no_joint_move_is_found(tmp_path: Path) -> None:
    """A wall from in front of the arm to beyond its reach, and as high."""
    task = qt.load_task(walled_task(tmp_path, height=4.0, width=0.4))
    moves = JointMoveSearch(task)
    open_task = qt.load_task(walled_task(tmp_path, height=0.2))
    q = qt.follow(open_task).q
    with pytest.raises(NoJointMove, match=r"to wall would be outside clearance by .* 10 random"):
        moves.found(q[20], q[-21], 10)


def test_a_plan_moves_around_the_wall_too(task: qt.PathTask) -> None:
    plan = qt.plan(task)
    q = plan.motion()
    u = np.arange(20)[:, None, None] / 20.0
    dense = (q[:-1] + u * np.diff(q, axis=0)).reshape(-1, 6)
    assert distances(task, dense).min() >= CLEARANCE - 1e-4
    assert np.isfinite(plan.bound)
    assert plan.bound <= plan.value + 1e-9
    z = qt.kinematics.JointRanges.of(task.model).centering
    on_path = plan.at_waypoints
    assert len(on_path) == 42 < len(q)
    assert plan.value == pytest.approx(float(z(on_path).mean()))
    followed = qt.follow(task, "qp_planned", plan=plan)
    assert followed.path_task.joint_moves == task.joint_moves
    assert followed.position_error.max() < 1e-6


def slides(boxes: list[tuple[float, float, float, float]]) -> mujoco.MjModel:
    """A ball of 20 mm on slides along x and y, from −1 to 1 m, among boxes (x, y, half sizes)."""
    around = "".join(
        f'<geom name="box_{k}" type="box" pos="{x} {y} 0" size="{a} {b} 1"/>'
        for k, (x, y, a, b) in enumerate(boxes)
    )
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody>{around}
        <body><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
        <geom type="sphere" size="0.001" mass="1" contype="0" conaffinity="0"/>
        <body><joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
        <geom name="ball" type="sphere" size="0.02" mass="1"/><site name="tool"/></body></body>
        </worldbody></mujoco>"""
    )


SIZES = st.floats(0.02, 0.4)
PLACES = st.floats(-0.9, 0.9)


@given(
    st.lists(st.tuples(PLACES, PLACES, SIZES, SIZES), min_size=1, max_size=4),
    st.tuples(PLACES, PLACES),
    st.tuples(PLACES, PLACES),
)
@settings(max_examples=25, deadline=None)
def test_a_ball_among_random_boxes_touches_none(
    boxes: list[tuple[float, float, float, float]],
    begin: tuple[float, float],
    end: tuple[float, float],
) -> None:
    model = slides(boxes)
    rows = np.array([begin, end])
    task = joint_path(model, rows, None).path_task
    assert task.clearances
    try:
        q = JointMoveSearch(task).found(*rows, effort=200)
    except NoJointMove as error:
        assert "box_" in str(error)
        return
    assert (q[[0, -1]] == rows).all()
    assert np.abs(q).max() <= 1.0
    u = np.arange(20)[:, None, None] / 20.0
    points = np.vstack([(q[:-1] + u * np.diff(q, axis=0)).reshape(-1, 2), q[-1]])
    for x, y, a, b in boxes:
        beside = np.maximum(np.abs(points - [x, y]) - [a, b], 0.0)
        assert np.linalg.norm(beside, axis=1).min() >= 0.02 - 1.1e-5


def test_what_the_tool_works_on_is_not_touched_on_the_way() -> None:
    """The clearance ignores ball and box, since one works on the other, but not on joint moves."""
    model = slides([(0.0, 0.0, 0.2, 0.3)])
    rows = np.array([[-0.8, 0.0], [0.8, 0.0]])
    task = dataclasses.replace(
        joint_path(model, rows, None).path_task,
        constraints=(qt.Clearance(model, 0.01, ignore=[("ball", "box_0")]),),
        joint_moves=(1,),
    )
    q = JointMoveSearch(task).found(*rows)
    u = np.arange(20)[:, None, None] / 20.0
    points = (q[:-1] + u * np.diff(q, axis=0)).reshape(-1, 2)
    beside = np.maximum(np.abs(points) - [0.2, 0.3], 0.0)
    assert np.linalg.norm(beside, axis=1).min() >= 0.03 - 1.1e-5
    straight = qt.trajectories.JointMotion(np.arange(2.0), rows)
    found = {f.name: f for f in qt.referee.examine(task, straight)}
    assert not found["outside clearance on joint moves"].passes
    # In the middle the box is 0.2 m deep, the ball's radius is 0.02 m.
    assert found["outside clearance on joint moves"].value == pytest.approx(0.23, abs=1e-3)
    around = qt.trajectories.JointMotion(np.arange(float(len(q))), q)
    passing = qt.referee.Passing(around.times[[0, -1]], False, False)
    found = {f.name: f for f in qt.referee.examine(task, around, passing=passing)}
    assert found["outside clearance on joint moves"].passes


RETREAT = "[path.retreat]\ndistance = 0.05\nsteps = 5\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('motion = "joint"', 'motion = "jump"', "transfer.motion"),
        ('motion = "joint"', 'motion = "joint"\nblend = 2', "follows no path"),
        (
            'motion = "joint"',
            'motion = "joint"\nlinear = "full"\nangular = "none"',
            "follows no path",
        ),
        (
            "speed = 0.05",
            "speed = 0.05\nrapid = 0.5",
            r"feed\.rapid: it is for straight ways",
        ),
        (RETREAT, "", "begins and ends away from the part"),
    ],
)
def test_what_a_joint_move_cannot_have_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = walled_task(tmp_path)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(qt.TaskFileError, match=message):
        qt.load_task(file)


def test_joints_without_a_range_turn_the_short_way() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a" type="hinge" limited="false"/>
        <geom size="0.1" mass="1"/><body><joint name="b" type="hinge" range="-400 400"/>
        <geom size="0.1" mass="1"/><site name="tool"/></body></body></worldbody></mujoco>"""
    )
    task = joint_path(model, np.zeros((2, 2)), None).path_task
    q = JointMoveSearch(task).nearest_turn(np.array([[-3.0, -3.0], [-3.2, -3.2]]), np.full(2, 3.0))
    turn = 2.0 * np.pi
    assert q == pytest.approx(np.array([[turn - 3.0, -3.0], [turn - 3.2, -3.2]]))


def test_comparisons_refuse_joint_moves(task: qt.PathTask) -> None:
    with pytest.raises(qt.InvalidInput, match="compare: wall has joint moves"):
        qt.compare(task)


def test_rapid_points_of_a_file_end_joint_moves(tmp_path: Path) -> None:
    """G-code lifts, crosses, and comes down: the points in between give way to the joint move."""
    file = walled_task(tmp_path)
    (tmp_path / "edges.nc").write_text(
        "G21 G90\nG0 X-350 Y1000 Z500\nG1 Z420 F3000\nG1 X-250\nG0 Z480\nG0 X-250 Y900 Z520\n"
        "G0 X250 Y900 Z520\nG0 X250 Y1000 Z480\nG1 Z420\nG1 X350\nG0 Z500\n"
    )
    text = file.read_text().replace('"edges.csv"', '"edges.nc"\nrapids = "keep"')
    for table in ("approach", "retreat"):
        text = text.replace(f"[path.{table}]\ndistance = 0.05\nsteps = 5\n", "")
    file.write_text(text)
    task = qt.load_task(file)
    (to,) = task.joint_moves
    assert task.positions[to - 1] == pytest.approx([-0.25, 1.0, 0.48])
    assert task.positions[to] == pytest.approx([0.25, 1.0, 0.48])
    assert not (np.abs(task.positions[:, 1] - 0.9) < 0.05).any()


def test_the_travel_of_a_plan_counts_the_joint_move(task: qt.PathTask) -> None:
    plan = qt.plan(task, "travel")
    assert plan.value == pytest.approx(np.degrees(np.abs(np.diff(plan.motion(), axis=0)).sum()))
    assert plan.bound <= plan.value
    assert all(finding.passes for finding in plan.examined() if "clearance" in finding.name)

"""No move of a program is shorter than its controller's interpolation period."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.programs import DIALECTS
from qp_twist.trajectories import TimedPath, joints_of, write_checked, write_trajectory

PERIODS = {"rapid": 0.004, "krl": 0.012, "ls": 0.008}
TIMES = {
    "rapid": (r"\\T:=([\d.]+),", 1.0),
    "krl": (r"TIME_BLOCK PART = ([\d.]+)", 1.0),
    "ls": (r"J P\[\d+\] (\d+)msec", 1e-3),
}


def durations(program: str, text: str) -> np.ndarray:
    pattern, unit = TIMES[program]
    return unit * np.array(re.findall(pattern, text), dtype=float)


@pytest.fixture(scope="module")
def planned() -> tuple[qt.PathTask, TimedPath]:
    """An eighth of the deburring run."""
    task = qt.load_task("deburring").part(slice(0, 51))
    run = qt.refine_trajectory(qt.follow(task, slow_down=True))
    return task, TimedPath.of(qt.time_trajectory(run))


@pytest.fixture(scope="module")
def dense(planned: tuple[qt.PathTask, TimedPath]) -> tuple[qt.PathTask, TimedPath]:
    """With a row each 1.5 ms, two of them ten times as close."""
    task, timed = planned
    times = np.arange(0.0, timed.times[-1], 1.5e-3)
    times = np.sort(np.concatenate([times, times[[100, 400]] + 1.5e-4, timed.times[-1:]]))
    return task, TimedPath(timed.joint_names, timed.at(times).q, times)


@pytest.mark.parametrize("program", PERIODS)
def test_rows_that_are_too_close_are_left_out_where_the_tool_stays(
    program: str, dense: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> None:
    task, rows = dense
    path, period = tmp_path / f"dense{DIALECTS[program].suffix}", PERIODS[program]
    joints = joints_of(task, rows.joint_names, as_modelled=program != "ls")
    check, written = write_checked(rows, path, task, joints)
    assert written and check.passes, check.verdict
    took = durations(program, path.read_text())
    assert took.min() >= period - 1e-9
    assert len(took) < 1.1 * (rows.times[-1] / period) < 0.6 * len(rows.q)
    assert took.sum() < 1.1 * rows.times[-1]
    assert "rows left out" in "; ".join(check.notes)
    # MuJoCo's tool on the straight moves of the program is where it was in the rows left out.
    data = mujoco.MjData(task.model)

    def tool(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.qpos[:] = q
        mujoco.mj_kinematics(task.model, data)
        return data.site("tool").xpos.copy(), data.site("tool").xmat[2::3].copy()

    moved = check.motion
    assert moved.times[-1] == pytest.approx(took.sum())
    planned = [tool(q) for q in rows.q]
    fine = np.linspace(0.0, moved.times[-1], 4 * len(rows.q))
    positions = np.array([place for place, _ in planned])
    for q in moved.at(fine).q[:: len(fine) // 300]:
        place, axis = tool(q)
        nearest = int(np.argmin(np.linalg.norm(positions - place, axis=1)))
        begin, end = positions[max(nearest - 1, 0)], positions[min(nearest + 1, len(positions) - 1)]
        along = (end - begin) / np.linalg.norm(end - begin)
        off = place - positions[nearest]
        # A fifth of 0.1 mm and 0.05°, and the digits that are cut off.
        assert np.linalg.norm(off - (off @ along) * along) < 0.2e-4 + 0.6e-5
        assert axis @ planned[nearest][1] > np.cos(np.radians(0.2 * 0.05 + 0.01))


def test_times_in_whole_milliseconds_leave_the_tool_its_speed(
    planned: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> None:
    task, rows = planned
    times = np.append(np.arange(0.0, rows.times[-1], 0.0133), rows.times[-1])
    rows = TimedPath(rows.joint_names, rows.at(times).q, times)
    path = tmp_path / "whole.ls"
    check, written = write_checked(rows, path, task, joints_of(task, rows.joint_names))
    assert written and check.passes, check.verdict
    places, data = [], mujoco.MjData(task.model)
    for q in check.motion.q:
        data.qpos[:] = q
        mujoco.mj_kinematics(task.model, data)
        places.append(data.site("tool").xpos.copy())
    took = durations("ls", path.read_text())
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / took
    # Rounded up, all 13.3 ms would be 14, and 47.5 mm/s; few are, whose rounded angles are longer.
    assert np.mean(np.abs(speeds / 0.05 - 1.0) < 0.02) > 0.95


def test_without_a_task_short_moves_take_a_period(
    dense: tuple[qt.PathTask, TimedPath], tmp_path: Path
) -> None:
    task, rows = dense
    joints = joints_of(task, rows.joint_names, as_modelled=True)
    text = write_trajectory(rows, tmp_path / "dense.src", joints).read_text()
    took = durations("krl", text)
    assert len(took) == len(rows.q) - 1
    assert took.min() >= 0.012 - 1e-9  # some more where a rounded angle would be faster
    assert took == pytest.approx(0.012, abs=3e-4)
    assert "; spacing: 0 rows left out" in text
    # A script divides time itself.
    script = write_trajectory(rows, tmp_path / "dense.script", joints).read_text()
    assert len(re.findall(r"^  line\(", script, re.MULTILINE)) == len(rows.q) - 1
    assert "spacing" not in script


def test_a_row_where_the_tool_turns_back_is_kept(tmp_path: Path) -> None:
    task = qt.load_task("deburring")
    q = np.tile(task.start, (5, 1))
    q[2, 0] += 0.01  # out and back in 4 ms
    rows = TimedPath(qt.JointRanges.of(task.model).names, q, 0.002 * np.arange(5.0))
    joints = joints_of(task, rows.joint_names)
    write_checked(rows, tmp_path / "back.ls", task, joints, force=True)
    text = (tmp_path / "back.ls").read_text()
    shown = np.array(re.findall(r"J1= (\S+) deg", text), dtype=float)
    assert np.degrees(q[:, 0].max()) == pytest.approx(shown.max(), abs=1e-4)
    assert durations("ls", text).min() >= 0.008

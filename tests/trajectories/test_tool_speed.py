"""The tool's speed against the programmed one: dips, ramps, their causes, and what avoids them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from oracles.joint_paths import evenly, joint_path, short, slider
from oracles.mounted_robots import mounted

import qp_twist as qt
from qp_twist.errors import InvalidInput, TaskFileError
from qp_twist.referee import (
    Passing,
    ToolSpeed,
    motion_limits,
    tool_speed,
    with_default_accelerations,
    with_default_jerks,
)
from qp_twist.trajectories import run_task, steady_trajectory

Array = np.ndarray
SPEED = 0.1  # m/s
COUNT = 101
LIMITS = {"velocity": 1.0, "acceleration": 2.0}


def line_task(**changes: object) -> qt.PathTask:
    """One metre along x in 10 s, a waypoint each centimetre."""
    q = np.zeros((COUNT, 2))
    q[:, 0] = np.linspace(0.0, 1.0, COUNT)
    task = joint_path(slider(2), q, evenly(COUNT, 0.1), **LIMITS).path_task
    return dataclasses.replace(task, **{"constant_speed": True, **changes})


def at_shares(shares: Array) -> qt.TimedPath:
    """The rows of the line with these shares of the speed from each to the next, (100,)."""
    q = np.zeros((COUNT, 2))
    q[:, 0] = np.linspace(0.0, 1.0, COUNT)
    times = np.append(0.0, np.cumsum(0.1 / shares))
    return qt.TimedPath(("slide_1", "slide_2"), q, times)


def speed_of(motion: qt.TimedPath, task: qt.PathTask) -> ToolSpeed:
    found = qt.check_trajectory(motion, task).speed
    assert found is not None
    return found


def test_a_dip_has_the_place_depth_time_and_length_that_were_made() -> None:
    shares = np.ones(100)
    shares[40:46] = (0.7, 0.5, 0.5, 0.25, 0.5, 0.9)
    found = speed_of(at_shares(shares), line_task())
    (dip,) = found.dips
    assert (dip.first, dip.last) == (41, 47)
    assert dip.lowest in (44, 45)
    assert dip.share == pytest.approx(0.25)
    assert dip.programmed == pytest.approx(SPEED)
    assert dip.seconds == pytest.approx((0.1 / shares[40:46]).sum())
    assert dip.length == pytest.approx(0.06)
    assert found.at_speed == pytest.approx(0.94)
    assert "slide_1" in str(dip) and "slide_2" not in str(dip)


@pytest.mark.parametrize(("most", "passes"), [(None, True), (0.8, True), (0.74, False)])
def test_a_dip_deeper_than_allowed_does_not_pass(most: float | None, passes: bool) -> None:
    shares = np.ones(100)
    shares[50] = 0.25
    check = qt.check_trajectory(at_shares(shares), line_task(max_dip=most))
    (finding,) = (f for f in check.findings if f.name == "dip of the tool's speed")
    assert finding.passes == passes
    assert finding.value == pytest.approx(75.0)
    assert any(note.startswith("dip: ") for note in check.notes)
    # Without a constant speed nobody asked for it; the file says nothing that counts.
    other = dataclasses.replace(line_task(), constant_speed=False)
    lying = dataclasses.replace(at_shares(shares), metadata={"task": "rows", "dips": []})
    assert not any("dip" in f.name for f in qt.check_trajectory(lying, other).findings)


def test_ramps_at_both_ends_are_no_dips_but_a_speed_held_below_is_one() -> None:
    up = np.linspace(0.1, 0.9, 5)
    shares = np.ones(100)
    shares[:5], shares[-5:] = up, up[::-1]
    found = speed_of(at_shares(shares), line_task())
    assert not found.dips and found.ramps == 2
    assert found.ramp_seconds == pytest.approx(2.0 * (0.1 / up).sum())
    assert found.ramp_length == pytest.approx(0.05)
    shares[5:30] = 0.6  # where it does not go on to the programmed speed
    (dip,) = speed_of(at_shares(shares), line_task()).dips
    assert dip.share == pytest.approx(0.6)
    assert dip.length == pytest.approx(0.26, abs=0.015)


@pytest.mark.parametrize("stops", [(0.0,), (0.0, 0.6), (0.0, 5.0)])
def test_a_stop_is_a_dip_but_where_a_ramp_begins(stops: tuple[float, ...]) -> None:
    """Within a second the tool comes to its speed, if its controller does not stop on the way."""
    shares = np.ones(100)
    shares[:5] = np.linspace(0.1, 0.9, 5)
    task, motion = line_task(), at_shares(shares).motion
    passing = Passing(motion.times, timed=True, by_row=True)
    found = tool_speed(task, motion, passing, motion_limits(task), np.array(stops))
    assert found is not None
    assert [dip.share for dip in found.dips] == [0.0] * (len(stops) - 1)
    assert all("stop" in str(dip) for dip in found.dips)


def test_a_change_of_the_feed_is_no_dip() -> None:
    """The second half at 0.2 m/s: the tool needs a while to be as fast."""
    task = line_task()
    durations = task.durations.copy()
    durations[51:] /= 2.0
    task = dataclasses.replace(task, durations=durations)
    shares = np.ones(100)
    shares[50:] = 2.0
    shares[50:54] = (1.2, 1.4, 1.6, 1.8)
    found = speed_of(at_shares(shares), task)
    assert not found.dips and found.ramps == 1


def test_a_lift_off_is_a_ramp_and_a_corner_of_the_path_is_named() -> None:
    q = np.zeros((21, 2))
    q[:11, 0], q[11:, 0] = np.linspace(0.0, 0.1, 11), 0.1
    q[10:, 1] = np.linspace(0.0, 0.1, 11)
    task = joint_path(slider(2), q, evenly(21, 0.1), **LIMITS).path_task
    shares = np.ones(20)
    shares[8:12] = (0.6, 0.3, 0.3, 0.6)
    motion = qt.TimedPath(("slide_1", "slide_2"), q, np.append(0.0, np.cumsum(0.1 / shares)))
    (dip,) = speed_of(motion, task).dips
    assert "a corner of 90° at waypoint 11" in str(dip)
    parts = ("contact",) * 11 + ("retreat",) * 10
    found = speed_of(motion, dataclasses.replace(task, parts=parts))
    assert not found.dips and found.ramps == 2


@pytest.fixture(scope="module")
def fast() -> qt.PathTask:
    """The first edges of the deburring path at 20 times its feed, at which joints hold it back."""
    task = qt.load_task("deburring")
    fast = dataclasses.replace(task, durations=task.durations / 20.0, constant_speed=True)
    return short(fast, 181)


def own_shares(task: qt.PathTask, motion: qt.JointMotion) -> tuple[Array, Array]:
    """Speed of the site by differences of its positions over 0.2 ms, m/s; and the way."""
    data, dt = mujoco.MjData(task.model), 1e-4
    times = np.arange(dt, motion.times[-1] - dt, 2e-3)

    def places(t: Array) -> Array:
        found = []
        for q in motion.at(t).q:
            data.qpos[:] = q
            mujoco.mj_kinematics(task.model, data)
            found.append(data.site("tool").xpos.copy())
        return np.array(found)

    speeds = np.linalg.norm(places(times + dt) - places(times - dt), axis=1) / (2.0 * dt)
    return speeds, speeds * 2e-3


def test_the_speed_is_that_of_differences_of_the_tool_s_position(fast: qt.PathTask) -> None:
    run = qt.refine_trajectory(qt.follow(fast, slow_down=True, fine=True))
    limits = with_default_accelerations(motion_limits(fast), qt.JointRanges.of(fast.model))
    timed = qt.time_trajectory(run, limits=limits)
    found = speed_of(timed, fast)
    speeds, ways = own_shares(fast, timed.motion)
    # The waypoints are chords of a sphere: the path's own speed differs from 1 m/s by 1e-5.
    assert found.at_speed == pytest.approx(ways[speeds >= 0.98].sum() / ways.sum(), abs=0.01)
    assert min(dip.share for dip in found.dips) == pytest.approx(speeds[50:-50].min(), abs=0.02)


def test_the_feed_is_a_cap_beside_rounded_corners_too() -> None:
    """By differences; along these waypoints the curve is up to 4 % longer than its chords."""
    task = qt.load_task("dome_seams").part(slice(240, 300))
    assert task.durations is not None and not task.joint_moves
    run = qt.refine_trajectory(qt.follow(task, slow_down=True, fine=True))
    limits = with_default_accelerations(motion_limits(task), qt.JointRanges.of(task.model))
    for whose in (limits, with_default_jerks(limits)):
        timed = qt.time_trajectory(run, limits=whose)
        assert own_shares(task, timed.motion)[0].max() <= 0.05 * 1.003
        assert timed.times[-1] < 1.1 * task.durations.sum()


def test_the_free_motion_moves_before_the_tool_slows_down(
    fast: qt.PathTask, tmp_path: Path
) -> None:
    shares = []
    for constant in (False, True):  # at half the speed, for which the edges leave ramps enough way
        task = dataclasses.replace(fast, constant_speed=constant, durations=2.0 * fast.durations)
        run = run_task(task, "qp_gradient", tmp_path / "run.csv")
        assert run.check is not None and run.check.passes and run.timed is not None
        speeds, ways = own_shares(task, run.timed.motion)
        shares.append(float(ways[speeds >= 0.49].sum() / ways.sum()))
    assert shares[1] > shares[0] + 0.15
    assert run.check.speed is not None
    for dip in run.check.speed.dips:
        assert "joint_" in str(dip) or "corner" in str(dip)


def seam() -> qt.PathTask:
    """Half of a ring that a tool of free roll goes round at 0.2 m/s, leaning to its middle."""
    arm = mounted("Fanuc M-20iA", (-20.0, 20.0, -10.0, -60.0, 40.0, 170.0))
    lean = mink.SO3.from_x_radians(0.8)
    ring = [
        mink.SE3.from_rotation(mink.SO3.from_z_radians(t))
        @ mink.SE3.from_rotation_and_translation(lean, np.array([0.05, 0.0, 0.0]))
        for t in np.linspace(0.0, np.pi, 41)
    ]
    placed = arm.start @ ring[0].inverse()
    durations = np.append(0.0, np.full(40, 0.05 * np.pi / 40 / 0.2))
    return arm.task("seam", [placed @ pose for pose in ring], durations)


def test_a_path_is_rounded_within_its_tolerances_where_waypoints_make_it_a_polygon(
    tmp_path: Path,
) -> None:
    """Between its waypoints the ring is straight: joints on its chords would need more jerk."""
    task, shares = seam(), []
    for constant in (False, True):
        task = dataclasses.replace(task, constant_speed=constant)
        run = run_task(task, "qp_gradient", tmp_path / "run.csv")
        assert run.check is not None and run.check.passes and run.timed is not None
        speeds, ways = own_shares(task, run.timed.motion)
        shares.append(float(ways[speeds >= 0.98 * 0.2].sum() / ways.sum()))
    assert shares[0] < 0.3 and shares[1] > 0.7
    assert run.check.speed is not None and not run.check.speed.dips


def test_a_motion_whose_dips_are_shallow_enough_is_written_not_one_with_more_at_speed(
    tmp_path: Path,
) -> None:
    """A zigzag of 4° is rounded, and then faster, but dips deeper at the corners to its ways."""
    x = np.linspace(0.0, 20.0, 41)
    rows = [f"{a},{0.038 * (k % 2)},0,0,0,1" for k, a in enumerate(x)]
    (tmp_path / "zigzag.csv").write_text("\n".join(["x [mm],y [mm],z [mm],nx,ny,nz", *rows]))
    (tmp_path / "zigzag.toml").write_text(
        """
        title = "zigzag"
        robot = { scene = "m16ib_deburring.xml", frame = "tool" }
        start = { central = true }
        feed = { speed = 0.1, mode = "constant" }
        [projector]
        linear = "full"
        angular = { plane = [0, 0, 1] }
        frame = "body"
        [path]
        kind = "file"
        file = "zigzag.csv"
        tool = "into"
        placement = { position = [0.9, 0.1, 0.6] }
        approach = { distance = 0.02, steps = 4 }
        retreat = { distance = 0.02, steps = 4 }
        """
    )
    task, found = qt.load_task(tmp_path / "zigzag.toml"), []
    for most in (None, 0.65):
        asked = dataclasses.replace(task, max_dip=most)
        run = run_task(asked, "qp_gradient", tmp_path / "run.csv")
        assert run.check is not None and run.check.passes and run.check.speed is not None
        found.append(run.check.speed)
    assert found[1].at_speed < found[0].at_speed
    assert min(dip.share for dip in found[0].dips) < 0.35


def test_a_whole_pose_is_rounded_and_a_stated_start_stays(fast: qt.PathTask) -> None:
    task = short(fast, 60)
    limits = with_default_accelerations(motion_limits(task), qt.JointRanges.of(task.model))
    run = qt.follow(task, slow_down=True, fine=True)
    steady = steady_trajectory(run, limits)
    assert (steady.q[0] == run.q[0]).all()
    assert np.abs(steady.position_error).max() < 0.5 * task.tolerances.position
    assert np.abs(steady.axis_error).max() < 0.5 * task.tolerances.axis
    assert np.abs(steady.q - run.q).max() > 0.01
    held = qt.follow(task, "qp_rmr", slow_down=True, fine=True)
    whole = dataclasses.replace(
        held.path_task, projector=task.operational, waypoints=task.waypoints
    )
    still = steady_trajectory(dataclasses.replace(held, path_task=whole), limits)
    assert np.abs(still.q - held.q).max() < 1e-3
    assert 0.0 < np.abs(still.position_error).max() < 0.5 * task.tolerances.position


def test_settings_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match='add mode = "constant"'):
        line_task(constant_speed=False, max_dip=0.1)
    with pytest.raises(InvalidInput, match="at most 1"):
        line_task(max_dip=10.0)
    with pytest.raises(InvalidInput, match="needs a speed"):
        task = dataclasses.replace(line_task(), durations=None)
        run_task(task, "qp_gradient", tmp_path / "run.csv")
    text = (Path(str(qt.load_task("deburring").source))).read_text()
    scene = qt.load_task("deburring").scene.as_posix()
    text = text.replace("../scenes/m16ib_deburring.xml", scene)
    for given, refused in (('mode = "constant"\nmax_dip = 0.1', False), ("max_dip = 0.1", True)):
        file = tmp_path / "mine.toml"
        file.write_text(text.replace("speed = 0.050 ", f"{given}\nspeed = 0.050 "))
        if refused:
            with pytest.raises(TaskFileError, match="max_dip"):
                qt.load_task(file)
        else:
            task = qt.load_task(file)
            assert task.constant_speed and task.max_dip == 0.1

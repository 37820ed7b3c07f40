"""Timing: a smooth curve in time, limits between rows, the feed, slowed stretches, errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.joint_paths import evenly, joint_path, short, slider
from scipy.interpolate import BPoly, CubicHermiteSpline
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.kernel.speed_kernel import reachable
from qp_twist.kinematics import JointRanges
from qp_twist.referee import (
    MotionLimits,
    examine,
    motion_limits,
    with_default_accelerations,
    with_default_jerks,
)
from qp_twist.trajectories import (
    JointMotion,
    TimedPath,
    path_errors,
    refine_trajectory,
    run_task,
    speed_profile,
    time_trajectory,
)
from qp_twist.trajectories.timed_way import TimedWay

SEEDS = st.integers(0, 2**32 - 1)

# ---------------------------------------------------------------- the motion between rows


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_a_motion_is_the_cubic_through_positions_and_velocities(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 2.0, size=6))
    q, v = rng.normal(size=(2, 6, 3))
    motion = JointMotion(times, q, v)
    spline = CubicHermiteSpline(times, q, v)
    t = np.sort(rng.uniform(times[0], times[-1], size=200))
    state = motion.at(t)
    assert state.q == pytest.approx(spline(t), abs=1e-11)
    assert state.velocities == pytest.approx(spline(t, 1), abs=1e-9)
    assert state.accelerations == pytest.approx(spline(t, 2), abs=1e-7)
    piece = np.searchsorted(times, t, side="right") - 1
    # Bounds that hold, and that a dense look comes near to.
    dense = np.linspace(times[:-1], times[1:], 2001)
    speeds = np.abs(spline(dense, 1)).max(axis=0)
    assert (np.abs(state.velocities) <= motion.largest_speeds()[piece] * (1 + 1e-9)).all()
    assert motion.largest_speeds() == pytest.approx(speeds, rel=1e-5)
    lowest, highest = motion.extremes()
    assert lowest == pytest.approx(spline(dense).min(axis=0), abs=1e-5)
    assert highest == pytest.approx(spline(dense).max(axis=0), abs=1e-5)
    hardest = motion.largest_accelerations()
    inner = np.linspace(times[:-1] + 1e-9, times[1:] - 1e-9, 3)
    assert hardest == pytest.approx(np.abs(spline(inner, 2)).max(axis=0), rel=1e-5)
    assert (motion.at(times).q == q).all()


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_with_accelerations_a_motion_is_the_quintic_through_all_three(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 2.0, size=6))
    q, v, a = rng.normal(size=(3, 6, 2))
    motion = JointMotion(times, q, v, 10.0 ** rng.uniform(-2, 2) * a)
    spline = BPoly.from_derivatives(times, list(zip(q, v, motion.accelerations, strict=True)))
    t = np.sort(rng.uniform(times[0], times[-1], size=200))
    for k, found in enumerate(motion.at(t)):
        exact = spline(t, k)
        assert found == pytest.approx(exact, abs=1e-12 * 100.0**k * (1.0 + np.abs(exact).max()))
    assert (motion.at(times).q == q).all()
    dense = np.linspace(times[:-1] + 1e-9, times[1:] - 1e-9, 4001)
    lowest, highest = motion.extremes()
    assert lowest == pytest.approx(spline(dense).min(axis=0), rel=1e-4, abs=1e-4)
    assert highest == pytest.approx(spline(dense).max(axis=0), rel=1e-4, abs=1e-4)
    for k, largest in ((1, motion.largest_speeds()), (2, motion.largest_accelerations())):
        seen = np.abs(spline(dense, k)).max(axis=0)
        assert (seen <= largest * (1.0 + 1e-9)).all()
        assert largest == pytest.approx(seen, rel=1e-4)


def test_without_velocities_the_joints_move_straight_and_rest_outside() -> None:
    motion = JointMotion(np.array([1.0, 2.0, 4.0]), np.array([[0.0], [1.0], [-1.0]]))
    q, v, a = motion.at([0.0, 1.5, 2.0, 3.0, 4.0, 5.0])
    assert q[:, 0] == pytest.approx([0.0, 0.5, 1.0, 0.0, -1.0, -1.0])
    assert v[:, 0] == pytest.approx([0.0, 1.0, -1.0, -1.0, -1.0, 0.0])
    assert not a.any()
    assert motion.at(1.5).q.shape == (1,)


# ---------------------------------------------------------------- analytic times


@pytest.mark.parametrize(
    ("length", "feed", "acceleration"), [(1.0, 0.5, 1.0), (1.0, 10.0, 1.0), (2.0, 0.5, 2.0)]
)
def test_a_straight_line_of_one_joint_takes_the_time_of_the_trapezoid(
    length: float, feed: float, acceleration: float
) -> None:
    # Rows where the acceleration ends, so that the profile can switch there.
    count = 65
    q = np.linspace(0.0, length, count)[:, None]
    trajectory = joint_path(
        slider(), q, evenly(count, length / (count - 1) / feed), acceleration=acceleration
    )
    timed = time_trajectory(trajectory)
    run_up = feed**2 / (2.0 * acceleration)
    if 2.0 * run_up >= length:
        expected = 2.0 * np.sqrt(length / acceleration)
    else:
        assert run_up / length * (count - 1) == pytest.approx(round(run_up / length * (count - 1)))
        expected = length / feed + feed / acceleration
    assert timed.times[-1] == pytest.approx(expected, rel=1e-9)
    assert timed.velocities[[0, -1]] == pytest.approx(0.0)
    assert not timed.stops


def test_a_velocity_limit_alone_slows_to_exactly_that_velocity() -> None:
    q = np.array([[0.0, 0.0], [1.0, 0.2], [1.5, 1.2]])
    trajectory = joint_path(slider(2), q, evenly(3, 1.0), velocity=np.array([0.5, 2.0]))
    timed = time_trajectory(trajectory)
    assert timed.times == pytest.approx([0.0, 2.0, 3.0])
    [slowed] = timed.slowed
    assert (slowed.first, slowed.last, slowed.factor) == (0, 1, pytest.approx(2.0))
    assert slowed.limits == ("velocity of slide_1",)
    assert "rows 1 to 2: up to 2 times" in str(slowed)


def test_limits_that_are_not_reached_leave_exactly_the_feed() -> None:
    q = np.cumsum(np.random.default_rng(0).normal(scale=0.01, size=(20, 3)), axis=0)
    durations = evenly(20, 0.1)
    timed = time_trajectory(joint_path(slider(3), q, durations, velocity=100.0))
    assert (timed.times == np.cumsum(durations)).all()
    assert not timed.slowed


def test_in_the_middle_of_a_smooth_path_the_feed_is_kept_under_accelerations() -> None:
    s = np.linspace(0.0, 2.0, 81)
    q = np.column_stack([np.cos(s), np.sin(s)])
    timed = time_trajectory(joint_path(slider(2), q, evenly(81, 0.1), acceleration=5.0))
    rows = timed.path_rows
    assert len(rows) == 81
    assert np.diff(timed.times[rows])[1:-1] == pytest.approx(0.1, rel=1e-9)
    assert [(s.first, s.last) for s in timed.slowed] == [(0, rows[1]), (rows[79], rows[80])]
    assert timed.times[-1] == pytest.approx(8.05, abs=0.02)  # 0.25 m/s, 5 m/s²
    assert not timed.stops


def corner() -> qt.Trajectory:
    """Two metres with a right angle in the middle, 0.5 m/s, at most 5 m/s² in x and in y."""
    side = np.linspace(0.0, 1.0, 21)
    q = np.vstack([np.column_stack([side, 0 * side]), np.column_stack([0 * side + 1, side])[1:]])
    return joint_path(slider(2), q, evenly(41, 0.1), velocity=0.5, acceleration=5.0)


def found_share(check: qt.trajectories.Check, name: str) -> float:
    [finding] = [finding for finding in check.findings if finding.name == name]
    return finding.value


def by_other_means(timed: TimedPath | JointMotion) -> BPoly | CubicHermiteSpline:
    """The motion that the rows of a file mean, by another library."""
    if timed.accelerations is None:
        return CubicHermiteSpline(timed.times, timed.q, timed.velocities)
    rows = zip(timed.q, timed.velocities, timed.accelerations, strict=True)
    return BPoly.from_derivatives(timed.times, list(rows))


@pytest.mark.parametrize("jerk", [np.inf, 100.0])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-3, 5e-3])
def test_a_corner_is_rounded_within_the_tolerance_and_not_stopped_at(
    tolerance: float, jerk: float
) -> None:
    trajectory = corner()
    limits = MotionLimits.of(trajectory.path_task)
    limits = dataclasses.replace(limits, jerk=np.full(2, jerk))
    timed = time_trajectory(trajectory, limits=limits, position_tolerance=tolerance)
    assert not timed.stops
    rows = timed.trajectory
    assert rows.feed is not None
    assert rows.feed.sum() == pytest.approx(4.0)
    # By positions alone, every millisecond: how far from the two lines, how fast, how hard.
    t = np.arange(0.0, timed.times[-1], 1e-3)
    x, y = by_other_means(timed)(t).T
    off = np.minimum(np.hypot(y, np.maximum(x - 1.0, 0.0)), np.hypot(x - 1.0, np.minimum(y, 0.0)))
    assert 0.05 * tolerance < off.max() <= tolerance
    for v in (np.diff(x) / 1e-3, np.diff(y) / 1e-3):
        assert np.abs(v).max() <= 0.5 * (1 + 1e-9)
        assert np.abs(np.diff(v) / 1e-3).max() <= 5.0 * (1 + 1e-6)
    for v in (x, y):
        assert np.abs(np.diff(v, n=3)).max() / 1e-9 <= jerk * (1 + 1e-6) + 1e-6
    # Beside a corner it is nowhere faster than before it, as far as a check counts that.
    unlimited = dataclasses.replace(limits, velocity=np.full(2, np.inf))
    fast = time_trajectory(trajectory, limits=unlimited, position_tolerance=tolerance)
    assert fast.motion.largest_speeds().max() <= 0.5 * (1 + 2e-3)
    # The waypoint itself is passed.
    assert np.abs(np.hypot(x - 1.0, y)).min() < 1e-3
    stop = 4.2 if np.isinf(jerk) else 4.3  # with a full stop: a = 5, and then in 50 ms
    assert 4.1 < timed.times[-1] < (stop + 0.05 if tolerance < 5e-3 else stop)


@pytest.mark.parametrize(("method", "smooth"), [("qp", True), ("qp_minimum_norm", False)])
def test_what_rounds_by_samples_keep_is_proven_to_be_kept(method: str, smooth: bool) -> None:
    task = qt.load_task("deburring")
    rows = refine_trajectory(qt.follow(task, method, slow_down=True))
    limits = with_default_accelerations(motion_limits(task), qt.JointRanges.of(task.model))
    timed = time_trajectory(rows, limits=with_default_jerks(limits) if smooth else limits)
    assert len(timed.q) > len(rows.q)
    assert timed.errors.kept(1e-4, np.radians(0.05)).all()
    assert max(timed.errors.position.at.max(), timed.errors.axis.at.max()) < 1e-7


def test_a_result_makes_no_task_and_is_judged_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    task = qt.load_task("deburring")
    made: list[qt.PathTask] = []
    monkeypatch.setattr(qt.PathTask, "__post_init__", made.append)
    judge = Mock(wraps=examine)
    monkeypatch.setattr("qp_twist.trajectories.check.examine", judge)
    done = run_task(task, "qp_gradient", tmp_path / "run.csv")
    assert done.passes
    assert done.timed is not None
    assert len(done.timed.q) > len(done.trajectory.q) == 401
    assert done.timed.trajectory.path_task is task
    assert made == []
    assert judge.call_count == 1


# ---------------------------------------------------------------- whose limits


def test_a_run_is_from_rest_to_rest_within_default_accelerations(tmp_path: Path) -> None:
    task = short(qt.load_task("deburring"), 40)
    assert not np.isfinite(task.acceleration_limits).any()
    done = run_task(task, "qp_gradient", tmp_path / "run.csv")
    assert done.check is not None
    assert done.passes
    default = "accelerations checked against the default: full speed within 0.25 s"
    jerks = "jerks checked against the default: full acceleration within 50 ms"
    assert done.check.sources == (default, jerks)
    assert done.check.verdict.startswith(f"passes; {default}; {jerks}")
    # The file alone, by another library, every millisecond.
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", skip_header=3)
    assert table.shape[1] == 20
    t, q, v, a = table[:, 1], table[:, 2:8], table[:, 8:14], table[:, 14:]
    spline = BPoly.from_derivatives(t, list(zip(q, v, a, strict=True)))
    dense = np.append(np.arange(0.0, t[-1], 1e-3), t[-1])
    assert not v[[0, -1]].any()
    assert not a[[0, -1]].any()
    assert (np.abs(spline(dense, 1)) <= task.velocity_limits * (1 + 1e-9)).all()
    # Full speed within a quarter of a second.
    share = np.abs(spline(dense, 2)).max(axis=0) / (task.velocity_limits / 0.25)
    assert 0.7 < share.max() <= 1.0 + 1e-6
    # From 1 ms to the next accelerations change by no more than the jerk allows: positions alone.
    x = spline(np.arange(-3, 1 + len(dense)) * 1e-3, extrapolate=False)
    x = np.where(np.isnan(x), np.where(np.arange(len(x))[:, None] < 9, q[0], q[-1]), x)
    hardest = np.abs(np.diff(x, n=3, axis=0)).max(axis=0) / 1e-9
    assert (hardest <= task.velocity_limits / 0.25 / 0.05 * (1 + 1e-5)).all()
    assert (hardest / task.velocity_limits).max() > 0.9 / 0.25 / 0.05
    # A file whose motion is twice as fast breaks the default, which the verdict names.
    rows = qt.read_trajectory(tmp_path / "run.csv")
    fast = dataclasses.replace(
        rows,
        times=rows.times / 2.0,
        velocities=2.0 * rows.velocities,
        accelerations=4.0 * rows.accelerations,
    )
    check = qt.check_trajectory(fast, task)
    for name, times in (("acceleration limits", 4.0), ("jerk limits", 8.0)):
        share = times * found_share(done.check, name)
        assert found_share(check, name) == pytest.approx(share, rel=1e-6)
    assert check.verdict.endswith(f"{default}; {jerks}")


@pytest.mark.parametrize("stated", [1e9, 10**300, "fast", None, True])
def test_a_file_cannot_set_the_limits_that_it_is_checked_against(stated: object) -> None:
    """Jumps from row to row with zero velocities: far beyond any industrial arm."""
    task = short(qt.load_task("deburring"), 6)
    rows = refine_trajectory(qt.follow(task, "qp_minimum_norm", slow_down=True))
    names = JointRanges.of(task.model).names
    q = rows.q[: len(task.waypoints)]
    times = np.arange(len(q)) * 0.05
    plain = TimedPath(names, q, times, np.zeros_like(q))
    limits = dict.fromkeys(names, stated)
    lying = dataclasses.replace(plain, metadata={"acceleration_limits": limits})
    before, after = qt.check_trajectory(plain, task), qt.check_trajectory(lying, task)
    assert not before.passes
    assert before.verdict == after.verdict
    assert before.sources == (
        "accelerations checked against the default: full speed within 0.25 s",
    )
    assert [f.value for f in before.findings] == [f.value for f in after.findings]
    assert not [note for note in before.notes if "acceleration limit" in note]
    assert (
        len([note for note in after.notes if "acceleration limits of joint_1, joint_2" in note])
        == 1
    )


def test_limits_are_the_tasks_then_the_robots_then_the_default() -> None:
    task = short(qt.load_task("deburring"), 2)
    ranges = JointRanges.of(task.model)
    own = np.array([1.0, np.inf, np.inf, np.inf, np.inf, np.inf])
    limits = motion_limits(dataclasses.replace(task, acceleration_limits=own))
    assert (limits.acceleration == own).all()
    assert limits.accelerations_of == ""
    full = with_default_accelerations(limits, ranges)
    assert full.acceleration[1:] == pytest.approx(4.0 * task.velocity_limits[1:])
    assert full.acceleration[0] == 1.0
    assert full.accelerations_of == "the default: full speed within 0.25 s"
    # Without any speed: pi rad/s, or 1 m/s.
    bare = dataclasses.replace(full, velocity=np.full(6, np.inf), acceleration=np.full(6, np.inf))
    assert with_default_accelerations(bare, ranges).acceleration == pytest.approx(4.0 * np.pi)
    # A known robot whose maker publishes accelerations.
    known = dataclasses.replace(task, velocity_limits=np.full(6, np.inf))
    speeds = motion_limits(known)
    assert speeds.speeds_of == "Fanuc M-16iB/20"
    assert speeds.velocity == pytest.approx(task.velocity_limits, rel=1e-4)


# ---------------------------------------------------------------- limits hold everywhere


@given(SEEDS, st.sampled_from(["smooth", "rough", "jumps"]), st.booleans())
@settings(max_examples=20, deadline=None)
def test_no_limit_is_exceeded_anywhere_between_the_rows(seed: int, kind: str, smooth: bool) -> None:
    rng = np.random.default_rng(seed)
    count, joints = int(rng.integers(2, 16)), int(rng.integers(1, 4))
    if kind == "smooth":
        s = np.linspace(0.0, 1.0, count)[:, None]
        q = np.sin(rng.uniform(0.5, 6.0, size=joints) * s + rng.uniform(0, 6, size=joints))
    else:
        q = np.cumsum(rng.normal(size=(count, joints)), axis=0)
        if kind == "jumps":
            q *= 10.0 ** rng.uniform(-3, 1, size=joints)
            q[rng.uniform(size=count) < 0.3] = q[0]  # standing still, and back
    feed = 10.0 ** rng.uniform(-2, 0.5, size=count - 1)
    velocity = 10.0 ** rng.uniform(-1, 2, size=joints)
    acceleration = 10.0 ** rng.uniform(-1, 2, size=joints)
    velocity[rng.uniform(size=joints) < 0.2] = np.inf
    acceleration[rng.uniform(size=joints) < 0.2] = np.inf
    rests = rng.uniform(size=count) < 0.1
    rests[[0, -1]] = True
    jerk = 10.0 ** rng.uniform(0, 4, size=joints) if smooth else np.full(joints, np.inf)
    profile = speed_profile(q, feed, velocity, acceleration, rests, max_jerk=jerk)
    motion, rows = profile.motion, profile.rows
    assert (np.diff(motion.times[rows]) >= feed * (1 - 1e-9)).all()
    assert not motion.velocities[rows][rests].any()
    assert (motion.q[rows] == q).all()
    if smooth:
        assert not motion.accelerations[rows][rests].any()
    # Positions, densely, and nothing but their differences.
    shares = np.linspace(0.0, 1.0, 26)
    t = motion.times[:-1, None] + np.diff(motion.times)[:, None] * shares
    at = motion.at(t.ravel()).q.reshape(*t.shape, joints)
    dt = (np.diff(motion.times) / 25)[:, None, None]
    rounding = 1e-13 * np.abs(q).max()
    speeds = np.abs(np.diff(at, axis=1))
    assert (speeds <= velocity * dt * (1 + 1e-6) + rounding).all()
    changes = np.abs(np.diff(at, n=2, axis=1))
    assert (changes <= acceleration * dt**2 * (1 + 1e-6) + 4 * rounding).all()
    jerks = np.abs(np.diff(at, n=3, axis=1))
    assert (jerks <= jerk * dt**3 * (1 + 1e-6) + 8 * rounding).all()
    assert at[:, 0] == pytest.approx(motion.q[:-1], abs=1e-12 + 10 * rounding)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_without_jerk_limits_no_speed_could_be_larger(seed: int) -> None:
    """The squared speeds are those of a linear program over the whole path."""
    rng = np.random.default_rng(seed)
    cells, joints = int(rng.integers(2, 40)), int(rng.integers(1, 4))
    h, most = rng.uniform(0.01, 0.02, size=cells), rng.uniform(0.5, 3.0, size=joints)
    most[rng.uniform(size=joints) < 0.2] = np.inf
    x = np.concatenate([[0.0], np.cumsum(h)])
    k, phase = rng.uniform(0.1, 3.0, size=joints), rng.uniform(0, 6, size=joints)
    first, second = k * np.cos(k * x[:, None] + phase), -(k**2) * np.sin(k * x[:, None] + phase)
    curve = np.stack(
        [np.stack([first[e], second[e]], axis=1) for e in (slice(cells), slice(1, None))], axis=1
    )
    cap = np.where(rng.uniform(size=cells + 1) < 0.5, rng.uniform(0.01, 5.0, size=cells + 1), 50.0)
    y = reachable(curve, h, most, cap)
    A, b = [], []
    for i, end, j in np.ndindex(cells, 2, joints):
        if np.isfinite(most[j]):
            row = np.zeros(cells + 1)
            row[[i, i + 1]] = np.array([-1.0, 1.0]) * curve[i, end, 0, j] / (2.0 * h[i])
            row[i + end] += curve[i, end, 1, j]
            A += [row, -row]
            b += [most[j], most[j]]
    bounds = [(0.0, 0.0 if i in (0, cells) else cap[i]) for i in range(cells + 1)]
    best = linprog(-np.ones(cells + 1), A or None, b or None, bounds=bounds)
    assert (y >= 0.0).all() and (y[1:-1] <= cap[1:-1]).all() and not y[[0, -1]].any()
    assert not A or (np.array(A) @ y <= np.array(b) * (1 + 1e-9)).all()
    seconds, least = ((2.0 * h / (r[:-1] + r[1:])).sum() for r in (np.sqrt(y), np.sqrt(best.x)))
    assert seconds <= least * (1 + 1e-3)


@pytest.mark.parametrize(
    ("length", "jerk", "seconds"),
    [
        (1.0, 80.0, 1.0 + 0.25 + 0.05),  # 1 m/s and 4 m/s² are reached
        (0.2, 80.0, 0.5),  # the acceleration is reached, for as long as it rises
        (0.01, 80.0, 4.0 * (0.01 / 160.0) ** (1.0 / 3.0)),  # neither is
    ],
)
def test_with_jerk_limits_a_move_takes_the_time_of_seven_sections(
    length: float, jerk: float, seconds: float
) -> None:
    one, moves = np.ones(1), 25  # from rest to rest each, begun at as many parameters
    q, rests = length * np.arange(moves + 1.0)[:, None], np.ones(moves + 1, dtype=bool)
    feed, free = np.full(moves, 0.1), np.full(moves, np.inf)
    profile = speed_profile(q, feed, one, 4.0 * one, rests, free, jerk * one)
    took = np.diff(profile.motion.times[profile.rows])
    assert (seconds * (1 - 1e-9) <= took).all() and (took <= seconds * 1.005).all()
    # Accelerations are continuous, 0 at both ends, and change by at most the jerk.
    dt = 1e-5
    a = by_other_means(profile.motion)(np.arange(0.0, profile.motion.times[-1], dt), 2)[:, 0]
    assert np.abs(np.diff(a)).max() <= jerk * dt * (1 + 1e-6)
    assert not profile.motion.accelerations[[0, -1]].any()


@pytest.mark.parametrize("jerk", [np.inf, 50.0])
def test_without_speed_limits_a_move_takes_the_time_of_accelerations(jerk: float) -> None:
    """Rows in even steps but for rounding, of a move that nothing but the rest at its end slows."""
    noise = np.random.default_rng(3).uniform(-1e-13, 1e-13, (60, 2))
    q = np.linspace(0.0, 1.0, 60)[:, None] * [2.0, -1.0] + noise
    rests, free, one = np.zeros(60, dtype=bool), np.full(59, np.inf), np.ones(2)
    rests[[0, -1]] = True
    feed = np.full(59, 0.01)
    profile = speed_profile(q, feed, np.inf * one, 4.0 * one, rests, free, jerk * one)
    # d = a T²/4; with jerk limits d = a T (T/2 − a/j)/2, since the acceleration is reached
    ramp = 4.0 / jerk
    expected = ramp + np.sqrt(ramp**2 + 4.0 * 2.0 / 4.0)
    assert profile.motion.times[-1] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("jerk", [np.inf, 60.0])
@pytest.mark.parametrize("off", [-1e-9, 1e-9, -1e-7, 1e-5])
def test_where_rows_are_nearly_twice_as_far_apart_as_others_nothing_happens(
    off: float, jerk: float
) -> None:
    """The turn of a row ends at twice the shorter distance: there cubics must not be slivers."""

    def seconds(off: float) -> float:
        h = np.tile([0.2, 0.1 + off, 0.2], 5)
        x = np.concatenate([[0.0], np.cumsum(h)])[:, None]
        q, one, rests = (
            np.sin(x * [0.7, 1.3, 2.0] + [0.0, 2.0, 4.0]),
            np.ones(3),
            np.zeros(16, bool),
        )
        rests[[0, -1]] = True
        limits = 3.0 * one, 6.0 * one
        free = np.full(len(h), np.inf)
        motion = speed_profile(q, h, *limits, rests, free, jerk * one).motion
        return float(motion.times[-1])

    assert seconds(off) == pytest.approx(seconds(0.0), rel=1e-3)


@given(SEEDS, st.sampled_from(["smooth", "rough", "jumps"]))
@settings(max_examples=8, deadline=None)
def test_no_random_path_is_left_by_more_than_the_tolerance(seed: int, kind: str) -> None:
    """What cannot be rounded is stopped at; the position is that of two slides."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 20))
    q = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    if kind == "smooth":
        q = np.sin(rng.uniform(0.5, 6.0, size=2) * np.linspace(0.0, 1.0, count)[:, None])
    elif kind == "jumps":
        q *= 10.0 ** rng.uniform(-3, 0, size=2)
        q[rng.uniform(size=count) < 0.3] = q[0]
    durations = np.append(0.0, 10.0 ** rng.uniform(-2, 0, size=count - 1))
    trajectory = joint_path(slider(2), q, durations, velocity=2.0, acceleration=5.0)
    limits = with_default_jerks(MotionLimits.of(trajectory.path_task))
    tolerance = 10.0 ** rng.uniform(-4, -1)
    timed = time_trajectory(trajectory, limits=limits, position_tolerance=tolerance)
    rows, spline = timed.times[timed.path_rows], by_other_means(timed)
    s = timed.trajectory.s
    for k in range(len(rows) - 1):
        a, b = trajectory.path_task.at(s[k : k + 2]).positions[:, :2]
        p = spline(np.linspace(rows[k], rows[k + 1], 60)) - a
        along = np.clip(p @ (b - a) / max((b - a) @ (b - a), 1e-300), 0.0, 1.0)
        assert np.linalg.norm(p - along[:, None] * (b - a), axis=1).max() <= tolerance * 1.001


# ---------------------------------------------------------------- errors between waypoints


def test_the_error_between_waypoints_is_that_of_the_arc_over_its_chord() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="hinge" axis="0 0 1"/>'
        '<geom size="0.1"/><site name="tool" pos="2 0 0"/></body></worldbody></mujoco>'
    )
    q = np.array([[0.0], [0.2], [0.5]])
    trajectory = joint_path(model, q, evenly(3, 1.0))
    errors = path_errors(trajectory.path_task, JointMotion(np.arange(3.0), q), samples=31)
    assert errors.position.at == pytest.approx(0.0, abs=1e-12)
    expected = [2.0 * (1.0 - np.cos(0.1)), 2.0 * (1.0 - np.cos(0.15))]
    assert errors.position.between == pytest.approx(expected, rel=1e-3)
    assert (errors.position.bound >= expected).all()
    assert errors.position.bound[1] <= 1.2 * expected[1]
    assert not errors.axis.between.any()
    # The angle of the frame turns with the chord: nothing is left of it.
    angle = qt.TwistProjector(linear=qt.Projector.none(), angular=qt.Projector.line([0, 0, 1]))
    task = dataclasses.replace(trajectory.path_task, projector=angle)
    turned = path_errors(task, JointMotion(np.arange(3.0), q))
    assert turned.axis.between == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- rows between


@pytest.mark.parametrize("every", [5, 20, 50])
def test_a_path_is_followed_as_finely_as_its_tolerances_ask(every: int) -> None:
    line = qt.load_task("planar_line")
    task = line.part(slice(None, None, every))
    plain, fine = (qt.follow(task, "qp_minimum_norm", fine=fine) for fine in (False, True))
    assert plain.between.position.bound.max() > 1e-4 or every == 5
    assert fine.between.position.bound.max() <= 1e-4
    assert fine.s[fine.at_waypoints].tolist() == list(range(len(task.waypoints)))
    assert fine.position_error.max() < 1e-8 and fine.passes
    twice = qt.follow(line.part(slice(None, None, every // 5)), "qp_minimum_norm", fine=True)
    assert len(twice.q) <= 2 * len(fine.q)  # the rows follow from the path, not from its points


def test_rows_are_inserted_where_straight_joints_would_leave_the_path() -> None:
    task = short(qt.load_task("deburring"), 6, lines=10 * np.arange(6))
    trajectory = qt.follow(task, "qp")
    straight = path_errors(task, JointMotion(np.arange(6.0), trajectory.q))
    assert straight.position.between.max() > 1e-4
    refined = refine_trajectory(trajectory)
    assert len(refined.q) > 6
    # The rows that were there stay, at their times.
    kept = [int(np.argmin(np.abs(refined.q - row).max(axis=1))) for row in trajectory.q]
    assert (refined.q[kept] == trajectory.q).all()
    times = np.cumsum(refined.durations)
    assert times[kept] == pytest.approx(np.cumsum(trajectory.durations))
    assert refined.path_task is task
    assert refined.feed == pytest.approx(refined.durations[1:])
    before = np.searchsorted(kept, np.arange(len(refined.q)), side="right") - 1
    assert (np.floor(refined.s) == before).all()
    # A look at the joints between them, by another way: the frame against its straight line.
    configuration = mink.Configuration(task.model)
    for k in range(len(refined.q) - 1):
        a, b = task.at(refined.s).positions[k : k + 2]
        for share in (0.25, 0.5, 0.75):
            configuration.update((1.0 - share) * refined.q[k] + share * refined.q[k + 1])
            p = configuration.get_transform_frame_to_world("tool", "site").translation()
            off = (p - a) - (p - a) @ (b - a) / ((b - a) @ (b - a)) * (b - a)
            assert np.linalg.norm(off) < 1e-4
    for name in ("position_error", "axis_error"):
        assert getattr(refined, name).max() < 1e-7
    assert len(refined.binding) == len(refined.statuses) == len(refined.sigma_min)
    assert refine_trajectory(refined) is refined


# ---------------------------------------------------------------- following slowly


@pytest.mark.parametrize("acceleration", [np.inf, 1.0])
def test_slowing_down_keeps_the_path_that_the_limits_would_not_let_it_keep(
    acceleration: float,
) -> None:
    limits = {"velocity_limits": np.full(6, 0.12), "acceleration_limits": np.full(6, acceleration)}
    task = short(qt.load_task("deburring"), 8, **limits)
    missed = qt.follow(task, "qp_minimum_norm")
    assert missed.position_error.max() > 1e-4
    assert (missed.durations == task.durations).all()
    kept = qt.follow(task, "qp_minimum_norm", slow_down=True)
    assert kept.position_error.max() < 1e-8
    assert kept.axis_error.max() < 1e-8
    assert (kept.durations >= task.durations).all()
    longer = kept.durations > task.durations
    assert longer.any()
    held = [names for names, slow in zip(kept.binding, longer, strict=True) if slow]
    assert all("limit" in name for names in held for name in names)
    assert any(held)
    speeds = np.abs(np.diff(kept.q, axis=0)) / kept.durations[1:, None]
    assert (speeds <= 0.12 * (1 + 1e-6)).all()
    if np.isfinite(acceleration):
        velocities = np.diff(kept.q, axis=0) / kept.durations[1:, None]
        change = np.abs(np.diff(velocities, axis=0)) / kept.durations[2:, None]
        assert change.max() <= acceleration * (1 + 1e-5)
    timed = time_trajectory(kept)
    assert timed.errors.position.between.max() < 1e-4
    assert (timed.motion.largest_speeds() <= 0.12 * (1 + 1e-9)).all()


def test_a_path_without_a_clock_and_without_limits_has_no_times() -> None:
    trajectory = joint_path(slider(), np.array([[0.0], [1.0]]), None)
    with pytest.raises(qt.InvalidInput, match="waypoint 1 to 2 takes; add"):
        time_trajectory(trajectory)
    limited = joint_path(slider(), np.array([[0.0], [1.0]]), None, velocity=0.5)
    assert time_trajectory(limited).times == pytest.approx([0.0, 2.0])


def test_refused_arguments() -> None:
    trajectory = joint_path(slider(), np.array([[0.0], [1.0]]), evenly(2, 1.0))
    with pytest.raises(qt.InvalidInput, match="expected a Trajectory"):
        time_trajectory("trajectory")  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="position_tolerance"):
        time_trajectory(trajectory, position_tolerance=0.0)
    with pytest.raises(qt.InvalidInput, match="slow_down"):
        qt.follow(trajectory.path_task, slow_down="yes")  # type: ignore[arg-type]


def test_rows_between_which_no_speed_is_slow_enough_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As where a motion jumps from branch to branch: two neighbouring cells then end at rest."""
    trajectory = qt.follow(qt.load_task("deburring").part(np.arange(6)))
    ranges = JointRanges.of(trajectory.path_task.model)
    limits = with_default_accelerations(motion_limits(trajectory.path_task), ranges)
    limits, solved = with_default_jerks(limits), TimedWay._reachable

    def stuck(self: TimedWay, cells: Any, tight: Array) -> Array:
        y = solved(self, cells, tight)
        y[len(y) // 2 : len(y) // 2 + 2] = 0.0
        return y

    monkeypatch.setattr(TimedWay, "_reachable", stuck)
    with pytest.raises(qt.InvalidInput, match="no speed is slow enough between rows 3 and 4"):
        qt.time_trajectory(trajectory, limits=limits)

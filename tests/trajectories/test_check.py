"""Checks of trajectories: what passes, what does not and where, rows of any number."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from oracles.joint_paths import evenly, joint_path, short, slider
from scipy.interpolate import BPoly

import qp_twist as qt
from qp_twist.cli import check as _  # noqa: F401  (its command)
from qp_twist.cli import main
from qp_twist.trajectories import (
    Check,
    Finding,
    TimedPath,
    check_trajectory,
    read_trajectory,
    time_trajectory,
)

Array = np.ndarray
NAMES = ("slide_1", "slide_2")


def corner(acceleration: float = 1e6, velocity: float = 2.0) -> qt.Trajectory:
    """Along x for a metre, then along y, 10 rows each, at 1 m/s."""
    side = np.linspace(0.0, 1.0, 11)
    q = np.vstack([np.column_stack([side, 0 * side]), np.column_stack([0 * side + 1, side])[1:]])
    return joint_path(slider(2), q, evenly(21, 0.1), velocity=velocity, acceleration=acceleration)


def found(check: Check, name: str) -> Finding:
    [finding] = [finding for finding in check.findings if finding.name == name]
    return finding


def test_what_was_timed_passes_and_nothing_it_says_of_itself_matters() -> None:
    timed = time_trajectory(corner(acceleration=4.0))
    check = check_trajectory(timed, timed.trajectory.path_task)
    assert check.passes
    assert not check.problems
    assert found(check, "acceleration limits").value <= 100.0 + 1e-9
    assert found(check, "time").value == pytest.approx(timed.times[-1])
    # Rows far off under the same errors as before.
    lying = dataclasses.replace(timed.trajectory, q=timed.trajectory.q + np.array([0.01, 0.0]))
    assert not check_trajectory(lying, timed.trajectory.path_task).passes


@pytest.mark.parametrize(
    ("change", "name", "value", "where"),
    [
        (lambda q, t: (q + np.eye(21, 2, k=-8) * 0.003, t), "position error", 3.0, "waypoint 9"),
        (lambda q, t: (q, t * 0.4), "velocity limits", 125.0, "slide_"),
        (lambda q, t: (q, t * 0.9), "feed", 100.0 / 0.9, "waypoints"),
        (
            lambda q, t: (q + np.array([9.0, 0.0]), t),
            "smallest joint margin",
            -1.0 / 9.0,
            "slide_1",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_size_and_place(
    change: object, name: str, value: float, where: str
) -> None:
    trajectory = corner()
    q, times = change(trajectory.q.copy(), np.arange(21) * 0.1)  # type: ignore[operator]
    check = check_trajectory(TimedPath(NAMES, q, times), trajectory.path_task)
    assert not check.passes
    finding = found(check, name)
    assert not finding.passes
    assert finding.value == pytest.approx(value)
    assert where in finding.where
    assert any(problem.startswith(name) for problem in check.problems)


def test_who_stands_and_then_rushes_is_in_time_at_the_waypoints_but_does_not_pass() -> None:
    """Between two waypoints: nine tenths of the time at rest, the way in the last tenth."""
    trajectory = corner()
    trajectory = joint_path(slider(2), trajectory.q, evenly(21, 0.1), velocity=np.inf)
    times = np.arange(21) * 0.1
    q = np.repeat(trajectory.q, 2, axis=0)[:-1]
    waiting = np.sort(np.concatenate([times, times[1:] - 0.01]))
    check = check_trajectory(TimedPath(NAMES, q, waiting), trajectory.path_task)
    assert found(check, "feed").passes
    assert not found(check, "feed between").passes
    assert found(check, "feed between").value == pytest.approx(1000.0, rel=0.02)
    steady = check_trajectory(TimedPath(NAMES, trajectory.q, times), trajectory.path_task)
    assert found(steady, "feed between").value == pytest.approx(100.0, rel=0.02)


def test_a_file_that_says_it_was_made_for_something_else_is_told_of() -> None:
    trajectory = corner()
    rows = TimedPath.of(trajectory)
    assert not [n for n in check_trajectory(rows, trajectory.path_task).notes if "metadata" in n]
    units = dict.fromkeys(NAMES, "deg")
    lying = rows.metadata | {"task": "another", "robot": 7, "units": units, "frame": "odd"}
    told = check_trajectory(dataclasses.replace(rows, metadata=lying), trajectory.path_task).notes
    assert [note for note in told if "task 'another'" in note]
    assert [note for note in told if "robot '7'" in note]
    assert len([note for note in told if "'deg'" in note and "'m'" in note]) == 2


def test_the_way_between_the_waypoints_counts() -> None:
    trajectory = corner()
    velocities = np.zeros((21, 2))
    velocities[:, 1] = [0.5, -0.5] * 10 + [0.5]
    rows = TimedPath(NAMES, trajectory.q, np.arange(21) * 0.1, velocities)
    check = check_trajectory(rows, trajectory.path_task)
    assert found(check, "position error").passes
    # A cubic that leaves at v and comes back at −v is v T/4 off in the middle.
    between = found(check, "position error between")
    assert between.value == pytest.approx(1e3 * 0.5 * 0.1 / 4.0, rel=0.02)
    assert not between.passes


def test_no_row_between_two_waypoints_is_passed_over() -> None:
    trajectory = corner(velocity=np.inf)
    t = np.linspace(0.0, 2.0, 2001)
    q = np.column_stack([np.minimum(t, 1.0), np.maximum(t - 1.0, 0.0)])
    assert check_trajectory(TimedPath(NAMES, q, t), trajectory.path_task).passes
    q[340, 1] = 0.02  # away and back within 2 ms of the 100 between two waypoints
    check = check_trajectory(TimedPath(NAMES, q, t), trajectory.path_task)
    assert found(check, "position error").passes
    between = found(check, "position error between")
    assert not between.passes
    assert between.value == pytest.approx(20.0)
    assert between.where == "waypoints 4 to 5"


def test_a_joint_that_leaves_its_range_between_two_rows_is_outside() -> None:
    q = np.array([[8.9], [8.9]])
    # Out at 2 m/s, back at 1: with u = t/T the way is T (2u − 3u² + u³), at most 2√3/9 T.
    T = 0.100025 / (2.0 * np.sqrt(3.0) / 9.0)
    rows = TimedPath(("slide_1",), q, np.array([0.0, T]), np.array([[2.0], [-1.0]]))
    task = joint_path(slider(), q, None).path_task
    finding = found(check_trajectory(rows, task, position_tolerance=1.0), "smallest joint margin")
    assert not finding.passes
    assert finding.value == pytest.approx(-0.000025 / 9.0)


@pytest.mark.parametrize("rows", [7, 20, 22, 101, 1000])
def test_any_number_of_rows_is_matched_to_the_waypoints_in_their_order(rows: int) -> None:
    trajectory = corner()
    t = np.linspace(0.0, 2.0, rows)
    t = np.unique(np.append(t, 1.0))  # the corner itself
    q = np.column_stack([np.minimum(t, 1.0), np.maximum(t - 1.0, 0.0)])
    check = check_trajectory(TimedPath(NAMES, q, t), trajectory.path_task)
    assert check.passes, check.verdict
    # Without the corner nobody passes it.
    missing = check_trajectory(TimedPath(NAMES, q[t != 1.0], t[t != 1.0]), trajectory.path_task)
    assert not missing.passes or rows == 1000
    # A path that ends early misses the rest.
    early = check_trajectory(TimedPath(NAMES, q[t < 1.5], t[t < 1.5]), trajectory.path_task)
    finding = found(early, "position error")
    assert not finding.passes
    assert finding.value == pytest.approx(1e3 * (2.0 - t[t < 1.5].max()), rel=1e-3)
    assert finding.where == "waypoint 21"


def test_a_path_passed_backwards_does_not_pass_and_run_in_and_run_out_do_no_harm() -> None:
    trajectory = corner()
    task = trajectory.path_task
    q = trajectory.q
    run_in = np.linspace([-1.0, -1.0], q[0], 6)[:-1]
    run_out = np.linspace(q[-1], [2.0, 3.0], 6)[1:]
    whole = np.vstack([run_in, q, run_out])
    assert check_trajectory(TimedPath(NAMES, whole), task).passes
    assert not check_trajectory(TimedPath(NAMES, whole[::-1]), task).passes


def test_a_path_that_is_passed_twice_is_matched_in_its_order() -> None:
    side = np.linspace(0.0, 1.0, 9)
    there_and_back = np.column_stack([np.append(side, side[-2::-1]), np.zeros(17)])
    task = joint_path(slider(2), there_and_back, None).path_task
    t = np.linspace(0.0, 1.0, 33)
    dense = np.column_stack([np.append(t, t[-2::-1]), np.zeros(65)])
    assert check_trajectory(TimedPath(NAMES, dense), task).passes
    once = check_trajectory(TimedPath(NAMES, dense[:33]), task)
    assert not once.passes
    assert found(once, "position error").value > 100.0


def test_a_motion_that_stands_still_fails_in_numbers_that_json_has() -> None:
    trajectory = corner()
    still = TimedPath(NAMES, np.zeros((5, 2)), np.arange(5.0))
    check = check_trajectory(still, trajectory.path_task)
    assert found(check, "position error").value == pytest.approx(1e3 * np.sqrt(2.0))
    assert not check.passes
    # No two successive waypoints are met, so there is no feed to be judged, nor to be proven.
    assert "feed" not in {finding.name for finding in check.findings}
    assert "closer together" not in check.verdict
    assert json.loads(json.dumps(check.to_dict(), allow_nan=False))["passes"] is False
    away = TimedPath(NAMES, np.vstack([np.zeros((4, 2)), [[1e300, 0.0]]]), np.arange(5.0) * 1e-9)
    with np.errstate(over="ignore", invalid="ignore"):
        check = check_trajectory(away, trajectory.path_task)
    assert any(not np.isfinite(finding.value) for finding in check.findings)
    assert json.loads(json.dumps(check.to_dict(), allow_nan=False))["passes"] is False


def test_without_times_only_the_path_is_checked_and_that_is_said() -> None:
    trajectory = corner()
    check = check_trajectory(trajectory, trajectory.path_task)
    assert check.passes
    assert check.unchecked == ("feed, joint speeds and accelerations not checked: no times",)
    assert check.verdict.startswith(f"passes; {check.unchecked[0]}")
    assert {f.name for f in check.findings}.isdisjoint({"velocity limits", "feed", "time"})


def test_only_the_rows_of_the_task_count_and_hard_bands_do() -> None:
    task = short(qt.load_task("deburring"), 6)
    trajectory = qt.follow(task, "qp_minimum_norm")
    assert check_trajectory(trajectory, task).passes
    # The roll about the tool, which is free, is another than the waypoints'.
    full = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    whole = check_trajectory(trajectory, dataclasses.replace(task, projector=full))
    assert found(whole, "axis error").value > 1.5
    band = qt.RollBand([0, 0, 1], lower=np.radians(-1.0), upper=np.radians(1.0))
    banded = check_trajectory(trajectory, dataclasses.replace(task, bands=(band,)))
    assert not found(banded, "outside a band").passes
    excess = found(whole, "axis error").value - 1.0
    assert np.degrees(found(banded, "outside a band").value) == pytest.approx(excess, rel=1e-3)
    tilted = trajectory.q.copy()
    tilted[3, 4] += np.radians(1.0)
    check = check_trajectory(TimedPath(trajectory.joint_names, tilted), task)
    configuration = mink.Configuration(task.model, tilted[3])
    axis = configuration.get_transform_frame_to_world("tool", "site").rotation().as_matrix()[:, 2]
    expected = np.arccos(axis @ task.waypoints[3].rotation().as_matrix()[:, 2])
    assert found(check, "axis error").value == pytest.approx(np.degrees(expected), rel=1e-6)
    assert found(check, "axis error").where == "waypoint 4"


def test_tolerances_and_joints_are_checked() -> None:
    trajectory = corner()
    off = TimedPath(NAMES, trajectory.q + np.array([0.0, 5e-4]))
    assert not check_trajectory(off, trajectory.path_task).passes
    assert check_trajectory(off, trajectory.path_task, position_tolerance=1e-3).passes
    with pytest.raises(qt.InvalidInput, match="no column for slide_2"):
        check_trajectory(TimedPath(("slide_1",), np.zeros((3, 1))), trajectory.path_task)
    with pytest.raises(qt.InvalidInput, match="times have to increase"):
        check_trajectory(TimedPath(NAMES, np.zeros((2, 2)), np.zeros(2)), trajectory.path_task)
    with pytest.raises(qt.InvalidInput, match="at least two rows"):
        check_trajectory(TimedPath(NAMES, np.zeros((1, 2))), trajectory.path_task)


# ---------------------------------------------------------------- how exactly


def line_task(count: int = 5, *, velocity: float = np.inf, acceleration: float = np.inf,
              durations: float | None = 1.0) -> tuple[qt.PathTask, Array]:  # fmt: skip
    """One slide along x, waypoints a metre apart; within ± 9 m."""
    q = np.arange(float(count))[:, None]
    time = None if durations is None else evenly(count, durations)
    path = joint_path(slider(), q, time, velocity=velocity, acceleration=acceleration)
    return path.path_task, q


def verdict(task: qt.PathTask, q: Array, *args: Array, **options: float) -> Check:
    return check_trajectory(TimedPath(("slide_1",), q, *args), task, **options)


@pytest.mark.parametrize(("over", "passes"), [(-1e-3, True), (5e-7, True), (1e-5, False)])
def test_a_speed_may_exceed_its_limit_by_a_millionth(over: float, passes: bool) -> None:
    task, q = line_task(velocity=1.0 / (1.0 + over))
    check = verdict(task, q, np.arange(5.0))
    assert found(check, "velocity limits").passes == passes
    assert found(check, "velocity limits").value == pytest.approx(100.0 * (1.0 + over), abs=1e-6)
    assert check.passes == passes


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(("over", "passes"), [(-1e-3, True), (5e-7, True), (1e-5, False)])
def test_an_acceleration_may_exceed_its_limit_by_a_millionth(
    over: float, passes: bool, smooth: bool
) -> None:
    # From rest to rest 6 D/T²; straight, from 1 m/s to −1 m/s within 1 s between the middles.
    q = np.array([[0.0], [1.0], [0.0], [1.0]])
    largest = 6.0 if smooth else 2.0
    task = joint_path(slider(), q, evenly(4, 1.0), acceleration=largest / (1.0 + over)).path_task
    rows = (np.zeros((4, 1)),) if smooth else ()
    check = verdict(task, q, np.arange(4.0), *rows)
    assert found(check, "acceleration limits").passes == passes
    assert found(check, "acceleration limits").value == pytest.approx(100.0 * (1.0 + over))


@pytest.mark.parametrize(("end", "sign"), [("lower", -1.0), ("upper", 1.0)])
@pytest.mark.parametrize(("beyond", "passes"), [(-1e-3, True), (5e-7, True), (1e-5, False)])
def test_a_joint_may_be_outside_by_what_files_round(
    end: str, sign: float, beyond: float, passes: bool
) -> None:
    q = sign * (9.0 + beyond - np.arange(3.0)[:, None])
    task = joint_path(slider(), q, None).path_task
    margin = found(verdict(task, q), "smallest joint margin")
    assert margin.passes == passes, end
    assert margin.where == "slide_1, waypoint 1"
    assert margin.value == pytest.approx(-beyond / 9.0, abs=1e-12)


@pytest.mark.parametrize(("share", "passes"), [(0.5, True), (1.0005, True), (1.002, False)])
def test_the_feed_may_be_exceeded_by_a_thousandth(share: float, passes: bool) -> None:
    task, q = line_task()
    times = np.array([0.0, 1.0, 1.0 + 1.0 / share, 3.0 + 1.0 / share, 6.0])
    check = verdict(task, q, times)
    feed = found(check, "feed")
    assert feed.passes == passes
    if share > 1.0:
        assert (feed.value, feed.where) == (pytest.approx(100.0 * share), "waypoints 2 to 3")
    assert found(check, "time").value == 6.0


@pytest.mark.parametrize(("share", "passes"), [(1.0, True), (1.018, True), (1.03, False)])
def test_between_two_waypoints_the_feed_may_be_that_of_a_cubic_from_rest_to_rest(
    share: float, passes: bool
) -> None:
    """1.5 in the middle, beyond errors along the way; here they are none to speak of."""
    task, q = line_task(2)
    for tolerance in (1e-7, 1e-4):
        options = {"position_tolerance": tolerance}
        straight = verdict(
            task, np.array([[0.0], [0.01], [0.99], [1.0]]),
            np.array([0.0, 0.17, 0.17 + 0.98 / (1.5 * share), 1.0]), **options,
        )  # fmt: skip
        assert found(straight, "feed between").passes == passes
        assert found(straight, "feed between").value == pytest.approx(150.0 * share, rel=5e-3)
    # Row by row it is a thousandth.
    share = 1.0 + 0.05 * (share - 1.0)
    rest = np.zeros((2, 1))
    slow = verdict(task, q, np.array([0.0, 1.0 / share]), rest, position_tolerance=1e-7)
    assert found(slow, "feed between").passes == passes


def test_times_that_are_rounded_do_no_harm_and_excuse_no_jump() -> None:
    """As in JSON: whole nanoseconds. What moves within one of them moves fast all the same."""
    task, q = line_task(3, velocity=1.0, durations=None)
    for T in (1e-3, 1e-4):
        rows = np.array([0.0, T, 2.0 * T])[:, None]
        exact = joint_path(slider(), rows, None, velocity=1.0).path_task
        at = np.array([0.0, T - 1e-9, 2.0 * T])
        assert found(verdict(exact, rows, at), "velocity limits").passes
        at[1] -= 1e-8
        assert not found(verdict(exact, rows, at), "velocity limits").passes
    for T in (1e-12, 1e-10, 1e-9, 1e-8):
        for velocities in (None, np.zeros((3, 1))):
            rows = (np.array([0.0, T, 2.0 * T]), *([] if velocities is None else [velocities]))
            speed = found(verdict(task, q, *rows), "velocity limits")
            assert not speed.passes
            assert speed.value >= 100.0 / (T + 1.1e-9)


def shaken(
    spacing: float, *, low: float = 0.7, ramp: float = 1e-3, cycles: int = 5
) -> tuple[Array, ...]:
    """From rest to 1 m/s in 1 s, then five times down to 0.7 m/s and up again, 1 ms each; to rest.

    Returns:
        Times, positions (N, 1) and velocities (N, 1); the speed is linear between the rows.
    """
    knots = 1.0 + ramp * np.arange(2 * cycles + 1)
    inner = 1.0 + spacing * np.arange(1, round((knots[-1] - 1.0) / spacing))
    times = np.concatenate(
        [np.linspace(0.0, 1.0, 11), inner, knots[-1] + np.linspace(0.0, 1.0, 11)]
    )
    speeds = np.interp(
        times, [0.0, *knots, knots[-1] + 1.0], [0.0, *([1.0, low] * cycles), 1.0, 0.0]
    )
    q = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))])
    return times, q[:, None], speeds[:, None]


def line_of(q: Array, acceleration: float) -> qt.PathTask:
    return joint_path(
        slider(), q[[0, -1]], None, velocity=10.0, acceleration=acceleration
    ).path_task


@pytest.mark.parametrize("decimals", [9, 15])
@pytest.mark.parametrize("spacing", [1e-3, 1e-4, 1e-5, 2e-6])
def test_a_shaken_speed_is_refused_however_close_the_rows_are(
    spacing: float, decimals: int
) -> None:
    """300 m/s² where 2 are allowed; the times in full, and in nanoseconds."""
    times, q, speeds = shaken(spacing)
    check = verdict(line_of(q, 2.0), q, np.round(times, decimals), speeds)
    assert found(check, "acceleration limits").value == pytest.approx(100.0 * 300.0 / 2.0, rel=0.01)
    calm = shaken(spacing, low=1.0)
    passing = verdict(line_of(calm[1], 2.0), calm[1], np.round(calm[0], decimals), calm[2])
    assert passing.passes, passing.verdict
    assert found(passing, "acceleration limits").value == pytest.approx(50.0, rel=0.01)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("spacing", [1e-2, 1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("seed", range(3))
def test_a_motion_at_its_limits_passes_when_its_file_is_rounded(
    seed: int, spacing: float, smooth: bool
) -> None:
    """Bang-bang at ±a, rows anywhere; times in ns, positions and velocities with six decimals."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(spacing * rng.uniform(0.2, 1.0, size=1001))
    a = 3.0 * np.repeat(rng.choice([-1.0, 1.0], size=10), 100)
    v = np.concatenate([[0.0], np.cumsum(a * np.diff(times))])
    q = np.concatenate([[0.0], np.cumsum(np.diff(times) * 0.5 * (v[1:] + v[:-1]))])
    q, v = np.round(q, 6)[:, None], np.round(v, 6)[:, None]
    task = joint_path(slider(), q[[0, -1]], None, velocity=np.abs(v).max(), acceleration=3.0)
    check = verdict(task.path_task, q, np.round(times, 9), *([v] if smooth else []))
    for name in ("velocity limits", "acceleration limits"):
        assert found(check, name).passes, found(check, name)


@pytest.mark.parametrize("metadata", [{}, {"generator": "qp_twist 1", "interpolation": "cubic"}])
def test_rows_with_accelerations_are_judged_on_the_quintics_that_they_mean(
    metadata: dict[str, str],
) -> None:
    """Along slide_1 at 1 m/s; slide_2 is at rest at every row, and accelerated at one of them."""
    side = np.linspace(0.0, 1.0, 11)
    q, times = np.column_stack([side, 0.0 * side]), np.arange(11) * 0.1
    path = joint_path(slider(2), q, evenly(11, 0.1), velocity=2.0, acceleration=40.0)
    v, a = np.tile([1.0, 0.0], (11, 1)), np.zeros((11, 2))
    rows = TimedPath(NAMES, q, times, v, metadata)
    assert check_trajectory(rows, path.path_task).passes
    a[4, 1] = 50.0
    check = check_trajectory(dataclasses.replace(rows, accelerations=a), path.path_task)
    curve = BPoly.from_derivatives(times, list(zip(q, v, a, strict=True)))
    dense = np.linspace(0.0, 1.0, 100_001)
    off = np.abs(curve(dense)[:, 1]).max()
    assert found(check, "position error").passes
    assert found(check, "position error between").value == pytest.approx(1e3 * off, rel=0.02)
    assert not found(check, "position error between").passes
    accelerations = np.abs(curve(dense, 2)).max()
    assert found(check, "acceleration limits").value == pytest.approx(
        100.0 * accelerations / 40.0, rel=1e-3
    )
    assert any("degree five" in note for note in check.notes)


@pytest.mark.parametrize(
    ("angle", "passes"), [(1.0, True), (1.0 + 5e-6, True), (1.0 + 5e-5, False)]
)
def test_a_hard_band_may_be_left_by_a_hundredth_of_a_millimetre_or_a_thousandth_of_a_degree(
    angle: float, passes: bool
) -> None:
    """At a waypoint; between them by the tolerances, each band in its unit."""
    task, q = line_task(3, durations=None)
    moved = q.copy()
    moved[1] += angle - 1.0
    bands = (qt.SlabBand([1, 0, 0], -1.0, 0.0), qt.SlabBand([1, 0, 0], -0.5, 0.0, weight=1.0))
    free = qt.TwistProjector(linear=qt.Projector.plane([1, 0, 0]), angular=qt.Projector.none())
    banded = dataclasses.replace(task, bands=bands, projector=free)
    check = verdict(banded, moved)
    band = found(check, "outside a band")
    assert band.passes == passes
    assert band.value == pytest.approx(angle - 1.0, abs=1e-12)
    assert band.where == ("waypoint 1" if angle == 1.0 else "waypoint 2")
    # A soft one is no limit.
    soft = verdict(dataclasses.replace(banded, bands=bands[1:]), moved)
    assert not [f for f in soft.findings if "band" in f.name]


def elbow(limit: float) -> tuple[qt.PathTask, Array]:
    """A frame that rolls about its own z, 0.4 rad from each waypoint to the next and back."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="slide_1" axis="0 0 1" '
        'range="-3 3"/><geom size="0.1"/><site name="tool"/></body></worldbody></mujoco>'
    )
    q = np.zeros((3, 1))
    task = joint_path(model, q, None).path_task
    band = qt.RollBand([0, 0, 1], -limit, limit)
    return dataclasses.replace(task, bands=(band,)), q


@pytest.mark.parametrize(("over", "passes"), [(-0.1, True), (0.9, True), (1.1, False)])
def test_between_the_waypoints_a_hard_band_is_held_to_the_tolerance(
    over: float, passes: bool
) -> None:
    """A joint that rolls away and comes back between two waypoints: a cubic, 4/27 high at 1/3."""
    tolerance = np.radians(0.05)
    task, q = elbow(0.2)
    v = (0.2 + over * tolerance) * 27.0 / 4.0
    velocities = np.array([[v], [0.0], [0.0]])
    check = verdict(task, q, np.arange(3.0), velocities)
    band = found(check, "outside a band between")
    assert band.passes == passes
    assert band.value == pytest.approx(max(over, 0.0) * tolerance, rel=0.02)
    assert band.where == "roll band, waypoints 1 to 2"
    assert band.bound is not None
    assert band.bound >= max(over, 0.0) * tolerance * (1.0 - 1e-9)
    assert found(check, "outside a band").passes


@pytest.mark.parametrize(("over", "passes"), [(0.9, True), (1.1, False)])
def test_the_default_tolerances_are_a_tenth_of_a_millimetre_and_a_twentieth_of_a_degree(
    over: float, passes: bool
) -> None:
    task, q = line_task(3, durations=None)
    moved = q.copy()
    moved[2] -= 1e-4 * over
    assert verdict(task, moved).passes == passes
    turning, still = elbow(3.0)
    angular = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.line([0, 0, 1]))
    turning = dataclasses.replace(turning, projector=angular, bands=())
    still += np.radians(0.05) * over
    check = verdict(turning, still)
    assert check.passes == passes
    assert found(check, "axis error").value == pytest.approx(0.05 * over)


@pytest.mark.parametrize(("share", "passes"), [(0.995, False), (1.001, True)])
def test_what_lies_between_the_points_looked_at_decides(share: float, passes: bool) -> None:
    """An arc over its chord is highest in the middle, which is none of the ninths."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="slide_1" axis="0 0 1" '
        'range="-9 9"/><geom size="0.1"/><site name="tool" pos="2 0 0"/></body></worldbody>'
        "</mujoco>"
    )
    q = np.array([[0.0], [0.2]])
    task = joint_path(model, q, None).path_task
    height = 2.0 * (1.0 - np.cos(0.1))
    check = verdict(task, q, position_tolerance=share * height)
    between = found(check, "position error between")
    assert between.passes == passes
    assert between.bound is not None
    assert 1e3 * height <= between.bound <= 1.02e3 * height
    assert between.value <= 1e3 * height * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (slice(0, 15), "ends at waypoint 15 of 21: those after it are compared with its last row"),
        (slice(5, 21), "begins at waypoint 6 of 21: those before it are compared with its first"),
        (slice(0, 20), ""),  # a single waypoint is missing: its error says so
        (slice(0, 21), ""),
    ],
)
def test_a_part_of_the_path_is_called_so(part: slice, said: str) -> None:
    trajectory = corner()
    rows = TimedPath(NAMES, trajectory.q[part], (np.arange(21) * 0.1)[part])
    check = check_trajectory(rows, trajectory.path_task)
    assert check.passes == (part == slice(0, 21))
    notes = [note for note in check.notes if "waypoint" in note]
    assert [said in note for note in notes] == [True] * bool(said)


@pytest.mark.parametrize(("before", "after"), [(0, 0), (3, 0), (0, 1), (3, 4)])
def test_rows_before_and_after_the_path_are_counted(before: int, after: int) -> None:
    task, q = line_task()
    beside = np.concatenate([np.arange(before) - before, q[:, 0], 4.0 + np.arange(1, after + 1)])
    notes = " ".join(verdict(task, beside[:, None], np.arange(len(beside)) * 1.0).notes)
    assert ("3 rows before the first waypoint" in notes) == (before == 3)
    assert ("1 row after the last waypoint" in notes) == (after == 1)
    assert ("4 rows after the last waypoint" in notes) == (after == 4)
    assert ("not against the path" in notes) == (before + after > 0)


@pytest.mark.parametrize("end", [0, 1])
def test_a_trajectory_that_begins_or_ends_at_speed_says_so(end: int) -> None:
    task, q = line_task(2, acceleration=100.0)
    for speed, said in ((5e-7, False), (1e-3, True)):
        velocities = np.zeros((2, 1))
        velocities[end] = -speed
        line = verdict(task, q, np.array([0.0, 2.0]), velocities).verdict
        at_speed = f"slide_1 {('begins', 'ends')[end]} at 0.001 m/s"
        assert (at_speed in line) == said


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("with_velocities", [True, False])
def test_a_joint_that_cannot_brake_inside_its_range_does_not_pass(
    end: int, with_velocities: bool
) -> None:
    """At 2 m/s² a joint at 1 m/s comes to rest after 0.25 m; rows of positions begin at speed."""
    task = line_task(2, acceleration=2.0)[0]
    lower, upper = qt.JointRanges.of(task.model).lower[0], qt.JointRanges.of(task.model).upper[0]
    times = np.linspace(0.0, 1.0, 11)
    for room, fits in ((0.26, True), (0.24, False)):
        q = (upper - room - 1.0 + times if end else lower + room + times)[:, None]
        rows = TimedPath(NAMES[:1], q, times, np.ones_like(q) if with_velocities else None)
        findings = check_trajectory(rows, task).findings
        name = ("range before the first row", "range after the last row")[end]
        left = [finding for finding in findings if finding.name == name]
        assert bool(left) != fits
        assert all(finding.value == pytest.approx(0.01) and not finding.passes for finding in left)


def test_places_are_counted_from_1() -> None:
    """Rows, and waypoints: of a joint that leaves its range at row 8, at waypoint 4."""
    rows = np.repeat(np.arange(6.0), 2)[:-1, None]
    rows[1::2] += 0.5
    task = joint_path(slider(), np.arange(6.0)[:, None] + 4.0, None).path_task
    rows = np.sort(rows + 4.0, axis=0)
    rows[7] = 9.5
    margin = found(verdict(task, rows), "smallest joint margin")
    assert margin.where == "slide_1, row 8, waypoint 4"
    timed = found(verdict(task, rows, 0.5 * np.arange(11.0)), "smallest joint margin")
    assert timed.where == "slide_1, 3.5 s, waypoint 4"


# ---------------------------------------------------------------- what could not be checked


def test_a_verdict_says_first_what_was_not_checked_and_passes_with_it() -> None:
    task, q = line_task(velocity=2.0, acceleration=100.0)
    # From rest to rest; between them at 1 m/s, which no row exceeds.
    timed = np.array([0.0, 1.5, 2.5, 3.5, 5.0]), np.array([0.0, 1.0, 1.0, 1.0, 0.0])[:, None]
    plain = verdict(task, q, *timed)
    # Accelerations of cubics jump at the rows: of jerks they say nothing.
    jerks = "jerks not checked: no accelerations"
    assert plain.verdict == f"passes; {jerks} (5 rows of task rows)"
    for change, sentence, kind in (
        ("velocity_limits", "joint speeds not checked: no limits known", "unchecked"),
        (
            "acceleration_limits",
            "accelerations checked against the default: full speed within 0.25 s",
            "sources",
        ),
    ):
        unlimited = dataclasses.replace(task, **{change: np.array([np.inf])})
        check = verdict(unlimited, q, *timed)
        assert check.passes
        both = (sentence, jerks) if kind == "unchecked" else (jerks, sentence)
        assert check.verdict == f"passes; {'; '.join(both)} (5 rows of task rows)"
        assert sentence in check.to_dict()[kind]
        assert len(check.unchecked) + len(check.sources) == 2
    assert verdict(task, q).unchecked == (
        "feed, joint speeds and accelerations not checked: no times",
    )
    fast = verdict(task, q, np.arange(5.0) / 4.0)
    assert fast.verdict.startswith("does not pass: velocity limits: 200 %")


def test_jerk_limits_of_the_task_do_not_pass_unseen_and_defaults_name_their_joints() -> None:
    trajectory = corner(velocity=2.0, acceleration=40.0)
    jerk = np.array([800.0, np.inf])
    task = dataclasses.replace(trajectory.path_task, jerk_limits=jerk)
    rest = np.zeros_like(trajectory.q)
    cubic = TimedPath(NAMES, trajectory.q, np.arange(21) * 0.5, rest)
    assert check_trajectory(cubic, trajectory.path_task).passes
    check = check_trajectory(cubic, task)
    assert "jerk limits: inf % at rows, at which accelerations may jump" in check.verdict
    quintic = check_trajectory(dataclasses.replace(cubic, accelerations=rest), task)
    assert quintic.passes
    source = "jerks of slide_2, which the task does not state, checked against the default"
    assert source in quintic.verdict


def test_single_joints_without_limits_and_models_without_ranges_are_named() -> None:
    trajectory = corner(velocity=np.array([2.0, np.inf]), acceleration=40.0)
    rows = TimedPath(NAMES, trajectory.q, np.arange(21) * 0.1)
    check = check_trajectory(rows, trajectory.path_task)
    assert check.unchecked[0] == "joint speeds of slide_2 not checked: no limits known"
    assert check.unchecked[-1] == "jerks not checked: no accelerations"
    assert all("rest at its ends" in sentence for sentence in check.unchecked[1:-1])
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body>"
        + "".join(f'<joint name="j{i}"/>' for i in range(6))
        + '<geom size="0.1"/><site name="tool"/></body></worldbody><equality>'
        '<joint joint1="j0" joint2="j1"/></equality></mujoco>'
    )
    limits = np.array([1.0, *[np.inf] * 5])
    task = joint_path(model, np.zeros((3, 6)), evenly(3, 1.0), limits, 1.0).path_task
    names = tuple(f"j{i}" for i in range(6))
    assert check_trajectory(TimedPath(names, np.zeros((3, 6)), np.arange(3.0)), task).unchecked == (
        "joint speeds of j1, j2, j3 and 2 more not checked: no limits known",
        "joint ranges not checked: the model states none",
        "jerks not checked: no accelerations",
    )


def named_arm(name: str, lengths: tuple[float, float] = (0.425, 0.3922)) -> mujoco.MjModel:
    """An arm with the joint axes of a UR5e, all but its base and wherever it stands."""
    upper, lower = lengths
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco model="{name}"><compiler angle="radian"/><worldbody>
        <body pos="1 2 3" euler="0.3 0.4 0.5"><joint name="a" axis="0 0 1"/><geom size="0.1"/>
        <body pos="0 0 0.16"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
        <body pos="{upper} 0 0"><joint name="c" axis="0 1 0"/><geom size="0.1"/>
        <body pos="{lower} 0 0"><joint name="d" axis="0 1 0"/><geom size="0.1"/>
        <body pos="0 0.1333 0"><joint name="e" axis="0 0 -1"/><geom size="0.1"/>
        <body pos="0 0 -0.0997"><joint name="f" axis="0 1 0"/><geom size="0.1"/>
        <site name="tool" pos="0 0.1 0"/>
        </body></body></body></body></body></body></worldbody></mujoco>"""
    )


def test_a_known_robot_is_checked_against_its_data_sheet_which_is_named() -> None:
    """7.5 rad/s on an arm that can do 180°/s."""
    q = np.array([0.1, -1.0, 1.2, 0.3, 0.4, 0.5]) + np.outer([0.0, 0.75, 1.5], np.ones(6))
    arm = named_arm("ur5e")
    trajectory = joint_path(arm, q, evenly(3, 0.1))
    names = tuple("abcdef")
    task = trajectory.path_task
    check = check_trajectory(TimedPath(names, q, np.arange(3) * 0.1), task, position_tolerance=1.0)
    speeds = found(check, "velocity limits")
    assert not speeds.passes
    assert speeds.value == pytest.approx(100.0 * 7.5 / np.pi)
    of_robot = "speeds checked against the Universal Robots UR5e's data sheet"
    default = "accelerations checked against the default: full speed within 0.25 s"
    assert check.verdict.endswith(f"; {of_robot}; {default}")
    assert (task.velocity_limits == np.inf).all()  # what steps and plans hold does not change
    slow = TimedPath(names, q, np.arange(3) * 1.0)
    check = check_trajectory(slow, task, position_tolerance=1.0, axis_tolerance_deg=90.0)
    assert found(check, "velocity limits").passes
    assert check.sources == (of_robot, default)
    assert "joint speeds" not in " ".join(check.unchecked)
    # What the task states wins, joint by joint.
    stated = dataclasses.replace(task, velocity_limits=np.array([0.5, *[np.inf] * 5]))
    check = check_trajectory(slow, stated, position_tolerance=1.0)
    assert found(check, "velocity limits").value == pytest.approx(150.0)
    assert check.sources == (of_robot, default)
    stated = dataclasses.replace(
        task, velocity_limits=np.full(6, 9.0), acceleration_limits=np.full(6, 9.0)
    )
    check = check_trajectory(slow, stated, position_tolerance=1.0)
    assert found(check, "velocity limits").value == pytest.approx(100.0 * 0.75 / 9.0)
    assert not check.sources


# ---------------------------------------------------------------- the command


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trajectory file of the planar line, and one with a row that is off."""
    folder = tmp_path_factory.mktemp("line")
    main(["--quiet", "run", "planar_line", "--method", "qp_gradient",
          "--out", str(folder / "line.csv")])  # fmt: skip
    rows = read_trajectory(folder / "line.csv")
    document = {
        "joint_names": rows.joint_names,
        "points": [{"positions": row.tolist()} for row in rows.q + np.eye(101, 3, k=-40) * 1e-3],
    }
    (folder / "off.json").write_text(json.dumps(document))
    return folder


def test_the_command_passes_with_0_and_prints_the_table(
    line: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["check", str(line / "line.csv"), "planar_line"])
    out = capsys.readouterr().out
    assert "101 rows, 101 waypoints, row by row" in out
    assert "smallest joint margin" in out
    unknown = "joint speeds and accelerations not checked: no times"
    assert out.splitlines()[-1] == f"passes; {unknown} (101 rows of task planar_line)"


def test_the_command_fails_with_1_and_says_what_and_where(
    line: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["check", str(line / "off.json"), "planar_line"])
    assert caught.value.code == 1
    assert "does not pass: position error: 2" in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["check", str(line / "off.json"), "planar_line", "--json"])
    assert caught.value.code == 1
    content = json.loads(capsys.readouterr().out)
    assert content["passes"] is False
    assert content["findings"][0]["where"] == "waypoint 41"
    main(["check", str(line / "off.json"), "planar_line", "--position-tolerance", "0.01"])


def test_the_command_cannot_read_with_2(line: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (line / "broken.csv").write_text("joint_1,joint_2,joint_3\n1,2,x\n")
    for file, sentence in (("broken.csv", "line 2, column 'joint_3'"), ("none.csv", "none.csv")):
        with pytest.raises(SystemExit) as caught:
            main(["check", str(line / file), "planar_line"])
        assert caught.value.code == 2
        assert sentence in capsys.readouterr().err

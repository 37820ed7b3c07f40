"""Checks of trajectories: what passes, what does not and where, rows of any number."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import mink
import numpy as np
import pytest
from joint_paths import evenly, joint_path, short, slider

import qp_twist as qt
from qp_twist.cli import check as _  # noqa: F401  (its command)
from qp_twist.cli import main
from qp_twist.exchange import (
    ENDINGS,
    Check,
    Finding,
    JointRows,
    check_trajectory,
    read_trajectory,
    write_trajectory,
)
from qp_twist.exchange.matching import _cost as matching_cost
from qp_twist.timing import time_trajectory

Array = np.ndarray
NAMES = ("slide_1", "slide_2")


def corner(acceleration: float = np.inf, velocity: float = 2.0) -> qt.Trajectory:
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
    assert check.matched == "row by row"
    assert found(check, "acceleration limits").value <= 100.0 + 1e-9
    assert found(check, "time").value == pytest.approx(timed.times[-1])
    # Rows far off under the same errors as before.
    lying = dataclasses.replace(timed.trajectory, q=timed.q + np.array([0.01, 0.0]))
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
    check = check_trajectory(JointRows(NAMES, q, times), trajectory.path_task)
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
    check = check_trajectory(JointRows(NAMES, q, waiting), trajectory.path_task)
    assert found(check, "feed").passes
    assert not found(check, "feed between").passes
    assert found(check, "feed between").value == pytest.approx(1000.0, rel=0.02)
    steady = check_trajectory(JointRows(NAMES, trajectory.q, times), trajectory.path_task)
    assert found(steady, "feed between").value == pytest.approx(100.0, rel=0.02)


def test_errors_within_the_tolerance_are_no_speed() -> None:
    """Pieces of a tenth of a millimetre, each point up to 40 µm off along the path."""
    side = np.linspace(0.0, 0.01, 101)
    trajectory = joint_path(slider(2), np.column_stack([side, 0.0 * side]), evenly(101, 0.01),
                            velocity=np.inf)  # fmt: skip
    q = trajectory.q.copy()
    q[1:-1, 0] += np.random.default_rng(0).uniform(-4e-5, 4e-5, 99)
    check = check_trajectory(JointRows(NAMES, q, np.arange(101) * 0.01), trajectory.path_task)
    assert check.passes, check.verdict


@pytest.mark.parametrize("axis_error", [0.0, 0.15, 3.0])
def test_of_two_poses_with_the_same_axis_error_the_nearer_one_is_matched(axis_error: float) -> None:
    task = qt.load_task("deburring")
    waypoint = task.waypoints[0]
    turned = waypoint.rotation().multiply(mink.SO3.from_x_radians(axis_error)).as_matrix()
    away = np.outer([0.0, 1e-4, 5e-3, 1.5e-2, 0.3], [1.0, 0.0, 0.0]) + waypoint.translation()
    costs = matching_cost(task, 0, np.tile(turned, (5, 1, 1)), away, (1e-4, np.radians(0.05)))
    assert (np.diff(costs) > 0.0).all()


def test_a_file_that_says_it_was_made_for_something_else_is_told_of() -> None:
    trajectory = corner()
    rows = JointRows.of(trajectory)
    assert not [n for n in check_trajectory(rows, trajectory.path_task).notes if "metadata" in n]
    units = dict.fromkeys(NAMES, "deg")
    lying = rows.metadata | {"task": "another", "robot": 7, "units": units, "frame": "odd"}
    told = check_trajectory(dataclasses.replace(rows, metadata=lying), trajectory.path_task).notes
    assert [note for note in told if "task 'another'" in note]
    assert [note for note in told if "robot '7'" in note]
    assert len([note for note in told if "'deg'" in note and "'m'" in note]) == 2


def test_an_acceleration_is_that_of_the_cubic_or_of_the_change_of_speed() -> None:
    trajectory = corner(acceleration=4.0)
    times = np.arange(21) * 0.1
    # Straight pieces: at the corner 1 m/s ends and 1 m/s begins within 0.1 s.
    check = check_trajectory(JointRows(NAMES, trajectory.q, times), trajectory.path_task)
    assert found(check, "acceleration limits").value == pytest.approx(100.0 * 10.0 / 4.0)
    assert "waypoint 11" in found(check, "acceleration limits").where
    # From rest to rest in every piece: 6 D/T² at its ends.
    rows = JointRows(NAMES, trajectory.q, times, np.zeros((21, 2)))
    check = check_trajectory(rows, trajectory.path_task)
    assert found(check, "acceleration limits").value == pytest.approx(100.0 * 60.0 / 4.0)
    assert found(check, "velocity limits").value == pytest.approx(100.0 * 1.5 / 2.0)


def test_the_way_between_the_waypoints_counts() -> None:
    trajectory = corner()
    velocities = np.zeros((21, 2))
    velocities[:, 1] = [0.5, -0.5] * 10 + [0.5]
    rows = JointRows(NAMES, trajectory.q, np.arange(21) * 0.1, velocities)
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
    assert check_trajectory(JointRows(NAMES, q, t), trajectory.path_task).passes
    q[340, 1] = 0.02  # away and back within 2 ms of the 100 between two waypoints
    check = check_trajectory(JointRows(NAMES, q, t), trajectory.path_task)
    assert found(check, "position error").passes
    between = found(check, "position error between")
    assert not between.passes
    assert between.value == pytest.approx(20.0)
    assert between.where == "waypoints 4 to 5"


def test_a_joint_that_leaves_its_range_between_two_rows_is_outside() -> None:
    q = np.array([[8.9], [8.9]])
    # Out at 2 m/s, back at 1: with u = t/T the way is T (2u − 3u² + u³), at most 2√3/9 T.
    T = 0.100025 / (2.0 * np.sqrt(3.0) / 9.0)
    rows = JointRows(("slide_1",), q, np.array([0.0, T]), np.array([[2.0], [-1.0]]))
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
    check = check_trajectory(JointRows(NAMES, q, t), trajectory.path_task)
    assert check.passes, check.verdict
    # Without the corner nobody passes it.
    missing = check_trajectory(JointRows(NAMES, q[t != 1.0], t[t != 1.0]), trajectory.path_task)
    assert not missing.passes or rows == 1000
    # A path that ends early misses the rest.
    early = check_trajectory(JointRows(NAMES, q[t < 1.5], t[t < 1.5]), trajectory.path_task)
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
    assert check_trajectory(JointRows(NAMES, whole), task).passes
    assert not check_trajectory(JointRows(NAMES, whole[::-1]), task).passes


def test_a_path_that_is_passed_twice_is_matched_in_its_order() -> None:
    side = np.linspace(0.0, 1.0, 9)
    there_and_back = np.column_stack([np.append(side, side[-2::-1]), np.zeros(17)])
    task = joint_path(slider(2), there_and_back, None).path_task
    t = np.linspace(0.0, 1.0, 33)
    dense = np.column_stack([np.append(t, t[-2::-1]), np.zeros(65)])
    assert check_trajectory(JointRows(NAMES, dense), task).passes
    once = check_trajectory(JointRows(NAMES, dense[:33]), task)
    assert not once.passes
    assert found(once, "position error").value > 100.0


def test_a_motion_that_stands_still_fails_in_numbers_that_json_has() -> None:
    trajectory = corner()
    still = JointRows(NAMES, np.zeros((5, 2)), np.arange(5.0))
    check = check_trajectory(still, trajectory.path_task)
    assert found(check, "position error").value == pytest.approx(1e3 * np.sqrt(2.0))
    assert not found(check, "feed").passes
    assert json.loads(json.dumps(check.to_dict(), allow_nan=False))["passes"] is False


def test_without_times_only_the_path_is_checked_and_that_is_said() -> None:
    trajectory = corner()
    check = check_trajectory(trajectory, trajectory.path_task)
    assert check.passes
    assert "no times" in check.notes[0]
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
    check = check_trajectory(JointRows(trajectory.joint_names, tilted), task)
    configuration = mink.Configuration(task.model, tilted[3])
    axis = configuration.get_transform_frame_to_world("tool", "site").rotation().as_matrix()[:, 2]
    expected = np.arccos(axis @ task.waypoints[3].rotation().as_matrix()[:, 2])
    assert found(check, "axis error").value == pytest.approx(np.degrees(expected), rel=1e-6)
    assert found(check, "axis error").where == "waypoint 4"


def test_tolerances_and_joints_are_checked() -> None:
    trajectory = corner()
    off = JointRows(NAMES, trajectory.q + np.array([0.0, 5e-4]))
    assert not check_trajectory(off, trajectory.path_task).passes
    assert check_trajectory(off, trajectory.path_task, position_tolerance=1e-3).passes
    with pytest.raises(qt.InvalidInput, match="no column for slide_2"):
        check_trajectory(JointRows(("slide_1",), np.zeros((3, 1))), trajectory.path_task)
    with pytest.raises(qt.InvalidInput, match="times have to increase"):
        check_trajectory(JointRows(NAMES, np.zeros((2, 2)), np.zeros(2)), trajectory.path_task)
    with pytest.raises(qt.InvalidInput, match="at least two rows"):
        check_trajectory(JointRows(NAMES, np.zeros((1, 2))), trajectory.path_task)


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
    assert out.splitlines()[-1] == "passes: 101 rows do planar_line"


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


def test_a_file_in_degrees_in_another_order_passes(line: Path) -> None:
    rows = read_trajectory(line / "line.csv")
    lines = ["time,joint_3 [deg],joint_1 [deg],joint_2 [deg]"]
    for k, q in enumerate(np.degrees(rows.q)):
        lines.append(",".join(map(repr, [0.1 * k, *map(float, q[[2, 0, 1]])])))
    (line / "degrees.csv").write_text("\n".join(lines))
    main(["check", str(line / "degrees.csv"), "planar_line"])


@pytest.mark.parametrize("duration", [0.001, 0.005])
def test_short_pieces_keep_their_limits_in_every_file(duration: float, tmp_path: Path) -> None:
    s = np.linspace(0.0, 1.0, 201)
    q = 0.5 * np.column_stack([np.sin(6.0 * s), np.cos(6.0 * s)])
    moving = joint_path(slider(2), q, evenly(201, duration), velocity=2.0, acceleration=5.0)
    timed = time_trajectory(moving)
    for ending in ENDINGS:
        rows = read_trajectory(write_trajectory(timed, tmp_path / f"short{ending}"))
        check = check_trajectory(rows, moving.path_task)
        assert check.passes, (ending, check.verdict)
        assert found(check, "acceleration limits").value == pytest.approx(100.0, rel=1e-3)


def test_written_and_read_the_task_error_is_the_same(tmp_path: Path) -> None:
    task = short(qt.load_task("deburring"), 6)
    trajectory = qt.follow(task, "qp_minimum_norm", slow_down=True)
    for ending in (".csv", ".npz", ".json"):
        path = write_trajectory(time_trajectory(trajectory), tmp_path / f"t{ending}")
        check = check_trajectory(read_trajectory(path), task)
        assert check.passes
        value = found(check, "position error").value
        assert value == pytest.approx(1e3 * trajectory.position_error.max(), abs=1e-12)


def test_a_file_that_is_not_there_is_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["check", "nosuch.csv", "planar_line"])
    assert caught.value.code == 2
    assert "nosuch.csv: there is no such trajectory file" in capsys.readouterr().err

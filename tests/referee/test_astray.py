"""A motion that ends before its path does, or leaves it: where, and by how much at most."""

import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.ball_cell import FEED, ball_before, write_cell
from oracles.joint_paths import evenly, joint_path, slider
from oracles.twists import ALONG_X

import qp_twist as qt
from qp_twist.cli import main

Array = np.ndarray
NAMES = ("slide_1", "slide_2")
SIDE = np.linspace(0.0, 1.0, 21)
LINE = np.column_stack([SIDE, 0.0 * SIDE])
"""The path, a metre along x in 2 s."""
TASK = joint_path(slider(2), LINE, evenly(21, 0.1), acceleration=1e6).path_task


def checked(q: Array, step: float = 0.1) -> qt.trajectories.Check:
    return qt.check_trajectory(qt.TimedPath(NAMES, q, step * np.arange(len(q))), TASK)


def value(check: qt.trajectories.Check, name: str) -> float:
    [finding] = [f for f in check.findings if f.name == name]
    return finding.value


@given(st.integers(1, 17), st.floats(0.01, 3.0), st.floats(-1.0, 1.0))
@settings(max_examples=20, deadline=None)
def test_a_motion_that_leaves_the_path_has_the_largest_error_of_all_of_it(
    last: int, away: float, along: float
) -> None:
    """It goes straight off, further and further, or along the path at a growing distance."""
    end = LINE[last] + [along * (1.0 - SIDE[last]), away]
    off = LINE[last] + np.linspace(0.0, 1.0, 41)[1:, None] * (end - LINE[last])
    check = checked(np.vstack([LINE[: last + 1], off]))
    assert not check.passes
    largest = max(f.value for f in check.findings if f.name.startswith("position error"))
    # The least that there is to be named: how far from any point of the path.
    nearest = np.clip(off[:, 0], 0.0, 1.0)
    assert largest >= 1e3 * np.hypot(off[:, 0] - nearest, off[:, 1]).max() - 1e-6
    if check.path_left:
        assert check.verdict.startswith("does not pass: leaves the path for good after waypoint")
        [part] = check.astray
        assert part.waypoint == last + 1
        assert part.times[-1] == check.motion.times[-1]


def test_what_goes_away_and_never_comes_back_is_not_measured_where_it_is_nearest() -> None:
    away = np.column_stack([np.full(20, SIDE[12]), np.linspace(0.05, 1.0, 20)])
    check = checked(np.vstack([LINE[:13], away]))
    assert check.path_left == ("leaves the path for good after waypoint 13 of 21",)
    assert value(check, "position error off the path") == pytest.approx(1e3, rel=1e-6)
    [finding] = [f for f in check.findings if f.name == "position error off the path"]
    assert finding.where == "3.2 s, after waypoint 13, the last one met"
    backwards = checked(np.vstack([LINE[:13], away])[::-1] * [-1.0, 1.0] + [1.0, 0.0])
    assert backwards.path_left == ("comes onto the path only at waypoint 9 of 21",)
    assert value(backwards, "position error off the path") == pytest.approx(1e3, rel=1e-6)


def test_a_retreat_from_the_whole_path_is_not_off_it() -> None:
    retreat = np.column_stack([np.full(5, 1.0), np.linspace(0.1, 0.5, 5)])
    check = checked(np.vstack([LINE, retreat]))
    assert check.passes, check.verdict
    assert not check.astray


# ---------------------------------------------------------------- runs


def rail() -> qt.PathTask:
    """A slide whose range ends at 9 m, on a path to 10 m and back to 8 m."""
    rows = np.concatenate([np.linspace(8.0, 10.0, 9), np.linspace(9.75, 8.0, 8)])[:, None]
    free = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="slide_1" type="slide" axis="1 0 0"/>'
        '<geom size="0.1" mass="1"/><site name="tool"/></body></worldbody></mujoco>'
    )
    along = ALONG_X
    task = joint_path(free, rows, evenly(17, 1.0), velocity=1.0, projector=along).path_task
    return dataclasses.replace(task, model=slider())


@pytest.mark.parametrize("solver", [None, "daqp"])
def test_a_run_that_may_slow_down_ends_where_no_time_takes_it_further(solver: str | None) -> None:
    run = qt.follow(rail(), "qp_minimum_norm", slow_down=True, solver=solver)
    assert run.q[:, 0] == pytest.approx(np.linspace(8.0, 9.0, 5))
    assert run.position_error.max() < 1e-8
    assert run.kept == 5
    assert run.blocked_by is not None and "slide_1" in run.blocked_by[0]
    assert "ends at waypoint 5 of 17" in run.ending and "slide_1" in run.ending
    assert run.ending in repr(run)


def test_a_run_at_the_feed_goes_on_and_says_where_it_left_the_path() -> None:
    """As methods are compared: with every waypoint, and the largest error among them."""
    run = qt.follow(rail(), "qp_minimum_norm")
    assert len(run.q) == 17
    assert run.position_error.max() == pytest.approx(1.0)
    assert run.kept == 5
    assert "leaves the path at waypoint 6 of 17" in run.ending
    status = qt.compare(rail(), ["qp_minimum_norm"]).to_dict()["methods"]["qp_minimum_norm"]
    assert status["position_error_max_m"] == pytest.approx(1.0)
    assert "first at 6" in status["status"] and "1000 mm at 9" in status["status"]


def test_the_command_writes_what_was_reached_and_says_where_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Along x into a wall, which the ball may come near to 10 mm: at x = 0.47."""
    monkeypatch.chdir(tmp_path)
    wall = ball_before("wall", (0.6, 0.0), (0.1, 1.0))
    for name, first in (("wall", 0.0), ("at_once", 0.46)):
        write_cell(name, wall, first, 1.0, steps=5, more=FEED)
    with pytest.raises(SystemExit) as end:
        main(["run", "wall.toml", "--method", "qp_gradient", "--out", "run.json"])
    assert end.value.code == 1
    said = capsys.readouterr()
    assert "ends at waypoint 3 of 6" in said.err
    assert "ball to wall" in said.out or "wall to ball" in said.out
    assert "inf" not in said.err and "e+" not in said.err
    points = json.loads(Path("run.json").read_text())["points"]
    x = np.array([point["positions"] for point in points])[:, 0]
    assert x[-1] == pytest.approx(0.4) and (np.diff(x) >= 0.0).all()
    with pytest.raises(SystemExit) as end:
        main(["run", "at_once.toml", "--out", "none.json"])
    assert end.value.code == 1
    assert "not written: qp_gradient ends at waypoint 1 of 6" in capsys.readouterr().err
    assert not Path("none.json").exists()

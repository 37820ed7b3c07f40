"""The motion before the first waypoint and after the last keeps what the task states.

A ball on two slides is moved among boxes: its distance from a box is a formula.
"""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.ball_cell import BALL, DISTANCE, ball_before, write_cell
from oracles.half_space import HalfSpace
from oracles.joint_paths import joint_path

import qp_twist as qt
from qp_twist.cli import main

Array = np.ndarray
NAMES = ("x", "y")
BOX = np.array([0.1, 0.2])
"""Half sizes of the box around (0, 0.6), m."""
XML = ball_before("box", (0.0, 0.6), BOX)
LINE = np.column_stack([np.linspace(-0.5, 0.5, 11), np.zeros(11)])
"""The path, below the box."""
AROUND = np.array([[-0.5, 0.0], [-0.5, 0.6]])
THROUGH = np.array([[-0.5, 0.0], [-0.5, 0.6], [0.5, 0.6]])


def gaps(q: Array) -> Array:
    """Distance of the ball from the box at positions q (K, 2); at most 0 where they touch."""
    beside = np.abs(q - [0.0, 0.6]) - BOX
    outside = np.linalg.norm(np.maximum(beside, 0.0), axis=1)
    return outside + np.minimum(beside.max(axis=1), 0.0) - BALL


def task_with(*ignored: tuple[str, str]) -> qt.PathTask:
    model = mujoco.MjModel.from_xml_string(XML)
    clearance = qt.Clearance(model, DISTANCE, ignore=ignored)
    task = joint_path(model, LINE, None).path_task
    return dataclasses.replace(task, constraints=(clearance,))


TASK = task_with()


def joined(run_in: Array, run_out: Array) -> Array:
    """The path with rows before and after it."""
    return np.vstack([run_in, LINE, run_out])


def failed(check: qt.trajectories.Check) -> list[str]:
    return [finding.name for finding in check.findings if not finding.passes]


@pytest.mark.parametrize("timed", [False, True])
def test_a_collision_beside_the_path_is_named_with_pair_place_and_depth(timed: bool) -> None:
    way = THROUGH[1:] * [-1.0, 1.0]  # up beside the box, then through it
    rows = joined(way[:0], way)
    times = np.arange(len(rows)) * 0.5 if timed else None
    check = qt.check_trajectory(qt.TimedPath(NAMES, rows, times), TASK)
    assert failed(check) == ["outside clearance after the path"]
    [finding] = [f for f in check.findings if not f.passes]
    # In the middle of the box, the row between 12 and 13: a tenth of a metre deep.
    assert finding.value == pytest.approx(BOX[0] + BALL + DISTANCE, abs=1e-3)
    pair, place, side = finding.where.split(", ")
    assert (pair, side) == ("box to ball", "after the last waypoint")
    assert place in (["5.75 s"] if timed else ["row 12", "row 13"])
    assert "after the path" in check.verdict
    mirrored = qt.TimedPath(NAMES, rows[::-1] * [-1.0, 1.0], times)
    check = qt.check_trajectory(mirrored, TASK)
    assert failed(check) == ["outside clearance before the path"]
    [finding] = [f for f in check.findings if not f.passes]
    assert finding.where.endswith("before the first waypoint")


def test_a_way_around_passes_and_that_is_said_in_a_line() -> None:
    check = qt.check_trajectory(qt.TimedPath(NAMES, joined(AROUND[:0], AROUND[1:] * [-1, 1])), TASK)
    assert check.passes, check.verdict
    [finding] = [f for f in check.findings if f.name.endswith("after the path")]
    assert finding.value == 0.0 and finding.bound is not None
    assert not [f for f in check.findings if f.name.endswith("before the path")]


POINTS = st.lists(st.tuples(st.floats(-0.9, 0.9), st.floats(0.0, 1.2)), min_size=1, max_size=4)


@given(POINTS, POINTS, st.booleans(), st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_whatever_comes_too_near_beside_the_path_does_not_pass(
    before: list[tuple[float, float]], after: list[tuple[float, float]], cubic: bool, seed: int
) -> None:
    rows = joined(np.array(before), np.array(after))
    times = np.arange(float(len(rows)))
    velocities = None
    if cubic:  # at rest on the path, so that it stays there
        velocities = np.random.default_rng(seed).normal(size=rows.shape)
        velocities[len(before) : len(before) + len(LINE)] = 0.0
    given_rows = qt.TimedPath(NAMES, rows, times, velocities)
    check = qt.check_trajectory(given_rows, TASK)
    motion = check.motion
    q = motion.at(np.linspace(times[0], times[-1], 20_000)).q
    least = gaps(q).min()
    if least < DISTANCE - 1.1e-4:
        sides = [name for name in failed(check) if name.startswith("outside clearance")]
        assert sides, (least, check.verdict)
        worst = max(f.value for f in check.findings if f.name in sides)
        # The depth is the referee's to 2 %; MuJoCo's to what it iterates.
        assert worst == pytest.approx(DISTANCE - least, rel=0.03, abs=2e-4)
    elif least > DISTANCE:
        assert not [name for name in failed(check) if name.startswith("outside clearance")]


def test_every_constraint_is_kept_beside_the_path() -> None:
    half = HalfSpace(TASK.model, "tool", "site", np.array([0.0, 1.0, 0.0]), -0.1)
    task = dataclasses.replace(TASK, constraints=(*TASK.constraints, half))
    rows = qt.TimedPath(NAMES, joined(LINE[:0], np.array([[0.5, -0.3], [0.9, -0.3]])))
    check = qt.check_trajectory(rows, task)
    assert failed(check) == ["outside half-space after the path"]
    [finding] = [f for f in check.findings if not f.passes]
    assert finding.value == pytest.approx(0.2, rel=1e-6)


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task file of the ball, and a motion that ends in the box."""
    monkeypatch.chdir(tmp_path)
    write_cell("cell", XML, -0.5, 0.5, steps=10)
    rows = joined(LINE[:0], np.array([[0.5, 0.6], [0.0, 0.6]]))
    text = "\n".join(f"{k},{x},{y}" for k, (x, y) in enumerate(rows))
    Path("crash.csv").write_text(f"time,x [m],y [m]\n{text}\n")
    return tmp_path


def test_no_command_passes_a_motion_that_collides_after_its_path(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (
        ["check", "crash.csv", "cell.toml"],
        ["report", "crash.csv", "cell.toml", "--out", "page"],
        ["export", "crash.csv", "cell.toml", "--to", "mcap"],
    ):
        with pytest.raises(SystemExit) as end:
            main(command)
        assert end.value.code == 1, command
        said = capsys.readouterr()
        assert "outside clearance after the path" in said.err
        assert "box to ball" in said.err and "after the last waypoint" in said.err
        assert "passes" not in said.out
    page = (cell / "page" / "report.html").read_text("utf-8")
    assert "outside clearance after the path" in page and "after the last waypoint" in page
    assert "proven, everywhere" not in page
    chart = page[page.index('<article id="clearance-1"') :]
    chart = chart[: chart.index("</article>")]
    assert 'class="chart bad"' in chart and "✗" in chart and "✓" not in chart

"""One referee: what passes in a run passes in every command, what fails in one fails in all."""

import dataclasses
import functools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.joint_paths import short

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.comparison.findings import MethodRun
from qp_twist.comparison.metrics import metrics
from qp_twist.pages.motion_charts import motion_charts
from qp_twist.paths.task_schema import StudySection
from qp_twist.studies.judge import Judge
from qp_twist.trajectories import TimedPath, run_task, task_run
from qp_twist.trajectories.check import Check
from qp_twist.viewing.one_run import run_once
from qp_twist.viewing.settings import PageSettings

CASES = range(50)
AT_ROWS = ("position error", "axis error", "outside a band", "smallest joint margin")
"""Findings of a check about the waypoints; those of constraints are named after their kinds."""


@functools.cache
def shipped(name: str) -> qt.PathTask:
    return qt.load_task(name)


def task_of(case: int) -> qt.PathTask:
    """A short piece of a shipped task: slower joints, other tolerances, bands, a clearance."""
    rng = np.random.default_rng(case)
    name = ("deburring", "deburring_cell", "deburring_bands", "part_in_hand", "turn_tilt")[case % 5]
    task = short(shipped(name), int(rng.integers(3, 9)))
    assert task.durations is not None
    study = StudySection(
        position_error=10.0 ** rng.uniform(-9, -3), axis_error_deg=10.0 ** rng.uniform(-7, 0)
    )
    slower = rng.choice([1.0, 0.05, 0.02])
    return dataclasses.replace(
        task,
        name=f"{name}_{case}",
        study=study if rng.uniform() < 0.5 else None,
        velocity_limits=slower * np.where(np.isfinite(task.velocity_limits),
                                          task.velocity_limits, np.pi),
    )  # fmt: skip


def moved(run: qt.Trajectory, case: int) -> qt.Trajectory:
    """In every third case the rows of a run, one of them moved by hand and measured anew."""
    if case % 3:
        return run
    rng = np.random.default_rng(case)
    q = run.q.copy()
    q[rng.integers(0, len(q))] += rng.normal(size=q.shape[1]) * 10.0 ** rng.uniform(-8, -1)
    return dataclasses.replace(run, q=q)


@functools.cache
def run_of(case: int) -> qt.Trajectory:
    return moved(qt.follow(task_of(case), "qp_gradient"), case)


def kept_at_waypoints(check: Check, task: qt.PathTask) -> bool:
    kinds = [f"outside {constraint.kind}" for constraint in task.stated_constraints]
    found = [f for f in check.findings if f.name in (*AT_ROWS, *kinds)]
    assert len(found) >= 3
    return all(finding.passes for finding in found)


@pytest.mark.parametrize("case", CASES)
def test_rows_pass_in_all_or_in_none(case: int) -> None:
    task = task_of(case)
    run = run_of(case)
    names = qt.JointRanges.of(task.model).names
    ranges = qt.JointRanges.of(task.model)
    check = qt.check_trajectory(TimedPath(names, ranges.positions(run.q)), task)
    checked = kept_at_waypoints(check, task)
    assert run.passes == checked
    # The report marks its curves as the findings that they show.
    marks = {chart.of: chart.passes for chart in motion_charts(task, check)}
    shown = [finding for finding in check.findings if finding.name in marks]
    assert len(shown) >= 3
    assert all(marks[finding.name] == finding.passes for finding in shown)
    assert (run.kept == len(task.waypoints)) == (not run.verdict.off.any())
    numbers = metrics(run)
    words = ("leaves the limits", "off the path", "outside a", "ends at", "diverged")
    assert checked != any(word in numbers["status"] for word in words), numbers["status"]
    fault = Judge(task).fault(run)
    if fault is None or fault.kind != "jump":  # the length of steps is a study's own criterion
        assert checked == (fault is None), fault
    if not checked:
        assert MethodRun.of(run).faults or numbers["status"] != "ok"


def test_cases_pass_and_fail() -> None:
    """What the comparison above is made of."""
    passed = [run_of(case).passes for case in CASES]
    assert 10 < sum(passed) < 40


@pytest.mark.parametrize("case", range(0, 35, 7))  # one of each task
def test_a_file_has_the_verdict_of_its_run_in_every_command(
    case: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    task, file = task_of(case), tmp_path / "run.csv"
    done = run_task(task, "qp_gradient", file)
    check, passes = done.check, case % 2 == 0
    if not passes:  # the file's joints are faster than another task lets them
        task = dataclasses.replace(task, velocity_limits=1e-3 * task.velocity_limits)
        check = qt.check_trajectory(qt.read_trajectory(file), task)
    assert done.passes and check is not None and check.passes == passes
    for module in ("check", "report"):
        monkeypatch.setattr(f"qp_twist.cli.{module}.load", lambda *_: task)
    capsys.readouterr()
    code = _exit_code(["check", str(file), task.name, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (code == 0) == passes
    assert found == check.to_dict()
    code = _exit_code(["report", str(file), task.name, "--out", str(tmp_path)])
    assert (code == 0) == passes
    assert qt.check_trajectory(done.timed or done.rows, task).passes == passes


@pytest.mark.parametrize("case", CASES)
def test_the_live_page_says_what_a_comparison_says(case: int) -> None:
    task = task_of(case)
    shown = run_once(task, PageSettings.of(task, "qp_gradient"))
    compared = qt.compare(task, ["qp_gradient"]).to_dict()
    assert shown.status == compared["methods"]["qp_gradient"]["status"]
    assert compared["tolerances"]["position"] == task.tolerances.position


def _exit_code(arguments: list[str]) -> int:
    try:
        main(arguments)
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


ARM = """
<mujoco>
  <compiler angle="radian"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="pin" type="sphere" size="0.01" pos="{x} {y} 0" contype="1" conaffinity="1"/>
    <body>
      <joint name="shoulder" axis="0 0 1" range="-3 3"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0.5 0 0" mass="1"/>
      <body pos="0.5 0 0">
        <joint name="elbow" axis="0 0 1" range="-3 3"/>
        <geom type="capsule" size="0.01" fromto="0 0 0 0.5 0 0" mass="1"/>
        <body pos="0.5 0 0">
          <geom name="tip" type="sphere" size="0.01" mass="1" contype="1" conaffinity="1"/>
          <site name="tool"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
PAST_A_PIN = """
title = "Past a pin"
[robot]
scene = "arm.xml"
frame = "tool"
[projector]
linear = "full"
angular = "none"
[path]
kind = "polyline"
points = [[0.3, 0.6, 0], [-0.3, 0.6, 0]]
steps_per_segment = 8
[start]
q = [0.3, 1.6]
[feed]
speed = 0.1
[limits.velocity]
shoulder = 2.0
elbow = 2.0
[clearance]
distance = 0.005
"""


def test_what_straight_joints_between_waypoints_would_touch_is_not_told_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tip goes past a pin at 5.3 mm; with straight joints from waypoint to waypoint nearer."""
    (tmp_path / "arm.xml").write_text(ARM.format(x=0.0375, y=0.6253))
    (tmp_path / "pin.toml").write_text(PAST_A_PIN)
    task = qt.load_task(tmp_path / "pin.toml")

    def coarsely(*given: Any, **options: Any) -> qt.Trajectory:
        return qt.follow(*given, **{**options, "fine": False})

    monkeypatch.setattr(task_run, "follow", coarsely)
    coarse = run_task(task, "qp", tmp_path / "coarse.csv").trajectory
    status = metrics(coarse)["status"]
    assert re.search(r"comes too near, 4\.\d+ mm: pin to tip, waypoint 4\.[456]", status), status
    main(["run", str(tmp_path / "pin.toml"), "--method", "qp", "--out", str(tmp_path / "r.csv")])
    said = capsys.readouterr().out
    assert "passes" in said
    assert "too near" not in said
    # With a row more before it, the place keeps its name.
    more = coarse.with_rows(np.array([1]), coarse.q[:1], np.array([0.0]), None)
    assert metrics(more)["status"].partition("pin to tip")[2] == status.partition("pin to tip")[2]

"""Ctrl-C while a plan is made: the best motion by then, if there is one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from oracles.banded_paths import every

import qp_twist as qt
from qp_twist.following.planned import with_start

TASK = every(qt.load_task("deburring"), 8)
CLI = """
import os, signal, time
from qp_twist.cli.command import run_command
from qp_twist.planning.search import PlanSearch
signal.signal(signal.SIGINT, signal.default_int_handler)

def stage(*_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60.0)

PlanSearch._stage = stage
run_command(["run", "deburring", "--method", "qp_planned", "--out", "run.csv"])
"""


def interrupted(phase: str, **options: object) -> qt.Plan:
    """A plan that is interrupted when a phase begins."""

    def progress(what: str, share: float) -> None:
        if phase in what:
            raise KeyboardInterrupt

    return qt.plan(TASK, max_step_deg=24.0, progress=progress, **options)


def test_a_plan_keeps_the_best_motion_when_it_is_interrupted() -> None:
    plan = interrupted("run of qp_gradient")
    assert plan.interrupted
    assert "interrupted" in str(plan.certificate)
    assert "interrupted" in repr(plan)
    q = plan.motion()
    assert np.abs(np.diff(q, axis=0)).max() <= np.radians(24.0) + 1e-9
    errors = qt.follow(TASK, "qp_planned", plan=plan)
    assert errors.position_error.max() < 1e-4
    whole = qt.plan(TASK, max_step_deg=24.0)
    assert not whole.interrupted
    # The optimum lies between the bounds and both values.
    assert max(plan.bound, whole.bound) <= min(plan.value, whole.value)
    assert plan.value == pytest.approx(float(qt.JointRanges.of(TASK.model).centering(q).mean()))
    assert plan.gap == plan.value - plan.bound


def test_from_a_fixed_start_the_run_of_a_method_is_the_first_motion() -> None:
    start = qt.plan(TASK, max_step_deg=24.0).start
    plan = interrupted("layers", start=start)
    assert plan.interrupted
    assert np.array_equal(plan.start, start)
    assert np.isnan(plan.bound)


def test_before_there_is_a_motion_nothing_is_returned() -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted("layers")


def test_a_search_that_a_plan_is_part_of_ends_with_it() -> None:
    def progress(what: str, share: float) -> None:
        if "run of qp_gradient" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        with_start(every(TASK, 1, best_start=True), progress)


def test_the_command_says_that_planning_was_interrupted(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLI], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "planning was interrupted; the best plan by then: centering: mean z" in done.stdout
    assert (tmp_path / "run.csv").exists()  # and it passes its check, or the exit code were 1

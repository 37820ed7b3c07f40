"""Plans of paths whose waypoints are much denser than the joints need."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

import qp_twist as qt
from qp_twist.planning.levels import STAGES, Levels
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import Problem, motion_limits

ROOT = Path(__file__).parents[2]


def deburring(folder: Path, steps: int) -> qt.PathTask:
    """The deburring run with so many waypoints along each edge, without its feed."""
    text = (ROOT / "tasks" / "deburring.toml").read_text("utf-8")
    text = text.replace("steps_per_edge = 100 ", f"steps_per_edge = {steps} ")
    file = folder / f"deburring_{steps}.toml"
    file.write_text(text.replace("../scenes", str(ROOT / "scenes")), "utf-8")
    task = dataclasses.replace(qt.load_task(file), durations=None)
    assert len(task.waypoints) == 4 * steps + 1
    return task


def test_the_layers_of_a_path_follow_its_shape_and_not_its_number_of_waypoints(
    tmp_path: Path,
) -> None:
    numbers = []
    for steps in (100, 800):
        task = deburring(tmp_path, steps)
        ranges = qt.JointRanges.of(task.model)
        limits = motion_limits(task, ranges)
        problem = Problem(task, PathRows(task), limits, Objective.of(ranges, "centering"))
        levels = Levels(problem, lambda what, share: None)
        chosen = levels.selected(STAGES[0], limits.steps)
        assert chosen[0] == 0 and chosen[-1] == len(task.waypoints) - 1
        z = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])[chosen]
        turns = np.arccos(np.clip((z[1:] * z[:-1]).sum(axis=1), -1.0, 1.0))
        assert turns.max() < np.radians(3.0)
        assert levels.selected(STAGES[-1], limits.steps) == list(range(len(task.waypoints)))
        numbers.append(len(chosen))
    assert numbers[1] <= 1.3 * numbers[0]


def test_a_plan_of_dense_waypoints_is_as_good_as_one_of_some_of_them(tmp_path: Path) -> None:
    task = deburring(tmp_path, 400)
    sparse = qt.plan(task.part(np.arange(0, 1601, 4)), max_step_deg=15.0)
    dense = qt.plan(task, max_step_deg=15.0)
    assert dense.q is not None
    assert np.abs(np.diff(dense.q, axis=0)).max() <= np.radians(15.0) + 1e-9
    assert dense.bound <= dense.value <= 1.01 * sparse.value

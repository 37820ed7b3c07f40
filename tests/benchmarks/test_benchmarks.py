"""The scripts in benchmarks: each can be loaded, and its measurement taken on little work."""

from __future__ import annotations

import itertools
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page import markdown_table
from timer import Timed, once

import qp_twist as qt
from qp_twist.planning.graph import LayerPath
from qp_twist.planning.level_search import LevelSearch
from qp_twist.robots import controller_joints, named_robot

FOLDER = Path(__file__).parents[2] / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py") if "__main__" in path.read_text("utf-8"))


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_says_how_it_is_run(name: str) -> None:
    assert f"python benchmarks/{name}.py" in (import_module(name).__doc__ or "")


def test_every_backend_is_judged_on_named_and_random_problems() -> None:
    matrix = import_module("solver_matrix")
    tally = matrix.random_ones(range(2))
    assert not tally.false
    assert all(sum(counts.values()) == 2 for counts in tally.counts.values())
    assert "solved, but wrong" in matrix.table("random problems", tally)


def test_hierarchies_are_compared_with_the_cascade() -> None:
    found = import_module("hierarchies").compare(range(2))
    assert found.levels > 4 and not found.wrong


def test_an_arm_is_driven_and_its_limits_are_measured() -> None:
    result = import_module("limits_that_hold").run_arm(3, 30)
    assert sum(result.statuses.values()) == 30 and not result.failures
    assert max(result.violations.values()) < 1e-9


def test_a_servo_leaves_no_tick_of_a_random_stream_to_the_slower_reference() -> None:
    """At 12.6 s joints that brake at two limits leave a single velocity, off by rounding."""
    said = import_module("servo_ticks").servo_ticks(6400, 0, 10.0)
    assert said.endswith("steps that the kernel left to the reference: 0"), said


def test_a_ratio_is_taken_block_by_block() -> None:
    """A disturbance of a block is in both times of its ratio, and a failed block in none."""
    ours = Timed(blocks=[2.0, 20.0, np.nan, 2.0])
    other = Timed(blocks=[1.0, 10.0, 1.0, 1.0])
    assert ours.ratio_to(other).tolist() == [2.0, 2.0, 2.0]


def test_once_returns_a_time_and_what_the_call_returns() -> None:
    took, found = once(lambda: "done")
    assert took > 0 and found == "done"


def test_the_first_columns_of_a_table_are_text() -> None:
    table = markdown_table(("a", "b", "c"), [("x", "y", 1)], left=2)
    assert table == "| a | b | c |\n| :-- | :-- | --: |\n| x | y | 1 |\n"


def test_an_excursion_of_the_target_is_measured() -> None:
    edge = import_module("edge_cases")
    for found in edge.excursions(edge.all_arms()["seven"], [0, 1], "relax", 10.0):
        assert found.flips == 0 and not found.failures
        assert found.final < 0.1 and found.excess < 1e-9


def test_a_plan_in_a_random_cell_is_held_against_an_exhaustive_search() -> None:
    found = import_module("cells").one_cell(103, every=20, roll_step=10.0)
    assert found["planned"] and found["at_waypoints"] and not found["wrong"]
    assert found["z"] < 1.01 * found["z_loose"]


def test_a_detour_that_is_longer_than_the_grid_s_path_is_compared_with_finer_ones() -> None:
    """The coarse grid's path touches something between waypoints; past it, z is 12 % higher."""
    found = import_module("cells").one_cell(5414, every=10, roll_step=2.0)
    assert found["planned"] and found["between"] and not found["wrong"]
    assert found["z"] < 1.01 * found["z_strict"]


def test_an_obstacle_that_passes_between_the_evaluated_points_of_an_edge_is_avoided() -> None:
    """An edge of the grid's best path reaches 1.3 mm into a corner that no program gets it off."""
    cells = import_module("cells")
    task = cells.cell(5054, 10)
    assert task.durations is not None
    part = slice(12, 32)
    task = replace(task, waypoints=task.waypoints[part], durations=task.durations[part])
    plan = qt.plan(task)
    assert plan.q is not None and not cells.faults(task, plan.q)
    (clearance,) = task.constraints
    judge = cells.Obstacles(task.model, clearance.pairs)
    shares = np.linspace(0.0, 1.0, cells.INSIDE, endpoint=False)[:, None]
    between = [begin + shares * (end - begin) for begin, end in itertools.pairwise(plan.q)]
    assert judge.least(plan.q) >= cells.CLEAR - 1e-6
    assert judge.least(np.concatenate(between)) >= cells.CLEAR - cells.BETWEEN - 1e-6


def test_a_place_that_no_motion_passes_is_searched_finer_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a cell without a plan: later stages look at the place first, not at the whole path."""
    task = import_module("cells").crowded(1, 10)
    part = slice(200, 300)
    assert task.durations is not None
    task = replace(
        task, waypoints=task.waypoints[part], durations=task.durations[part], flipped_waypoints=None
    )
    lengths: list[tuple[bool, int]] = []
    searched = LevelSearch.best

    def counted(self: LevelSearch, *arguments: Any) -> LayerPath:
        lengths.append((self.problem.has_clearance, len(self.level.layers)))
        return searched(self, *arguments)

    monkeypatch.setattr(LevelSearch, "best", counted)
    plan = qt.plan(task)
    assert plan.q is None and plan.certificate.waypoints[0] in (78, 79)
    assert max(count for cleared, count in lengths[1:] if cleared) < 50 < lengths[0][1]


def test_a_plan_that_touches_is_found_out() -> None:
    """The joints straight from a configuration to one with the arm in the floor."""
    cells = import_module("cells")
    task = cells.cell(103, 20)
    clearance = task.constraints[-1]
    assert len(clearance.names) > 40
    judge = cells.Obstacles(task.model, clearance.pairs)
    straight = np.linspace(task.start, [0.0, 2.0, 0.5, 0.0, 0.0, 0.0], 40)
    keeps = judge.keeps(straight)
    assert 0 < keeps.sum() < 40
    assert keeps.tolist() == (clearance.margins(straight).min(axis=1) >= 0.0).tolist()
    assert judge.least(straight) < -0.1
    assert cells.faults(task, straight[: len(task.waypoints)])


def test_a_step_in_front_of_a_wall_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = import_module("cells")
    monkeypatch.setattr(cells, "LENGTH", 0.5)
    way = cells.way("wall", 0)
    found = cells.run(way, cells.ours(way, "relax", None), None)
    assert found.short < 1e-6 and not found.failures and found.excess < 1e-9
    assert len(found.states) == 100


@pytest.mark.parametrize(
    ("world", "seed", "mode", "acceleration"),
    [
        ("wall", 2, "scale", 10.0),  # joints brake at their ranges, too
        ("wall", 496, "relax", 10.0),  # a velocity is held that rows of corrections contradict
        ("corner", 3, "scale", 10.0),
        ("corner", 0, "scale", None),  # slides along, with the task at rest
        ("moving", 2, "relax", None),  # corrected steps while the obstacle comes
        ("moving", 649, "scale", 10.0),  # gives way to it early enough
    ],
)
def test_steps_keep_their_distance_smoothly(
    world: str, seed: int, mode: str, acceleration: float | None
) -> None:
    cells = import_module("cells")
    way = cells.way(world, seed)
    found = cells.run(way, cells.ours(way, mode, acceleration), acceleration)
    assert found.short < 1e-6 and not found.failures and found.excess < 1e-9
    assert found.flips <= 5


@pytest.mark.parametrize("name", ["csv_mm.csv", "normals.csv", "arcs.apt", "dome.nc"])
def test_the_judge_of_programs_and_the_package_read_the_same_toolpath(name: str) -> None:
    """The judge has readers of its own; arcs are chords here and there."""
    judge = import_module("judged_programs")
    file = FOLDER / "toolpaths" / name
    curves = judge.curves_of(file)
    dense = [np.linspace(a, b, 50) for curve in curves for a, b in itertools.pairwise(curve)]
    read = qt.read_toolpath(file, rotary="head-bc" if name == "dome.nc" else None)
    for curve in read.curves:
        rows = np.hstack([curve.positions, curve.vectors])
        distance, angle = judge.apart(rows, np.concatenate(dense))
        assert distance.max() < 1.2e-5  # that of the chords of an arc
        assert angle.max() < 1e-3


def test_the_judge_reads_back_what_a_program_shows(tmp_path: Path) -> None:
    judge = import_module("judged_programs")
    task = qt.load_task("deburring")
    q = task.start + np.linspace(0.0, 0.05, 4)[:, None]
    rows = qt.JointRows(qt.kinematics.JointRanges.of(task.model).names, q, np.arange(4.0))
    joints = controller_joints(
        task.model, task.frame_name, task.frame_type, named_robot("M-16iB/20")
    )
    shown, robot = judge.rows_of(qt.write_trajectory(rows, tmp_path / "short.ls", joints))
    shown[:, 2] += shown[:, 1]  # J3 is the forearm's angle to the floor
    assert robot == "Fanuc M-16iB/20"
    assert np.abs(shown - q).max() < 1e-6

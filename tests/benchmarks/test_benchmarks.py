"""The scripts in benchmarks: each can be loaded, and its measurement taken on little work."""

import itertools
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import qp_twist as qt

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


def test_an_excursion_of_the_target_is_measured() -> None:
    edge = import_module("edge_cases")
    for found in edge.excursions(edge.all_arms()["seven"], [0, 1], "relax", 10.0):
        assert found.flips == 0 and not found.failures
        assert found.final < 0.1 and found.excess < 1e-9


def test_a_plan_in_a_random_cell_is_held_against_an_exhaustive_search() -> None:
    found = import_module("cells").one_cell(103, every=20, roll_step=10.0)
    assert found["planned"] and found["at_waypoints"] and not found["wrong"]
    assert found["z"] < 1.01 * found["z_loose"]


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


def test_a_place_that_no_motion_passes_is_named() -> None:
    """Of a cell without a plan."""
    task = import_module("cells").crowded(1, 10)
    part = slice(200, 300)
    task = replace(
        task, waypoints=task.waypoints[part], durations=task.durations[part], flipped_waypoints=None
    )
    plan = qt.plan(task)
    assert plan.q is None and plan.certificate.waypoints[0] in (78, 79)


@pytest.mark.parametrize(
    ("name", "extra", "motion", "length"),
    [
        ("KUKA KR 10 R1100 sixx", "rail", "joint", 0.06),
        ("KUKA KR 10 R1100 sixx", "rail", "poses", 0.06),
        ("Universal Robots UR3e", "", "joints", 0.06),
        ("Fanuc M-20iA", "rail", "joints", 0.05),  # 2,777 % with moves to rows alone
    ],
)
def test_points_of_a_program_lead_through_the_accelerations_planned(
    name: str, extra: str, motion: str, length: float, tmp_path: Path
) -> None:
    grid = import_module("program_grid")
    job = grid.job_of(name, extra, length, 1 + round(500 * length))
    assert max(grid.of_file(job)) <= 1.0 + 1e-6
    acceleration, jerk, least = map(float, grid.cell(job, extra, motion, tmp_path)[-3:])
    assert acceleration <= 105.0 and jerk <= 150.0 and least <= 100.0

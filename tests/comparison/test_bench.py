"""The bench judges rightly: its reference, its rows, its statistics. No test looks at a time."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.exact_levels import exact_cascade
from oracles.hierarchies import Hierarchy

import qp_twist as qt
from qp_twist.bench import BenchRun, bench, read_run, write_run
from qp_twist.bench.contender import Contender, StepOf
from qp_twist.bench.contenders import contenders, floor, peer_problem, peer_steps
from qp_twist.bench.problem import DT, Problem, Truth
from qp_twist.bench.problems import growth, table
from qp_twist.bench.program import StepProgram, Variant
from qp_twist.bench.ratios import changes, differences, ratios, ratios_of_calls
from qp_twist.bench.record import Accuracy, Case, Machine, Measured, Quantiles
from qp_twist.bench.reference import NoReference, reference
from qp_twist.bench.tables import RATIOS, compared, document, sheets
from qp_twist.bench.timer import LEAD_IN, blocks_of, interleaved
from qp_twist.checks import Array
from qp_twist.cli import main
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask
from qp_twist.peers.urdf import robot_urdf
from qp_twist.qp import installed_solvers

# ---------------------------------------------------------------- the reference


def feasible_program(rng: np.random.Generator, n: int, equalities: int, rows: int) -> StepProgram:
    """A random program that has a solution by construction."""
    inside = rng.normal(size=n)
    A, G = rng.normal(size=(equalities, n)), rng.normal(size=(rows, n))
    return StepProgram(
        3.0 * rng.normal(size=n),
        A,
        A @ inside,
        G,
        G @ inside + rng.uniform(0.0, 1.0, rows),
        inside - rng.uniform(0.01, 1.0, n),
        inside + rng.uniform(0.01, 1.0, n),
    )


def by_brute_force(program: StepProgram) -> Array:
    """The best of the feasible points that some choice of active constraints leads to."""
    n = len(program.desired)
    eye = np.eye(n)
    best, least = None, np.inf
    for sides in itertools.product((0, -1, 1), repeat=n):
        for chosen in itertools.product((False, True), repeat=len(program.g)):
            fixed = [i for i in range(n) if sides[i]]
            rows = np.vstack([program.A, eye[fixed], program.G[list(chosen)]])
            ends = np.concatenate(
                [
                    program.b,
                    [(program.lower if sides[i] < 0 else program.upper)[i] for i in fixed],
                    program.g[list(chosen)],
                ]
            )
            if len(rows) > n:
                continue
            x = program.desired + np.linalg.pinv(rows) @ (ends - rows @ program.desired)
            if program.residual(x) > 1e-8 or program.excess(x) > 1e-8:
                continue
            cost = float(np.sum((x - program.desired) ** 2))
            if cost < least:
                best, least = x, cost
    assert best is not None
    return best


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(0, 2), st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_the_reference_is_the_best_point_of_all_active_sets(
    seed: int, n: int, equalities: int, rows: int
) -> None:
    program = feasible_program(np.random.default_rng(seed), n, min(equalities, n - 1), rows)
    solution = reference(program)
    assert program.residual(solution.velocity) < 1e-13
    assert program.excess(solution.velocity) < 1e-13
    assert np.abs(solution.velocity - by_brute_force(program)).max() < 1e-6


def by_sixty_digits(program: StepProgram) -> Array:
    """Task and rows as a first level, the distance to the desired velocity as a second."""
    n = len(program.desired)
    first = (program.A, program.b, program.G, program.g)
    second = (np.eye(n), program.desired, np.zeros((0, n)), np.zeros(0))
    hierarchy = Hierarchy([first, second], program.lower, program.upper, np.zeros(n))
    return exact_cascade(hierarchy).x


def test_the_reference_is_that_of_sixty_digit_arithmetic() -> None:
    rng = np.random.default_rng(4)
    programs = [feasible_program(rng, 6, 2, 2) for _ in range(6)]
    programs += [p.make([40])[1].programs[40] for p in (*table(0), *growth(0)) if p.x < 24]
    solutions = [reference(program) for program in programs]
    assert sum(s.active > 1 for s in solutions) > 5
    for program, solution in zip(programs, solutions, strict=True):
        assert np.abs(solution.velocity - by_sixty_digits(program)).max() < 1e-12


def test_a_program_without_a_solution_has_no_reference() -> None:
    program = feasible_program(np.random.default_rng(0), 4, 2, 0)
    with pytest.raises(NoReference, match="contradict each other"):
        reference(replace(program, b=program.b + 100.0))
    dependent = replace(program, A=np.vstack([program.A, program.A[:1]]), b=np.zeros(3))
    with pytest.raises(NoReference, match="depend on each other"):
        reference(dependent)


# ---------------------------------------------------------------- the problems


@pytest.fixture(scope="module")
def by_rows() -> list[tuple[Problem, Truth]]:
    return [p.make([50, 51]) for p in growth(0) if p.group == "rows"]


def test_the_rows_are_those_of_the_twist_task(by_rows: list[tuple[Problem, Truth]]) -> None:
    """Bases may differ; what a velocity leaves undone may not."""
    rng = np.random.default_rng(1)
    for problem, truth in by_rows:
        [frame] = problem.frames
        task = TwistTask(frame.site, "site", frame.projector)
        configuration = mink.Configuration(problem.model, problem.q[50])
        task.set_target(problem.targets[50][0])
        assert problem.rows == task.projector.rank
        for velocity in rng.normal(size=(5, problem.model.nv)):
            undone = task.compute_jacobian(configuration) @ velocity
            undone += task.compute_error(configuration) / DT
            assert truth.programs[50].residual(velocity) == pytest.approx(
                np.linalg.norm(undone), rel=1e-9
            )


def test_a_trajectory_keeps_its_limits_and_is_close_to_them() -> None:
    planned = next(iter(table(0)))
    problem, truth = planned.make(range(20, 200, 4))
    lower, upper = problem.model.jnt_range.T
    assert (problem.q > lower).all() and (problem.q < upper).all()
    assert np.minimum(problem.q - lower, upper - problem.q).min() < 0.01
    speeds = np.abs(np.diff(problem.q, axis=0)) / DT
    assert (speeds < problem.speeds).all() and (speeds.max(axis=0) > 0.8 * problem.speeds).all()
    assert truth.active_share >= 0.25


def test_the_urdf_of_two_arms_is_the_robot_itself() -> None:
    planned = list(table(0))[2]
    problem, _ = planned.make([10])
    model = mujoco.MjModel.from_xml_string(
        robot_urdf(problem.model, peer_problem(problem, costs=1.0).frames, problem.speeds).replace(
            "</robot>",
            '<mujoco><compiler fusestatic="false" balanceinertia="true" boundmass="1" '
            'boundinertia="1"/></mujoco></robot>',
        )
    )
    data = mujoco.MjData(model)
    names = [problem.model.joint(i).name for i in range(problem.model.njnt)]
    for k in (0, 70):
        for name, value in zip(names, problem.q[k + 1], strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        for i, target in enumerate(problem.targets[k]):
            body = data.body(f"frame_{i}")
            assert np.abs(body.xpos - target.translation()).max() < 1e-9
            assert np.abs(body.xmat.reshape(3, 3) - target.rotation().as_matrix()).max() < 1e-9


# ---------------------------------------------------------------- times


def test_quantiles_are_in_microseconds() -> None:
    q = Quantiles.of([k * 1000 for k in range(101)])
    assert q is not None
    assert (q.median, q.p10, q.p90, q.count) == (50.0, 10.0, 90.0, 101)
    assert Quantiles.of([]) is None


def test_contenders_take_turns_on_runs_of_consecutive_steps() -> None:
    calls: list[tuple[str, int]] = []

    def recorder(name: str) -> StepOf:
        return lambda k: calls.append((name, k))

    blocks = blocks_of(40, 5, 4)
    names = ["a", "b", "c"]
    timed = interleaved({n: recorder(n) for n in names}, blocks, np.random.default_rng(0))
    assert all(len(timed[n].warm) == 20 for n in names)
    expected = [k for block in blocks for k in range(block.start - LEAD_IN, block.stop)]
    for name in names:
        assert [k for n, k in calls if n == name] == expected
    run = 5 + LEAD_IN
    orders = [
        [calls[i][0] for i in range(b, b + 3 * run, run)] for b in range(0, len(calls), 3 * run)
    ]
    assert all(sorted(order) == names for order in orders)
    assert len({tuple(order) for order in orders}) > 1


# ---------------------------------------------------------------- answers, right and wrong


def right_but(change: Callable[[Array], Any]) -> Callable[[Problem], Callable[[], StepOf]]:
    """Prepares a contender that knows the solution and returns something of it."""

    def prepare(problem: Problem) -> Callable[[], StepOf]:
        return lambda: lambda k: change(solution(problem, k))

    return prepare


@cache
def solution(problem: Problem, k: int) -> Array:
    """The reference of a step."""
    return reference(problem.program(k)).velocity


def fail(velocity: Array) -> Array:
    raise RuntimeError("no solution\nand more")


def perturbed(velocity: Array) -> Array:
    return velocity + 1e-3 * np.eye(len(velocity))[0]


FAKES = [
    Contender("fake:right", Variant.COMMON, right_but(lambda v: v)),
    Contender("fake:wrong", Variant.COMMON, right_but(perturbed)),
    Contender("fake:soft", Variant.OTHER, right_but(perturbed)),
    Contender("fake:fast", Variant.COMMON, right_but(lambda v: 100.0 * v)),
    Contender("fake:nan", Variant.COMMON, right_but(lambda v: v * np.nan)),
    Contender("fake:raises", Variant.COMMON, right_but(fail)),
    Contender("fake:absent", Variant.COMMON, right_but(fail), missing=lambda: "it is not here."),
    Contender("fake:broken", Variant.COMMON, lambda problem: fail(problem.q)),
    *floor(),
    *(c for c in peer_steps() if c.name == "mink:hard"),
]


@pytest.fixture(scope="module")
def run() -> BenchRun:
    return bench(parts=["steps"], quick=True, known=FAKES)


def accuracy(case: Case, name: str) -> Accuracy:
    measured = case.of(name)
    assert measured is not None and measured.accuracy is not None
    return measured.accuracy


def test_a_wrong_answer_shows_however_fast_it_is(run: BenchRun) -> None:
    assert [case.joints for case in run.cases] == [6, 7, 14]
    for case in run.cases:
        assert case.active_share is not None and case.active_share >= 0.25
        right = accuracy(case, "fake:right")
        assert right.error == 0.0 and right.residual < 1e-12 and right.excess < 1e-14
        wrong = accuracy(case, "fake:wrong")
        assert wrong.error == pytest.approx(1e-3) and wrong.residual > 1e-5
        assert accuracy(case, "fake:soft").error is None
        assert accuracy(case, "fake:soft").residual == wrong.residual
        assert accuracy(case, "fake:fast").excess > 1.0
        assert accuracy(case, "mink:hard").error < 1e-3  # type: ignore[operator]
    for sheet in list(sheets(run))[:3]:
        marked = {sheet.rows[i][0] for i, _ in sheet.wrong}
        assert {"fake:wrong", "fake:soft", "fake:fast"} <= marked
        assert "fake:right" not in marked
    assert "**1e-03**" in document(run)


def test_a_step_that_fails_is_counted_and_not_timed(run: BenchRun) -> None:
    for case in run.cases:
        for name, said in (
            ("fake:nan", "the velocity is not finite"),
            ("fake:raises", "RuntimeError: no solution"),
        ):
            measured = case.of(name)
            assert measured is not None
            assert (measured.warm, measured.accuracy) == (None, None)
            assert (measured.failures, measured.said) == (case.steps, said)
    assert f"fake:raises failed on {run.cases[0].steps} steps" in document(run)


def test_who_does_not_take_part_is_told_with_the_reason(run: BenchRun) -> None:
    assert run.skipped[0] == "skipped fake:absent: it is not here."
    broken = [sentence for sentence in run.skipped if "fake:broken" in sentence]
    assert len(broken) == 3
    assert broken[1].endswith("with seven-axis arm (scenes/seven_axis_arm.xml): no solution")
    assert all(case.of("fake:absent") is None for case in run.cases)


@pytest.mark.parametrize(("module", "package"), [("pink", "pin-pink"), ("placo", "placo")])
def test_a_library_that_is_not_installed_is_named_with_its_package(
    module: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    if module == "pink":
        monkeypatch.setitem(sys.modules, "pinocchio", mink)  # anything that can be imported
    makes = [c for c in peer_steps() if c.family == module]
    assert len(makes) == {"pink": 1, "placo": 3}[module]
    for contender in makes:
        said = contender.missing()
        assert said is not None and f"pip install {package}" in said


def test_placo_does_not_give_up_its_scale_for_the_posture() -> None:
    """The motion fits, so that the largest scale is 1: nothing of the task is to be missing."""
    pytest.importorskip("placo")
    steps = range(0, 190, 10)
    [scaled] = [c for c in peer_steps() if c.name == "placo:scaled"]
    for planned in table(0):
        problem, truth = planned.make(steps)
        step = scaled.prepare(problem)()
        accuracy = truth.accuracy(scaled.variant, {k: np.array(step(k)) for k in steps})
        assert accuracy is not None and accuracy.residual < 1e-6


def test_where_nobody_takes_part_earlier_results_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "placo", None)
    (tmp_path / "bench.json").write_text("of before")
    with pytest.raises(SystemExit) as ended:
        main(["bench", "--quick", "--only", "placo:hard,placo:soft", "--out", str(tmp_path)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "none of the contenders named takes part" in said
    assert "skipped placo:hard" in said
    assert (tmp_path / "bench.json").read_text() == "of before"


def test_every_backend_takes_part() -> None:
    names = [c.name for c in contenders()]
    assert len(set(names)) == len(names)
    assert {f"step:{solver}" for solver in installed_solvers()} <= set(names)
    assert {"step:daqp:twist", "solve_ik:daqp", "mink:soft", "closed:twa", "placo:scaled"} <= set(
        names
    )


# Not the compiled step, which would be compiled for this alone: tests/control/test_compiled.py.
SOLVING = [c for c in contenders() if c.variant is not Variant.OTHER and "compiled" not in c.name]


@pytest.mark.parametrize("joints", [6, 7, 14])
def test_everybody_solves_the_program_that_they_are_judged_by(joints: int) -> None:
    [planned] = [p for p in table(0) if p.x == joints]
    problem, truth = planned.make([30, 110])
    taking = [c for c in SOLVING if c.missing() is None and c.applies(problem)]
    assert {"step:daqp", "solve_ik:daqp", "mink:hard"} <= {c.name for c in taking}
    for contender in taking:
        step = contender.prepare(problem)()
        try:
            answers = {k: np.array(step(k)) for k in truth.programs}
        except qt.SolverInaccurate:  # a failure is counted, and no other backend is asked
            assert contender.name == "step:clarabel"
            continue
        judged = truth.accuracy(contender.variant, answers)
        assert judged is not None and judged.error is not None
        assert judged.error < 1e-4, contender.name  # the loosest of the tolerances
        assert judged.residual < 1e-7, contender.name
        if contender.variant is Variant.COMMON:
            assert judged.excess < 1e-4, contender.name


def test_libraries_with_fewer_words_take_part_where_these_suffice(
    by_rows: list[tuple[Problem, Truth]],
) -> None:
    for contender in (c for c in contenders() if c.family in ("pink", "placo", "closed")):
        assert [p.rows for p, _ in by_rows if contender.applies(p)] == [5]


# ---------------------------------------------------------------- files and comparisons


def test_a_run_survives_its_file(run: BenchRun, tmp_path: Path) -> None:
    assert read_run(write_run(run, tmp_path / "bench.json")) == run


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no such bench.json"),
        ("not json", "this is not JSON (line 1"),
        ("[1, 2]", "qp-twist bench did not write this file"),
        ('{"task": "deburring"}', "qp-twist bench did not write this file"),
        ('{"format": "qp-twist bench", "version": 0}', "has format version 0"),
        ('{"format": "qp-twist bench", "version": 1, "seed": "x"}', "created is missing or wrong"),
        (b"\xff\xfe", "expected a bench.json in UTF-8"),
        (2000 * "[" + 2000 * "]", "nested too deep"),
    ],
)
def test_what_is_no_run_is_refused(text: str | bytes | None, said: str, tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    if text is not None:
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InvalidInput) as refused:
        read_run(file)
    assert str(refused.value).startswith(f"--compare {file}: ")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def times(median: float, width: float = 1.0) -> Quantiles:
    return Quantiles(median=median, p10=median - width, p90=median + width, count=9)


def one_case(**medians: float) -> Case:
    results = tuple(
        Measured(
            contender=name.replace("_", ":").replace("::", "_"),
            warm=times(median),
            accuracy=Accuracy(residual=0.0, excess=0.0, error=1e-9),
        )
        for name, median in medians.items()
    )
    return Case(
        group="step", x=6, title="arm", joints=6, rows=5, steps=9, active_share=0.5, results=results
    )


def one_run(case: Case, **changed: Any) -> BenchRun:
    made = BenchRun(
        created="2025-01-01T00:00:00+00:00",
        seed=0,
        quick=False,
        machine=Machine.here(),
        skipped=(),
        cases=(case,),
    )
    return made.model_copy(update=changed)


def test_ratios_are_of_medians() -> None:
    case = one_case(step_daqp=600.0, step_compiled=30.0, mink_hard=200.0, placo_hard=10.0)
    assert ratios(case) == {
        ("step:daqp", "mink:hard"): 3.0,
        ("step:daqp", "placo:hard"): 60.0,
        ("step:compiled", "mink:hard"): 0.15,
        ("step:compiled", "placo:hard"): 3.0,
    }


def test_a_call_is_held_against_a_call() -> None:
    """PlaCo's step has its kinematics in it: our call without ours is no match for it."""
    case = one_case(step_compiled=30.0, solve__ik_daqp=600.0, mink_hard=200.0, placo_hard=24.0)
    calls = {"step:compiled": 18.0, "mink:hard": 180.0}
    results = tuple(
        m.model_copy(update={"call": times(calls[m.contender])}) if m.contender in calls else m
        for m in case.results
    )
    case = case.model_copy(update={"results": results})
    assert ratios_of_calls(case) == {("step:compiled", "mink:hard"): 0.1}
    [sheet] = [sheet for sheet in sheets(one_run(case)) if sheet.title == RATIOS]
    named = {row[0]: row[1] for row in sheet.rows}
    assert named["step:compiled / placo:hard"] == "1.25"
    assert named["solve_ik:daqp / mink:hard"] == "3"
    assert not [name for name in named if "placo" in name and "call" in name]


def test_a_change_is_called_one_only_where_the_spans_are_apart() -> None:
    before = one_run(one_case(step_daqp=100.0, mink_hard=100.0, pink_soft=100.0, gone_away=1.0))
    now = one_run(one_case(step_daqp=50.0, mink_hard=101.5, pink_soft=103.0, new_here=1.0), seed=3)
    found = {c.contender: (c.ratio, c.verdict) for c in changes(before, now)}
    assert found == {
        "step:daqp": (0.5, "faster"),
        "mink:hard": (1.015, ""),
        "pink:soft": (1.03, "slower"),
    }
    said = " ".join(differences(before, now))
    assert "only then: gone:away" in said and "only now: new:here" in said
    assert "seeds differ (0 then)" in said
    assert compared(before, now).rows[0][4:6] == ("0.50", "faster")
    assert differences(now, now) == []


def test_another_machine_and_other_versions_are_said() -> None:
    now = one_run(one_case(step_daqp=100.0))
    other = now.machine.model_copy(
        update={"processor": "abacus", "versions": now.machine.versions | {"numpy": "0.1"}}
    )
    said = differences(now.model_copy(update={"machine": other, "quick": True}), now)
    assert any("abacus" in sentence for sentence in said)
    assert any("numpy 0.1 → " in sentence for sentence in said)
    assert any("quick" in sentence for sentence in said)


# ---------------------------------------------------------------- the command


def test_the_command_writes_what_it_prints_and_compares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bench", "--quick", "--parts", "steps", "--only", "mink:hard,floor", "--out"]
    main([*words, str(tmp_path / "a")])
    out, err = capsys.readouterr()
    assert err == ""
    assert out.count("mink:hard") == 3 and "floor:mujoco" in out
    assert {f.name for f in (tmp_path / "a").iterdir()} == {"bench.json", "bench.md", "bench.svg"}
    content = json.loads((tmp_path / "a" / "bench.json").read_text("utf-8"))
    assert [case["joints"] for case in content["cases"]] == [6, 7, 14]
    assert "| `mink:hard` |" in (tmp_path / "a" / "bench.md").read_text("utf-8")
    assert "mink:hard" in (tmp_path / "a" / "bench.svg").read_text("utf-8")
    earlier = tmp_path / "a" / "bench.json"
    words = ["bench", "--quick", "--parts", "steps", "--only", "floor"]
    main([*words, "--out", str(tmp_path / "b"), "--compare", str(earlier)])
    assert "Now beside the run of" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "minx"], "--only 'minx': not known; did you mean 'mink'? Known: floor:mujoco"),
        (["--only", ","], "--only: no name in it"),
        (
            ["--parts", "step"],
            "--parts 'step': not known; did you mean 'steps'? Known: steps, growth, batch",
        ),
        (["--compare", "nowhere.json"], "--compare nowhere.json: there is no such bench.json"),
        (["--out", "taken/there"], "taken is a file"),
    ],
)
def test_the_command_refuses_in_a_sentence(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    with pytest.raises(SystemExit) as done:
        main(["bench", "--quick", *words])
    assert done.value.code == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()

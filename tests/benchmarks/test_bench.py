"""The bench judges rightly: its reference, its rows, its statistics. No test looks at a time."""

import itertools
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from bench import bench, compared, document, read_run
from bench import main as run_script
from contenders import Contender, contenders, floor, peer_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from step_problems import DT, Problem, Truth, growth, table
from step_program import StepProgram, Variant, reference
from timer import StepOf
from urdf import link_name, robot_urdf

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.cli import main
from qp_twist.kinematics import TwistTask
from qp_twist.paths import shipped_folder
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
def run() -> dict[str, Any]:
    return bench(["steps"], quick=True, known=FAKES)


def test_a_wrong_answer_shows_however_fast_it_is(run: dict[str, Any]) -> None:
    assert [case["joints"] for case in run["cases"]] == [6, 7, 14]
    for case in run["cases"]:
        assert case["active_share"] >= 0.25
        found = case["results"]
        right, wrong = found["fake:right"], found["fake:wrong"]
        assert right["error"] == 0.0 and right["residual"] < 1e-12 and right["excess"] < 1e-14
        assert wrong["error"] == pytest.approx(1e-3) and wrong["residual"] > 1e-5
        assert found["fake:soft"]["error"] is None
        assert found["fake:soft"]["residual"] == wrong["residual"]
        assert found["fake:fast"]["excess"] > 1.0
        assert found["mink:hard"]["error"] < 1e-3
    marked = {line.split("`")[1] for line in document(run).splitlines() if "e-03** |" in line}
    assert {"fake:wrong", "fake:soft"} <= marked and "fake:right" not in marked


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


def test_every_backend_takes_part() -> None:
    names = [c.name for c in contenders()]
    assert len(set(names)) == len(names)
    assert {f"step:{solver}" for solver in installed_solvers()} <= set(names)
    assert {"step:daqp:twist", "solve_ik:daqp", "mink:soft", "closed:twa", "placo:scaled"} <= set(
        names
    )


# Not the compiled step, which would be compiled for this alone: tests/qp/test_verification.py.
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
        judged: dict[str, Any] = truth.accuracy(contender.variant, answers)
        assert judged["error"] < 1e-4, contender.name  # the loosest of the tolerances
        assert judged["residual"] < 1e-7, contender.name
        if contender.variant is Variant.COMMON:
            assert judged["excess"] < 1e-4, contender.name


# ---------------------------------------------------------------- files and comparisons


def one_run(seed: int = 0, **medians: float) -> dict[str, Any]:
    results = {
        name.replace("_", ":"): {
            "warm": [median, median - 1.0, median + 1.0], "call": None, "cold": None,
            "residual": 0.0, "excess": 0.0, "error": 1e-9, "failures": 0, "said": "",
        }
        for name, median in medians.items()
    }  # fmt: skip
    case = {"group": "step", "x": 6, "title": "arm", "joints": 6, "rows": 5, "steps": 9,
            "active_share": 0.5, "results": results}  # fmt: skip
    return {"created": "2025-01-01", "seed": seed, "quick": False, "machine": "abacus",
            "versions": {"numpy": "2"}, "skipped": [], "cases": [case]}  # fmt: skip


def test_a_change_is_called_one_only_where_the_spans_are_apart() -> None:
    before = one_run(step_daqp=100.0, mink_hard=100.0, pink_soft=100.0, gone_away=1.0)
    now = one_run(seed=3, step_daqp=50.0, mink_hard=101.5, pink_soft=103.0, new_here=1.0)
    cells = [line.split(" | ") for line in compared(before, now).splitlines() if "step 6" in line]
    assert [(row[1], row[4], row[5]) for row in cells] == [
        ("`step:daqp`", "0.50", "faster"), ("`mink:hard`", "1.01", ""),
        ("`pink:soft`", "1.03", "slower"),
    ]  # fmt: skip
    assert "- seed then: 0" in compared(before, now)
    assert "then:" not in compared(now, now)


# ---------------------------------------------------------------- the command


def test_the_command_runs_the_script_which_writes_what_it_prints_and_compares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("bench.table", lambda seed: itertools.islice(table(seed), 1))
    first, second = (str(tmp_path / name) for name in ("a.json", "b.json"))
    with pytest.raises(SystemExit) as done:
        main(["bench", "--quick", "--only", "nobody", "--out", first])
    assert done.value.code == 2
    assert "--only 'nobody': not known" in capfd.readouterr().err
    assert run_script(["steps", "--quick", "--only", "mink:hard,floor", "--out", first]) == 0
    out = capfd.readouterr().out
    assert out.count("| `mink:hard` |") == 1 and "floor:mujoco" in out
    assert document(read_run(first)) in out
    words = ["steps", "--quick", "--only", "floor", "--out", second, "--compare", first]
    assert run_script(words) == 0
    assert "Now beside the run of" in capfd.readouterr().out


def test_an_installation_without_the_folder_says_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("qp_twist.cli.bench.SCRIPT", tmp_path / "bench.py")
    with pytest.raises(SystemExit) as done:
        main(["bench"])
    assert done.value.code == 2
    err = capsys.readouterr().err
    assert "in a checkout run python benchmarks/bench.py" in err and err.count("\n") == 1


# ---------------------------------------------------------------- URDF

ODD = """
<mujoco><compiler angle="radian"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body pos="0.1 -0.2 0.3" quat="0.9 0.1 -0.3 0.2">
    <joint name="a" axis="0 1 1" pos="0.05 0 -0.1" range="-1 2" ref="0.3"/>
    <geom size="0.1"/>
    <body pos="0 0.4 0.1" euler="0.4 1.5707963267948966 -0.2">
      <joint name="b" type="slide" axis="1 0 2" ref="-0.2" range="-0.5 0.5"/>
      <joint name="c" axis="0 0 1" pos="0 0.1 0"/>
      <geom size="0.1"/>
      <body pos="0.2 0 0"><geom size="0.1"/><site name="tip" pos="0 0.1 0" euler="1 2 3"/></body>
    </body>
  </body>
  {more}
</worldbody></mujoco>
"""


def robot(name: str) -> tuple[mujoco.MjModel, list[str]]:
    if name == "odd":
        return mujoco.MjModel.from_xml_string(ODD.format(more="")), ["tip"]
    model = mujoco.MjModel.from_xml_path(str(shipped_folder("scenes") / name))
    return model, {"planar_3r.xml": ["tip"], "two_arms.xml": ["left_tool", "right_tool"]}.get(
        name, ["tool"]
    )


@pytest.mark.parametrize("name", ["odd", "m16ib_deburring.xml", "planar_3r.xml", "two_arms.xml"])
def test_the_urdf_of_a_robot_is_the_robot_itself(name: str) -> None:
    model, sites = robot(name)
    options = '<mujoco><compiler fusestatic="false" balanceinertia="true" boundmass="1" '
    text = robot_urdf(model, sites, np.full(model.nv, 2.0)).replace(
        "</robot>", options + 'boundinertia="1"/></mujoco></robot>'
    )
    read = mujoco.MjModel.from_xml_string(text)
    ranges, rng = qt.JointRanges.of(model), np.random.default_rng(2)
    data, theirs = mujoco.MjData(model), mujoco.MjData(read)
    for _ in range(25):
        data.qpos[:] = rng.uniform(-3.0, 3.0, model.nq)
        for joint, value in zip(ranges.names, data.qpos, strict=True):
            theirs.joint(joint).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_kinematics(read, theirs)
        for number, site in enumerate(sites):
            here, there = data.site(site), theirs.body(link_name(number))
            assert np.abs(here.xpos - there.xpos).max() < 1e-9
            assert np.abs(here.xmat - there.xmat).max() < 1e-9
    for joint, lower, upper in zip(ranges.names, ranges.lower, ranges.upper, strict=True):
        expected = np.clip([lower, upper], -1e9, 1e9)
        np.testing.assert_array_equal(read.joint(joint).range, expected)
    assert text.count('velocity="2.0"') == model.nv

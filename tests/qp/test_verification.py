"""Nothing leaves unverified: lying backends, hard problems, proofs of optimality."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mink
import numpy as np
import numpy.typing as npt
import pytest
import qpsolvers
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.problems import NAMED, program, random_case
from oracles.referee import GAP, LowerBound, broken_constraint
from oracles.twists import POINT, pose

import qp_twist as qt
from qp_twist.qp import QuadraticProgram, Verified, installed_solvers, solve
from qp_twist.qp.backend import solve_raw
from qp_twist.qp.solve import Refused
from qp_twist.qp.verification import Point, proof_of_optimality

Array = npt.NDArray[np.float64]
DEBURRING = qt.load_task("deburring")
TRUTH = qpsolvers.solve_problem
Lie = Callable[[qpsolvers.Problem, Array], Any]
"""What a backend returns as the solution of a program, beside its optimum."""


# ---------------------------------------------------------------------------------------- the lies


def _free_direction(problem: qpsolvers.Problem) -> Array:
    """Along the rows' null space where that is possible."""
    if problem.A is None or not len(problem.A):
        return np.ones(problem.q.shape[0]) / np.sqrt(problem.q.shape[0])
    return np.linalg.svd(problem.A)[2][-1]


def _not_optimal(problem: qpsolvers.Problem, best: Array) -> Array:
    """A feasible point: from the optimum into the feasible set, as far as the nearest limit."""

    def room(x: Array) -> float:
        rooms = [np.inf]
        if problem.lb is not None:
            rooms += [(x - problem.lb).min(), (problem.ub - x).min()]
        if problem.G is not None:
            rooms.append((problem.h - problem.G @ x).min())
        return float(min(rooms))

    direction = _free_direction(problem)
    candidates = [best + t * direction for t in (0.3, -0.3, 1e-2, -1e-2, 1e-3, -1e-3)]
    inside = [x for x in candidates if room(x) >= 0.0]
    return inside[0] if inside else np.full(len(best), np.nan)


def _last_step(problem: qpsolvers.Problem, best: Array) -> Array:
    """What was right when the task and the objective were a tenth smaller."""
    last = qpsolvers.Problem(
        problem.P, 0.9 * problem.q, problem.G, problem.h,
        problem.A, None if problem.b is None else 0.9 * problem.b, problem.lb, problem.ub,
    )  # fmt: skip
    return _usable(TRUTH(last, solver="daqp"), problem)


def _usable(solution: qpsolvers.Solution, problem: qpsolvers.Problem) -> Array:
    usable = solution.x is not None and np.isfinite(solution.x).all()
    return np.array(solution.x) if usable else np.zeros(problem.q.shape[0])


LIES: dict[str, Lie] = {
    "NaN": lambda problem, best: np.full(len(best), np.nan),
    "infinity": lambda problem, best: np.full(len(best), np.inf),
    "zeros": lambda problem, best: np.zeros(len(best)),
    "last step": _last_step,
    # Farther than any bound or row.
    "outside the limits": lambda problem, best: best + 1e3 * _free_direction(problem),
    "off the rows": lambda problem, best: best + 1e-4,
    "feasible, not optimal": _not_optimal,
    "too short": lambda problem, best: np.zeros(len(best) - 1),
    "a column": lambda problem, best: np.zeros((len(best), 1)),
    "a number": lambda problem, best: 0.0,
    "text": lambda problem, best: ["a"] * len(best),
    "nothing, called solved": lambda problem, best: None,
}


class Backends:
    """``qpsolvers.solve_problem`` where a backend's solution is changed before it is returned.

    Attributes:
        lied: Whether the last one was wrong; zeros, say, may be right.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, change: Callable[..., None]) -> None:
        self.change, self.lied = change, False
        monkeypatch.setattr(qpsolvers, "solve_problem", self)

    @classmethod
    def lying(cls, monkeypatch: pytest.MonkeyPatch, lie: str) -> Backends:
        def change(solution: qpsolvers.Solution, problem: qpsolvers.Problem) -> None:
            said = LIES[lie](problem, _usable(solution, problem))
            solution.found, solution.x = True, said

        return cls(monkeypatch, change)

    def __call__(self, problem: qpsolvers.Problem, solver: str, **options: Any) -> Any:
        solution = TRUTH(problem, solver=solver, **options)
        truth = TRUTH(problem, solver="daqp", primal_tol=1e-11, dual_tol=1e-11)
        self.change(solution, problem)
        right = truth.found and np.shape(solution.x) == truth.x.shape
        right = right and np.asarray(solution.x).dtype == np.float64
        self.lied = not (right and np.abs(solution.x - truth.x).max() < 1e-6)
        return solution


# -------------------------------------------------------------------------------------- the places


def _task(projector: qt.TwistProjector, ahead: float = 0.0) -> qt.TwistTask:
    """Towards the first waypoints, or a point some metres ahead."""
    task = qt.TwistTask("tool", "site", projector)
    target = DEBURRING.waypoints[5]
    task.set_target(pose(target.rotation(), target.translation() + np.array([ahead, 0.0, 0.0])))
    return task


def _slow(speed: float) -> list[mink.Limit]:
    model = DEBURRING.model
    names = [model.joint(i).name for i in range(model.njnt)]
    return [qt.PositionLimit(model), mink.VelocityLimit(model, dict.fromkeys(names, speed))]


def _step(projector: qt.TwistProjector = DEBURRING.projector, **options: Any) -> qt.Step:
    given = {"tasks": [_task(projector)]} | options
    centering = qt.JointCentering(DEBURRING.model, gain=0.3)
    controller = qt.Controller(DEBURRING.model, **given, secondary=[centering], solver="daqp")
    return controller.step(mink.Configuration(DEBURRING.model, DEBURRING.start), 0.1)


def _levels(scale: float, **options: Any) -> qt.Solution:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(3, 6))
    J[:, 4:] = 0.0  # what is left has something to decide, at bounds too
    goal, one = scale * J @ rng.uniform(-0.3, 0.3, 6), np.ones(6)
    return qt.solve_levels([(J, goal)], -one, one, solver="daqp", reference=0.2 * one, **options)


PLACES: dict[str, Callable[[], qt.Step | qt.Solution]] = {
    "step": _step,
    "step in twist space": lambda: _step(secondary_space="twist"),
    "scaled step": lambda: _step(POINT, limits=_slow(0.05)),
    "relaxed step": lambda: _step(POINT, limits=_slow(0.05), on_infeasible="relax"),
    "two levels": lambda: _step(levels=[[_task(POINT)], [_task(POINT, 0.1)]], tasks=[]),
    "solve_levels": lambda: _levels(1.0),
    "solve_levels, scaled": lambda: _levels(10.0),
    "solve_levels, relaxed": lambda: _levels(10.0, on_infeasible="relax"),
}


def asked(place: str) -> tuple[Array, str]:
    """What is returned at a place, and the backend that it names."""
    found = PLACES[place]()
    if isinstance(found, qt.Solution):
        return found.x, ""
    return found.velocity, found.solver


UNNEEDED = ("", "levels")
"""Where no backend is named: on arrays, and where the levels leave a single point."""
HONEST = {place: asked(place)[0] for place in PLACES}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("lie", LIES)
def test_a_backend_that_lies_is_an_error_that_says_what_it_returned(
    monkeypatch: pytest.MonkeyPatch, place: str, lie: str
) -> None:
    backends = Backends.lying(monkeypatch, lie)
    try:
        x, solver = asked(place)
    except qt.SolverInaccurate as error:
        assert backends.lied
        assert "daqp returned" in str(error)
        assert isinstance(error.problem, qt.QuadraticProgram)
    else:
        np.testing.assert_allclose(x, HONEST[place], atol=2e-6)
        assert solver == "levels" or not backends.lied or lie == "zeros"


@pytest.mark.parametrize("place", PLACES)
def test_a_right_result_is_taken_whatever_the_multipliers(
    monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    def garbage(solution: qpsolvers.Solution, problem: qpsolvers.Problem) -> None:
        solution.y, solution.z, solution.z_box = np.full(50, np.nan), None, -1e9 * np.ones(6)

    Backends(monkeypatch, garbage)
    x, solver = asked(place)
    np.testing.assert_allclose(x, HONEST[place], atol=1e-12)
    assert solver in ("daqp", *UNNEEDED)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("how", ["not found", "raises"])
def test_a_backend_that_finds_nothing_is_an_error_that_says_so(
    monkeypatch: pytest.MonkeyPatch, place: str, how: str
) -> None:
    def modest(solution: qpsolvers.Solution, problem: qpsolvers.Problem) -> None:
        if how == "raises":
            raise RuntimeError("out of luck")
        solution.found = False

    Backends(monkeypatch, modest)
    with pytest.raises(qt.SolverInaccurate, match="daqp returned no solution"):
        asked(place)


def test_a_binding_limit_is_named_though_the_multipliers_are_garbage(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def garbage(solution: qpsolvers.Solution, problem: qpsolvers.Problem) -> None:
        solution.z_box = np.arange(6.0) - 3.0

    honest = _step(limits=_slow(0.3))
    assert honest.binding
    Backends(monkeypatch, garbage)
    step = _step(limits=_slow(0.3))
    assert [str(limit) for limit in step.binding] == [str(limit) for limit in honest.binding]


# ------------------------------------------------------------------------------ the solver matrix


@pytest.mark.parametrize("name", NAMED)
def test_every_backend_on_a_hard_problem(name: str) -> None:
    case = NAMED[name]()
    bound = LowerBound(case.problem)
    for solver in installed_solvers():
        result = solve(case.problem, solver)
        assert case.feasible or not isinstance(result, Verified), (solver, result)
        assert isinstance(result, Verified) == case.feasible or solver != "compiled", result
        if isinstance(result, Verified):
            assert not broken_constraint(case.problem, result.x), solver
            assert bound.gap(result.x) <= GAP, solver


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_our_own_solver_never_calls_a_wrong_result_solved(seed: int) -> None:
    case = random_case(seed)
    raw = solve_raw(case.problem, "compiled")
    assert isinstance(solve(case.problem, "compiled"), Verified) == raw.found
    assert case.feasible or not raw.found


def test_the_referee_sends_wrong_results_off() -> None:
    """The independent check itself: what it must not pass."""
    case = NAMED["a robot's step"]()
    p = case.problem
    result = solve(p, "daqp")
    assert isinstance(result, Verified)
    free = np.linalg.svd(p.A)[2][-1]
    for x in (result.x + 1e-2 * free, result.x - 1e-2 * free):
        assert not broken_constraint(p, x)
        assert LowerBound(p).gap(x) > GAP
    assert broken_constraint(p, result.x + 1e-6)
    assert broken_constraint(p, np.full(p.n, np.nan))
    outside = np.array(p.upper)
    outside[0] = np.nextafter(outside[0], np.inf)
    assert broken_constraint(p, outside) == "outside the bounds"


@pytest.mark.skipif(
    np.finfo(np.longdouble).eps >= np.finfo(float).eps, reason="no numbers longer than floats"
)
@pytest.mark.parametrize("seed", range(4))
def test_the_tip_of_a_narrow_wedge_is_proven_though_its_multipliers_are_large(seed: int) -> None:
    """Σ λ n = 1e6 with λ = 1e13, of which doubles leave 1e-3; a point beside the tip is refused."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    G = np.array([[1e-7, 1.0, 0.0], [1e-7, -0.6, 0.8], [1e-7, -0.6, -0.8]]) @ turn
    p = QuadraticProgram.free(1e-2 * np.eye(3), -1e6 * turn[0], G, np.zeros(3))
    result = solve(p, "compiled")
    assert isinstance(result, Verified)
    assert np.abs(result.x).max() < 1e-6
    for off in (1e-2, 1e-4):
        point = Point.at(p, -off * turn[0])
        assert "not optimal" in proof_of_optimality(p, point, result.multipliers)


def test_an_empty_box_is_refused_before_a_backend_sees_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(qpsolvers, "solve_problem")
    p = program(np.eye(2), np.zeros(2), lower=[0.0, 1.0], upper=[1.0, 0.5])
    result = solve(p, "daqp")
    assert isinstance(result, Refused)
    assert not result.claimed

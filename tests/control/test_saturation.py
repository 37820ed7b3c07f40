"""Saturation in the null space, against linear programs, optimality conditions and the QPs."""

import copy
import dataclasses
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog, lsq_linear

import qp_twist as qt
from qp_twist import closed_form
from qp_twist.closed_form import saturation_in_null_space
from qp_twist.comparison import metrics

Array = NDArray[np.float64]
EXAMPLE = Path(__file__).parents[2] / "examples" / "scaling.py"
SCALING = runpy.run_path(str(EXAMPLE))
SEEDS = st.integers(0, 2**32 - 1)
FORMS = pytest.mark.parametrize("optimal", [False, True], ids=["basic", "optimal"])


def largest_scale(A: Array, b: Array, lower: Array, upper: Array) -> float:
    """Optimum of the linear program, by HiGHS."""
    n = A.shape[1]
    result = linprog(
        -np.eye(n + 1)[-1],
        A_eq=np.column_stack([A, -b]),
        b_eq=np.zeros(len(b)),
        bounds=np.column_stack([np.append(lower, 0.0), np.append(upper, 1.0)]),
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return float(result.x[-1])


def distance_from_optimality(x: Array, A: Array, lower: Array, upper: Array) -> float:
    """How far −x is from Aᵀλ + μ with μ of the right sign: 0 proves that x is the shortest."""
    low, high = x <= lower + 1e-9, x >= upper - 1e-9
    at_bound = low | high
    free = np.full(len(A), np.inf)
    fit = lsq_linear(
        np.column_stack([A.T, np.eye(len(x))[:, at_bound]]),
        -x,
        (
            np.concatenate([-free, np.where(low, -np.inf, 0.0)[at_bound]]),
            np.concatenate([free, np.where(high, np.inf, 0.0)[at_bound]]),
        ),
        method="bvls",
        tol=1e-14,
    )
    return float(np.linalg.norm(fit.fun))


def as_published(A: Array, b: Array, lower: Array, upper: Array) -> tuple[Array, float]:
    """The basic algorithm word by word: each trial at s = 1, its best scale kept book of."""
    n = A.shape[1]
    W, x_n = np.eye(n), np.zeros(n)
    best, x_best = 0.0, np.zeros(n)
    while np.linalg.matrix_rank(A @ W, tol=1e-9) == len(A):
        inverse = np.linalg.pinv(A @ W)
        inverse[np.diag(W) == 0.0] = 0.0
        x = x_n + inverse @ (b - A @ x_n)
        if ((lower <= x) & (x <= upper)).all():
            return x, 1.0
        slope = inverse @ b
        rest = x - slope
        free = np.flatnonzero(np.diag(W))
        ends = np.sort([(lower - rest)[free] / slope[free], (upper - rest)[free] / slope[free]], 0)
        if ends[0].max() <= ends[1].min() and ends[1].min() > best:
            best = float(ends[1].min())
            x_best = rest + best * slope
        critical = free[np.argmin(ends[1])]
        W[critical, critical] = 0.0
        x_n[critical] = upper[critical] if x[critical] > upper[critical] else lower[critical]
    return x_best, best


def check_what_is_promised(
    result: closed_form.Saturation, A: Array, b: Array, lower: Array, upper: Array
) -> None:
    x = result.displacement
    assert (lower <= x).all()
    assert (x <= upper).all()
    assert 0.0 <= result.scale <= 1.0
    error = np.linalg.norm(A @ x - result.scale * b)
    assert error <= 1e-10 * (1.0 + np.linalg.norm(b))
    at_bound = (x - lower <= 1e-9) | (upper - x <= 1e-9)
    assert at_bound[result.saturated].all()


# ---------------------------------------------------------------- one step


@FORMS
@given(seed=SEEDS, joints=st.integers(1, 9), rows=st.integers(1, 9))
@settings(max_examples=25)
def test_without_an_active_bound_it_is_the_minimum_norm(
    optimal: bool, seed: int, joints: int, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(min(rows, joints), joints))
    x = A.T @ rng.normal(size=len(A))  # in the row space: the shortest that does A x
    lower = np.where(rng.uniform(size=joints) < 0.3, -np.inf, np.minimum(1.1 * x, 0.0) - 1e-3)
    upper = np.maximum(1.1 * x, 0.0) + 1e-3
    result = saturation_in_null_space(A, None, A @ x, lower, upper, optimal=optimal)
    assert result.displacement == pytest.approx(x, abs=1e-9 * (1.0 + np.abs(x).max()))
    assert result.scale == 1.0
    assert result.proven
    assert not result.saturated.any()


def test_on_random_problems() -> None:
    """The basic form is the published one; the optimal one is the linear program's, and shortest.

    On some of them holding for good costs the basic form some of the scale.
    """
    short = 0
    for seed in range(60):
        p = SCALING["random_problem"](seed)
        problem = (p.J, p.goal, p.lower, p.upper)
        largest = largest_scale(*problem)
        assert largest >= p.sigma - 1e-9  # by construction of the problem
        basic, optimal = (
            saturation_in_null_space(p.J, None, p.goal, p.lower, p.upper, optimal=flag)
            for flag in (False, True)
        )
        for result in (basic, optimal):
            check_what_is_promised(result, *problem)
        published, scale = as_published(*problem)
        assert basic.scale == pytest.approx(scale, abs=1e-9)
        assert basic.displacement == pytest.approx(published, abs=1e-9)
        assert basic.scale <= largest + 1e-9
        assert not basic.proven or basic.scale == pytest.approx(largest, abs=1e-9)
        assert optimal.proven
        assert optimal.scale == pytest.approx(largest, abs=1e-9)
        assert distance_from_optimality(optimal.displacement, p.J, p.lower, p.upper) < 1e-9
        if basic.scale == 1.0:
            lengths = [np.linalg.norm(result.displacement) for result in (optimal, basic)]
            assert lengths[0] <= lengths[1] + 1e-12
        if basic.scale < optimal.scale - 1e-3:
            assert not basic.proven
            short += 1
    assert short > 0


@FORMS
def test_of_dependent_rows_the_part_in_their_range_counts(optimal: bool) -> None:
    A = np.array([[1.0, 1.0], [1.0, 1.0]])
    result = saturation_in_null_space(A, None, [1.0, 3.0], [-1, -1], [0.8, 5], optimal=optimal)
    assert result.displacement == pytest.approx([0.8, 1.2])
    assert result.scale == 1.0
    # No row can be moved: nothing is asked, nothing is done.
    still = saturation_in_null_space(
        np.zeros((2, 2)), None, [1, 1], [-1, -1], [1, 1], optimal=optimal
    )
    assert still.displacement.tolist() == [0.0, 0.0]


@FORMS
def test_wrong_input_is_refused(optimal: bool) -> None:
    def call(**wrong: Any) -> None:
        given = {"jacobian": np.eye(2), "projector": None, "twist": [1, 1], "lower": [-1, -1]}
        saturation_in_null_space(**{**given, "upper": [1, 1], "optimal": optimal, **wrong})

    for bound in ([0.5, -1.0], [np.nan, -1.0], [-1.0], "low", None):
        with pytest.raises(qt.InvalidInput, match="lower"):
            call(lower=bound)
    for bound in ([-0.5, 1.0], [np.nan, 1.0], [[1.0, 1.0]], "high"):
        with pytest.raises(qt.InvalidInput, match="upper"):
            call(upper=bound)
    with pytest.raises(qt.InvalidInput, match="twist: expected an array of shape"):
        call(twist=[1.0])
    with pytest.raises(qt.InvalidInput, match="jacobian"):
        call(jacobian=[[np.inf, 1.0], [0.0, 1.0]])


# ---------------------------------------------------------------- along a path


@FORMS
def test_at_a_position_limit_it_goes_on_as_the_quadratic_program_does(optimal: bool) -> None:
    task = narrowed(qt.load_task("planar_line"), joint=2, upper_deg=105.0)
    assert metrics(qt.follow(task, "minimum_norm"))["first_violation"].keys() == {"joint_3"}
    found, program = qt.follow(task, "sns", optimal=optimal), qt.follow(task, "qp_minimum_norm")
    assert found.q == pytest.approx(program.q, abs=1e-9)
    assert metrics(found)["status"] == "ok"
    assert found.margins.min() < 1e-3


def narrowed(task: qt.PathTask, joint: int, upper_deg: float) -> qt.PathTask:
    """The same task with another upper limit of one joint."""
    model = copy.copy(task.model)
    model.jnt_range[joint, 1] = np.radians(upper_deg)
    return dataclasses.replace(task, model=model)


# ---------------------------------------------------------------- the example


def test_the_example_prints_its_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["scaling.py", "--problems", "60"])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    table = capsys.readouterr().out.splitlines()
    rows = {line[:16].strip(): line[16:].split() for line in table[3:]}
    assert list(rows) == list(SCALING["WAYS"])
    for name in ("qt.solve_levels", "SNS, optimal"):
        met, same, difference, excess, error, _, _ = rows[name]
        assert (met, same) == ("100.00%", "100.00%")
        assert float(difference) <= 1e-6
        assert float(excess) <= 1e-9
        assert float(error) <= 1e-8

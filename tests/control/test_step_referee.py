"""The referee of random steps: it has to see what is wrong before it may say "none"."""

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
import qpsolvers
from oracles import step_referee as referee
from scipy.optimize import linprog

# Kernels, and a referee by singular values, against quadprog and HiGHS.
pytestmark = pytest.mark.any_blas

FOLDER = Path(__file__).parents[2] / "benchmarks"
ROWS, BOUNDS, GRADIENT, SLACK = range(4)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(FOLDER)  # as where it is run
    return importlib.import_module("random_steps")


class Steps:
    """Steps of one case, solved by quadprog and HiGHS: not by the package."""

    def __init__(self, study: ModuleType, number: int, count: int) -> None:
        self.study, self.case = study, study.CASES[number]
        self.model = study.composed(self.case)[0].model
        self.chain = study.chain_of(self.model, self.case.site)
        rng = np.random.default_rng(number)
        self.q, self.targets = study.random_problems(self.chain, count, rng)
        n, m = self.model.nv, self.case.kind
        self.x, self.s = np.zeros((count, n)), np.ones(count)
        self.programs = []
        for k in range(count):
            A, b, _, box, h, F = referee.stated(
                self.chain, m, study.SPEED, study.GAIN, study.DT, self.q[k], self.targets[k]
            )
            fastest = linprog(
                np.append(np.zeros(n), -1.0), A_eq=np.column_stack([A, -b]), b_eq=np.zeros(m),
                bounds=[*zip(*box, strict=True), (0.0, 1.0)],
            )  # fmt: skip
            if fastest.x[-1] < 1.0:
                self.s[k] = fastest.x[-1] * (1.0 - 1e-8)
            H = np.outer(F, F) + A.T @ A if self.case.twist_space else np.eye(n)
            c = -np.outer(F, F) @ h if self.case.twist_space else -h
            self.x[k] = qpsolvers.solve_qp(
                H, c, None, None, A, self.s[k] * b, *box, solver="quadprog"
            )
            self.programs.append((A, b, box))

    def found(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Which tolerances each step breaks, (K, 4)."""
        b = self.study
        found = b.judge(
            self.chain, self.case.kind, self.case.twist_space, b.SPEED, b.GAIN, b.DT, self.q,
            self.targets, x, s, np.ones(len(x), dtype=bool),
        )  # fmt: skip
        return ~(found[:, :4] <= [b.ROWS, b.BOUNDS, b.GRADIENT, b.SLACK])


def test_its_kinematics_are_mujocos(study: ModuleType) -> None:
    for case in study.CASES:
        model = study.composed(case)[0].model
        data, site = mujoco.MjData(model), model.site(case.site).id
        chain, n = study.chain_of(model, case.site), model.nv
        q, _ = study.random_problems(chain, 20, np.random.default_rng(1))
        assert q.std(axis=0).min() > 0.5
        for here, R, p, J in zip(q, *referee.kinematics(chain, q), strict=True):
            data.qpos[:] = here
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            exact = np.zeros((6, n))
            mujoco.mj_jacSite(model, data, exact[:3], exact[3:], site)
            np.testing.assert_allclose(J, exact, atol=1e-12)
            np.testing.assert_allclose(p, data.site_xpos[site], atol=1e-12)
            np.testing.assert_allclose(R.ravel(), data.site_xmat[site], atol=1e-12)


@pytest.mark.parametrize("number", range(6))
def test_it_lets_optimal_steps_pass_and_refuses_planted_errors(
    study: ModuleType, number: int
) -> None:
    steps = Steps(study, number, 40)
    x, s = steps.x, steps.s
    as_solved = steps.found(x, s)
    assert not as_solved[:, [ROWS, BOUNDS]].any()
    proved = ~as_solved.any(axis=1)
    assert proved.mean() > 0.9 and (number in (2, 5) or (s < 1.0).sum() > 1)
    rng = np.random.default_rng(2)
    # A velocity that is off by 1e-5, in any direction: some row sees it, or it is not optimal.
    off = rng.normal(size=x.shape)
    off *= 1e-5 / np.abs(off).max(axis=1)[:, None]
    assert steps.found(x + off, s)[:, ROWS].mean() > 0.95
    for k, (A, b, box) in enumerate(steps.programs):
        if not proved[k]:
            continue
        # On its rows and inside its bounds, but not optimal: a step towards another vertex.
        away = qpsolvers.solve_qp(
            np.eye(len(x[k])), rng.normal(size=len(x[k])), None, None, A, s[k] * b, *box,
            solver="quadprog",
        )  # fmt: skip
        other = x.copy()
        other[k] += min(1.0, 1e-2 / (np.abs(away - x[k]).max() + 1e-300)) * (away - x[k])
        if np.abs(other[k] - x[k]).max() > 1e-3 and not study.CASES[number].twist_space:
            assert steps.found(other, s)[k].tolist() == [False, False, True, False]
        if s[k] < 1.0:  # slower than it has to be, by a hundredth
            slower, less = x.copy(), s.copy()
            slower[k] *= 0.99
            less[k] *= 0.99
            verdict = steps.found(slower, less)[k]
            assert verdict[SLACK] and not verdict[[ROWS, BOUNDS]].any()
    # A bound that is passed along the null space of the rows, and what is no number.
    beyond = x.copy()
    for k, (A, _, box) in enumerate(steps.programs):
        free = np.linalg.svd(A)[2][-1]
        j = int(np.abs(free).argmax())
        beyond[k] += (box[1, j] + 1e-6 - x[k, j]) / free[j] * free
    assert steps.found(beyond, s)[:, BOUNDS].all()
    unknown = x.copy()
    unknown[:, -1] = np.nan
    assert steps.found(unknown, s).any(axis=1).all()


@pytest.fixture
def asked(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """The study from its command line, with its results in the test's folder."""

    def main(*options: str) -> int:
        given = ["random_steps.py", "random_steps", "--keep", str(tmp_path), *options]
        monkeypatch.setattr("sys.argv", given)
        return int(study.main())

    return main


def test_a_kernel_that_lies_is_found_out(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: Callable[..., int]
) -> None:
    honest = study.qt.batch.step

    def lies(*arguments: object, **options: object) -> object:
        done = honest(*arguments, **options)
        done.velocity[3] *= 1.001
        done.velocity[5] = np.nan
        return done

    monkeypatch.setattr(study.qt.batch, "step", lies)
    assert asked("--pieces", "1", "--steps", "200") == 1
    result = json.loads(next(tmp_path.glob("run-*-0.json")).read_text())
    assert [step for step, *_ in result["refused"]] == [3, 5]
    assert result["counts"]["off the rows"] == 2

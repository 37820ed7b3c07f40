"""Our own solver, compiled: as good as any."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.problems import NAMED, random_case

import qp_twist as qt
from qp_twist.qp import Verified, solve
from qp_twist.qp.backend import solve_raw

# ---------------------------------------------------------------- the program


@pytest.mark.parametrize("name", NAMED)
def test_every_named_program_is_solved_or_refused_as_it_should(name: str) -> None:
    case = NAMED[name]()
    assert isinstance(solve(case.problem, "compiled"), Verified) == case.feasible or (
        name == "rows of cond 1e+10"  # nearly dependent: it asks again on an orthonormal basis
        and isinstance(solve(case.problem, "compiled"), Verified)
    )


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_never_calls_a_wrong_result_solved(seed: int) -> None:
    case = random_case(seed)
    raw = solve_raw(case.problem, "compiled")
    result = solve(case.problem, "compiled")
    assert isinstance(result, Verified) == raw.found
    assert case.feasible or not raw.found


@functools.cache
def _active_set() -> Any:
    """The compiled method, which Python cannot call by itself."""
    from numba import njit

    from qp_twist.kernel import dual_active_set as method

    def solved(H, c, *given):  # type: ignore[no-untyped-def]
        A, b, G, g, lower, upper, active, before, x, u, J, R, held, work, lengths = given
        method.cholesky_inverse(H, J)
        method.row_lengths(G, lengths)
        return method.active_set(
            c, A, b, G, g, lengths, lower, upper, active, before, x, u, J, R, held, work
        )

    return method, njit(solved)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_beginning_from_any_active_set_ends_at_the_same_point(seed: int) -> None:
    method, solved = _active_set()
    rng = np.random.default_rng(seed)
    n, m, k = int(rng.integers(2, 9)), int(rng.integers(0, 3)), int(rng.integers(0, 4))
    root = rng.normal(size=(n, n))
    x0 = rng.normal(size=n)
    A, G = rng.normal(size=(m, n)), rng.normal(size=(k, n))
    problem = (
        root @ root.T + 0.1 * np.eye(n), rng.normal(size=n), A, A @ x0, G, G @ x0 + 0.1,
        x0 - rng.random(n), x0 + rng.random(n),
    )  # fmt: skip
    found = []
    for before in (0, int(rng.integers(0, n - m + 1))):
        active = np.zeros(n, dtype=np.int64)
        active[:before] = m + rng.permutation(k + 2 * n)[:before]
        x, u = np.zeros(n), np.zeros(n + 1)
        status, count = solved(
            *problem, active, before, x, u, np.zeros((n, n)), np.zeros((n, n)),
            np.zeros(m + k + 2 * n, dtype=np.int64), np.zeros((3, n + 1)), np.zeros(k),
        )  # fmt: skip
        assert status == method.SOLVED
        assert (u[m:count] >= 0.0).all()
        found.append(x)
    np.testing.assert_allclose(found[0], found[1], atol=1e-9 * (1.0 + np.abs(found[0]).max()))


# ---------------------------------------------------------------- the name


def test_it_has_no_options() -> None:
    with pytest.raises(qt.InvalidInput, match="has no options"):
        solve_raw(NAMED["a robot's step"]().problem, "compiled", options={"eps_abs": 1e-3})

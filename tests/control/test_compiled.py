"""Our own solver, compiled: as good as any; test_verification.py asks it for the named programs."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.problems import NAMED, random_case

import qp_twist as qt
from qp_twist.qp import Verified, solve
from qp_twist.qp.backend import solve_raw


@settings(max_examples=120, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_never_calls_a_wrong_result_solved(seed: int) -> None:
    case = random_case(seed)
    raw = solve_raw(case.problem, "compiled")
    result = solve(case.problem, "compiled")
    assert isinstance(result, Verified) == raw.found
    assert case.feasible or not raw.found


def test_it_has_no_options() -> None:
    with pytest.raises(qt.InvalidInput, match="has no options"):
        solve_raw(NAMED["a robot's step"]().problem, "compiled", options={"eps_abs": 1e-3})

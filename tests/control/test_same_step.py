"""The one contract between the two statements of the step: reference and kernel say the same.

And both say what the reference said when its answers were recorded (``oracles/recorded_steps.py``,
which compares all of them; here a part of them is compared).
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.compositions import composition
from oracles.recorded_steps import (
    COUNT,
    Recorded,
    answer,
    ask,
    differences,
    kept,
    taken_by_kernel,
)

AT_A_TIME, PARTS = 40, 8
recorded = functools.cache(kept)


def difference(seed: int, solver: str, expected: Recorded, *, smooth: bool = False) -> str:
    """In what the answer of a solver differs, in words; empty where it does not."""
    found = differences(answer(composition(seed), solver, smooth=smooth), expected)
    if not found:
        return ""
    return f"{seed}, {solver}: {'; '.join(found)} ({', '.join(composition(seed).words)})"


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("solver", ["quadprog", "compiled"])
def test_steps_are_those_that_were_recorded(solver: str, part: int) -> None:
    records = recorded()
    chosen = np.random.default_rng(part).choice(len(records), AT_A_TIME, replace=False).tolist()
    found = [difference(seed, solver, records[seed]) for seed in chosen]
    assert not any(found), "\n".join(filter(None, found))


@pytest.mark.parametrize("smooth", [True, False])
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(COUNT, 2**32 - 1))
def test_reference_and_kernel_take_the_same_step(smooth: bool, seed: int) -> None:
    """A smooth step brakes, fades and gives way in the same words and numbers."""
    found = difference(seed, "compiled", ask(seed, "daqp", smooth=smooth), smooth=smooth)
    assert not found


def test_a_difference_is_seen() -> None:
    """A comparison that cannot fail compares nothing."""
    record = next(r for r in recorded() if r.settled and r.answer.active and r.spread < 1e-8)
    for change in (
        {"velocity": record.answer.velocity + 1e-5 * (1.0 + abs(record.answer.velocity).max())},
        {"residuals": record.answer.residuals + 1e-3 * (1.0 + abs(record.answer.velocity).max())},
        {"scale": record.answer.scale + 1e-4},
        {"status": "RELAXED" if record.answer.status != "RELAXED" else "SOLVED"},
        {"active": record.answer.active[1:]},
    ):
        assert differences(record.answer._replace(**change), record)
    assert not differences(record.answer, record)


def test_the_recorded_steps_are_of_every_kind_and_the_kernel_takes_most_itself() -> None:
    """Falling back to the reference is rare where the step is a plain one, and counted."""
    records = recorded()
    statuses = [record.answer.status for record in records]
    assert {"SOLVED", "SCALED", "RELAXED", "PRIORITIZED", "DEGRADED", "InfeasibleStep"} <= set(
        statuses
    )
    assert sum(record.settled for record in records) > 0.9 * len(records)
    plain = [seed for seed, status in enumerate(statuses) if status == "SOLVED"][:100]
    assert sum(taken_by_kernel(composition(seed)) for seed in plain) >= 70

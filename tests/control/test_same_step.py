"""The one contract between the two statements of the step: reference and kernel say the same."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.compositions import composition
from oracles.two_statements import answer, ask, differences


@pytest.mark.parametrize("smooth", [True, False])
@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_reference_and_kernel_take_the_same_step(smooth: bool, seed: int) -> None:
    """A step brakes, fades, scales and gives way in the same words and numbers."""
    question = composition(seed)
    compiled = answer(question, "compiled", smooth=smooth)
    found = differences(compiled, ask(seed, "daqp", smooth=smooth))
    assert not found, f"{seed}: {'; '.join(found)} ({', '.join(question.words)})"


def test_a_difference_is_seen() -> None:
    """A comparison that cannot fail compares nothing."""
    asked = (ask(seed, "daqp") for seed in range(100))
    one = next(a for a in asked if a.settled and a.answer.active and a.spread < 1e-8)
    for change in (
        {"velocity": one.answer.velocity + 1e-5 * (1.0 + abs(one.answer.velocity).max())},
        {"residuals": one.answer.residuals + 1e-3 * (1.0 + abs(one.answer.velocity).max())},
        {"scale": one.answer.scale + 1e-4},
        {"status": "RELAXED" if one.answer.status != "RELAXED" else "SOLVED"},
        {"active": one.answer.active[1:]},
    ):
        assert differences(one.answer._replace(**change), one)
    assert not differences(one.answer, one)

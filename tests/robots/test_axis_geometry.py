"""Invariants of axes: what they are made of, and how they change where an axis counts backwards."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from qp_twist.robots.axis_geometry import Line, axis_geometry


@given(seed=st.integers(0, 10**6), parallel=st.booleans(), signs=st.tuples(*[st.booleans()] * 6))
def test_axes_that_count_backwards_have_the_geometry_of_the_turned_lines(
    seed: int, parallel: bool, signs: tuple[bool, ...]
) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(6, 3))
    if parallel:  # as the second, third and fourth of many arms
        axes[2] = axes[1]
        axes[3] = -axes[1]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    points = rng.normal(size=(6, 3))
    turn = np.where(signs, -1.0, 1.0)
    lines = [Line(axis, point) for axis, point in zip(axes, points, strict=True)]
    expected = axis_geometry([Line(s * a, p) for s, a, p in zip(turn, axes, points, strict=True)])
    found = axis_geometry(lines).turned(turn)
    assert found.is_like(expected) and expected.is_like(found)
    np.testing.assert_allclose(np.exp(1j * found.angles), np.exp(1j * expected.angles), atol=1e-9)
    np.testing.assert_allclose(found.lengths, expected.lengths, atol=1e-9)

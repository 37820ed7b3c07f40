"""What a toolpath says at a glance, against sums over its points one by one."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qp_twist.paths import Toolpath, read_toolpath
from qp_twist.paths.toolpath import Curve
from qp_twist.paths.toolpath_summary import summarize, tool_motion

SEEDS = st.integers(0, 10**6)


def curve(rng: np.random.Generator, count: int, first_line: int, feeds: bool) -> Curve:
    vectors = rng.normal(size=(count, 3))
    return Curve(
        "any",
        rng.normal(size=(count, 3)),
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True),
        None,
        np.arange(first_line, first_line + count),
        rng.uniform(0.01, 0.1, size=count) if feeds else None,
    )


@given(seed=SEEDS, feeds=st.booleans())
def test_numbers_are_sums_over_the_points(seed: int, feeds: bool) -> None:
    rng = np.random.default_rng(seed)
    one, other = curve(rng, 4, 10, feeds), curve(rng, 3, 30, feeds)
    found = summarize(Toolpath(Path("any.apt"), "axis", (one, other), unit="mm"))
    cut, time, longest, turn = 0.0, 0.0, (0.0, 0), (0.0, 0)
    for each in (one, other):
        for k in range(1, len(each)):
            step = math.dist(each.positions[k - 1], each.positions[k])
            cut += step
            time += step / each.feeds[k] if each.feeds is not None else 0.0
            longest = max(longest, (step, int(each.lines[k])))
            assert each.vectors is not None
            cosine = float(each.vectors[k - 1] @ each.vectors[k])
            turn = max(turn, (math.acos(cosine), int(each.lines[k])))
    assert (found.curves, found.points) == (2, 7)
    assert found.cut == pytest.approx(cut)
    assert found.rapids == pytest.approx(math.dist(one.positions[-1], other.positions[0]))
    assert found.time == (pytest.approx(time) if feeds else None)
    assert found.longest_step is not None and found.largest_turn is not None
    assert found.longest_step.line == longest[1]
    assert found.longest_step.value == pytest.approx(longest[0])
    assert found.largest_turn.line == turn[1]
    assert found.largest_turn.value == pytest.approx(turn[0])
    points = np.vstack([one.positions, other.positions])
    np.testing.assert_array_equal(found.low, points.min(axis=0))
    np.testing.assert_array_equal(found.high, points.max(axis=0))


def test_small_turns_are_exact() -> None:
    angle = 1e-9
    vectors = np.array([[0.0, 0.0, 1.0], [math.sin(angle), 0.0, math.cos(angle)]])
    line = Curve("any", np.eye(3)[:2], vectors, None, np.arange(1, 3))
    found = summarize(Toolpath(Path("any.apt"), "axis", (line,)))
    assert found.largest_turn is not None
    assert found.largest_turn.value == pytest.approx(angle, rel=1e-6)


def test_rapid_motions_are_no_cuts_and_without_directions_nothing_turns(tmp_path: Path) -> None:
    file = tmp_path / "part.apt"
    file.write_text(
        "UNITS/MM\nRAPID\nGOTO/0,0,50\nFEDRAT/600,MMPM\nGOTO/0,0,0\nGOTO/30,40,0\nRAPID\n"
        "GOTO/30,40,50\n"
    )
    toolpath = read_toolpath(file)
    motion, found = tool_motion(toolpath), summarize(toolpath)
    assert found.cut == pytest.approx(motion.steps[motion.cut].sum())
    assert found.cut + found.rapids == pytest.approx(0.15)
    assert found.feeds == (pytest.approx(0.01), pytest.approx(0.01))


def test_one_point_has_no_step() -> None:
    point = Curve("any", np.zeros((1, 3)), None, None, np.array([3]))
    found = summarize(Toolpath(Path("any.csv"), "none", (point,)))
    assert found.longest_step is None and found.largest_turn is None and found.tilt is None
    assert found.cut == found.rapids == 0.0 and found.time is None

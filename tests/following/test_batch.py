"""Many runs at once: each the same as one by one."""

import dataclasses

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import qp_twist as qt
from qp_twist.paths import PathTask

Array = np.ndarray


def random_moves(rng: np.random.Generator, count: int, size: float) -> list[mink.SE3]:
    return [mink.SE3.exp(size * rng.normal(size=6)) for _ in range(count)]


def one_by_one(path_task: PathTask, method: str, start: Array, move: mink.SE3) -> qt.Trajectory:
    flipped = path_task.flipped_waypoints
    return qt.follow(
        dataclasses.replace(
            path_task,
            start=start,
            waypoints=tuple(move @ w for w in path_task.waypoints),
            flipped_waypoints=flipped and tuple(move @ w for w in flipped),
        ),
        method,
        solver="daqp",
    )


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_each_run_is_the_one_that_would_be_followed_alone(seed: int, threads: int) -> None:
    rng = np.random.default_rng(seed)
    path_task = qt.load_task("deburring").part(slice(25))
    method = ("rmr", "minimum_norm", "gradient_projection", "qp_gradient", "qp")[rng.integers(5)]
    moves = random_moves(rng, 3, 0.02)
    starts = path_task.start + 0.05 * rng.normal(size=(3, 6))
    runs = qt.batch.follow(path_task, method, starts=starts, moves=moves, threads=threads)
    assert runs.q is not None
    for run, (start, move) in enumerate(zip(starts, moves, strict=True)):
        alone = one_by_one(path_task, method, start, move)
        assert runs.waypoints[run] == len(alone.q)
        np.testing.assert_allclose(runs.q[run, : len(alone.q)], alone.q, atol=1e-9)
        expected = (
            alone.position_error.max(), alone.axis_error.max(), alone.margins.min(),
            alone.z.mean(), np.abs(np.diff(alone.q, axis=0)).max(), alone.iterations.sum(),
        )  # fmt: skip
        found = (
            runs.position_error[run], runs.axis_error[run], runs.min_margin[run],
            runs.mean_z[run], runs.max_step[run], runs.steps[run],
        )  # fmt: skip
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert not runs.failures


def test_a_run_that_fails_stops_no_other() -> None:
    path_task = qt.load_task("deburring").part(slice(12))
    away = mink.SE3.from_translation(np.array([50.0, 0.0, 0.0]))
    moves = [mink.SE3.identity(), away, mink.SE3.identity()]
    runs = qt.batch.follow(path_task, "qp_gradient", moves=moves)
    assert list(runs.failures) == [1]
    assert "cannot be corrected onto the first waypoint" in runs.failures[1]
    assert runs.waypoints.tolist() == [12, 0, 12]
    assert runs.q is not None
    assert np.isnan(runs.q[1]).all()
    assert np.isnan(runs.mean_z[1])
    np.testing.assert_array_equal(runs.q[0], runs.q[2])


def test_runs_that_limits_hold_are_finished_by_the_reference() -> None:
    path_task = qt.load_task("deburring").part(slice(30))
    slow = dataclasses.replace(
        path_task,
        durations=np.concatenate([[0.0], np.full(29, 0.1)]),
        velocity_limits=np.full(6, 0.05),
    )
    runs = qt.batch.follow(slow, "qp_gradient", starts=[slow.start, slow.start])
    alone = qt.follow(slow, "qp_gradient", solver="daqp")
    assert alone.scale.min() < 1.0
    assert runs.by_reference.all()
    assert runs.q is not None
    np.testing.assert_allclose(runs.q[0], alone.q, atol=1e-9)


def test_what_cannot_be_done_is_a_sentence() -> None:
    path_task = qt.load_task("deburring").part(slice(5))
    for arguments, said in (
        ({"method": "sns"}, "has no compiled form"),
        ({"method": "qp_planned"}, "has no compiled form"),
        ({"method": "nonsense"}, "nonsense"),
        ({"starts": np.zeros((2, 5))}, "starts"),
        ({"starts": np.full((2, 6), np.nan)}, "starts"),
        ({"starts": np.zeros((2, 6)), "moves": [mink.SE3.identity()] * 3}, "2 starts and 3 moves"),
        ({"moves": np.zeros((2, 4, 4))}, "number 0 is no rigid motion"),
        ({"moves": np.zeros((2, 3))}, "moves"),
        ({"threads": 0}, "threads"),
        ({"gain": -1.0}, "gain"),
    ):
        with pytest.raises(qt.InvalidInput, match=said):
            qt.batch.follow(path_task, **{"method": "qp_gradient", **arguments})  # type: ignore[arg-type]

"""Kinematics, corrections and runs as machine code: the same as the reference."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import qp_twist as qt

SEEDS = st.integers(0, 2**32 - 1)


# ---------------------------------------------------------------- runs


def runs(path_task: qt.PathTask, method: str, **options: Any) -> tuple[Any, Any]:
    both = []
    for solver in ("daqp", "compiled"):
        try:
            both.append(qt.follow(path_task, method, solver=solver, **options))
        except qt.QpTwistError as error:
            both.append(str(error))
    return both[0], both[1]


def same_run(a: Any, b: Any) -> None:
    if isinstance(a, str) or isinstance(b, str):
        assert a == b
        return
    np.testing.assert_allclose(b.q, a.q, atol=1e-8)
    for name in ("position_error", "axis_error", "sigma_min", "scale", "band_excess"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name), atol=1e-8, err_msg=name)
    assert (a.iterations == b.iterations).mean() > 0.98
    assert a.statuses == b.statuses
    assert a.binding == b.binding
    assert (a.failure, a.diverged_at) == (b.failure, b.diverged_at)
    if a.durations is not None:
        np.testing.assert_array_equal(a.durations, b.durations)


METHODS = (
    "rmr", "rmr_flipped", "minimum_norm", "gradient_projection", "twa", "qp_rmr",
    "qp_minimum_norm", "qp_gradient", "qp",
)  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_a_run_is_the_reference_run(method: str) -> None:
    same_run(*runs(qt.load_task("planar_line"), method))


@pytest.mark.parametrize("method", ["rmr", "minimum_norm", "qp_gradient", "qp"])
def test_a_run_with_blended_projectors_is_the_reference_run(method: str) -> None:
    same_run(*runs(qt.load_task("approach_contact_retreat"), method))


@settings(max_examples=8, deadline=None)
@given(SEEDS)
def test_a_run_that_limits_hold_is_the_reference_run(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path_task = qt.load_task("planar_line")
    start = path_task.start + rng.normal(scale=0.3, size=path_task.model.nq)
    slow = rng.uniform(0.05, 0.6) * np.ones(path_task.model.nv)
    durations = np.full(len(path_task.waypoints), 0.1)
    durations[0] = 0.0
    path_task = dataclasses.replace(
        path_task, start=start, durations=durations, velocity_limits=slow
    )
    method = METHODS[rng.integers(len(METHODS))]
    same_run(*runs(path_task, method, gain=float(rng.uniform(0.0, 2.0))))


def test_a_run_along_a_plan_is_the_reference_run() -> None:
    path_task = qt.load_task("planar_line")
    same_run(*runs(path_task, "qp_planned", plan=qt.plan(path_task, start=path_task.start)))


def test_progress_and_stop_are_called_at_every_waypoint() -> None:
    path_task, seen = qt.load_task("planar_line"), []
    run = qt.follow(
        path_task, "qp_gradient", solver="compiled", progress=seen.append,
        stop=lambda q, apart, turned: len(seen) == 7,
    )  # fmt: skip
    assert seen == [1, 2, 3, 4, 5, 6, 7]
    assert len(run.q) == 8

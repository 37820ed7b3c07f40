"""Weighted least norm and its weights, against a linear solve and finite differences."""

import dataclasses

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles.arms import random_arm, random_configuration
from oracles.twists import site

import qp_twist as qt
from qp_twist import closed_form
from qp_twist.comparison import metrics

Array = NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)
ROLL_FREE = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]))


def full_rank(rng: np.random.Generator, rows: int, joints: int) -> Array:
    """Rows with singular values between 0.2 and 2."""
    u, _, vt = np.linalg.svd(rng.normal(size=(rows, joints)), full_matrices=False)
    return u * rng.uniform(0.2, 2.0, size=len(vt)) @ vt


@given(SEEDS, st.integers(1, 9), st.integers(1, 9))
@settings(max_examples=25)
def test_it_solves_the_optimality_conditions(seed: int, rows: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    rows = min(rows, joints)
    A, b = full_rank(rng, rows, joints), rng.normal(size=rows)
    weight = 10.0 ** rng.uniform(-2.0, 2.0, size=joints)
    kkt = np.block([[np.diag(weight), A.T], [A, np.zeros((rows, rows))]])
    oracle = np.linalg.solve(kkt, np.concatenate([np.zeros(joints), b]))[:joints]
    found = closed_form.weighted_least_norm(A, None, b, weight)
    assert found == pytest.approx(oracle, abs=1e-9 * (1.0 + np.abs(oracle).max()))
    # Only the ratios count.
    assert closed_form.weighted_least_norm(A, None, b, 1e9 * weight) == pytest.approx(found)


@given(SEEDS)
@settings(max_examples=15)
def test_it_is_the_quadratic_program_in_the_metric_of_the_weights(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_arm(rng, 7)
    configuration = mink.Configuration(model, random_configuration(model, rng, margin=0.2))
    task = qt.TwistTask("tool", "site", ROLL_FREE)
    pose = site(configuration)
    task.set_target(pose.plus(1e-4 * rng.normal(size=6)))
    weight = 10.0 ** rng.uniform(-1.0, 1.0, size=7)
    step = qt.Controller(model, [task], metric=weight, limits=[]).step(configuration, dt=1.0)
    state = task.state(configuration)
    found = closed_form.weighted_least_norm(state.jacobian, state.projector, state.error, weight)
    assert found == pytest.approx(step.velocity, abs=1e-8)


def test_a_heavy_joint_leaves_the_task_to_the_others() -> None:
    rng = np.random.default_rng(1)
    A, b = full_rank(rng, 3, 5), rng.normal(size=3)
    moved = [
        np.abs(closed_form.weighted_least_norm(A, None, b, [1, 1, heavy, 1, 1])[2])
        for heavy in (1e-3, 1.0, 1e3, 1e6, 1e9)
    ]
    assert moved == sorted(moved, reverse=True)
    assert moved[-1] < 1e-7
    # A joint that is needed does its part, whatever it weighs.
    needed = closed_form.weighted_least_norm(np.eye(2), None, [1.0, 2.0], [1.0, 1e9])
    assert needed == pytest.approx([1.0, 2.0])


def test_wrong_input_is_refused() -> None:
    for weight in ([1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [1.0], "heavy"):
        with pytest.raises(qt.InvalidInput, match="weight"):
            closed_form.weighted_least_norm(np.eye(2), None, [1.0, 1.0], weight)
    with pytest.raises(qt.InvalidInput, match="twist"):
        closed_form.weighted_least_norm(np.eye(2), None, np.ones(6), [1.0, 1.0])
    with pytest.raises(qt.InvalidInput, match="jacobian"):
        closed_form.weighted_least_norm(np.eye(2), ROLL_FREE, [1.0, 1.0], [1.0, 1.0])
    body = dataclasses.replace(ROLL_FREE, frame="body")
    with pytest.raises(qt.InvalidInput, match="resolved"):
        closed_form.weighted_least_norm(np.eye(6), body, np.ones(6), np.ones(6))


# ---------------------------------------------------------------- weights


def distance(q: Array, lower: Array, upper: Array) -> float:
    """H, as Chan and Dubey write it."""
    return float(np.sum((upper - lower) ** 2 / (4.0 * (upper - q) * (q - lower))))


@given(SEEDS)
@settings(max_examples=25)
def test_the_gradient_is_that_of_their_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-3.0, 0.0, size=5)
    upper = lower + rng.uniform(0.1, 4.0, size=5)
    q = lower + rng.uniform(0.02, 0.98, size=5) * (upper - lower)
    h = 1e-6 * (upper - lower)
    differences = [
        (distance(q + step, lower, upper) - distance(q - step, lower, upper)) / (2.0 * step[i])
        for i, step in enumerate(np.diag(h))
    ]
    gradient = closed_form.joint_limit_gradient(q, lower, upper)
    assert gradient == pytest.approx(np.array(differences), rel=1e-5, abs=1e-5)
    assert closed_form.joint_limit_weights(q, lower, upper) == pytest.approx(1 + np.abs(gradient))


def test_a_joint_is_slowed_down_on_its_way_to_a_limit_and_free_on_its_way_back() -> None:
    lower, upper = -np.ones(4), np.ones(4)
    before = closed_form.joint_limit_gradient([0.5, 0.5, -0.5, -0.5], lower, upper)
    weights = closed_form.joint_limit_weights([0.6, 0.4, -0.6, -0.4], lower, upper, before)
    assert weights[[1, 3]].tolist() == [1.0, 1.0]
    assert (weights[[0, 2]] > 2.0).all()
    # One that stands still keeps its weight.
    still = closed_form.joint_limit_weights([0.5] * 4, lower, upper, before)
    assert still == pytest.approx(1.0 + np.abs(before))


# ---------------------------------------------------------------- along a path


@pytest.mark.parametrize(("joint", "side", "limit_deg"), [(0, 0, 48.0), (2, 1, 108.0)])
def test_it_turns_away_from_a_limit_that_the_minimum_norm_runs_through(
    joint: int, side: int, limit_deg: float
) -> None:
    task = qt.load_task("planar_line")
    task.model.jnt_range[joint, side] = np.radians(limit_deg)
    found, shortest = (qt.follow(task, name) for name in ("weighted_least_norm", "minimum_norm"))
    assert shortest.margins.min() < -0.1
    assert found.margins.min() > 0.03
    assert found.position_error.max() < 1e-9


def test_the_run_is_met_inside_the_limits(deburring: qt.Comparison) -> None:
    numbers = metrics(deburring.trajectories["weighted_least_norm"])
    assert numbers["status"] == "ok"
    assert numbers["violations"] == 0


def test_wrong_limits_are_refused() -> None:
    for lower, upper in (([1.0], [-1.0]), ([np.nan], [1.0]), ([0.0, 0.0], [1.0]), ("a", [1.0])):
        with pytest.raises(qt.InvalidInput, match="lower"):
            closed_form.joint_limit_weights([0.0], lower, upper)
    with pytest.raises(qt.InvalidInput, match="previous_gradient"):
        closed_form.joint_limit_weights([0.0], [-1.0], [1.0], [1.0, 2.0])

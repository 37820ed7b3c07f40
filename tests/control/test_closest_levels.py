"""Levels that give way inside the kernel, against bounded least squares."""

from __future__ import annotations

import mink
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration
from scipy.optimize import lsq_linear

import qp_twist as qt
from qp_twist.control.lazy_step import LazyStep

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
POINT = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
DT = 0.01


def hurried(seed: int, *frames: tuple[str, str]) -> tuple[list[qt.TwistTask], qt.Step]:
    """A step of an arm whose points, a level each, are asked to be where the limits let none be."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, 7)
    configuration = mink.Configuration(model, random_configuration(model, rng, margin=0.1))
    tasks = [qt.TwistTask(name, kind, POINT) for name, kind in frames]
    for task in tasks:
        task.set_target_from_configuration(configuration)
        assert task.target is not None
        away = mink.SE3.from_translation(10.0 ** rng.uniform(-4.0, -1.5) * rng.normal(size=3))
        task.set_target(away @ task.target)
    controller = qt.Controller(
        model,
        levels=[[task] for task in tasks],
        secondary=[qt.JointCentering(model, "natural", gain=0.1)],
        limits=[qt.MotionLimit(model, velocity=rng.uniform(0.1, 2.0, 7))],
        on_infeasible="relax",
        smooth=False,
    )
    return tasks, controller.step(configuration, DT)


def shortest(A: Array, b: Array, step: qt.Step, held: int = 0) -> float:
    """The least ‖A x − b‖ inside the bounds, from scipy.

    Among those, nearly, that do on the first ``held`` rows what the step does: they weigh 1e7.
    """
    p = step.problem
    rows, sides = 1e7 * p.A[:held], 1e7 * p.A[:held] @ step.velocity
    found = lsq_linear(
        np.vstack([rows, A]), np.concatenate([sides, b]), (p.lower, p.upper), method="bvls",
        tol=1e-14, lsq_solver="exact",
    )  # fmt: skip
    return float(np.linalg.norm(A @ found.x - b))


def excess_cost(step: qt.Step, rows: int) -> float:
    """How much more the step costs than it could, with what it does on the first rows."""
    p = step.problem
    root = np.linalg.cholesky(p.H)
    side = -np.linalg.solve(root, p.c)
    return float(np.linalg.norm(root.T @ step.velocity - side)) - shortest(root.T, side, step, rows)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_one_level_comes_as_close_as_bounded_least_squares(seed: int) -> None:
    _, step = hurried(seed, ("tool", "site"))
    p, x = step.problem, step.velocity
    left, best = float(np.linalg.norm(p.A @ x - p.b)), shortest(p.A, p.b, step)
    assert left <= best + 1e-8 * (1.0 + np.abs(p.b).max())
    assert (p.lower <= x).all() and (x <= p.upper).all()
    assert (step.status is qt.Status.RELAXED) == (best > 1e-7 * (1.0 + np.abs(p.b).max()))
    if step.status is not qt.Status.RELAXED or step.sigma_min < 2e-3:
        return
    assert isinstance(step, LazyStep)
    assert np.allclose(step.residuals[0], p.A @ x - p.b)
    assert step.proven and step.gaps[0] <= 1e-8 and step.binding
    assert excess_cost(step, 3) <= 1e-6


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_a_lower_level_takes_nothing_from_the_one_above(seed: int) -> None:
    _, step = hurried(seed, ("tool", "site"), ("link_5", "body"))
    p, x = step.problem, step.velocity
    above, below = slice(0, 3), slice(3, 6)
    if not isinstance(step, LazyStep):
        return  # singular: the reference's own tests
    unit = 1.0 + float(np.abs(p.b).max())
    left = float(np.linalg.norm(p.A[above] @ x - p.b[above]))
    assert left <= shortest(p.A[above], p.b[above], step) + 1e-8 * unit
    # Of all that do the same there, none comes closer on the second level.
    closest = shortest(p.A[below], p.b[below], step, held=3)
    assert float(np.linalg.norm(p.A[below] @ x - p.b[below])) <= closest + 1e-6 * unit
    assert excess_cost(step, 6) <= 1e-6 * unit


def test_such_steps_are_the_kernels_own() -> None:
    """Otherwise the tests above would compare the reference."""
    taken = dict.fromkeys((qt.Status.RELAXED, qt.Status.PRIORITIZED), 0)
    asked = dict.fromkeys(taken, 0)
    for seed in range(60):
        _, step = hurried(seed, ("tool", "site"), ("link_5", "body"))
        if step.status in taken and step.sigma_min > 2e-3:
            asked[step.status] += 1
            taken[step.status] += isinstance(step, LazyStep)
    assert min(asked.values()) >= 5
    assert all(taken[status] >= 0.8 * asked[status] for status in taken)


@pytest.mark.parametrize("change", ["scale", "raise"])
def test_the_first_level_gives_way_only_where_it_may(change: str) -> None:
    model = random_arm(np.random.default_rng(1), 7)
    configuration = mink.Configuration(model)
    task = qt.TwistTask("tool", "site", POINT)
    task.set_target_from_configuration(configuration)
    assert task.target is not None
    task.set_target(mink.SE3.from_translation(np.array([0.3, 0.2, 0.1])) @ task.target)
    controller = qt.Controller(
        model, [task], limits=[qt.MotionLimit(model, velocity=0.1)], on_infeasible="relax"
    )
    assert controller.step(configuration, DT).status is qt.Status.RELAXED
    controller.on_infeasible = change
    if change == "raise":
        with pytest.raises(qt.InfeasibleStep):
            controller.step(configuration, DT)
    else:
        assert controller.step(configuration, DT).status is qt.Status.SCALED

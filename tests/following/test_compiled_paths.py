"""Kinematics, corrections and runs as machine code: the same as the reference."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration, random_direction
from oracles.rounded_arms import axis_path, vertical_arm

import qp_twist as qt
from qp_twist.kinematics import JointRanges, SerialChain, frame_pose
from qp_twist.planning.bound import centred_nearby
from qp_twist.planning.path_rows import REACHED, PathRows

Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)


# ---------------------------------------------------------------- the parts


@functools.cache
def callable_from_python(kernel: Any) -> Any:
    """A kernel that only kernels call, compiled once more, for a test."""
    from numba.core.caching import NullCache

    from qp_twist.kernel.compiling import entry

    made = entry(kernel.py_func)
    made._cache = NullCache()  # the kernel's own machine code cannot be called from Python
    return made


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_poses_and_jacobians_are_mujocos(seed: int) -> None:
    from qp_twist.kernel.arm_kernel import poses_and_jacobians
    from qp_twist.kinematics.compiled_rows import arm_of

    rng = np.random.default_rng(seed)
    model = random_arm(rng, int(rng.integers(1, 9)), slides=True)
    q = np.array([random_configuration(model, rng) for _ in range(4)])
    poses, jacobians = np.zeros((4, 12)), np.zeros((4, 6, model.nv))
    poses_and_jacobians(arm_of(SerialChain.of(model, "tool", "site")), q, poses, jacobians)
    for here, pose, jacobian in zip(q, poses, jacobians, strict=True):
        configuration = mink.Configuration(model, here)
        rotation, position = frame_pose(configuration, "tool", "site")
        expected = np.zeros((6, model.nv))
        site = model.site("tool").id
        mujoco.mj_jacSite(model, configuration.data, expected[:3], expected[3:], site)
        np.testing.assert_allclose(pose, np.concatenate([rotation.ravel(), position]), atol=1e-12)
        np.testing.assert_allclose(jacobian, expected, atol=1e-12)


@settings(max_examples=80, deadline=None)
@given(SEEDS)
def test_reflections_give_the_null_space(seed: int) -> None:
    from qp_twist.kernel import null_space as kernels

    null_space, reflect = map(callable_from_python, (kernels.null_space, kernels.reflect))

    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    m = int(rng.integers(0, n + 1))
    A = rng.normal(size=(m, n))
    V, R, N = np.zeros((m, n)), np.zeros((m, m)), np.zeros((n - m, n))
    reflect(A, V, R)
    null_space(V, N)
    np.testing.assert_allclose(N @ N.T, np.eye(n - m), atol=1e-12)
    np.testing.assert_allclose(N @ A.T, 0.0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_what_dependent_rows_do_not_see_is_what_their_singular_vectors_do_not(seed: int) -> None:
    from qp_twist.kernel import null_space as kernels

    null_space, row_space = map(callable_from_python, (kernels.null_space, kernels.row_space))

    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    rank = int(rng.integers(0, n + 1))
    count = rank + int(rng.integers(0, 5)) if rank else int(rng.integers(0, 3))
    A = rng.normal(size=(count, rank)) @ rng.normal(size=(rank, n))
    A[rng.random(count) < 0.2] = 0.0
    V = np.full((n, n), np.nan)
    found = row_space(A, V)
    sigma, right = np.linalg.svd(A)[1:] if count else (np.zeros(0), np.eye(n))
    assert found == (sigma > 1e-9).sum()
    N = np.zeros((n - found, n))
    null_space(V[:found], N)
    np.testing.assert_allclose(N @ N.T, np.eye(n - found), atol=1e-12)
    np.testing.assert_allclose(N.T @ N, right[found:].T @ right[found:], atol=1e-7)


# ---------------------------------------------------------------- corrections


def on_path(rng: np.random.Generator) -> qt.PathTask:
    """The deburring run with one of many projectors."""
    path_task = qt.load_task("deburring")
    kinds = ("full", "plane", "line", "none")

    def block() -> qt.Projector:
        kind = kinds[rng.integers(4)]
        axis = () if kind in ("full", "none") else (random_direction(rng),)
        return getattr(qt.Projector, kind)(*axis)

    frame = ("world", "body", "target")[rng.integers(3)]
    projector = qt.TwistProjector(linear=block(), angular=block(), frame=frame)
    return dataclasses.replace(path_task, projector=projector)


def on_rounded_path(rng: np.random.Generator) -> qt.PathTask:
    """Five joints of which a rounded angle leaves the task hardly reachable: errors are least."""
    angle = ("1.5708", "1.571", "1.57")[rng.integers(3)]
    return axis_path(vertical_arm(angle))


@pytest.mark.parametrize("make", [on_path, on_rounded_path])
@settings(max_examples=4, deadline=None)
@given(seed=SEEDS)
def test_corrections_say_whether_they_arrive_and_descents_stay_and_lower_z(
    make: Any, seed: int
) -> None:
    """By the task's own error, with poses of MuJoCo."""
    rng = np.random.default_rng(seed)
    path_task = make(rng)
    task = qt.TwistTask(path_task.frame_name, path_task.frame_type, path_task.projector)
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)

    def reached(q: Array, at: Array) -> Array:
        found = []
        for here, k in zip(q, at, strict=True):
            task.set_target(path_task.waypoints[k])
            error = task.state(mink.Configuration(path_task.model, here)).error
            away = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
            found.append(away[0] <= REACHED.position * 1.001 and away[1] <= REACHED.axis * 1.001)
        return np.array(found)

    q = np.array([random_configuration(path_task.model, rng) for _ in range(12)])
    at = rng.integers(0, len(path_task.waypoints), 12)
    there, arrived = rows.correct(q, at)
    assert arrived.any() and (arrived == reached(there, at)).all()
    low = centred_nearby(there[arrived], at[arrived], rows, ranges)
    finite = np.isfinite(low).all(axis=1)
    assert finite.mean() > 0.7 and reached(low[finite], at[arrived][finite]).all()
    before, after = ranges.centring(there[arrived][finite]), ranges.centring(low[finite])
    assert (after <= before + 1e-9).all()
    assert after.sum() < before.sum() or (rows.freedom == 0).all()


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


def test_most_waypoints_of_a_run_are_compiled() -> None:
    from qp_twist.following import compiled_walk

    path_task = qt.load_task("dome_seams")
    for method in ("rmr", "minimum_norm", "qp_gradient", "qp"):
        settings_ = path_task.settings(method)
        assert compiled_walk.walk_known(path_task, method, settings_)
        walk = compiled_walk.CompiledWalk(path_task, method, settings_)
        start = qt.follow(path_task, method, solver="daqp", stop=lambda *_: True).q[0]
        done, *_ = walk.on_from(start, 1)
        assert len(done) == len(path_task.waypoints) - 1


def test_progress_and_stop_are_called_at_every_waypoint() -> None:
    path_task, seen = qt.load_task("planar_line"), []
    run = qt.follow(
        path_task, "qp_gradient", solver="compiled", progress=seen.append,
        stop=lambda q, apart, turned: len(seen) == 7,
    )  # fmt: skip
    assert seen == [1, 2, 3, 4, 5, 6, 7]
    assert len(run.q) == 8


def test_what_the_kernel_does_not_know_goes_the_old_way() -> None:
    from qp_twist.following.compiled_walk import walk_known

    banded, plain = qt.load_task("deburring_bands"), qt.load_task("deburring")
    for path_task, method in ((banded, "qp"), (plain, "sns"), (plain, "twa"), (plain, "mink")):
        assert not walk_known(path_task, method, path_task.settings(method))
    posture = plain.settings("qp").model_copy(update={"secondary": "manipulability"})
    assert not walk_known(plain, "qp", posture)

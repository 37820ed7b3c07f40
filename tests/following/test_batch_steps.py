"""Single steps of many configurations: the same as one by one."""

from typing import Any

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_configuration

import qp_twist as qt

Array = np.ndarray
DEBURRING = qt.load_task("deburring")
MODEL = DEBURRING.model


def controller(rng: np.random.Generator, **options: Any) -> qt.Controller:
    task = qt.TwistTask("tool", "site", DEBURRING.projector, gain=float(rng.uniform(0.2, 1.0)))
    task.set_target(DEBURRING.waypoints[0])
    return by_reference(
        qt.Controller(
            MODEL, [task], secondary=[qt.JointCentering(MODEL, gain=0.2)],
            limits=[qt.MotionLimit(MODEL, velocity=0.5)], solver="daqp", **options,
        )
    )  # fmt: skip


def by_reference(composed: qt.Controller) -> qt.Controller:
    """Whose single steps are not the kernel's: what it is held against."""
    composed._prepared = None
    return composed


def rows(rng: np.random.Generator, count: int) -> tuple[Array, list[mink.SE3]]:
    """Configurations, and targets near them."""
    q = np.array([random_configuration(MODEL, rng) for _ in range(count)])
    targets = []
    for here in q:
        pose = mink.Configuration(MODEL, here).get_transform_frame_to_world("tool", "site")
        targets.append(pose @ mink.SE3.exp(0.02 * rng.normal(size=6)))
    return q, targets


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["joint", "twist"]))
def test_many_steps_are_the_steps_one_by_one(seed: int, space: Any) -> None:
    rng = np.random.default_rng(seed)
    composed = controller(rng, secondary_space=space)
    q, targets = rows(rng, 6)
    done = qt.batch.step(composed, q, 0.05, targets, threads=1)
    assert done.failures == {}
    task = composed.twist_tasks[0]
    for k in range(len(q)):
        task.set_target(targets[k])
        composed.limits[0].velocity = np.zeros(6)  # type: ignore[attr-defined]
        expected = composed.step(mink.Configuration(MODEL, q[k]), 0.05)
        size = 1.0 + np.abs(expected.velocity).max()
        np.testing.assert_allclose(done.velocity[k], expected.velocity, atol=1e-9 * size)
        assert done.scale[k] == pytest.approx(expected.scale, abs=1e-7)
        assert not done.by_reference[k] or expected.status is qt.Status.RELAXED


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 10.0]), st.sampled_from([0.0, 0.5]))
def test_each_row_has_its_own_state_before(
    seed: int, acceleration: float | None, away: float
) -> None:
    """Its velocity, in the kernel and where the reference computes it."""
    rng = np.random.default_rng(seed)
    q, targets = rows(rng, 6)
    targets = [mink.SE3.from_translation(away * rng.normal(size=3)) @ target for target in targets]
    before = rng.normal(size=(6, MODEL.nv))
    task = qt.TwistTask.axis_free("tool", "site")
    limit = qt.MotionLimit(MODEL, velocity=3.0, acceleration=acceleration)
    composed = qt.Controller(MODEL, [task], limits=[limit])
    done = qt.batch.step(composed, q, 0.05, targets, velocity=before, threads=1)
    np.testing.assert_array_equal(limit.velocity, 0.0)
    for k in range(len(q)):
        task.set_target(targets[k])
        expected = composed.step(mink.Configuration(MODEL, q[k]), 0.05, velocity=before[k])
        np.testing.assert_allclose(done.velocity[k], expected.velocity, atol=1e-8)


def test_threads_and_the_form_of_targets_make_no_difference_and_nothing_is_changed() -> None:
    rng = np.random.default_rng(3)
    composed = controller(rng, on_infeasible="relax")
    q, targets = rows(rng, 50)
    before, velocity = composed.twist_tasks[0].target, composed.limits[0].velocity  # type: ignore[attr-defined]
    one = qt.batch.step(composed, q, 0.05, targets, threads=1)
    two = qt.batch.step(composed, q, 0.05, np.array([t.as_matrix() for t in targets]), threads=2)
    np.testing.assert_array_equal(one.velocity, two.velocity)
    assert not one.by_reference.any()
    assert composed.twist_tasks[0].target.wxyz_xyz == pytest.approx(before.wxyz_xyz)  # type: ignore[union-attr]
    np.testing.assert_array_equal(composed.limits[0].velocity, velocity)  # type: ignore[attr-defined]


@pytest.mark.parametrize("strict", [False, True])
def test_two_tasks_have_targets_of_their_own(strict: bool) -> None:
    rng = np.random.default_rng(5)
    tool = qt.TwistTask.point("tool", "site")
    elbow = qt.TwistTask("link_3", "body", qt.TwistProjector(
        linear=qt.Projector.line([0.0, 0.0, 1.0]), angular=qt.Projector.none()))  # fmt: skip
    given: dict[str, Any] = {"tasks": [tool, elbow]}
    if strict:
        given = {"levels": [[tool], [elbow]]}
    composed = by_reference(qt.Controller(MODEL, **given, limits=[], solver="daqp"))
    q, _ = rows(rng, 8)
    targets: list[list[mink.SE3]] = [[], []]
    for here in q:
        configuration = mink.Configuration(MODEL, here)
        for poses, frame in zip(targets, (("tool", "site"), ("link_3", "body")), strict=True):
            pose = configuration.get_transform_frame_to_world(*frame)
            poses.append(pose @ mink.SE3.exp(0.01 * rng.normal(size=6)))
    done = qt.batch.step(composed, q, 0.1, targets)
    for k in range(len(q)):
        tool.set_target(targets[0][k])
        elbow.set_target(targets[1][k])
        expected = composed.step(mink.Configuration(MODEL, q[k]), 0.1).velocity
        np.testing.assert_allclose(done.velocity[k], expected, atol=1e-8)


def test_a_row_that_fails_stops_no_other() -> None:
    rng = np.random.default_rng(7)
    composed = controller(rng, on_infeasible="raise")
    q, targets = rows(rng, 5)
    far = mink.SE3.from_translation(np.array([0.0, 0.0, 9.0])) @ targets[2]
    done = qt.batch.step(composed, q, 0.5, [*targets[:2], far, *targets[3:]])
    assert 2 in done.failures and "infeasible" in done.failures[2]
    assert np.isnan(done.velocity[2]).all()
    others = [k for k in range(5) if k not in done.failures]
    assert others and np.isfinite(done.velocity[others]).all()


def test_what_has_no_compiled_form_is_refused_with_a_sentence() -> None:
    rng = np.random.default_rng(0)
    composed = controller(rng)
    q, targets = rows(rng, 3)
    with pytest.raises(qt.InvalidInput, match="no compiled form"):
        posture = mink.PostureTask(MODEL, cost=1.0)
        qt.batch.step(qt.Controller(MODEL, [*composed.tasks, posture]), q, 0.1, targets)
    with pytest.raises(qt.InvalidInput, match="expected one for each of 3 rows, got 2"):
        qt.batch.step(composed, q, 0.1, targets[:2])
    with pytest.raises(qt.InvalidInput, match="number 1 is no rigid motion"):
        wrong = np.array([t.as_matrix() for t in targets])
        wrong[1, 0] *= 2.0
        qt.batch.step(composed, q, 0.1, wrong)
    for huge in (1e155, 1e200, np.nan):
        with pytest.raises(qt.InvalidInput, match=r"no rigid motion|finite"):
            qt.batch.step(composed, q, 0.1, huge * np.array([t.as_matrix() for t in targets]))
    with pytest.raises(qt.InvalidInput, match="expected a sequence of"):
        qt.batch.step(composed, q, 0.1, targets[0])  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="threads"):
        qt.batch.step(composed, q, 0.1, targets, threads=1.5)  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="dt"):
        qt.batch.step(composed, q, 0.0, targets)
    with pytest.raises(mink.TargetNotSet):
        qt.batch.step(qt.Controller(MODEL, [qt.TwistTask.point("tool", "site")]), q, 0.1)


def test_what_is_not_plain_is_left_out_where_that_is_asked_for() -> None:
    rng = np.random.default_rng(3)
    composed = controller(rng)
    q, targets = rows(rng, 50)
    whole = qt.batch.step(composed, q, 0.05, targets)
    plain = qt.batch.step(composed, q, 0.05, targets, others=False)
    np.testing.assert_array_equal(plain.by_reference, whole.by_reference)
    assert np.isnan(plain.velocity[plain.by_reference]).all()
    np.testing.assert_array_equal(
        plain.velocity[~plain.by_reference], whole.velocity[~plain.by_reference]
    )

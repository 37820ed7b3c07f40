"""Prepared steps with inequality rows, levels and costs of other tasks: the reference's."""

from __future__ import annotations

import pickle
from typing import Any

import liars
import mink
import numpy as np
import pytest
import qpsolvers
from arms import random_arm, random_configuration, random_direction
from hypothesis import given, settings
from hypothesis import strategies as st
from test_plain_step import SOLVERS, by_reference, projector, same

import qp_twist as qt
from qp_twist.controller.plain_step import PlainStep

Array = np.ndarray


class HalfSpaces(mink.Limit):
    """G q̇ ≤ g, the same everywhere."""

    def __init__(self, G: Array, g: Array) -> None:
        self.G, self.g = G, g

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=self.g * dt)


def half_spaces(rng: np.random.Generator, nv: int) -> HalfSpaces:
    """Rows of all kinds: full, of one entry, empty, and some that say nothing."""
    k = int(rng.integers(1, 6))
    G = rng.normal(size=(k, nv)) * (rng.random((k, nv)) < rng.choice([0.2, 0.7, 1.0]))
    g = rng.uniform(0.0, 0.3, k)
    g[rng.random(k) < 0.2] = np.inf
    return HalfSpaces(G, g)


def controllers(seed: int, solver: str) -> tuple[list[qt.Controller], mink.Configuration]:
    """The same controller by the reference and prepared: rows, levels, costs, in all mixtures."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, int(rng.integers(4, 10)), slides=bool(rng.random() < 0.3), limited=True)
    nv, q = model.nv, random_configuration(model, rng)
    configuration = mink.Configuration(model, q)
    state = rng.bit_generator.state
    found = []
    for name in ("daqp", solver):
        rng.bit_generator.state = state
        tasks = [qt.TwistTask("tool", "site", projector(rng))]
        if rng.random() < 0.5:
            tasks.append(qt.TwistTask("link_2", "body", projector(rng)))
        for task in tasks:
            pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
            away = 10.0 ** rng.uniform(-4.0, -1.5) * rng.normal(size=6)
            task.set_target(pose.multiply(mink.SE3.exp(away)))
        band = qt.SlabBand(random_direction(rng), -rng.uniform(0, 0.02), rng.uniform(0, 0.02))
        if rng.random() < 0.5 and band.contradiction(tasks[0].projector) is None:
            tasks[0].bands = [band]
        limits: list[mink.Limit] = [qt.PositionLimit(model)] if rng.random() < 0.5 else []
        if rng.random() < 0.4:
            limits.append(mink.ConfigurationLimit(model))
        if rng.random() < 0.4:
            names = [model.joint(i).name for i in range(model.njnt)]
            speeds = {joint: float(rng.uniform(0.1, 1.0)) for joint in names}
            limits.append(mink.VelocityLimit(model, speeds))
        if rng.random() < 0.8:
            limits.append(half_spaces(rng, nv))
        others: list[Any] = []
        if rng.random() < 0.4:
            others.append(mink.PostureTask(model, cost=rng.uniform(0.1, 2.0)))
            others[-1].set_target(q + 0.05 * rng.normal(size=len(q)))
        if rng.random() < 0.2:
            others.append(mink.DampingTask(model, cost=0.5))
        strict = len(tasks) > 1 and rng.random() < 0.6
        found.append(
            qt.Controller(
                model,
                others if strict else [*tasks, *others],
                levels=[[task] for task in tasks] if strict else None,
                limits=limits,
                secondary=[qt.JointCentering(model, gain=0.3)][: rng.integers(2)],
                secondary_space=("joint", "twist")[rng.integers(2)],
                metric=rng.uniform(0.3, 3.0, nv),
                solver=name,
            )
        )
    by_reference(found[0])
    return found, configuration


@pytest.mark.parametrize("solver", SOLVERS)
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_with_rows_levels_and_costs_it_is_the_reference_step(solver: str, seed: int) -> None:
    (reference, prepared), configuration = controllers(seed, solver)
    try:
        expected = reference.step(configuration, 0.05)
    except qt.QpTwistError as error:
        with pytest.raises(type(error)):
            prepared.step(configuration, 0.05)
        return
    step = prepared.step(configuration, 0.05)
    size = 1.0 + np.abs(expected.velocity).max()
    np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-8 * size)
    assert step.status is expected.status
    if isinstance(step, PlainStep) and not expected.binding:
        same(expected, step)


@pytest.mark.parametrize("solver", SOLVERS)
def test_most_of_these_steps_are_plain_and_rows_bind_in_some(solver: str) -> None:
    plain = pushed = 0
    for seed in range(80):
        (reference, prepared), configuration = controllers(seed, solver)
        expected, step = (c.step(configuration, 0.05) for c in (reference, prepared))
        atol = (1e-8 if solver in SOLVERS else 1e-5) * (1.0 + np.abs(expected.velocity).max())
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=atol)
        if not isinstance(step, PlainStep):
            continue
        plain += 1
        pushed += any(limit.kind in ("band", "HalfSpaces") for limit in step.binding)
        if solver in SOLVERS:
            assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
            for mine, theirs in zip(step.binding, expected.binding, strict=True):
                assert mine.multiplier == pytest.approx(theirs.multiplier, rel=1e-4, abs=1e-6)
    assert plain > 30 and pushed > 10


# ---------------------------------------------------------------- what changes under way


PATH = qt.load_task("deburring")
MODEL = PATH.model


def at_start() -> mink.Configuration:
    return mink.Configuration(MODEL, PATH.start)


def deburring(
    solver: str, *limits: mink.Limit, **task: Any
) -> tuple[qt.Controller, mink.Configuration]:
    tool = qt.TwistTask("tool", "site", PATH.projector, **task)
    tool.set_target(PATH.waypoints[1])
    controller = qt.Controller(
        MODEL, [tool], secondary=[qt.JointCentering(MODEL)], limits=limits, solver=solver
    )
    return controller, at_start()


def self_motion(step: qt.Step) -> Array:
    """The direction that the rows of the task leave free."""
    direction: Array = np.linalg.svd(step.problem.A)[2][-1]
    return direction


@pytest.mark.parametrize("solver", SOLVERS)
def test_rows_may_come_and_go_from_step_to_step(solver: str) -> None:
    rows = HalfSpaces(np.zeros((0, 6)), np.zeros(0))
    controller, configuration = deburring(solver, rows)
    before = controller.step(configuration, 0.1)
    free, way = before.velocity.copy(), self_motion(before)
    rng = np.random.default_rng(5)
    for k in (1, 4, 2, 17, 0, 3):
        rows.G = rng.normal(size=(k, 6))
        rows.G[:1] = way
        rows.g = rows.G @ free + 0.5
        rows.g[:1] -= 0.51  # one is in the way
        step = controller.step(configuration, 0.1)
        fresh = deburring("daqp", rows)[0]
        expected = by_reference(fresh).step(configuration, 0.1)
        assert isinstance(step, PlainStep) and len(step.problem.g) == k
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-6)
        assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
        assert (np.abs(step.velocity - free).max() > 1e-4) == (k > 0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_bands_may_be_given_and_taken_away_and_made_soft(solver: str) -> None:
    controller, configuration = deburring(solver)
    task = controller.twist_tasks[0]
    free = controller.step(configuration, 0.1)
    band = qt.RollBand((0.0, 0.0, 1.0), 0.1, 0.3)
    task.bands = [band]
    held = controller.step(configuration, 0.1)
    expected = by_reference(deburring("daqp", bands=[band])[0]).step(configuration, 0.1)
    assert isinstance(held, PlainStep)
    np.testing.assert_allclose(held.velocity, expected.velocity, atol=1e-8)
    assert [x.kind for x in held.binding] == ["band"] == [x.kind for x in expected.binding]
    task.bands = [qt.RollBand((0.0, 0.0, 1.0), 0.1, 0.3, weight=1.0)]
    assert not isinstance(controller.step(configuration, 0.1), PlainStep)
    task.bands = []
    again = controller.step(configuration, 0.1)
    assert isinstance(again, PlainStep) and again.problem.G.shape == (0, 6)
    np.testing.assert_allclose(again.velocity, free.velocity, atol=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_step_knows_the_names_of_its_rows_later_and_as_a_copy(solver: str) -> None:
    controller, configuration = deburring(solver)
    free = controller.step(configuration, 0.1)
    way = self_motion(free)
    rows = HalfSpaces(np.array([-way, way]), np.array([10.0, way @ free.velocity - 0.01]))
    wide = qt.RollBand((0.0, 0.0, 1.0), -2.0, 2.0)
    controller, configuration = deburring(solver, rows, bands=[wide])
    step = controller.step(configuration, 0.1)
    assert isinstance(step, PlainStep)
    copied = pickle.loads(pickle.dumps(step))
    rows.G, rows.g = np.zeros((0, 6)), np.zeros(0)
    controller.twist_tasks[0].bands = []
    controller.step(configuration, 0.1)
    for kept in (step, copied):
        assert [limit.joint for limit in kept.binding] == ["HalfSpaces row 1"]
        same(step, kept)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("G", [np.full((1, 6), np.nan), np.zeros((1, 5)), np.full((1, 6), 1e15)])
def test_rows_that_are_none_are_refused_with_a_sentence(solver: str, G: Array) -> None:
    rows = HalfSpaces(np.zeros((0, 6)), np.zeros(0))
    controller, configuration = deburring(solver, rows)
    before = controller.step(configuration, 0.1)
    rows.G, rows.g = G, np.ones(1)
    with pytest.raises(qt.InvalidInput, match="HalfSpaces: G"):
        controller.step(configuration, 0.1)
    rows.G, rows.g = np.ones((1, 6)), np.full(1, np.nan)
    with pytest.raises(qt.InvalidInput, match="HalfSpaces: its rows"):
        controller.step(configuration, 0.1)
    rows.g = np.ones((1, 1))
    with pytest.raises(qt.InvalidInput, match="HalfSpaces: its rows"):
        controller.step(configuration, 0.1)
    rows.G, rows.g = np.zeros((0, 6)), np.zeros(0)
    np.testing.assert_allclose(controller.step(configuration, 0.1).velocity, before.velocity)


def test_no_backend_is_believed_when_it_leaves_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one before the row was there: right in all but the row."""
    truth = qpsolvers.solve_problem
    controller, configuration = deburring("daqp")
    free = controller.step(configuration, 0.1).velocity.copy()
    way = self_motion(controller.step(configuration, 0.1))
    rows = HalfSpaces(way[None], np.array([way @ free - 0.01]))
    expected = by_reference(deburring("daqp", rows)[0]).step(configuration, 0.1)

    def says(problem: qpsolvers.Problem, solver: str, **options: Any) -> Any:
        if solver != "daqp":
            return truth(problem, solver=solver, **options)
        solution = truth(
            qpsolvers.Problem(
                problem.P, problem.q, None, None, problem.A, problem.b, problem.lb, problem.ub
            ),
            solver=solver,
            **options,
        )
        solution.z = np.zeros(0 if problem.G is None else len(problem.G))
        return solution

    liars.install(monkeypatch, says)
    step = deburring("daqp", rows)[0].step(configuration, 0.1)
    assert not isinstance(step, PlainStep)
    np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-6)


# ---------------------------------------------------------------- levels


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_level_that_needs_a_direction_of_the_one_above_is_left_to_the_reference(
    solver: str,
) -> None:
    """The rows of both together are regular enough; what is left of the second alone is not."""
    configuration = at_start()
    point = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
    found = []
    for name in ("daqp", solver):
        first, second = (qt.TwistTask("tool", "site", point) for _ in range(2))
        for task, waypoint in ((first, 1), (second, 3)):
            task.set_target(PATH.waypoints[waypoint])
        found.append(qt.Controller(MODEL, levels=[[first], [second]], solver=name))
    by_reference(found[0])
    expected, step = (controller.step(configuration, 0.1) for controller in found)
    assert step.status is expected.status is qt.Status.PRIORITIZED
    np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-9)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_smallest_singular_value_is_of_the_first_level(solver: str) -> None:
    configuration = at_start()
    none = qt.Projector.none()
    point = qt.TwistProjector(linear=qt.Projector.full(), angular=none)
    axis = qt.TwistProjector(linear=none, angular=qt.Projector.plane((0.0, 0.0, 1.0)))
    tasks = [qt.TwistTask("tool", "site", part) for part in (point, axis)]
    for task in tasks:
        task.set_target(PATH.waypoints[1])
    step = qt.Controller(MODEL, levels=[tasks[:1], tasks[1:]], solver=solver).step(
        configuration, 0.1
    )
    assert isinstance(step, PlainStep)
    rows = tasks[0].velocity_rows(configuration, 0.1)[0]
    assert step.sigma_min == pytest.approx(np.linalg.svd(rows, compute_uv=False)[-1])
    assert [len(part) for part in step.residuals] == [3, 2]
    together = qt.Controller(MODEL, tasks, solver="quadprog").step(configuration, 0.1)
    np.testing.assert_allclose(step.velocity, together.velocity, atol=1e-8)


# ---------------------------------------------------------------- costs of other tasks


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_posture_task_that_is_moved_under_way_counts(solver: str) -> None:
    configuration = at_start()
    tool = qt.TwistTask("tool", "site", PATH.projector)
    tool.set_target(PATH.waypoints[1])
    posture = mink.PostureTask(MODEL, cost=1.0)
    controller = qt.Controller(MODEL, [tool, posture], solver=solver)
    with pytest.raises(mink.TargetNotSet):
        controller.step(configuration, 0.1)
    for shift in (0.0, 0.2):
        posture.set_target(PATH.start + shift)
        step = controller.step(configuration, 0.1)
        assert isinstance(step, PlainStep)
        theirs = mink.solve_ik(
            configuration, [posture], 0.1, "daqp", damping=1e-9, constraints=[tool]
        )
        np.testing.assert_allclose(step.velocity, theirs, atol=1e-5)


def test_limits_of_mink_on_single_joints_are_read_once_and_seen_when_they_change() -> None:
    """They are not asked at every step; what is written into them counts all the same."""
    speeds = {MODEL.joint(i).name: 0.5 for i in range(MODEL.njnt)}
    ranges, velocity = mink.ConfigurationLimit(MODEL, gain=0.5), mink.VelocityLimit(MODEL, speeds)

    def refused(*_: Any) -> mink.Constraint:
        raise AssertionError("a limit on single joints was asked for its rows")

    changes = (
        lambda: None,
        lambda: setattr(velocity, "limit", np.full(MODEL.nv, 0.2)),
        lambda: ranges.upper.__setitem__(slice(None), PATH.start + 0.03),
        lambda: setattr(ranges, "gain", 0.4),
    )
    compiled, configuration = deburring("compiled", ranges, velocity)
    reference = by_reference(deburring("daqp", ranges, velocity)[0])
    found: list[Array] = []
    for change in changes:
        change()
        expected = reference.step(configuration, 0.1)
        with pytest.MonkeyPatch.context() as patch:
            for kind in (mink.ConfigurationLimit, mink.VelocityLimit):
                patch.setattr(kind, "compute_qp_inequalities", refused)
            step = compiled.step(configuration, 0.1)
        assert isinstance(step, PlainStep)
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-9)
        assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
        assert not any(np.allclose(step.velocity, other, atol=1e-3) for other in found)
        found.append(step.velocity)

"""Prepared steps with inequality rows, levels and costs of other tasks: the reference's."""

from __future__ import annotations

import pickle
from typing import Any

import mink
import numpy as np
import pytest
import qpsolvers
from oracles import liars
from oracles.same_steps import by_reference, same

import qp_twist as qt
from qp_twist.control.lazy_step import LazyStep

Array = np.ndarray


class HalfSpaces(mink.Limit):
    """G q̇ ≤ g, the same everywhere."""

    def __init__(self, G: Array, g: Array) -> None:
        self.G, self.g = G, g

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=self.g * dt)


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


def test_rows_may_come_and_go_from_step_to_step() -> None:
    rows = HalfSpaces(np.zeros((0, 6)), np.zeros(0))
    controller, configuration = deburring("compiled", rows)
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
        assert isinstance(step, LazyStep) and len(step.problem.g) == k
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-6)
        assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
        assert (np.abs(step.velocity - free).max() > 1e-4) == (k > 0)


def test_bands_may_be_given_and_taken_away_and_made_soft() -> None:
    controller, configuration = deburring("compiled")
    task = controller.twist_tasks[0]
    free = controller.step(configuration, 0.1)
    band = qt.RollBand((0.0, 0.0, 1.0), 0.1, 0.3)
    task.bands = [band]
    held = controller.step(configuration, 0.1)
    expected = by_reference(deburring("daqp", bands=[band])[0]).step(configuration, 0.1)
    assert isinstance(held, LazyStep)
    np.testing.assert_allclose(held.velocity, expected.velocity, atol=1e-8)
    assert [x.kind for x in held.binding] == ["band"] == [x.kind for x in expected.binding]
    soft = qt.RollBand((0.0, 0.0, 1.0), 0.1, 0.3, weight=1.0)
    task.bands = [soft]
    left = controller.step(configuration, 0.1)
    expected = by_reference(deburring("daqp", bands=[soft])[0]).step(configuration, 0.1)
    assert isinstance(left, LazyStep) and left.velocity.shape == (6,)
    np.testing.assert_allclose(left.velocity, expected.velocity, atol=1e-8)
    assert np.abs(left.velocity - held.velocity).max() > 1e-3  # it is left, for a price
    assert [str(x) for x in left.binding] == [str(x) for x in expected.binding]
    task.bands = []
    again = controller.step(configuration, 0.1)
    assert isinstance(again, LazyStep) and again.problem.G.shape == (0, 6)
    np.testing.assert_allclose(again.velocity, free.velocity, atol=1e-12)


def test_a_step_knows_the_names_of_its_rows_later_and_as_a_copy() -> None:
    controller, configuration = deburring("compiled")
    free = controller.step(configuration, 0.1)
    way = self_motion(free)
    rows = HalfSpaces(np.array([-way, way]), np.array([10.0, way @ free.velocity - 0.01]))
    wide = qt.RollBand((0.0, 0.0, 1.0), -2.0, 2.0)
    controller, configuration = deburring("compiled", rows, bands=[wide])
    step = controller.step(configuration, 0.1)
    assert isinstance(step, LazyStep)
    copied = pickle.loads(pickle.dumps(step))
    rows.G, rows.g = np.zeros((0, 6)), np.zeros(0)
    controller.twist_tasks[0].bands = []
    controller.step(configuration, 0.1)
    for kept in (step, copied):
        assert [limit.joint for limit in kept.binding] == ["HalfSpaces row 1"]
        same(step, kept)


@pytest.mark.parametrize("G", [np.full((1, 6), np.nan), np.zeros((1, 5)), np.full((1, 6), 1e15)])
def test_rows_that_are_none_are_refused_with_a_sentence(G: Array) -> None:
    rows = HalfSpaces(np.zeros((0, 6)), np.zeros(0))
    controller, configuration = deburring("compiled", rows)
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
    assert not isinstance(step, LazyStep)
    np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-6)


# ---------------------------------------------------------------- levels


def test_a_level_that_needs_a_direction_of_the_one_above_is_left_to_the_reference() -> None:
    """The rows of both together are regular enough; what is left of the second alone is not."""
    configuration = at_start()
    point = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
    found = []
    for name in ("daqp", "compiled"):
        first, second = (qt.TwistTask("tool", "site", point) for _ in range(2))
        for task, waypoint in ((first, 1), (second, 3)):
            task.set_target(PATH.waypoints[waypoint])
        found.append(qt.Controller(MODEL, levels=[[first], [second]], solver=name))
    by_reference(found[0])
    expected, step = (controller.step(configuration, 0.1) for controller in found)
    assert step.status is expected.status is qt.Status.PRIORITIZED
    np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-9)


def test_the_smallest_singular_value_is_of_the_first_level() -> None:
    configuration = at_start()
    none = qt.Projector.none()
    point = qt.TwistProjector(linear=qt.Projector.full(), angular=none)
    axis = qt.TwistProjector(linear=none, angular=qt.Projector.plane((0.0, 0.0, 1.0)))
    tasks = [qt.TwistTask("tool", "site", part) for part in (point, axis)]
    for task in tasks:
        task.set_target(PATH.waypoints[1])
    step = qt.Controller(MODEL, levels=[tasks[:1], tasks[1:]], solver="compiled").step(
        configuration, 0.1
    )
    assert isinstance(step, LazyStep)
    rows = tasks[0].velocity_rows(configuration, 0.1)[0]
    assert step.sigma_min == pytest.approx(np.linalg.svd(rows, compute_uv=False)[-1])
    assert [len(part) for part in step.residuals] == [3, 2]
    together = qt.Controller(MODEL, tasks, solver="quadprog").step(configuration, 0.1)
    np.testing.assert_allclose(step.velocity, together.velocity, atol=1e-8)


# ---------------------------------------------------------------- costs of other tasks


def test_a_posture_task_that_is_moved_under_way_counts() -> None:
    configuration = at_start()
    tool = qt.TwistTask("tool", "site", PATH.projector)
    tool.set_target(PATH.waypoints[1])
    posture = mink.PostureTask(MODEL, cost=1.0)
    controller = qt.Controller(MODEL, [tool, posture], solver="compiled")
    with pytest.raises(mink.TargetNotSet):
        controller.step(configuration, 0.1)
    for shift in (0.0, 0.2):
        posture.set_target(PATH.start + shift)
        step = controller.step(configuration, 0.1)
        assert isinstance(step, LazyStep)
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
        assert isinstance(step, LazyStep)
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-9)
        assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
        assert not any(np.allclose(step.velocity, other, atol=1e-3) for other in found)
        found.append(step.velocity)

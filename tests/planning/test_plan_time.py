"""Plans in time: least times of a joint path, the fastest path, and paths slower than the feed."""

from __future__ import annotations

import dataclasses
import re

import mink
import numpy as np
import pytest
from scipy.optimize import minimize

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.planning.objective import Objective
from qp_twist.planning.pace import Pace, PacedStretch, slowest
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import Problem, motion_limits
from qp_twist.planning.search import PlanSearch, SearchResult
from qp_twist.planning.smooth import refine

SPEED, ACCELERATION = np.array([1.0, 1.5, 2.0]), np.array([4.0, 6.0, 8.0])


def line(count: int, feed: float | None = None) -> qt.PathTask:
    """The planar line at some waypoints, with limits; ``feed``: seconds between two of them."""
    task = qt.load_task("planar_line")
    some = np.linspace(0, 100, count).astype(int)
    return dataclasses.replace(
        task, waypoints=tuple(task.waypoints[i] for i in some), velocity_limits=SPEED,
        acceleration_limits=ACCELERATION,
        durations=None if feed is None else np.append(0.0, np.full(count - 1, feed)),
    )  # fmt: skip


def changes(q: Array, times: Array, room: Array) -> Array:
    """Shares of the acceleration limits at rests and inner rows, by the definition, (N, nv)."""
    v, most = np.diff(q, axis=0) / times[:, None], ACCELERATION
    harmonic = 2.0 * times[:-1] * times[1:] / (times[:-1] + times[1:]) * room[1:]
    inner = np.abs(np.diff(v, axis=0)) / (harmonic[:, None] * most)
    ends = np.abs(v[[0, -1]]) / (0.5 * times[[0, -1], None] * most)
    return np.vstack([inner, ends])


def random_path(seed: int, steps: int) -> tuple[Array, Array, Array, Array]:
    """A joint path with so many steps, their rooms, their times and the least ones by speeds."""
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.normal(scale=0.1, size=(steps + 1, 3)), axis=0)
    feed, room = rng.uniform(0.0, 0.15, steps), np.where(rng.random(steps) < 0.3, 0.4, 1.0)
    times = Pace(feed, SPEED, ACCELERATION, room, rests=True).seconds(q)
    floor = np.maximum(feed, (np.abs(np.diff(q, axis=0)) / SPEED).max(axis=1))
    return q, room, times, floor


@pytest.mark.parametrize("seed", range(4))
def test_times_keep_all_limits_and_are_as_short_as_a_general_optimisers(seed: int) -> None:
    q, room, times, floor = random_path(seed, 6)
    assert (times >= floor - 1e-12).all()
    assert changes(q, times, room).max() <= 1.0 + 1e-6
    best = min(
        (
            minimize(
                np.sum, start, bounds=[(low, None) for low in floor], method="SLSQP",
                constraints={"type": "ineq", "fun": lambda t: 1.0 - changes(q, t, room).ravel()},
                options={"maxiter": 500},
            )
            for start in (times, 2.0 * times, np.full(6, 1.5))
        ),
        key=lambda found: float(found.fun) if found.success else np.inf,
    )  # fmt: skip
    assert best.success
    assert times.sum() <= 1.01 * best.fun


@pytest.mark.parametrize("seed", range(4))
def test_no_step_of_a_long_path_could_be_shorter_by_itself(seed: int) -> None:
    q, room, times, floor = random_path(seed, 59)
    assert changes(q, times, room).max() <= 1.0 + 1e-6
    for k in np.flatnonzero(times > 1.001 * floor):
        shorter = times.copy()
        shorter[k] *= 1.0 - 1e-3
        assert changes(q, shorter, room).max() > 1.0 + 1e-6


def test_waypoints_that_take_no_time_change_nothing() -> None:
    q = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.1], [0.2, 0.3, 0.3]])
    pace = Pace(np.zeros(2), SPEED, ACCELERATION, np.ones(2), rests=True)
    twice = Pace(np.zeros(3), SPEED, ACCELERATION, np.ones(3), rests=True)
    again = twice.seconds(q[[0, 1, 1, 2]])
    assert again == pytest.approx(np.insert(pace.seconds(q), 1, 0.0))


@pytest.mark.parametrize("feed", [None, 0.05, 0.4])
def test_the_fastest_path_nearby_is_as_fast_as_a_general_optimisers(feed: float | None) -> None:
    """SLSQP with all joints and all times as unknowns, the task as equality constraints."""
    task = line(6, feed)
    rows, ranges = PathRows(task), qt.JointRanges.of(task.model)
    goal = Objective.of(ranges, "time").along(task)
    start, _ = rows.correct(np.tile(task.start, (6, 1)), np.arange(6))
    limits = motion_limits(task, ranges, 40.0, rows.hard, slow_down=True)
    mine = refine(Problem(task, rows, limits, goal), start)
    positions, floor = task.positions[:, :2], 1e-3 if feed is None else feed
    assert goal.pace is not None
    room = goal.pace.room

    def tips(x: Array) -> Array:
        angles, lengths = np.cumsum(x[:18].reshape(6, 3), axis=1), np.array([2.0, 1.5, 1.0])
        reached = np.stack([np.cos(angles) @ lengths, np.sin(angles) @ lengths], axis=1)
        return np.asarray((reached - positions).ravel())

    def left(x: Array) -> Array:
        q, t = x[:18].reshape(6, 3), x[18:]
        speeds = SPEED * t[:, None] - np.abs(np.diff(q, axis=0))
        return np.concatenate([speeds.ravel(), 1.0 - changes(q, t, room).ravel()])

    bounds = [*zip(np.tile(ranges.lower, 6), np.tile(ranges.upper, 6), strict=True)]
    found = minimize(
        lambda x: x[18:].sum(), np.append(start, 1.5 * goal.pace.seconds(start)),
        bounds=bounds + 5 * [(floor, None)], method="SLSQP",
        constraints=[{"type": "eq", "fun": tips}, {"type": "ineq", "fun": left}],
        options={"maxiter": 500, "ftol": 1e-9},
    )  # fmt: skip
    assert found.success
    assert mine.feasible and mine.value <= 1.01 * found.fun


def test_a_plan_in_time_is_on_the_path_inside_its_limits_and_above_its_bound() -> None:
    task = line(26)
    plan, central = qt.plan(task, "time"), qt.plan(task)
    times = plan.durations
    assert times is not None and plan.value == pytest.approx(times.sum())
    assert plan.bound <= plan.value <= Pace.of_run(task).seconds(central.motion()).sum()
    assert (np.abs(np.diff(plan.motion(), axis=0)) <= SPEED * times[:, None] + 1e-12).all()
    assert changes(plan.motion(), times, Pace.of_run(task).room).max() <= 1.0 + 1e-6
    names = [finding.name for finding in plan.examined() if not finding.passes]
    assert not [name for name in names if "limit" in name or "at waypoints" in name]
    assert plan.result.startswith(f"time: {plan.value:.4g} s >= bound")


def test_a_clearance_that_the_fastest_motion_keeps_anyway_changes_nothing() -> None:
    """The times of a grid's path are not those of a motion: no finer grid is searched for them."""
    task = qt.load_task("deburring_cell")
    cell = dataclasses.replace(
        task, waypoints=task.waypoints[:81:4], flipped_waypoints=None, durations=None
    )
    kept, free = (qt.plan(t, "time", seeds=()) for t in (cell, cell.without_clearance()))
    assert cell.clearances[0].margins(free.motion()).min() > 0.0
    assert np.array_equal(kept.motion(), free.motion())
    assert str(kept.certificate.grid) == str(free.certificate.grid)


def test_a_plan_under_a_fast_feed_is_no_slower_than_the_fastest_motion_that_then_keeps_it() -> None:
    """Where the feed allows most steps, accelerations decide, which the grid does not know."""
    task = qt.load_task("part_in_hand")
    assert task.durations is not None
    capped = dataclasses.replace(task, durations=task.durations / 10.0)
    fastest = qt.plan(dataclasses.replace(task, durations=None), "time").motion()
    goal = Objective.of(qt.JointRanges.of(task.model), "time").along(capped)
    assert qt.plan(capped, "time").value <= goal.value(fastest)


def test_where_the_feed_cannot_be_kept_a_plan_is_slower_and_says_where() -> None:
    task = line(13, 0.01)
    at_feed = qt.plan(task, seeds=())
    assert at_feed.q is None and at_feed.certificate.kind == "speed"
    plan = qt.plan(task, seeds=(), slow_down=True)
    pace, said = plan.pace, str(plan.certificate)
    assert pace is not None and plan.is_slower and task.durations is not None
    assert plan.certificate.slower == pytest.approx((pace[1:] / task.durations[1:]).max())
    assert "slower than the feed" in said and "at the feed, between waypoints" in said
    assert f"it takes {pace.sum():.4g} s instead of {task.durations.sum():.4g} s" in said
    assert plan.bound <= plan.value
    run = qt.follow(task, "qp_planned", plan=plan, slow_down=True)
    assert run.passes and run.least_times is not None
    assert qt.check_trajectory(qt.time_trajectory(qt.refine_trajectory(run)), task).passes


def test_a_plan_in_time_names_the_time_that_it_takes() -> None:
    plan = qt.plan(line(13, 0.01), "time", seeds=())
    assert f"it takes {plan.value:.4g} s instead of 0.12 s" in str(plan.certificate)


def moved(first: float, second: float) -> qt.PathTask:
    """The line in two stretches of 12 and 13 waypoints, with such times between two of them, s."""
    times = np.array([0.0, *[first] * 12, *[second] * 12])
    return dataclasses.replace(line(25), durations=times, joint_moves=(12,))


def longer(plan: qt.Plan) -> Array:
    """Times from waypoint to waypoint by those at the feed, (N − 1,); 0 in joint moves."""
    assert plan.durations is not None and plan.s is not None
    assert plan.path_task.durations is not None
    reached = np.append(0.0, np.cumsum(plan.durations))[plan.s == np.floor(plan.s)]
    factors: Array = np.diff(reached) / plan.path_task.durations[1:]
    factors[[k - 1 for k in plan.path_task.joint_moves]] = 0.0
    return factors


@pytest.mark.parametrize("times", [(0.02, 0.01), (0.01, 0.02), (0.4, 0.01)])
@pytest.mark.parametrize("objective", ["time", "centering"])
def test_a_slower_plan_of_stretches_counts_the_waypoints_and_times_of_the_whole_path(
    objective: str, times: tuple[float, float]
) -> None:
    plan = qt.plan(moved(*times), objective, seeds=(), slow_down=True)
    said, factors = str(plan.certificate), longer(plan)
    worst = int(np.argmax(factors))
    assert plan.certificate.slower == pytest.approx(factors[worst])
    slow = [False, *(factors > 1.0 + 1e-6).tolist(), False]
    begins, ends = (
        [k for k in range(len(slow) - 1) if slow[k : k + 2] == edge]
        for edge in ([False, True], [True, False])
    )
    run = next(k for k, end in enumerate(ends) if worst < end)
    where = f"between waypoints {begins[run] + 1} and {ends[run] + 1}, after waypoint {worst + 1} "
    assert where in said
    others = re.findall(r"at (\d+) more stretch", said)
    assert [int(count) for count in others] == [len(begins) - 1] * (len(begins) > 1)
    feed = np.array([times[0]] * 11 + [0.0] + [times[1]] * 12)
    total = f"{(factors * feed).sum():.4g} s instead of {feed.sum():.4g} s, outside joint moves"
    assert f"in all it takes {total}" in said


@pytest.mark.parametrize("slow_down", [False, True])
def test_why_a_stretch_does_not_keep_the_feed_is_told_with_waypoints_of_the_whole_path(
    slow_down: bool,
) -> None:
    """Only the second stretch, of waypoints 13 to 25, is too fast."""
    plan = qt.plan(moved(0.4, 0.01), seeds=(), slow_down=slow_down)
    said = str(plan.certificate)
    assert (plan.q is not None) == slow_down and "the best needs" in said
    why = said.rpartition("at the feed")[2]
    named = [
        int(k) for pair in re.findall(r"waypoints? (\d+)(?: and (\d+))?", why) for k in pair if k
    ]
    assert len(named) >= 2 and min(named) >= 13 and max(named) <= 25
    assert set(plan.certificate.waypoints) <= set(named)


@pytest.mark.parametrize("seed", range(6))
def test_the_joint_that_makes_a_path_slower_is_at_one_of_its_limits(seed: int) -> None:
    q, room, times, _ = random_path(seed, 6)
    pace = Pace(np.full(6, 1e-3), SPEED, ACCELERATION, room, rests=False)
    times = pace.seconds(q)
    factor, said = slowest([PacedStretch(0, pace, q)], ("a", "b", "c"))
    worst = int(np.argmax(times))
    assert factor == times[worst] / 1e-3
    assert f"after waypoint {worst + 1} " in said
    joint = "abc".index(said.partition("because of ")[2][0])
    speed = abs(q[worst + 1, joint] - q[worst, joint]) / (SPEED[joint] * times[worst])
    inner = changes(q, times, room)[:-2, joint]
    assert max(speed, *inner[max(worst - 1, 0) : worst + 1]) > 0.98


def test_a_plan_that_keeps_the_feed_is_the_same_whether_or_not_it_might_be_slower() -> None:
    task = line(11, 0.5)
    plain, free = (qt.plan(task, seeds=(), slow_down=slow_down) for slow_down in (False, True))
    assert np.array_equal(plain.motion(), free.motion()) and not free.is_slower
    assert "slower" not in str(free.certificate)


@pytest.mark.parametrize("feed", [0.5, 0.01])
def test_what_keeps_the_feed_after_all_becomes_the_best_near_it(feed: float) -> None:
    task, ranges = line(11, feed), qt.JointRanges.of(qt.load_task("planar_line").model)
    goal, rows = Objective.of(ranges, "centering"), PathRows(task)
    problem = Problem(task, rows, motion_limits(task, ranges, None, rows.hard), goal)
    fastest = qt.plan(task, "time", seeds=())
    found = SearchResult(problem.judged(fastest.motion()), fastest.certificate)
    near = PlanSearch(problem).near(found)
    if feed < 0.1:  # too fast for every motion
        assert near is found
    else:
        assert near.path is not None and near.path.feasible
        assert near.path.value <= 1.001 * qt.plan(task, seeds=()).value < found.path.value


def test_a_waypoint_out_of_reach_is_named_whatever_the_speed() -> None:
    task = line(6, 0.5)
    away = mink.SE3.from_translation(np.array([9.0, 0.0, 0.0])) @ task.waypoints[-1]
    far = dataclasses.replace(task, waypoints=(*task.waypoints[:-1], away))
    certificate = qt.plan(far, seeds=(), slow_down=True).certificate
    assert certificate.kind == "unreachable" and "slower" not in str(certificate)


def test_what_has_no_time_is_refused() -> None:
    task = qt.load_task("planar_line")
    with pytest.raises(qt.InvalidInput, match=r"no feed, and no speed limit of .*limits\.velocity"):
        qt.plan(task, "time")
    with pytest.raises(qt.InvalidInput, match="the time is that of the worst joint"):
        qt.plan(line(6), "time", joint_weights={"joint_1": 2.0})


def test_a_plan_keeps_the_speeds_of_the_data_sheet_where_the_task_states_none() -> None:
    stated = qt.load_task("deburring")
    assert stated.known_limits is not None and stated.durations is not None
    nothing = np.full(stated.model.nv, np.inf)
    task = dataclasses.replace(stated, velocity_limits=nothing)
    limits = motion_limits(task, qt.JointRanges.of(task.model))
    speeds = task.known_limits[1]
    np.testing.assert_allclose(limits.steps, speeds * stated.durations[1:, None])
    np.testing.assert_array_equal(Pace.stated(task).velocity, speeds)
    assert limits.step_limit == "the speed limits"


def test_a_largest_step_that_nobody_states_is_named_as_one() -> None:
    line = qt.load_task("planar_line")
    task = dataclasses.replace(
        line, waypoints=line.waypoints[:: len(line.waypoints) - 1], flipped_waypoints=None,
        velocity_limits=np.full(line.model.nv, np.inf), durations=np.full(2, 10.0), lines=None,
    )  # fmt: skip
    assert task.known_limits is None
    plan = qt.plan(task)
    assert plan.q is None
    assert "15° where [limits.velocity] states none" in str(plan.certificate)

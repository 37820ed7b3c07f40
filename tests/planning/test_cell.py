"""The shipped cell: its clamp is in the way of the best motion, and another one passes it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.kinematics import JointRanges
from qp_twist.planning import RollMap, least_mean_z
from qp_twist.planning.layer import centred
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm

EVERY = 5


def nearest(task: qt.PathTask, q: np.ndarray) -> tuple[float, set[str]]:
    """Distance of the nearest pair at q, m, by MuJoCo, and the names of both geoms."""
    (clearance,) = (c for c in task.constraints if isinstance(c, qt.Clearance))
    data = mujoco.MjData(task.model)
    data.qpos[:] = q
    mujoco.mj_kinematics(task.model, data)
    distances = [
        mujoco.mj_geomDistance(task.model, data, a, b, 0.1, None) for a, b in clearance.pairs
    ]
    least = int(np.argmin(distances))
    return distances[least], {task.model.geom(int(g)).name for g in clearance.pairs[least]}


@pytest.fixture(scope="module")
def cell() -> qt.PathTask:
    return qt.load_task("deburring_cell")


def test_every_waypoint_is_reached_clear_of_all_but_not_at_least_z(cell: qt.PathTask) -> None:
    """All branches at every 10° of roll, of every 5th waypoint."""
    arm = closed_form_arm(cell)
    assert arm is not None
    free = replace(cell, model=qt.load_task("deburring").model, constraints=())
    grid = RollGrid(free, arm, np.radians(10.0), np.full(6, np.inf))
    ranges = JointRanges.of(cell.model)
    hit: set[str] = set()
    for index in range(0, len(cell.waypoints), EVERY):
        layer = grid.layer(index)
        by_z = layer.q[np.argsort(ranges.centering(layer.q))]
        distance, names = nearest(cell, by_z[0])
        hit |= names if distance < 0.0 else set()
        assert any(nearest(cell, q)[0] >= 0.005 for q in by_z)
    assert hit & {"clamp_post", "clamp_lever"}


def test_the_least_z_of_the_waypoints_keeps_the_clearance(cell: qt.PathTask) -> None:
    """All branches at every degree of roll, the least z first, 30 mm clear of everything."""
    (clearance,) = cell.clearances
    wide = qt.Clearance(cell.model, 0.03, ignore=clearance.ignored)
    cell = replace(cell, constraints=(wide,))
    arm = closed_form_arm(cell)
    assert arm is not None
    free = replace(cell, model=qt.load_task("deburring").model, constraints=())
    grid = RollGrid(free, arm, np.radians(1.0), np.full(6, np.inf))
    ranges, waypoints = JointRanges.of(cell.model), range(0, len(cell.waypoints), 8 * EVERY)
    touching = 0
    for index in waypoints:
        q = grid.layer(index).q
        by_z = q[np.argsort(ranges.centering(q))]
        clear = next(q for q in by_z if nearest(cell, q)[0] >= 0.03)
        touching += bool((clear != by_z[0]).any())
        expected = float(ranges.centering(clear))
        least = least_mean_z(cell, [index])
        assert least <= expected + 1e-9
        assert least == pytest.approx(expected, rel=0.01)
    assert touching > len(waypoints) / 2
    alone = [least_mean_z(cell, [index]) for index in waypoints]
    assert least_mean_z(cell, waypoints) == pytest.approx(np.mean(alone), rel=1e-9)


def test_the_default_method_passes_the_clamp_that_it_hits_without_clearance(
    cell: qt.PathTask,
) -> None:
    assert cell.durations is not None
    # Past the clamp.
    cell = replace(
        cell, waypoints=cell.waypoints[:120], durations=cell.durations[:120], flipped_waypoints=None
    )
    free = replace(cell, model=qt.load_task("deburring").model, constraints=())
    distances = [nearest(cell, q) for q in qt.follow(free).q[::2]]
    least, names = min(distances, key=lambda pair: pair[0])
    assert least < -0.01
    assert names == {"fork", "clamp_post"}
    assert min(nearest(cell, q)[0] for q in qt.follow(cell).q[::2]) >= 0.005 - 1e-6


def test_the_map_of_rolls_says_where_the_arm_would_touch_and_what(cell: qt.PathTask) -> None:
    roll_map = RollMap.of(cell, columns=9, spacing_deg=15.0)
    arm = closed_form_arm(cell)
    assert arm is not None
    grid = RollGrid(cell, arm, np.radians(15.0), np.full(6, np.inf))
    order = np.argsort(np.remainder(grid.rolls + np.pi, 2.0 * np.pi))
    touched, free = 0, 0
    for column, index in enumerate(roll_map.waypoints):
        q = centred(grid.branches(index), JointRanges.of(cell.model))[order]
        for roll, branch in np.ndindex(q.shape[:2]):
            pair = roll_map.touched[column, roll, branch]
            if not roll_map.margins[column, roll, branch] >= 0.0:  # outside, or out of reach
                assert pair == -1
                continue
            distance, _ = nearest(cell, q[roll, branch])
            if abs(distance - 0.005) < 1e-4:
                continue
            assert (pair < 0) == (distance > 0.005)
            touched, free = touched + (pair >= 0), free + (pair < 0)
    assert min(touched, free) > 100
    counts = roll_map.in_the_way()
    assert sum(counts.values()) == (roll_map.touched >= 0).sum()
    assert list(counts.values()) == sorted(counts.values(), reverse=True)
    assert {"forearm to clamp_post", "fork to clamp_post"} <= set(
        list(roll_map.in_the_way([0]))[:3]
    )
    assert not any("table" in name for name in roll_map.in_the_way([0]))
    without = RollMap.of(qt.load_task("deburring"), columns=2, spacing_deg=60.0)
    assert (without.touched == -1).all()
    assert without.in_the_way() == {}


def test_where_pairs_leave_no_start_it_is_said_how_to_let_one_touch(cell: qt.PathTask) -> None:
    """At 0.35 m from everything no start is left."""
    wide = replace(cell, constraints=(qt.Clearance(cell.model, 0.35),))
    with pytest.raises(qt.InvalidInput, match=r"clearance, part to \w+ and .* and \d+ more") as e:
        qt.find_starts(wide)
    assert "belongs into ignore of [clearance]" in str(e.value)


@pytest.mark.parametrize("distance", [0.4, 10.0])
def test_a_distance_that_links_can_never_keep_is_refused_at_once(
    cell: qt.PathTask, distance: float
) -> None:
    """Millimetres given as metres: no start, and no step, could keep it."""
    wide = replace(cell, constraints=(qt.Clearance(cell.model, distance),))
    with pytest.raises(qt.InvalidInput, match=r"floor to turret.* more. .*5 mm is 0.005"):
        qt.follow(wide)


def test_a_start_that_comes_no_nearer_is_given_up(cell: qt.PathTask) -> None:
    """At 30 mm all pairs are apart in some configurations, but not on the path."""
    wide = replace(cell, constraints=(qt.Clearance(cell.model, 0.03),))
    with pytest.raises(qt.InvalidInput, match=r"after [2-5]\d steps it is .*clearance"):
        qt.follow(wide)


def test_durations_of_other_waypoints_are_refused(cell: qt.PathTask) -> None:
    with pytest.raises(qt.InvalidInput, match="one for each of the 51 waypoints, got 401"):
        qt.plan(replace(cell, waypoints=cell.waypoints[::8]))

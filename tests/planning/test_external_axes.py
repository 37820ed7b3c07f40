"""Plans of arms on a rail and in front of a table, and waypoints that none reaches."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable

import mink
import mujoco
import numpy as np
import pytest
from oracles.banded_paths import least_mean_z
from oracles.railed_arm import railed_arm
from oracles.scripts import script
from oracles.tilting_table import CENTRE, TILT, arm_that_moves, table_that_moves

import qp_twist as qt

study = script("benchmarks/placements.py")
STEP = math.radians(20.0)


def on_a_rail(far: float = 0.0) -> qt.PathTask:
    """21 waypoints of the deburring run, the last moved by ``far`` m, the arm on a rail along x."""
    task = qt.load_task("deburring")
    shift = mink.SE3.from_translation(np.array([0.0, far, 0.0]))
    waypoints = task.waypoints[::20]
    none = np.full(7, np.inf)
    return dataclasses.replace(
        task, model=railed_arm(task), waypoints=(*waypoints[:-1], shift @ waypoints[-1]),
        flipped_waypoints=None, durations=None, start=np.append(0.0, task.start),
        velocity_limits=none, acceleration_limits=none,
    )  # fmt: skip


def test_a_plan_on_a_rail_is_as_good_as_an_independent_search() -> None:
    """All branches of the arm without its rail, with the waypoints moved by places on the rail."""
    task, fixed = on_a_rail(), qt.load_task("deburring")
    plan = qt.plan(task, max_step_deg=20.0)
    q = plan.motion()
    assert np.abs(np.diff(q, axis=0)).max() <= STEP + 1e-9
    assert (q >= task.model.jnt_range[:, 0]).all() and (q <= task.model.jnt_range[:, 1]).all()
    data = mujoco.MjData(task.model)
    for row, waypoint in zip(q, task.waypoints, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        site = data.site("tool")
        assert np.abs(site.xpos - waypoint.translation()).max() < 1e-8
        assert np.abs(site.xmat[2::3] - waypoint.rotation().as_matrix()[:, 2]).max() < 1e-8
    arm, rolls = study.InverseKinematics(fixed), np.radians(np.arange(0.0, 360.0, 10.0))
    layers, ranges = [], qt.JointRanges.of(task.model)
    for waypoint in task.waypoints:
        found = []
        for place in np.linspace(-0.5, 0.5, 11):
            pose = mink.SE3.from_translation(np.array([-place, 0.0, 0.0])) @ waypoint
            own = arm.inside_with_turns(arm.branches(pose, rolls))
            found.append(np.column_stack([np.full(len(own), place), own]))
        layer = np.concatenate(found)
        layers.append(layer[ranges.centering(layer) < 0.15])
    searched = least_mean_z(task, layers, STEP)
    assert np.isfinite(searched)
    assert plan.value <= 1.02 * searched


def test_the_travel_of_a_rail_counts_as_much_as_its_weight_says() -> None:
    task = dataclasses.replace(on_a_rail(), waypoints=on_a_rail().waypoints[:7])
    moved = []
    for weight in (0.05, 20.0):
        plan = qt.plan(task, "travel", max_step_deg=20.0, joint_weights={"rail": weight}, seeds=())
        rail, *arm = np.degrees(np.abs(np.diff(plan.motion(), axis=0)).sum(axis=0))
        assert math.isclose(plan.value, weight * rail + sum(arm), rel_tol=1e-9)
        assert 0.0 < plan.bound <= plan.value
        moved.append((rail, sum(arm)))
    # Either is the better one by its own weights.
    (much, little), (still, more) = moved
    assert 0.05 * much + little <= 0.05 * still + more
    assert 20.0 * still + more <= 20.0 * much + little
    assert still < 0.1 * much


def test_the_largest_margin_is_half_the_rail_a_metre_counted_as_a_radian() -> None:
    """The rail's middle is 0.5 m from both ends, and the arm reaches the path from there."""
    plan = qt.plan(on_a_rail(), "margin", max_step_deg=20.0)
    q = plan.motion()
    assert np.abs(q[:, 0]).max() < 1e-3
    assert math.degrees(0.5) - 0.01 < plan.value <= math.degrees(0.5)
    ends = np.minimum(q - task_range(0), task_range(1) - q)
    assert plan.value == pytest.approx(math.degrees(ends.min()), abs=1e-9)


def task_range(end: int) -> np.ndarray:
    """Lower (0) or upper (1) limits of the arm on its rail."""
    return np.asarray(on_a_rail().model.jnt_range[:, end])


@pytest.mark.parametrize(
    ("objective", "weights", "text"),
    [
        ("travel", {"rails": 1.0}, "no joint is called 'rails'; did you mean 'rail'"),
        ("travel", {"rail": -1.0}, "joint_weights['rail']"),
        ("margin", {"rail": 2.0}, "takes no weights"),
    ],
)
def test_weights_that_say_nothing_are_refused(
    objective: str, weights: dict[str, float], text: str
) -> None:
    with pytest.raises(qt.InvalidInput, match=re.escape(text)):
        qt.plan(on_a_rail(), objective, joint_weights=weights)


def test_a_waypoint_beyond_the_length_of_the_arm_is_named() -> None:
    """The arm reaches less than 2.2 m from its base, and the rail runs across."""
    task = on_a_rail(far=2.0)
    plan = qt.plan(task)
    assert plan.q is None
    assert plan.certificate.kind == "unreachable"
    assert plan.certificate.waypoints == (21,)


def on_a_table(leans: float = 0.0) -> qt.PathTask:
    """A quarter of the deburring run in 9 waypoints, the part on a table that turns and tilts.

    The path stands still in the plate, so the plate is the world of this scene. Balls touch unless
    the table ``leans`` so far, rad.
    """
    task = qt.load_task("deburring")
    none = np.full(8, np.inf)
    return dataclasses.replace(
        task, model=arm_that_moves(leans), waypoints=task.waypoints[:97:12], flipped_waypoints=None,
        durations=None, start=np.append([0.0, 0.0], task.start), velocity_limits=none,
        acceleration_limits=none,
    )  # fmt: skip


def tool_in_the_cell(
    task: qt.PathTask,
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Gives the tool's position and axis in the plate that carries the path, by MuJoCo."""
    cell = table_that_moves()
    data = mujoco.MjData(cell)
    order = [task.model.joint(cell.joint(k).name).qposadr[0] for k in range(cell.njnt)]

    def tool(row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.qpos[:] = row[order]
        mujoco.mj_kinematics(cell, data)
        site, path = data.site("tool"), data.site("path")
        turn = path.xmat.reshape(3, 3).T
        return turn @ (site.xpos - path.xpos), turn @ site.xmat[2::3]

    return tool


def turned(turn: float, tilt: float) -> mink.SE3:
    """The plate's pose in the cell."""
    about = mink.SO3.from_x_radians(tilt) @ mink.SO3.from_z_radians(turn)
    return mink.SE3.from_rotation_and_translation(about, CENTRE - about.apply(CENTRE))


def test_a_plan_with_a_table_is_as_good_as_an_independent_search() -> None:
    """Three free degrees: all branches of the arm, for a grid of the plate's poses and the roll."""
    task, step, most = on_a_table(), math.radians(15.0), 0.13
    plan = qt.plan(task, max_step_deg=15.0)
    q = plan.motion()
    assert np.abs(np.diff(q, axis=0)).max() <= step + 1e-9
    assert (q >= task.model.jnt_range[:, 0]).all() and (q <= task.model.jnt_range[:, 1]).all()
    # In the cell the tool is on the path that the plate carries, at the waypoints ...
    tool, bound = tool_in_the_cell(task), plan.between
    poses = [(w.translation(), w.rotation().as_matrix()[:, 2]) for w in task.waypoints]
    for row, (position, axis) in zip(q, poses, strict=True):
        there = tool(row)
        assert np.abs(there[0] - position).max() < 1e-8
        assert np.abs(there[1] - axis).max() < 1e-8
    # ... and between them as near to it as the plan says.
    for k, share in ((k, share) for k in range(len(q) - 1) for share in (0.25, 0.5, 0.75)):
        begin, along = poses[k][0], poses[k + 1][0] - poses[k][0]
        off = tool(q[k] + share * (q[k + 1] - q[k]))[0] - begin
        off = off - along * np.clip(off @ along / (along @ along), 0.0, 1.0)
        assert np.linalg.norm(off) <= bound.position.bound[k] + 1e-9
    arm, ranges = study.InverseKinematics(qt.load_task("deburring")), qt.JointRanges.of(task.model)
    angles, layers = np.radians(np.arange(-180.0, 180.0, 10.0)), []
    for waypoint in task.waypoints:
        found = []
        for turn in angles:
            for tilt in angles[np.abs(angles) <= TILT + 1e-9]:
                own = arm.inside_with_turns(arm.branches(turned(turn, tilt) @ waypoint, angles))
                rows = np.column_stack([np.tile([turn, tilt], (len(own), 1)), own])
                found.append(rows[ranges.centering(rows) < most])
        layers.append(np.concatenate(found))
    searched = least_mean_z(task, layers, step)
    assert np.isfinite(searched)
    assert plan.value <= 1.02 * searched
    # The bound is below every motion, and above nothing that one waypoint alone could do better.
    alone = float(np.mean([ranges.centering(layer).min() for layer in layers]))
    assert plan.bound <= min(alone, plan.value) + 1e-12
    assert plan.bound >= 0.97 * alone


def test_a_table_that_has_to_lean_to_the_end_of_its_range_does() -> None:
    """Only the last 3° of 60° are clear: a sample of all configurations had next to none there."""
    leans = math.radians(57.0)
    task = on_a_table(leans)
    balls = [task.model.geom(f"ball_of_{name}").id for name in ("world", "base")]
    clearance = qt.Clearance(task.model, 0.005, pairs=[balls])
    task = dataclasses.replace(task, constraints=(clearance,))
    q, tool = qt.plan(task, max_step_deg=15.0, seeds=()).motion(), tool_in_the_cell(task)
    assert np.abs(np.diff(q, axis=0)).max() <= math.radians(15.0) + 1e-9
    # The balls' middles are a metre from the table's, on either side of the angle that it leans.
    apart = 2.0 * (np.sin(0.5 * np.abs(q[:, 1])) - math.sin(0.5 * leans))
    assert apart.min() >= 0.005 - 1e-8
    for row, waypoint in zip(q, task.waypoints, strict=True):
        assert np.abs(tool(row)[0] - waypoint.translation()).max() < 1e-8

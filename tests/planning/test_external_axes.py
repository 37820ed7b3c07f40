"""Plans of arms on a rail, and waypoints that no configuration reaches."""

from __future__ import annotations

import dataclasses
import math

import mink
import mujoco
import numpy as np
from oracles.banded_paths import least_mean_z
from oracles.scripts import script

import qp_twist as qt

study = script("examples/placements.py")
STEP = math.radians(20.0)


def on_a_rail(far: float = 0.0) -> qt.PathTask:
    """21 waypoints of the deburring run, the last moved by ``far`` m, the arm on a rail along x."""
    task = qt.load_task("deburring")
    spec = mujoco.MjSpec.from_file(str(task.scene))
    spec.body("base").add_joint(
        name="rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0], range=[-0.5, 0.5],
        limited=1,
    )  # fmt: skip
    shift = mink.SE3.from_translation(np.array([0.0, far, 0.0]))
    waypoints = task.waypoints[::20]
    none = np.full(7, np.inf)
    return dataclasses.replace(
        task, model=spec.compile(), waypoints=(*waypoints[:-1], shift @ waypoints[-1]),
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
        layers.append(layer[ranges.centring(layer) < 0.15])
    searched = least_mean_z(task, layers, STEP)
    assert np.isfinite(searched)
    assert plan.value <= 1.02 * searched


def test_a_waypoint_beyond_the_length_of_the_arm_is_named() -> None:
    """The arm reaches less than 2.2 m from its base, and the rail runs across."""
    task = on_a_rail(far=2.0)
    plan = qt.plan(task)
    assert plan.q is None
    assert plan.certificate.kind == "unreachable"
    assert plan.certificate.waypoints == (21,)


def test_a_layer_with_few_configurations_is_not_called_empty() -> None:
    """Of a rail of 2 mm few random configurations lead to a place on it."""
    task, arm = on_a_rail(), study.InverseKinematics(qt.load_task("deburring"))
    task.model.jnt_range[0] = (0.198, 0.2)
    rolls, back = np.radians(np.arange(0.0, 360.0, 5.0)), np.array([-0.199, 0.0, 0.0])
    for waypoint in task.waypoints:
        pose = mink.SE3.from_translation(back) @ waypoint
        assert len(arm.inside_with_turns(arm.branches(pose, rolls)))
    certificate = qt.plan(task, max_step_deg=20.0).certificate
    assert certificate.kind not in ("unreachable", "limits")

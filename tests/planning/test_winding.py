"""Paths around the base of an arm whose joints turn by more than a turn: how far they go."""

from __future__ import annotations

from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from oracles.cobots import cobot

import qp_twist as qt
from qp_twist.checks import Array

AXIS = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
)
ELBOW_UP = np.radians([10.0, -80.0, 100.0, -110.0, -90.0, 0.0])


def around(model: mujoco.MjModel, first: mink.SE3, span: float, spacing: float) -> qt.PathTask:
    """A path that turns about the base's axis, its tool as at the beginning.

    With waypoints 40° apart joints may move by 306° to the next one.
    """
    count = 1 + int(np.ceil(np.degrees(span) / spacing))
    angles = np.linspace(0.0, span, 1 + count)
    turns = (mink.SE3.from_rotation(mink.SO3.from_z_radians(angle)) for angle in angles)
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    return qt.PathTask(
        name="around", title="around", source=None, scene=Path("around.xml"), model=model,
        frame_name="tool", frame_type="site", projector=AXIS, operational=whole,
        waypoints=tuple(turn @ first for turn in turns), flipped_waypoints=None, start=ELBOW_UP,
        durations=None if spacing < 20.0 else np.append(0.0, np.full(count, 1.7)),
        velocity_limits=np.full(6, np.pi), acceleration_limits=np.full(6, np.inf),
    )  # fmt: skip


def base_angles(model: mujoco.MjModel, pose: mink.SE3) -> Array:
    """Joint 1 of all configurations at a pose with any roll, rad, from 0 to 2π, sorted.

    By Newton's method from random configurations, on MuJoCo's Jacobian.
    """
    rng, data, found = np.random.default_rng(0), mujoco.MjData(model), []
    tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    axis, J = pose.rotation().as_matrix()[:, 2], np.zeros((6, model.nv))
    for _ in range(300):
        data.qpos[:] = rng.uniform(-np.pi, np.pi, model.nq)
        for _ in range(40):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, J[:3], J[3:], tip)
            own = data.site_xmat[tip].reshape(3, 3)[:, 2]
            off = np.append(pose.translation() - data.site_xpos[tip], np.cross(own, axis))
            step = np.linalg.lstsq(J, off, rcond=1e-6)[0]
            data.qpos += step * min(1.0, 0.5 / np.abs(step).max())
            if np.abs(step).max() < 1e-8 and own @ axis > 0.0:
                found.append(data.qpos[0] % (2.0 * np.pi))
                break
    return np.sort(found)


@pytest.mark.parametrize(("beyond", "spacing"), [(-12.0, 13.0), (-12.0, 40.0), (12.0, 40.0)])
def test_an_arm_winds_about_its_base_as_far_as_its_range_and_no_further(
    beyond: float, spacing: float
) -> None:
    """By symmetry configurations further along are those at the beginning, turned about the base.

    So joint 1 goes from a band of its values at the first waypoint to the same band turned by the
    path's angle, whatever the other joints do.
    """
    model = cobot("UR5e")
    configuration = mink.Configuration(model)
    configuration.update(ELBOW_UP)
    first = configuration.get_transform_frame_to_world("tool", "site")
    angles = base_angles(model, first)
    bands = np.split(angles, np.flatnonzero(np.diff(angles) > np.radians(20.0)) + 1)
    lower, upper = model.jnt_range[0]
    turns = 2.0 * np.pi * np.arange(-3, 4)
    furthest = max(
        upper - band.min() - turn
        for band in bands for turn in turns if lower <= band.max() + turn <= upper
    )  # fmt: skip
    task = around(model, first, furthest + np.radians(beyond), spacing)
    plan = qt.plan(task, "travel", seeds=())
    if beyond < 0.0:
        assert np.ptp(plan.motion()[:, 0]) > furthest - np.radians(20.0)
    else:
        assert plan.q is None and plan.certificate.covered
        assert plan.certificate.joints == (model.joint(0).name,)
        assert len(qt.plan(task, "travel", cuts="fewest", seeds=()).cuts) == 1

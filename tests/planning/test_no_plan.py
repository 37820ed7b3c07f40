"""Where there is no plan: the place and the reason that a certificate names are the true ones."""

from __future__ import annotations

import dataclasses
import math

import mink
import mujoco
import numpy as np
import pytest
from oracles.arms import random_arm
from oracles.rounded_arms import axis_path, vertical_arm

import qp_twist as qt
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.levels import Grid

WHOLE = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
PLACE = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())


def slowed(share: float) -> qt.PathTask:
    """The deburring run in 21 waypoints, its joints with a share of their speeds."""
    task = qt.load_task("deburring")
    starts = np.cumsum(task.durations)[::20]
    return dataclasses.replace(
        task, waypoints=task.waypoints[::20], flipped_waypoints=None,
        durations=np.diff(starts, prepend=0.0),
        velocity_limits=share * task.velocity_limits,
    )  # fmt: skip


def test_where_only_the_feed_is_too_fast_it_is_said_how_much_slower_it_has_to_be() -> None:
    task = slowed(0.02)
    certificate = qt.plan(task, seeds=()).certificate
    assert certificate.kind == "speed"
    assert f"only its speed prevents one: {certificate.slower:.3g} times slower" in str(certificate)
    # Whole paths at the named speed and at a hundredth of it, judged by their own steps.
    slower = dataclasses.replace(task, durations=1.01 * certificate.slower * task.durations)
    q = qt.plan(slower, seeds=()).motion()
    fastest = np.abs(np.diff(q, axis=0)) / slower.durations[1:, None]
    assert (fastest <= slower.velocity_limits + 1e-9).all()


def test_a_feed_that_no_joints_keep_is_known_before_a_search_and_slowed() -> None:
    task, looked = slowed(1e-4), list[str]()
    plan = qt.plan(task, seeds=(), slow_down=True, progress=lambda what, _: looked.append(what))
    said = str(plan.certificate)
    assert "at the feed, between waypoints" in said
    assert "all joints together cannot move the tool so far" in said
    assert all("rolls 4° apart" in what or "off the grid" in what for what in looked)
    assert plan.is_slower and plan.durations is not None
    speeds = np.abs(np.diff(plan.motion(), axis=0)) / plan.durations[:, None]
    assert (speeds <= task.velocity_limits * (1.0 + 1e-9)).all()


def test_where_nothing_is_reached_no_speed_is_named() -> None:
    task = slowed(0.02)
    away = mink.SE3.from_translation(np.array([0.0, 5.0, 0.0]))
    far = dataclasses.replace(task, waypoints=tuple(away @ w for w in task.waypoints))
    certificate = qt.plan(far, seeds=()).certificate
    assert certificate.kind == "unreachable" and math.isnan(certificate.slower)
    assert "slower" not in str(certificate)


def test_a_step_from_the_start_is_found_and_samples_prove_nothing_about_connections() -> None:
    """Four free degrees: the next waypoint's configurations are far apart, the start's are near."""
    rng = np.random.default_rng(3)
    model = random_arm(rng, 7)
    lower, upper = model.jnt_range.T
    begin = lower + (upper - lower) * rng.uniform(0.3, 0.7, model.nv)
    configuration = mink.Configuration(model, begin)
    first = configuration.get_transform_frame_to_world("tool", "site")
    step = mink.SE3.from_translation(np.array([0.002, 0.0, 0.0]))
    none = np.full(model.nv, np.inf)
    task = dataclasses.replace(
        qt.load_task("planar_line"), name="near", model=model, frame_name="tool",
        frame_type="site", projector=PLACE, operational=WHOLE, waypoints=(first, step @ first),
        flipped_waypoints=None, start=begin, durations=None, velocity_limits=none,
        acceleration_limits=none, constraints=(), segments=(), bands=(), toolpath=None, lines=None,
    )  # fmt: skip
    # A step of the least norm is a motion, and by far within what is allowed.
    J = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, configuration.data, J, None, model.site("tool").id)
    assert np.degrees(np.abs(np.linalg.pinv(J) @ [0.002, 0.0, 0.0])).max() < 1.0
    assert qt.plan(task, start=begin, max_step_deg=1.0, seeds=()).q is not None
    # Too far for any motion: each joint moves the tool by its column at most.
    apart = 0.03
    assert np.abs(J[0]).sum() * np.radians(apart) < 0.9 * 0.002
    certificate = qt.plan(task, start=begin, max_step_deg=apart, seeds=()).certificate
    assert certificate.kind == "speed" and not certificate.covered
    keeps = "no motion was found that keeps the largest step, max_step_deg = 0.03"
    assert keeps in str(certificate)
    assert "every connection" not in str(certificate)
    assert "this is no proof" in str(certificate)
    # Further than all joints together move it, at their longest levers: that is one.
    proof = qt.plan(task, start=begin, max_step_deg=1e-3, seeds=()).certificate
    assert proof.kind == "speed" and proof.covered


def cell(tip: str, away: float) -> qt.PathTask:
    """A turret, an elbow, a wrist and a roll; a tip; and a ball beside the path's end."""
    ball = f'<geom name="ball" type="sphere" size=".02" pos="{0.55 + away} .2 .62"/>'
    model = vertical_arm(repr(math.pi / 2), tip=tip, scene=ball)
    return axis_path(model, name="cell", constraints=(qt.Clearance(model, 0.01),))


TIP = '<geom name="tip" type="sphere" size=".01" pos=".1 0 0"/>'
ARM = '<geom name="arm" type="sphere" size=".01" pos=".1 .06 0"/>'


@pytest.mark.parametrize("tip", [TIP, TIP + ARM])
def test_what_no_joint_can_change_is_named_with_its_distance(tip: str) -> None:
    """The tip is on the path, so that its distance from the ball is the same at every roll."""
    task = cell(tip, 0.036)
    gap = math.hypot(0.036, 0.0) - 0.03
    certificate = qt.plan(task, max_step_deg=30.0).certificate
    assert certificate.kind == "band" and certificate.covered
    near = [
        k + 1 for k, w in enumerate(task.waypoints)
        if np.linalg.norm(w.translation() - [0.586, 0.2, 0.62]) - 0.03 < 0.01 - 2e-4
    ]  # fmt: skip
    assert set(certificate.waypoints) == set(near)
    assert any("ball" in name and "tip" in name for name in certificate.bands)
    assert "the task alone decides their distance" in str(certificate)
    last = np.linalg.norm(task.waypoints[near[0] - 1].translation() - [0.586, 0.2, 0.62]) - 0.03
    assert f"at most {1e3 * last:.3g} mm at waypoint {near[0]}" in str(certificate)
    assert gap < 0.01


def test_what_a_roll_can_avoid_is_not_called_prescribed() -> None:
    """An arm beside the axis reaches the ball at some rolls only."""
    task = cell(ARM, 0.06)
    plan = qt.plan(task, max_step_deg=30.0)
    assert "the task alone" not in str(plan.certificate)
    assert plan.q is not None
    assert all(finding.passes for finding in plan.examined() if "clearance" in finding.name)


def test_many_pairs_that_are_in_the_way_are_not_all_named() -> None:
    names = tuple(f"clearance, arm to post {k}" for k in range(30))
    grid = Grid(0.1, np.full(6, 0.1))
    text = str(Certificate("band", grid, (3,), bands=names))
    assert "post 7 and 22 more (" in text and "post 8" not in text
    assert "more" not in str(Certificate("band", grid, (3,), bands=names[:8]))

"""What stands behind the live page: runs, the arm in the hand, bars and dial."""

import dataclasses
import threading
import time
import xml.etree.ElementTree as ET
from functools import cache

import mink
import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.pages.local_server import LocalServer
from qp_twist.pages.near_pairs import NearPair, nearest_pair
from qp_twist.viewing.live_arm import LiveArm
from qp_twist.viewing.one_run import Run, run_once
from qp_twist.viewing.panel import clearance_bar, joint_bars, panel_html, status_html
from qp_twist.viewing.projectors import projector_choices, roll, with_projector
from qp_twist.viewing.runs import Runs
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import PageSettings
from qp_twist.viewing.stage import Stage


@cache
def planar():
    """The planar line with one waypoint in ten."""
    task = qt.load_task("planar_line")
    return dataclasses.replace(task, waypoints=task.waypoints[::10])


@cache
def deburring():
    """The deburring task with its first corner only, one waypoint in five."""
    task = qt.load_task("deburring")
    return dataclasses.replace(
        task,
        waypoints=task.waypoints[:120:5],
        flipped_waypoints=task.flipped_waypoints[:120:5],
        durations=task.durations[:120:5] * 5,
    )


# Projectors


def test_projector_choices_have_the_ranks_of_their_names():
    ranks = {name: t.rank for name, t in projector_choices(deburring()).items()}
    assert ranks == {
        "as the task says": 5, "whole pose": 6, "free roll": 5, "free tilt": 4, "position only": 3,
    }  # fmt: skip
    ranks = {name: t.rank for name, t in projector_choices(planar()).items()}
    assert ranks == {"as the task says": 2, "whole pose": 3, "position only": 2}


@pytest.mark.parametrize(
    ("name", "roll_counts", "tilt_counts"),
    [("free roll", False, True), ("free tilt", True, False), ("position only", False, False)],
)
def test_a_projector_frees_what_its_name_says(name, roll_counts, tilt_counts):
    rotation = mink.SO3.exp(np.array([0.3, -0.7, 1.1])).as_matrix()  # of the tool
    basis = projector_choices(deburring())[name].resolved(body=rotation).basis
    for axis, counts in ((2, roll_counts), (0, tilt_counts), (1, tilt_counts)):
        turn = np.concatenate([np.zeros(3), rotation[:, axis]])
        assert np.linalg.norm(basis.T @ turn) == pytest.approx(1.0 if counts else 0.0, abs=1e-12)
    assert np.linalg.norm(basis.T @ np.eye(6)[:, :3], axis=0) == pytest.approx(np.ones(3))


def test_a_task_with_another_projector_keeps_bands_that_it_leaves_free_and_drops_segments():
    task = qt.load_task("deburring_bands")
    assert with_projector(task, "as the task says") is task
    assert with_projector(task, "whole pose").bands == task.bands != ()
    aside = dataclasses.replace(task, bands=(qt.RollBand([0, 0, 1], 0.2, 0.8),))
    assert with_projector(aside, "free roll").bands == aside.bands
    assert with_projector(aside, "whole pose").bands == ()  # the roll is held at 0
    with_segments = qt.load_task("approach_contact_retreat")
    assert with_segments.segments
    assert with_projector(with_segments, "position only").segments == ()


# Limits off


@pytest.mark.parametrize(
    ("method", "closed_form", "weight"),
    [("qp", "twa", "paper"), ("qp_gradient", "gradient_projection", "gradient")],
)
def test_without_limits_a_qp_is_its_closed_form(method, closed_form, weight):
    settings = dataclasses.replace(
        PageSettings.of(planar(), method), weight=weight, gain=0.5, limits=False
    )
    run = run_once(planar(), settings)
    other = qt.follow(planar(), closed_form, iterations=20, weight=weight, gain=0.5)
    # Their starts are corrected with and without limits, to a tolerance of 1e-9 m.
    assert np.abs(run.trajectory.q - other.q).max() < 1e-6
    kept = run_once(planar(), dataclasses.replace(settings, limits=True)).trajectory
    assert kept.margins.min() >= -1e-9


def test_without_limits_the_paper_example_leaves_them_and_says_so():
    settings = PageSettings.of(planar(), "qp")
    on = run_once(planar(), settings)
    off = run_once(planar(), dataclasses.replace(settings, limits=False))
    assert on.trajectory.margins.min() >= -1e-9
    assert off.trajectory.margins.min() < -0.1  # against the robot's own ranges
    assert "leaves the limits" in off.status
    assert "leaves the limits" not in on.status


# Runs


def test_a_run_traces_the_path_and_reports_its_progress():
    heard = []
    run = run_once(
        planar(), PageSettings.of(planar(), "qp"), lambda share, what: heard.append(share)
    )
    assert run.trace == pytest.approx(planar().positions, abs=1e-8)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0
    moment = run.moment(3)
    assert moment.z == pytest.approx(
        0.5 * np.sum(((moment.q - qt.JointRanges.of(planar().model).middle)
                      / np.ptp(planar().model.jnt_range, axis=1)) ** 2)
    )  # fmt: skip


def test_the_roll_is_the_turn_about_the_tool_against_the_waypoint():
    task = deburring()
    configuration = mink.Configuration(task.model, task.start)
    pose = configuration.get_transform_frame_to_world("tool", "site")
    for angle in (-2.0, -0.3, 0.0, 1.0, 3.0):
        about_tool = mink.SE3.from_rotation(mink.SO3.from_z_radians(-angle))
        assert roll(task, configuration, pose @ about_tool) == pytest.approx(angle, abs=1e-9)


def test_the_worker_gives_up_what_nobody_waits_for_and_remembers_what_it_found():
    runs, began, seen = Runs(), threading.Event(), []
    run = run_once(planar(), PageSettings.of(planar(), "minimum_norm"))

    def endless(progress):
        began.set()
        while True:  # ends by what progress raises
            progress(0.5, "going on")
            time.sleep(0.001)

    def quick(progress):
        seen.append("computed")
        return run

    try:
        runs.request("endless", endless)
        assert began.wait(10.0)
        runs.request("quick", quick)
        assert runs.wait("quick", 10.0) is run
        assert runs.get("endless") is None
        runs.request("quick", quick)
        assert runs.wait("quick", 10.0) is run
        assert seen == ["computed"]
    finally:
        runs.close()
    assert not any(thread.name == "runs" for thread in threading.enumerate())


def test_the_worker_says_why_there_is_no_run(capsys):
    runs = Runs()

    def refused(progress):
        raise qt.InvalidInput("the path is out of reach.")

    def broken(progress):
        raise ZeroDivisionError("by zero")

    try:
        for key, compute in (("refused", refused), ("broken", broken)):
            runs.request(key, compute)
            assert isinstance(runs.wait(key, 10.0), str)
        assert runs.get("refused") == "the path is out of reach."
        assert "ZeroDivisionError" in runs.get("broken")
        assert "by zero" in capsys.readouterr().err
    finally:
        runs.close()


# The session


@pytest.fixture
def session():
    opened = Session(planar(), PageSettings.of(planar(), "minimum_norm"))
    try:
        assert isinstance(opened.runs.wait(opened.key, 30.0), Run)
        opened.tick(0.0)
        yield opened
    finally:
        opened.close()


def run_of(session):
    found = session.runs.wait(session.key, 30.0)
    session.tick(0.0)
    return found


def test_playing_moves_on_by_the_speed_and_begins_again(session):
    session.playback.playing, session.playback.speed = True, 4.0
    session.tick(0.5)
    assert session.playback.index == pytest.approx(2.0)
    assert np.array_equal(session.moment().q, session.run.trajectory.q[2])
    session.seek(100)
    assert session.playback.index == 10
    session.tick(0.5)
    assert session.playback.index == 0.0


def test_a_changed_setting_gives_another_run_and_the_first_one_comes_back(session):
    first = session.run
    session.change(method="twa")
    assert session.settings.weight == "paper"  # as the task file has it
    assert run_of(session).trajectory.method == "twa"
    assert session.status(session.moment())[0].startswith("twa: leaves the limits")
    session.change(method="minimum_norm")
    session.tick(0.0)
    assert session.run is first


def test_a_moved_workpiece_takes_the_path_with_it(session):
    to = session.handle + np.array([0.1, -0.2, 0.0])
    rotation = mink.SO3.from_z_radians(0.3)
    session.place(mink.SE3.from_rotation_and_translation(rotation, to))
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = (planar().positions - [0.0, 2.0, 0.0]) @ turn.T + to
    assert session.task.positions == pytest.approx(expected, abs=1e-12)
    old = session.run
    session.tick(0.0)
    assert session.run is old  # the hand has not come to rest
    time.sleep(0.35)
    session.tick(0.0)
    assert run_of(session).trace == pytest.approx(expected, abs=1e-7)
    session.put_back()
    session.tick(0.0)
    assert session.run is old


def test_a_workpiece_out_of_reach_has_no_run_but_a_sentence(session):
    far = mink.SE3.from_translation(session.handle + np.array([9.0, 0.0, 0.0]))
    session.place(far)
    time.sleep(0.35)
    session.tick(0.0)
    assert "cannot be corrected" in run_of(session)
    assert "cannot be corrected" in session.status(session.moment())[0]
    assert session.run is None
    assert np.array_equal(session.moment().q, planar().start)


# The arm in the hand


def moved(pose, by):
    return mink.SE3.from_rotation_and_translation(pose.rotation(), pose.translation() + by)


@pytest.mark.parametrize(
    ("method", "on_infeasible"), [("qp", "relax"), ("twa", "scale"), ("qp_gradient", "scale")]
)
def test_the_arm_keeps_its_limits_however_far_the_target_is(method, on_infeasible):
    task = deburring()
    arm = LiveArm(task, PageSettings.of(task, method), task.start, on_infeasible=on_infeasible)
    speeds = np.array([2.8798, 2.8798, 3.0543, 6.1087, 5.9341, 9.0757])  # of the data sheet
    lower, upper = task.model.jnt_range.T
    away = moved(arm.pose, [2.0, 3.0, -1.5])
    arm.target = mink.SE3.from_rotation_and_translation(
        mink.SO3.exp(np.array([2.0, 1.0, -1.0])), away.translation()
    )
    before, scales = task.start, []
    for _ in range(70):
        moment = arm.step()
        assert (moment.q >= lower - 1e-9).all()
        assert (moment.q <= upper + 1e-9).all()
        assert (np.abs(moment.q - before) <= speeds * arm.dt + 1e-9).all()
        before = moment.q
        scales.append(moment.scale)
        assert moment.sentence
    assert moment.position_error > 0.5
    assert on_infeasible == "relax" or min(scales) < 1.0


def test_the_arm_reaches_a_target_that_is_near():
    task = deburring()
    arm = LiveArm(task, PageSettings.of(task, "qp_gradient"), task.start)
    arm.target = moved(arm.pose, [0.05, -0.03, 0.04])
    for _ in range(80):
        moment = arm.step()
    there = mink.Configuration(task.model, moment.q).get_transform_frame_to_world("tool", "site")
    assert there.translation() == pytest.approx(arm.target.translation(), abs=1e-4)
    z = [pose.rotation().as_matrix()[:, 2] for pose in (there, arm.target)]
    assert z[0] == pytest.approx(z[1], abs=1e-4)
    assert moment.scale == 1.0


def test_the_arm_without_limits_goes_where_they_would_not_let_it():
    task = planar()
    settings = PageSettings.of(task, "qp_minimum_norm")
    outside = {}
    for limits in (True, False):
        arm = LiveArm(task, dataclasses.replace(settings, limits=limits), task.start)
        arm.target = moved(arm.pose, [1.5, -3.0, 0.0])
        for _ in range(130):
            moment = arm.step()
        outside[limits] = moment.margins.min() < -1e-9
        reached = moment.position_error
    assert outside == {True: False, False: True}
    assert reached < 1e-2


def test_a_grasped_session_follows_the_hand_and_goes_back(session):
    session.seek(4)
    pose = session.grasp()
    assert pose.as_matrix() == pytest.approx(session.arm.pose.as_matrix())
    before = session.moment().q
    session.drag(moved(session.arm.pose, [0.1, -0.1, 0.0]))
    assert not np.array_equal(session.tick(0.025).q, before)
    session.change(projector="whole pose")
    assert session.arm.task.projector.rank == 3
    assert session.arm.target.translation() == pytest.approx(
        planar().positions[4] + [0.1, -0.1, 0.0], abs=1e-6
    )
    session.release()
    session.change(projector="as the task says")
    assert np.array_equal(session.tick(0.0).q, before)


# The panel


def test_limits_are_lit_by_form_and_word():
    ranges = qt.JointRanges.of(planar().model)  # [0, 90], [0, 90], [0, 180] degrees
    q = np.radians([30.0, 90.0, -5.0])
    bars = joint_bars(ranges, q, ["joint_1 (upper velocity limit)"])
    assert [(bar.name, bar.state, bar.value, bar.word) for bar in bars] == [
        ("joint_1", "held", "30.0°", "velocity"),
        ("joint_2", "at limit", "90.0°", "at limit"),
        ("joint_3", "outside", "−5.0°", "outside"),
    ]
    assert [bar.at for bar in bars] == pytest.approx([100.0 / 3.0, 100.0, -100.0 * 5.0 / 180.0])
    assert bars[2].labels == {0.0: "0°", 100.0: "180°"}
    assert joint_bars(ranges, np.radians([30.0, 45.0, 90.0]))[0].state == "free"


@pytest.mark.parametrize(
    ("mm", "state", "shown", "word"),
    [
        (24.3, "free", "24.3 mm", ""),
        (5.0, "held", "5.0 mm", "at limit"),
        (2.1, "outside", "2.1 mm", "too near"),
        (-57.1, "outside", "−57.1 mm", "overlap"),
    ],
)
def test_the_bar_of_the_clearance_shows_distance_and_state(mm, state, shown, word):
    bar = clearance_bar(NearPair(1e-3 * mm, 0.005, "a<b to c", state == "outside"))
    assert (bar.state, bar.value, bar.word) == (state, shown, word)
    assert "5 mm" in bar.labels.values()
    assert bar.at == pytest.approx(max(2.0 * mm, -8.0))  # of 50 mm, and little below 0


def test_the_panel_is_html_with_units_and_signs(session):
    moment = dataclasses.replace(session.moment(), margins=np.array([0.5, -0.1, 0.2]))
    near = NearPair(0.004, 0.005, "a<b to c", too_near=True)
    text = panel_html(qt.JointRanges.of(planar().model), moment, near)
    ET.fromstring(f"<div>{text.replace('&nbsp;', ' ')}</div>")
    for words in ("mm", "°", "⚠ −0.100 joint_2", "a&lt;b to c", "✕", "roll "):
        assert words in text
    wrong = status_html("title", "leaves the limits <at> 3", wrong=True)
    assert "⚠" in wrong and "&lt;at&gt;" in wrong
    assert "⚠" not in status_html("title", "ok", wrong=False)


# The port


def test_a_port_that_is_taken_is_refused_and_passed_over():
    first = LocalServer(names=())
    try:
        taken = first.get_port()
        with pytest.raises(qt.InvalidInput, match=f"{taken} cannot be used"):
            LocalServer(taken, names=())
        second = LocalServer(names=())
        second.stop()
        assert second.get_port() != taken
    finally:
        first.stop()
    with pytest.raises(qt.InvalidInput, match="65535"):
        LocalServer(70000, names=())


# Clearance


def test_the_dragged_arm_stops_before_the_clamp_and_leaves_the_tasks_constraints_alone():
    task = qt.load_task("deburring_cell")
    arm = LiveArm(task, PageSettings.of(task, "qp_gradient"), task.start, on_infeasible="relax")
    (clearance,) = task.clearances
    assert not any(limit is clearance for limit in arm.controller.limits)
    assert any(isinstance(limit, qt.Clearance) for limit in arm.controller.limits)
    off = dataclasses.replace(PageSettings.of(task, "qp_gradient"), limits=False)
    kept = [type(limit) for limit in LiveArm(task, off, task.start).controller.limits]
    assert kept == [qt.Clearance]
    pose = arm.pose
    post = task.model.body("clamp").pos
    arm.target = mink.SE3.from_rotation_and_translation(
        pose.rotation(), np.array([post[0], post[1], 0.6])
    )
    data, least = mujoco.MjData(task.model), np.inf
    for _ in range(150):
        data.qpos[:] = arm.step().q
        mujoco.mj_kinematics(task.model, data)
        least = min(
            least,
            *(mujoco.mj_geomDistance(task.model, data, a, b, 1.0, None)
              for a, b in clearance.pairs),
        )  # fmt: skip
    assert 0.005 - 1e-4 < least < 0.006
    near = nearest_pair(task, arm.configuration.q)
    assert near is not None
    assert near.asked == 0.005 and "clamp" in near.name


def test_the_live_page_shows_a_moving_part_where_it_is_in_the_cell() -> None:
    """Body poses by MuJoCo in the scene; path, handles and lit shapes are children of one frame."""
    path_task = qt.load_task("part_in_hand")
    server = LocalServer(names=())
    try:
        stage = Stage(server, path_task, path_task.positions[0])
        q = path_task.start + 0.1
        stage.scene.show(q)
        scene = path_task.scene_model
        assert scene is not None
        data = mujoco.MjData(scene)
        for name, value in zip(qt.JointRanges.of(path_task.model).names, q, strict=True):
            data.qpos[scene.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(scene, data)
        carrier = server.scene.get_handle_by_name("/carrier")
        assert carrier is not None
        np.testing.assert_allclose(carrier.position, data.body("part").xpos, atol=1e-9)
        np.testing.assert_allclose(carrier.wxyz, data.body("part").xquat, atol=1e-9)
        for name in ("path", "target", "workpiece", "waypoint"):
            assert server.scene.get_handle_by_name(f"/carrier/{name}") is not None
    finally:
        server.stop()

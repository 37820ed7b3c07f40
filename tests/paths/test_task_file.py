"""Task files: what is read, and how a mistake is named."""

import dataclasses
import shutil
from pathlib import Path

import mink
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.paths import shipped_folder, shipped_tasks

MINIMAL = """\
title = "A short line"

[robot]
scene = "arm.xml"
frame = "tip"

[projector]
linear = { plane = [0, 0, 1] }
angular = "none"

[path]
kind = "polyline"
points = [[-1, 2, 0], [-0.9, 2, 0]]
steps_per_segment = 4

[start]
q_deg = [70.7, 69.1, 99.2]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(shipped_folder("scenes") / "planar_3r.xml", tmp_path / "arm.xml")
    return tmp_path


def write(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", shipped_tasks(), ids=lambda p: p.stem)
def test_every_shipped_task_loads_and_says_what_it_is(path: Path) -> None:
    task = qt.load_task(path.stem)
    assert task.name == path.stem
    assert task.title
    assert task.redundancy == (0 if path.stem == "approach_contact_retreat" else 1)


def test_a_file_of_ones_own_is_followed_with_its_own_scene(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(folder, MINIMAL)
    # From another folder: relative paths belong to the file.
    monkeypatch.chdir(folder.parent)
    task = qt.load_task(path)
    assert task.scene == folder / "arm.xml"
    assert len(task.waypoints) == 5
    assert task.positions[:, 0] == pytest.approx(np.linspace(-1, -0.9, 5))
    trajectory = qt.follow(task, "qp_minimum_norm")
    assert trajectory.position_error.max() < 1e-8


def test_velocity_and_acceleration_limits_are_stated_by_joint(folder: Path) -> None:
    limits = """[feed]
dt = 0.1
[limits]
velocity = { joint_2 = 1.5 }
acceleration = { joint_1 = 4.0, joint_3 = 2.5 }

[start]"""
    task = qt.load_task(write(folder, MINIMAL.replace("[start]", limits)))
    assert task.velocity_limits.tolist() == [np.inf, 1.5, np.inf]
    assert task.acceleration_limits.tolist() == [4.0, np.inf, 2.5]
    assert np.isinf(qt.load_task(write(folder, MINIMAL)).acceleration_limits).all()


@pytest.mark.parametrize(
    ("old", "new", "sentences"),
    [
        ("steps_per_segment", "steps_per_segmnt", ["line 14", "path.steps_per_segmnt", "unknown key", "did you mean 'steps_per_segment'"]),
        ("steps_per_segment = 4\n", "", ["path.steps_per_segment", "missing"]),
        ("steps_per_segment = 4", 'steps_per_segment = "four"', ["line 14", "valid integer", '"four"']),
        ("steps_per_segment = 4", "steps_per_segment = 0", ["line 14", "greater than or equal to 1"]),
        ("steps_per_segment = 4", "steps_per_segment = 4.5", ["line 14", "integer"]),
        ('kind = "polyline"', 'kind = "spiral"', ["line 12", "path", "polyline", "spherical_patch"]),
        ("[[-1, 2, 0], [-0.9, 2, 0]]", "[[-1, 2, 0]]", ["line 13", "path.points", "at least 2"]),
        ("[-0.9, 2, 0]]", "[-0.9, 2]]", ["line 13", "path.points[1]"]),
        ("[-0.9, 2, 0]]", "[-0.9, nan, 0]]", ["line 13", "path.points[1][1]", "finite"]),
        ('angular = "none"', 'angular = "nothing"', ["line 9", "projector.angular", '"full"', "'nothing'"]),
        ("{ plane = [0, 0, 1] }", "{ plane = [0, 0, 0] }", ["line 8", "projector.linear", "no direction"]),
        ("{ plane = [0, 0, 1] }", "{ plane = [0, 0] }", ["line 8", "projector.linear", "shape (3)"]),
        ('frame = "tip"', 'frame = "tap"', ["robot.frame", "'tap'", "tip"]),
        ('"arm.xml"', '"leg.xml"', ["robot.scene", "'leg.xml'"]),
        ("[70.7, 69.1, 99.2]", "[70.7, 69.1]", ["start.q_deg", "3 joint coordinates", "got 2"]),
        ("q_deg = [70.7", "q = [1.0]\nq_deg = [70.7", ["start", "either q_deg"]),
        ("[start]", "[limits.velocity]\njoint_9 = 1.0\n[start]", ["limits.velocity.joint_9", "joint_1"]),
        ("[start]", "[limits.velocity]\njoint_1 = -1.0\n[start]", ["line 17", "limits.velocity.joint_1", "greater than 0"]),
        ("[start]", "[limits.velocity]\njoint_1 = 1.0\n[start]", ["limits.velocity", "[feed]"]),
        ("[start]", "[limits.acceleration]\njoint_1 = 1.0\n[start]", ["limits.acceleration", "[feed]"]),
        ("[start]", "[limits.acceleration]\njoint_9 = 1.0\n[start]", ["limits.acceleration.joint_9", "joint_1"]),
        ("[start]", "[limits]\nacceleration = { joint_1 = 0.0 }\n[start]", ["line 17", "limits.acceleration.joint_1", "greater than 0"]),
        ("[start]", "[feed]\ndt = 0.1\nspeed = 1.0\n[start]", ["feed", "either dt or speed"]),
        ("[start]", "[feed]\n[start]", ["feed", "give speed"]),
        ("[start]", "[methods.qpp]\ngain = 1.0\n[start]", ["line 16", "methods.qpp", "'qp'"]),
        ("[start]", "[methods.qp]\ngain = -1.0\n[start]", ["line 17", "methods.qp.gain"]),
        ("[start]", "[methods.rmr]\ngain = 1.0\n[start]", ["line 17", "methods.rmr.gain", "no secondary"]),
        ("[start]", '[methods.qp]\nweight = "heavy"\n[start]', ["line 17", "methods.qp.weight", "'gradient'"]),
        ("kind = ", "tool_axis = [0, 0, 1]\nkind = ", ["roll", "plane_normal"]),
        ("{ plane = [0, 0, 1] }", "{ plane = [false, false, true] }", ["line 8", "three numbers"]),
        ("steps_per_segment = 4", "steps_per_segment = 4\nradius = 1.0", ["line 15", "path.radius", "unknown key here"]),
        ('angular = "none"', 'angular = "none"\n[operational]\nlinear = "none"\nangular = "full"', ["direction outside the operational space"]),
        ('title = "A short line"', "title = " + 300 * "[" + 300 * "]", ["mine.toml"]),
        ('title = "A short line"', "title = 1" + 5000 * "0", ["cannot be read"]),
        ('title = "A short line"', "title = ", ["not valid TOML", "line 1"]),
        ('title = "A short line"', "tilte = 3", ["tilte", "unknown key", "'title'"]),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(
    folder: Path, old: str, new: str, sentences: list[str]
) -> None:
    assert old in MINIMAL
    path = write(folder, MINIMAL.replace(old, new))
    with pytest.raises(qt.TaskFileError) as caught:
        qt.load_task(path)
    for sentence in ["mine.toml", *sentences]:
        assert sentence in str(caught.value)
    assert "pydantic" not in str(caught.value)


def test_a_missing_task_is_named_with_those_there_are() -> None:
    with pytest.raises(qt.TaskFileError, match=r"'nosuch'.*deburring.*\./nosuch\.toml"):
        qt.load_task("nosuch")
    with pytest.raises(qt.TaskFileError, match="no such task file"):
        qt.load_task("./nosuch.toml")


def test_a_file_that_is_no_task_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as the trajectory, where the arguments of a command are exchanged."""
    (tmp_path / "joints.csv").write_text("joint_1\n0.0\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(qt.TaskFileError, match=r"joints\.csv is no task file: .* \.toml file"):
        qt.load_task("joints.csv")


def test_a_broken_scene_is_named(folder: Path) -> None:
    (folder / "arm.xml").write_text("<mujoco><wrong/></mujoco>")
    with pytest.raises(qt.TaskFileError, match=r"robot\.scene: .*MuJoCo cannot load"):
        qt.load_task(write(folder, MINIMAL))


def test_a_scene_with_a_free_joint_is_refused_by_name(folder: Path) -> None:
    (folder / "arm.xml").write_text(
        """<mujoco><worldbody><body><freejoint name="base"/><geom size="0.1"/>
        <site name="tip"/></body></worldbody></mujoco>"""
    )
    with pytest.raises(qt.TaskFileError, match=r"joint 'base' is a ball or free joint"):
        qt.load_task(write(folder, MINIMAL))


def test_a_list_of_poses_by_quaternion_or_roll_pitch_yaw(folder: Path) -> None:
    text = (
        MINIMAL[: MINIMAL.index("[path]")]
        + """
[path]
kind = "poses"
poses = [
  { position = [-1, 2, 0], quaternion_wxyz = [2, 0, 0, 0] },
  { position = [-0.9, 2, 0], rpy_deg = [0, 0, 90] },
]
[start]
q = [1.2339, 1.2060, 1.7314]
"""
    )
    task = qt.load_task(write(folder, text))
    assert task.waypoints[0].rotation().as_matrix() == pytest.approx(np.eye(3))
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert task.waypoints[1].rotation().as_matrix() == pytest.approx(quarter, abs=1e-12)
    both = text.replace("rpy_deg", "quaternion_wxyz = [1, 0, 0, 0], rpy_deg")
    with pytest.raises(qt.TaskFileError, match=r"poses\[1\].*either quaternion_wxyz or rpy_deg"):
        qt.load_task(write(folder, both))


def test_feed_by_dt_by_speed_and_by_turning(folder: Path) -> None:
    feed = MINIMAL.replace("[start]", "[feed]\ndt = 0.25\n[start]")
    durations = qt.load_task(write(folder, feed)).durations
    assert durations is not None
    assert durations.tolist() == [0.0, 0.25, 0.25, 0.25, 0.25]
    feed = MINIMAL.replace("[start]", "[feed]\nspeed = 0.05\n[start]")
    durations = qt.load_task(write(folder, feed)).durations
    assert durations == pytest.approx([0.0, 0.5, 0.5, 0.5, 0.5])
    turning = (
        MINIMAL[: MINIMAL.index("[path]")]
        + """
[path]
kind = "poses"
poses = [
  { position = [-1, 2, 0], rpy_deg = [0, 0, 0] },
  { position = [-1, 2, 0], rpy_deg = [0, 0, 90] },
]
[start]
q_deg = [70.7, 69.1, 99.2]
[feed]
speed = 1.0
"""
    )
    with pytest.raises(qt.TaskFileError, match=r"waypoints 1 and 2.*angular_speed_deg"):
        qt.load_task(write(folder, turning))
    durations = qt.load_task(write(folder, turning + "angular_speed_deg = 30\n")).durations
    assert durations == pytest.approx([0.0, 3.0])


def test_the_roll_rule_puts_y_in_the_plane() -> None:
    task = qt.load_task("deburring")
    assert task.flipped_waypoints is not None
    for waypoint, flipped in zip(task.waypoints, task.flipped_waypoints, strict=True):
        rotation = waypoint.rotation().as_matrix()
        assert rotation[1, 1] == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        other = flipped.rotation().as_matrix()
        assert other == pytest.approx(rotation * [-1, -1, 1], abs=1e-12)


def test_a_tool_axis_along_the_rules_normal_is_refused(folder: Path) -> None:
    text = MINIMAL.replace("kind = ", "tool_axis = [0, 1, 0]\nkind = ")
    text += "[roll]\nplane_normal = [0, 1, 0]\n"
    with pytest.raises(qt.TaskFileError, match=r"waypoint 1.*parallel"):
        qt.load_task(write(folder, text))


PATCH = (
    MINIMAL[: MINIMAL.index("[path]")]
    + """
[path]
kind = "spherical_patch"
center = [0, 0, 0]
radius = 0.3
half_width = [0.1, 0.1]
steps_per_edge = 3
[roll]
plane_normal = [0, 1, 0]
[start]
q_deg = [70.7, 69.1, 99.2]
"""
)


def test_a_patch_beyond_its_sphere_is_refused(folder: Path) -> None:
    text = PATCH.replace("radius = 0.3", "radius = 0.1")
    with pytest.raises(qt.TaskFileError, match="outside the sphere"):
        qt.load_task(write(folder, text))


def test_a_lead_runs_along_the_normal_to_the_edges_and_away_from_them(folder: Path) -> None:
    run = qt.load_task(write(folder, PATCH))
    text = PATCH.replace("[roll]", "lead = 0.15\nsteps_per_lead = 5\n[roll]")
    task = qt.load_task(write(folder, text))
    corner = run.positions[0]
    way = np.linspace(0.15, 0.0, 6)[:, None] * corner / 0.3
    assert task.positions[:6] == pytest.approx(corner + way)
    assert task.positions[5:-5] == pytest.approx(run.positions)
    assert task.positions[-6:] == pytest.approx(corner + way[::-1])
    into = task.waypoints[0].rotation().as_matrix()
    assert into[:, 2] == pytest.approx(-corner / 0.3)
    for waypoint in (*task.waypoints[:6], *task.waypoints[-6:]):
        assert waypoint.rotation().as_matrix() == pytest.approx(into)
    with pytest.raises(qt.TaskFileError, match=r"path: give both lead \(m\) and steps_per_lead"):
        qt.load_task(write(folder, text.replace("steps_per_lead = 5", "")))


def test_a_start_out_of_reach_is_a_sentence(folder: Path) -> None:
    far = MINIMAL.replace("[[-1, 2, 0], [-0.9, 2, 0]]", "[[9, 2, 0], [9, 3, 0]]")
    task = qt.load_task(write(folder, far))
    with pytest.raises(qt.InvalidInput, match=r"cannot be corrected onto the first waypoint"):
        qt.follow(task, "qp")


def test_a_files_settings_stand_in_place_of_the_methods_own(folder: Path) -> None:
    text = MINIMAL + "[methods.twa]\ngain = 0.3\n"
    settings = qt.load_task(write(folder, text)).settings("twa")
    assert settings.gain == 0.3
    assert (settings.secondary, settings.weight, settings.iterations) == ("centering", "paper", 1)
    assert qt.load_task(write(folder, MINIMAL)).settings("twa").gain == 1.0


def test_flipping_needs_a_roll_rule(folder: Path) -> None:
    task = qt.load_task(write(folder, MINIMAL))
    assert "rmr_flipped" not in task.method_names()
    with pytest.raises(qt.InvalidInput, match="roll rule"):
        qt.follow(task, "rmr_flipped")


def test_the_orientation_of_the_start_is_held_where_the_path_states_none(folder: Path) -> None:
    task = qt.load_task(write(folder, MINIMAL))
    configuration = mink.Configuration(task.model, task.start)
    held = configuration.get_transform_frame_to_world("tip", "site").rotation().as_matrix()
    assert task.waypoints[-1].rotation().as_matrix() == pytest.approx(held, abs=1e-12)


CELL = """\
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="wall" type="box" size="0.1 5 1" pos="-1.5 0 0"/>
  <geom name="sign" type="sphere" size="0.1" pos="-1 2 0" contype="0" conaffinity="0"/>
  <body name="link_1"><joint name="joint_1" axis="0 0 1" range="0 1.5708"/>
    <geom type="capsule" size="0.05" fromto="0 0 0 2 0 0"/>
    <body name="link_2" pos="2 0 0"><joint name="joint_2" axis="0 0 1" range="0 1.5708"/>
      <geom type="capsule" size="0.05" fromto="0 0 0 1.5 0 0"/>
      <body name="link_3" pos="1.5 0 0"><joint name="joint_3" axis="0 0 1" range="0 3.1416"/>
        <geom name="ball" type="sphere" size="0.05" pos="1 0 0"/><site name="tip" pos="1 0 0"/>
</body></body></body></worldbody></mujoco>
"""


def cell(folder: Path, clearance: str, scene: str = CELL) -> Path:
    (folder / "arm.xml").write_text(scene, encoding="utf-8")
    return write(folder, MINIMAL + "[clearance]\n" + clearance)


def only_clearance(path: Path) -> qt.Clearance:
    (found,) = (c for c in qt.load_task(path).constraints if isinstance(c, qt.Clearance))
    return found


def test_a_clearance_is_kept_by_every_pair_that_may_collide(folder: Path) -> None:
    clearance = only_clearance(cell(folder, "distance = 0.25"))
    # link_1 and link_2 as well as link_2 and the ball are joined by joints; the sign is no obstacle.
    assert set(clearance.names) == {
        "wall to link_1", "wall to link_2", "wall to ball", "link_1 to ball",
    }  # fmt: skip
    margins = clearance.margins(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi]]))
    ball = clearance.names.index("wall to ball")
    # The wall ends at x = -1.4, the ball of radius 0.05 is at 4.5 and at 2.5.
    assert margins[:, ball] == pytest.approx([5.6, 3.6], abs=1e-4)
    # The folded tip is 0.5 beyond the end of link_1, whose capsule has the radius 0.05, too.
    own = clearance.names.index("link_1 to ball")
    assert margins[1, own] == pytest.approx(0.5 - 0.1 - 0.25, abs=1e-4)


def test_ignored_pairs_are_named_by_geom_or_body_in_either_order(folder: Path) -> None:
    pairs = 'ignore = [["ball", "wall"], ["link_1", "link_3"], ["wall", "link_1"]]'
    clearance = only_clearance(cell(folder, pairs))
    assert clearance.names == ("wall to link_2",)
    assert clearance.distance == 0.005


def test_everything_may_be_ignored_but_something_has_to_be_able_to_collide(folder: Path) -> None:
    nothing_left = (
        'ignore = [["link_1", "link_3"], ["wall", "link_1"], ["wall", "link_2"], ["wall", "ball"]]'
    )
    assert only_clearance(cell(folder, nothing_left)).names == ()
    still = CELL.replace("<worldbody>", '<default><geom contype="0"/></default><worldbody>')
    with pytest.raises(qt.TaskFileError, match=r"clearance: no geom.*contype and conaffinity"):
        qt.load_task(cell(folder, "distance = 0.01", still))


@pytest.mark.parametrize(
    ("section", "sentences"),
    [
        ("distance = -0.001", ["line 19", "clearance.distance", "greater than or equal to 0", "-0.001"]),
        ("distance = nan", ["line 19", "clearance.distance", "finite"]),
        ('distance = "5 mm"', ["line 19", "clearance.distance", "valid number"]),
        ("distanc = 0.01", ["line 19", "clearance.distanc", "did you mean 'distance'"]),
        ('ignore = ["ball", "wall"]', ["line 19", "clearance.ignore[0]", 'expected a valid array, got "ball"']),
        ('ignore = "ball"', ["line 19", "clearance.ignore", 'expected a valid array, got "ball"']),
        ('ignore = [["ball"]]', ["clearance.ignore[0][1]", "missing"]),
        ('ignore = [["ball", ""]]', ["clearance.ignore[0][1]", "at least 1 character"]),
        ('ignore = [["bal", "wall"]]', ["line 18", "clearance", "no geom or body", "'bal'", "'ball'"]),
        ('ignore = [["ball", "tip"]]', ["line 18", "clearance", "no geom or body", "'tip'"]),
    ],
)  # fmt: skip
def test_a_mistake_in_a_clearance_is_named(
    folder: Path, section: str, sentences: list[str]
) -> None:
    with pytest.raises(qt.TaskFileError) as caught:
        qt.load_task(cell(folder, section))
    for sentence in ["mine.toml", *sentences]:
        assert sentence in str(caught.value)
    assert "pydantic" not in str(caught.value)


def test_a_part_takes_the_time_of_the_waypoints_that_it_leaves_out() -> None:
    task = qt.load_task("deburring")
    assert task.durations is not None
    index = np.unique(np.append(np.arange(0, len(task.waypoints), 7), len(task.waypoints) - 1))
    part = task.part(index)
    assert part.feed_time is not None
    assert np.isclose(part.feed_time, task.feed_time)
    begun = task.part(slice(10, 20))
    assert begun.durations is not None
    assert begun.durations.tolist() == [0.0, *task.durations[11:20].tolist()]


def test_projectors_stay_with_their_waypoints_where_segments_begin_between_them() -> None:
    task = qt.load_task("deburring")
    line = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
    segments = tuple(
        qt.paths.Segment(first, of) for first, of in ((10, line), (12, task.projector), (25, line))
    )
    task = dataclasses.replace(task, segments=segments)
    for index in ([0, 5, 11, 20, 30], [0, 9, 13, 26, 40], [14, 30, 31], [26, 27]):
        part = task.part(index)
        assert part.in_force == tuple(task.in_force[k] for k in index)

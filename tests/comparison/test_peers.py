"""Other libraries' steps: what they are given, where they equal ours, what they say when not."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import mink
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.comparison import metrics
from qp_twist.control import Status
from qp_twist.following.peer import peer_frame
from qp_twist.geometry import twist_error
from qp_twist.peers import PEERS, PeerProblem, peer_module
from qp_twist.peers.urdf import link_name, robot_urdf, roll_pitch_yaw

LAP = qt.load_task("deburring")
LINE = qt.load_task("planar_line")
X, Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
FULL, NONE = qt.Projector.full(), qt.Projector.none()
OTHERS = ("pink", "placo_hard", "placo_scaled")


def cut(task: qt.PathTask, indices: Sequence[int] | slice) -> qt.PathTask:
    """Some waypoints of a task, each with the time of its own."""
    chosen = np.arange(len(task.waypoints))[indices]
    return dataclasses.replace(
        task,
        waypoints=tuple(task.waypoints[i] for i in chosen),
        flipped_waypoints=None,
        durations=None if task.durations is None else task.durations[chosen],
    )


PIECE = cut(LAP, slice(0, 40))


def with_model(task: qt.PathTask, **ranges: tuple[float, float]) -> qt.PathTask:
    """The task with a model of its own, of other joint ranges."""
    model = mujoco.MjModel.from_xml_path(str(task.scene))
    for joint, limits in ranges.items():
        model.joint(joint).range = limits
    return dataclasses.replace(task, model=model)


def installed(method: str) -> bool:
    return importlib.util.find_spec(qt.METHODS[method].peer) is not None


# ---------------------------------------------------------------- well configured


@pytest.mark.parametrize(
    "method",
    [
        "mink",
        *(
            pytest.param(m, marks=pytest.mark.skipif(not installed(m), reason=f"no {m} here"))
            for m in OTHERS
        ),
    ],
)
def test_well_configured_a_peer_equals_the_joint_space_qp(method: str) -> None:
    ours, theirs = qt.follow(PIECE, "qp_gradient"), qt.follow(PIECE, method)
    # Soft costs and rows of another linearisation: beside what the secondary does, next to nothing.
    done = np.abs(ours.q - qt.follow(PIECE, "qp_minimum_norm").q).max()
    assert done > np.radians(30.0)
    assert np.abs(theirs.q - ours.q).max() < 0.01 * done
    assert theirs.z.mean() == pytest.approx(ours.z.mean(), rel=1e-3)
    assert theirs.position_error.max() < 1e-7  # placo's own solver comes no closer
    assert theirs.axis_error.max() < 1e-7
    assert metrics(theirs)["status"] == "ok"


def test_without_a_secondary_it_is_the_minimum_norm() -> None:
    theirs = qt.follow(PIECE, "mink", secondary="none")
    assert np.abs(theirs.q - qt.follow(PIECE, "minimum_norm").q).max() < np.radians(0.15)
    assert np.abs(theirs.q - theirs.q[0]).max() > np.radians(15.0)


def test_a_planar_arm_and_a_path_whose_projector_changes() -> None:
    line = cut(LINE, slice(0, None, 4))
    assert metrics(qt.follow(line, "mink"))["status"] == "ok"
    path = qt.load_task("approach_contact_retreat")
    ours, theirs = qt.follow(path, "qp_gradient"), qt.follow(path, "mink")
    assert metrics(theirs)["status"] == "ok"
    assert theirs.z.mean() == pytest.approx(ours.z.mean(), rel=5e-3)


def test_as_first_written_it_is_far_off_and_says_solved() -> None:
    theirs = qt.follow(PIECE, "mink_default")
    assert theirs.position_error.max() > 5e-3
    assert set(theirs.statuses) == {Status.SOLVED}
    assert theirs.scale.min() == 1.0
    assert theirs.failure == ""
    # It is the repeated pull that breaks the task: in the first iteration only it does not.
    mended = qt.follow(PIECE, "mink_default", iterations=20, every_iteration=False)
    assert mended.position_error.max() < 1e-8


# ---------------------------------------------------------------- settings and limits


def test_settings_reach_the_posture() -> None:
    short = cut(LAP, slice(0, 12))
    still = qt.follow(short, "mink", gain=0.0)
    weak, strong = (qt.follow(short, "mink", gain=gain) for gain in (0.02, 0.2))
    assert strong.z[-1] < weak.z[-1] < still.z[-1]
    heavy = qt.follow(short, "mink", posture_cost=0.3, iterations=1)
    assert heavy.position_error.max() > 1e-3  # a cost that competes with the task's
    start = qt.follow(short, "mink", secondary="posture", gain=0.5).q
    there = np.linalg.norm(start[-1] - short.start)
    assert there < np.linalg.norm(still.q[-1] - short.start)
    ours, equal = (qt.follow(short, "mink", weight=w, gain=0.2).q for w in ("natural", "equal"))
    assert np.abs(ours - equal).max() > np.radians(1.0)


def test_the_iterations_of_a_waypoint_share_its_speed() -> None:
    assert LAP.durations is not None
    slow = dataclasses.replace(PIECE, velocity_limits=np.full(6, 0.05))
    run = qt.follow(slow, "mink")
    assert slow.durations is not None
    speeds = np.abs(np.diff(run.q, axis=0)) / slow.durations[1:, None]
    assert speeds.max() < 0.05 * (1.0 + 1e-6)
    assert speeds.max() > 0.0499
    assert run.position_error.max() > 1e-3  # it could not keep up ...
    assert set(run.statuses) == {Status.SOLVED}  # ... and says solved


def test_joint_ranges_hold() -> None:
    free = qt.follow(PIECE, "mink", secondary="none").q
    way = free[-1] - free[0]
    joint = int(np.argmax(np.abs(way)))
    limit = free[0, joint] + 0.5 * way[joint]
    far = limit - 3.0 * np.sign(way[joint])
    narrow = with_model(
        dataclasses.replace(PIECE, start=free[0]),
        **{f"joint_{joint + 1}": (min(limit, far), max(limit, far))},
    )
    held = qt.follow(narrow, "mink", secondary="none").q
    room = (limit - held[:, joint]) * np.sign(way[joint])
    assert room.min() >= -1e-9
    assert room.min() < 1e-3


def test_an_exception_of_the_peer_is_the_failure_of_the_method() -> None:
    # Outside its range with too little speed to be back in one step: mink has no step to give.
    start = qt.follow(PIECE, "minimum_norm").q[0]
    outside = with_model(dataclasses.replace(PIECE, start=start), joint_1=(-2.9, start[0] - 0.3))
    run = qt.follow(outside, "mink")
    assert run.failure.startswith("no step at waypoint 2: mink: ")
    np.testing.assert_array_equal(run.q, np.broadcast_to(start, run.q.shape))
    assert run.failure in metrics(run)["status"]


# ---------------------------------------------------------------- projectors


@pytest.mark.parametrize("frame", ["world", "body", "target"])
def test_an_axis_to_align_is_the_angular_plane(frame: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        e = rng.normal(size=3)
        projector = qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(e), frame=frame)
        rows = peer_frame(PIECE, projector, qt.METHODS["mink"])
        target, about = Rotation.random(rng=rng).as_matrix(), Rotation.random(rng=rng).as_matrix()
        axis, direction = rows.axis(target)
        # Any rotation that aligns the two has no task error; one that does not has the angle left.
        onto = Rotation.align_vectors(direction[None], axis[None])[0].as_matrix()
        roll = Rotation.from_rotvec(rng.uniform(-3.0, 3.0) * direction).as_matrix()
        for rotation in (roll @ onto, about):
            error = twist_error(rotation, np.zeros(3), target, np.zeros(3), projector)[3:]
            angle = np.arccos(np.clip(rotation @ axis @ direction, -1.0, 1.0))
            assert np.linalg.norm(error) == pytest.approx(angle, abs=1e-7)


@pytest.mark.parametrize(
    "projector",
    [
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane([0.6, 0.0, 0.8]), frame="body"),
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(X), frame="target"),
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(Z), frame="world"),
        qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE, frame="body"),
        qt.TwistProjector(
            linear=qt.Projector.line(Z), angular=qt.Projector.plane(Z), frame="target"
        ),
        qt.TwistProjector(linear=qt.Projector.plane(X), angular=FULL, frame="target"),
        qt.TwistProjector(linear=NONE, angular=FULL),
        qt.TwistProjector(linear=FULL, angular=NONE),
    ],
)
def test_mink_meets_every_projector_that_it_has_words_for(projector: qt.TwistProjector) -> None:
    short = dataclasses.replace(cut(LAP, slice(0, 6)), projector=projector)
    run = qt.follow(short, "mink")
    assert run.failure == ""
    assert run.position_error.max() < 1e-8
    assert run.axis_error.max() < 1e-8


def test_what_a_planar_arm_cannot_leave_is_as_good_as_full() -> None:
    turn = qt.TwistProjector(linear=NONE, angular=qt.Projector.line(Z))
    line = dataclasses.replace(cut(LINE, slice(0, 5)), projector=turn)
    assert qt.follow(line, "mink").axis_error.max() < 1e-8


@pytest.mark.parametrize(
    ("projector", "options", "sentence"),
    [
        (qt.TwistProjector(linear=FULL, angular=qt.Projector.line(Z)), {}, "turn about one axis"),
        (qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE), {}, "fixed to the world"),
        (
            qt.TwistProjector(linear=qt.Projector.line([1, 1, 0]), angular=NONE, frame="body"),
            {}, "does not stay one of them",
        ),
        (
            qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE, frame="target"),
            {}, "fixed to the target",
        ),
        (None, {"secondary": "plan"}, "secondary plan, .* cannot be stated as a posture"),
        (None, {"secondary": "manipulability"}, "manipulability, .* cannot be stated as a posture"),
        (None, {"weight": "paper"}, "weight 'paper' cannot be stated as a posture task"),
        (None, {"gain": 1.5}, "gain is 0 to 1, got 1.5"),
        (None, {"posture_cost": 0.0}, "above 0"),
    ],
)  # fmt: skip
def test_what_mink_has_no_words_for_is_refused(
    projector: qt.TwistProjector | None, options: dict[str, object], sentence: str
) -> None:
    task = PIECE if projector is None else dataclasses.replace(PIECE, projector=projector)
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.follow(task, "mink", **options)


def test_bands_are_refused_and_equal_costs_are_for_peers_only() -> None:
    with pytest.raises(qt.InvalidInput, match="tolerance bands are not put into the words of mink"):
        qt.follow(qt.load_task("deburring_bands"), "mink")
    with pytest.raises(qt.InvalidInput, match="'equal' is for the posture tasks"):
        qt.follow(PIECE, "qp_gradient", weight="equal")


@pytest.mark.parametrize(("library", "priority"), [("mink", "scaled"), ("pink", "hard")])
def test_a_priority_that_a_library_does_not_have_is_refused(library: str, priority: str) -> None:
    frame = peer_frame(PIECE, PIECE.projector, qt.METHODS["mink"])
    problem = PeerProblem(PIECE.model, (frame,), PIECE.start, 1.0, priority=priority)  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match=f"not {priority}"):
        PEERS[library](problem)


# ---------------------------------------------------------------- which of them run


def test_a_comparison_has_mink_and_the_others_on_request() -> None:
    named = {name for name, method in qt.METHODS.items() if method.peer}
    assert named == {"mink", "mink_default", *OTHERS}
    assert named & set(LAP.method_names()) == {"mink"}
    assert not named & set(qt.load_task("deburring_bands").method_names())


@pytest.mark.parametrize(("method", "package"), [("pink", "pin-pink"), ("placo_hard", "placo")])
def test_a_peer_that_is_not_installed_is_named(
    method: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("pinocchio", "pink", "placo"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(qt.InvalidInput, match=f"pip install {package}"):
        qt.follow(PIECE, method)
    comparison = qt.compare(cut(LAP, slice(0, 3)), ["mink", method])
    assert list(comparison.trajectories) == ["mink"]
    assert package in comparison.not_run[method]
    # Drawn beside the QP that it comes nearest to.
    assert set(comparison.figures()) >= {"along_the_path"}


# ---------------------------------------------------------------- URDF

ODD = """
<mujoco><compiler angle="radian"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
  <body pos="0.1 -0.2 0.3" quat="0.9 0.1 -0.3 0.2">
    <joint name="a" axis="0 1 1" pos="0.05 0 -0.1" range="-1 2" ref="0.3"/>
    <geom size="0.1"/>
    <body pos="0 0.4 0.1" euler="0.4 1.5707963267948966 -0.2">
      <joint name="b" type="slide" axis="1 0 2" ref="-0.2" range="-0.5 0.5"/>
      <joint name="c" axis="0 0 1" pos="0 0.1 0"/>
      <geom size="0.1"/>
      <body pos="0.2 0 0"><geom name="tip" size="0.1" pos="0 0.1 0" euler="1 2 3"/></body>
    </body>
  </body>
  {more}
</worldbody></mujoco>
"""


def odd(more: str = "") -> qt.PathTask:
    model = mujoco.MjModel.from_xml_string(ODD.format(more=more))
    return dataclasses.replace(
        LINE,
        model=model,
        frame_name="tip",
        frame_type="geom",
        start=model.qpos0,
        velocity_limits=np.full(3, np.inf),
    )


FRAME = link_name(0)


def chain_urdf(task: qt.PathTask) -> str:
    frame = peer_frame(task, task.projector, qt.METHODS["pink"])
    return robot_urdf(task.model, [frame], task.velocity_limits)


def frame_of(urdf: str, q: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the controlled frame: forward kinematics of the text, by its own standard."""
    joints = {}
    for joint in ET.fromstring(urdf).iter("joint"):
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        assert parent is not None and child is not None and origin is not None
        xyz, rpy = (np.array(origin.get(key, "").split(), dtype=float) for key in ("xyz", "rpy"))
        axis = joint.find("axis")
        along = None if axis is None else np.array(axis.get("xyz", "").split(), dtype=float)
        joints[parent.get("link")] = (joint.get("type"), xyz, rpy, along, child.get("link"))
    pose, link, values = np.eye(4), "world", iter(q)
    while link != FRAME:
        kind, xyz, rpy, along, link = joints[link]
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
        pose = pose @ move
        if along is not None:
            step, value = np.eye(4), next(values)
            if kind == "prismatic":
                step[:3, 3] = value * along
            else:
                step[:3, :3] = Rotation.from_rotvec(value * along).as_matrix()
            pose = pose @ step
    return pose


@pytest.mark.parametrize("task", [LAP, LINE, odd()], ids=["m16ib", "planar", "odd"])
def test_the_urdf_is_the_chain_of_the_scene(task: qt.PathTask) -> None:
    urdf = chain_urdf(task)
    rng = np.random.default_rng(2)
    for _ in range(25):
        q = rng.uniform(-3.0, 3.0, task.model.nq)
        at = mink.Configuration(task.model, q)
        pose = at.get_transform_frame_to_world(task.frame_name, task.frame_type)
        np.testing.assert_allclose(frame_of(urdf, q), pose.as_matrix(), rtol=0, atol=1e-12)


def test_the_urdf_has_names_ranges_and_speeds() -> None:
    joints = {j.get("name"): j for j in ET.fromstring(chain_urdf(LAP)).iter("joint")}
    ranges = qt.JointRanges.of(LAP.model)
    for dof, name in enumerate(ranges.names):
        limit = joints[name].find("limit")
        assert limit is not None
        assert float(limit.get("lower", "")) == ranges.lower[dof]
        assert float(limit.get("upper", "")) == ranges.upper[dof]
        assert float(limit.get("velocity", "")) == LAP.velocity_limits[dof]


@pytest.mark.parametrize("pitch", [0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 2.0])
def test_roll_pitch_yaw_also_where_the_pitch_is_straight_up(pitch: float) -> None:
    rotation = Rotation.from_euler("xyz", [0.7, pitch, -2.1]).as_matrix()
    again = Rotation.from_euler("xyz", roll_pitch_yaw(rotation)).as_matrix()
    np.testing.assert_allclose(again, rotation, rtol=0, atol=1e-12)


def test_the_urdf_of_a_task_has_one_frame() -> None:
    text = chain_urdf(LAP)
    assert text.count(f'name="{FRAME}"') == 1
    assert text.count('type="revolute"') == 6


def test_a_tree_is_no_chain() -> None:
    arm = '<body name="arm"><joint name="other"/><geom size="0.1"/></body>'
    with pytest.raises(qt.InvalidInput, match="other does not move"):
        chain_urdf(odd(arm))


@pytest.mark.skipif(not installed("pink"), reason="pinocchio is not installed")
def test_pinocchio_reads_the_urdf_as_it_is_meant() -> None:
    pin = peer_module("pinocchio", "pin-pink")
    for task in (LAP, odd()):
        model = pin.buildModelFromXML(chain_urdf(task))
        assert tuple(model.names)[1:] == qt.JointRanges.of(task.model).names
        data = model.createData()
        q = np.random.default_rng(3).uniform(-2.0, 2.0, model.nq)
        pin.framesForwardKinematics(model, data, q)
        pose = mink.Configuration(task.model, q).get_transform_frame_to_world(
            task.frame_name, task.frame_type
        )
        frame = data.oMf[model.getFrameId(FRAME)].homogeneous
        np.testing.assert_allclose(frame, pose.as_matrix(), rtol=0, atol=1e-12)

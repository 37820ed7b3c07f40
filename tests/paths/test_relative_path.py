"""Paths on a body that moves: a part on a positioner, and a part in the robot's hand.

MuJoCo's kinematics of the scene as it stands is the judge: the tool seen from the part.
"""

import dataclasses
import json
import math
import re
from pathlib import Path

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from oracles.tilting_table import CENTRE, arm_that_moves, table_that_moves

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.constraints.colliding_pairs import geom_name
from qp_twist.geometry import Projector
from qp_twist.paths import placed, shipped_folder
from qp_twist.paths.rerooted import rerooted

Array = npt.NDArray[np.float64]
SCENES = shipped_folder("scenes")
TURN_TILT, IN_HAND = "turn_tilt", "part_in_hand"


class Cell:
    """A shipped scene as it stands, by MuJoCo, with joints by name."""

    def __init__(self, scene: str, tool: str, part: str) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(SCENES / scene))
        self.data, self.tool, self.part = mujoco.MjData(self.model), tool, part

    def put(self, names: tuple[str, ...], q: Array) -> None:
        for name, value in zip(names, q, strict=True):
            self.data.qpos[self.model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(self.model, self.data)

    def seen(self, names: tuple[str, ...], q: Array) -> tuple[Array, Array]:
        """Position and z of the tool in the frame of the part."""
        self.put(names, q)
        tool, part = self.data.site(self.tool), self.data.body(self.part)
        turn = part.xmat.reshape(3, 3).T
        return turn @ (tool.xpos - part.xpos), turn @ tool.xmat.reshape(3, 3)[:, 2]

    def least(self, pairs: list[tuple[str, str]]) -> float:
        """Least distance of pairs of geoms where the joints are, m."""
        ids = [tuple(self.model.geom(name).id for name in pair) for pair in pairs]
        return min(mujoco.mj_geomDistance(self.model, self.data, a, b, 5.0, None) for a, b in ids)


CELLS = {
    TURN_TILT: Cell("m16ib_positioner.xml", "arm_tool", "plate"),
    IN_HAND: Cell("m16ib_grinding.xml", "wheel", "part"),
}


def off_the_edge(task: str, position: Array, z: Array) -> float:
    """How far the tool is from the edge that the task is about, m or rad, by its geometry."""
    x, y, height = position
    if task == TURN_TILT:  # chords of 3° stay within 0.07 mm of the circle of 180 mm
        out = np.array([x, y, 0.0]) / math.hypot(x, y)
        inward = -(out + np.array([0.0, 0.0, 1.0])) / math.sqrt(2.0)
        return max(
            abs(math.hypot(x, y) - 0.18), abs(height - 0.21), 0.1 * math.acos(min(z @ inward, 1.0))
        )
    apart = min(abs(abs(x) - 0.11), abs(y - 0.07))
    return max(apart, abs(height - 0.05), float(np.linalg.norm(z - [0.0, 0.0, -1.0])))


@pytest.fixture(scope="module", params=[TURN_TILT, IN_HAND])
def run(request: pytest.FixtureRequest) -> qt.Trajectory:
    return qt.follow(qt.load_task(request.param))


def test_the_tool_is_on_the_path_that_the_part_carries(run: qt.Trajectory) -> None:
    task, cell = run.path_task, CELLS[run.path_task.name]
    (clearance,) = task.clearances
    pairs = [
        (geom_name(task.model, int(a)), geom_name(task.model, int(b))) for a, b in clearance.pairs
    ]
    for q, waypoint in zip(run.q, task.waypoints, strict=True):
        position, z = cell.seen(run.joint_names, q)
        assert np.abs(position - waypoint.translation()).max() < 2e-9
        assert np.abs(z - waypoint.rotation().as_matrix()[:, 2]).max() < 2e-9
        assert off_the_edge(task.name, position, z) < 1e-4
        assert cell.least(pairs) >= 0.005 - 1e-6
    limits = {cell.model.joint(j).name: cell.model.jnt_range[j] for j in range(cell.model.njnt)}
    for name, column in zip(run.joint_names, run.q.T, strict=True):
        assert (limits[name][0] <= column).all() and (column <= limits[name][1]).all()


def test_the_same_motion_is_checked_between_the_waypoints_and_passes(run: qt.Trajectory) -> None:
    refined = qt.refine_trajectory(run)
    check = qt.check_trajectory(qt.time_trajectory(refined), run.path_task)
    assert check.passes, check.verdict
    cell, motion = CELLS[run.path_task.name], check.motion
    for t in np.linspace(motion.times[0], motion.times[-1], 301):
        position, z = cell.seen(run.joint_names, motion.at(np.array([t])).q[0])
        # 0.1 mm of the path, and the path's chords.
        assert off_the_edge(run.path_task.name, position, z) < 4e-4


def test_a_plan_lies_on_the_part_too() -> None:
    task = qt.load_task(IN_HAND)
    task = dataclasses.replace(
        task, waypoints=task.waypoints[:21:4], durations=None, flipped_waypoints=None,
        velocity_limits=np.full(6, np.inf),
    )  # fmt: skip
    plan = qt.plan(task, max_step_deg=15.0)
    names = qt.JointRanges.of(task.model).names
    for q, waypoint in zip(plan.motion(), task.waypoints, strict=True):
        position, z = CELLS[IN_HAND].seen(names, q)
        assert np.abs(position - waypoint.translation()).max() < 1e-8
        assert np.abs(z - [0.0, 0.0, -1.0]).max() < 1e-8


# ---------------------------------------------------------------- in Python


@pytest.fixture
def cart() -> mujoco.MjModel:
    """A lifting arm beside a part on a cart: x of the cart against z of the arm."""
    return mujoco.MjModel.from_xml_string(
        """
        <mujoco><compiler angle="radian"/><worldbody>
          <body name="arm"><joint name="lift" type="slide" axis="0 0 1" range="-1 1"/>
            <joint name="swing" axis="0 1 0" range="-3 3"/><geom size="0.01" contype="0"/>
            <site name="tool" pos="0.5 0 0"/><site name="root"/></body>
          <body name="cart"><joint name="drive" type="slide" axis="1 0 0" range="-2 2"/>
            <geom size="0.01" pos="0 0 -3" contype="0"/><site name="on_cart"/>
            <body name="clamped"><geom size="0.01" pos="0 0 -3" contype="0"/></body></body>
        </worldbody></mujoco>
        """
    )


def on_the_cart(model: mujoco.MjModel, **others: object) -> qt.PathTask:
    """Points above the cart, to be reached with the tool's origin; joints: lift, swing, drive."""
    settings: dict[str, object] = {
        "name": "cart", "title": "cart", "source": None, "scene": Path("cart.xml"), "model": model,
        "frame_name": "tool", "frame_type": "site",
        "projector": qt.TwistProjector(
            linear=Projector.plane([0, 1, 0]), angular=Projector.none()
        ),
        "operational": qt.TwistProjector(
            linear=Projector.plane([0, 1, 0]), angular=Projector.line([0, 1, 0])
        ),
        "waypoints": tuple(
            mink.SE3.from_translation(np.array([x, 0.0, 0.3])) for x in (0.2, 0.4, 0.6)
        ),
        "flipped_waypoints": None, "start": np.array([0.3, 0.1, 0.2]), "durations": None,
        "velocity_limits": np.array([1.0, 2.0, 3.0]),
        "acceleration_limits": np.array([4.0, 5.0, 6.0]), "relative_to": "cart", **others,
    }  # fmt: skip
    return qt.PathTask(**settings)  # type: ignore[arg-type]


def test_a_run_moves_cart_and_arm_against_each_other(cart: mujoco.MjModel) -> None:
    """x of the tool less that of the cart, by hand."""
    run = qt.follow(on_the_cart(cart))
    drive, lift, swing = run.q.T
    assert np.abs(0.5 * np.cos(swing) - drive - [0.2, 0.4, 0.6]).max() < 1e-8
    assert np.abs(lift - 0.5 * np.sin(swing) - 0.3).max() < 1e-8


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ({"relative_to": "wagon"}, "relative_to: the scene has no body 'wagon'"),
        ({"relative_to": "on_cart"}, "'on_cart' is a site; name the body that carries it, 'cart'."),
        (
            {"relative_to": "arm"},
            "relative_to: no joint moves the site 'tool' against the body 'arm', which is to carry "
            "the path",
        ),
        (
            {"frame_name": "on_cart", "relative_to": "clamped"},
            "no joint moves the site 'on_cart' against the body 'clamped'",
        ),
    ],
)
def test_a_body_that_cannot_carry_the_path_is_refused(
    cart: mujoco.MjModel, others: dict[str, object], words: str
) -> None:
    with pytest.raises(qt.InvalidInput, match=re.escape(words)):
        on_the_cart(cart, **others)


def test_a_scene_with_a_free_body_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string(
        """
        <mujoco><worldbody><body name="arm"><joint name="turn"/><geom size="0.01"/>
        <site name="tool"/></body><body name="ball"><freejoint/><geom size="0.01"/></body>
        </worldbody></mujoco>
        """
    )
    with pytest.raises(qt.InvalidInput, match="whose joints are all hinges and slides"):
        on_the_cart(model, relative_to="ball", start=model.qpos0)


def test_a_path_on_a_body_is_placed_on_it_but_takes_no_body_along() -> None:
    task = qt.load_task(IN_HAND)
    by, origin = np.array([0.01, 0.0, 0.02]), np.zeros(3)
    moved = placed(task, mink.SO3.identity(), origin, by)
    assert np.abs(moved.positions - task.positions - by).max() < 1e-12
    with pytest.raises(qt.InvalidInput, match="the path lies on 'part', which joints move"):
        placed(task, mink.SO3.identity(), origin, by, body="grinder")


# ---------------------------------------------------------------- distances


def test_a_floor_that_moves_as_seen_from_the_part_is_kept_clear_of_and_proven() -> None:
    """Gradients and bounds of distances to a plane on a body that joints move."""
    task = qt.load_task(TURN_TILT)
    (clearance,) = task.clearances
    floor = [k for k, name in enumerate(clearance.names) if "floor" in name.split(" to ")]
    assert any("part" in clearance.names[k] for k in floor)
    rng = np.random.default_rng(4)
    ranges = qt.JointRanges.of(task.model)
    for _ in range(10):
        q = rng.uniform(ranges.lower, ranges.upper)
        gradients = clearance.gradients(q[None])[0, floor]
        step = 1e-6
        for dof in range(task.model.nv):
            ends = [q + side * step * np.eye(8)[dof] for side in (1.0, -1.0)]
            above, below = clearance.margins(np.array(ends))[:, floor]
            smooth = (above - below) / (2.0 * step)
            # Corners of boxes and rims have kinks, where either side's slope is right.
            assert np.median(np.abs(smooth - gradients[:, dof])) < 1e-5
        travel = rng.uniform(0.0, 0.3, task.model.nv)
        bound = clearance.change(q[None], travel[None])[0, floor]
        there = q + rng.choice([-1.0, 1.0], (40, 8)) * travel
        changed = np.abs(clearance.margins(there) - clearance.margins(q[None]))[:, floor]
        assert np.isfinite(bound).all()
        assert (changed <= bound + 1e-12).all()


# ---------------------------------------------------------------- task files and commands


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("plates", "robot.relative_to: the scene has no body 'plates'; did you mean 'plate'?"),
        ("arm_link_6", "robot.relative_to: no joint moves the site 'arm_tool' against the body"),
        ("part", "robot.relative_to: 'part' is a site; name the body that carries it, 'plate'."),
    ],
)
def test_a_task_file_with_another_body_is_refused_with_the_line(
    tmp_path: Path, body: str, words: str
) -> None:
    folder = shipped_folder("tasks")
    text = (folder / "turn_tilt.toml").read_text("utf-8").replace('"plate"', f'"{body}"')
    text = text.replace("../scenes/", "").replace('"round_edge', f'"{folder.as_posix()}/round_edge')
    (tmp_path / "task.toml").write_text(text, "utf-8")
    with pytest.raises(qt.TaskFileError) as refused:
        qt.load_task(tmp_path / "task.toml")
    number = next(k for k, line in enumerate(text.splitlines(), 1) if "relative_to" in line)
    assert words in str(refused.value)
    assert f"line {number}: " in str(refused.value)


def test_two_arms_share_a_part() -> None:
    """The left arm draws a square on a plate that the right one holds; both are planned."""
    spec = mujoco.MjSpec.from_file(str(SCENES / "two_arms.xml"))
    held = spec.body("right_link_7").add_body(name="plate", pos=[0.0, 0.0, 0.13])
    held.mass, held.inertia, held.explicitinertial = 0.3, np.full(3, 1e-3), 1
    scene = spec.compile()
    left, right = [0.0, 0.1, 0.0, -1.5, 0.0, 0.8, 0.0], [0.0, 0.3, 0.0, -1.7, 0.0, -1.2, 0.0]
    data = mujoco.MjData(scene)
    data.qpos[:] = left + right
    mujoco.mj_kinematics(scene, data)
    turn = data.body("plate").xmat.reshape(3, 3).T
    first = turn @ (data.site("left_tool").xpos - data.body("plate").xpos)
    axis = turn @ data.site("left_tool").xmat[2::3]
    # Kept from where the pen is: a square of 6 cm across the pen's axis.
    one = np.cross(axis, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(axis, [1.0, 0.0, 0.0]))
    other = np.cross(axis, one)
    held_at = mink.SO3.from_matrix(turn @ data.site("left_tool").xmat.reshape(3, 3))
    corners = [first + 0.06 * (a * one + b * other) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    points = [
        begin + share * (end - begin)
        for begin, end in zip(corners, [*corners[1:], corners[0]], strict=True)
        for share in np.arange(6) / 6.0
    ]
    free = qt.TwistProjector(
        linear=Projector.full(), angular=Projector.plane([0, 0, 1]), frame="body"
    )
    task = qt.PathTask(
        name="plate", title="plate", source=None, scene=Path("two_arms.xml"), model=scene,
        frame_name="left_tool", frame_type="site", projector=free,
        operational=qt.TwistProjector(linear=Projector.full(), angular=Projector.full()),
        waypoints=tuple(mink.SE3.from_rotation_and_translation(held_at, p) for p in points),
        flipped_waypoints=None, start=np.array(left + right), durations=None,
        velocity_limits=np.full(14, np.inf), acceleration_limits=np.full(14, np.inf),
        relative_to="plate",
    )  # fmt: skip
    run = qt.follow(task)
    assert len(run.joint_names) == 14
    for q, point in zip(run.q, points, strict=True):
        for name, value in zip(run.joint_names, q, strict=True):
            data.qpos[scene.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(scene, data)
        turn = data.body("plate").xmat.reshape(3, 3).T
        there = turn @ (data.site("left_tool").xpos - data.body("plate").xpos)
        assert np.abs(there - point).max() < 1e-8
        assert np.abs(turn @ data.site("left_tool").xmat[2::3] - axis).max() < 1e-8
    moved = dict(zip(run.joint_names, np.ptp(run.q, axis=0), strict=True))
    assert any(moved[f"right_joint_{k}"] > 1e-3 for k in range(1, 8))
    assert any(moved[f"left_joint_{k}"] > 1e-3 for k in range(1, 8))


def test_run_check_report_and_export_of_a_part_in_the_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hand.csv"
    main(["run", IN_HAND, "--out", str(file)])
    main(["check", str(file), IN_HAND])
    main(["export", str(file), IN_HAND, "--out", str(tmp_path / "hand.ls")])
    said = capsys.readouterr().out
    assert "J3 = joint_3 - J2" in said  # as for every M-16iB
    assert said.count("passes; ") == 3
    # The program's axes are those of the scene, where the robot stands.
    main(["check", str(tmp_path / "hand.ls"), IN_HAND])
    assert "passes" in capsys.readouterr().out
    # As modelled the axes count from the robot's base, though the part is what is at rest.
    main(["export", str(file), IN_HAND, "--to", "krl", "--as-modelled"])
    assert "A1 = joint_1" in capsys.readouterr().out
    main(["check", str(file.with_suffix(".src")), IN_HAND, "--as-modelled"])
    qt.report(qt.read_trajectory(file), qt.load_task(IN_HAND), tmp_path / "page")
    page = (tmp_path / "page" / "report.html").read_text("utf-8")
    assert "Path lies on" in page and "Fanuc M-16iB/20, recognised" in page


def test_a_program_has_the_axes_of_a_positioner(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "table.csv"
    main(["run", TURN_TILT, "--out", str(file)])
    main(["export", str(file), TURN_TILT, "--out", str(tmp_path / "table.ls")])
    said = capsys.readouterr().out
    assert "GP2_J1 = tilt in deg" in said and "passes" in said
    text = (tmp_path / "table.ls").read_text()
    assert "DEFAULT_GROUP\t= 1,1,*,*,*;" in text
    # The first point of the second group is where tilt and turn begin.
    shown = re.search(r"GP2:\s+UF : 0, UT : 1,\s+J1= (\S+) deg, J2= (\S+) deg", text)
    assert shown is not None
    begin = np.degrees(qt.read_trajectory(file).q[0, 6:])
    assert [float(shown[1]), float(shown[2])] == pytest.approx(begin, abs=0.51e-4)
    other = ["--external", "GP2_J2=tilt,GP2_J1=turn"]
    with pytest.raises(SystemExit):
        main(["check", str(tmp_path / "table.ls"), TURN_TILT, *other])
    assert "the header says GP2_J1 = tilt" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["export", str(file), TURN_TILT, "--to", "urscript", "--as-modelled"])
    assert "also needs 2 joints ('tilt', 'turn')" in capsys.readouterr().err
    main(["export", str(file), TURN_TILT, "--out", str(tmp_path / "table.mcap")])
    assert "passes" in capsys.readouterr().out
    # Columns are in the order of the scene; they have names, so that any order is the same motion.
    rows = qt.read_trajectory(file)
    assert rows.metadata["relative_to"] == "plate"
    assert rows.joint_names == (*(f"arm_joint_{k}" for k in range(1, 7)), "tilt", "turn")
    names = ["turn", *rows.joint_names[:-1]]
    assert qt.check_trajectory(rows.of_joints(names), qt.load_task(TURN_TILT)).passes
    # 56 s: the report plays it faster than the robot.
    found = qt.report(rows, qt.load_task(TURN_TILT), tmp_path / "page")
    assert "It moves 2 times as fast" in found.path.read_text("utf-8")


def test_a_trajectory_of_the_same_robot_on_another_body_is_noticed(tmp_path: Path) -> None:
    run = qt.follow(qt.load_task(IN_HAND))
    file = tmp_path / "run.json"
    qt.write_trajectory(qt.time_trajectory(run), file)
    content = json.loads(file.read_text("utf-8"))
    text = json.dumps(content).replace('"relative_to": "part"', '"relative_to": "link_6"')
    assert text != json.dumps(content)
    file.write_text(text, "utf-8")
    check = qt.check_trajectory(qt.read_trajectory(file), qt.load_task(IN_HAND))
    assert any("link_6" in note and "'part'" in note for note in check.notes)


def test_a_table_modelled_by_hand_is_what_re_rooting_makes() -> None:
    """An arm whose base moves against its part, written by hand with reversed axes."""
    hand, seen = arm_that_moves(), rerooted(table_that_moves(), "plate").model
    rng = np.random.default_rng(0)
    for q in rng.uniform(-2.0, 2.0, (20, 8)):
        sites = []
        for model in (hand, seen):
            data = mujoco.MjData(model)
            for k in range(hand.njnt):
                data.qpos[model.joint(hand.joint(k).name).qposadr[0]] = q[k]
            mujoco.mj_kinematics(model, data)
            sites.append(np.append(data.site("tool").xpos, data.site("tool").xmat))
        sites[0][:3] -= CENTRE  # the plate's frame is where the axes meet
        assert np.abs(sites[0] - sites[1]).max() < 1e-12

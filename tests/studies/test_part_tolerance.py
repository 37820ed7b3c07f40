"""How far a part may be off, against gantries whose room is known and other solvers."""

import json
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from scipy.optimize import least_squares

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.cli import main
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.studies import part_tolerance

MASS = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
GANTRY = f"""<mujoco><worldbody>{{wall}}
  <body>{MASS}<joint name="x" type="slide" axis="1 0 0" range="-0.5 0.5"/>
    <body>{MASS}<joint name="y" type="slide" axis="0 1 0" range="-0.5 0.5"/>
      <body>{MASS}<joint name="z" type="slide" axis="0 0 1" range="-0.5 0.5"/>
        <geom type="sphere" size="0.02"/><site name="tool"/>
  </body></body></body></worldbody></mujoco>"""
WALL = '<body name="wall" pos="0 {y} 0"><geom type="box" size="1 0.1 1"/></body>'


def gantry(wall: str = "", end: float = 0.3) -> qt.Trajectory:
    """A tool that goes from x = −0.3 to an end, at y = 0.1."""
    model = mujoco.MjModel.from_xml_string(GANTRY.format(wall=wall))
    path = [mink.SE3.from_translation(np.array([x, 0.1, 0.0])) for x in np.linspace(-0.3, end, 7)]
    position = TwistProjector(linear=Projector.full(), angular=Projector.none())
    task = qt.PathTask(
        name="gantry", title="", source=None, scene=Path("gantry.xml"), model=model,
        frame_name="tool", frame_type="site", durations=None, flipped_waypoints=None,
        velocity_limits=None, acceleration_limits=None,
        waypoints=tuple(path), start=np.array([-0.3, 0.1, 0.0]), projector=position,
        operational=position,
    )  # fmt: skip
    return qt.follow(task, "qp_minimum_norm")


def test_a_gantry_has_the_room_to_its_nearest_limit() -> None:
    found = part_tolerance(gantry(), [1e-3, 1e-3, 1e-3], samples=20)
    for widths in (found.proven, found.sampled):
        assert 0.19 <= widths[0] <= 0.2 + 1e-4  # the tolerance of a position error
        np.testing.assert_allclose(widths[:3], widths[0])
        assert not widths[3:].any()
    assert "x" in found.held_by


def test_the_box_has_the_proportions_that_were_asked_for() -> None:
    found = part_tolerance(gantry(), [0.0, 2e-3, 1e-3], samples=20)
    assert 0.38 <= found.sampled[1] <= 0.4 + 1e-4  # from 0.1 to 0.5 m
    np.testing.assert_allclose(found.sampled[[0, 2]], [0.0, 0.5 * found.sampled[1]])


@pytest.mark.parametrize(("body", "room"), [(None, (0.0475, 0.05)), ("wall", (0.1, 0.2))])
def test_a_wall_counts_unless_it_moves_along(body: str | None, room: tuple[float, float]) -> None:
    # From the ball at y = 0.12 to the wall's face are 0.05 m.
    run = gantry(WALL.format(y=0.1 + 0.02 + 0.05 + 0.1))
    found = part_tolerance(run, [1e-3, 1e-3, 1e-3], samples=20, body=body)
    # A wall that moves towards the start of the motion stands in the way to it.
    assert room[0] <= found.sampled[0] <= room[1] + 2e-4
    # The joints move the ball by up to r each, in three directions that the proof adds up; the wall
    # moves by the length of such a shift.
    nearer = 3.0 + (np.sqrt(3.0) if body else 0.0)
    assert 0.05 / nearer / 1.06 <= found.proven[0] <= 0.0501 / nearer


def test_a_turn_takes_room_at_the_ends_of_the_path() -> None:
    """Turned by φ about z, in the middle, the ends are 0.3 m (sin φ) off in y, to the limit 0.5."""
    found = part_tolerance(gantry(), [0, 0, 0, 0, 0, 0.01], samples=20)
    # In x the path gets shorter; in y 0.1 + 0.3 sin φ ≤ 0.5 up to a quarter turn and beyond.
    assert found.sampled[5] > np.pi / 2
    assert 0.0 < found.proven[5] < found.sampled[5]


@pytest.fixture(scope="module")
def robot() -> qt.Trajectory:
    """Fifteen waypoints of the cap, followed step by step, the roll free."""
    task = qt.load_task("deburring").part(np.arange(0, 60, 4))
    return qt.follow(task, "qp_gradient")


def errors(task: qt.PathTask, q: Array, data: mujoco.MjData, position: Array, axis: Array) -> Array:
    """Errors of the tool's point and axis, by MuJoCo."""
    data.qpos[:] = q
    mujoco.mj_kinematics(task.model, data)
    site = data.site(task.frame_name)
    turned = site.xmat.reshape(3, 3)[:, 2]
    return np.concatenate([site.xpos - position, np.cross(axis, turned)])


def test_in_the_proven_box_another_solver_finds_joint_positions(robot: qt.Trajectory) -> None:
    found = part_tolerance(robot, [1e-3, 1e-3, 0.0, 2e-3, 0.0, 0.0], samples=4)
    assert found.proven[0] > 0.0
    assert (found.sampled >= found.proven).all()
    task, rng = robot.path_task, np.random.default_rng(0)
    data = mujoco.MjData(task.model)
    limits = task.model.jnt_range.T
    for row, waypoint in zip(robot.q, task.waypoints, strict=True):
        for corner in rng.choice([-1.0, 1.0], (2, 6)):
            x = corner * found.proven
            turn = mink.SO3.exp(x[3:])
            position = found.about + x[:3] + turn.apply(waypoint.translation() - found.about)
            axis = turn.apply(waypoint.rotation().as_matrix()[:, 2])
            solved = least_squares(
                lambda q: errors(task, q, data, position, axis),  # noqa: B023
                row, bounds=limits, xtol=1e-14, ftol=1e-14, gtol=1e-14,
            )  # fmt: skip
            assert np.abs(solved.fun).max() < 1e-7


def test_a_held_roll_is_reached_by_another_solver_within_the_box(robot: qt.Trajectory) -> None:
    found = part_tolerance(robot, [1e-3, 1e-3, 0.0], roll="held", samples=4)
    assert (found.sampled[:2] > 0.0).all()
    task, rng = robot.path_task, np.random.default_rng(0)
    data = mujoco.MjData(task.model)
    site = data.site(task.frame_name)
    for row in robot.q[::7]:
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        pose = site.xmat.copy()
        position = site.xpos + rng.choice([-1.0, 1.0], 3) * found.sampled[:3]

        def off(q: Array) -> Array:
            data.qpos[:] = q
            mujoco.mj_kinematics(task.model, data)
            return np.concatenate([site.xpos - position, site.xmat - pose])  # noqa: B023

        solved = least_squares(
            off, row, bounds=task.model.jnt_range.T, xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        assert np.abs(solved.fun).max() < 1e-6


def test_what_cannot_be_asked_about_is_refused(robot: qt.Trajectory) -> None:
    with pytest.raises(qt.InvalidInput, match=r"three half-widths, m, or six.*\[0.1, 0.1\]"):
        part_tolerance(robot, [0.1, 0.1])
    with pytest.raises(qt.InvalidInput, match="none below 0 and one above it"):
        part_tolerance(robot, [0.0, 0.0, 0.0])
    with pytest.raises(qt.InvalidInput, match="free, held; got 'fixed'"):
        part_tolerance(robot, roll="fixed")  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="does not keep its path where the part is"):
        part_tolerance(gantry(end=0.6), [1e-3, 1e-3, 1e-3])


def test_the_command_prints_both_boxes(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["tolerance", "planar_line", "--box", "0.001,0.001,0", "--samples", "2"]
    main([*command, "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert facts["sampled"][0] > 0.0
    assert facts["sampled"][2] == 0.0
    main(command)
    printed = capsys.readouterr().out
    assert "nothing is proven (a proof is for tasks that hold the position" in printed
    assert f"sampled: ±({1e3 * facts['sampled'][0]:.3g}" in printed
    assert "none of 2 random placements in this box fails" in printed


def test_shifts_along_which_nothing_holds_the_tool_are_not_asked_about() -> None:
    run = qt.follow(qt.load_task("planar_line"))
    found = part_tolerance(run, [1e-3, 1e-3, 1e-3], samples=2)
    assert found.unheld == ("z",) and found.sampled[2] == 0.0 < found.sampled[0]
    assert str(found).startswith("shifts along z do not matter: the task does not hold them")
    with pytest.raises(qt.InvalidInput, match="does not hold the tool along any of these"):
        part_tolerance(run, [0.0, 0.0, 1e-3])

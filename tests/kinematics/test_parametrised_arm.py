"""Closed forms of arms with given joints, beside Newton's method on MuJoCo's kinematics."""

import dataclasses
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_direction, random_rotation
from oracles.banded_paths import ARM
from oracles.cobots import COBOTS, cobot

import qp_twist as qt
from qp_twist.kinematics import ParametrisedArm, SerialChain
from qp_twist.planning.manifold_net import ManifoldNet
from qp_twist.planning.path_rows import PathRows

pytestmark = pytest.mark.numerical
Array = np.ndarray
FOLDER = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(FOLDER))
plans = import_module("plans")
SEEDS = st.integers(0, 10_000)


def arm_of(joints: Sequence[tuple[Array, Array, str]], tool: Array) -> mujoco.MjModel:
    """A chain of joints, each with its anchor relative to the one before, its axis and type."""
    bodies = "".join(
        f'<body pos="{_text(place)}"><joint name="joint_{k}" axis="{_text(axis)}" type="{kind}"/>'
        '<geom size="0.01" contype="0" conaffinity="0"/>'
        for k, (place, axis, kind) in enumerate(joints, start=1)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}'
        f'<site name="tool" pos="{_text(tool)}" euler="0.3 0.5 -0.4"/>'
        f"{'</body>' * len(joints)}</worldbody></mujoco>"
    )


def _text(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def oblique(rng: np.random.Generator, other: Array) -> Array:
    """A direction at 30° or more from another."""
    while True:
        direction = random_direction(rng)
        if np.linalg.norm(np.cross(direction, other)) > 0.5:
            return direction


def srs(rng: np.random.Generator, miss: float = 0.0) -> mujoco.MjModel:
    """Three axes through a shoulder, one at the elbow, three through a wrist, in any directions.

    With ``miss`` each axis of shoulder and wrist is so far from the one before.
    """
    joints: list[tuple[Array, Array, str]] = []
    axis, nothing = random_direction(rng), np.zeros(3)
    for k in range(7):
        place = nothing
        if k in (0, 3, 4):
            place = rng.uniform(0.2, 0.5) * random_direction(rng)
        elif miss:
            place = miss * np.cross(axis, oblique(rng, axis))
        axis = oblique(rng, axis)
        joints.append((place, axis, "hinge"))
    return arm_of(joints, rng.uniform(-0.2, 0.2, 3))


def ortho_parallel(rng: np.random.Generator, external: int) -> mujoco.MjModel:
    """An industrial arm on some rails, columns and turn tables, placed and turned at random."""
    joints: list[tuple[Array, Array, str]] = [
        (rng.uniform(-0.5, 0.5, 3), random_direction(rng), rng.choice(["hinge", "slide"]))
        for _ in range(external)
    ]
    turn = random_rotation(rng)
    a1, a2, b = rng.uniform(-0.2, 0.2, 3)
    c1, c2, c3 = rng.uniform(0.3, 0.8, 3)
    for place, axis in (
        ((0, 0, 0), (0, 0, 1)), ((a1, 0, c1), (0, 1, 0)), ((0, 0, c2), (0, 1, 0)),
        ((a2, b, 0), (0, 0, 1)), ((0, 0, c3), (0, 1, 0)), ((0, 0, 0), (0, 0, 1)),
    ):  # fmt: skip
        sign = rng.choice([-1.0, 1.0])
        joints.append((turn @ np.array(place, dtype=float), sign * (turn @ axis), "hinge"))
    return arm_of(joints, rng.uniform(-0.2, 0.2, 3))


def panda() -> mujoco.MjModel:
    """The Panda's published lengths: the first three axes meet, the last one is 88 mm aside."""
    places = (
        "0 0 .333|1 0 0 0", "0 0 0|1 -1 0 0", "0 -.316 0|1 1 0 0", ".0825 0 0|1 1 0 0",
        "-.0825 .384 0|1 -1 0 0", "0 0 0|1 1 0 0", ".088 0 0|1 1 0 0",
    )  # fmt: skip
    bodies = "".join(
        f'<body pos="{place.split("|")[0]}" quat="{place.split("|")[1]}">'
        f'<joint name="joint_{k}" range="{low} {high}" limited="true"/><geom size=".01"/>'
        for k, (place, low, high) in enumerate(
            zip(places, (-2.9, -1.8, -2.9, -3.1, -2.9, 0.0, -2.9),
                (2.9, 1.8, 2.9, -0.1, 2.9, 3.7, 2.9), strict=True)
        )
    )  # fmt: skip
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}'
        f'<site name="tool" pos="0 0 .107"/>{"</body>" * 7}</worldbody></mujoco>'
    )


def fetch(lift: bool) -> mujoco.MjModel:
    """The Fetch's published lengths: a shoulder with an offset, and a wrist whose axes meet."""
    joints = [
        ((0.12, 0, 0.35), (0, 0, 1)), ((0.117, 0, 0.06), (0, 1, 0)), ((0.219, 0, 0), (1, 0, 0)),
        ((0.133, 0, 0), (0, 1, 0)), ((0.197, 0, 0), (1, 0, 0)), ((0.1245, 0, 0), (0, 1, 0)),
        ((0.1385, 0, 0), (1, 0, 0)),
    ]  # fmt: skip
    every = [(np.array(p, dtype=float), np.array(a, dtype=float), "hinge") for p, a in joints]
    up = [(np.zeros(3), np.array([0.0, 0.0, 1.0]), "slide")] if lift else []
    return arm_of([*up, *every], np.array([0.17, 0.0, 0.0]))


def pose(model: mujoco.MjModel, q: Array) -> tuple[Array, Array]:
    """Rotation and position of the tool, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return data.site("tool").xmat.reshape(3, 3).copy(), data.site("tool").xpos.copy()


def newton(
    model: mujoco.MjModel, q: Array, moving: list[int], target: tuple[Array, Array]
) -> Array | None:
    """Newton's method with MuJoCo's Jacobian, for six joints; None if it does not converge."""
    data, q = mujoco.MjData(model), q.copy()
    jacobian, site = np.zeros((6, model.nv)), model.site("tool").id
    for _ in range(40):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        left = target[0] @ data.site(site).xmat.reshape(3, 3).T
        error = np.append(target[1] - data.site(site).xpos, qt.geometry.rotation_vector(left))
        if np.abs(error).max() < 1e-10:
            return q
        step = np.linalg.lstsq(jacobian[:, moving], error, rcond=1e-9)[0]
        q[moving] += step / max(1.0, np.abs(step).max() / 0.7)
    return None


def apart(a: Array, b: Array) -> Array:
    return np.abs(np.remainder(a - b + np.pi, 2.0 * np.pi) - np.pi).max(axis=-1)


def recognised(model: mujoco.MjModel) -> list[ParametrisedArm]:
    return ParametrisedArm.recognise(SerialChain.of(model, "tool", "site"))


def check_solutions(model: mujoco.MjModel, arm: ParametrisedArm, q: Array, found: Array) -> None:
    """All branches lead to the pose of q, by MuJoCo, and q is one of them."""
    target = pose(model, q)
    found = found[np.isfinite(found).all(axis=1)]
    assert len(found)
    for own in found:
        np.testing.assert_allclose(own[list(arm.parameters)], q[list(arm.parameters)], atol=1e-12)
        again = pose(model, own)
        np.testing.assert_allclose(again[0], target[0], atol=1e-6)
        np.testing.assert_allclose(again[1], target[1], atol=1e-6)


def offset(rng: np.random.Generator, kind: str, backwards: bool) -> mujoco.MjModel:
    """Six axes of which the last two meet, and the second and third meet or are parallel.

    Or the same from the flange on.
    """
    axes = [random_direction(rng)]
    for _ in range(5):
        axes.append(oblique(rng, axes[-1]))
    points = list(
        np.cumsum(rng.uniform(0.1, 0.4, (6, 1)) * [random_direction(rng) for _ in axes], 0)
    )
    points[5] = points[4] + rng.uniform(-0.2, 0.2) * axes[4]
    if kind == "parallel":
        axes[2] = rng.choice([-1.0, 1.0]) * axes[1]
        axes[3] = oblique(rng, axes[2])
    else:
        points[2] = points[1] + rng.uniform(-0.2, 0.2) * axes[1]
    if backwards:
        axes, points = axes[::-1], points[::-1]
    places = np.diff(points, axis=0, prepend=np.zeros((1, 3)))
    joints = [(place, axis, "hinge") for place, axis in zip(places, axes, strict=True)]
    return arm_of(joints, rng.uniform(-0.2, 0.2, 3))


KINDS = st.sampled_from([
    "srs", "rail", "table", "six", "panda", "fetch", "lift", "UR5e", "CRX-10iA", "xArm6", "Rizon 4",
])  # fmt: skip


def model_of(kind: str, rng: np.random.Generator) -> mujoco.MjModel:
    if kind == "srs":
        return srs(rng)
    if kind in COBOTS:
        return cobot(kind)
    if kind in ("panda", "fetch", "lift"):
        return panda() if kind == "panda" else fetch(kind == "lift")
    return ortho_parallel(rng, {"six": 0, "rail": 1, "table": 2}[kind])


@given(kind=KINDS, seed=SEEDS)
@settings(max_examples=16, deadline=None)
def test_all_solutions_are_found_and_each_is_one(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    compare_with_newton(model_of(kind, rng), rng)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("kind", ["parallel", "meeting"])
def test_roots_of_the_polynomial_are_all_solutions(kind: str, backwards: bool) -> None:
    """Of random arms; where a root is lost to rounding, they are not taken to be exact."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        compare_with_newton(offset(rng, kind, backwards), rng)


def compare_with_newton(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    arms = recognised(model)
    assert arms and all(arm.exact for arm in arms)
    for arm in arms:
        q = rng.uniform(-2.5, 2.5, model.nq)
        target = pose(model, q)
        given_joints = list(arm.parameters)
        found = arm.branches(target[0][None], target[1][None], q[None, given_joints])[0]
        check_solutions(model, arm, q, found)
        moving = [dof for dof in range(model.nv) if dof not in given_joints]
        for _ in range(15):
            start = q.copy()
            start[moving] = rng.uniform(-np.pi, np.pi, 6)
            other = newton(model, start, moving, target)
            if other is not None:
                assert np.nanmin(apart(found, other)) < 1e-5


@pytest.mark.parametrize("name", ["UR5e", "CRX-10iA", "Gen3 6", "xArm6", "Rizon 4"])
def test_no_solution_of_an_arm_without_a_spherical_wrist_is_missing(name: str) -> None:
    """Each configuration is among the solutions of its pose, and all of them lead to it."""
    model = cobot(name)
    arm, rng = recognised(model)[0], np.random.default_rng(6)
    assert arm.exact
    q = rng.uniform(-np.pi, np.pi, (500, model.nv))
    poses = arm.chain.poses(q)
    found = arm.branches(*poses, q[:, list(arm.parameters)])
    assert np.nanmin(apart(found, q[:, None]), axis=1).max() < 1e-5
    pose_of, branch = np.nonzero(np.isfinite(found).all(axis=2))
    for now, target in zip(arm.chain.poses(found[pose_of, branch]), poses, strict=True):
        np.testing.assert_allclose(now, target[pose_of], atol=1e-8)


def test_two_closed_forms_of_an_industrial_arm_agree() -> None:
    """Subproblems of Paden and Kahan, and the formulas of the ortho-parallel arm (py_opw)."""
    task = qt.load_task("deburring")
    (arm,) = recognised(task.model)
    assert arm.parameters == ()
    q = qt.JointRanges.of(task.model).random(50, np.random.default_rng(0))
    rotations, positions = arm.chain.poses(q)
    mine = arm.branches(rotations, positions, q[:, :0])
    for found, *there in zip(mine, rotations, positions, strict=True):
        pose = mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(there[0]), there[1])
        (others,) = ARM.branches(pose, np.zeros(1))
        one, two = (x[np.isfinite(x).all(axis=1)] for x in (found, others))
        assert len(one) == len(two)
        assert apart(one[:, None], two).min(axis=1).max() < 1e-6


@given(seed=SEEDS, joints=st.integers(6, 8))
@settings(max_examples=20, deadline=None)
def test_other_arms_are_not_recognised(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    assert not recognised(random_arm(rng, joints))
    assert not recognised(srs(rng, miss=0.05))


def test_an_arm_that_is_nearly_of_the_kind_is_solved_nearly() -> None:
    """Axes that miss each other by a millimetre, as after a calibration."""
    rng = np.random.default_rng(3)
    model = srs(rng, miss=1e-3)
    arms = recognised(model)
    assert arms and not any(arm.exact for arm in arms)
    for arm in arms:
        q = rng.uniform(-2.5, 2.5, (20, 7))
        poses = [pose(model, own) for own in q]
        rotations, positions = (np.array(part) for part in zip(*poses, strict=True))
        found = arm.branches(rotations, positions, q[:, list(arm.parameters)])
        near = np.nanmin(apart(found, q[:, None]), axis=1, initial=np.inf)
        assert (near < 0.1).mean() > 0.8 and (near > 1e-5).any()


# ---------------------------------------------------------------- layers


def whole_pose(model: mujoco.MjModel, waypoints: tuple[mink.SE3, ...], start: Array) -> qt.PathTask:
    """A task that prescribes all six directions of some poses."""
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    return dataclasses.replace(
        plans.seven(2), model=model, waypoints=waypoints, projector=whole, constraints=(),
        start=start,
    )  # fmt: skip


@pytest.mark.parametrize("arm", ["panda", "seven"])
def test_no_manifold_that_newtons_method_finds_is_missing(arm: str) -> None:
    """All six directions prescribed: from 80 random configurations each."""
    model = panda() if arm == "panda" else plans.seven(2).model
    ranges, rng = qt.JointRanges.of(model), np.random.default_rng(1)
    reached = [pose(model, q) for q in ranges.random(4, rng)]
    waypoints = tuple(
        mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), position)
        for rotation, position in reached
    )
    task = whole_pose(model, waypoints, ranges.random(1, rng)[0])
    net = ManifoldNet(task, PathRows(task), np.radians(8.0))
    count = 0
    for index, target in enumerate(reached):
        layer = net.layer(index).q
        tree = net.seeds.tree(layer)
        for q in ranges.random(80, rng):
            found = newton(model, q, list(range(7)), target)
            if found is None:
                continue
            found -= 2.0 * np.pi * np.round((found - ranges.middle) / (2.0 * np.pi))
            if ranges.inside(found):
                count += 1
                assert tree.query(net.seeds.scaled(found[None]))[0][0] < 2.0
    assert count > 10

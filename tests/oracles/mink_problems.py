"""Problems as mink apps pose them: every kind of mink task and limit, twist tasks among them."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mink
import mujoco
import numpy as np
import qpsolvers

import qp_twist as qt

MODEL = """
<mujoco model="two arms on a cart">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="cart" pos="0 0 0.4">
      <joint name="cart_x" type="slide" axis="1 0 0"/>
      <joint name="cart_y" type="slide" axis="0 1 0"/>
      <joint name="cart_yaw" axis="0 0 1"/>
      <geom name="cart" type="box" size="0.3 0.2 0.1" mass="30"/>
      {left}
      {right}
      <body name="head" pos="0 0 0.6">
        <joint name="neck" type="ball" range="0 1.2"/>
        <geom type="sphere" size="0.08" mass="1"/>
        <site name="camera" pos="0.08 0 0" euler="0 1.5707963 0"/>
      </body>
    </body>
    <body name="obstacle" mocap="true" pos="3 0 1">
      <geom name="obstacle" type="sphere" size="0.1"/></body>
    <body name="drone" pos="1 1 1.5">
      <freejoint name="drone"/>
      <geom name="drone" type="box" size="0.1 0.1 0.03" mass="1"/>
    </body>
    <body name="crank" pos="0 -1 0.5"><joint name="crank" axis="0 1 0" range="-3 3"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.1"/>
      <body name="rod" pos="0.1 0 0"><joint name="rod" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.1"/></body></body>
    <body name="slider" pos="0.4 -1 0.5"><joint name="slider" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.02 0.02 0.02" mass="0.1"/></body>
  </worldbody>
  <equality>
    <connect name="pin" body1="rod" body2="slider" anchor="0.3 0 0"/>
    <joint name="fingers" joint1="left_finger_1" joint2="left_finger_2" polycoef="0 1 0 0 0"/>
  </equality>
</mujoco>
"""
_AXES = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")


def _arm(side: str, y: float) -> str:
    links = "".join(
        f'<body name="{side}_link_{k}" pos="0 0 {0.1 + 0.05 * (k % 3)}">'
        f'<joint name="{side}_{k}" axis="{axis}" range="-2.6 2.6"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.03" mass="1"/>'
        for k, axis in enumerate(_AXES, start=1)
    )
    fingers = "".join(
        f'<body name="{side}_finger_{k}" pos="0 {0.02 * sign} 0.1">'
        f'<joint name="{side}_finger_{k}" type="slide" axis="0 {sign} 0" range="0 0.03"/>'
        '<geom type="box" size="0.005 0.005 0.02" mass="0.05"/></body>'
        for k, sign in ((1, 1), (2, -1))
    )
    hand = (
        f'<site name="{side}_hand" pos="0 0 0.12"/>'
        f'<geom name="{side}_hand" size="0.03" mass="0.2"/>'
    )
    return f'<body pos="0.2 {y} 0.1">{links}{hand}{fingers}{"</body>" * 7}</body>'


def model() -> mujoco.MjModel:
    """A cart with two arms, fingers, a neck; a drone; a crank with a loop."""
    return mujoco.MjModel.from_xml_string(
        MODEL.format(left=_arm("left", 0.2), right=_arm("right", -0.2))
    )


def configuration(seed: int) -> mink.Configuration:
    """A random one, inside the limits."""
    rng = np.random.default_rng(seed)
    robot = model()
    q = robot.qpos0.copy()
    for joint in range(robot.njnt):
        at, kind = robot.jnt_qposadr[joint], int(robot.jnt_type[joint])
        if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            low, high = robot.jnt_range[joint] if robot.jnt_limited[joint] else (-0.3, 0.3)
            q[at] = rng.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low))
        else:
            at += 3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0
            quaternion = np.concatenate([[1.0], 0.2 * rng.normal(size=3)])
            q[at : at + 4] = quaternion / np.linalg.norm(quaternion)
    for name in ("crank", "rod", "slider"):  # the loop closed, to first order
        q[robot.joint(name).qposadr[0]] = 0.01 * rng.normal()
    found = mink.Configuration(robot, q)
    hand = found.get_transform_frame_to_world("left_hand", "site").translation()
    found.data.mocap_pos[0] = hand + np.array([0.15, 0.0, 0.0])  # beside it
    found.update(q)
    return found


@dataclass(frozen=True)
class Problem:
    """What is handed to ``solve_ik``."""

    configuration: mink.Configuration
    tasks: Sequence[mink.tasks.BaseTask]
    limits: Sequence[mink.Limit] | None = None
    constraints: Sequence[mink.Task] = field(default_factory=list)
    dt: float = 0.01


def _near(c: mink.Configuration, name: str, kind: str, rng: np.random.Generator) -> mink.SE3:
    pose = c.get_transform_frame_to_world(name, kind)
    turn = mink.SO3.exp(0.05 * rng.normal(size=3))
    return mink.SE3.from_rotation_and_translation(
        turn @ pose.rotation(), pose.translation() + 0.02 * rng.normal(size=3)
    )


def _around(c: mink.Configuration, rng: np.random.Generator) -> np.ndarray:
    return np.array([2.0, 0.3, 1.0]) + 0.1 * rng.normal(size=3)


def _beside(c: mink.Configuration, rng: np.random.Generator) -> mink.SE3:
    """The left hand's target in the right one's frame."""
    now = c.get_transform_frame_to_world("right_hand", "site").inverse()
    return now @ _near(c, "left_hand", "site", rng)


def _aimed(task: Any, target: Any, by: str = "set_target") -> Any:
    getattr(task, by)(target)
    return task


Make = Callable[[mink.Configuration, np.random.Generator], Any]
HAND = "left_hand", "site"
TASKS: dict[str, Make] = {
    "FrameTask": lambda c, rng: _aimed(
        mink.FrameTask(*HAND, 1.0, 0.5, gain=0.7, lm_damping=0.1), _near(c, *HAND, rng)
    ),
    "RelativeFrameTask": lambda c, rng: _aimed(
        mink.RelativeFrameTask(*HAND, "right_hand", "site", 1.0, 0.3), _beside(c, rng)
    ),
    "AxisAlignTask": lambda c, rng: _aimed(
        mink.AxisAlignTask(*HAND, axis=(0, 0, 1), cost=1.0),
        _near(c, *HAND, rng).rotation().as_matrix()[:, 2],
    ),
    "LookAtTask": lambda c, rng: _aimed(
        mink.LookAtTask("camera", "site", cost=0.8), _around(c, rng)
    ),
    "ComTask": lambda c, rng: _aimed(
        mink.ComTask(cost=2.0), c.data.subtree_com[1] + 0.01 * rng.normal(size=3)
    ),
    "PostureTask": lambda c, rng: _aimed(
        mink.PostureTask(c.model, cost=0.1, gain=0.3),
        c.integrate(0.1 * rng.normal(size=c.model.nv), 1.0),
    ),
    "DampingTask": lambda c, rng: mink.DampingTask(c.model, cost=0.05),
    "KineticEnergyRegularizationTask": lambda c, rng: _aimed(
        mink.KineticEnergyRegularizationTask(cost=1e-4), 0.01, "set_dt"
    ),
    "DofFreezingTask": lambda c, rng: mink.DofFreezingTask(c.model, [0, 1, 2]),
    "EqualityConstraintTask": lambda c, rng: mink.EqualityConstraintTask(
        c.model, cost=1.0, gain=0.5
    ),
    "TwistTask": lambda c, rng: _aimed(
        qt.TwistTask.axis_free(*HAND, gain=0.7), _near(c, *HAND, rng)
    ),
    "TwistTask, relative": lambda c, rng: _aimed(
        qt.TwistTask.line_on_line(*HAND, relative_to=("right_hand", "site")), _beside(c, rng)
    ),
    "GazeTask": lambda c, rng: _aimed(qt.GazeTask("camera", "site"), _around(c, rng), "set_point"),
}
frame, align, look_at, com, posture, damping, freezing, equality, twist = (
    TASKS[name]
    for name in (
        "FrameTask", "AxisAlignTask", "LookAtTask", "ComTask", "PostureTask", "DampingTask",
        "DofFreezingTask", "EqualityConstraintTask", "TwistTask",
    )
)  # fmt: skip
CONSTRAINTS = (
    "FrameTask", "RelativeFrameTask", "ComTask", "DofFreezingTask", "EqualityConstraintTask",
    "TwistTask", "TwistTask, relative", "GazeTask",
)  # fmt: skip
"""Tasks whose rows can be met: those of AxisAlignTask and LookAtTask contradict themselves."""


def _configuration_limit(c: mink.Configuration) -> mink.Limit:
    return mink.ConfigurationLimit(c.model, gain=0.5)


def _velocity_limit(c: mink.Configuration) -> mink.Limit:
    arms = {f"{side}_{k}": 0.8 for side in ("left", "right") for k in range(1, 8)}
    return mink.VelocityLimit(c.model, {**arms, "neck": np.full(3, 1.0), "cart_x": 0.2})


def _collision_limit(c: mink.Configuration) -> mink.Limit:
    arms = [
        g for side in ("left", "right")
        for g in mink.get_subtree_geom_ids(c.model, c.model.body(f"{side}_link_3").id)
    ]  # fmt: skip
    return mink.CollisionAvoidanceLimit(
        c.model, [(arms, ["obstacle", "floor"])],
        minimum_distance_from_collisions=0.1, collision_detection_distance=0.5,
    )  # fmt: skip


def _free_joint_limit(c: mink.Configuration) -> mink.Limit:
    return mink.FreeJointVelocityLimit(
        c.model, max_linear_velocity=0.1, max_angular_velocity=0.2, joint_name="drone"
    )


LIMITS: dict[str, Callable[[mink.Configuration], mink.Limit]] = {
    "ConfigurationLimit": _configuration_limit,
    "VelocityLimit": _velocity_limit,
    "CollisionAvoidanceLimit": _collision_limit,
    "FreeJointVelocityLimit": _free_joint_limit,
}


def drone(c: mink.Configuration, rng: np.random.Generator) -> mink.Task:
    """Moves the free joint, for its limit to hold back."""
    task = mink.FrameTask("drone", "body", 1.0, 1.0)
    task.set_target(_near(c, "drone", "body", rng))
    return task


def into_the_obstacle(c: mink.Configuration) -> mink.Task:
    task = mink.FrameTask("left_hand", "site", 1.0, 0.0)
    hand = c.get_transform_frame_to_world("left_hand", "site")
    task.set_target(mink.SE3.from_translation(hand.translation() + np.array([0.05, 0.0, 0.0])))
    return task


def named(seed: int) -> dict[str, Problem]:
    """Every kind of task as a cost, as a constraint, and every kind of limit."""
    c, problems = configuration(seed), {}
    for name, make in TASKS.items():
        rng = np.random.default_rng([seed, len(name)])
        problems[f"{name} in tasks"] = Problem(c, [make(c, rng), posture(c, rng)])
    for name in CONSTRAINTS:
        rng = np.random.default_rng([seed, len(name), 1])
        constraint = TASKS[name](c, rng)
        assert isinstance(constraint, mink.Task)
        problems[f"{name} in constraints"] = Problem(
            c, [frame(c, rng), posture(c, rng)], constraints=[constraint]
        )
    for name, limit in LIMITS.items():
        rng = np.random.default_rng([seed, len(name), 2])
        tasks = [into_the_obstacle(c), com(c, rng), drone(c, rng), posture(c, rng)]
        problems[f"{name}"] = Problem(c, tasks, limits=[limit(c)])
    rng = np.random.default_rng([seed, 3])
    problems["all limits, constraints"] = Problem(
        c,
        [make(c, rng) for make in (frame, look_at, com, posture, damping, drone)],
        limits=[make(c) for make in LIMITS.values()],
        constraints=[equality(c, rng), freezing(c, rng)],
    )
    problems["no limits"] = Problem(c, [frame(c, rng), posture(c, rng)], limits=[])
    return problems


@dataclass(frozen=True)
class Difference:
    """A velocity against the optimum of the program that mink builds.

    Attributes:
        value: Of the objective above the optimum, as a share of it.
        excess: Largest by which a row of mink's is broken, rad or m.
    """

    value: float
    excess: float


def program(problem: Problem) -> qpsolvers.Problem:
    """What mink builds of a problem, on Δq."""
    for task in (*problem.tasks, *problem.constraints):
        if isinstance(task, qt.TwistTask):
            task.set_dt(problem.dt)
    return mink.build_ik(
        problem.configuration, problem.tasks, problem.dt, 1e-12, problem.limits, problem.constraints
    )


def _optimum(stated: qpsolvers.Problem) -> np.ndarray:
    for tolerance in (1e-12, 1e-10, 1e-9):  # as close as it gets
        tight = {"tol_feas": tolerance, "tol_gap_abs": 1e-2 * tolerance, "tol_gap_rel": tolerance}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of insufficient progress
            found = qpsolvers.solve_problem(stated, solver="clarabel", **tight)
        if found.found and found.x is not None:
            return found.x
    raise AssertionError("the oracle found no optimum")


def difference(problem: Problem, velocity: np.ndarray) -> Difference:
    """Against an interior-point method at its closest, which is neither mink's choice nor ours."""
    stated = program(problem)
    best = np.linalg.solve(stated.P, -stated.q)
    if stated.G is not None or stated.A is not None:
        best = _optimum(stated)

    def value(x: np.ndarray) -> float:
        return float(0.5 * x @ stated.P @ x + stated.q @ x)

    x = velocity * problem.dt
    broken = [0.0]
    if stated.G is not None:
        broken.append(float((stated.G @ x - stated.h).max()))
    if stated.A is not None:
        broken.append(float(np.abs(stated.A @ x - stated.b).max()))
    optimum = value(best)
    return Difference((value(x) - optimum) / abs(optimum), max(broken))

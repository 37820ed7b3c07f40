"""What ``qt.solve_ik`` takes in the place of ``mink.solve_ik``, in apps of the kinds of mink's own.

    pip install --no-deps robosuite==1.5.2   # for the robots of the first part
    python benchmarks/drop_in.py [drop_in] [--steps 1000] [--only NAME] [--write]
    python benchmarks/drop_in.py [drop_in_optimum] [--seeds 20] [--write]

*drop_in*: an arm of six joints and one of seven, two arms, a hand, a humanoid, a quadruped and a
mobile base with two arms follow moving targets for so many steps. At every step both are asked for
the velocity at the same configuration, with the same tasks, limits, constraints and backend (daqp),
in turns one or the other first; then mink's is taken. *Default* leaves out ``limits=``, so that
mink makes a ``ConfigurationLimit`` in each call; *passed* are ``ConfigurationLimit`` and
``VelocityLimit``, made once, *collisions* a ``CollisionAvoidanceLimit`` too; in *held*, feet or a
hand are constraints. Rows are those of mink's program, at most. Times are the processor's, of the
one thread, which other processes of the machine do not lengthen: median and 99th percentile;
*slowed down* counts steps where mink finds no solution, which are left out of the times. Half a
minute.

*drop_in_optimum*: both on every kind of mink task and limit, on the problems of
``tests/oracles/mink_problems.py`` (a cart with two arms, fingers, a neck, a drone and a crank) at
random configurations. The oracle is the program that mink builds, solved by an interior-point
method as closely as it can.
"""

from __future__ import annotations

from page import command, markdown_table

# isort: split
import contextlib
import importlib.util
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import mink
import mujoco
import numpy as np
import qpsolvers
from oracles import mink_problems
from timer import once

import qp_twist as qt

DT, SPEED, WARM = 0.005, 2.5, 20
"""Length of a step, s; joint velocity limit, rad/s and m/s; calls that are not timed."""
APART = 1e-3
"""Largest difference of the two velocities that is put down to mink's backend, as a share."""


def file_of(path: str) -> Path:
    """A model of the robosuite wheel, which is not imported."""
    spec = importlib.util.find_spec("robosuite")
    if spec is None or not spec.submodule_search_locations:
        sys.exit("robosuite is not here; pip install --no-deps robosuite==1.5.2 brings its models.")
    return Path(next(iter(spec.submodule_search_locations))) / "models/assets" / path


def fixed(path: str) -> mujoco.MjModel:
    """A robot as it is shipped."""
    return mujoco.MjModel.from_xml_path(str(file_of(path)))


def driving(path: str) -> mujoco.MjModel:
    """A robot whose base moves in the plane."""
    spec = mujoco.MjSpec.from_file(str(file_of(path)))
    base = spec.body("base")
    for name, kind, axis in (
        ("base_x", mujoco.mjtJoint.mjJNT_SLIDE, (1, 0, 0)),
        ("base_y", mujoco.mjtJoint.mjJNT_SLIDE, (0, 1, 0)),
        ("base_yaw", mujoco.mjtJoint.mjJNT_HINGE, (0, 0, 1)),
    ):
        base.add_joint(name=name, type=kind, axis=axis)
    return spec.compile()


@dataclass
class Follower:
    """A frame whose target goes round in a circle.

    Attributes:
        task: Its task.
        home: Pose around which it moves.
        radius: m; 0 for a target that stays.
        phase: Where on the circle it begins, rad.
    """

    task: mink.FrameTask
    home: mink.SE3
    radius: float
    phase: float

    def move(self, t: float) -> None:
        """Set the target at a time, s."""
        a = 2.0 * np.pi * 0.5 * t + self.phase
        shift = self.radius * np.array([np.cos(a), np.sin(a), 0.5 * np.sin(2.0 * a)])
        turn = mink.SO3.exp(2.0 * self.radius * np.array([np.sin(a), np.cos(a), 0.0]))
        self.task.set_target(
            mink.SE3.from_rotation_and_translation(
                turn @ self.home.rotation(), self.home.translation() + shift
            )
        )


@dataclass
class App:
    """A robot with what it is asked for.

    Attributes:
        configuration: Where it is.
        followers: Frames with moving targets, costs.
        tasks: Other costs.
        damping: mink's.
        held: Frames that stay as they are, as constraints.
        pairs: Groups of geoms that keep apart.
    """

    configuration: mink.Configuration
    followers: list[Follower] = field(default_factory=list)
    tasks: list[mink.tasks.BaseTask] = field(default_factory=list)
    damping: float = 1e-3
    held: list[mink.FrameTask] = field(default_factory=list)
    pairs: list[tuple[list[int], list[int]]] = field(default_factory=list)

    @classmethod
    def of(cls, model: mujoco.MjModel, bend: float, damping: float = 1e-3) -> App:
        """A robot whose joints are a share of the way from where they are to mid-range."""
        q = model.qpos0.copy()
        for joint in np.flatnonzero(model.jnt_limited):
            low, high = model.jnt_range[joint]
            at = model.jnt_qposadr[joint]
            # A quarter of the half range off the middle, so that no arm is straight.
            q[at] += bend * (0.5 * (low + high) + 0.125 * (high - low) - q[at])
        return cls(mink.Configuration(model, q), damping=damping)

    def follow(
        self, frame: str, kind: str, linear: float, angular: float, radius: float, lm: float = 0.0
    ) -> None:
        """Add a frame with a moving target."""
        task = mink.FrameTask(frame, kind, linear, angular, lm_damping=lm)
        home = self.configuration.get_transform_frame_to_world(frame, kind)
        self.followers.append(Follower(task, home, radius, 1.3 * len(self.followers)))

    def hold(self, frame: str, kind: str, angular: float = 1.0) -> None:
        """Add a frame that stays."""
        task = mink.FrameTask(frame, kind, 1.0, angular)
        task.set_target_from_configuration(self.configuration)
        self.held.append(task)

    def keep_posture(self, cost: float) -> None:
        """Add a cost on leaving the posture."""
        task = mink.PostureTask(self.configuration.model, cost)
        task.set_target(self.configuration.q)
        self.tasks.append(task)


def arm(path: str) -> App:
    """The hand of an arm."""
    app = App.of(fixed(path), 0.6)
    app.follow("right_hand", "body", 1.0, 1.0, 0.12, lm=1.0)
    app.keep_posture(1e-2)
    return app


def two_arms() -> App:
    """Both hands, which meet in the middle unless the forearms keep apart."""
    app = App.of(fixed("robots/baxter/robot.xml"), 0.6)
    for side in ("right", "left"):
        app.follow(f"{side}_hand", "body", 1.0, 0.5, 0.15, lm=1.0)
    middle = 0.5 * sum(follower.home.translation() for follower in app.followers)
    for follower in app.followers:
        there = 0.1 * follower.home.translation() + 0.9 * middle
        follower.home = mink.SE3.from_rotation_and_translation(follower.home.rotation(), there)
    app.keep_posture(1e-2)
    model = app.configuration.model
    links = [
        mink.get_subtree_geom_ids(model, model.body(f"{side}_lower_elbow").id)
        for side in ("right", "left")
    ]
    torso = mink.get_body_geom_ids(model, model.body("torso").id)
    app.pairs = [(links[0], links[1]), (links[0] + links[1], torso)]
    return app


def hand() -> App:
    """The fingertips."""
    app = App.of(fixed("grippers/inspire_right_hand.xml"), 0.5, damping=1e-5)
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        app.follow(f"site_r_{finger}_distal", "site", 1.0, 0.0, 0.015)
    app.keep_posture(1e-2)
    return app


def humanoid() -> App:
    """Hands, feet, pelvis and the centre of mass; feet are held as constraints."""
    app = App.of(fixed("robots/gr1/robot.xml"), 0.3, damping=1e-1)
    app.follow("pelvis", "site", 0.0, 10.0, 0.02)
    for site in ("right_center", "left_center"):
        app.follow(site, "site", 5.0, 1.0, 0.08)
    for foot in ("left_foot", "right_foot"):
        app.follow(foot, "body", 10.0, 5.0, 0.0)
        app.hold(foot, "body")
    com = mink.ComTask(cost=200.0)
    com.set_target(app.configuration.data.subtree_com[1].copy())
    app.tasks.append(com)
    app.keep_posture(1e-1)
    return app


def quadruped() -> App:
    """Body and feet."""
    app = App.of(fixed("robots/spot/robot.xml"), 0.5, damping=1e-5)
    app.follow("body", "body", 1.0, 1.0, 0.05)
    for foot in ("FR", "FL", "RR", "RL"):
        app.follow(f"{foot}_center", "site", 1.0, 0.0, 0.0)
    for foot in ("FR_center", "FL_center"):
        app.hold(foot, "site")
    app.keep_posture(1e-5)
    return app


def mobile_base() -> App:
    """Both hands of a robot that drives; its base is slowed down."""
    app = App.of(driving("robots/tiago/robot.xml"), 0.6)
    for side in ("right", "left"):
        app.follow(f"{side}_hand", "body", 1.0, 0.5, 0.2, lm=1e-2)
    app.keep_posture(1e-2)
    model = app.configuration.model
    cost = np.zeros(model.nv)
    cost[[int(model.joint(name).dofadr[0]) for name in ("base_x", "base_y", "base_yaw")]] = 0.3
    app.tasks.append(mink.DampingTask(model, cost))
    return app


APPS: dict[str, Callable[[], App]] = {
    "arm, UR5e": lambda: arm("robots/ur5e/robot.xml"),
    "arm, Panda": lambda: arm("robots/panda/robot.xml"),
    "two arms, Baxter": two_arms,
    "hand, Inspire": hand,
    "humanoid, GR1": humanoid,
    "quadruped, Spot": quadruped,
    "mobile base, Tiago": mobile_base,
}


def limits_of(app: App, way: str) -> list[mink.Limit] | None:
    """Of a way of giving them."""
    if way == "default":
        return None
    model = app.configuration.model
    moved = [model.joint(j) for j in range(model.njnt) if model.jnt_type[j] in (2, 3)]
    found = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, {joint.name: SPEED for joint in moved}),
    ]
    if way == "collisions":
        found.append(
            mink.CollisionAvoidanceLimit(
                model, app.pairs, minimum_distance_from_collisions=0.05,
                collision_detection_distance=0.2,
            )
        )  # fmt: skip
    return found


def ways_of(app: App) -> list[str]:
    """Ways in which limits and constraints are given to an app."""
    ways = ["default", "passed"]
    return ways + ["collisions"] * bool(app.pairs) + ["held"] * bool(app.held)


@dataclass
class Times:
    """Of one app with one way of giving limits."""

    nv: int
    rows: int
    minks: list[float]
    ours: list[float]
    without_solution: int
    apart: float


def times_of(app: App, way: str, steps: int) -> Times:
    """Ask both at every step of a run."""
    c = app.configuration
    start, limits = c.q.copy(), limits_of(app, way)
    followers = app.followers if way != "held" else [f for f in app.followers if f.radius > 0.0]
    tasks = [*(follower.task for follower in followers), *app.tasks]
    constraints = app.held if way == "held" else None
    options = {"damping": app.damping, "limits": limits, "constraints": constraints}
    found = Times(c.model.nv, 0, [], [], 0, 0.0)
    for step in range(-WARM, steps):
        for follower in followers:
            follower.move(DT * step)
        order: Sequence[tuple[Callable[..., np.ndarray], int]]
        order = ((mink.solve_ik, 0), (qt.solve_ik, 1))
        velocities, took = [None, None], [0, 0]
        for solve_ik, who in order if step % 2 else reversed(order):
            with contextlib.suppress(mink.NoSolutionFound):
                call = partial(solve_ik, c, tasks, DT, "daqp", **options)
                took[who], velocities[who] = once(call, time.thread_time_ns)
        theirs, ours = velocities
        assert ours is not None
        if theirs is None:
            found.without_solution += step >= 0
        elif step >= 0:
            found.minks.append(took[0])
            found.ours.append(took[1])
            found.apart = max(
                found.apart, float(np.abs(theirs - ours).max() / (1.0 + np.abs(theirs).max()))
            )
        if step % 50 == 0:
            stated = mink.build_ik(c, tasks, DT, app.damping, limits, constraints)
            rows = sum(len(side) for side in (stated.h, stated.b) if side is not None)
            found.rows = max(found.rows, rows)
        c.integrate_inplace(ours if theirs is None else theirs, DT)
    c.update(start)
    return found


def drop_in(steps: int, only: str) -> str:
    """Times in whole apps."""
    rows = []
    for name, make in APPS.items():
        if only not in name:
            continue
        app = make()
        for way in ways_of(app):
            found = times_of(app, way, steps)
            if found.apart > APART:
                print(f"{name}, {way}: velocities are {found.apart:.1e} apart", file=sys.stderr)
            theirs, ours = (
                1e-3 * np.quantile(times, (0.5, 0.99)) for times in (found.minks, found.ours)
            )
            rows.append((
                name, found.nv, way, found.rows, *(f"{value:.0f}" for value in (*theirs, *ours)),
                *(f"{ratio:.2f}" for ratio in ours / theirs), found.without_solution,
            ))  # fmt: skip
    headings = (
        "app", "nv", "limits", "rows", "`mink.solve_ik`, µs", "p99", "`qt.solve_ik`, µs", "p99",
        "ratio of medians", "of p99", "slowed down",
    )  # fmt: skip
    return markdown_table(headings, rows)


def drop_in_optimum(seeds: int) -> str:
    """How far both are from the optimum, and from their rows."""
    warnings.simplefilter("ignore", qpsolvers.warnings.SparseConversionWarning)
    worst: dict[str, list[float]] = {}
    for seed in range(seeds):
        for name, problem in mink_problems.named(seed).items():
            entry = worst.setdefault(name, [0.0] * 4)
            arguments = problem.configuration, problem.tasks, problem.dt, "daqp"
            options = {"limits": problem.limits, "constraints": problem.constraints}
            for offset, solve_ik in ((0, qt.solve_ik), (2, mink.solve_ik)):
                velocity = solve_ik(*arguments, **options)
                found = mink_problems.difference(problem, velocity)
                entry[offset] = max(entry[offset], abs(found.value))
                entry[offset + 1] = max(entry[offset + 1], found.excess)
    headings = (
        "task or limit", "`qt.solve_ik`: optimum", "rows", "`mink.solve_ik`: optimum", "rows",
    )  # fmt: skip
    rows = [(name, *(f"{value:.0e}" for value in entry)) for name, entry in worst.items()]
    return markdown_table(headings, rows)


if __name__ == "__main__":
    parts = {"drop_in": drop_in, "drop_in_optimum": drop_in_optimum}
    sys.exit(command(__doc__, parts, steps=1000, only="", seeds=20))

"""Random controllers at random configurations: every kind of robot, task, limit and cost, mixed.

A composition is made anew from its seed, so that two implementations of the step can be asked the
same question. :mod:`oracles.two_statements` compares their answers.
"""

from dataclasses import dataclass, field
from typing import Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt

import qp_twist as qt
from oracles.arms import planar_arm, random_arm, random_configuration, random_direction, text

Array = npt.NDArray[np.float64]

KINDS = ("full", "plane", "line", "none")
SITUATIONS = ("regular", "stretched", "at limits", "outside limits", "far target", "met")


@dataclass(eq=False)
class Composition:
    """A question to a controller.

    Attributes:
        model: The robot.
        configuration: Where it is.
        dt: Length of the step, s.
        options: Keyword arguments of :class:`qp_twist.Controller`.
        settings: Attributes of it that are set afterwards.
        velocity: Joint velocity before the step, (nv,), or ``None``.
        use_secondary: As in :meth:`qp_twist.Controller.step`.
        words: What it is made of, for a person who looks for the cause of a difference.
    """

    model: mujoco.MjModel
    configuration: mink.Configuration
    dt: float
    options: dict[str, Any]
    velocity: Array | None
    use_secondary: bool
    settings: dict[str, Any]
    words: list[str] = field(default_factory=list)

    def controller(self, solver: str, *, smooth: bool = False) -> qt.Controller:
        """The controller, with a solver."""
        controller = qt.Controller(self.model, solver=solver, **self.options)
        for name, value in ({"smooth": smooth} | self.settings).items():
            setattr(controller, name, value)
        return controller

    def step(self, solver: str, nudge: Array | None = None, *, smooth: bool = False) -> qt.Step:
        """The step by a solver; ``nudge`` (nv,) moves the configuration a little before it."""
        controller = self.controller(solver, smooth=smooth)
        configuration = self.configuration
        if nudge is not None:
            configuration = mink.Configuration(self.model, configuration.q.copy())
            configuration.integrate_inplace(nudge, 1.0)
        return controller.step(
            configuration, self.dt, use_secondary=self.use_secondary, velocity=self.velocity
        )


class HalfSpaces(mink.Limit):
    """G q̇ ≤ g, the same everywhere: rows of somebody's own limit."""

    def __init__(self, G: Array, g: Array) -> None:
        self.G, self.g = G, g

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=self.g * dt)


def composition(seed: int) -> Composition:
    """The composition of a seed."""
    rng = np.random.default_rng([seed, 20])
    model, robot = _robot(rng)
    situation = SITUATIONS[rng.choice(len(SITUATIONS), p=[0.4, 0.1, 0.15, 0.1, 0.2, 0.05])]
    q = _configuration(model, rng, situation)
    configuration = mink.Configuration(model, q)
    frames = _frames(model)
    tasks: list[qt.TwistTask] = [
        _task(rng, configuration, frames, situation)
        for _ in range(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1]))
    ]
    words = [robot, situation, *(repr(task.projector) for task in tasks)]
    options: dict[str, Any] = {
        "on_infeasible": ("scale", "scale", "relax", "raise")[rng.integers(4)],
        "secondary_space": ("joint", "twist")[rng.integers(2)],
        "limits": _limits(rng, model, q, words),
    }
    others = _soft_tasks(rng, model, q, frames, configuration)
    words += [type(other).__name__ for other in others]
    if rng.random() < 0.35:
        levels: list[list[Any]] = [[task] for task in tasks]
        if others and rng.random() < 0.5 and type(others[0]) is not mink.DampingTask:
            levels.append([others.pop(0)])
        if rng.random() < 0.25:
            levels.insert(0, [_half_spaces(rng, model.nv)])
        options |= {"levels": levels, "tasks": others}
        words.append(f"{len(levels)} levels")
    else:
        options["tasks"] = [*tasks, *others]
    options["secondary"] = _secondary(rng, model, q, tasks)
    if rng.random() < 0.5:
        options["metric"] = rng.uniform(0.3, 3.0, model.nv)
    chosen: dict[str, Any] = {}
    if rng.random() < 0.2:
        chosen["joint_weight"] = 10.0 ** rng.uniform(-4, 1)
    if rng.random() < 0.2:
        chosen["free_twist_costs"] = rng.uniform(0, 3), rng.uniform(0, 3)
    if rng.random() < 0.1:
        chosen["singularity"] = float(rng.choice([0.0, 1e-2, 5e-2]))
    velocity = None
    if rng.random() < 0.5:
        velocity = 0.3 * rng.normal(size=model.nv)
    dt = float(rng.choice([0.002, 0.01, 0.05, 0.2]))
    return Composition(
        model, configuration, dt, options, velocity, bool(rng.random() < 0.85), chosen, words
    )


def _robot(rng: np.random.Generator) -> tuple[mujoco.MjModel, str]:
    kind = rng.random()
    joints = int(rng.integers(1, 15))
    if kind < 0.55:
        slides = joints > 1 and bool(rng.random() < 0.3)
        return random_arm(rng, joints, slides=slides, limited=bool(rng.random() < 0.8)), (
            f"arm of {joints}{' with slides' if slides else ''}"
        )
    if kind < 0.65:
        return planar_arm(rng.uniform(0.2, 1.0, min(joints, 6)).tolist()), "planar arm"
    return _tree(rng), "tree with a free or ball joint"


def _tree(rng: np.random.Generator) -> mujoco.MjModel:
    """One or two arms on a base that is fixed, free or on a ball joint."""
    base = ("", '<freejoint name="base"/>', '<joint name="base" type="ball"/>')[rng.integers(3)]
    arms = ""
    for side in ("left", "right")[: int(rng.integers(1, 3))]:
        opening = closing = ""
        ball = int(rng.integers(0, 6))
        for k in range(int(rng.integers(2, 6))):
            at = text(rng.uniform(0.15, 0.4) * random_direction(rng))
            axis = text(random_direction(rng))
            joint = f'<joint name="{side}_{k}" axis="{axis}" range="-2.5 2.5"/>'
            if k == ball:
                joint = f'<joint name="{side}_{k}" type="ball"/>'
            opening += (
                f'<body name="{side}_link_{k}" pos="{at}">{joint}'
                '<geom size="0.03" mass="1" contype="0" conaffinity="0"/>'
            )
            closing += "</body>"
        arms += f'{opening}<site name="{side}_hand" pos="0.1 0 0.05"/>{closing}'
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="base">'
        f'{base}<geom size="0.1" mass="5" contype="0" conaffinity="0"/>{arms}'
        "</body></worldbody></mujoco>"
    )


def _configuration(model: mujoco.MjModel, rng: np.random.Generator, situation: str) -> Array:
    scalar = _scalar(model)
    if not scalar.all():
        q = model.qpos0.copy()
        mujoco.mj_integratePos(model, q, 0.6 * rng.normal(size=model.nv), 1.0)
    else:
        q = random_configuration(model, rng)
    limited = np.flatnonzero(model.jnt_limited.astype(bool) & scalar)
    if situation == "stretched":
        q[model.jnt_qposadr[scalar]] = 0.0
    elif len(limited) and situation in ("at limits", "outside limits"):
        chosen = rng.permutation(limited)[: int(rng.integers(1, 4))]
        beyond = 0.02 if situation == "outside limits" else 0.0
        side = rng.integers(2, size=len(chosen))
        ends = model.jnt_range[chosen, side]
        q[model.jnt_qposadr[chosen]] = ends + beyond * (2 * side - 1)
    return q


def _scalar(model: mujoco.MjModel) -> npt.NDArray[np.bool_]:
    """Which joints are hinges or slides, (njnt,)."""
    one = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    return np.isin(model.jnt_type, [int(kind) for kind in one])


def _frames(model: mujoco.MjModel) -> list[tuple[str, str]]:
    sites = [(model.site(i).name, "site") for i in range(model.nsite)]
    return sites + [(model.body(i).name, "body") for i in range(2, model.nbody)]


def _projector(rng: np.random.Generator) -> qt.TwistProjector:
    def block() -> qt.Projector:
        kind = KINDS[rng.integers(4)]
        axis = () if kind in ("full", "none") else (random_direction(rng),)
        made: qt.Projector = getattr(qt.Projector, kind)(*axis)
        return made

    frame = ("world", "body", "target")[rng.integers(3)]
    return qt.TwistProjector(linear=block(), angular=block(), frame=frame)  # type: ignore[arg-type]


def _task(
    rng: np.random.Generator,
    configuration: mink.Configuration,
    frames: list[tuple[str, str]],
    situation: str,
) -> qt.TwistTask:
    name, kind = frames[0] if rng.random() < 0.6 else frames[rng.integers(len(frames))]
    pose = configuration.get_transform_frame_to_world(name, kind)
    away = 10.0 ** rng.uniform(-4.0, -1.5)
    away = {"met": 0.0, "far target": 10.0 ** rng.uniform(-0.5, 0.5)}.get(situation, away)
    moved = pose.multiply(mink.SE3.exp(away * rng.normal(size=6)))
    twist = 0.05 * rng.normal(size=6) if rng.random() < 0.3 and situation != "met" else None
    if rng.random() < 0.07:
        gaze = qt.GazeTask(name, kind, axis=random_direction(rng))
        gaze.set_point(moved.translation() + 0.5 * random_direction(rng))
        return gaze
    carrier, projector = None, _projector(rng)
    if len(frames) > 1 and rng.random() < 0.07 and projector.frame != "world":
        carrier = next(frame for frame in frames if frame != (name, kind))
        base = configuration.get_transform_frame_to_world(*carrier)
        moved, twist = base.inverse().multiply(moved), None
    task = qt.TwistTask(
        name, kind, projector, gain=float(rng.choice([1.0, rng.uniform(0.1, 1.0)])),
        max_linear_step=float(rng.choice([np.inf, 0.02])), relative_to=carrier,
    )  # fmt: skip
    task.set_target(moved, twist)
    if rng.random() < 0.3:
        band = _band(rng, away)
        if band.contradiction(task.projector) is None:
            task.bands = [band]
    return task


def _band(rng: np.random.Generator, away: float) -> Any:
    weight = None if rng.random() < 0.6 else 10.0 ** rng.uniform(-1, 3)
    room = min(away * rng.uniform(0.1, 2.0) + 1e-3, 3.0)
    choice = rng.integers(4)
    if choice == 0:
        return qt.RollBand(random_direction(rng), -room, room, weight=weight)
    if choice == 1:
        axis = random_direction(rng)
        return qt.ConeBand(axis, axis, upper=room, weight=weight)
    if choice == 2:
        return qt.SlabBand(random_direction(rng), -room, room, weight=weight)
    return qt.BoxBand([-room] * 3, [room] * 3, weight=weight)


def _half_spaces(rng: np.random.Generator, nv: int) -> HalfSpaces:
    k = int(rng.integers(1, 6))
    G = rng.normal(size=(k, nv)) * (rng.random((k, nv)) < rng.choice([0.2, 0.7, 1.0]))
    g = rng.uniform(0.0, 0.3, k)
    g[rng.random(k) < 0.2] = np.inf
    return HalfSpaces(G, g)


def _limits(
    rng: np.random.Generator, model: mujoco.MjModel, q: Array, words: list[str]
) -> list[mink.Limit] | None:
    if rng.random() < 0.1:
        return None
    limits: list[mink.Limit] = []
    scalar = bool(_scalar(model).all())
    if rng.random() < 0.6:
        limits.append(qt.PositionLimit(model, margin=float(rng.choice([0.0, 0.01]))))
    if rng.random() < 0.4:
        limits.append(
            qt.MotionLimit(
                model, velocity=float(rng.uniform(0.1, 3.0)),
                acceleration=float(rng.choice([np.inf, rng.uniform(1, 80)])),
            )
        )  # fmt: skip
    if rng.random() < 0.2 and scalar:
        limits.append(qt.constraints.DisplacementWindow(model, q, rng.uniform(0.0, 0.3, model.nv)))
    if rng.random() < 0.25:
        limits.append(mink.ConfigurationLimit(model, gain=float(rng.uniform(0.3, 1.0))))
    if rng.random() < 0.25:
        names = [
            model.joint(i).name
            for i in range(model.njnt)
            if _scalar(model)[i] and rng.random() < 0.8
        ]
        if names:
            speeds = {name: float(rng.uniform(0.1, 2.0)) for name in names}
            limits.append(mink.VelocityLimit(model, speeds))
    if rng.random() < 0.2:
        limits.append(_half_spaces(rng, model.nv))
    order = rng.permutation(len(limits))
    limits = [limits[i] for i in order]
    words += [type(limit).__name__ for limit in limits]
    return limits


def _soft_tasks(
    rng: np.random.Generator,
    model: mujoco.MjModel,
    q: Array,
    frames: list[tuple[str, str]],
    configuration: mink.Configuration,
) -> list[Any]:
    others: list[Any] = []
    if rng.random() < 0.2:
        posture = mink.PostureTask(model, cost=rng.uniform(0.1, 2.0))
        wanted = q.copy()
        mujoco.mj_integratePos(model, wanted, 0.1 * rng.normal(size=model.nv), 1.0)
        posture.set_target(wanted)
        others.append(posture)
    if rng.random() < 0.1:
        others.append(mink.DampingTask(model, cost=0.5))
    if rng.random() < 0.12:
        name, kind = frames[-1]
        frame = mink.FrameTask(
            name, kind, position_cost=float(rng.uniform(0, 2)),
            orientation_cost=float(rng.uniform(0, 2)), lm_damping=float(rng.choice([0.0, 1e-2])),
        )  # fmt: skip
        pose = configuration.get_transform_frame_to_world(name, kind)
        frame.set_target(pose.multiply(mink.SE3.exp(0.05 * rng.normal(size=6))))
        others.append(frame)
    return [others[i] for i in rng.permutation(len(others))]


def _secondary(
    rng: np.random.Generator, model: mujoco.MjModel, q: Array, tasks: list[qt.TwistTask]
) -> list[Any]:
    secondary: list[Any] = []
    if rng.random() < 0.5:
        weight = ("gradient", "paper", "natural")[rng.integers(3)]
        secondary.append(qt.JointCentering(model, weight, gain=float(rng.uniform(0.05, 1.0))))  # type: ignore[arg-type]
    if rng.random() < 0.25:
        wanted = q.copy()
        mujoco.mj_integratePos(model, wanted, 0.05 * rng.normal(size=model.nv), 1.0)
        secondary.append(qt.PostureReference(model, wanted, gain=0.5))
    first = tasks[0]
    plain = type(first) is qt.TwistTask and first.relative_to is None
    if rng.random() < 0.1 and plain and 0 < first.projector.rank <= model.nv:
        secondary.append(qt.Manipulability(model, tasks[0], gain=0.1))
    return secondary

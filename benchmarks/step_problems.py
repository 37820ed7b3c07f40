"""The problems of the bench: a robot on a trajectory, the input of every contender at every step.

Three robots for the table, and series of growing ones. Their joint motions are smooth, their limits
as tight as possible without making a step infeasible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import mink
import mujoco
import numpy as np
from step_program import NoReference, Reference, StepProgram, Variant, basis, reference, turn_error

from qp_twist.checks import Array
from qp_twist.errors import QpTwistError
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.paths import shipped_folder

DT = 0.01
"""Length of a step, s."""
STEPS = 200
"""Steps of a trajectory: one period of 2 s."""


@dataclass(frozen=True)
class Frame:
    """A site that follows its poses along the trajectory.

    Attributes:
        site: Its name.
        projector: T, its axes fixed to the frame.
    """

    site: str
    projector: TwistProjector


@dataclass(frozen=True, eq=False)
class Problem:
    r"""A trajectory whose poses are the targets, and the limits around it.

    At step k every contender starts at :math:`q_k` with the poses at :math:`q_{k+1}` as targets:
    the trajectory is fixed, whatever the contenders return. The desired velocity is a share of the
    distance to the middle, :math:`\dot q_0 = k\,(q_{mid} - q)/dt`.

    Attributes:
        model: The robot, its ranges those of the bench.
        frames: The controlled frames.
        q: Configurations, (STEPS + 1, nq).
        speeds: Velocity limits, rad/s, (nv,).
        gain: k.
        levels: Indices of frames by priority; all in one level by default.
        half_spaces: Rows G of G q̇ ≤ g, (m, nv).
        ends: g at every step, (STEPS, m).
    """

    model: mujoco.MjModel
    frames: tuple[Frame, ...]
    q: Array
    speeds: Array
    gain: float
    levels: tuple[tuple[int, ...], ...] = ()
    half_spaces: Array = field(default_factory=lambda: np.zeros((0, 0)))
    ends: Array = field(default_factory=lambda: np.zeros((STEPS, 0)))

    @cached_property
    def middle(self) -> Array:
        """The middle of the ranges, rad, (nv,)."""
        middle: Array = self.model.jnt_range.mean(axis=1)
        return middle

    @cached_property
    def targets(self) -> list[list[mink.SE3]]:
        """Pose of each frame at the end of each step."""
        configuration = mink.Configuration(self.model)
        found = []
        for q in self.q[1:]:
            configuration.update(q)
            found.append(
                [configuration.get_transform_frame_to_world(f.site, "site") for f in self.frames]
            )
        return found

    @property
    def rows(self) -> int:
        """Number of task rows."""
        return sum(frame.projector.rank for frame in self.frames)

    def jacobians(self, k: int) -> tuple[list[Array], list[Array], list[Array]]:
        """Rotation (3, 3), position (3,) and Jacobian (6, nv) of each frame at step k."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.q[k]
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        rotations, positions, jacobians = [], [], []
        for frame in self.frames:
            index = self.model.site(frame.site).id
            jacobian = np.empty((6, self.model.nv))
            mujoco.mj_jacSite(self.model, data, jacobian[:3], jacobian[3:], index)
            rotations.append(data.site_xmat[index].reshape(3, 3).copy())
            positions.append(data.site_xpos[index].copy())
            jacobians.append(jacobian)
        return rotations, positions, jacobians

    def program(self, k: int) -> StepProgram:
        """The program of a step, as arrays."""
        A, b = [], []
        for frame, target, R, p, J in zip(
            self.frames, self.targets[k], *self.jacobians(k), strict=True
        ):
            for block, rows, error in (
                (frame.projector.linear, J[:3], target.translation() - p),
                (
                    frame.projector.angular,
                    J[3:],
                    turn_error(frame.projector.angular, R, target.rotation().as_matrix()),
                ),
            ):
                U = basis(block, R)
                A.append(U.T @ rows)
                b.append(U.T @ error / DT)
        q = self.q[k]
        lower, upper = self.model.jnt_range.T
        return StepProgram(
            self.gain * (self.middle - q) / DT,
            np.vstack(A),
            np.concatenate(b),
            self.half_spaces.reshape(-1, self.model.nv),
            self.ends[k],
            np.maximum((lower - q) / DT, -self.speeds),
            np.minimum((upper - q) / DT, self.speeds),
        )


class NoProblem(QpTwistError):
    """No trajectory was found that is feasible at every step."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The programs of some steps of a problem, and their solutions."""

    programs: dict[int, StepProgram]
    solutions: dict[int, Reference]

    @classmethod
    def of(cls, problem: Problem, steps: Sequence[int]) -> Truth:
        """Solve them.

        Raises:
            NoReference: If a step has no solution.
        """
        programs = {k: problem.program(k) for k in steps}
        return cls(programs, {k: reference(program) for k, program in programs.items()})

    @property
    def active_share(self) -> float:
        """Share of the steps on which a bound or an inequality row has a multiplier above zero."""
        return sum(s.active > 0 for s in self.solutions.values()) / max(1, len(self.solutions))

    def accuracy(
        self, variant: Variant, velocities: Mapping[int, Array]
    ) -> dict[str, float | None]:
        """Largest errors of a contender's velocities by step; empty if there are none.

        Returns:
            ``residual``: ‖Uᵀ(J q̇ − t)‖, m/s and rad/s; ``excess`` over a bound or an inequality
            row, rad/s; ``error``: |q̇ − q̇*| of a joint, rad/s, from the solution of its program,
            ``None`` if it solves another one.
        """
        if not velocities:
            return {}
        error = None
        if variant is not Variant.OTHER:
            right = {
                k: self.solutions[k]
                if variant is Variant.COMMON
                else reference(self.programs[k].of(variant))
                for k in velocities
            }
            error = max(float(np.abs(v - right[k].velocity).max()) for k, v in velocities.items())
        return {
            "residual": max(self.programs[k].residual(v) for k, v in velocities.items()),
            "excess": max(self.programs[k].excess(v) for k, v in velocities.items()),
            "error": error,
        }


# ---------------------------------------------------------------- the problems by name

FULL, NONE = Projector.full(), Projector.none()
Z = (0.0, 0.0, 1.0)
AXIS = TwistProjector(linear=FULL, angular=Projector.plane(Z), frame="body")
"""Position and the direction of the tool axis: five rows."""
POSITION = TwistProjector(linear=FULL, angular=NONE)
LEAST_ACTIVE = 0.25
"""Share of the steps of a problem of the table on which a bound has to be active."""
GAIN = 0.07
"""Desired velocity: share of the distance to the middle of the ranges in a step."""
RANGE_CLEARANCE = 2e-3
"""Margin of the ranges around the motion, at either end, rad."""
SLACK = 1.15
"""Velocity limits, as multiples of each joint's largest speed on the motion."""
SMALLEST_SIGMA = 0.03
"""Least singular value of the task rows along a trajectory, m/rad or 1."""
REACH = 1.5
"""Length of an arm, m, for any number of links."""
TIP = "tip"
_TRIES = 40
_LOOKED_AT = range(0, STEPS, 8)
"""The steps at which a drawn trajectory is checked."""

JOINTS = (3, 6, 12, 24, 40, 60)
PARTS: dict[int, tuple[tuple[int, ...], ...]] = {
    1: ((0, 1, 2, 3),),
    2: ((0, 1), (2, 3)),
    3: ((0,), (1,), (2, 3)),
    4: ((0,), (1,), (2,), (3,)),
}
"""Four frames in one to four levels."""
HALF_SPACES = (0, 1, 4, 16)


@dataclass(frozen=True)
class Planned:
    """A problem of the run, before it is built.

    Attributes:
        group: ``step`` for the table; else the name of the series' parameter.
        x: Value of that parameter; in the table the number of joints.
        title: Title in tables.
        draw: Draws a problem.
        seed: The seed of the first try.
        least: Least share of the steps on which a limit has to be active.
    """

    group: str
    x: int
    title: str
    draw: Callable[[np.random.Generator], Problem]
    seed: tuple[int, int]
    least: float = 0.0

    def make(self, steps: Sequence[int]) -> tuple[Problem, Truth]:
        """The first drawn problem that is regular and has a solution at every step.

        Raises:
            NoProblem: If no drawn problem is feasible.
        """
        for attempt in range(_TRIES):
            problem = self.draw(np.random.default_rng([*self.seed, attempt]))
            if not _regular(problem):
                continue
            try:
                if Truth.of(problem, _LOOKED_AT).active_share < self.least:
                    continue
                truth = Truth.of(problem, steps)
            except NoReference:
                continue
            if truth.active_share >= self.least:
                return problem, truth
        raise NoProblem(
            f"bench: no trajectory among {_TRIES} with a solution at every step (seed "
            f"{self.seed[0]}); give another --seed."
        )


def _regular(problem: Problem) -> bool:
    return all(
        np.linalg.svd(problem.program(k).A, compute_uv=False)[-1] > SMALLEST_SIGMA
        for k in range(0, STEPS, 4)
    )


def table(seed: int) -> Iterator[Planned]:
    """Six, seven and fourteen joints."""
    bent = (0.3, 0.6, -0.4, 1.3, 0.5, 0.9, 0.2)
    yield _robot("six-axis arm", 6, "m16ib_deburring.xml", ("tool",), None, 0.35, seed)
    yield _robot("seven-axis arm", 7, "seven_axis_arm.xml", ("tool",), bent, 0.4, seed)
    tools = ("left_tool", "right_tool")
    yield _robot("two seven-axis arms", 14, "two_arms.xml", tools, bent + bent, 0.4, seed)


def _robot(
    name: str,
    joints: int,
    scene: str,
    sites: Sequence[str],
    middle: Sequence[float] | None,
    amplitude: float,
    seed: int,
) -> Planned:
    def draw(rng: np.random.Generator) -> Problem:
        model = mujoco.MjModel.from_xml_path(str(shipped_folder("scenes") / scene))
        centre = model.key("start").qpos if middle is None else np.array(middle)
        return _along(model, [Frame(site, AXIS) for site in sites], centre, amplitude, rng)

    title = f"{name} (scenes/{scene})"
    return Planned("step", joints, title, draw, (seed, joints), LEAST_ACTIVE)


def growth(seed: int) -> Iterator[Planned]:
    """Vary one number at a time."""
    for joints in JOINTS:
        yield _series("joints", joints, f"{joints} joints, position", joints, POSITION, seed)
    blocks = (
        (Projector.line(Z), NONE), (Projector.plane(Z), NONE), (FULL, NONE),
        (FULL, Projector.line(Z)), (FULL, Projector.plane(Z)), (FULL, FULL),
    )  # fmt: skip
    for rows, (linear, angular) in enumerate(blocks, start=1):
        projector = TwistProjector(linear=linear, angular=angular, frame="body")
        yield _series("rows", rows, f"7 joints, {rows} rows", 7, projector, seed)
    for levels in PARTS:
        yield _levels(levels, seed)
    for rows in HALF_SPACES:
        title = f"7 joints, 5 rows, {rows} inequality rows"
        yield _series("inequalities", rows, title, 7, AXIS, seed, half_spaces=rows)


def _series(
    group: str,
    x: int,
    title: str,
    joints: int,
    projector: TwistProjector,
    seed: int,
    *,
    half_spaces: int = 0,
) -> Planned:
    def draw(rng: np.random.Generator) -> Problem:
        model = chain_model(joints, rng)
        centre = rng.uniform(-0.5, 0.5, joints) * min(1.0, 12.0 / joints)
        amplitude = 0.4 * min(1.0, 6.0 / joints)
        frames = [Frame(TIP, projector)]
        return _along(model, frames, centre, amplitude, rng, half_spaces=half_spaces)

    return Planned(group, x, title, draw, (seed, joints))


def _levels(levels: int, seed: int) -> Planned:
    """Eight rows of a chain of twelve joints, in one to four strict priorities."""
    line = TwistProjector(linear=Projector.line(Z), angular=NONE, frame="body")
    axis = TwistProjector(linear=NONE, angular=Projector.plane(Z), frame="body")
    at = (TIP, POSITION), (TIP, axis), (site_name(5), line), (site_name(3), axis)

    def draw(rng: np.random.Generator) -> Problem:
        model = chain_model(12, rng)
        centre = rng.uniform(-0.5, 0.5, 12)
        frames = [Frame(*one) for one in at]
        return _along(model, frames, centre, 0.3, rng, levels=PARTS[levels])

    title = f"12 joints, 8 rows in {levels} level{'s' if levels > 1 else ''}"
    return Planned("levels", levels, title, draw, (seed, 12))


def _along(
    model: mujoco.MjModel,
    frames: Sequence[Frame],
    centre: Array,
    amplitude: float,
    rng: np.random.Generator,
    *,
    levels: tuple[tuple[int, ...], ...] = (),
    half_spaces: int = 0,
) -> Problem:
    q = joint_motion(centre, amplitude, rng)
    model.jnt_range[:, 0] = q.min(axis=0) - RANGE_CLEARANCE
    model.jnt_range[:, 1] = q.max(axis=0) + RANGE_CLEARANCE
    model.jnt_limited[:] = 1
    velocities = np.diff(q, axis=0) / DT
    speeds = SLACK * np.abs(velocities).max(axis=0)
    G = rng.normal(size=(half_spaces, model.nv))
    G /= np.linalg.norm(G, axis=1, keepdims=True)
    # The motion itself satisfies them with a margin of 0.1 rad/s.
    ends = velocities @ G.T + 0.1
    return Problem(model, tuple(frames), q, speeds, GAIN, levels, G, ends)


# ---------------------------------------------------------------- motions, ranges, arms


def joint_motion(middle: Array, amplitude: float, rng: np.random.Generator) -> Array:
    """A closed motion of two harmonics a joint around ``middle`` (n,), rad, (STEPS + 1, n)."""
    t = np.linspace(0.0, 2.0 * np.pi, STEPS + 1)[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(middle)))
    share = rng.uniform(0.15, 0.35, len(middle))
    wave = np.sin(t + phase[0]) + share * np.sin(2.0 * t + phase[1])
    size = amplitude * rng.uniform(0.6, 1.0, len(middle))
    motion: Array = middle + size * wave / (1.0 + share)
    return motion


def site_name(joint: int) -> str:
    """Name of the site at the end of a link."""
    return f"after_{joint}"


def chain_model(joints: int, rng: np.random.Generator) -> mujoco.MjModel:
    """A serial arm with hinges about random axes across its links; its last site is ``tip``."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    length = REACH / joints
    for joint in range(joints):
        body = body.add_body(name=f"link_{joint}", pos=[0, 0, 0 if joint == 0 else length])
        angle = 0.5 * np.pi * (joint % 2) + rng.uniform(-0.5, 0.5)
        tilt = rng.uniform(-0.3, 0.3)
        axis = [np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)]
        body.add_joint(name=f"joint_{joint}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.02, 0, 0], fromto=[0, 0, 0, 0, 0, length]
        )
        body.add_site(name=site_name(joint), pos=[0, 0, length])
    body.add_site(name=TIP, pos=[0, 0, length])
    return spec.compile()

"""The bench's problems: three robots for the table, and the series of growing ones.

Their joint motions are smooth, their limits as tight as possible without making a step infeasible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from qp_twist.bench.problem import DT, STEPS, Frame, NoProblem, Problem, Truth
from qp_twist.bench.reference import NoReference
from qp_twist.checks import Array
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.paths import shipped_folder

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
ROWS = (1, 2, 3, 4, 5, 6)
LEVELS = (1, 2, 3, 4)
HALF_SPACES = (0, 1, 4, 16)


@dataclass(frozen=True)
class Planned:
    """A problem of the run, before it is built."""

    group: str
    x: int
    title: str
    make: Callable[[Sequence[int]], tuple[Problem, Truth]]


def table(seed: int) -> Iterator[Planned]:
    """Six, seven and fourteen joints."""
    six = "six-axis arm (scenes/m16ib_deburring.xml)"
    seven = "seven-axis arm (scenes/seven_axis_arm.xml)"
    two = "two seven-axis arms (scenes/two_arms.xml)"
    bent = (0.3, 0.6, -0.4, 1.3, 0.5, 0.9, 0.2)
    yield _robot(6, six, "m16ib_deburring.xml", ("tool",), None, 0.35, seed)
    yield _robot(7, seven, "seven_axis_arm.xml", ("tool",), bent, 0.4, seed)
    yield _robot(14, two, "two_arms.xml", ("left_tool", "right_tool"), bent + bent, 0.4, seed)


def growth(seed: int) -> Iterator[Planned]:
    """Vary one number at a time."""
    for joints in JOINTS:
        yield _series(
            "joints", joints, f"{joints} joints, position", joints, [(TIP, POSITION)], seed
        )
    for rows, projector in zip(ROWS, _by_rank(), strict=True):
        yield _series("rows", rows, f"7 joints, {rows} rows", 7, [(TIP, projector)], seed)
    for levels in LEVELS:
        yield _levels(levels, seed)
    for rows in HALF_SPACES:
        title = f"7 joints, 5 rows, {rows} inequality rows"
        yield _series("inequalities", rows, title, 7, [(TIP, AXIS)], seed, half_spaces=rows)


def _by_rank() -> tuple[TwistProjector, ...]:
    """Twist projectors of ranks 1 to 6."""
    blocks = (
        (Projector.line(Z), NONE), (Projector.plane(Z), NONE), (FULL, NONE),
        (FULL, Projector.line(Z)), (FULL, Projector.plane(Z)), (FULL, FULL),
    )  # fmt: skip
    return tuple(TwistProjector(linear=p, angular=r, frame="body") for p, r in blocks)


def _robot(
    joints: int,
    title: str,
    scene: str,
    sites: Sequence[str],
    middle: Sequence[float] | None,
    amplitude: float,
    seed: int,
) -> Planned:
    def draw(rng: np.random.Generator, gain: float) -> Problem:
        model = mujoco.MjModel.from_xml_path(str(shipped_folder("scenes") / scene))
        centre = model.key("start").qpos if middle is None else np.array(middle)
        frames = tuple(Frame(site, AXIS) for site in sites)
        return _along("step", joints, title, model, frames, centre, amplitude, gain, rng)

    return Planned("step", joints, title, lambda steps: _first(draw, steps, [seed, joints]))


def _series(
    group: str,
    x: int,
    title: str,
    joints: int,
    tasks: Sequence[tuple[str, TwistProjector]],
    seed: int,
    *,
    half_spaces: int = 0,
) -> Planned:
    frames = tuple(Frame(site, projector) for site, projector in tasks)

    def draw(rng: np.random.Generator, gain: float) -> Problem:
        model = chain_model(joints, rng)
        centre = rng.uniform(-0.5, 0.5, joints) * min(1.0, 12.0 / joints)
        amplitude = 0.4 * min(1.0, 6.0 / joints)
        return _along(
            group, x, title, model, frames, centre, amplitude, gain, rng, half_spaces=half_spaces
        )

    return Planned(group, x, title, lambda steps: _first(draw, steps, [seed, joints], least=0.0))


def _levels(levels: int, seed: int) -> Planned:
    """Eight rows of a chain of twelve joints, in one to four strict priorities."""
    line = TwistProjector(linear=Projector.line(Z), angular=NONE, frame="body")
    axis = TwistProjector(linear=NONE, angular=Projector.plane(Z), frame="body")
    middle = Frame(site_name(5), line)
    frames = (Frame(TIP, POSITION), Frame(TIP, axis), middle, Frame(site_name(3), axis))
    parts: dict[int, tuple[tuple[int, ...], ...]] = {
        1: ((0, 1, 2, 3),),
        2: ((0, 1), (2, 3)),
        3: ((0,), (1,), (2, 3)),
        4: ((0,), (1,), (2,), (3,)),
    }
    title = f"12 joints, 8 rows in {levels} level{'s' if levels > 1 else ''}"

    def draw(rng: np.random.Generator, gain: float) -> Problem:
        model = chain_model(12, rng)
        centre = rng.uniform(-0.5, 0.5, 12)
        return _along(
            "levels", levels, title, model, frames, centre, 0.3, gain, rng, levels=parts[levels]
        )

    return Planned(
        "levels", levels, title, lambda steps: _first(draw, steps, [seed, 12], least=0.0)
    )


def _along(
    group: str,
    x: int,
    title: str,
    model: mujoco.MjModel,
    frames: tuple[Frame, ...],
    centre: Array,
    amplitude: float,
    gain: float,
    rng: np.random.Generator,
    *,
    levels: tuple[tuple[int, ...], ...] = (),
    half_spaces: int = 0,
) -> Problem:
    q = joint_motion(centre, amplitude, rng)
    set_ranges(model, q)
    G = rng.normal(size=(half_spaces, model.nv))
    G /= np.linalg.norm(G, axis=1, keepdims=True)
    # The motion itself satisfies them with a margin of 0.1 rad/s.
    ends = np.diff(q, axis=0) / DT @ G.T + 0.1
    return Problem(group, x, title, model, frames, q, velocity_limits_of(q), gain, levels, G, ends)


def _first(
    draw: Callable[[np.random.Generator, float], Problem],
    steps: Sequence[int],
    seed: Sequence[int],
    *,
    least: float = LEAST_ACTIVE,
) -> tuple[Problem, Truth]:
    """The first drawn problem that is regular and has a solution at every step.

    Raises:
        NoProblem: If no drawn problem is feasible.
    """
    for attempt in range(_TRIES):
        problem = draw(np.random.default_rng([*seed, attempt]), GAIN)
        if not _regular(problem):
            continue
        try:
            if Truth.of(problem, _LOOKED_AT).active_share < least:
                continue
            truth = Truth.of(problem, steps)
        except NoReference:
            continue
        if truth.active_share >= least:
            return problem, truth
    raise NoProblem(
        f"bench: no trajectory among {_TRIES} with a solution at every step (seed {seed[0]}); give "
        "another --seed."
    )


def _regular(problem: Problem) -> bool:
    return all(
        np.linalg.svd(problem.program(k).A, compute_uv=False)[-1] > SMALLEST_SIGMA
        for k in range(0, STEPS, 4)
    )


# ---------------------------------------------------------------- motions, ranges, arms


def joint_motion(
    middle: Array, amplitude: float, rng: np.random.Generator, steps: int = STEPS
) -> Array:
    """A closed motion of two harmonics a joint around ``middle`` (n,), rad, (steps + 1, n)."""
    t = np.linspace(0.0, 2.0 * np.pi, steps + 1)[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(middle)))
    share = rng.uniform(0.15, 0.35, len(middle))
    wave = np.sin(t + phase[0]) + share * np.sin(2.0 * t + phase[1])
    size = amplitude * rng.uniform(0.6, 1.0, len(middle))
    motion: Array = middle + size * wave / (1.0 + share)
    return motion


def set_ranges(model: mujoco.MjModel, q: Array) -> None:
    """Narrow the ranges of all joints to a motion, plus a small margin."""
    model.jnt_range[:, 0] = q.min(axis=0) - RANGE_CLEARANCE
    model.jnt_range[:, 1] = q.max(axis=0) + RANGE_CLEARANCE
    model.jnt_limited[:] = 1


def velocity_limits_of(q: Array) -> Array:
    """Velocity limits a little above the speeds of a motion, rad/s, (n,)."""
    speeds: Array = SLACK * np.abs(np.diff(q, axis=0)).max(axis=0) / DT
    return speeds


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

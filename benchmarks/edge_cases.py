"""How the step behaves where the target leaves the reach, crosses singularities or jumps.

    python benchmarks/edge_cases.py [edge_cases edge_excursions edge_settling edge_noise
        edge_exceptions] [--arms seven,six,two] [--only out,jump] [--runs 40] [--soft-runs 40]
        [--first 0] [--figure FILE] [--write]

Every case is run at 200 Hz with joint speeds up to pi/2 rad/s by mink's soft frame task and by the
controller with ``scale`` and ``relax``, each with the default acceleration limit (full speed within
50 ms) and with one of 10 rad/s^2.
Shown are rms joint acceleration (rad/s^2), sign changes of joints that move faster than 0.3 rad/s
from one step to the next, mean position error (mm), and for all four settings of the controller the
largest final error and the largest excess over position, velocity and acceleration limits. An
excursion is a smooth random motion of the target about home, in and out of the reach, and back.
"""

from page import command, in_processes, markdown_table

# isort: split
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt
from oracles.arms import seven_axes

import qp_twist as qt

Array = npt.NDArray[np.float64]
Pose = mink.SE3
DT = 0.005
FASTEST = 0.5 * np.pi
HARDEST = 10.0
FLIP = 0.3
"""Speed above which a change of sign counts, rad/s."""
AT_ONCE = 2000
"""Excursions side by side."""
APART = '<geom size="0.05" mass="2" contype="0" conaffinity="0"/>'
"""Links that touch nothing."""
SCENES = Path(qt.__file__).parents[1] / "scenes"


@dataclass(eq=False)
class Arm:
    """A robot, the frames that it moves, and where it starts."""

    name: str
    model: mujoco.MjModel
    home: Array
    frames: tuple[str, ...]
    shoulder: Array
    wrist: tuple[int, ...]
    """Joint whose zero straightens the wrist, of each frame's arm."""
    posture: Array = field(init=False)

    def __post_init__(self) -> None:
        self.posture = self.home

    def poses(self, q: Array) -> list[Pose]:
        """Where the frames are."""
        configuration = mink.Configuration(self.model, q)
        return [configuration.get_transform_frame_to_world(name, "site") for name in self.frames]


def all_arms() -> dict[str, Arm]:
    """Six axes, seven axes, and two arms of seven."""
    deburring = qt.load_task("deburring")
    seven = np.array([0, 0.5, 0, -1.4, 0, 1.2, 0])
    two = mujoco.MjModel.from_xml_path(str(SCENES / "two_arms.xml"))
    both = np.tile([0, 0.5, 0, -1.4, 0, 1.2, 0], 2)
    six = np.array([0.0, 0.3, -0.4, 0.0, -0.9, 0.0])
    return {
        "seven": Arm("seven", seven_axes(APART), seven, ("tool",), np.array([0, 0, 0.36]), (5,)),
        "six": Arm("six", deburring.model, six, ("tool",), np.array([0, 0, 0.74]), (4,)),
        "two": Arm("two", two, both, ("left_tool", "right_tool"), np.array([0, 0, 0.34]), (5, 12)),
    }


class Case(NamedTuple):
    """What the target does."""

    name: str
    start: Array
    target: Callable[[float], list[Pose]]
    twist: Callable[[float], list[Array]] | None
    length: float
    reachable_again: bool


def moved(pose: Pose, by: Array) -> Pose:
    """A pose, shifted along the axes of the world."""
    return Pose.from_rotation_and_translation(pose.rotation(), pose.translation() + by)


def there_and_back(t: float, length: float = 4.0) -> float:
    """0, 1 and 0 again."""
    return float(np.sin(np.pi * min(t / length, 1.0)))


def ramp(t: float, length: float) -> float:
    """From 0 to 1, at rest at both ends."""
    x = min(max(t / length, 0.0), 1.0)
    return 3 * x * x - 2 * x**3


def cases(arm: Arm) -> list[Case]:
    """All cases of an arm; displacements are stated for the seven-axis arm and grow with others."""
    home = arm.poses(arm.home)
    # The first arm's frame goes; a second arm's target stays where it is.
    rest = home[1:]
    first = home[0]
    size = np.linalg.norm(first.translation() - arm.shoulder) / 0.7685

    def shifted(by: Callable[[float], Array]) -> Callable[[float], list[Pose]]:
        return lambda t: [moved(first, size * by(t)), *rest]

    def line(*by: float) -> Callable[[float], list[Pose]]:
        return shifted(lambda t: np.array(by) * there_and_back(t))

    found: list[Case] = []

    def add(
        name: str, target: Callable[[float], list[Pose]], length: float = 6.0, *,
        start: Array = arm.home, twist: Any = None, again: bool = True,
    ) -> None:  # fmt: skip
        found.append(Case(name, start, target, twist, length, again))

    add("out", line(0.7, 0, 0))
    add("overhead", line(-0.5, 0, 0.9))
    add("diagonal", line(0.5, 0.5, 0))
    to_shoulder = 0.95 * (arm.shoulder - first.translation())
    add("folded", lambda t: [moved(first, to_shoulder * there_and_back(t)), *rest])
    add("sideways", line(-0.25, 0.9, -0.1))
    add("jump", shifted(lambda t: np.array([0.7, 0.2, 0.1]) * (0.5 < t < 2.5)), 5.0)
    through = 2.0 * (np.append(arm.shoulder[:2], first.translation()[2]) - first.translation())
    add("through base", lambda t: [moved(first, through * there_and_back(t)), *rest])
    noise = 1e-4 * np.random.default_rng(3).normal(size=(4000, 3))
    # Distance along x at which this arm is stretched, by bisection on what relax reaches.
    edge = _edge(arm, first)
    for name, where, amount in (
        ("2 mm inside", edge - 0.002, 0.0),
        ("2 mm inside, noise", edge - 0.002, 1.0),
        ("0.25 mm outside", edge + 0.00025, 0.0),
        ("20 mm outside", edge + 0.020, 0.0),
        ("70 mm outside, noise", edge + 0.070, 1.0),
    ):
        along = np.array([where, 0, 0])
        add(
            name,
            lambda t, along=along, amount=amount: [
                moved(first, along * ramp(t, 2.0) + amount * noise[round(t / DT) % 4000]), *rest
            ],
            5.0,
            again=where < edge and not amount,
        )  # fmt: skip
    conveyor = size * np.array([0.0, 0.35, 0.0])
    add(
        "conveyor leaves",
        lambda t: [moved(first, conveyor * t * (t < 4.0)), *rest],
        9.0,
        twist=lambda t: (
            [np.append(conveyor * (t < 4.0), np.zeros(3))] + [np.zeros(6) for _ in rest]
        ),
    )
    for offset in (0.0, *np.geomspace(1e-4, 0.1, 10)):
        name = "wrist straight" if offset == 0.0 else f"wrist graze {offset:.2g}"
        bent = arm.home.copy()
        bent[arm.wrist[0]] = -0.5

        def wrist(t: float, bent: Array = bent, offset: float = offset) -> list[Pose]:
            q, share = bent.copy(), ramp(t, 3.0)
            q[arm.wrist[0]] = share - 0.5
            pose = arm.poses(q)[0]
            turned = mink.SO3.exp(np.array([offset * np.sin(np.pi * share), 0, 0]))
            rotation = turned @ pose.rotation()
            return [Pose.from_rotation_and_translation(rotation, pose.translation()), *rest]

        add(name, wrist, 4.0, start=bent)
    over = arm.home.copy()
    over[:7] = _overhead(arm)
    above = arm.poses(over)
    for offset in (0.0, *np.geomspace(1e-4, 0.1, 10)):
        name = "shoulder straight" if offset == 0.0 else f"shoulder graze {offset:.2g}"

        def shoulder(t: float, offset: float = offset) -> list[Pose]:
            share = there_and_back(t)
            along = -2.0 * (above[0].translation()[0] - arm.shoulder[0]) * share
            return [moved(above[0], np.array([along, offset * share, 0])), *rest]

        add(name, shoulder, 5.0, start=over)
    return found


def _overhead(arm: Arm) -> Array:
    """Joint angles of the first arm with its tool near the axis of joint 1, above the shoulder."""
    if arm.name == "six":
        return np.array([0.0, -0.5, 1.1, 0.0, 1.0, 0.0])
    return np.array([0, -0.45, 0, -1.2, 0, -0.6, 0])


def _edge(arm: Arm, pose: Pose) -> float:
    """Distance along x at which a target leaves the reach, m: bisection on damped least squares."""
    task = qt.TwistTask.axis_free(arm.frames[0], "site")
    low, high = 0.0, 1.0
    for _ in range(15):
        middle = 0.5 * (low + high)
        configuration = mink.Configuration(arm.model, arm.home.copy())
        task.set_target(moved(pose, np.array([middle, 0, 0])))
        error = np.inf
        for _ in range(150):
            A, b = task.velocity_rows(configuration, 1.0)
            error = float(np.linalg.norm(b))
            damped = A @ A.T + (0.1 * error**2 + 1e-12) * np.eye(len(b))
            configuration.integrate_inplace(A.T @ np.linalg.solve(damped, b), 1.0)
        low, high = (middle, high) if error < 1e-5 else (low, middle)
    return low


Stepper = Callable[[], Array]


class Contender(NamedTuple):
    """Who steps, and how."""

    name: str
    make: Callable[[Arm, mink.Configuration], tuple[Stepper, Callable[..., None]]]


def soft() -> Contender:
    """mink's soft frame task with Levenberg-Marquardt damping, beside a light posture."""

    def make(arm: Arm, configuration: mink.Configuration) -> tuple[Stepper, Callable[..., None]]:
        posture = mink.PostureTask(arm.model, 1e-2)
        posture.set_target(arm.posture)
        tasks = [mink.FrameTask(name, "site", 1.0, 1.0, lm_damping=1.0) for name in arm.frames]
        speeds = {arm.model.joint(i).name: FASTEST for i in range(arm.model.njnt)}
        limits = [mink.ConfigurationLimit(arm.model), mink.VelocityLimit(arm.model, speeds)]

        def aim(poses: Sequence[Pose], twists: Sequence[Array] | None) -> None:
            for task, pose in zip(tasks, poses, strict=True):
                task.set_target(pose)

        def step() -> Array:
            return mink.solve_ik(configuration, [*tasks, posture], DT, "daqp", 1e-3, limits=limits)

        return step, aim

    return Contender("mink soft", make)


def ours(
    mode: str, acceleration: float | None, solver: str | None, singularity: float | None = None
) -> Contender:
    """The controller, with a light posture as its secondary."""

    def make(arm: Arm, configuration: mink.Configuration) -> tuple[Stepper, Callable[..., None]]:
        controller = _controller(arm, mode, acceleration, solver=solver)
        if singularity is not None:
            controller.singularity = singularity

        def aim(poses: Sequence[Pose], twists: Sequence[Array] | None) -> None:
            for i, (task, pose) in enumerate(zip(controller.twist_tasks, poses, strict=True)):
                task.set_target(pose, None if twists is None else twists[i])

        return lambda: controller.step(configuration, DT).velocity, aim

    return Contender(f"{mode}{'' if acceleration is None else f', a = {acceleration:g}'}", make)


class Figures(NamedTuple):
    """What a run shows."""

    rms: float
    flips: int
    mean: float
    final: float
    excess: float
    failures: int
    errors: Array
    """Position error at every step, mm."""


def run(arm: Arm, case: Case, contender: Contender, acceleration: float | None = None) -> Figures:
    """Follow the target for the length of the case."""
    configuration = mink.Configuration(arm.model, case.start.copy())
    step, aim = contender.make(arm, configuration)
    velocities, errors, failures = [], [], 0
    lower, upper = arm.model.jnt_range.T
    excess, before = -np.inf, np.zeros(arm.model.nv)
    for i in range(round(case.length / DT)):
        poses = case.target(i * DT)
        aim(poses, None if case.twist is None else case.twist(i * DT))
        try:
            velocity = step()
        except Exception:
            velocity, failures = np.zeros(arm.model.nv), failures + 1
        configuration.integrate_inplace(velocity, DT)
        q = configuration.q
        excess = max(excess, (q - upper).max(), (lower - q).max(), np.abs(velocity).max() - FASTEST)
        if acceleration is not None:
            excess = max(excess, np.abs(velocity - before).max() - acceleration * DT)
        before = velocity
        velocities.append(velocity)
        places = [configuration.get_transform_frame_to_world(f, "site") for f in arm.frames]
        errors.append(max(
            np.linalg.norm(a.translation() - b.translation())
            for a, b in zip(places, poses, strict=True)
        ))  # fmt: skip
    v = np.array(velocities)
    fast = (v[1:] * v[:-1] < 0.0) & _fast(v[1:], v[:-1])
    rms = float(np.sqrt((np.diff(v, axis=0) ** 2).mean())) / DT
    return Figures(
        rms, int(fast.sum()), 1e3 * float(np.mean(errors)), 1e3 * float(errors[-1]),
        float(excess), failures, 1e3 * np.array(errors),
    )  # fmt: skip


def settling(arm: Arm, solver: str | None, mode: str) -> list[tuple[float, int, float]]:
    """Of six targets 0.2 m away: settled below 1 mm after s, times left again, final error, mm."""
    rng, found = np.random.default_rng(1), []
    for _ in range(6):
        away = rng.normal(size=3)
        away *= 0.2 / np.linalg.norm(away)
        away[2] -= 0.05
        configuration = mink.Configuration(arm.model, arm.home.copy())
        goal = moved(arm.poses(arm.home)[0], away)
        task = qt.TwistTask.axis_free(arm.frames[0], "site")
        task.set_target(goal)
        limit = qt.MotionLimit(arm.model, velocity=FASTEST, acceleration=HARDEST)
        controller = qt.Controller(
            arm.model,
            [task],
            limits=[limit],
            solver=solver,
            on_infeasible=mode,  # type: ignore[arg-type]
        )
        errors = []
        for _ in range(800):
            configuration.integrate_inplace(controller.step(configuration, DT).velocity, DT)
            place = configuration.get_transform_frame_to_world(arm.frames[0], "site")
            errors.append(np.linalg.norm(place.translation() - goal.translation()))
        outside = np.array(errors) > 1e-3
        settled = (int(np.flatnonzero(outside)[-1]) + 1) * DT
        found.append((settled, int((np.diff(outside.astype(int)) == 1).sum()), 1e3 * errors[-1]))
    return found


def wanders(seed: int) -> tuple[Array, Array, Array]:
    """Amplitudes (3, 3) in m and frequencies (3,) in rad/s of a target, and its turn (3,)."""
    rng = np.random.default_rng([seed, 7])
    waves = rng.normal(size=(3, 3)) * rng.uniform(0.05, 0.6)
    rates = rng.uniform(0.5, 4.0, 3)
    return waves, rates, rng.normal(size=3) * rng.uniform(0.0, 0.8)


def random_case(arm: Arm, seed: int) -> Case:
    """The target wanders smoothly about home, in and out of the reach, and comes back."""
    first, rest = arm.poses(arm.home)[0], arm.poses(arm.home)[1:]
    waves, rates, turn = wanders(seed)

    def target(t: float) -> list[Pose]:
        window = there_and_back(t, 2.0)
        by = window * np.sin(np.outer(rates, [t]))[:, 0] @ waves
        rotation = mink.SO3.exp(window * turn) @ first.rotation()
        return [Pose.from_rotation_and_translation(rotation, first.translation() + by), *rest]

    return Case(f"random {seed}", arm.home, target, None, 5.0, True)


SETTINGS = [(mode, limit) for limit in (None, HARDEST) for mode in ("scale", "relax")]


def of_case(arm: Arm, case: Case, solver: str) -> tuple[Figures, list[Figures]]:
    """mink's run and those of the controller in each of the settings."""
    return run(arm, case, soft()), [
        run(arm, case, ours(mode, limit, solver or None), limit) for mode, limit in SETTINGS
    ]


def short(figures: Sequence[Figures]) -> str:
    """The worst of some runs: rms, flips, and the largest mean error."""
    rms, flips, mean = (max(getattr(f, name) for f in figures) for name in Figures._fields[:3])
    return f"{rms:.1f} / {flips} / {mean:.{2 if mean < 1.0 else 1}f}"


def cases_page(arms: str, only: str, solver: str, figure: str) -> tuple[str, int]:
    """A table of all cases; grazes of one singularity are one row, the worst of its eleven."""
    chosen, wrong = tuple(filter(None, only.split(","))), 0
    rows = []
    for name in arms.split(","):
        arm = all_arms()[name]
        groups: dict[str, list[tuple[Figures, list[Figures]]]] = {}
        for case in cases(arm):
            if chosen and not case.name.startswith(chosen):
                continue
            found = of_case(arm, case, solver)
            wrong += sum(f.excess > 1e-9 or f.failures > 0 for f in found[1])
            first = case.name.split()[0]
            group = f"{first}, grazed and straight" if first in ("wrist", "shoulder") else case.name
            groups.setdefault(group, []).append(found)
        for group, found in groups.items():
            mine = [[f for _, four in found for f in [four[k]]] for k in range(4)]
            final = max(f.final for _, four in found for f in four)
            excess = max(f.excess for _, four in found for f in four)
            rows.append(
                (name, group, short([f for f, _ in found]), *map(short, mine), f"{final:.4f}",
                 f"{max(excess, 0.0):.0e}")
            )  # fmt: skip
        if figure and name == "seven":
            draw(arm, groups, figure)
    head = ("arm", "target", "soft task", "scale", "relax", "scale, a = 10", "relax, a = 10")
    return markdown_table((*head, "final mm", "excess"), rows, left=2), wrong


def draw(arm: Arm, groups: dict[str, list[tuple[Figures, list[Figures]]]], file: str) -> None:
    """The position errors of all cases over time, beside each other."""
    import matplotlib.pyplot as plt
    from PIL import Image

    columns = 4
    height = -(-len(groups) // columns)
    plt.rcParams.update({"font.size": 8, "svg.hashsalt": "edge"})
    figure, axes = plt.subplots(
        height, columns, figsize=(10.0, 1.75 * height), layout="constrained", squeeze=False
    )
    for place, (name, found) in zip(axes.flat, groups.items(), strict=False):
        theirs, mine = found[0][0].errors, [f.errors for f in found[0][1][:2]]
        time = DT * np.arange(len(theirs))
        for errors, color, label, width in (
            (theirs, "#999999", "mink, soft task", 2.2),
            (mine[0], "#0b6fa4", "scale", 1.2),
            (mine[1], "#d1570c", "relax", 1.2),
        ):
            place.plot(time, errors, color=color, label=label, linewidth=width)
        place.set_title(name, fontsize=8, loc="left")
        place.spines[["top", "right"]].set_visible(False)
        place.set_ylim(bottom=0.0)
    for place in axes.flat[len(groups) :]:
        place.axis("off")
    for place in axes[:, 0]:
        place.set_ylabel("error / mm")
    for place in axes[-1]:
        place.set_xlabel("time / s")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=130)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(32).save(file, optimize=True)


def noise_page(arms: str, solver: str) -> str:
    """0.1 mm of noise on a target 2 mm inside the edge, and what the error is without noise."""
    arm = all_arms()[arms.partition(",")[0]]
    noisy, quiet = (
        next(c for c in cases(arm) if c.name == name)
        for name in ("2 mm inside, noise", "2 mm inside")
    )
    contenders = [
        (f"`singularity={value:g}`", ours("scale", None, solver or None, singularity=value))
        for value in (0.0001, 0.005, 0.05)
    ]
    rows = []
    for name, who in [*contenders, ("mink's soft task", soft())]:
        f = run(arm, noisy, who)
        rows.append((name, f"{f.rms:.0f}", f.flips, f"{run(arm, quiet, who).final:.2f}"))
    head = ("setting", "rms rad/s²", "sign changes", "error without noise, mm")
    return markdown_table(head, rows)


def settling_page(arms: str, solver: str) -> str:
    """Settling of six targets 0.2 m away, under the acceleration limit."""
    rows = []
    for mode in ("scale", "relax"):
        found = settling(all_arms()[arms.split(",", maxsplit=1)[0]], solver or None, mode)
        times, left, final = zip(*found, strict=True)
        rows.append(
            (mode, ", ".join(f"{t:.2f}" for t in times), max(left), f"{max(final):.5f}")
        )  # fmt: skip
    head = ("mode", "below 1 mm after, s", "left again", "final error at most, mm")
    return markdown_table(head, rows, left=2)


def soft_excursion(seed: int, arm: str) -> Figures:
    """An excursion of an arm by mink's soft task, without its errors."""
    chosen = all_arms()[arm]
    return run(chosen, random_case(chosen, seed), soft())._replace(errors=np.zeros(0))


def rotations(vectors: Array) -> Array:
    """Matrices of rotation vectors (K, 3), by Rodrigues' formula, (K, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    K = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * K @ K


def excursions(arm: Arm, seeds: Sequence[int], mode: str, limit: float | None) -> list[Figures]:
    """The controller's runs of :func:`random_case`, side by side, without their errors."""
    controller = _controller(arm, mode, limit)
    drawn = [wanders(seed) for seed in seeds]
    waves, rates, turn = (np.array(part) for part in zip(*drawn, strict=True))
    home, count = [pose.as_matrix() for pose in arm.poses(arm.home)], len(seeds)
    targets = np.array([np.tile(pose, (count, 1, 1)) for pose in home])
    q, before = np.tile(arm.home, (count, 1)), np.zeros((count, arm.model.nv))
    lower, upper = arm.model.jnt_range.T
    flips, failures = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    square, mean, excess = np.zeros(count), np.zeros(count), np.full(count, -np.inf)
    steps = round(5.0 / DT)
    for i in range(steps):
        window = there_and_back(i * DT, 2.0)
        by = window * np.einsum("ki,kij->kj", np.sin(rates * i * DT), waves)
        targets[0, :, :3, 3] = home[0][:3, 3] + by
        targets[0, :, :3, :3] = rotations(window * turn) @ home[0][:3, :3]
        aims = targets if len(arm.frames) > 1 else targets[0]
        step = qt.batch.step(controller, q, DT, aims, velocity=before)
        failed = np.isnan(step.velocity).any(axis=1)
        failures += failed
        velocity = np.where(failed[:, None], 0.0, step.velocity)
        q = q + DT * velocity
        over = [q - upper, lower - q, np.abs(velocity) - FASTEST]
        if limit is not None:
            over.append(np.abs(velocity - before) - limit * DT)
        excess = np.maximum(excess, np.max(over, axis=(0, 2)))
        if i > 0:
            flips += ((velocity * before < 0.0) & _fast(velocity, before)).sum(axis=1)
            square += ((velocity - before) ** 2).mean(axis=1)
        before = velocity
    rms, final = np.sqrt(square / (steps - 1)) / DT, np.zeros(count)
    for k in range(count):
        places = [pose.translation() for pose in arm.poses(q[k])]
        ends = [targets[n, k, :3, 3] for n in range(len(arm.frames))]
        final[k] = 1e3 * max(np.linalg.norm(a - b) for a, b in zip(places, ends, strict=True))
    found = zip(rms, flips, mean, final, excess, failures, strict=True)
    return [Figures(*figures, errors=np.zeros(0)) for figures in found]


def missing_flips(seed: int, arm: str, mode: str, limit: float | None) -> int:
    """Sign changes of an excursion in steps that do not meet the task.

    The velocity of a step that meets it is not the controller's choice: where a fast target comes
    within reach the task has to be met at once.
    """
    chosen, flips = all_arms()[arm], 0
    case = random_case(chosen, seed)
    configuration = mink.Configuration(chosen.model, case.start.copy())
    controller = _controller(chosen, mode, limit)
    before = np.zeros(chosen.model.nv)
    for i in range(round(case.length / DT)):
        for task, pose in zip(controller.twist_tasks, case.target(i * DT), strict=True):
            task.set_target(pose)
        step = controller.step(configuration, DT)
        if step.status is not qt.Status.SOLVED:
            flips += int(((step.velocity * before < 0.0) & _fast(step.velocity, before)).sum())
        before = step.velocity
        configuration.integrate_inplace(before, DT)
    return flips


def _fast(a: Array, b: Array) -> npt.NDArray[np.bool_]:
    return np.minimum(np.abs(a), np.abs(b)) > FLIP


def _controller(arm: Arm, mode: str, limit: float | None, **options: Any) -> qt.Controller:
    """The controller of all cases, with a light posture as its secondary."""
    return qt.Controller(
        arm.model, [qt.TwistTask.axis_free(name, "site") for name in arm.frames],
        limits=[
            qt.MotionLimit(
                arm.model, velocity=FASTEST, acceleration="default" if limit is None else limit
            )
        ],
        secondary=[qt.PostureReference(arm.model, arm.posture, gain=0.01)],
        on_infeasible=mode, **options,  # type: ignore[arg-type]
    )  # fmt: skip


def exceptions_page() -> str:
    """The six-axis arm where ``relax`` is not as smooth or as close as the soft task, and why.

    Who follows the conveyor that leaves, and who returns; and rms acceleration 0.25 mm outside,
    with and without the last two seconds, in which the secondary leads to the target.
    """
    arm = all_arms()["six"]
    named = {c.name: c for c in cases(arm)}
    case, outside = named["conveyor leaves"], named["0.25 mm outside"]
    both = {"mink's soft task": soft(), "`relax`": ours("relax", None, None)}
    rows = []
    for leaving, first in both.items():
        for returning, second in both.items():
            errors = _handed_over(arm, case, first, second, 4.0)
            away = round(4.0 / DT)
            rows.append((leaving, returning, *(f"{1e3 * e.mean():.0f}" for e in
                         (errors[:away], errors[away:], errors))))  # fmt: skip
    head = ("follows", "returns", "mean error of the first 4 s, mm", "of the other 5 s", "of all")
    conveyor, rows = markdown_table(head, rows, left=2), []
    for name, who in both.items():
        early, whole = (run(arm, outside._replace(length=t), who) for t in (3.0, 5.0))
        figures = f"{early.rms:.2f}", f"{whole.rms:.2f}", f"{early.final:.3f}", f"{whole.final:.4f}"
        rows.append((name, *figures))
    head = ("0.25 mm outside", "rms of 3 s", "rms of 5 s", "error after 3 s, mm", "after 5 s")
    return conveyor + "\n" + markdown_table(head, rows)


def _handed_over(
    arm: Arm, case: Case, first: Contender, second: Contender, at: float
) -> npt.NDArray[np.float64]:
    """Position errors of a run that ``second`` takes over at a time, m."""
    configuration, errors = mink.Configuration(arm.model, case.start.copy()), []
    step, aim = first.make(arm, configuration)
    for i in range(round(case.length / DT)):
        if i == round(at / DT):
            step, aim = second.make(arm, configuration)
        (pose,) = case.target(i * DT)
        aim([pose], None if case.twist is None else case.twist(i * DT))
        configuration.integrate_inplace(step(), DT)
        place = configuration.get_transform_frame_to_world(arm.frames[0], "site")
        errors.append(np.linalg.norm(place.translation() - pose.translation()))
    return np.array(errors)


def excursions_page(arms: str, runs: int, soft_runs: int, first: int, jobs: int) -> tuple[str, int]:
    """Random excursions: how many have more than five sign changes, or end off the target."""
    rows, wrong = [], 0
    for arm in arms.split(","):
        for mode, limit in [("", None), *SETTINGS]:
            seeds = range(first, first + (runs if mode else min(runs, soft_runs)))
            if mode:
                found = [
                    figures
                    for part in range(0, len(seeds), AT_ONCE)
                    for figures in excursions(
                        all_arms()[arm], seeds[part : part + AT_ONCE], mode, limit
                    )
                ]
            else:
                work = partial(soft_excursion, arm=arm)
                found = list(in_processes(work, seeds, jobs or os.cpu_count() or 1))
            flips = np.array([f.flips for f in found])
            final = np.array([f.final for f in found])
            excess = max(f.excess for f in found)
            failures = sum(f.failures for f in found)
            wrong += (int(excess > 1e-9) + failures) if mode else 0
            worst = np.flatnonzero(flips > 5) if mode else ()
            still = [missing_flips(seeds[k], arm, mode, limit) for k in worst]
            above = f"{len(still)}, {sum(f > 5 for f in still)}" if mode else int((flips > 5).sum())
            limited = "default" if limit is None else f"{limit:g}"
            who = arm, mode or "soft task", limited if mode else ""
            quantiles = ", ".join(f"{v:.0f}" for v in np.quantile(flips, (0.5, 0.99, 1.0)))
            rows.append(
                (*who, len(found), quantiles,
                 above,
                 f"{max(f.rms for f in found):.1f}", f"{final.max():.2g}",
                 int((final > 0.1).sum()), f"{max(excess, 0.0):.0e}", failures)
            )  # fmt: skip
    head = (
        "arm", "mode", "a", "runs", "sign changes: median, 99 %, most",
        "above 5, without exact steps", "rms at most", "final error at most, mm",
        "runs above 0.1 mm", "excess", "exceptions",
    )  # fmt: skip
    return markdown_table(head, rows, left=2), wrong


PAGES = {
    "edge_cases": cases_page,
    "edge_excursions": excursions_page,
    "edge_settling": settling_page,
    "edge_noise": noise_page,
    "edge_exceptions": exceptions_page,
}
OPTIONS: dict[str, Any] = {
    "arms": "seven,six,two", "only": "", "solver": "", "figure": "", "runs": 40, "soft_runs": 40,
    "first": 0, "jobs": 0,
}  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(command(__doc__, PAGES, **OPTIONS))

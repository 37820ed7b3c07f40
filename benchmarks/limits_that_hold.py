"""Drive random arms hard and measure by how much any limit is ever broken.

Each arm of hinges and slides gets random ranges, velocity and acceleration limits, a random task
and a random dt, and a command that changes at random: targets within reach and far out of it,
feed-forward twists that reverse, standing still. Seeded: arm 7 is the same arm in every run.

    python benchmarks/limits_that_hold.py [--arms 1000] [--steps 1000] [--first 0] [--jobs 2]
"""

from __future__ import annotations

from page import command, in_processes

# isort: split
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import mink
import mujoco
import numpy as np
import numpy.typing as npt

import qp_twist as qt

Array = npt.NDArray[np.float64]


@dataclass
class Result:
    """What a run shows; results add up.

    Attributes:
        violations: Largest excess over the position (rad, m), velocity (rad/s, m/s) and
            acceleration limits (rad/s², m/s²); negative if they were never reached.
        statuses: How many steps had each status.
        reached: How many joints were, in some step, at a limit of each kind.
        failures: Steps without a result: what was raised, and where.
    """

    violations: dict[str, float] = field(default_factory=dict)
    statuses: Counter[str] = field(default_factory=Counter)
    reached: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    def add(self, other: Result) -> None:
        """Take in the result of another run."""
        for kind, violation in other.violations.items():
            self.violations[kind] = max(self.violations.get(kind, -np.inf), violation)
        self.statuses += other.statuses
        self.reached += other.reached
        self.failures += other.failures


def random_arm(rng: np.random.Generator) -> mujoco.MjModel:
    """A serial chain of 3 to 10 joints, some of which slide and some of which have no range."""
    opening, joints = "", int(rng.integers(3, 11))
    for i in range(joints):
        sliding, unlimited = rng.uniform(size=2) < (0.15, 0.1)
        longest = 0.5 if sliding else 3.0
        ends = f"{rng.uniform(-longest, -0.05)!r} {rng.uniform(0.05, longest)!r}"
        opening += f"""
        <body pos="{_text(rng.normal(0.0, 0.2, 3))}" quat="{_text(rng.normal(size=4))}">
          <joint name="joint_{i + 1}" type="{"slide" if sliding else "hinge"}"
            axis="{_text(rng.normal(size=3))}"
            {'limited="false"' if unlimited else f'range="{ends}"'}/>
          <geom size="0.05" mass="1" contype="0" conaffinity="0"/>"""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{opening}'
        f'<site name="tool" pos="0.1 0 0.2"/>{"</body>" * joints}</worldbody></mujoco>'
    )


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def random_task(rng: np.random.Generator) -> qt.TwistTask:
    """A task with a random projector of rank 1 to 6."""
    direction = rng.normal(size=3)
    blocks = [qt.Projector.full(), qt.Projector.plane(direction), qt.Projector.line(direction)]
    projector = qt.TwistProjector(
        linear=blocks[rng.integers(3)],
        angular=(*blocks, qt.Projector.none())[rng.integers(4)],
        frame=("world", "body", "target")[rng.integers(3)],
    )
    return qt.TwistTask("tool", "site", projector, gain=10.0 ** rng.uniform(-2.0, 0.0))


def commands(
    rng: np.random.Generator, model: mujoco.MjModel, configuration: mink.Configuration
) -> Iterator[tuple[mink.SE3, Array]]:
    """Targets and feed-forward twists without end."""
    low, high = np.where(model.jnt_limited[:, None], model.jnt_range, (-3.0, 3.0)).T
    elsewhere = mink.Configuration(model)
    while True:
        here = configuration.get_transform_frame_to_world("tool", "site")
        twist, period = np.zeros(6), int(rng.integers(1, 60))
        match rng.choice(["reach", "far", "feed", "stand"], p=[0.4, 0.2, 0.3, 0.1]):
            case "reach":
                elsewhere.update(rng.uniform(low, high))
                here = elsewhere.get_transform_frame_to_world("tool", "site")
            case "far":
                here = here.plus(10.0 * rng.normal(size=6))
            case "feed":
                twist = 10.0 ** rng.uniform(-2.0, 1.0) * rng.normal(size=6)
        for k in range(int(rng.integers(1, 100))):
            yield here, twist if k // period % 2 == 0 else -twist


def run_arm(seed: int, steps: int) -> Result:
    """Drive one random arm from rest."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng)
    fastest, hardest = 10.0 ** rng.uniform([[-1.0], [-0.5]], [[1.0], [2.0]], (2, model.nv))
    dt = 10.0 ** rng.uniform(-3.0, -1.0)
    limit = qt.MotionLimit(model, velocity=fastest, acceleration=hardest)
    task = random_task(rng)
    controller = qt.Controller(
        model,
        [task],
        secondary=[qt.JointCentering(model, "natural", gain=0.01)] if rng.uniform() < 0.5 else [],
        secondary_space=("joint", "twist")[rng.integers(2)],
        limits=[limit],
        on_infeasible=("scale", "relax")[rng.integers(2)],
    )
    limited = model.jnt_limited.astype(bool)
    low, high = np.where(limited[:, None], model.jnt_range, (-np.inf, np.inf)).T
    start = rng.uniform(np.where(limited, low, -3.0), np.where(limited, high, 3.0))
    configuration = mink.Configuration(model, start)
    result, before = Result(), np.zeros(model.nv)
    reached = np.zeros((3, model.nv), dtype=bool)
    for k, (target, twist) in zip(range(steps), commands(rng, model, configuration), strict=False):
        task.set_target(target, twist)
        try:
            step = controller.step(configuration, dt)
            velocity = step.velocity
            result.statuses[step.status.name] += 1
        except qt.QpTwistError as error:
            result.failures.append(f"arm {seed}, step {k + 1}: {type(error).__name__}: {error}")
            velocity = np.clip(0.0, *limit.bounds(configuration, dt))
            limit.note(velocity)
        configuration.integrate_inplace(velocity, dt)
        q = configuration.q
        excess = np.array([
            np.maximum(q - high, low - q),
            np.abs(velocity) - fastest,
            np.abs(velocity - before) / dt - hardest,
        ])  # fmt: skip
        for kind, largest in zip(KINDS, excess.max(axis=1), strict=True):
            result.violations[kind] = max(result.violations.get(kind, -np.inf), float(largest))
        reached |= excess > -1e-6
        before = velocity
    result.reached = Counter(dict(zip(KINDS, reached.sum(axis=1).tolist(), strict=True)))
    result.reached["joint"] = model.nv
    return result


KINDS = ("position", "velocity", "acceleration")


def limits_that_hold(arms: int, steps: int, first: int, jobs: int) -> str:
    """Drive arms from this seed on, and report what was broken."""
    total, count = Result(), arms * steps
    for result in in_processes(partial(run_arm, steps=steps), range(first, first + arms), jobs):
        total.add(result)
    lines = [f"{arms} arms × {steps} steps"]
    for kind, unit in zip(KINDS, ("rad, m", "rad/s, m/s", "rad/s², m/s²"), strict=True):
        share = total.reached[kind] / total.reached["joint"]
        lines.append(
            f"largest violation of {kind} limits: {max(total.violations[kind], 0.0):.1e} {unit} "
            f"(reached by {share:.0%} of the joints)"
        )
    lines += [f"steps {name}: {n / count:.2%}" for name, n in sorted(total.statuses.items())]
    lines.append(f"steps without a result: {len(total.failures)}")
    lines += [f"  {failure}" for failure in total.failures[:10]]
    return "\n".join(lines)


if __name__ == "__main__":
    parts = {"limits_that_hold": limits_that_hold}
    sys.exit(command(__doc__, parts, arms=1000, steps=1000, first=0, jobs=2))

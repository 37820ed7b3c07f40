"""A million random steps: is any called solved that is not?

    python benchmarks/false_solved.py [--steps 1000000] [--solver daqp] [--rows 3] [--markdown FILE]

Configurations anywhere inside the limits, singular ones among them, targets from a hair to a
decimetre away, speed limits that are often active. Whatever the kernel calls solved is checked in
NumPy by the conditions of Karush, Kuhn and Tucker: the rows and bounds are stated again, from
`qt.batch.kinematics`, and so is the solution, from the bounds that are touched. Half a minute; with
another solver the steps are taken one by one, in five. With `--rows` each step has so many random
inequality rows, too, and what is called solved is held against quadprog's solution of the program
that is stated again; it is taken one by one. `billion.py` takes a thousand times as many of these
steps.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import mink
import mujoco
import numpy as np
import qpsolvers
from publishing import publish
from step_referee import chain_of, random_problems

import qp_twist as qt

Array = np.ndarray
DT, GAIN = 0.05, 0.3
ROOT = Path(__file__).parent.parent


def perpendicular(axes: Array) -> tuple[Array, Array]:
    """Two unit vectors across each axis, (K, 3)."""
    other = np.eye(3)[np.abs(axes).argmin(axis=1)]
    u = np.cross(axes, other)
    u /= np.linalg.norm(u, axis=1)[:, None]
    return u, np.cross(axes, u)


def random_steps(
    model: mujoco.MjModel,
    speed: float,
    count: int,
    rng: np.random.Generator,
    solver: str = "compiled",
) -> tuple[qt.Controller, Array, Array]:
    """A controller, configurations, and the poses that are their targets."""
    q, targets = random_problems(chain_of(model, "tool"), count, rng)
    controller = qt.Controller(
        model,
        [qt.TwistTask.axis_free("tool", "site")],
        secondary=[qt.JointCentering(model, "natural", gain=GAIN)],
        limits=[qt.MotionLimit(model, velocity=speed)],
        solver=solver,
    )
    return controller, q, targets


def stated(
    model: mujoco.MjModel, q: Array, targets: Array, speed: float
) -> tuple[Array, Array, Array, Array, Array]:
    """A (K, 5, n), b (K, 5), lower and upper (K, n) and the desired velocity (K, n), in NumPy."""
    ranges = qt.JointRanges.of(model)
    found = qt.batch.kinematics(model, "tool", "site", q)
    axis, wanted = found.rotations[:, :, 2], targets[:, :3, 2]
    normal = np.cross(axis, wanted)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, np.einsum("ki,ki->k", axis, wanted))
    turn = normal * (angle / np.where(sine > 0.0, sine, 1.0))[:, None]
    u, v = perpendicular(axis)
    across = np.stack([u, v], axis=1)
    A = np.concatenate([found.jacobians[:, :3], across @ found.jacobians[:, 3:]], axis=1)
    b = np.concatenate(
        [targets[:, :3, 3] - found.positions, np.einsum("kij,kj->ki", across, turn)], axis=1
    ) / DT  # fmt: skip
    lower = np.maximum(-np.maximum(q - ranges.lower, 0.0) / DT, -speed)
    upper = np.minimum(np.maximum(ranges.upper - q, 0.0) / DT, speed)
    return A, b, lower, upper, GAIN * (ranges.middle - q) / DT


def proved(
    A: Array, b: Array, lower: Array, upper: Array, desired: Array, x: Array
) -> tuple[Array, Array, Array, Array]:
    """Residual, excess, gradient of the wrong sign or left over, and error, a row each (K,)."""
    residual = np.abs(np.einsum("kij,kj->ki", A, x) - b).max(axis=1)
    excess = np.maximum(lower - x, x - upper).max(axis=1)
    # A hair is kept from the ends of the ranges.
    close = 1e-9
    low, high = x <= lower + close, x >= upper - close
    free = ~(low | high)
    rows = A * free[:, None, :]
    gradient = x - desired
    # y of least squares on the free joints; what is left must vanish there and push outwards else.
    y = -np.einsum(
        "kij,kj->ki", np.linalg.pinv(rows.transpose(0, 2, 1), rcond=1e-9), gradient * free
    )
    left = gradient + np.einsum("kji,kj->ki", A, y)
    wrong = np.where(free, np.abs(left), 0.0)
    wrong = np.where(low & ~high, np.maximum(-left, 0.0), wrong)
    wrong = np.where(high & ~low, np.maximum(left, 0.0), wrong)
    # The point itself, from the bounds that it touches: x_f = h_f + A_f⁺(b − A_c x_c − A_f h_f).
    held = np.where(free, 0.0, x)
    missing = b - np.einsum("kij,kj->ki", A, held + np.where(free, desired, 0.0))
    exact = held + free * (
        desired + np.einsum("kij,kj->ki", np.linalg.pinv(rows, rcond=1e-9), missing)
    )
    return residual, excess, wrong.max(axis=1), np.abs(x - exact).max(axis=1)


class Rows(mink.Limit):
    """G q̇ ≤ g."""

    def __init__(self, nv: int) -> None:
        self.G, self.g = np.zeros((0, nv)), np.zeros(0)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        return mink.Constraint(G=self.G, h=self.g * dt)


def with_rows(count: int, rows: int, solver: str, model: mujoco.MjModel, speed: float) -> str:
    """A line of the table of steps with inequality rows."""
    rng = np.random.default_rng([model.nv, rows])
    controller, q, targets = random_steps(model, speed, count, rng, solver)
    A, b, lower, upper, desired = stated(model, q, targets, speed)
    [task], [motion], limit = controller.twist_tasks, controller.limits, Rows(model.nv)
    controller = qt.Controller(
        model, [task], secondary=controller.secondary, limits=[motion, limit], solver=solver
    )
    configuration, one = mink.Configuration(model), np.eye(model.nv)
    solved = pushed = 0
    false, worst = np.zeros(3, dtype=int), np.zeros(2)
    for k in range(count):
        configuration.update(q[k])
        task.set_target(mink.SE3.from_matrix(targets[k]))
        motion.note(np.zeros(model.nv))
        limit.G, limit.g = rng.normal(size=(rows, model.nv)), rng.uniform(0.0, 0.5, rows)
        step = controller.step(configuration, DT)
        if step.status is not qt.Status.SOLVED:
            continue
        x = step.velocity
        exact = qpsolvers.solve_qp(
            one, -desired[k], limit.G, limit.g, A[k], b[k], lower[k], upper[k], solver="quadprog"
        )
        size = 1.0 + np.abs(x).max()
        residual = np.abs(A[k] @ x - b[k]).max()
        excess = max((lower[k] - x).max(), (x - upper[k]).max(), (limit.G @ x - limit.g).max())
        error = np.inf if exact is None else np.abs(x - exact).max()
        sigma = np.linalg.svd(A[k], compute_uv=False)
        solved, pushed = solved + 1, pushed + bool(any(x.kind == "Rows" for x in step.binding))
        # Where the rows hang on each other quadprog's solution is no exacter than that.
        fine = sigma[0] / sigma[-1] <= 1e6
        false += [
            residual > 1e-8 * (1.0 + np.abs(b[k]).max()), excess > 1e-8 * size,
            fine and error > 1e-6 * size,
        ]  # fmt: skip
        worst = np.maximum(worst, [residual, error if fine else 0.0])
    return (
        f"| {model.nv} | {count:,} | {solved:,} | {100 * pushed / solved:.0f} | "
        + " | ".join(f"{kind:,}" for kind in false)
        + f" | {worst[0]:.0e} | {worst[1]:.0e} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--solver", default="compiled")
    parser.add_argument("--rows", type=int, default=0)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    active = "a row active" if given.rows else "a limit active"
    lines = [
        f"| joints | steps | called solved | {active}, % | not on their rows | outside their "
        "bounds | not optimal | largest residual | largest error where cond ≤ 10⁶ |",
        "| --: | --: | --: | --: | --: | --: | --: | --: | --: |",
    ]
    false = 0
    chunk = 25_000
    six, seven = qt.load_task("deburring").model, ROOT / "scenes" / "seven_axis_arm.xml"
    for model, speed in ((six, 0.6), (qt.load_robot(seven).model, 0.6)):
        if given.rows:
            lines.append(with_rows(given.steps // 2, given.rows, given.solver, model, speed))
            false += sum(int(kind) for kind in lines[-1].split(" | ")[4:7])
            continue
        began, counts, worst = time.perf_counter(), np.zeros(6, dtype=int), np.zeros(2)
        for number in range(-(-given.steps // (2 * chunk))):
            rng = np.random.default_rng([model.nv, number])
            controller, q, targets = random_steps(model, speed, chunk, rng, given.solver)
            take = plain_steps if given.solver == "compiled" else one_by_one
            velocity, solved = take(controller, q, targets)
            problem = [part[solved] for part in stated(model, q, targets, speed)]
            x = velocity[solved]
            residual, excess, wrong, error = proved(*problem, x)
            size = 1.0 + np.abs(x).max(axis=1)
            sigma = np.linalg.svd(problem[0], compute_uv=False)
            fine = sigma[:, 0] / sigma[:, -1] <= 1e6
            off = residual > 1e-8 * (1.0 + np.abs(problem[1]).max(axis=1))
            active = ((x <= problem[2] + 1e-9) | (x >= problem[3] - 1e-9)).any(axis=1)
            counts += [
                chunk, len(x), active.sum(), off.sum(), (excess > 1e-8 * size).sum(),
                (wrong > 1e-6 * size).sum(),
            ]  # fmt: skip
            worst = np.maximum(worst, [residual.max(), error[fine].max()])
        false += int(counts[3:].sum())
        steps, called, active_steps, *kinds = (int(count) for count in counts)
        lines.append(
            f"| {model.nv} | {steps:,} | {called:,} | {100 * active_steps / called:.0f} | "
            + " | ".join(f"{kind:,}" for kind in kinds)
            + f" | {worst[0]:.0e} | {worst[1]:.0e} |"
        )
        print(f"{model.nv} joints: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    publish("\n".join(lines) + "\n", given.markdown)
    return 1 if false else 0


def plain_steps(controller: qt.Controller, q: Array, targets: Array) -> tuple[Array, Array]:
    """What the kernel returns, and which of it it calls solved at full speed."""
    done = qt.batch.step(controller, q, DT, targets, others=False)
    return done.velocity, ~done.by_reference & (done.scale == 1.0)


def one_by_one(controller: qt.Controller, q: Array, targets: Array) -> tuple[Array, Array]:
    """The same of any solver: steps at full speed, whoever took them."""
    [task], [limit] = controller.twist_tasks, controller.limits
    configuration = mink.Configuration(controller.model)
    velocity, solved = np.zeros(q.shape), np.zeros(len(q), dtype=bool)
    for k, (here, target) in enumerate(zip(q, targets, strict=True)):
        configuration.update(here)
        task.set_target(mink.SE3.from_matrix(target))
        limit.note(np.zeros(len(here)))
        step = controller.step(configuration, DT)
        velocity[k], solved[k] = step.velocity, step.status is qt.Status.SOLVED
    return velocity, solved


if __name__ == "__main__":
    sys.exit(main())

"""How much of a task fits inside bounds: four ways to find out, on random problems.

    python examples/scaling.py [--problems N]

J ~ N(0, 1) with 1–8 joints and 1–n rows, bounds −0.1 − U(0, 1) … 0.1 + U(0, 1), and a goal of
J q₀/σ with q₀ inside, some entries on, the bounds: the share σ of it can be done, if not more. σ is
1 or U(0.1, 0.9). Prints a table against the linear program of the largest scale, which knows
nothing of short steps. 10,000 problems take one to two minutes.
"""

import argparse
import time
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist import closed_form


@dataclass(frozen=True)
class Problem:
    """Find x with J x = s · goal inside the bounds, s ≤ 1 as large as possible."""

    J: np.ndarray
    goal: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sigma: float


def random_problem(seed: int) -> Problem:
    """The problem of a seed."""
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(1, 8, endpoint=True))
    rows = int(rng.integers(1, joints, endpoint=True))
    J = rng.normal(size=(rows, joints))
    lower, upper = -0.1 - rng.uniform(size=joints), 0.1 + rng.uniform(size=joints)
    inside = rng.uniform(lower, upper)
    bound = np.where(rng.uniform(size=joints) < 0.5, lower, upper)
    q0 = np.where(rng.uniform(size=joints) < rng.uniform(), bound, inside)
    sigma = 1.0 if rng.uniform() < 0.5 else float(rng.uniform(0.1, 0.9))
    return Problem(J, J @ q0 / sigma, lower, upper, sigma)


def linear_program(p: Problem) -> tuple[np.ndarray, float]:
    """The largest scale, and a point that has it."""
    bounds = np.column_stack([np.append(p.lower, 0.0), np.append(p.upper, 1.0)])
    result = linprog(
        -np.eye(len(p.lower) + 1)[-1],
        A_eq=np.column_stack([p.J, -p.goal]),
        b_eq=np.zeros(len(p.goal)),
        bounds=bounds,
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return result.x[:-1], float(result.x[-1])


def levels(p: Problem) -> tuple[np.ndarray, float]:
    """What the controller does, on arrays: s first, then the shortest x that has it."""
    solution = qt.solve_levels([(p.J, p.goal)], p.lower, p.upper)
    return solution.x, solution.scale


def saturation(p: Problem, optimal: bool) -> tuple[np.ndarray, float]:
    """Saturation in the null space."""
    result = closed_form.saturation_in_null_space(
        p.J, None, p.goal, p.lower, p.upper, optimal=optimal
    )
    return result.displacement, result.scale


WAYS = {
    "linear program": linear_program,
    "qt.solve_levels": levels,
    "SNS, basic": partial(saturation, optimal=False),
    "SNS, optimal": partial(saturation, optimal=True),
}
HEADINGS = ("", "s ≥ σ", "s = LP's", "largest", "outside", "‖Jx − s goal‖", "mean", "µs")
UNDER = ("", "", "(to 1e-6)", "|s − LP|", "bounds", "largest", "‖x‖", "each")


def measure(problems: int) -> dict[str, np.ndarray]:
    """For each way: s ≥ σ, |s − LP|, excess over the bounds, task error, ‖x‖, µs; a row each."""
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in WAYS}
    for seed in range(problems):
        p = random_problem(seed)
        for name, way in WAYS.items():
            began = time.perf_counter()
            x, s = way(p)
            seconds = time.perf_counter() - began
            if name == "linear program":
                best = s
            excess = max(float((p.lower - x).max()), float((x - p.upper).max()), 0.0)
            error = float(np.linalg.norm(p.J @ x - s * p.goal))
            norm = float(np.linalg.norm(x))
            rows[name].append((s >= p.sigma - 1e-6, abs(s - best), excess, error, norm, seconds))
    return {name: np.array(values) for name, values in rows.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=10_000, help="how many; seeds from 0 on")
    problems = parser.parse_args().problems
    line = "{:<16}{:>9}{:>11}{:>10}{:>10}{:>15}{:>8}{:>7}".format
    print(f"{problems} random problems")
    print(line(*HEADINGS))
    print(line(*UNDER))
    for name, values in measure(problems).items():
        met, shortfall, excess, error, norm, seconds = values.T
        print(
            line(
                name,
                f"{met.mean():.2%}",
                f"{(shortfall <= 1e-6).mean():.2%}",
                f"{shortfall.max():.1e}",
                f"{excess.max():.1e}",
                f"{error.max():.1e}",
                f"{norm.mean():.4f}",
                f"{1e6 * seconds.mean():.0f}",
            )
        )


if __name__ == "__main__":
    main()

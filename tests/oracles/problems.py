"""Hard quadratic programs, by name and at random, with what is known of each by construction.

Every program has a strictly convex cost. Those with a solution are built around a point that
satisfies them; those without contain rows that miss what the bounds allow by a stated margin.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from qp_twist import QuadraticProgram

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A program and whether it has a solution."""

    problem: QuadraticProgram
    feasible: bool


def program(
    H: npt.ArrayLike,
    c: npt.ArrayLike,
    *,
    A: npt.ArrayLike | None = None,
    b: npt.ArrayLike = (),
    G: npt.ArrayLike | None = None,
    g: npt.ArrayLike = (),
    lower: npt.ArrayLike = -np.inf,
    upper: npt.ArrayLike = np.inf,
) -> QuadraticProgram:
    """A quadratic program from what it has; the rest is left out."""
    c = np.asarray(c, dtype=np.float64)
    n = len(c)
    none = np.zeros((0, n))
    return QuadraticProgram(
        np.array(H, dtype=np.float64), c.copy(),
        none if A is None else np.array(A, dtype=np.float64), np.array(b, dtype=np.float64),
        none if G is None else np.array(G, dtype=np.float64), np.array(g, dtype=np.float64),
        np.broadcast_to(np.asarray(lower, dtype=np.float64), (n,)).copy(),
        np.broadcast_to(np.asarray(upper, dtype=np.float64), (n,)).copy(),
    )  # fmt: skip


def positive_definite(rng: np.random.Generator, n: int, condition: float) -> Array:
    """A random symmetric matrix with eigenvalues from 1/condition to 1."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    values = np.geomspace(1.0 / condition, 1.0, n) if n > 1 else np.ones(1)
    H = Q @ np.diag(values) @ Q.T
    return 0.5 * (H + H.T)


def rows_of_condition(rng: np.random.Generator, m: int, n: int, condition: float) -> Array:
    """Random rows (m, n) with singular values from 1/condition to 1."""
    left, _ = np.linalg.qr(rng.normal(size=(m, m)))
    right, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return left @ np.diag(np.geomspace(1.0 / condition, 1.0, m)) @ right[:m]


def _task(seed: int, *, n: int = 6, m: int = 5, fill: float = 0.5) -> Case:
    """A robot's step: minimum norm on m rows, inside bounds of half a rad/s to 3 rad/s."""
    rng = np.random.default_rng(seed)
    upper, lower = rng.uniform(0.5, 3.0, n), -rng.uniform(0.5, 3.0, n)
    x = fill * rng.uniform(lower, upper)
    A = rng.normal(size=(m, n))
    return Case(program(np.eye(n), np.zeros(n), A=A, b=A @ x, lower=lower, upper=upper), True)


def _redundant() -> Case:
    problem = _task(1).problem
    mix = np.random.default_rng(2).normal(size=(3, 5))
    return Case(
        program(
            problem.H, problem.c,
            A=np.vstack([problem.A, mix @ problem.A]),
            b=np.concatenate([problem.b, mix @ problem.b]),
            lower=problem.lower, upper=problem.upper,
        ), True,
    )  # fmt: skip


def _contradicting(by: float) -> Case:
    problem = _redundant().problem
    b = problem.b.copy()
    b[-1] += by * np.linalg.norm(problem.A[-1])
    return Case(replace(problem, b=b), False)


def _tiny_rows(length: float) -> Case:
    """One task row of five is short, as close to a singularity."""
    problem = _task(3).problem
    A, b = problem.A.copy(), problem.b.copy()
    factor = length / np.linalg.norm(A[2])
    A[2] *= factor
    b[2] *= factor
    return Case(
        program(problem.H, problem.c, A=A, b=b, lower=problem.lower, upper=problem.upper), True
    )


def _tiny_inequality(length: float) -> Case:
    rng = np.random.default_rng(4)
    G = rng.normal(size=(4, 5))
    G[1] *= length / np.linalg.norm(G[1])
    x = rng.normal(size=5)
    return Case(program(np.eye(5), -10.0 * G.sum(axis=0) - x, G=G, g=G @ x), True)


def _conditioned_rows(condition: float) -> Case:
    rng = np.random.default_rng(5)
    A = rows_of_condition(rng, 5, 7, condition)
    x = rng.uniform(-1.0, 1.0, 7)
    return Case(program(np.eye(7), np.zeros(7), A=A, b=A @ x, lower=-2.0, upper=2.0), True)


def _conditioned_cost(condition: float) -> Case:
    rng = np.random.default_rng(6)
    H = positive_definite(rng, 7, condition)
    A = rng.normal(size=(3, 7))
    x = rng.uniform(-1.0, 1.0, 7)
    return Case(program(H, H @ rng.normal(size=7), A=A, b=A @ x, lower=-2.0, upper=2.0), True)


def _too_far(by: float) -> Case:
    """A task row that asks for more than the bounds allow, by a margin in the row's direction."""
    problem = _task(7).problem
    A, b = problem.A.copy(), problem.b.copy()
    A[0] /= np.linalg.norm(A[0])
    b[0] = np.maximum(A[0] * problem.upper, A[0] * problem.lower).sum() + by
    return Case(
        program(problem.H, problem.c, A=A, b=b, lower=problem.lower, upper=problem.upper), False
    )


def _empty_box(by: float) -> Case:
    problem = _task(8).problem
    lower = problem.lower.copy()
    lower[3] = problem.upper[3] + by
    return Case(
        program(problem.H, problem.c, A=problem.A, b=problem.b, lower=lower, upper=problem.upper),
        False,
    )


def _opposing_rows(gap: float) -> Case:
    """a·x ≤ −gap and a·x ≥ 0 where gap > 0; a slab of no width where gap is 0."""
    a = np.array([[1.0, 2.0, -1.0]])
    return Case(
        program(np.eye(3), [-1.0, 0.5, 2.0], G=np.vstack([a, -a]), g=[-gap, 0.0]), gap <= 0.0
    )


def _fixed(count: int) -> Case:
    """Joints that must not move: lower == upper."""
    rng = np.random.default_rng(9)
    lower, upper = -np.ones(7), np.ones(7)
    x = rng.uniform(-0.5, 0.5, 7)
    lower[:count] = upper[:count] = x[:count]
    A = rng.normal(size=(2, 7))
    return Case(program(np.eye(7), np.zeros(7), A=A, b=A @ x, lower=lower, upper=upper), True)


def _time_step(dt: float) -> Case:
    """Position limits as velocity bounds, room/dt, and a target some millimetres away."""
    rng = np.random.default_rng(10)
    room = rng.uniform(1e-6, 0.5, size=(2, 6))
    lower, upper = np.maximum(-room[0] / dt, -2.0), np.minimum(room[1] / dt, 2.0)
    J = rng.normal(size=(5, 6))
    x = rng.uniform(lower, upper)
    cost = J.T @ J + 1e-2 * np.eye(6)
    return Case(
        program(cost, -cost @ (1e-3 / dt * rng.normal(size=6)), A=J[:3], b=J[:3] @ x,
                lower=lower, upper=upper), True,
    )  # fmt: skip


def _cost_size(size: float) -> Case:
    rng = np.random.default_rng(11)
    H = size * positive_definite(rng, 6, 1e2)
    A = rng.normal(size=(3, 6))
    x = rng.uniform(-1.0, 1.0, 6)
    return Case(program(H, H @ rng.normal(size=6), A=A, b=A @ x, lower=-1.0, upper=1.0), True)


def _linear_size(size: float) -> Case:
    """The linear cost outweighs the quadratic one, and the bounds decide."""
    rng = np.random.default_rng(12)
    A = rng.normal(size=(2, 6))
    x = rng.uniform(-1.0, 1.0, 6)
    return Case(
        program(np.eye(6), size * rng.normal(size=6), A=A, b=A @ x, lower=-1.0, upper=1.0), True
    )


def _degenerate_vertex() -> Case:
    """Ten half-spaces through one point of three dimensions, which is the optimum."""
    rng = np.random.default_rng(13)
    G = rng.normal(size=(10, 3))
    G /= np.linalg.norm(G, axis=1)[:, None]
    x = np.array([0.3, -0.2, 0.7])
    return Case(program(np.eye(3), -x - 3.0 * G.T @ rng.uniform(0, 1, 10), G=G, g=G @ x), True)


def _corner() -> Case:
    """The only point is a corner of the box: the rows push all joints to their bounds."""
    upper = np.array([1.0, 2.0, 0.5, 0.1])
    A = np.ones((1, 4))
    return Case(
        program(np.eye(4), np.zeros(4), A=A, b=[upper.sum()], lower=-upper, upper=upper), True
    )


def _zero_rows(b: float) -> Case:
    problem = _task(14).problem
    A, sides = problem.A.copy(), problem.b.copy()
    A[2], sides[2] = 0.0, b
    return Case(
        program(problem.H, problem.c, A=A, b=sides, G=np.zeros((1, 6)), g=[0.0],
                lower=problem.lower, upper=problem.upper), b == 0.0,
    )  # fmt: skip


def _nearly_parallel(angle: float) -> Case:
    """Two inequality rows at a small angle, both active at the optimum."""
    G = np.array([[0.0, 1.0, 0.0], [np.sin(angle), np.cos(angle), 0.0]])
    x = np.array([0.5, 0.0, 0.2])
    c = -x - G.T @ np.array([1.0, 1.0])
    return Case(program(np.eye(3), c, G=G, g=G @ x), True)


NAMED: dict[str, Callable[[], Case]] = {
    "a robot's step": lambda: _task(0),
    "square rows": lambda: _task(20, m=6),
    "all at the bounds": _corner,
    "no constraints": lambda: Case(program(np.diag([1.0, 2.0]), [1.0, -4.0]), True),
    "one unknown": lambda: Case(program([[2.0]], [-8.0], lower=-1.0, upper=1.0), True),
    "one unknown, one row": lambda: Case(
        program([[2.0]], [-8.0], A=[[3.0]], b=[1.5], lower=-1.0, upper=1.0), True
    ),
    "one unknown, no room": lambda: Case(
        program([[2.0]], [-8.0], A=[[3.0]], b=[3.1], lower=-1.0, upper=1.0), False
    ),
    "30 unknowns": lambda: _task(15, n=30, m=12, fill=1.0),
    "30 unknowns, 29 rows": lambda: _task(16, n=30, m=29, fill=1.0),
    "redundant rows": _redundant,
    "zero rows": lambda: _zero_rows(0.0),
    "zero row that asks for 1e-3": lambda: _zero_rows(1e-3),
    "degenerate vertex": _degenerate_vertex,
    "slab of no width": lambda: _opposing_rows(0.0),
    "slab turned inside out": lambda: _opposing_rows(1e-3),
    "half-open bounds": lambda: Case(
        program(np.eye(3), [1.0, 1.0, -1.0], lower=[0.0, -np.inf, -np.inf],
                upper=[np.inf, np.inf, 0.5]), True,
    ),
    "all joints fixed": lambda: _fixed(7),
    **{f"{k} joints fixed": (lambda k=k: _fixed(k)) for k in (1, 3, 5)},
    **{f"row of {v:g}": (lambda v=v: _tiny_rows(v)) for v in (1e-4, 1e-6, 1e-7, 1e-8, 1e-9)},
    **{f"inequality of {v:g}": (lambda v=v: _tiny_inequality(v)) for v in (1e-4, 1e-6, 1e-9)},
    **{f"rows of cond {v:g}": (lambda v=v: _conditioned_rows(v)) for v in (1e4, 1e6, 1e8, 1e10)},
    **{f"cost of cond {v:g}": (lambda v=v: _conditioned_cost(v)) for v in (1e4, 1e6, 1e8, 1e10)},
    **{f"task too far by {v:g}": (lambda v=v: _too_far(v)) for v in (1e-3, 1e-1, 1.0, 1e3)},
    **{f"rows contradict by {v:g}": (lambda v=v: _contradicting(v)) for v in (1e-3, 1.0, 1e3)},
    **{f"empty box by {v:g}": (lambda v=v: _empty_box(v)) for v in (1e-3, 1.0, 1e3)},
    **{f"dt of {v:g}": (lambda v=v: _time_step(v)) for v in (1e-4, 1e-3, 1e-2, 1e-1, 1.0)},
    **{f"cost of size {v:g}": (lambda v=v: _cost_size(v)) for v in (1e-8, 1e-4, 1e4, 1e8)},
    **{f"linear cost of {v:g}": (lambda v=v: _linear_size(v)) for v in (1e-8, 1e2, 1e4, 1e8)},
    **{f"rows at {v:g} rad": (lambda v=v: _nearly_parallel(v)) for v in (1e-2, 1e-4, 1e-6, 1e-8)},
}  # fmt: skip
"""The named problems."""


def random_case(seed: int) -> Case:
    """A random program in which each difficulty of the named ones may occur, several at once."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 11)) if rng.random() < 0.95 else int(rng.integers(11, 31))
    m, k = int(rng.integers(0, n + 1)), int(rng.integers(0, n + 1))

    bounded = rng.random(n) < rng.choice([0.0, 0.8, 1.0], p=[0.1, 0.2, 0.7])
    upper = np.where(bounded, 10.0 ** rng.uniform(-2.0, 1.0, n), np.inf)
    lower = np.where(bounded, -(10.0 ** rng.uniform(-2.0, 1.0, n)), -np.inf)
    x = rng.uniform(np.maximum(lower, -3.0), np.minimum(upper, 3.0))
    if rng.random() < 0.3:  # on the bounds
        on = bounded & (rng.random(n) < 0.5)
        x = np.where(on, np.where(rng.random(n) < 0.5, lower, upper), x)
    if rng.random() < 0.15:  # fixed joints
        fixed = rng.random(n) < 0.4
        lower, upper = np.where(fixed, x, lower), np.where(fixed, x, upper)

    A = rng.normal(size=(m, n))
    if m > 1 and rng.random() < 0.2:
        A = rows_of_condition(rng, m, n, 10.0 ** rng.uniform(0.0, 8.0))
    if m > 1 and rng.random() < 0.2:  # redundant
        A[-1] = rng.normal(size=m - 1) @ A[:-1]
    G = rng.normal(size=(k, n))
    if k > 1 and rng.random() < 0.2:  # nearly parallel
        G[-1] = G[0] + 10.0 ** rng.uniform(-8.0, -1.0) * rng.normal(size=n)
    if m and rng.random() < 0.2:
        A[rng.integers(m)] *= 10.0 ** rng.uniform(-6.0, 2.0)
    if k and rng.random() < 0.2:
        G[rng.integers(k)] *= 10.0 ** rng.uniform(-6.0, 2.0)
    room = np.where(rng.random(k) < 0.4, 0.0, rng.uniform(0.0, 1.0, k))
    b, g = A @ x, G @ x + room * np.linalg.norm(G, axis=1)

    size = 10.0 ** rng.choice([0.0, rng.uniform(-8.0, 8.0)], p=[0.7, 0.3])
    H = size * positive_definite(rng, n, 10.0 ** rng.choice([0.0, rng.uniform(0.0, 8.0)]))
    c = H @ rng.normal(size=n) + rng.choice([0.0, 1.0, 100.0]) * size * rng.normal(size=n)

    feasible = rng.random() >= 0.15
    if not feasible:
        margin = 10.0 ** rng.uniform(-3.0, 3.0)
        a = rng.normal(size=n)
        a /= np.linalg.norm(a)
        if bounded.any():  # more than the bounds allow, in a direction that they close
            a = np.where(bounded, a, 0.0)
            a /= np.linalg.norm(a)
            reach = np.maximum(a * np.where(bounded, lower, 0), a * np.where(bounded, upper, 0))
            A, b = np.vstack([A, a]), np.append(b, reach.sum() + margin)
        else:
            A, b = np.vstack([A, a, a]), np.concatenate([b, [0.0, margin]])
    return Case(program(H, c, A=A, b=b, G=G, g=g, lower=lower, upper=upper), feasible)

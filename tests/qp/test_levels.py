"""Strict priorities: against the textbook cascade, formulas, and what may never change."""

from typing import Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration
from oracles.exact_levels import exact_cascade
from oracles.hierarchies import Hierarchy, cascade, harder, random_hierarchy, residual
from oracles.twists import PLANE, ROLL_FREE, site
from scipy.optimize import linprog, lsq_linear

import qp_twist as qt
from qp_twist.constraints import gather_limits
from qp_twist.qp.backend import installed_solvers
from qp_twist.qp.directions import Directions
from qp_twist.qp.one_program import Found, first_level
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import EQUALITY_TOLERANCE

Array = npt.NDArray[np.float64]
SEEDS = st.integers(0, 10**6)
SAME = 1e-7


def last_level(hierarchy: Hierarchy) -> tuple[Array, Array, Array, Array]:
    n = len(hierarchy.lower)
    return np.eye(n), hierarchy.reference, np.zeros((0, n)), np.zeros(0)


def relaxed(h: Hierarchy, levels: list[Any] | None = None) -> qt.Solution:
    return qt.solve_levels(
        h.levels if levels is None else levels, h.lower, h.upper,
        on_infeasible="relax", reference=h.reference,
    )  # fmt: skip


# --------------------------------------------------------------------- the oracle, and against it


@pytest.mark.parametrize("seed", range(12))
def test_the_oracle_agrees_with_bounded_least_squares(seed: int) -> None:
    """One level without inequality rows is what scipy solves by another method."""
    h = random_hierarchy(seed, inequalities=False)
    A, b, G, g = h.levels[0]
    loose = h.lower < h.upper
    expected = lsq_linear(
        A[:, loose], b - A[:, ~loose] @ h.lower[~loose], (h.lower[loose], h.upper[loose]),
        method="bvls", tol=1e-14, lsq_solver="exact",
    )  # fmt: skip
    found = cascade(h, [(A, b, G, g)])
    assert found.stationarity < 1e-9
    assert found.residuals[0] == pytest.approx(np.sqrt(2.0 * expected.cost), abs=1e-9)


@pytest.mark.parametrize("block", range(5))
def test_every_level_equals_the_textbook_cascade(block: int) -> None:
    for seed in range(10 * block, 10 * block + 10):
        h = random_hierarchy(seed)
        solution = relaxed(h)
        assert (solution.x >= h.lower).all()
        assert (solution.x <= h.upper).all()
        levels = [*h.levels, last_level(h)]
        oracle = cascade(h, levels)
        assert oracle.stationarity < 1e-9, seed
        reached = [residual(level, solution.x) for level in levels]
        np.testing.assert_allclose(reached, oracle.residuals, atol=SAME, err_msg=str(seed))
        np.testing.assert_allclose(solution.x, oracle.x, atol=1e-6, err_msg=str(seed))
        assert solution.scale == 1.0
        assert solution.proven and max(solution.gaps) < 1e-8
        for level, left in zip(h.levels, solution.residuals, strict=True):
            np.testing.assert_allclose(left, level[0] @ solution.x - level[1], atol=1e-12)


# ------------------------------------------------------------- ill-conditioned, against decimals

EXACT = 1e-8
"""Of a level's size: what two definitions of its rank may differ by."""
SMALL = 8
"""Most unknowns of a hierarchy that is solved exactly: the time grows with their cube."""


@pytest.mark.parametrize("kind", ["stretched", "parallel"])
def test_ill_conditioned_levels_are_the_optimum_or_say_that_they_may_not_be(kind: str) -> None:
    """Rows of 1e-3 … 1e3, or almost parallel ones, whatever BLAS has made of them."""
    unproven = []
    seeds = [seed for seed in range(40) if len(harder(seed, kind).lower) <= SMALL]
    for seed in seeds:
        h = harder(seed, kind)
        solution, expected = relaxed(h), exact_cascade(h)
        for level, gap, optimum in zip(h.levels, solution.gaps, expected, strict=True):
            size = 1.0 + optimum + float(np.linalg.norm(level[1]))
            off = abs(residual(level, solution.x) - optimum)
            assert off <= gap + EXACT * size, seed
            if solution.proven:
                longest = float(np.linalg.norm(np.vstack([level[0], level[2]]), axis=1).max())
                assert off <= 1e-7 * (longest + size), seed
        if not solution.proven:
            unproven.append(seed)
    assert len(seeds) > 5 and len(unproven) <= 0.15 * len(seeds), unproven


# ------------------------------------------------------------------------ what is zero, or small


@given(SEEDS, st.floats(-4.0, 4.0))
@settings(max_examples=25)
def test_what_the_tolerance_does_not_resolve_changes_neither_scale_nor_result(
    seed: int, digits: float
) -> None:
    """A first level that is met, and its right-hand side moved by up to the stated tolerance."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    A = rng.normal(size=(int(rng.integers(1, n)), n)) * 10.0**digits
    if rng.random() < 0.4:
        A = np.vstack([A, rng.normal(size=(1, len(A))) @ A])  # rows that have to agree
    lower, upper = -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    met = np.zeros(n) if rng.random() < 0.5 else rng.uniform(lower, upper)
    b = A @ met
    away = rng.normal(size=len(b))
    tolerance = EQUALITY_TOLERANCE * (np.linalg.norm(A, axis=1).max() + np.abs(b).max())
    away *= tolerance * 0.99 * 10.0 ** rng.choice([0.0, -1.0, -6.0, -11.0]) / np.linalg.norm(away)
    below = (np.eye(n), np.full(n, 9.0))
    still = qt.solve_levels([(A, b), below], lower, upper)
    moved = qt.solve_levels([(A, b + away), below], lower, upper)
    assert still.scale == moved.scale == 1.0
    assert np.linalg.norm(moved.residuals[0]) <= 1.01 * tolerance


@given(SEEDS)
@settings(max_examples=20)
def test_a_scaled_first_level_leaves_the_others_to_the_cascade(seed: int) -> None:
    h = random_hierarchy(seed, inequalities=False)
    h.lower = np.minimum(h.lower, 0.0)  # standing still is inside, so that there is a scale
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(min(3, len(h.lower)), len(h.lower)))
    h.levels[0] = (A, A @ np.clip(3.0 * rng.normal(size=len(h.lower)), -5, 5), *h.levels[0][2:])
    solution = qt.solve_levels(
        [level[:2] for level in h.levels], h.lower, h.upper, reference=h.reference
    )
    slower = [(A, solution.scale * h.levels[0][1], *h.levels[0][2:]), *h.levels[1:], last_level(h)]
    oracle = cascade(h, slower)
    reached = [residual(level, solution.x) for level in slower]
    assert reached[0] <= 1e-8
    # What is left is about SCALE_BACKOFF wide, which is at the limit of the oracle.
    assert oracle.stationarity < 1e-7
    np.testing.assert_allclose(reached, oracle.residuals, atol=1e-4)


@given(SEEDS)
@settings(max_examples=25)
def test_without_bounds_it_is_the_recursive_null_space_formula(seed: int) -> None:
    r"""q_k = q_{k−1} + (A_k P)† (b_k − A_k q_{k−1}),  P ← P − (A_k P)†(A_k P).

    B. Siciliano and J.-J. E. Slotine, "A general framework for managing multiple tasks in highly
    redundant robotic systems", ICAR 1991.
    """
    h = random_hierarchy(seed, bounded=False, inequalities=False)
    x, P = np.zeros(len(h.lower)), np.eye(len(h.lower))
    for A, b, _, _ in h.levels:
        inverse = np.linalg.pinv(A @ P, rcond=1e-9)
        if np.abs(A @ P).max() < 1e-9 * np.abs(A).max():
            continue  # nothing is left of this level but rounding
        x = x + inverse @ (b - A @ x)
        P = P - inverse @ (A @ P)
    expected = x + P @ (h.reference - x)
    solution = relaxed(h)
    np.testing.assert_allclose(solution.x, expected, atol=1e-7 * (1.0 + np.abs(expected).max()))


@given(SEEDS)
@settings(max_examples=25)
def test_a_lower_level_never_changes_what_a_higher_one_achieved(seed: int) -> None:
    h = random_hierarchy(seed)
    alone = relaxed(h, h.levels[:1])
    both = relaxed(h)
    A, b, G, g = h.levels[0]
    np.testing.assert_allclose(A @ both.x - b, A @ alone.x - b, atol=1e-8)
    np.testing.assert_allclose(
        np.maximum(G @ both.x - g, 0.0), np.maximum(G @ alone.x - g, 0.0), atol=1e-8
    )


def test_a_level_of_conflicting_tasks_is_a_compromise() -> None:
    rows = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    solution = qt.solve_levels(
        [(rows, [1.0, 3.0, 0.5])], [-9.0, -9.0], [9.0, 9.0], on_infeasible="relax"
    )
    np.testing.assert_allclose(solution.x, [2.0, 0.5], atol=1e-12)


def test_inequality_rows_count_where_they_stand() -> None:
    """x ≤ 1 above or below a desired velocity for x = 3."""
    row = np.array([[1.0, 0.0]])
    nothing = (np.zeros((0, 2)), [])
    wall, desired = (*nothing, row, [1.0]), (row, [3.0])
    low, high = [-9.0, -9.0], [9.0, 9.0]
    first = qt.solve_levels([wall, desired], low, high)
    np.testing.assert_allclose(first.x, [1.0, 0.0], atol=1e-12)
    below = qt.solve_levels([desired, wall], low, high)
    np.testing.assert_allclose(below.x, [3.0, 0.0], atol=1e-12)
    beside = qt.solve_levels([(*desired, row, [1.0])], low, high, on_infeasible="relax")
    np.testing.assert_allclose(beside.x, [2.0, 0.0], atol=1e-12)


# ------------------------------------------------------------------------------------ scale, raise


def saturated(seed: int) -> tuple[Array, Array, Array, Array, float]:
    """J, goal, bounds and σ: a goal that some point inside the bounds reaches to σ of it."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    J = rng.normal(size=(int(rng.integers(1, n + 1)), n))
    lower, upper = -0.1 - rng.uniform(size=n), 0.1 + rng.uniform(size=n)
    inside = rng.uniform(lower, upper)
    on = rng.uniform(size=n) < 0.3
    inside[on] = np.where(rng.uniform(size=n) < 0.5, lower, upper)[on]
    sigma = 1.0 if rng.uniform() < 0.5 else float(rng.uniform(0.1, 0.9))
    return J, J @ inside / sigma, lower, upper, sigma


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_scale_is_the_linear_programs_whatever_the_unit_of_the_rows(unit: float) -> None:
    """Posed and solved differently: y = x − lower ≥ 0 with slacks, by an interior-point method."""
    for seed in range(80) if unit == 1.0 else range(20):
        J, goal, lower, upper, sigma = saturated(seed)
        n = len(lower)
        solution = qt.solve_levels([(unit * J, unit * goal)], lower, upper)
        rows = np.block([
            [J, -goal[:, None], np.zeros((len(goal), n))],
            [np.eye(n), np.zeros((n, 1)), np.eye(n)],
        ])  # fmt: skip
        best = linprog(
            np.concatenate([np.zeros(n), [-1.0], np.zeros(n)]), A_eq=rows,
            b_eq=np.concatenate([-J @ lower, upper - lower]),
            bounds=[(0, None)] * n + [(0, 1)] + [(0, None)] * n, method="highs-ipm",
        )  # fmt: skip
        assert solution.scale >= sigma - 1e-6, seed
        assert solution.scale == pytest.approx(-best.fun, abs=1e-6), seed
        assert (lower - 1e-9 <= solution.x).all() and (solution.x <= upper + 1e-9).all()
        tolerance = 1e-8 * (np.linalg.norm(J, axis=1).max() + np.abs(goal).max())
        assert np.linalg.norm(J @ solution.x - solution.scale * goal) <= tolerance, seed
        if solution.scale < 1.0 - 1e-6:
            assert solution.binding
            for limit in solution.binding:  # a bound that binds is touched
                i = int(limit.joint[2:-1])
                touched = {"upper": upper, "lower": lower}[limit.side][i]
                assert solution.x[i] == pytest.approx(touched, abs=1e-3)


def test_raise_says_how_much_fits() -> None:
    with pytest.raises(qt.InfeasibleStep, match=r"0\.5 of it") as caught:
        qt.solve_levels([([[1.0, 1.0]], [4.0])], [-1, -1], [1, 1], on_infeasible="raise")
    assert caught.value.problem is not None
    fits = qt.solve_levels([([[1.0, 1.0]], [1.5])], [-1, -1], [1, 1], on_infeasible="raise")
    assert fits.scale == 1.0


# ------------------------------------------------------------------------- levels of a controller


class Arm:
    """A random arm of eight joints with tasks about it."""

    def __init__(self, seed: int, away: float = 0.05) -> None:
        rng = np.random.default_rng(seed)
        self.model = random_arm(rng, 8)
        q = random_configuration(self.model, rng, margin=0.1)
        self.configuration = mink.Configuration(self.model, q)
        pose = site(self.configuration)
        self.twist = qt.TwistTask("tool", "site", ROLL_FREE)
        self.twist.set_target(pose.plus(away * rng.normal(size=6)))
        self.frame = mink.FrameTask("link_4", "body", position_cost=1.0, orientation_cost=0.3)
        pose = self.configuration.get_transform_frame_to_world("link_4", "body")
        self.frame.set_target(pose.plus(away * rng.normal(size=6)))
        self.com = mink.ComTask(cost=2.0)
        self.com.set_target(self.configuration.data.subtree_com[1] + away * rng.normal(size=3))
        self.posture = mink.PostureTask(self.model, cost=0.5)
        self.posture.set_target(random_configuration(self.model, rng, margin=0.2))
        self.damping = mink.DampingTask(self.model, cost=0.1)

    def speeds(self, fastest: float) -> mink.VelocityLimit:
        names = [self.model.joint(i).name for i in range(8)]
        return mink.VelocityLimit(self.model, dict.fromkeys(names, fastest))

    def rows(self, task: mink.Task, dt: float) -> tuple[Array, Array]:
        """A task's rows, from its own Jacobian and error (mink: J Δq = −gain · error)."""
        if isinstance(task, qt.TwistTask):
            return task.velocity_rows(self.configuration, dt)
        J, error = task.compute_jacobian(self.configuration), task.compute_error(self.configuration)
        return task.cost[:, None] * J, -task.gain * task.cost * error / dt


HIERARCHIES = {
    "twist over frame": lambda a: [[a.twist], [a.frame]],
    "twist over com over posture": lambda a: [[a.twist], [a.com], [a.posture]],
    "frame over twist": lambda a: [[a.frame], [a.twist]],
    "two in one level": lambda a: [[a.twist, a.com], [a.posture]],
    "posture over everything": lambda a: [[a.posture], [a.twist]],
    "damping last": lambda a: [[a.twist], [a.com], [a.damping]],
}


@pytest.mark.parametrize("name", HIERARCHIES)
@given(seed=SEEDS)
@settings(max_examples=6)
def test_a_controllers_levels_are_solve_levels_on_the_same_rows(name: str, seed: int) -> None:
    arm, dt = Arm(seed), 0.05
    levels = HIERARCHIES[name](arm)
    limits = [qt.PositionLimit(arm.model), arm.speeds(1.0)]
    secondary = qt.JointCentering(arm.model, gain=0.2)
    controller = qt.Controller(
        arm.model, levels=levels, limits=limits, secondary=[secondary],
        on_infeasible="relax",
    )  # fmt: skip
    controller.singularity = 0.0
    step = controller.step(arm.configuration, dt)
    bounds = gather_limits(limits, arm.configuration, dt)
    rows = [
        tuple(map(np.concatenate, zip(*(arm.rows(t, dt) for t in tasks), strict=True)))
        for tasks in levels
    ]
    h = Hierarchy(
        [(A, b, np.zeros((0, 8)), np.zeros(0)) for A, b in rows], bounds.lower, bounds.upper,
        secondary.displacement(arm.configuration) / dt,
    )  # fmt: skip
    expected = qt.solve_levels(rows, h.lower, h.upper, on_infeasible="relax", reference=h.reference)
    for level in h.levels:
        assert residual(level, step.velocity) == pytest.approx(
            residual(level, expected.x), abs=SAME * (1.0 + np.abs(level[1]).max())
        )
    np.testing.assert_allclose(step.velocity, expected.x, atol=1e-6)
    oracle = cascade(h, [*h.levels, last_level(h)])
    assert oracle.stationarity < 1e-9
    np.testing.assert_allclose(step.velocity, oracle.x, atol=1e-5)
    assert np.concatenate(step.residuals) == pytest.approx(
        np.concatenate([A @ step.velocity - b for A, b in rows]), abs=1e-9
    )


def test_the_status_says_which_level_gave_way() -> None:
    arm = Arm(3, away=1e-3)
    plain = qt.Controller(arm.model, levels=[[arm.twist]]).step(arm.configuration, 0.1)
    assert plain.status is qt.Status.SOLVED
    both = qt.Controller(arm.model, levels=[[arm.twist], [arm.frame]])
    step = both.step(arm.configuration, 0.1)
    assert step.status is qt.Status.PRIORITIZED
    assert step.scale == 1.0
    np.testing.assert_allclose(step.residuals[0], 0.0, atol=1e-8)
    assert np.abs(step.residuals[1]).max() > 1e-4


TWO_LINKS = """
<mujoco><worldbody>
  <geom name="post" type="sphere" size="0.1" pos="0.9 0.35 0"/>
  <body><joint name="a" axis="0 0 1"/><geom type="capsule" size="0.03" fromto="0 0 0 0.5 0 0"/>
    <body pos="0.5 0 0"><joint name="b" axis="0 0 1"/>
      <geom name="arm" type="capsule" size="0.03" fromto="0.1 0 0 0.5 0 0"/>
      <site name="tip" pos="0.5 0 0"/></body></body>
</worldbody></mujoco>
"""


def test_a_collision_limit_can_stand_at_any_level() -> None:
    model = mujoco.MjModel.from_xml_string(TWO_LINKS)
    configuration = mink.Configuration(model, np.array([0.0, 0.1]))
    task = qt.TwistTask(
        "tip", "site",
        PLANE,
    )  # fmt: skip
    target = site(configuration, "tip").translation()
    task.set_target(
        mink.SE3.from_translation(target + np.array([-0.05, 0.3, 0.0]))  # behind the post
    )
    collision = mink.CollisionAvoidanceLimit(
        model, [(["arm"], ["post"])], gain=0.5, collision_detection_distance=0.5
    )
    dt = 1.0

    def clearance(step: qt.Step) -> float:
        constraint = collision.compute_qp_inequalities(configuration, dt)
        return float((constraint.h - constraint.G @ step.velocity * dt).min())

    def act(levels: Any, limits: Any) -> qt.Step:
        made = qt.Controller(model, levels=levels, limits=limits, on_infeasible="relax")
        made.smooth = False
        return made.step(configuration, dt)

    above = act([[collision], [task]], [])
    below = act([[task], [collision]], [])
    outside = act([[task]], [collision])
    assert clearance(above) >= -1e-8
    assert clearance(outside) >= -1e-8
    assert clearance(below) < -1e-3
    np.testing.assert_allclose(below.residuals[0], 0.0, atol=1e-8)
    np.testing.assert_allclose(above.velocity, outside.velocity, atol=1e-6)
    assert above.binding
    assert above.binding[0].kind == "collision"
    assert "post" in above.binding[0].joint


MODEL = random_arm(np.random.default_rng(0), 6)


def _twist() -> qt.TwistTask:
    return qt.TwistTask("tool", "site", ROLL_FREE)


@pytest.mark.parametrize(
    ("levels", "sentence"),
    [
        ([], "expected lists of tasks"),
        ([[]], "none of them empty"),
        ([[_twist()], []], "none of them empty"),
        (_twist(), "expected a list"),
        ([_twist()], "expected a list"),
        ([["tool"]], "expected tasks and limits"),
        ([[None]], "expected tasks and limits"),
        ([[_twist(), 3.0]], "expected tasks and limits"),
        ([[[_twist()]]], "expected tasks and limits"),
        ({"first": [_twist()]}, "expected a list"),
        ([[mink.VelocityLimit(MODEL, {})]], "tasks is empty"),
    ],
)
def test_odd_levels_are_refused_with_a_sentence(levels: Any, sentence: str) -> None:
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.Controller(MODEL, levels=levels)


def test_a_cost_without_rows_cannot_stand_in_a_level() -> None:
    arm = Arm(1)
    cost = mink.KineticEnergyRegularizationTask(cost=1.0)
    cost.set_dt(0.1)
    controller = qt.Controller(arm.model, levels=[[arm.twist], [cost]])
    with pytest.raises(qt.InvalidInput, match="states a cost but no rows"):
        controller.step(arm.configuration, 0.1)
    beside = qt.Controller(arm.model, tasks=[cost], levels=[[arm.twist]])
    assert np.isfinite(beside.step(arm.configuration, 0.1).velocity).all()


def test_with_levels_a_twist_task_belongs_to_one() -> None:
    with pytest.raises(qt.InvalidInput, match="belongs to a level"):
        qt.Controller(MODEL, tasks=[_twist()], levels=[[_twist()]])


BACKENDS = {"compiled", "clarabel", "daqp", "osqp", "piqp", "proxqp", "quadprog"}


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP's own interface
@pytest.mark.parametrize("solver", sorted(BACKENDS & set(installed_solvers())))
def test_the_largest_scale_is_found_where_a_row_nearly_fixes_a_bound(solver: str) -> None:
    """x₀ + α x₁ = 2 s inside |xᵢ| ≤ 1: the largest scale is (1 + α)/2, where both are 1."""
    small = 3e-6
    A, b, one = np.array([[1.0, small]]), np.array([2.0]), np.ones(2)
    cost = np.array([0.0, 1.0])
    problem = QuadraticProgram(
        np.eye(2), cost, A, b, np.zeros((0, 2)), np.zeros(0), -one, one
    )  # fmt: skip
    first = Directions.of(A, b, 0.01, 1e-6, damp=False, smooth=False)
    found = first_level(problem, first, "scale", solver)
    assert isinstance(found, Found)
    assert found.scale == pytest.approx(0.5 * (1.0 + small), rel=2e-8)
    assert np.abs(found.x).max() <= 1.0
    assert found.x[0] + small * found.x[1] == pytest.approx(2.0 * found.scale, abs=2e-8)


@pytest.mark.parametrize("distance", [0.5, 5.0])
@pytest.mark.parametrize(
    "solver", sorted({"compiled", "daqp", "quadprog"} & set(installed_solvers()))
)
def test_a_target_out_of_reach_is_followed_without_speed_limits(
    solver: str, distance: float
) -> None:
    """Costs and speeds of 1e5: joints come to rest at their limits, where only s = 0 is left."""
    model = qt.load_task("deburring").model
    configuration = mink.Configuration(model, np.full(6, 0.3))
    hand = qt.TwistTask.axis_free("tool", "site")
    there = configuration.get_transform_frame_to_world("tool", "site")
    away = np.array([distance, 0.5 * distance, 0.0])
    hand.set_target(mink.SE3.from_translation(away) @ there)
    controller = qt.Controller(model, [hand], solver=solver)
    lower, upper = model.jnt_range.T
    for _ in range(120):
        step = controller.step(configuration, 0.01)
        configuration.integrate_inplace(step.velocity, 0.01)
        assert (configuration.q >= lower - 1e-9).all()
        assert (configuration.q <= upper + 1e-9).all()

"""What the QP equals while no limit is active: the table of the design, on random arms.

The oracles are written out here with dense linear algebra, not taken from ``closed_form``; that the
closed forms equal them too is checked beside.
"""

import mink
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles import twists
from oracles.arms import random_arm, random_configuration
from oracles.twists import at, site
from scipy.linalg import null_space

import qp_twist as qt
from qp_twist import closed_form

EXACT = 1e-8
TWIST_SPACE = 1e-6
DT = 0.1
FRAMES = st.sampled_from(twists.FRAMES)
KINDS = st.sampled_from(twists.KINDS)
SEEDS = st.integers(0, 2**32 - 1)


class Situation:
    """A random arm at a random configuration with a random task near it."""

    def __init__(self, seed: int, joints: int, linear: str, angular: str, frame: str) -> None:
        rng = np.random.default_rng(seed)
        self.model = random_arm(rng, joints)
        self.configuration = mink.Configuration(self.model, random_configuration(self.model, rng))
        axes = rng.normal(size=(2, 3))
        task_projector = twists.twists(linear, angular, frame, (axes[0], axes[1]))
        self.task = qt.TwistTask("tool", "site", task_projector)
        pose = site(self.configuration)
        self.task.set_target(pose.plus(0.2 * rng.normal(size=6)))
        self.state = self.task.state(self.configuration)
        self.J = self.state.jacobian
        self.T = self.state.basis @ self.state.basis.T
        self.dt = self.state.error
        self.posture = qt.PostureReference(self.model, random_configuration(self.model, rng), 0.3)
        self.h = self.posture.displacement(self.configuration)

    def regular_task(self) -> bool:
        """Whether the task rows are there and well away from a singularity."""
        if self.state.basis.shape[1] == 0:
            return False
        rows = self.state.basis.T @ self.J
        return rows.shape[0] <= rows.shape[1] and _smallest(rows) > 1e-2

    def regular_arm(self) -> bool:
        """Whether the whole Jacobian is of full row rank, well away from a singularity."""
        return self.model.nv >= 6 and _smallest(self.J) > 1e-2

    def qp(self, *, secondary: bool, space: str = "joint", solver: str = "daqp") -> np.ndarray:
        """Joint displacement of one step of the controller without limits."""
        controller = qt.Controller(
            self.model,
            tasks=[self.task],
            secondary=[self.posture] if secondary else [],
            secondary_space=space,
            limits=[],
            solver=solver,
        )
        step = controller.step(self.configuration, DT)
        assert step.status is qt.Status.SOLVED
        assert step.scale == 1.0
        return step.velocity * DT


def _smallest(rows: np.ndarray) -> float:
    return float(np.linalg.svd(rows, compute_uv=False)[-1])


def _least_norm(rows: np.ndarray, rate: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(rows, rate, rcond=1e-12)[0]


@given(SEEDS)
@settings(max_examples=25)
def test_with_the_whole_twist_on_six_joints_it_is_resolved_motion_rate(seed: int) -> None:
    s = Situation(seed, 6, "full", "full", "world")
    assume(s.regular_arm())
    oracle = np.linalg.solve(s.J, s.dt)
    assert s.qp(secondary=False) == pytest.approx(oracle, abs=EXACT)
    assert closed_form.resolved_motion_rate(s.J, s.dt) == pytest.approx(oracle, abs=1e-9)


@given(SEEDS, st.integers(3, 9), KINDS, KINDS, FRAMES)
@settings(max_examples=25)
def test_without_a_secondary_it_is_the_minimum_norm(
    seed: int, joints: int, linear: str, angular: str, frame: str
) -> None:
    s = Situation(seed, joints, linear, angular, frame)
    assume(s.regular_task())
    oracle = _least_norm(s.T @ s.J, s.T @ s.dt)
    assert s.qp(secondary=False) == pytest.approx(oracle, abs=EXACT)
    assert closed_form.minimum_norm(s.J, s.T, s.dt) == pytest.approx(oracle, abs=1e-9)


@given(SEEDS, st.integers(3, 9), KINDS, KINDS, FRAMES)
@settings(max_examples=25)
def test_with_a_joint_space_secondary_it_is_gradient_projection(
    seed: int, joints: int, linear: str, angular: str, frame: str
) -> None:
    s = Situation(seed, joints, linear, angular, frame)
    assume(s.regular_task())
    # The closest point to h on the task's affine space: h plus the shortest correction.
    oracle = s.h + _least_norm(s.T @ s.J, s.T @ (s.dt - s.J @ s.h))
    assert s.qp(secondary=True) == pytest.approx(oracle, abs=1e-9 * (1.0 + np.abs(oracle).max()))
    formula = closed_form.gradient_projection(s.J, s.T, s.dt, s.h)
    assert formula == pytest.approx(oracle, abs=1e-9)


@given(SEEDS, KINDS, KINDS, FRAMES)
@settings(max_examples=25)
def test_with_a_twist_space_secondary_on_six_joints_it_is_the_twist_decomposition(
    seed: int, linear: str, angular: str, frame: str
) -> None:
    s = Situation(seed, 6, linear, angular, frame)
    assume(s.regular_arm())
    assume(s.regular_task())
    # Ask the arm for one twist: the task's part of Δt and the free part of J h.
    oracle = np.linalg.solve(s.J, s.T @ s.dt + (np.eye(6) - s.T) @ (s.J @ s.h))
    assert s.qp(secondary=True, space="twist") == pytest.approx(oracle, abs=TWIST_SPACE)
    assert closed_form.twa(s.J, s.T, s.dt, s.h) == pytest.approx(oracle, abs=1e-9)


@given(SEEDS, st.integers(7, 9), KINDS, KINDS, FRAMES)
@settings(max_examples=25)
def test_with_more_joints_it_uses_the_redundancy_of_task_and_manipulator(
    seed: int, joints: int, linear: str, angular: str, frame: str
) -> None:
    s = Situation(seed, joints, linear, angular, frame)
    assume(s.regular_arm())
    assume(s.regular_task())
    # J†TΔt + (1 − J†TJ)h, with J† by the normal equations of the paper.
    inverse = s.J.T @ np.linalg.inv(s.J @ s.J.T)
    oracle = inverse @ s.T @ s.dt + s.h - inverse @ s.T @ s.J @ s.h
    assert s.qp(secondary=True, space="twist") == pytest.approx(oracle, abs=TWIST_SPACE)
    formula = closed_form.twa(s.J, s.T, s.dt, s.h, manipulator_redundancy=True)
    assert formula == pytest.approx(oracle, abs=1e-8)
    # The paper's equation leaves the null space of J out; with n > 6 that is another step.
    paper = closed_form.twa(s.J, s.T, s.dt, s.h)
    left_out = s.h - inverse @ s.J @ s.h
    assert formula - paper == pytest.approx(left_out, abs=1e-8)


@given(SEEDS, KINDS, KINDS, FRAMES)
@settings(max_examples=25)
def test_with_h_in_the_null_space_the_secondary_of_the_decomposition_is_gradient_projection(
    seed: int, linear: str, angular: str, frame: str
) -> None:
    """TJh = 0 makes J†(1 − T)Jh = h, which the orthogonal projector gives for any such h."""
    s = Situation(seed, 6, linear, angular, frame)
    assume(s.regular_arm())
    assume(s.regular_task())
    h = s.h - _least_norm(s.T @ s.J, s.T @ s.J @ s.h)
    oblique = closed_form.twa(s.J, s.T, 0.0 * s.dt, h)
    orthogonal = closed_form.gradient_projection(s.J, s.T, 0.0 * s.dt, s.h)
    assert oblique == pytest.approx(h, abs=1e-8)
    assert orthogonal == pytest.approx(h, abs=1e-8)
    # The first terms remain two: J†TΔt leaves the free twist zero, (TJ)†TΔt is the shortest.
    whole = closed_form.twa(s.J, s.T, s.dt, h)
    first_terms = np.linalg.solve(s.J, s.T @ s.dt) - _least_norm(s.T @ s.J, s.T @ s.dt)
    gradient = closed_form.gradient_projection(s.J, s.T, s.dt, s.h)
    assert whole - gradient == pytest.approx(first_terms, abs=1e-7)


@given(SEEDS, st.sampled_from(["full", "plane", "line"]))
@settings(max_examples=20)
def test_the_twist_space_cost_depends_on_the_origin_of_the_frame(seed: int, angular: str) -> None:
    """Two frames of one link, the same task on its orientation: only their origins differ."""
    rng = np.random.default_rng(seed)
    model = random_arm(rng, 6)
    of = twists.twists("none", angular, axes=(np.ones(3), rng.normal(size=3)))
    configuration = mink.Configuration(model, random_configuration(model, rng))
    posture = qt.PostureReference(model, random_configuration(model, rng), 0.3)
    turn = mink.SO3.exp(0.1 * rng.normal(size=3))
    found: dict[str, list[np.ndarray]] = {"joint": [], "twist": [], "oracle": []}
    for name, kind in (("tool", "site"), ("link_6", "body")):
        task = qt.TwistTask(name, kind, of)
        here = site(configuration, name, kind)
        task.set_target(twists.pose(turn @ here.rotation(), here.translation()))
        state = task.state(configuration)
        assume(_smallest(state.jacobian) > 3e-2)
        free = (np.eye(6) - of.matrix) @ state.jacobian @ posture.displacement(configuration)
        asked = of.matrix @ state.error + free
        found["oracle"].append(np.linalg.solve(state.jacobian, asked))
        for space in ("joint", "twist"):
            controller = qt.Controller(
                model, [task], secondary=[posture], secondary_space=space, limits=[]
            )
            found[space].append(controller.step(configuration, DT).velocity * DT)
    assert found["joint"][0] == pytest.approx(found["joint"][1], abs=EXACT)
    np.testing.assert_allclose(found["twist"], found["oracle"], rtol=0, atol=TWIST_SPACE)
    assert np.abs(found["twist"][0] - found["twist"][1]).max() > 1e-4


@given(SEEDS, FRAMES)
@settings(max_examples=20)
def test_the_weight_of_the_free_twist_counts_only_where_it_cannot_all_be_had(
    seed: int, frame: str
) -> None:
    """One direction of translation and one of rotation are free: w weighs m/s against rad/s."""
    s = Situation(seed, 6, "plane", "plane", frame)
    assume(s.regular_arm())

    def velocity(cost: float, limits: list[mink.Limit]) -> np.ndarray:
        controller = qt.Controller(
            s.model, [s.task], secondary=[s.posture], secondary_space="twist", limits=limits,
        )  # fmt: skip
        controller.free_twist_costs = 1.0, cost
        step = controller.step(s.configuration, DT)
        assume(step.status is qt.Status.SOLVED)
        return step.velocity

    free = velocity(1.0, [])
    assert velocity(20.0, []) == pytest.approx(free, abs=1e-5)
    fastest = int(np.argmax(np.abs(free)))
    name = s.model.joint(fastest).name
    held: list[mink.Limit] = [mink.VelocityLimit(s.model, {name: 0.8 * abs(free[fastest])})]
    rows = np.eye(6) - s.T
    for cost in (1.0, 20.0):
        # An oracle: the least ‖·‖_w over the line of velocities with this joint at its limit.
        A = np.vstack([s.state.basis.T @ s.J, np.eye(6)[fastest]])
        b = np.append(s.state.basis.T @ s.dt / DT, 0.8 * free[fastest])
        base = _least_norm(A, b)
        along = np.linalg.svd(A)[2][-1]
        w = np.array([1.0, 1.0, 1.0, cost, cost, cost])
        off = w * (rows @ s.J @ (base - s.h / DT))
        move = w * (rows @ s.J @ along)
        expected = base - along * (move @ off) / (move @ move)
        assert velocity(cost, held) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("solver", ["proxqp", "osqp"])
@given(seed=SEEDS, joints=st.integers(6, 8), frame=FRAMES)
@settings(max_examples=12)
def test_other_backends_agree(solver: str, seed: int, joints: int, frame: str) -> None:
    s = Situation(seed, joints, "full", "plane", frame)
    assume(s.regular_arm())
    for space in ("joint", "twist"):
        reference = s.qp(secondary=True, space=space)
        other = s.qp(secondary=True, space=space, solver=solver)
        assert other == pytest.approx(reference, abs=TWIST_SPACE)


def test_the_planar_arm_with_three_of_six_rows_needs_no_special_case() -> None:
    path_task = qt.load_task("planar_line")
    configuration = mink.Configuration(path_task.model, path_task.start)
    task = qt.TwistTask("tip", "site", path_task.projector)
    pose = site(configuration, "tip")
    task.set_target(at(0.01, 0.02, 0.0) @ pose)
    J, T = task.state(configuration).jacobian, path_task.projector.matrix
    error = task.state(configuration).error
    h = np.array([0.01, -0.02, 0.03])
    planar = J[[0, 1, 5]]
    oracle = np.linalg.solve(planar, np.array([0.01, 0.02, (J @ h)[5]]))
    assert closed_form.twa(J, T, error, h) == pytest.approx(oracle, abs=1e-12)
    restricted = closed_form.twa(J, T, error, h, operational=path_task.operational)
    assert restricted == pytest.approx(oracle, abs=1e-12)


BLOCKS = {
    "full": lambda e: np.eye(3),
    "plane": lambda e: np.eye(3) - np.outer(e, e) / (e @ e),
    "line": lambda e: np.outer(e, e) / (e @ e),
    "none": lambda e: np.zeros((3, 3)),
}


@given(SEEDS, st.integers(6, 9), KINDS, KINDS)
@settings(max_examples=25)
def test_of_a_twist_the_closed_forms_take_the_part_that_the_task_prescribes(
    seed: int, joints: int, linear: str, angular: str
) -> None:
    """With Δt outside the range of T, where a task's own error never is.

    Held against the equations that define each resolution, with T written out.
    """
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(6, joints))
    assume(_smallest(J) > 0.1)
    T = np.zeros((6, 6))
    T[:3, :3] = BLOCKS[linear](rng.normal(size=3))
    T[3:, 3:] = BLOCKS[angular](rng.normal(size=3))
    one, h, dt = np.eye(6), rng.normal(size=joints), rng.normal(size=6)
    weight, bound = rng.uniform(0.5, 2.0, joints), np.full(joints, 1e3)
    free = null_space(J)  # of the whole J, (n, n − 6)
    own = null_space(T @ J, rcond=1e-9)  # of the task's rows
    assume(linear == angular == "full" or np.linalg.norm(dt - T @ dt) > 0.1)

    twa = closed_form.twa(J, T, dt, h)
    assert J @ twa == pytest.approx(T @ dt + (one - T) @ J @ h, abs=1e-8)
    assert free.T @ twa == pytest.approx(np.zeros(joints - 6), abs=1e-8)
    whole = closed_form.twa(J, T, dt, h, manipulator_redundancy=True)
    assert J @ whole == pytest.approx(T @ dt + (one - T) @ J @ h, abs=1e-8)
    assert free.T @ whole == pytest.approx(free.T @ h, abs=1e-8)
    # T as T_O: the rows of T alone are inverted, and nothing of h is left in twist space.
    alone = closed_form.twa(J, T, dt, h, operational=T)
    assert T @ J @ alone == pytest.approx(T @ dt, abs=1e-8)
    assert own.T @ alone == pytest.approx(np.zeros(own.shape[1]), abs=1e-8)

    for step, along in (
        (closed_form.minimum_norm(J, T, dt), 0.0 * h),
        (closed_form.resolved_motion_rate(J, dt, T), 0.0 * h),
        (closed_form.gradient_projection(J, T, dt, h), h),
        (closed_form.saturation_in_null_space(J, T, dt, -bound, bound).displacement, 0.0 * h),
    ):
        assert T @ J @ step == pytest.approx(T @ dt, abs=1e-8)
        assert own.T @ step == pytest.approx(own.T @ along, abs=1e-8)
    shortest = closed_form.weighted_least_norm(J, T, dt, weight)
    assert T @ J @ shortest == pytest.approx(T @ dt, abs=1e-8)
    assert own.T @ (weight * shortest) == pytest.approx(np.zeros(own.shape[1]), abs=1e-8)


@given(SEEDS)
@settings(max_examples=20)
def test_with_fewer_joints_than_rows_the_closed_forms_are_least_squares(seed: int) -> None:
    s = Situation(seed, 4, "full", "full", "world")
    assume(_smallest(s.J) > 1e-2)
    oracle = np.linalg.solve(s.J.T @ s.J, s.J.T @ s.dt)
    assert closed_form.resolved_motion_rate(s.J, s.dt) == pytest.approx(oracle, abs=1e-7)
    assert closed_form.twa(s.J, np.eye(6), s.dt, s.h) == pytest.approx(oracle, abs=1e-7)
    gradient = closed_form.gradient_projection(s.J, np.eye(6), s.dt, s.h)
    assert gradient == pytest.approx(oracle, abs=1e-7)

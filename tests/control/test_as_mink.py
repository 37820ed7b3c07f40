"""``qt.solve_ik`` takes what ``mink.solve_ik`` takes, raises what it raises, and states the same.

Each odd argument goes to both; where mink finds a velocity ours is the same one.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
import qpsolvers
from oracles import mink_problems

import qp_twist as qt

DT = 0.01
SEED = 1


class Case(SimpleNamespace):
    """One configuration with its tasks, limit and constraint; whatever mink takes is made of it."""

    def __init__(self) -> None:
        c, rng = mink_problems.configuration(SEED), np.random.default_rng(0)
        super().__init__(
            c=c, nv=c.model.nv, frame=mink_problems.frame(c, rng),
            posture=mink_problems.posture(c, rng), twist=mink_problems.twist(c, rng),
            speeds=mink_problems._velocity_limit(c), com=mink_problems.com(c, rng),
        )  # fmt: skip


@pytest.fixture
def case() -> Case:
    return Case()


class Other:
    """A task, limit or constraint without mink's base class: what another states, changed."""

    def __init__(
        self, of: Any, change: Callable[[Any], Any] = lambda stated: stated, gain: Any = 0.7
    ):
        self.of, self.change, self.gain, self.calls = of, change, gain, 0

    def said(self, stated: Any) -> Any:
        self.calls += 1
        return self.change(stated)


class Asked(Other):
    """A task."""

    def compute_qp_residual(self, configuration: mink.Configuration) -> Any:
        return self.said(self.of.compute_qp_residual(configuration))


class Dense(Other):
    """A task that states an objective and no rows."""

    def compute_qp_residual(self, configuration: mink.Configuration) -> None:
        return None

    def compute_qp_objective(self, configuration: mink.Configuration) -> Any:
        return self.said(self.of.compute_qp_objective(configuration))


class Limit(Other):
    """A limit, of another one or of what it is given."""

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Any:
        stated = self.of
        if isinstance(stated, mink.Limit):
            stated = stated.compute_qp_inequalities(configuration, dt)
        return self.said(stated)


class Constraint(Other):
    """A constraint."""

    def compute_error(self, configuration: mink.Configuration) -> Any:
        return self.said(self.of.compute_error(configuration))

    def compute_jacobian(self, configuration: mink.Configuration) -> Any:
        return self.change(self.of.compute_jacobian(configuration))


def unsymmetric(objective: mink.Objective) -> mink.Objective:
    """The same cost: half of what is taken from H on one side of its diagonal is on the other."""
    n = len(objective.c)
    skew = np.triu(np.full((n, n), 1e-3), 1)
    return mink.Objective(objective.H + skew - skew.T, objective.c)


def rows(G: Any, h: Any) -> Limit:
    return Limit(mink.Constraint(G, h))


TAKEN: dict[str, Callable[[Case], dict[str, Any]]] = {
    "a generator of tasks": lambda s: {"tasks": (t for t in (s.frame, s.posture))},
    "no tasks": lambda s: {"tasks": []},
    "a generator of limits": lambda s: {"limits": (x for x in (s.speeds,))},
    "dt as an array": lambda s: {"dt": np.array(DT)},
    "damping by joint": lambda s: {"damping": np.linspace(1e-3, 1.0, s.nv)},
    "a backend's option": lambda s: {"primal_tol": 1e-8},
    "another's task": lambda s: {"tasks": [Asked(s.frame), s.posture]},
    "damping by joint of a task": lambda s: {
        "tasks": [Asked(s.frame, lambda x: (x[0], x[1], np.linspace(0.1, 0.2, s.nv))), s.posture]
    },
    "an objective": lambda s: {"tasks": [Dense(s.frame), s.posture]},
    "another's limit": lambda s: {"limits": [Limit(s.speeds)]},
    "lists for inequalities": lambda s: {
        "limits": [Limit(s.speeds, lambda x: mink.Constraint(x.G.tolist(), x.h.tolist()))]
    },
    "one inequality without its brackets": lambda s: {
        "limits": [rows(np.ones(s.nv), np.array([1e-3]))]
    },
    "an inequality of zeros": lambda s: {"limits": [rows(np.zeros((1, s.nv)), np.ones(1))]},
    "an inactive limit": lambda s: {"limits": [rows(None, None)]},
    "another's constraint": lambda s: {"constraints": [Constraint(s.twist)]},
    "one row of a constraint": lambda s: {
        "constraints": [Constraint(s.twist, change=lambda x: x[0])]
    },
    "another configuration": lambda s: {
        "configuration": type("Mine", (mink.Configuration,), {})(s.c.model, s.c.q)
    },
}


def arguments(case: Case, change: Callable[[Case], dict[str, Any]]) -> dict[str, Any]:
    plain = {"configuration": case.c, "tasks": [case.frame, case.posture], "dt": DT}
    return plain | {"solver": "daqp"} | change(case)


@pytest.mark.parametrize("name", TAKEN)
def test_what_mink_takes_is_taken_with_minks_velocity(case: Case, name: str) -> None:
    expected = mink.solve_ik(**arguments(case, TAKEN[name]))
    velocity = qt.solve_ik(**arguments(case, TAKEN[name]))
    assert velocity.dtype == np.float64
    assert velocity.shape == (case.nv,)
    given = arguments(case, TAKEN[name])
    names = ("configuration", "tasks", "dt", "damping", "limits", "constraints")
    stated = mink.build_ik(**{key: given[key] for key in names if key in given})
    dt = float(np.asarray(given["dt"], dtype=float).item())
    # mink's backend stops a little early, so that ours may be better by a trace.
    scale = 1.0 + np.abs(velocity).max()
    np.testing.assert_allclose(velocity, expected.astype(float), atol=1e-3 * scale)
    ours, minks = velocity * dt, expected.astype(float) * dt
    values = [0.5 * x @ stated.P @ x + stated.q @ x for x in (ours, minks)]
    assert values[0] <= values[1] + 1e-9 * (1e-6 + abs(values[1]))
    if stated.G is not None:
        assert (stated.G @ ours <= stated.h + 1e-10).all()
    if stated.A is not None:
        np.testing.assert_allclose(stated.A @ ours, stated.b, atol=1e-10)
    step = qt.ik_step(**arguments(case, TAKEN[name]))
    np.testing.assert_allclose(step.velocity, velocity, atol=1e-9 * scale)


def test_what_states_h_that_is_not_symmetric_states_its_symmetric_part(case: Case) -> None:
    plain = qt.solve_ik(case.c, [Dense(case.frame), case.posture], DT, "daqp")
    task = Dense(case.frame, unsymmetric)
    np.testing.assert_allclose(
        qt.solve_ik(case.c, [task, case.posture], DT, "daqp"), plain, atol=1e-9
    )


UNSET = mink.FrameTask("left_hand", "site", 1.0, 1.0)
NOWHERE = mink.FrameTask("no_such_hand", "site", 1.0, 1.0)
NOWHERE.set_target(mink.SE3.identity())
RAISED: dict[str, tuple[Callable[[Case], dict[str, Any]], type[Exception]]] = {
    "an unknown solver": (lambda s: {"solver": "magic"}, qpsolvers.SolverNotFound),
    "no target": (lambda s: {"tasks": [UNSET]}, mink.TargetNotSet),
    "no such frame": (lambda s: {"tasks": [NOWHERE]}, mink.InvalidFrame),
    "no time step": (
        lambda s: {"tasks": [mink.KineticEnergyRegularizationTask(1.0)]},
        mink.IntegrationTimestepNotSet,
    ),
    "a joint outside": (
        lambda s: {"configuration": outside(s), "safety_break": True},
        mink.NotWithinConfigurationLimits,
    ),
    "damping of another shape": (lambda s: {"damping": np.ones(3)}, ValueError),
}  # fmt: skip


def outside(case: Case, joint: str = "left_2") -> mink.Configuration:
    q = case.c.q
    at = case.c.model.joint(joint).qposadr[0]
    if joint == "neck":  # its angle is at most 1.2
        q[at : at + 4] = np.cos(0.7), np.sin(0.7), 0.0, 0.0
    else:
        q[at] = 2.7
    return mink.Configuration(case.c.model, q)


@pytest.mark.parametrize("name", RAISED)
def test_what_mink_raises_is_raised(case: Case, name: str) -> None:
    change, error = RAISED[name]
    for solve_ik in (mink.solve_ik, qt.solve_ik, qt.ik_step):
        with pytest.raises(error):
            solve_ik(**arguments(case, change))


@pytest.mark.parametrize(
    "change",
    [
        {"dt": -DT}, {"dt": np.inf}, {"dt": np.full(33, DT)}, {"damping": np.nan},
        {"tasks": None}, {"limits": 3}, {"constraints": 3},
        {"limits": [rows(np.eye(33), np.full(33, np.nan))]},
        {"limits": [rows(np.eye(33), np.full(33, -np.inf))]},
        {"limits": [rows(np.full((1, 33), np.nan), np.ones(1))]},
        {"limits": [rows(np.eye(33), None)]}, {"limits": [Limit(None)]},
        {"limits": [Limit((np.eye(33), np.ones(33)))]},
    ],
)  # fmt: skip
def test_what_means_nothing_is_a_sentence(case: Case, change: dict[str, Any]) -> None:
    """mink fails at these in all sorts of ways, or returns NaN or a velocity of no meaning."""
    with pytest.raises(qt.InvalidInput):
        qt.solve_ik(**arguments(case, lambda s: change))


def test_the_velocity_is_the_callers_own(case: Case) -> None:
    first = qt.solve_ik(case.c, [case.frame, case.posture], DT, "daqp")
    kept = first.copy()
    qt.solve_ik(case.c, [case.com, case.posture], DT, "daqp")
    np.testing.assert_array_equal(first, kept)
    first[:] = 0.0
    np.testing.assert_array_equal(qt.solve_ik(case.c, [case.frame, case.posture], DT, "daqp"), kept)


# ---------------------------------------------------------------- what limits say, without asking


@pytest.mark.parametrize("turn", [0.0, 1e-10, 1e-3, 1.0, 1.3, np.pi])
def test_known_limits_are_kept_as_mink_states_them(turn: float) -> None:
    """With the ball joint at and beyond its end, of 1.2 rad: mink's own rows, and its optimum."""
    for seed in range(3):
        c, rng = mink_problems.configuration(seed), np.random.default_rng(seed)
        at, axis, q = c.model.joint("neck").qposadr[0], rng.normal(size=3), c.q
        axis /= np.linalg.norm(axis)
        q[at : at + 4] = np.cos(turn / 2), *(np.sin(turn / 2) * axis)
        c.update(q)
        tasks = [mink_problems.posture(c, rng), mink_problems.into_the_obstacle(c)]
        # Beyond its end it has to come back faster than the speeds allow.
        beside: list[list[str]] = [["VelocityLimit"], list(mink_problems.LIMITS)]
        for names in (["ConfigurationLimit"], *(beside if turn < 1.2 else [])):
            limits = [mink_problems.LIMITS[name](c) for name in names]
            problem = mink_problems.Problem(c, tasks, limits)
            found = mink_problems.difference(
                problem, qt.solve_ik(c, tasks, DT, "daqp", limits=limits)
            )
            assert abs(found.value) < 1e-6 and found.excess < 1e-9, (seed, names)


def test_bounds_and_rows_that_hold_back_are_named(case: Case) -> None:
    """A ball joint by its name; of two limits the one whose bound it is."""
    c = case.c
    at = c.model.joint("neck").qposadr[0]
    q = c.q
    q[at : at + 4] = np.cos(0.59), np.sin(0.59), 0.0, 0.0  # 1.18 of 1.2
    c.update(q)
    posture = mink.PostureTask(c.model, 1.0)
    further = q.copy()
    further[at : at + 4] = np.cos(0.8), np.sin(0.8), 0.0, 0.0
    further[c.model.joint("left_1").qposadr[0]] += 0.5
    posture.set_target(further)
    limits = [mink.ConfigurationLimit(c.model), mink.VelocityLimit(c.model, {"left_1": 0.8})]
    step = qt.ik_step(c, [posture], DT, "daqp", limits=limits)
    assert {(x.joint, x.kind, x.side) for x in step.binding} == {
        ("neck", "position", "upper"), ("left_1", "velocity", "upper"),
    }  # fmt: skip
    by_reference = qt.ik_step(c, [posture], DT, "daqp", limits=limits, primal_tol=1e-11)
    assert by_reference.solver == "daqp"
    assert {str(x) for x in by_reference.binding} == {str(x) for x in step.binding}


# ---------------------------------------------------------------- what is kept from call to call

ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
<body><joint name="a" axis="0 0 1" range="-1 1"/><geom size="0.1"/>
<body pos="1 0 0"><joint name="b" axis="0 1 0" range="-2 2"/><geom size="0.1"/>
<body pos="1 0 0"><joint name="neck" type="ball" range="0 1.5"/><geom size="0.1"/>
<site name="tip" pos="0.3 0 0"/></body></body></body>
</worldbody></mujoco>"""


def tight(model: mujoco.MjModel) -> tuple[mink.Configuration, list[mink.Task]]:
    """A posture that asks for more than the ranges give."""
    c = mink.Configuration(model)
    q = model.qpos0.copy()
    q[2:6] = np.cos(0.7), 0.0, np.sin(0.7), 0.0
    c.update(q)
    posture = mink.PostureTask(model, 1.0)
    posture.set_target(np.concatenate([[5.0, -5.0], [np.cos(1.4), 0.0, np.sin(1.4), 0.0]]))
    return c, [posture]


EDITS: dict[str, Callable[[mujoco.MjModel, Any, Any], None]] = {
    "a range of the model": lambda model, p, v: model.jnt_range.__setitem__((0, 1), 0.3),
    "a range of its ball joint": lambda model, p, v: model.jnt_range.__setitem__((2, 1), 1.41),
    "which joints have a range": lambda model, p, v: model.jnt_limited.__setitem__(1, 0),
    "an end": lambda model, p, v: p.upper.__setitem__(0, 0.2),
    "all ends": lambda model, p, v: setattr(p, "upper", 0.3 * p.upper),
    "the gain": lambda model, p, v: setattr(p, "gain", 0.2),
    "the ball joint's end": lambda model, p, v: p._ball_max_angle.__setitem__(0, 1.42),
    "which joints it is about": lambda model, p, v: (
        setattr(p, "indices", np.array([1])),
        setattr(p, "projection_matrix", np.eye(model.nv)[[1]]),
    ),
    "none but the ball joint": lambda model, p, v: (
        setattr(p, "indices", np.array([], dtype=int)), setattr(p, "projection_matrix", None)
    ),
    "the speeds": lambda model, p, v: setattr(v, "limit", 0.1 * v.limit),
    "whose speeds they are": lambda model, p, v: (
        setattr(v, "indices", np.array([1, 0])),
        setattr(v, "projection_matrix", np.eye(model.nv)[[1, 0]]),
    ),
    "no speeds": lambda model, p, v: setattr(v, "projection_matrix", None),
    "a matrix of speeds": lambda model, p, v: v.projection_matrix.__setitem__((0, 0), 2.0),
    "a matrix of ranges": lambda model, p, v: p.projection_matrix.__setitem__((0, 0), 2.0),
    "ends in whole numbers": lambda model, p, v: setattr(p, "upper", (0.5 * p.upper).astype(int)),
    "ends that alternate": lambda model, p, v: setattr(
        p, "upper", np.repeat(0.3 * p.upper, 2)[::2]
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "ball"),
    [(n, ball) for n in EDITS for ball in (True, False) if ball or "ball" not in n],
)
@pytest.mark.parametrize("passed", [False, True])
def test_what_is_edited_is_noticed(name: str, ball: bool, passed: bool) -> None:
    arm = ARM if ball else ARM.replace(' range="0 1.5"', "")  # the ball joint has a range or not
    model = mujoco.MjModel.from_xml_string(arm)
    c, tasks = tight(model)
    position = mink.ConfigurationLimit(model)
    velocity = mink.VelocityLimit(model, {"a": 120.0, "b": 60.0})
    limits = [position, velocity] if passed else None
    before = qt.solve_ik(c, tasks, DT, "daqp", limits=limits)
    np.testing.assert_allclose(
        before, mink.solve_ik(c, tasks, DT, "daqp", limits=limits), atol=1e-6
    )
    EDITS[name](model, position, velocity)
    after = qt.solve_ik(c, tasks, DT, "daqp", limits=limits)
    np.testing.assert_allclose(after, mink.solve_ik(c, tasks, DT, "daqp", limits=limits), atol=1e-6)
    of_the_model = "model" in name or "its ball" in name or "which joints have" in name
    assert (np.abs(after - before).max() > 1e-3) == (passed != of_the_model)


CHANGES: dict[str, Callable[[Case], None]] = {
    "a cost": lambda case: case.frame.set_position_cost(0.1),
    "an entry of a cost": lambda case: case.frame.cost.__setitem__(0, 0.1),
    "all costs": lambda case: setattr(case.posture, "cost", 3.0 * case.posture.cost),
    "a gain": lambda case: setattr(case.frame, "gain", 0.3),
    "a damping": lambda case: setattr(case.frame, "lm_damping", 2.0),
    "a target": lambda case: case.posture.set_target(case.c.q + 0.0),
    "a target in place": lambda case: case.posture.target_q.__iadd__(
        np.isin(np.arange(case.c.nq), case.c.model.jnt_qposadr[case.c.model.jnt_type == 3]) * 0.3
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_changed_of_a_task_is_noticed(case: Case, name: str) -> None:
    tasks = [case.frame, case.posture]
    limits = [mink.ConfigurationLimit(case.c.model)]
    before = qt.solve_ik(case.c, tasks, DT, "daqp", limits=limits)
    CHANGES[name](case)
    after = qt.solve_ik(case.c, tasks, DT, "daqp", limits=limits)
    expected = mink.solve_ik(case.c, tasks, DT, "daqp", limits=limits)
    np.testing.assert_allclose(after, expected, atol=1e-5)
    assert np.abs(after - before).max() > 1e-3


def test_two_models_of_one_size_do_not_mix() -> None:
    wide = mujoco.MjModel.from_xml_string(ARM)
    narrow = mujoco.MjModel.from_xml_string(ARM.replace("-1 1", "-0.1 0.1"))
    for model in (wide, narrow, wide):
        c, tasks = tight(model)
        expected = mink.solve_ik(c, tasks, DT, "daqp")
        np.testing.assert_allclose(qt.solve_ik(c, tasks, DT, "daqp"), expected, atol=1e-6)


@pytest.mark.parametrize("name", mink_problems.LIMITS)
@pytest.mark.parametrize("ask", ["solve_ik", "by a backend", "compiled", "daqp", "a level"])
def test_what_a_limit_of_a_newer_mink_has_is_refused(case: Case, name: str, ask: str) -> None:
    """An attribute that is not known is not ignored; a class derived from mink's states itself."""
    limit: Any = mink_problems.LIMITS[name](case.c)

    def asked() -> None:
        if ask in ("solve_ik", "by a backend"):
            options = {} if ask == "solve_ik" else {"primal_tol": 1e-11}
            qt.solve_ik(case.c, [case.posture], DT, "daqp", limits=[limit], **options)
            return
        limits = [] if ask == "a level" else [limit]
        levels = [[case.twist], [limit]] if ask == "a level" else [[case.twist]]
        solver = None if ask == "compiled" else "daqp"
        qt.Controller(case.c.model, levels=levels, limits=limits, solver=solver).step(case.c, DT)

    asked()
    limit.elastic = True
    with pytest.raises(qt.InvalidInput, match=f"{name} has 'elastic', which .* would ignore"):
        asked()
    limit.__class__ = type("Elastic", (type(limit),), {})
    asked()


# ---------------------------------------------------------------- rows that depend on each other


def test_dependent_constraints_are_solved_where_mink_states_them() -> None:
    """A loop in a plane: one of its three rows is zero. And the same constraint twice."""
    problems = mink_problems.named(SEED)
    problem = problems["EqualityConstraintTask in constraints"]
    c, (loop,) = problem.configuration, problem.constraints
    J = loop.compute_jacobian(c)
    assert np.linalg.matrix_rank(J) < len(J)
    twist = problems["TwistTask in constraints"].constraints[0]
    for constraints in ([loop], [twist, twist], [loop, twist, loop]):
        step = qt.ik_step(c, problem.tasks, DT, "daqp", constraints=constraints)
        assert step.status is qt.Status.SOLVED
        assert step.solver == "compiled"
        assert [len(r) for r in step.residuals] == [len(x.compute_error(c)) for x in constraints]
        for residual, task in zip(step.residuals, constraints, strict=True):
            rows, error = task.compute_jacobian(c), task.compute_error(c)
            np.testing.assert_allclose(
                residual, rows @ step.velocity + task.gain * error / DT, atol=1e-12
            )
            np.testing.assert_allclose(residual, 0.0, atol=1e-8 * (1 + np.abs(error).max() / DT))
        assert step.sigma_min < 1e-12
        # The oracle: the same rows, once each, in mink's own step.
        once = {id(x): x for x in constraints}.values()
        expected = mink.solve_ik(c, problem.tasks, DT, "daqp", constraints=list(once))
        np.testing.assert_allclose(step.velocity, expected, atol=1e-5)


def test_rows_that_depend_but_ask_for_something_else_are_not_called_solved(case: Case) -> None:
    once = Constraint(case.twist, gain=1.0)
    less = Constraint(case.twist, gain=0.5)
    step = qt.ik_step(case.c, [case.posture], DT, "daqp", constraints=[once, less])  # type: ignore[list-item]
    assert step.status is qt.Status.SCALED
    assert step.scale == pytest.approx(0.0, abs=1e-6)

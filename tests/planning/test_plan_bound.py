"""What a plan prints as a bound is one: nothing that SLSQP or chance finds is better."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian, frame_pose
from qp_twist.paths import shipped_folder
from qp_twist.planning.bound import pointwise_bound, steps_beyond_joints
from qp_twist.planning.levels import Grid, Roadmap
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows

pytestmark = pytest.mark.numerical
Array = np.ndarray
CONFIGURATIONS: dict[mujoco.MjModel, mink.Configuration] = {}


def seven_axes(seed: int) -> qt.PathTask:
    """Two waypoints of the shipped arm of seven joints, its tool held in all six directions."""
    model = mujoco.MjModel.from_xml_path(str(shipped_folder("scenes") / "seven_axis_arm.xml"))
    rng, ranges = np.random.default_rng(seed), qt.JointRanges.of(model)
    width = np.where(ranges.limited, ranges.upper - ranges.lower, 2.0)
    q = ranges.middle + 0.5 * rng.uniform(-0.5, 0.5, 7) * width
    pose = mink.Configuration(model, q).get_transform_frame_to_world("tool", "site")
    step = rng.normal(size=3)
    step *= 0.02 / np.linalg.norm(step)
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    return dataclasses.replace(
        qt.load_task("planar_line"), name=f"seven_{seed}", model=model, frame_name="tool",
        frame_type="site", projector=whole, operational=whole, flipped_waypoints=None,
        waypoints=(pose, mink.SE3.from_translation(step) @ pose), start=q, durations=None,
        velocity_limits=np.full(7, np.inf), acceleration_limits=np.full(7, np.inf), methods={},
    )  # fmt: skip


def planar(_: int) -> qt.PathTask:
    task = qt.load_task("planar_line")
    return dataclasses.replace(task, waypoints=task.waypoints[::50], flipped_waypoints=None)


def industrial(_: int) -> qt.PathTask:
    task = qt.load_task("deburring")
    return dataclasses.replace(
        task, waypoints=task.waypoints[::200], flipped_waypoints=None, durations=None
    )


def bound_of(task: qt.PathTask, objective: str) -> tuple[float, list[Array]]:
    """The bound alone, from layers of every waypoint and without a plan to begin at; the layers."""
    rows = PathRows(task)
    grid = Grid(np.radians(4.0), np.full(task.model.nv, 0.26))
    every = list(range(len(task.waypoints)))
    layers = Roadmap(task, rows, grid).layers(every)
    goal = Objective.of(qt.JointRanges.of(task.model), objective)
    bound = pointwise_bound(task, goal, rows, layers, every, None, None)
    return bound, [layer.q for layer in layers]


# ---------------------------------------------------------------- by MuJoCo and SLSQP


def configuration_of(task: qt.PathTask) -> mink.Configuration:
    """One for each model. It keeps the model; an address could become another model's."""
    if task.model not in CONFIGURATIONS:
        CONFIGURATIONS[task.model] = mink.Configuration(task.model)
    return CONFIGURATIONS[task.model]


def missed(task: qt.PathTask, index: int, q: Array) -> tuple[Array, Array]:
    """The task rows' error and their derivatives at a configuration, by MuJoCo."""
    configuration = configuration_of(task)
    configuration.update(q)
    rotation, position = frame_pose(configuration, task.frame_name, task.frame_type)
    goal, projector = task.waypoints[index], task.in_force[index]
    target = goal.rotation().as_matrix()
    error = qt.geometry.twist_error(rotation, position, target, goal.translation(), projector)
    U = projector.resolved(body=rotation, target=target).basis
    J = frame_jacobian(configuration, task.frame_name, task.frame_type)
    return U.T @ error, -U.T @ J


def onto(task: qt.PathTask, index: int, q: Array) -> Array | None:
    """Newton's method by singular values; ``None`` where it does not arrive."""
    for _ in range(50):
        error, derivative = missed(task, index, q)
        if np.linalg.norm(error) < 1e-10:
            return q
        step = -np.linalg.pinv(derivative) @ error
        q = q + step * min(1.0, 0.3 / np.abs(step).max())
    return None


def optima(
    task: qt.PathTask, index: int, objective: str, rng: np.random.Generator, layer: Array
) -> list[float]:
    """Values that SLSQP finds on a waypoint, on it to 1e-10.

    From the best nodes of a grid that are apart, from nodes of any kind and from random
    configurations.
    """
    ranges = qt.JointRanges.of(task.model)
    weight, middle = ranges.weight, ranges.middle
    limited = ranges.limited
    low, high = ranges.lower[limited], ranges.upper[limited]
    margin = objective == "margin"

    def z(x: Array) -> float:
        return 0.5 * float(((weight * (x - middle)) ** 2).sum())

    def room(x: Array) -> Array:
        return np.minimum(x[limited] - low, high - x[limited])

    found = []
    n = task.model.nv
    order = np.argsort([-room(x).min() if margin else z(x) for x in layer])
    begin = []
    for x in layer[order]:
        if len(begin) < 4 and all(np.abs(x - other).max() > 0.5 for other in begin):
            begin.append(x)
    begin += list(layer[rng.integers(len(layer), size=2)])
    for _ in range(3):
        begin.append(rng.uniform(np.where(limited, ranges.lower, -3.0),
                                 np.where(limited, ranges.upper, 3.0)))  # fmt: skip
    for x in begin:
        q = onto(task, index, x)
        if q is None:
            continue
        on_it = {
            "type": "eq",
            "fun": lambda x: missed(task, index, x[:n])[0],
            "jac": lambda x: np.pad(
                missed(task, index, x[:n])[1], ((0, 0), (0, len(x) - n))
            ),
        }  # fmt: skip
        if margin:
            rows = np.vstack([np.eye(n)[limited], -np.eye(n)[limited]])
            inside = {
                "type": "ineq",
                "fun": lambda x: (
                    np.concatenate([x[:n][limited] - low, high - x[:n][limited]]) - x[n]
                ),
                "jac": lambda x, rows=rows: np.column_stack([rows, -np.ones(len(rows))]),
            }
            best = minimize(
                lambda x: -x[n], np.append(q, room(q).min()), method="SLSQP",
                jac=lambda x: -np.eye(n + 1)[n], constraints=[on_it, inside],
                options={"maxiter": 100, "ftol": 1e-14},
            )  # fmt: skip
        else:
            best = minimize(
                z, q, method="SLSQP", jac=lambda x: weight**2 * (x - middle),
                constraints=[on_it], options={"maxiter": 100, "ftol": 1e-15},
            )  # fmt: skip
        reached = onto(task, index, best.x[:n])
        if reached is None:
            found.append(np.inf)
        else:
            found.append(-np.degrees(room(reached).min()) if margin else z(reached))
    return found


@pytest.mark.parametrize(
    ("make", "seed"),
    [(seven_axes, 5), (seven_axes, 16), (seven_axes, 18), (planar, 0), (industrial, 0)],
    ids=["seven 5", "seven 16", "seven 18", "planar", "m16ib"],
)
def test_no_mean_z_that_slsqp_reaches_is_below_the_bound(
    make: Callable[[int], qt.PathTask], seed: int
) -> None:
    task, rng = make(seed), np.random.default_rng(seed)
    every = range(len(task.waypoints))
    bound, layers = bound_of(task, "centering")
    reached = np.mean([min(optima(task, k, "centering", rng, layers[k])) for k in every])
    assert bound <= reached  # rounding included
    # And not because it is no use: what is taken off it is what the task's tolerance may gain.
    assert bound >= reached * (1.0 - 1e-6) - 1e-12


@pytest.mark.parametrize(
    ("make", "seed"),
    [(seven_axes, 5), (seven_axes, 16), (planar, 0), (industrial, 0)],
    ids=["seven 5", "seven 16", "planar", "m16ib"],
)
def test_no_margin_that_slsqp_reaches_is_above_the_bound(
    make: Callable[[int], qt.PathTask], seed: int
) -> None:
    task, rng = make(seed), np.random.default_rng(seed)
    every = range(len(task.waypoints))
    bound, layers = bound_of(task, "margin")
    reached = min(-min(optima(task, k, "margin", rng, layers[k])) for k in every)
    assert bound >= reached
    assert bound <= reached + 0.1


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_motion_travels_less_than_the_bound(seed: int) -> None:
    """Any ways between any configurations of the waypoints, by random restarts of each step."""
    rng = np.random.default_rng(seed)
    make = [seven_axes, planar, industrial][seed % 3]
    task = make(seed % 20)
    rows, count = PathRows(task), len(task.waypoints)
    bound = pointwise_bound(
        task, Objective.of(qt.JointRanges.of(task.model), "travel"), rows, [], [], None, None
    )
    assert bound > 0.0
    begin = task.start + 0.5 * rng.normal(size=(20, task.model.nv))
    q, arrived = rows.correct(begin, np.zeros(20, dtype=np.intp))
    total = np.zeros(20)
    for k in range(1, count):
        there, reached = rows.correct(q, np.full(20, k))  # the nearest ones, or nearly so
        total += np.degrees(np.abs(there - q).sum(axis=1))
        q, arrived = there, arrived & reached
    assert (total[arrived] >= bound).all()


@pytest.mark.parametrize("objective", ["centering", "travel", "margin"])
@pytest.mark.parametrize("make", [seven_axes, planar, industrial])
def test_a_plan_is_never_better_than_its_bound(
    make: Callable[[int], qt.PathTask], objective: str
) -> None:
    task = make(5)
    plan = qt.plan(task, objective, max_step_deg=60.0, seeds=())
    if plan.q is None:
        assert plan.certificate.kind == "speed"
        return
    better = -1.0 if objective == "margin" else 1.0
    assert better * (plan.value - plan.bound) >= 0.0
    assert plan.gap == abs(plan.value - plan.bound)


@pytest.mark.parametrize("seed", range(20))
def test_a_step_that_joints_make_is_never_beyond_them_and_one_of_no_time_is(seed: int) -> None:
    """Random joint steps through random places: the steps they make are possible, by definition."""
    task = industrial(0)
    ranges, rng = qt.JointRanges.of(task.model), np.random.default_rng([5, seed])
    begin = ranges.random(1, rng)[0]
    # Full steps of all joints in a common direction are what the bound is about; others are short.
    longest = rng.uniform(0.001, 0.3, ranges.middle.size)
    signs = rng.choice([-1.0, 1.0], (6, longest.size)) * rng.choice([1.0, 0.3], (6, 1))
    q = np.clip(begin + np.cumsum(np.vstack([0.0 * begin, signs * longest]), axis=0),
                ranges.lower, ranges.upper)  # fmt: skip
    chain = PathRows(task).chain
    rotations, positions = chain.poses(q)
    waypoints = tuple(
        mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(R), p)
        for R, p in zip(rotations, positions, strict=True)
    )
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    for projector in (task.projector, whole):
        path = dataclasses.replace(task, waypoints=waypoints, projector=projector)
        made = np.abs(np.diff(q, axis=0))
        assert not len(steps_beyond_joints(path, chain, made))
        hurried = steps_beyond_joints(path, chain, 1e-3 * made)
        moved = np.linalg.norm(np.diff(positions, axis=0), axis=1) > 0.02 * made.max(axis=1)
        assert set(np.flatnonzero(moved)) <= set(hurried)


def test_a_task_with_more_than_three_free_degrees_has_no_bound_of_z() -> None:
    task = qt.load_task("deburring")
    height = qt.Projector.plane([1.0, 0.0, 0.0])  # and y: four degrees stay free
    point = qt.TwistProjector(linear=height, angular=qt.Projector.none(), frame="world")
    some = dataclasses.replace(
        task, projector=point, waypoints=task.waypoints[:60:20], flipped_waypoints=None,
        durations=None,
    )  # fmt: skip
    plan = qt.plan(some, max_step_deg=60.0, seeds=())
    assert np.isfinite(plan.value) and np.isnan(plan.bound)
    assert repr(plan).endswith("no bound, 3 waypoints)")
    travel = qt.plan(some, "travel", max_step_deg=60.0, seeds=())
    assert 0.0 < travel.bound <= travel.value

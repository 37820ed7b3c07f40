"""Plans: kinematics of many configurations, layers, ways through them, refinement, certificates."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm
from scipy.optimize import minimize
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

import qp_twist as qt
from qp_twist.kinematics import SerialChain, frame_jacobian, frame_pose
from qp_twist.planning import RollMap
from qp_twist.planning.graph import Edges, cheapest_path, edges
from qp_twist.planning.layer import inside_limits
from qp_twist.planning.manifold_net import ManifoldNet
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import PathConstraints, Problem
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm
from qp_twist.planning.smooth import refine

ROOT = Path(__file__).parents[2]
Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)

DOCS = ROOT / "docs"
LOWEST_Z = (DOCS / "generated" / "snippets" / "lowest_z.txt").read_text("utf-8")


# ---------------------------------------------------------------- kinematics of many configurations


@given(SEEDS, st.integers(1, 8), st.booleans(), st.sampled_from(["site", "body", "geom"]))
@settings(max_examples=25)
def test_the_chain_has_mujocos_poses_and_jacobians(
    seed: int, joints: int, slides: bool, frame_type: str
) -> None:
    rng = np.random.default_rng(seed)
    model = random_arm(rng, max(joints, 2), slides=slides)
    model.qpos0 = rng.uniform(-1.0, 1.0, model.nq)
    name = {"site": "tool", "body": "link_2", "geom": "geom_1"}[frame_type]
    chain = SerialChain.of(model, name, frame_type)
    q = rng.uniform(-3.0, 3.0, (5, model.nq))
    q[:, rng.integers(model.nq)] = model.qpos0[0]  # one may be at its reference all the time
    assert chain.poses(q[:0])[0].shape == (0, 3, 3)
    rotations, positions, jacobians = chain.poses_and_jacobians(q)
    for row, rotation, position, jacobian in zip(q, rotations, positions, jacobians, strict=True):
        configuration = mink.Configuration(model, row)
        expected = frame_pose(configuration, name, frame_type)
        np.testing.assert_allclose(rotation, expected[0], atol=1e-12)
        np.testing.assert_allclose(position, expected[1], atol=1e-12)
        expected_jacobian = frame_jacobian(configuration, name, frame_type)
        np.testing.assert_allclose(jacobian, expected_jacobian, atol=1e-12)


def test_a_chain_with_a_ball_joint_is_refused_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="shoulder" type="ball"/>'
        '<geom size="0.1" mass="1"/><site name="tool"/></body></worldbody></mujoco>'
    )
    with pytest.raises(qt.InvalidInput, match=r"'shoulder'.*ball or free"):
        SerialChain.of(model, "tool", "site")


# ---------------------------------------------------------------- ways through layers


@given(SEEDS)
@settings(max_examples=25)
def test_the_shortest_way_is_dijkstras(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 12, rng.integers(2, 6))
    nodes = [rng.uniform(0.0, 1.0, size) for size in sizes]
    links, costs = [], []
    for a, b in itertools.pairwise(sizes):
        some = np.argwhere(rng.uniform(size=(a, b)) < 0.6)
        links.append(Edges(some[:, 0], some[:, 1]))
        costs.append(rng.uniform(0.0, 1.0, len(some)))
    clear = [np.ones(sizes[0], dtype=bool), *(rng.uniform(size=size) < 0.8 for size in sizes[1:])]
    kept = [rng.uniform(size=len(cost)) < 0.6 for cost in costs]
    way = cheapest_path(
        nodes, lambda k, alive: _of(links[k], alive), lambda k, e: _cost(links[k], costs[k], e),
        allowed=lambda k, reached: clear[k][reached],
        valid=lambda k, e: _cost(links[k], kept[k], e),
    )  # fmt: skip
    first = np.concatenate([[0], np.cumsum(sizes)])
    graph = np.zeros((3, 0))
    for k, (link, cost) in enumerate(zip(links, costs, strict=True)):
        weight = cost + nodes[k][link.start]
        ends_and_cost = np.array([first[k] + link.start, first[k + 1] + link.end, weight])
        graph = np.hstack([graph, ends_and_cost[:, clear[k + 1][link.end] & kept[k]]])
    ends = coo_matrix((graph[2], graph[:2].astype(int)), (first[-1], first[-1])).tocsr()
    distance = dijkstra(ends)[: sizes[0], first[-2] :] + nodes[-1]
    assert way.value == pytest.approx(distance.min())
    if np.isfinite(way.value):
        pruned = cheapest_path(
            nodes, lambda k, alive: _of(links[k], alive), lambda k, e: _cost(links[k], costs[k], e),
            at_most=way.value, allowed=lambda k, reached: clear[k][reached],
            valid=lambda k, e: _cost(links[k], kept[k], e),
        )  # fmt: skip
        assert pruned.value == pytest.approx(way.value)
        assert all(of[node] for of, node in zip(clear, way.nodes, strict=True))
        walked = sum(n[i] for n, i in zip(nodes, way.nodes, strict=True))
        for k, pair in enumerate(itertools.pairwise(way.nodes)):
            match = (links[k].start == pair[0]) & (links[k].end == pair[1]) & kept[k]
            walked += costs[k][match].min()
        assert walked == pytest.approx(way.value)


def _of(link: Edges, alive: Array) -> Edges:
    keep = np.isin(link.start, alive)
    return Edges(link.start[keep], link.end[keep])


def _cost(link: Edges, cost: Array, asked: Edges) -> Array:
    table = {(i, j): c for i, j, c in zip(link.start, link.end, cost, strict=True)}
    pairs = zip(asked.start, asked.end, strict=True)
    return np.array([table[pair] for pair in pairs], dtype=cost.dtype)


# ---------------------------------------------------------------- layers


@given(SEEDS, st.floats(0.1, 4.0), st.booleans())
@settings(max_examples=60)
def test_edges_between_copies_are_those_of_all_pairs(seed: int, step: float, endless: bool) -> None:
    rng, turn = np.random.default_rng(seed), 2.0 * np.pi
    ends = rng.choice([0.9, 1.0, 1.3, 2.0, 3.5], 3) * np.pi
    ranges = [f'range="{-end} {end}"' for end in ends]
    ranges[0] = "" if endless else ranges[0]
    joints = "".join(f'<joint name="j{k}" axis="0 0 1" {r}/>' for k, r in enumerate(ranges))
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><compiler angle='radian' autolimits='true'/><worldbody><body>"
        f"{joints}<geom size='0.1' mass='1'/></body></worldbody></mujoco>"
    )
    limits = qt.JointRanges.of(model)
    # Some are as far from 0 as a joint may be, where a half turn is rounded to either side.
    layers = [
        inside_limits(
            np.where(rng.random((9, 3)) < 0.2, np.pi, rng.uniform(-np.pi, np.pi, (9, 3))),
            np.arange(9), limits,
        )
        for _ in range(2)
    ]  # fmt: skip
    layers[1] = layers[1].joined(layers[0].q[:2] + 0.05, np.zeros(len(layers[0].q[:2]), int))
    here, after = layers
    nodes = rng.permutation(len(here.q))[: rng.integers(len(here.q) + 1)]
    largest, period = step * rng.uniform(0.5, 1.0, 3), np.where([endless, False, False], turn, 0.0)
    largest = np.where(period > 0.0, np.minimum(largest, np.pi), largest)
    found = edges(here, nodes, after, largest, period)
    apart = after.q[None] - here.q[nodes, None]
    apart -= period * np.round(apart / turn)
    start, end = np.nonzero((np.abs(apart) <= largest).all(axis=2))
    assert sorted(zip(found.start, found.end, strict=True)) == sorted(
        zip(nodes[start], end, strict=True)
    )


def test_all_turns_inside_the_limits_are_found() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody>'
        '<body><joint name="a" axis="0 0 1" range="-7 5"/><geom size="0.1" mass="1"/>'
        '<body><joint name="b" axis="0 0 1" range="-1 2"/><geom size="0.1" mass="1"/>'
        '<body><joint name="c" axis="0 0 1"/><geom size="0.1" mass="1"/>'
        '<body><joint name="d" type="slide" range="-9 9"/><geom size="0.1" mass="1"/>'
        '<site name="tool"/></body></body></body></body></worldbody></mujoco>'
    )
    q = np.random.default_rng(0).uniform(-9.0, 9.0, (50, 4))
    layer = inside_limits(q, np.arange(50), qt.JointRanges.of(model))
    expected = {
        (k, round(a, 9), round(b, 9))
        for k in range(50)
        for a in q[k, 0] + 2.0 * np.pi * np.arange(-5, 6)
        for b in q[k, 1] + 2.0 * np.pi * np.arange(-5, 6)
        if -7 <= a <= 5 and -1 <= b <= 2
    }
    found = {
        (k, round(r[0], 9), round(r[1], 9)) for k, r in zip(layer.branch, layer.q, strict=True)
    }
    assert found == expected
    assert (np.abs(layer.q[:, 2]) <= np.pi).all()  # without a range turns do not count
    np.testing.assert_array_equal(layer.q[:, 3], q[layer.branch, 3])  # a slide has none


def planar_layer(goal: Array, ranges: qt.JointRanges, spacing_deg: float) -> Array:
    """All configurations inside the limits with the tip at ``goal``, by the law of cosines.

    One for each side of the elbow and each direction of the last link, on a grid.
    """
    found = []
    for direction in np.radians(np.arange(0.0, 360.0, spacing_deg)):
        wrist = goal - [np.cos(direction), np.sin(direction)]
        cosine = (wrist @ wrist - 2.0**2 - 1.5**2) / (2.0 * 2.0 * 1.5)
        if abs(cosine) <= 1.0:
            for elbow in (np.arccos(cosine), -np.arccos(cosine)):
                first = np.arctan2(wrist[1], wrist[0]) - np.arctan2(
                    1.5 * np.sin(elbow), 2.0 + 1.5 * np.cos(elbow)
                )
                q = np.array([first, elbow, direction - first - elbow])
                found.append(q - 2.0 * np.pi * np.round((q - ranges.middle) / (2.0 * np.pi)))
    q = np.array(found)
    return q[((q >= ranges.lower) & (q <= ranges.upper)).all(axis=1)]


def task_error(task: qt.PathTask, q: Array, index: int) -> float:
    """The largest task error of configurations at a waypoint, m or rad."""
    poses = SerialChain.of(task.model, task.frame_name, task.frame_type).poses(q)
    goal, T = task.waypoints[index], task.in_force[index]
    target = goal.rotation().as_matrix(), goal.translation()
    errors = [qt.geometry.twist_error(*pose, *target, T) for pose in zip(*poses, strict=True)]
    return float(np.abs(errors).max())


@pytest.mark.parametrize("spacing", [(0.05, 0.05, 0.05), (0.2, 0.04, 0.05)])
def test_the_net_of_the_planar_arm_is_complete(spacing: tuple[float, ...]) -> None:
    """Against all solutions from the law of cosines, for all directions of the last link."""
    task = qt.load_task("planar_line")
    ranges = qt.JointRanges.of(task.model)
    net = ManifoldNet(task, PathRows(task), np.array(spacing))
    for index in (0, 40, 100):
        every = planar_layer(task.waypoints[index].translation()[:2], ranges, 0.5)
        layer = net.layer(index)
        assert task_error(task, layer.q, index) < 1e-8
        distance, _ = KDTree(layer.q / spacing).query(every / spacing)
        assert distance.max() < 1.2
        distance, _ = KDTree(every / spacing).query(layer.q / spacing)
        assert distance.max() < 1.2


def test_two_ways_to_the_layers_of_the_industrial_arm_agree(deburring: qt.Comparison) -> None:
    """The branches of the closed form on a grid of rolls, and the nets grown from random seeds."""
    task = deburring.path_task
    arm = closed_form_arm(task)
    assert arm is not None
    grid = RollGrid(task, arm, np.radians(2.0), np.full(6, 0.1))
    net = ManifoldNet(task, PathRows(task), 0.15)
    for index in (0, 150):
        exact, grown = grid.layer(index), net.layer(index)
        assert task_error(task, exact.q, index) < 1e-8
        assert KDTree(grown.q).query(exact.q)[0].max() < 0.3
        assert KDTree(exact.q).query(grown.q)[0].max() < 0.3


# ---------------------------------------------------------------- off the grid


def short_line(waypoints: int) -> qt.PathTask:
    """Some waypoints of the planar line, untimed."""
    task = qt.load_task("planar_line")
    some = np.linspace(0, 100, waypoints).astype(int)
    return dataclasses.replace(task, waypoints=tuple(task.waypoints[i] for i in some))


@pytest.mark.parametrize("objective", ["centering", {"centering": 1.0, "travel": 1e-3}])
@pytest.mark.parametrize("step", [0.5, 0.3])
def test_refining_is_as_good_as_a_general_optimiser(objective: object, step: float) -> None:
    """SLSQP with all joints of all waypoints as unknowns and the task as equality constraints."""
    task = short_line(6)
    rows, ranges = PathRows(task), qt.JointRanges.of(task.model)
    goal = Objective.of(ranges, objective)
    start, _ = rows.correct(np.tile(task.start, (6, 1)), np.arange(6))
    limits = PathConstraints(
        ranges, np.full((5, 3), step), np.full((4, 3), np.inf), np.ones(5), rows.hard
    )
    mine = refine(Problem(task, rows, limits, goal), start)
    positions = task.positions[:, :2]

    def joints(x: Array) -> Array:
        return x[:18].reshape(6, 3)

    def tips(x: Array) -> Array:
        angles = np.cumsum(joints(x), axis=1)
        lengths = np.array([2.0, 1.5, 1.0])
        reached = np.stack([np.cos(angles) @ lengths, np.sin(angles) @ lengths], axis=1)
        return (reached - positions).ravel()

    travel = 0.0 if objective == "centering" else 1e-3
    # The absolute values of the steps are unknowns of their own: SLSQP takes nothing with a kink.
    general = minimize(
        lambda x: ranges.centering(joints(x)).mean() + travel * np.degrees(x[18:].sum()),
        np.concatenate([start.ravel(), np.abs(np.diff(start, axis=0)).ravel()]),
        method="SLSQP",
        bounds=[
            *zip(np.tile(ranges.lower, 6), np.tile(ranges.upper, 6), strict=True),
            *[(0.0, step)] * 15,
        ],
        constraints=[
            {"type": "eq", "fun": tips},
            {"type": "ineq", "fun": lambda x: x[18:] - np.diff(joints(x), axis=0).ravel()},
            {"type": "ineq", "fun": lambda x: x[18:] + np.diff(joints(x), axis=0).ravel()},
        ],
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert general.success
    assert mine.feasible
    assert mine.value == pytest.approx(general.fun, abs=1e-6)


# ---------------------------------------------------------------- plans


def check(plan: qt.Plan, max_step: float = np.inf) -> None:
    """Every promise of a plan, looked at with MuJoCo alone."""
    task, q = plan.path_task, plan.motion()
    ranges = qt.JointRanges.of(task.model)
    configuration = mink.Configuration(task.model)
    for row, waypoint, projector in zip(q, task.waypoints, task.in_force, strict=True):
        configuration.update(row)
        rotation, position = frame_pose(configuration, task.frame_name, task.frame_type)
        error = qt.geometry.twist_error(
            rotation, position, waypoint.rotation().as_matrix(), waypoint.translation(), projector
        )
        assert np.abs(error).max() < 1e-8
    assert (q >= ranges.lower).all()
    assert (q <= ranges.upper).all()
    step = np.abs(np.diff(q, axis=0))
    assert step.max() <= max_step + 1e-9
    if task.durations is not None:
        assert (step <= task.velocity_limits * task.durations[1:, None] + 1e-9).all()


@pytest.mark.parametrize(
    ("objective", "from_start", "value", "at_least"),
    [
        ("centering", False, 0.0812, 0.0777),
        ("centering", True, 0.0885, 0.0777),
        ("travel", True, 556.0, 0.0),
    ],
)
def test_plans_of_the_deburring_run_are_as_good_as_known(
    deburring: qt.Comparison, objective: str, from_start: bool, value: float, at_least: float
) -> None:
    task = deburring.path_task
    start = task.start if from_start else None
    plan = qt.plan(task, objective, start, max_step_deg=3.0)
    check(plan, np.radians(3.0))
    assert at_least < plan.bound <= plan.value <= value
    assert plan.certificate.kind == "path"
    if objective == "centering":
        assert plan.value == pytest.approx(qt.JointRanges.of(task.model).centering(plan.q).mean())
        # What docs/snippets/lowest_z.py prints.
        words = "from the same start" if from_start else "from any start"
        shown = next(line for line in LOWEST_Z.splitlines() if words in line)
        stated = [float(number) for number in re.findall(r"\d\.\d+", shown)]
        assert stated == pytest.approx([plan.value, plan.bound], abs=1.1e-4)


def test_the_widest_plan_of_the_deburring_run(deburring: qt.Comparison) -> None:
    plan = qt.plan(deburring.path_task, "margin", max_step_deg=3.0)
    check(plan, np.radians(3.0))
    assert plan.value >= 72.0
    ranges = qt.JointRanges.of(plan.path_task.model)
    room = np.minimum(plan.motion() - ranges.lower, ranges.upper - plan.motion())
    assert np.degrees(room.min()) == pytest.approx(plan.value)
    assert plan.value <= plan.bound + 1e-6


def test_the_planar_line_is_planned_to_the_pointwise_optimum() -> None:
    plan = qt.plan(qt.load_task("planar_line"))
    check(plan)
    assert plan.value == pytest.approx(0.0522, abs=5e-5)  # the facts of the paper's example
    assert plan.gap < 1e-6


def test_the_planar_plan_is_the_best_of_a_fine_grid_everywhere() -> None:
    """All ways through six waypoints on a grid of 0.25°, from the law of cosines."""
    task = short_line(6)
    ranges, largest = qt.JointRanges.of(task.model), np.radians(25.0)
    layers = [planar_layer(w.translation()[:2], ranges, 0.25) for w in task.waypoints]
    cost = ranges.centering(layers[0])
    for before, after in itertools.pairwise(layers):
        step = np.abs(after[:, None] - before[None]).max(axis=2)
        through = np.where(step <= largest, cost[None], np.inf).min(axis=1)
        cost = through + ranges.centering(after)
    plan = qt.plan(task, "centering", max_step_deg=25.0)
    check(plan, largest)
    assert cost.min() / 6.0 - 2e-3 < plan.value <= cost.min() / 6.0 + 1e-9


def seven_joints(waypoints: int) -> qt.PathTask:
    """A short line for an arm of seven joints; the roll is free, so that two degrees are."""
    text, axes = "", ["0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1"]
    for i, axis in enumerate(axes):
        text += (
            f'<body pos="0 0 {0.3 if i % 2 == 0 else 0.1}"><joint name="joint_{i + 1}" '
            f'axis="{axis}" range="-2.6 2.6"/><geom size="0.04" mass="1"/>'
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{text}<site name="tool" pos="0 0 0.1"/>'
        f"{'</body>' * 7}</worldbody></mujoco>"
    )
    start = np.array([0.3, 0.7, -0.4, 1.5, 0.5, 0.9, 0.2])
    pose = mink.Configuration(model, start).get_transform_frame_to_world("tool", "site")
    steps = [np.array([0.0, 0.03 * k, 0.01 * k]) for k in range(waypoints)]
    template = qt.load_task("planar_line")
    return dataclasses.replace(
        template,
        name="seven_joints",
        model=model,
        frame_name="tool",
        frame_type="site",
        projector=qt.TwistProjector(
            linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
        ),
        operational=qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full()),
        waypoints=tuple(mink.SE3.from_translation(step) @ pose for step in steps),
        flipped_waypoints=None,
        start=start,
        durations=None,
        velocity_limits=np.full(7, np.inf),
        acceleration_limits=np.full(7, np.inf),
        methods={},
    )


# ---------------------------------------------------------------- why there is none


def every(task: qt.PathTask, step: int) -> qt.PathTask:
    """Every n-th waypoint."""
    return dataclasses.replace(
        task, waypoints=task.waypoints[::step], flipped_waypoints=None, durations=None
    )


def moved(task: qt.PathTask, waypoints: Sequence[int], by: Array) -> qt.PathTask:
    """The task with some waypoints elsewhere."""
    shift = mink.SE3.from_translation(by)
    return dataclasses.replace(
        task,
        waypoints=tuple(shift @ w if k in waypoints else w for k, w in enumerate(task.waypoints)),
    )


def test_waypoints_out_of_reach_are_named() -> None:
    task = moved(every(qt.load_task("deburring"), 40), [3, 4], np.array([0.0, 3.0, 0.0]))
    plan = qt.plan(task)
    assert plan.q is None
    assert np.isnan(plan.value)
    assert plan.certificate.kind == "unreachable"
    assert plan.certificate.waypoints == (4, 5)
    assert "does not reach waypoints 4 and 5" in str(plan.certificate)
    with pytest.raises(qt.InvalidInput, match="deburring: no plan: the arm does not reach"):
        plan.motion()
    whole = qt.load_task("deburring")
    far = qt.plan(moved(whole, range(100, 150), np.array([0.0, 3.0, 0.0]))).certificate
    seen = re.search(r"; (\d+) of 401 waypoints were looked at", str(far))
    assert seen and len(far.waypoints) <= int(seen[1]) < 401


def test_the_joint_that_forbids_a_waypoint_is_named() -> None:
    task = every(qt.load_task("deburring"), 40)
    task.model.jnt_range[1] = (1.2, 1.3)  # leans too far forward for the near edge
    plan = qt.plan(task)
    assert plan.certificate.kind == "limits"
    assert plan.certificate.joints == ("joint_2",)
    assert "forbidden by joint_2" in str(plan.certificate)


def test_waypoints_between_which_the_largest_step_does_not_do_are_named() -> None:
    task = every(qt.load_task("deburring"), 20)
    plan = qt.plan(task, max_step_deg=0.2)
    assert plan.certificate.kind == "speed"
    first, second = plan.certificate.waypoints
    assert second > first
    assert "every connection breaks the largest step, max_step_deg = 0.2" in str(plan.certificate)
    # That is a matter of all joints together. Further steps name those that would be too fast.
    assert "all joints together" in str(plan.certificate)
    plan = qt.plan(task, max_step_deg=2.5)
    assert plan.certificate.kind == "speed" and plan.certificate.joints
    assert "every connection breaks the largest step, max_step_deg = 2.5" in str(plan.certificate)
    assert "speed" not in str(plan.certificate)  # there is no feed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"objective": "speed"}, "expected one of centering, travel, margin"),
        ({"objective": {"centering": -1.0}}, "at least 0"),
        ({"objective": {"margin": 1.0}}, "expected one of"),
        ({"objective": {}}, "expected one of"),
        ({"objective": {"centering": 0.0}}, "expected one of"),
        ({"objective": None}, "expected one of"),
        ({"start": [1.0, 2.0]}, r"shape \(3\)"),
        ({"start": [np.nan] * 3}, "finite"),
        ({"start": "best"}, "numbers"),
        ({"max_step_deg": 0.0}, "above 0"),
        ({"max_step_deg": np.inf}, "finite"),
        ({"seeds": ["hope"]}, "unknown method"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(qt.InvalidInput, match=message):
        qt.plan(short_line(3), **arguments)


def test_a_path_of_one_waypoint_is_refused() -> None:
    with pytest.raises(qt.InvalidInput, match="has one waypoint"):
        qt.plan(short_line(1))
    with pytest.raises(qt.InvalidInput, match="PathTask"):
        qt.plan("planar_line")  # type: ignore[arg-type]


def test_a_plan_says_what_it_is_doing() -> None:
    said: list[tuple[str, float]] = []
    task = dataclasses.replace(short_line(9), best_start=True)
    qt.compare(task, ["qp_gradient"], planning=lambda what, share: said.append((what, share)))
    assert said
    said.clear()
    qt.follow(short_line(9), "qp_planned", planning=lambda what, share: said.append((what, share)))
    for part in ("run of qp_gradient", "layers", "steps", "off the grid"):
        shares = [share for what, share in said if part in what]
        assert 0.0 <= shares[0] <= shares[-1] <= 1.0


# ---------------------------------------------------------------- the map of rolls


def test_a_method_is_where_the_map_says_and_has_the_margin_that_it_says(
    deburring: qt.Comparison,
) -> None:
    task, q = deburring.path_task, deburring.trajectories["qp_gradient"].q
    roll_map = RollMap.of(task, columns=401, spacing_deg=4.0)
    assert roll_map.margins.shape == (401, 90, 8)
    rolls, branches = roll_map.locate(q)
    ranges = qt.JointRanges.of(task.model)
    for k in range(0, 401, 20):
        turned = task.waypoints[k].rotation() @ mink.SO3.from_z_radians(rolls[k])
        pose = frame_pose(mink.Configuration(task.model, q[k]), "tool", "site")
        np.testing.assert_allclose(pose[0], turned.as_matrix(), atol=1e-6)
        cell = int(np.argmin(np.abs(roll_map.rolls - rolls[k])))
        room = np.degrees(np.minimum(q[k] - ranges.lower, ranges.upper - q[k]).min())
        # This run stays in the most central turns.
        assert roll_map.margins[k, cell, branches[k]] == pytest.approx(room, abs=5.0)
    sigma = deburring.trajectories["qp_gradient"].sigma_min  # by MuJoCo's Jacobian
    np.testing.assert_allclose(PathRows(task).sigma_min(q, np.arange(401)), sigma, atol=1e-9)
    fine = RollMap.of(task, columns=5, spacing_deg=0.25)
    for column, k in enumerate(fine.waypoints):
        cell = int(np.argmin(np.abs(fine.rolls - rolls[k])))
        assert fine.sigma_min[column, cell, branches[k]] == pytest.approx(sigma[k], abs=0.01)
    arm = closed_form_arm(task)
    assert arm is not None
    grid = RollGrid(task, arm, np.radians(4.0), np.full(6, np.inf))
    step = task.velocity_limits * task.durations[1]
    for k in (0, 139):  # in the middle of an edge, and where the wrist is straight
        before, after = grid.branches(k), grid.branches(k + 1)
        apart = np.abs(np.remainder(after[None] - before[:, None] + np.pi, 2 * np.pi) - np.pi)
        alone = ~(apart <= step).all(axis=3).any(axis=1)
        order = np.argsort(np.remainder(grid.rolls + np.pi, 2 * np.pi))
        np.testing.assert_array_equal(roll_map.stuck[k], alone[order])
    slow = dataclasses.replace(task, velocity_limits=np.full(6, 1e-3))
    assert RollMap.of(slow, columns=20).stuck[:-1].all()


def test_the_map_of_rolls_is_refused_where_more_than_a_roll_is_free() -> None:
    with pytest.raises(qt.InvalidInput, match="whose roll about the tool is free all the way"):
        RollMap.of(qt.load_task("planar_line"))


# ---------------------------------------------------------------- following a plan


def test_following_a_plan_does_what_it_says() -> None:
    task = qt.load_task("planar_line")
    plan = qt.plan(task, "margin")
    run = qt.follow(task, "qp_planned", plan=plan)
    assert np.abs(run.q - plan.motion()).max() < 1e-3
    assert {status.name for status in run.statuses} == {"SOLVED"}
    own = qt.follow(task, "qp_planned", objective="margin")
    room = np.minimum(own.q - [0.0] * 3, np.radians([90.0, 90.0, 180.0]) - own.q).min()
    assert np.degrees(room) < plan.value  # from the task's start there is less


def test_a_part_that_has_moved_is_followed_all_the_same() -> None:
    task = qt.load_task("planar_line")
    plan = qt.plan(task)
    elsewhere = moved(task, range(101), np.array([0.01, -0.02, 0.0]))
    run = qt.follow(elsewhere, "qp_planned", plan=plan)
    assert run.position_error.max() < 1e-8
    assert run.margins.min() > 0.0
    assert run.z.mean() < 1.02 * qt.plan(elsewhere).value


def test_any_joint_space_method_can_follow_a_plan_and_no_plan_is_an_error() -> None:
    task = qt.load_task("planar_line")
    plan = qt.plan(task)
    run = qt.follow(task, "gradient_projection", secondary="plan", plan=plan, iterations=20)
    assert np.abs(run.q - plan.motion()).max() < 1e-3
    narrow = qt.load_task("planar_line")
    narrow.model.jnt_range[1] = np.radians([0.0, 30.0])
    with pytest.raises(qt.InvalidInput, match="forbidden by joint_2"):
        qt.follow(narrow, "qp_planned", plan=qt.plan(narrow))
    with pytest.raises(qt.InvalidInput, match="the plan has 101 waypoints, the path 6"):
        qt.follow(short_line(6), "qp_planned", plan=plan)
    with pytest.raises(qt.InvalidInput, match="Plan"):
        qt.follow(task, "qp_planned", plan=plan.q)


def test_a_task_file_may_ask_for_the_best_start(tmp_path: Path) -> None:
    text = (ROOT / "tasks" / "planar_line.toml").read_text("utf-8")
    text = text.replace("steps_per_segment = 100", "steps_per_segment = 20")
    file = tmp_path / "best.toml"
    head, tail = text.split("[start]")
    rest = tail[tail.index("\n[") :]
    file.write_text(f'start = "best"\n{head}{rest}', "utf-8")
    task = qt.load_task(file)
    assert task.best_start
    comparison = qt.compare(task, ["minimum_norm", "qp_planned"])
    plan = qt.plan(task)
    for trajectory in comparison.trajectories.values():
        np.testing.assert_allclose(trajectory.q[0], plan.start, atol=1e-6)
    # A method that plans has a start of its own: that of the best plan for its objective.
    shortest = qt.plan(task, "travel")
    run = qt.follow(task, "qp_planned", objective="travel")
    np.testing.assert_allclose(run.q[0], shortest.start, atol=1e-9)
    assert np.abs(shortest.start - plan.start).max() > 1e-3
    said = list[str]()
    known = qt.follow(task, "qp_planned", plan=shortest, planning=lambda what, _: said.append(what))
    np.testing.assert_allclose(known.q, run.q, atol=1e-9)
    assert not said  # nothing was planned once more
    file.write_text(f'start = "worst"\n{head}{rest}', "utf-8")
    with pytest.raises(qt.TaskFileError, match="start"):
        qt.load_task(file)
    file.write_text(f"{text}\nbest = true\n".replace("[start]", "[start]\nbest = true"), "utf-8")
    with pytest.raises(qt.TaskFileError):
        qt.load_task(file)


def test_the_best_start_needs_a_path_that_does_not_depend_on_it(tmp_path: Path) -> None:
    text = (ROOT / "tasks" / "planar_line.toml").read_text("utf-8")
    head, tail = text.split("[start]")
    rest = tail[tail.index("\n[") :]
    whole = head.replace("[projector]", "[projector]\nangular = { line = [0, 0, 1] }")
    whole = "\n".join(line for line in whole.splitlines() if line.strip() != 'angular = "none"')
    file = tmp_path / "held.toml"
    file.write_text(f'start = "best"\n{whole}{rest}', "utf-8")
    with pytest.raises(qt.TaskFileError, match=r"path\.tool_axis"):
        qt.load_task(file)


def test_a_comparison_with_a_plan_names_the_bound_that_no_motion_can_be_below() -> None:
    comparison = qt.compare(short_line(21), ["qp_gradient", "qp_planned"])
    task = comparison.path_task
    bound = qt.plan(task, start=task.start).bound
    assert comparison.z_bound == pytest.approx(bound)
    assert comparison.to_dict()["mean_z_bound"] == comparison.z_bound
    values = {name: run.z.mean() for name, run in comparison.trajectories.items()}
    assert bound <= min(values.values()) * (1.0 + 1e-9)
    [best] = [sentence for sentence in comparison.findings() if "the bound" in sentence]
    assert "mean z" in best
    ratio = f"{min(values.values()) / bound:#.3g}"
    assert ("times the bound" in best) == (ratio != "1.00")
    assert ratio == "1.00" or f"{ratio} times the bound" in best
    assert qt.compare(task, ["qp_gradient"]).z_bound is None
    elsewhere = dataclasses.replace(task, starts={"qp_gradient": task.start + 0.1})
    assert qt.compare(elsewhere, ["qp_gradient", "qp_planned"]).z_bound is None
    assert qt.follow(task, "qp_planned", objective="travel").z_bound is None


@pytest.mark.parametrize("method_solver", ["daqp", "osqp"])
def test_a_plan_is_followed_to_rounding_where_it_meets_the_task(method_solver: str) -> None:
    """Along the limits, too: there a step that is linear at the last waypoint finds no way."""
    task = qt.load_task("planar_line")
    ranges = qt.JointRanges.of(task.model)
    plan = qt.plan(task, start=task.start)
    # Limits as narrow as the plan just allows: most joints touch one of them somewhere.
    model = copy.copy(task.model)
    model.jnt_range[:, 0], model.jnt_range[:, 1] = plan.motion().min(0), plan.motion().max(0)
    narrow = dataclasses.replace(task, model=model)
    run = qt.follow(narrow, "qp_planned", plan=plan, solver=method_solver)
    np.testing.assert_allclose(run.q, plan.motion(), atol=1e-7)
    assert run.position_error.max() < 1e-8 and not run.failure
    assert (qt.JointRanges.of(model).margins(run.q).min(axis=0) < 1e-6).all()
    assert ranges.margins(run.q).min() > 0.0


def test_a_task_that_leaves_nothing_free_is_planned() -> None:
    """The whole pose of the planar arm: two configurations a waypoint, and nothing to move."""
    task = qt.load_task("planar_line")
    whole = dataclasses.replace(
        task, projector=task.operational, waypoints=task.waypoints[:5], flipped_waypoints=None
    )
    plan = qt.plan(whole)
    assert plan.motion().shape == (5, 3)
    assert plan.value == pytest.approx(plan.bound, rel=1e-6)
    assert plan.between.position.at.max() < 1e-8 and plan.between.axis.at.max() < 1e-8

"""Motion limits: the viable speed, boxes that never become empty, recovery, kinds, couplings."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles.arms import chain, random_arm, random_configuration, random_direction
from oracles.twists import ROLL_FREE, site
from oracles.walks import walk
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist.constraints import Box, Intersection, gather_limits, stopping_speed

Array = np.ndarray
SEEDS = st.integers(0, 2**32 - 1)
DECADES = st.floats(-6.0, 6.0).map(lambda exponent: 10.0**exponent)


def slide(low: float, high: float) -> mujoco.MjModel:
    return chain(f'type="slide" range="{low!r} {high!r}"')


def braking(speed: float, acceleration: float, dt: float) -> Array:
    """Speeds of each step of the hardest braking, this one the first, by going through them."""
    steps = int(speed / (acceleration * dt)) + 2
    return np.maximum(speed - acceleration * dt * np.arange(steps), 0.0)


@given(DECADES, DECADES, DECADES)
@settings(max_examples=60)
def test_braking_from_the_stopping_speed_stops_in_time_and_from_any_faster_one_does_not(
    room: float, acceleration: float, dt: float
) -> None:
    speed = float(stopping_speed(np.array(room), np.array(acceleration), dt))
    assume(speed / (acceleration * dt) < 1e6)
    assert braking(speed, acceleration, dt).sum() * dt == pytest.approx(room, rel=1e-9)
    assert braking(speed * (1 + 1e-6), acceleration, dt).sum() * dt > room * (1 + 1e-8)


class Drive(NamedTuple):
    """A run that picks its velocities from the boxes of a limit.

    Attributes:
        positions: q at the start and after each step, (steps + 1, nq).
        velocities: That before the first step, and that of each, (steps + 1, nv).
        reports: What recovers, before each step.
        gaps: By how much the boxes of each step fail to meet, as displacements; ≤ 0 if they meet.
    """

    positions: Array
    velocities: Array
    reports: list[tuple[str, ...]]
    gaps: list[float]


def drive(
    model: mujoco.MjModel, limit: qt.MotionLimit, q: Sequence[float], dt: float, steps: int,
    choose: Callable[[Array, Array], Array],
) -> Drive:  # fmt: skip
    configuration = mink.Configuration(model, np.array(q))
    positions, velocities, reports, gaps = [configuration.q], [limit.velocity], [], []
    for _ in range(steps):
        reports.append(limit.recovering(configuration, dt))
        boxes = limit.boxes(configuration, dt)
        lower = np.max([box.lower for box in boxes], axis=0)
        upper = np.min([box.upper for box in boxes], axis=0)
        gaps.append(float((lower - upper).max() * dt))
        box = Intersection(boxes, model)
        assert (box.lower <= box.upper).all()
        velocities.append(choose(box.lower, box.upper))
        configuration.integrate_inplace(velocities[-1], dt)
        limit.note(velocities[-1])
        positions.append(configuration.q)
    return Drive(np.array(positions), np.array(velocities), reports, gaps)


def restless(rng: np.random.Generator) -> Callable[[Array, Array], Array]:
    """Full speed one way or the other, or anything between; for a while, then something else."""
    share = 1.0

    def choose(lower: Array, upper: Array) -> Array:
        nonlocal share
        if rng.uniform() < 0.05:
            share = rng.choice([0.0, 1.0, rng.uniform()])
        # By np.where since lower + (upper − lower) is not upper, as rounded.
        between = lower + share * (upper - lower)
        return np.where(share == 1.0, upper, np.clip(between, lower, upper))

    return choose


@given(SEEDS, DECADES, DECADES, DECADES, DECADES)
@settings(max_examples=20)
def test_from_a_viable_state_the_box_is_never_empty_and_all_limits_hold(
    seed: int, width: float, fastest: float, acceleration: float, dt: float
) -> None:
    rng = np.random.default_rng(seed)
    # MuJoCo keeps a range's ends as they are; an offset makes positions round.
    low = -width * rng.uniform()
    model = slide(low, low + width)
    limit = qt.MotionLimit(model, velocity=fastest, acceleration=acceleration)
    run = drive(model, limit, [low + 0.5 * width], dt, 80, restless(rng))
    low, high = model.jnt_range[0]
    # Positions round to a share of the range.
    rounding = 1e-14 * max(abs(low), abs(high))
    assert max(run.gaps) <= rounding
    assert low <= run.positions.min() and run.positions.max() <= high
    assert np.abs(run.velocities).max() <= fastest
    change = acceleration * dt
    changes = np.abs(np.diff(run.velocities, axis=0))
    assert (changes <= change + 1e-15 * (np.abs(run.velocities[1:]) + change)).all()
    assert not any(run.reports)


def test_the_limit_is_reached_in_the_shortest_time_that_a_linear_program_knows() -> None:
    low, high, fastest, acceleration, dt, steps = -1.0, 0.8, 1.5, 4.0, 0.05, 50
    model = slide(low, high)
    limit = qt.MotionLimit(model, velocity=fastest, acceleration=acceleration)
    run = drive(model, limit, [-0.9], dt, steps, lambda _, upper: upper)
    # Most ∑ v (the furthest sum of positions) under the same limits over the whole horizon, which
    # ends at rest.
    differences = np.eye(steps) - np.eye(steps, k=-1)
    sums = np.tril(np.ones((steps, steps))) * dt
    best = linprog(
        -sums.sum(axis=0),
        A_ub=np.vstack([differences, -differences, sums]),
        b_ub=np.concatenate([np.full(2 * steps, acceleration * dt), np.full(steps, high + 0.9)]),
        A_eq=np.eye(steps)[-1:],
        b_eq=[0.0],
        bounds=(-fastest, fastest),
    )
    assert best.status == 0
    assert run.velocities[1:, 0] == pytest.approx(best.x, abs=1e-6)
    assert run.positions[-1] == pytest.approx(high, abs=1e-9)


def test_a_start_outside_returns_as_fast_as_acceleration_and_velocity_limits_allow() -> None:
    model = chain('range="-1 1"', 'range="-2 0.5"')
    limit = qt.MotionLimit(model, velocity=0.4, acceleration=2.0)
    run = drive(
        model, limit, [0.0, 0.53], 0.01, 40, lambda lower, upper: np.clip(9.0, lower, upper)
    )
    assert run.reports[0] == ("joint_2 is 0.03 rad above its range",)
    outside = run.positions[:-1, 1] > 0.5 + 1e-9
    for k in np.flatnonzero(outside):
        room = 0.5 - run.positions[k][1]
        before = run.velocities[k][1]
        wanted = np.clip(max(room / 0.01, -0.4), before - 0.02, before + 0.02)
        assert run.velocities[k + 1][1] == pytest.approx(wanted)
    # ½ · 0.4²/2 = 0.04 > 0.03: it does not come to full speed; 0.03 = ½ · 2 · t².
    assert np.flatnonzero(outside)[-1] == pytest.approx(np.sqrt(0.03) / 0.01, abs=2)
    assert run.positions[-1][1] <= 0.5
    assert not any(run.reports[int(outside.sum()) :])


def test_a_joint_too_fast_to_stop_brakes_as_hard_as_it_can_and_comes_back() -> None:
    model = slide(-1.0, 1.0)
    limit = qt.MotionLimit(model, velocity=2.0, acceleration=5.0)
    limit.note([1.5])
    run = drive(model, limit, [0.9], 0.01, 100, lambda _, upper: upper)
    [sentence] = run.reports[0]
    assert sentence.startswith(
        "joint_1 moves at 1.5 m/s and cannot stop within the 0.1 m to the up"
    )
    speeds = run.velocities[:, 0]
    hardest = braking(1.5, 5.0, 0.01)[1:30]
    assert speeds[1 : 1 + len(hardest)] == pytest.approx(hardest, abs=1e-12)
    assert np.max(run.positions) == pytest.approx(0.9 + hardest.sum() * 0.01)
    assert np.abs(np.diff(speeds)).max() <= 0.05 + 1e-12
    assert run.positions[-1] == pytest.approx(1.0, abs=1e-9)
    assert run.reports[-1] == ()


def test_each_bound_knows_which_limit_set_it() -> None:
    model = chain('range="-1 1"', 'range="-1 1"', 'range="-9 9"', 'type="ball"')
    limit = qt.MotionLimit(
        model, velocity={"joint_3": 0.5}, acceleration={"joint_2": 2.0, "joint_3": 9.0}
    )
    limit.note([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    q = mink.Configuration(model, np.array([0.99, 0.2, 0.0, 1.0, 0.0, 0.0, 0.0]))
    gathered = gather_limits([limit], q, 0.1)
    assert gathered.upper[:3] == pytest.approx([0.1, 0.2, 0.5])
    assert gathered.lower[:3] == pytest.approx([-19.9, -0.2, -0.5])
    assert list(gathered.upper_kind[:3]) == ["position", "acceleration", "velocity"]
    assert list(gathered.lower_kind[:3]) == ["position", "acceleration", "velocity"]
    assert np.isinf(gathered.upper[3:]).all()
    limit.note([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    gathered = gather_limits([limit], q, 0.1)
    # Too fast: both bounds are what the acceleration limit allows.
    assert gathered.lower[2] == gathered.upper[2] == pytest.approx(-0.6)
    assert gathered.lower_kind[2] == gathered.upper_kind[2] == "acceleration"


def test_of_contradicting_limits_position_gives_way_to_velocity_and_both_to_acceleration() -> None:
    model = slide(-1.0, 1.0)

    def common(*boxes: tuple[str, float, float]) -> tuple[float, float, str, str]:
        limits = [Box(kind, np.array([low]), np.array([high])) for kind, low, high in boxes]
        forth, back = (
            (box.lower, box.upper, box.lower_kind, box.upper_kind)
            for box in (Intersection(limits, model), Intersection(limits[::-1], model))
        )
        assert [x[0] for x in forth] == [x[0] for x in back]
        return tuple(x[0] for x in forth)

    acceleration, velocity = ("acceleration", 1.0, 2.0), ("velocity", -0.5, 0.5)
    assert common(("position", 5.0, 9.0), velocity, acceleration) == (
        1.0,
        1.0,
        *["acceleration"] * 2,
    )
    assert common(("position", 5.0, 9.0), velocity) == (0.5, 0.5, "velocity", "velocity")
    assert common(("position", 5.0, 9.0), ("wall", -1.0, 0.0)) == (0.0, 0.0, "wall", "wall")
    assert common(("position", 0.2, 9.0), velocity) == (0.2, 0.5, "position", "velocity")
    for boxes in (
        (velocity, ("wall", 0.6, 1.0)),
        (acceleration, ("wall", 0.6, 0.9)),
        (("position", 0.0, 1.0), ("position", 2.0, 3.0)),
    ):
        with pytest.raises(qt.InvalidInput, match=r"'joint_1'.*lower velocity bound.*above"):
            common(*boxes)
    with pytest.raises(qt.InvalidInput, match="wall limit has bounds of nan"):
        common(("wall", np.nan, 1.0))
    with pytest.raises(qt.InvalidInput, match="wall limit has bounds of inf"):
        common(("wall", np.inf, np.inf))
    with pytest.raises(qt.InvalidInput, match=r"shape \(2,\).*needs \(1,\)"):
        Intersection([Box("wall", np.zeros(2), np.ones(2))], model)


def test_the_controller_keeps_all_limits_under_reversing_and_infeasible_commands() -> None:
    reached = np.zeros(3, dtype=bool)
    for joints in range(5, 9):
        rng = np.random.default_rng(joints)
        model = random_arm(rng, joints, slides=joints % 2 == 0)
        low, high = model.jnt_range.T
        fastest, hardest = rng.uniform(0.5, 2.0, joints), rng.uniform(1.0, 10.0, joints)
        limit = qt.MotionLimit(model, velocity=fastest, acceleration=hardest)
        configuration = mink.Configuration(model, random_configuration(model, rng))
        task, dt = qt.TwistTask("tool", "site", ROLL_FREE), 0.02
        controller = qt.Controller(model, [task], limits=[limit])
        passed = []
        for k in range(120):
            if k % 15 == 0:
                here, way = site(configuration), 10.0 ** rng.uniform(-2, 1) * random_direction(rng)
            if k % 40 == 20:
                way = -way
            task.set_target(here.plus(np.concatenate([way, random_direction(rng)])))
            passed.append(walk(controller, configuration, 1, dt))
        q, v = (np.vstack(rows) for rows in zip(*passed, strict=True))
        change = np.abs(np.diff(v, axis=0, prepend=np.zeros((1, joints))))
        assert (np.abs(v) <= fastest).all()
        assert (change <= hardest * dt + 1e-12).all()
        assert (q >= low).all() and (q <= high).all()
        reached |= [
            np.minimum(q - low, high - q).min() < 1e-9,
            np.isclose(np.abs(v), fastest).any(),
            np.isclose(change, hardest * dt).any(),
        ]
    assert reached.all()


@pytest.mark.parametrize("ratio", [1.0, -1.0, 2.5, -0.4])
def test_coupled_joints_share_their_limits_so_that_the_coupling_fits_into_the_box(
    ratio: float,
) -> None:
    # joint_1 = 0.1 + r joint_2 (MuJoCo counts from the reference positions), joint_3 = joint_1 / 2.
    model = chain(
        'range="-1 1" ref="0.2"', 'range="-0.7 1.5"', 'range="-1 1"',
        equality=f'''<joint joint1="joint_1" joint2="joint_2" polycoef="-0.1 {ratio} 0 0 0"/>
        <joint joint1="joint_3" joint2="joint_1" polycoef="0.1 0.5 0 0 0"/>
        <joint joint1="joint_1" joint2="joint_3" polycoef="9 9 9 9 9" active="false"/>''',
    )  # fmt: skip
    limit = qt.MotionLimit(model, velocity=[1.0, 0.8, 3.0], acceleration=[5.0, 9.0, 1.0])
    direction = np.array([ratio, 1.0, ratio / 2])
    rng = np.random.default_rng(0)
    choice = restless(rng)

    def along_the_coupling(lower: Array, upper: Array) -> Array:
        ends = np.sort([lower / direction, upper / direction], axis=0)
        low, high = ends[0].max(), ends[1].min()
        assert low <= high + 1e-9
        return direction * choice(low, max(low, high))

    run = drive(model, limit, [0.1, 0.0, 0.05], 0.01, 800, along_the_coupling)
    positions = run.positions
    assert (positions >= model.jnt_range[:, 0] - 1e-9).all()
    assert (positions <= model.jnt_range[:, 1] + 1e-9).all()
    assert np.ptp(positions[:, 1]) > 0.4
    assert np.abs(np.diff(run.velocities, axis=0)).max(axis=0)[2] <= 1.0 * 0.01 + 1e-12


def test_ball_and_free_joints_have_velocity_and_acceleration_limits_on_each_dof() -> None:
    model = chain('type="free"', 'range="-1 1"', 'type="ball"')
    limit = qt.MotionLimit(model, velocity={"joint_1": 2.0}, acceleration={"joint_3": 3.0})
    lower, upper = limit.bounds(mink.Configuration(model), 0.1)
    assert upper == pytest.approx([*[2.0] * 6, 10.0, *[0.3] * 3])
    assert lower == pytest.approx(-upper)
    limited = chain('type="ball" range="0 1"')
    with pytest.raises(qt.InvalidInput, match=r"MotionLimit: ball joint 'joint_1' has a limit"):
        qt.MotionLimit(limited)


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"velocity": {"joint_9": 1.0}}, r"velocity\.joint_9: .*no joint.*joint_1, joint_2"),
        ({"velocity": {"joint_1": -1.0}}, r"velocity\.joint_1: expected numbers above 0, got -1"),
        ({"acceleration": 0.0}, "acceleration: expected numbers above 0"),
        ({"acceleration": [1.0, np.nan]}, "acceleration: expected numbers above 0"),
        ({"acceleration": [1.0, 2.0, 3.0]}, r"expected a number or 2 of them.*shape \(3,\)"),
        ({"velocity": {"joint_1": [1.0, 2.0]}}, r"velocity\.joint_1: expected a number, got"),
        ({"velocity": "fast"}, "velocity: expected numbers, got 'fast'"),
        ({"recovery_speed": 0.0}, "recovery_speed"),
    ],
)
def test_wrong_limits_are_refused(keywords: dict, sentence: str) -> None:
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.MotionLimit(chain("", ""), **keywords)

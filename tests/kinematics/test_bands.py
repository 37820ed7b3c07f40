"""Tolerance bands: exact gradients, containment to second order, recovery, refusals, task files."""

import math
from pathlib import Path

import mink
import numpy as np
import pytest
import qpsolvers
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration, random_direction, random_rotation
from oracles.twists import FRAMES, NOTHING, ROLL_FREE, SPATIAL, X, Y, Z, pose, turn
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.comparison import metrics
from qp_twist.kinematics import FramePair, frame_pose
from qp_twist.kinematics.cone_band import FACES
from qp_twist.paths import shipped_folder

seeds = st.integers(0, 2**32 - 1)


def pair_at(rotation: Array, position: Array = X, target: Array = X) -> FramePair:
    """A frame whose target is not turned and rests."""
    return FramePair(rotation, position, np.eye(3), target, np.zeros(6))


def moved(pair: FramePair, body: Array, dt: float) -> FramePair:
    """Where a frame and its target are after their twists have acted for a time."""
    return FramePair(
        turn(dt * body[3:]) @ pair.rotation,
        pair.position + dt * body[:3],
        turn(dt * pair.target_twist[3:]) @ pair.target_rotation,
        pair.target_position + dt * pair.target_twist[:3],
        pair.target_twist,
    )


def axes(pair: FramePair, frame: str) -> Array:
    return {"body": pair.rotation, "target": pair.target_rotation, "world": np.eye(3)}[frame]


def roll(pair: FramePair, axis: Array, frame: str) -> float:
    """The rotation about the axis that is nearest to E, by the traces: no quaternion."""
    E = pair.rotation @ pair.target_rotation.T
    a = axes(pair, frame) @ axis
    w = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
    return math.atan2(a @ w, np.trace(E) - a @ E @ a)


def plane_vector(pair: FramePair, axis: Array, reference: Array, frame: str) -> Array:
    """x = θ e seen from what the reference is fixed to: its component along it is zero."""
    u = axes(pair, frame).T @ pair.rotation @ axis
    across = u - (u @ reference) * reference
    angle = math.atan2(np.linalg.norm(across), u @ reference)
    return angle * across / np.linalg.norm(across)


def random_pair(rng: np.random.Generator, *, apart: float = 1.0) -> FramePair:
    target = random_rotation(rng)
    offset = apart * rng.uniform(0.1, 1.0) * random_direction(rng)
    position = rng.normal(size=3)
    return FramePair(
        turn(offset) @ target, position + rng.normal(size=3), target, position, rng.normal(size=6)
    )


def rates(band: qt.ToleranceBand, pair: FramePair, body: Array, rooms: Array) -> Array:
    """What a band's rows say of the rates of its values: row · twist less what is no room."""
    rows, bounds = band.half_spaces(pair, 1.0, NOTHING)
    return rows @ body - bounds + rooms


# ---------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", ["roll", "slab"])
@settings(max_examples=20)
@given(seed=seeds)
def test_the_gradients_of_the_roll_and_the_slab(kind: str, frame: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pair, a, body = random_pair(rng, apart=2.0), random_direction(rng), rng.normal(size=6)

    def value(h: float = 0.0) -> float:
        there = moved(pair, body, h)
        if kind == "roll":
            return roll(there, a, frame)
        return float(axes(there, frame) @ a @ (there.position - there.target_position))

    made = qt.RollBand if kind == "roll" else qt.SlabBand
    band = made(a, value() - 0.3, value() + 0.2, frame=frame)
    found = rates(band, pair, body, np.array([0.3, 0.2]))
    change = value(1e-6) - value(-1e-6)
    rate = (math.remainder(change, 2 * math.pi) if kind == "roll" else change) / 2e-6
    assert found == pytest.approx([-rate, rate], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("frame", ["target", "world"])
@settings(max_examples=20)
@given(seed=seeds)
def test_the_gradients_of_the_cone(frame: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pair, a, body = random_pair(rng), random_direction(rng), rng.normal(size=6)
    towards = axes(pair, frame).T @ pair.rotation @ a
    n = turn(rng.uniform(0.05, 1.4) * random_direction(rng)) @ towards
    x = plane_vector(pair, a, n, frame)
    angle = float(np.linalg.norm(x))
    upper, lower = rng.uniform(angle, 1.5), 0.5 * angle
    band = qt.ConeBand(a, n, upper, lower, frame=frame)
    around = 2 * math.pi / FACES * np.arange(FACES)
    rooms = np.append(upper - angle * np.cos(around), angle - lower)
    found = rates(band, pair, body, rooms)
    before, after = (plane_vector(moved(pair, body, h), a, n, frame) for h in (-1e-6, 1e-6))
    rate, e = (after - before) / 2e-6, x / angle
    expected = np.cos(around) * (rate @ e) + np.sin(around) * (rate @ np.cross(n, e))
    assert found == pytest.approx(np.append(expected, -rate @ e), rel=1e-5, abs=1e-6)


# ---------------------------------------------------------------------------------- the polygon


@pytest.mark.parametrize("upper_deg", [2.0, 20.0])
def test_a_cone_lets_everything_inside_through_and_its_polygon_by_two_percent(
    upper_deg: float,
) -> None:
    """Brute force: finite rotations of an axis within the cone, in all directions."""
    rng = np.random.default_rng(1)
    upper = math.radians(upper_deg)
    # A recovery that is not in the way: the axis always starts inside.
    band = qt.ConeBand(Z, Z, upper)
    single, polygon = [], []
    for _ in range(200):
        start = upper * math.sqrt(rng.uniform()) * np.append(random_direction(rng)[:2], 0.0)
        pair = pair_at(turn(start), 0 * X, 0 * X)
        u = pair.rotation @ Z
        rows, bounds = band.half_spaces(pair, 1.0, NOTHING)
        omegas = np.cross(u, rng.normal(size=(200, 3)))
        omegas *= 3.0 * upper * rng.uniform(size=(200, 1)) / np.linalg.norm(omegas, axis=1)[:, None]
        ends = np.arccos(np.minimum(1.0, Rotation.from_rotvec(omegas).apply(u)[:, 2]))
        held = omegas @ rows[:, 3:].T <= bounds
        assert held[ends <= (0.98 - upper**2) * upper].all()
        polygon.extend(ends[held.all(axis=1)])
        single.extend(ends[held[:, 0]])
    assert len(polygon) > 1000
    # The sphere's curvature over the step adds a share of upper².
    corner = upper / math.cos(math.pi / FACES)
    assert max(polygon) <= corner * (1.0 + upper**2)
    assert max(polygon) > 1.005 * upper
    assert max(single) > 2.0 * upper


# ---------------------------------------------------------------------------------- containment

HALF = math.radians(5.0)


def solve(
    task: qt.TwistTask, configuration: mink.Configuration, dt: float, desired: Array
) -> Array:
    """The velocity nearest to a desired one that holds the task and its bands."""
    blocks = task.band_rows(configuration, dt)
    A, b = task.velocity_rows(configuration, dt)
    velocity = qpsolvers.solve_qp(
        np.eye(len(desired)), -desired,
        np.vstack([block.rows for block in blocks]),
        np.concatenate([block.bounds for block in blocks]),
        A if len(A) else None, b if len(b) else None, solver="daqp",
    )  # fmt: skip
    assert velocity is not None
    return velocity


def reach(configuration: mink.Configuration) -> float:
    """No joint is further from the tool than this, in any posture."""
    model = configuration.model
    return float(np.linalg.norm(model.body_pos, axis=1).sum() + np.linalg.norm(model.site_pos[0]))


def build(kind: str, axis: Array, e: Array) -> qt.ToleranceBand:
    """A band with the frame on its edge when it stands on its target."""
    aside = np.cross(axis, e) / np.linalg.norm(np.cross(axis, e))
    if kind == "roll":
        return qt.RollBand(axis, -0.5, 0.0)
    if kind == "tilt":
        return qt.ConeBand(axis, turn(HALF * aside) @ axis, HALF)
    if kind == "lead":
        return qt.ConeBand(axis, turn(0.35 * aside) @ axis, 0.7, 0.35)
    return qt.SlabBand(axis, -0.1, 0.0, frame="body" if kind == "body slab" else "target")


def bound(kind: str, configuration: mink.Configuration, angle: float) -> float:
    """What docs/equations.md says of a step in which the hinges turn by ``angle`` in all."""
    lengths = reach(configuration)
    return angle**2 * {
        "roll": 0.5 / math.cos(0.5 * angle) ** 2,
        "tilt": min(0.5 / math.tan(HALF), 0.02 * HALF / angle**2) + 2.1,
        "lead": 0.5,
        "slab": 0.5 * lengths,
        "body slab": 1.5 * lengths + 0.75 * angle * lengths,
    }[kind]  # fmt: skip


KINDS = ("roll", "tilt", "lead", "slab", "body slab")


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_from_the_edge_overshoots_to_second_order(kind: str) -> None:
    ratios = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        model = random_arm(rng, 7, limited=False)
        configuration = mink.Configuration(model, random_configuration(model, rng))
        band = build(kind, random_direction(rng), random_direction(rng))
        task = qt.TwistTask("tool", "site", NOTHING, bands=[band])
        task.set_target_from_configuration(configuration)
        desired = rng.normal(size=7)
        excess = []
        for dt in (0.1, 0.004, 0.002):
            velocity = solve(task, configuration, dt, desired)
            end = mink.Configuration(model, configuration.integrate(velocity, dt))
            excess.append(float(task.band_excess(end)[0]))
            angle = dt * float(np.abs(velocity).sum())
            assert excess[-1] <= bound(kind, configuration, angle) + 1e-12
        if excess[1] > 1e-7:
            ratios.append(excess[1] / excess[2])
    assert len(ratios) >= 2
    assert np.array(ratios) == pytest.approx(4.0, abs=0.5)


def outwards(task: qt.TwistTask, configuration: mink.Configuration, dt: float) -> Array:
    """A unit joint velocity that leaves the band at its nearest end."""
    [rows] = task.band_rows(configuration, dt)
    row: Array = rows.rows[int(np.argmin(rows.bounds))]
    return row / np.linalg.norm(row)


def test_a_band_beside_five_rows_moves_with_the_target() -> None:
    """The rows of T stay equalities; without the target's twist the excess is of first order."""
    rng = np.random.default_rng(4)
    model = random_arm(rng, 7, limited=False)
    home = random_configuration(model, rng)
    twist = np.array([0.05, 0.1, -0.05, 0.3, -0.2, 0.4])
    worst = []
    for dt in (0.02, 0.01):
        configuration = mink.Configuration(model, home)
        rotation, position = frame_pose(configuration, "tool", "site")
        task = qt.TwistTask("tool", "site", ROLL_FREE, bands=[qt.RollBand(Z, -0.1, 0.1)])
        excess = []
        for time in np.arange(0.0, 0.6, dt):
            target = pose(turn(time * twist[3:]) @ rotation, position + time * twist[:3])
            task.set_target(target, twist)
            excess.append(float(task.band_excess(configuration)[0]))
            A, b = task.velocity_rows(configuration, dt)
            push = outwards(task, configuration, dt)
            velocity = solve(task, configuration, dt, 2.0 * push)
            assert A @ velocity == pytest.approx(b, abs=1e-8)
            configuration.integrate_inplace(velocity, dt)
        worst.append(max(excess))
    assert 1e-7 < worst[0] < 1e-3
    assert worst[0] / worst[1] == pytest.approx(4.0, abs=1.0)


# ---------------------------------------------------------------------------------- outside


@pytest.mark.parametrize(
    ("band", "start", "speed"),
    [
        (qt.RollBand(Z, -0.1, 0.1), turn(0.6 * Z), 0.5),
        (qt.RollBand(Z, -0.1, 0.1, recovery_speed=0.2), turn(-0.6 * Z), 0.2),
        (qt.ConeBand(Z, Z, 0.2), turn(0.8 * X), 0.5),
        (qt.ConeBand(Z, Z, 0.2), turn(2.0 * X), 0.5),
        (qt.ConeBand(Z, Z, 0.9, 0.6, recovery_speed=0.3), turn(0.1 * Y), 0.3),
        (qt.ConeBand(Z, Z, 0.9, 0.6), np.eye(3), 0.5),
    ],
    ids=["roll", "roll below", "tilt", "tilt beyond 90°", "lead", "lead at 0"],
)
def test_outside_it_comes_back_at_the_recovery_speed_and_no_faster(
    band: qt.ToleranceBand, start: Array, speed: float
) -> None:
    pair = pair_at(start, 0 * X, 0 * X)
    dt, excess = 0.1, [band.excess(FramePair(start, *pair[1:]))]
    for _ in range(40):
        rows, bounds = band.half_spaces(pair, dt, NOTHING)
        # Least motion that the rows allow, turned by exactly that.
        omega = qpsolvers.solve_qp(np.eye(3), np.zeros(3), rows[:, 3:], bounds, solver="daqp")
        assert omega is not None
        assert np.linalg.norm(omega) <= speed * (1.0 + 1e-6)
        pair = moved(pair, np.append(np.zeros(3), omega), dt)
        excess.append(band.excess(pair))
    expected = np.maximum(excess[0] - speed * dt * np.arange(41), 0.0)
    assert excess == pytest.approx(expected, abs=1e-6)
    assert excess[0] > 0.3


def test_a_roll_band_may_lie_across_the_half_turn() -> None:
    band = qt.RollBand(Z, math.radians(150.0), math.radians(210.0))
    for degrees, expected in ((180, 0), (-170, 0), (155, 0), (-140, 10), (140, 10), (0, 150)):
        pair = pair_at(turn(math.radians(degrees) * Z))
        assert math.degrees(band.excess(pair)) == pytest.approx(expected, abs=1e-9)


# ---------------------------------------------------------------------------------- beside mink


def test_minks_own_solver_keeps_the_band() -> None:
    """A mink task pulls the tool over; the limit holds its tilt and its height."""
    rng = np.random.default_rng(5)
    model = random_arm(rng, 7, limited=False)
    home = random_configuration(model, rng)
    tilts, heights = [], []
    for banded in (False, True):
        configuration = mink.Configuration(model, home)
        rotation, position = frame_pose(configuration, "tool", "site")
        task = qt.TwistTask("tool", "site", NOTHING, bands=[
            qt.ConeBand(Z, rotation @ Z, math.radians(5.0), frame="world"),
            qt.SlabBand(Z, -0.01, 0.01, frame="world"),
            qt.RollBand(Z, -1e-6, 1e-6, weight=1.0),  # soft: mink cannot take it
        ])  # fmt: skip
        task.set_target_from_configuration(configuration)
        pull = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=1.0, gain=0.1)
        pull.set_target(pose(turn(0.8 * random_direction(rng)) @ rotation, position + 0.2 * Z))
        limits: list[mink.Limit] = [qt.BandLimit(task)] if banded else []
        for _ in range(100):
            velocity = mink.solve_ik(configuration, [pull], 0.02, "daqp", 1e-6, limits=limits)
            configuration.integrate_inplace(velocity, 0.02)
            tilt, height, _ = task.band_excess(configuration)
            tilts.append(tilt)
            heights.append(height)
    assert min(max(tilts[:100]), max(heights[:100])) > 0.1
    assert max(tilts[100:]) < math.radians(0.3)
    assert max(heights[100:]) < 1e-3


# ---------------------------------------------------------------------------------- what T fixes


@pytest.mark.parametrize(
    ("bands", "projector", "kept"),
    [
        ([qt.RollBand(Z, -0.1, 0.1)], SPATIAL, 0),
        ([qt.RollBand(Z, 6.0, 2 * math.pi)], SPATIAL, 0),  # a whole turn is none
        ([qt.RollBand(Z, -0.1, 0.1)], ROLL_FREE, 1),
        ([qt.RollBand(X, -0.1, 0.1)], ROLL_FREE, 0),
        ([qt.RollBand(X, -0.1, 0.1, frame="world")], ROLL_FREE, 1),
        ([qt.ConeBand(Z, X, 1.6, 1.5)], ROLL_FREE, 0),
        ([qt.ConeBand(X, Z, 1.6, 1.5)], ROLL_FREE, 0),
        ([qt.ConeBand(X, X, 0.5)], ROLL_FREE, 1),
        ([qt.SlabBand(X, -0.1, 0.1)], SPATIAL, 0),
        ([qt.BoxBand(-X - Y - Z, X + Y + Z)], SPATIAL, 0),
        ([qt.BoxBand(-X - Y - Z, X + Y + Z)], NOTHING, 1),
    ],
)
def test_a_band_has_rows_where_the_projector_leaves_it_free(
    bands: list[qt.ToleranceBand], projector: qt.TwistProjector, kept: int
) -> None:
    rng = np.random.default_rng(6)
    configuration = mink.Configuration(random_arm(rng, 6))
    task = qt.TwistTask("tool", "site", projector, bands=bands)
    task.set_target(pose(random_rotation(rng), X))
    rows = task.band_rows(configuration, 0.1)
    assert len(rows) == kept
    assert task.band_excess(configuration).shape == (1,)


@pytest.mark.parametrize(
    ("band", "projector", "says"),
    [
        (qt.RollBand(Z, 0.1, 0.2), SPATIAL, "holds the value at 0°"),
        (qt.RollBand(Z, math.radians(350), 2 * math.pi - 0.01), SPATIAL, "at 360°"),
        (qt.RollBand(X, 0.1, 0.2), ROLL_FREE, "holds the value at 0°"),
        (qt.ConeBand(Z, X, 0.5), ROLL_FREE, "holds the value at 90°"),
        (qt.ConeBand(X, Y, 0.5), SPATIAL, "holds the value at 90°"),
        (qt.SlabBand(X, 0.1, 0.2), ROLL_FREE, "holds the value at 0 m"),
        (qt.BoxBand([-1, 0.1, -1], [1, 1, 1]), SPATIAL, "holds the value along y at 0 m"),
    ],
)
def test_a_band_that_contradicts_the_projector_is_refused(
    band: qt.ToleranceBand, projector: qt.TwistProjector, says: str
) -> None:
    with pytest.raises(qt.InvalidInput, match=f"contradicts the projector: it .*{says}"):
        qt.TwistTask("tool", "site", projector, bands=[band])


# ---------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: qt.RollBand(Z, 1.0, -1.0), "lower = 1 rad (57.2958°) is above upper = -1 rad"),
        (lambda: qt.RollBand(Z, -180.0, 180.0), "in rad"),
        (lambda: qt.RollBand(Z, -3.2, 3.2), "whole turn"),
        (lambda: qt.ConeBand(Z, Z, 3.2), "at most 3.14159"),
        (lambda: qt.ConeBand(Z, Z, 0.0), "above 0"),
        (lambda: qt.ConeBand(Z, Z, 0.1, 0.2), "lower = 0.2 rad (11.4592°) is above"),
        (lambda: qt.ConeBand(Z, Z, 0.1, frame="body"), "one of target, world"),
        (lambda: qt.SlabBand(Z, 0.1, -0.1), "lower = 0.1 m is above"),
        (lambda: qt.BoxBand([0, 0, 0], [1, -1, 1]), "above upper = -1 m"),
        (lambda: qt.SlabBand(Z, 0.0, 0.1, weight=0.0), "weight=…): expected a number above 0"),
        (lambda: qt.SlabBand(Z, 0.0, 0.1, weight=1e13), "at most 1e.12"),
        (lambda: qt.TwistTask("tool", "site", NOTHING, bands=qt.SlabBand(Z, 0, 1)), "a list of b"),
        (lambda: qt.BandLimit(qt.TwistTask("tool", "site", NOTHING)), "no hard band"),
    ],
)  # fmt: skip
def test_nonsense_is_named(build: object, says: str) -> None:
    assert callable(build)
    with pytest.raises(qt.InvalidInput, match=says.replace("(", r"\(").replace(")", r"\)")):
        build()


def test_bands_need_a_target() -> None:
    task = qt.TwistTask("tool", "site", NOTHING, bands=[qt.SlabBand(Z, -0.1, 0.1)])
    configuration = mink.Configuration(random_arm(np.random.default_rng(0), 3))
    for call in (
        lambda: task.band_rows(configuration, 0.1),
        lambda: task.band_excess(configuration),
    ):
        with pytest.raises(mink.TargetNotSet):
            call()


# ---------------------------------------------------------------------------------- task files

BANDS = """
[[bands]]
kind = "roll"
axis = [0, 0, 2]
lower_deg = -30
upper_deg = 60.0

[[bands]]
kind = "cone"
axis = [0, 0, 1]
reference = [1, 0, 0]
upper_deg = 120
lower_deg = 60
weight = 4.0

[[bands]]
kind = "slab"
normal = [0, 1, 0]
lower = -0.01
upper = 0.02
frame = "world"

[[bands]]
kind = "box"
lower = [-0.1, -0.2, -0.3]
upper = [0.1, 0.2, 0.3]
frame = "body"
"""


def write(folder: Path, bands: str) -> Path:
    """deburring.toml with bands, and nothing else changed."""
    text = (shipped_folder("tasks") / "deburring.toml").read_text("utf-8")
    path = folder / "banded.toml"
    path.write_text(text + bands, encoding="utf-8")
    return path


def test_bands_of_a_task_file_are_those_of_the_task(tmp_path: Path) -> None:
    roll, cone, slab, box = qt.load_task(write(tmp_path, BANDS)).bands
    assert isinstance(roll, qt.RollBand)
    assert roll.ranges[0] == pytest.approx((-math.pi / 6, math.pi / 3))
    assert roll.axis == pytest.approx(Z)
    assert (roll.frame, roll.weight) == ("body", None)
    assert isinstance(cone, qt.ConeBand)
    assert cone.ranges[0] == pytest.approx((math.pi / 3, 2 * math.pi / 3))
    assert (cone.frame, cone.weight) == ("target", 4.0)
    assert isinstance(slab, qt.SlabBand)
    assert (slab.ranges[0], slab.frame) == ((-0.01, 0.02), "world")
    assert isinstance(box, qt.BoxBand)
    assert (box.upper.tolist(), box.frame) == ([0.1, 0.2, 0.3], "body")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("upper_deg = 60.0", "upper_deg = -60.0", r"\[0\]: RollBand: lower = .* \(-30°\) is above"),
        ("upper_deg = 60.0", "upper_deg = 400.0", r"line LINE: bands\[0\].upper_deg: .* to 360"),
        ("upper_deg = 120", "upper_deg = 190", r"line LINE: bands\[1\].upper_deg: .* to 180"),
        ("weight = 4.0", "weight = 0.0", r"line LINE: bands\[1\].weight: .*greater than 0"),
        ('kind = "slab"', 'kind = "plate"', r"line LINE: bands\[2\].kind: expected one of 'roll'"),
        ("upper = 0.02", "uper = 0.02", r"line LINE: bands\[2\].uper: .*did you mean 'upper'"),
        ("upper = 0.02", "upper = 0.02\naxis = [0, 0, 1]", r"bands\[2\].axis: unknown key here"),
        ('frame = "body"', 'frame = "tool"', r"line LINE: bands\[3\].frame: .*'body' or 'target'"),
        ("[0, 0, 2]", "[0, 0, 0]", r"bands\[0\]: RollBand\(axis=…\): .*no direction"),
        ("[-0.1, -0.2, -0.3]", "[0.05, -0.2, -0.3]", r"bands: BoxBand.*contradicts the projector"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_band_is_named_with_its_place(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    assert old in BANDS
    path = write(tmp_path, BANDS.replace(old, new, 1))
    lines = path.read_text("utf-8").splitlines()
    line = max((i for i, text in enumerate(lines, start=1) if text == new), default=0)
    with pytest.raises(qt.TaskFileError, match=says.replace("LINE", str(line))):
        qt.load_task(path)


def test_the_shipped_task_with_bands_loads_and_reaches_the_task() -> None:
    path_task = qt.load_task("deburring_bands")
    [band] = path_task.bands
    assert repr(band) == "RollBand([0.0, 0.0, 1.0], -45°…45°, frame='body')"
    comparison = qt.compare(path_task, ["rmr_flipped", "minimum_norm"])
    numbers = comparison.to_dict()["methods"]
    # The roll of rmr_flipped is opposite to the waypoint's own.
    assert numbers["rmr_flipped"]["band_excess_max"] == pytest.approx(math.radians(135.0))
    # A closed form knows no band; its excess is that of the roll, taken by another formula.
    trajectory = comparison.trajectories["minimum_norm"]
    rolls = []
    for q, waypoint in zip(trajectory.q, path_task.waypoints, strict=True):
        rotation, position = frame_pose(mink.Configuration(path_task.model, q), "tool", "site")
        target = waypoint.rotation().as_matrix()
        rolls.append(roll(FramePair(rotation, position, target, position, np.zeros(6)), Z, "body"))
    outside = np.maximum(np.abs(rolls) - math.pi / 4, 0.0)
    assert trajectory.band_excess == pytest.approx(outside, abs=1e-9)
    assert outside.max() > 0.01
    assert "outside a band at 3 waypoints, first at 25" in numbers["minimum_norm"]["status"]
    table = comparison.table().splitlines()
    assert "band" in table[2]
    assert table[3].split()[-1] == "excess"
    assert not any("…" in line for line in table)
    unbanded = metrics(qt.follow(qt.load_task("deburring"), "minimum_norm"))
    assert numbers["minimum_norm"].keys() - unbanded.keys() == {"band_excess_max"}

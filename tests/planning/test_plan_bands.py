"""Plans keep hard tolerance bands: at the waypoints, between them, as well as brute force does."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable

import mink
import numpy as np
import pytest
from oracles.banded_paths import ARM, BANDS, every, least_mean_z, study
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.following import NoStart, find_starts
from qp_twist.kinematics import frame_pose
from qp_twist.paths.placement import placed
from qp_twist.planning import least_z_start, random_start, what_forbids
from qp_twist.planning.hard_constraints import BETWEEN
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm

Array = np.ndarray
X, Y, Z = np.eye(3)
FREE = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
HALF = math.radians(30.0)


def somewhere(index: int) -> qt.PathTask:
    """The task of the bands with its part at a random place, and a range of rolls of ±30°."""
    rng = np.random.default_rng([1, index])
    center = rng.uniform(study.CENTER_FROM, study.CENTER_TO)
    yaw, azimuth = rng.uniform(-np.pi, np.pi, 2)
    tilt = rng.uniform(0.0, study.MAX_TILT) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turn = mink.SO3.exp(tilt) @ mink.SO3.from_z_radians(yaw)
    task = dataclasses.replace(BANDS, bands=(qt.RollBand(Z, -HALF, HALF),))
    return placed(task, turn, [0.0, 1.0, 0.3], center)


# ---------------------------------------------------------------- the bands' own formulas, again


def roll_of(R: Array, R_d: Array) -> Array:
    """Roll about the tool's z of aligned frames: where its x points to."""
    E = np.swapaxes(R_d, -1, -2) @ R
    return np.arctan2(E[..., 1, 0] - E[..., 0, 1], E[..., 0, 0] + E[..., 1, 1])


def tilt_of(R: Array, R_d: Array) -> Array:
    """Angle between the tool's z and the target's, by half the chord."""
    return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(R[..., 2] - R_d[..., 2], axis=-1)))


def lean_of(R: Array, R_d: Array) -> Array:
    """Angle between the tool's x and the world's, likewise."""
    return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(R[..., 0] - X, axis=-1)))


def poses(task: qt.PathTask, q: Array) -> tuple[Array, Array]:
    """Poses of the frame by MuJoCo, one after the other."""
    configuration = mink.Configuration(task.model)
    found = []
    for row in q:
        configuration.update(row)
        found.append(frame_pose(configuration, task.frame_name, task.frame_type))
    return np.array([R for R, _ in found]), np.array([p for _, p in found])


def targets(task: qt.PathTask) -> Array:
    return np.array([w.rotation().as_matrix() for w in task.waypoints])


def outside(
    task: qt.PathTask, q: Array, value: Callable[[Array, Array], Array], low: float, high: float
) -> tuple[float, float]:
    """How far a joint path leaves a range, at the waypoints and at 24 points between any two.

    There each pose is compared with the nearest place of the path: the foot of the perpendicular
    from the tool's tip on the line between the two waypoints.
    """
    R_d = targets(task)
    at = value(poses(task, q)[0], R_d)
    turns = Rotation.from_matrix(R_d[1:] @ np.swapaxes(R_d[:-1], 1, 2)).as_rotvec()
    begin = np.array([w.translation() for w in task.waypoints])
    way = np.diff(begin, axis=0)
    length = np.linalg.norm(way, axis=1)
    between = []
    for share in np.arange(1, 25) / 25.0:
        R, p = poses(task, q[:-1] + share * np.diff(q, axis=0))
        along = np.einsum("ki,ki->k", p - begin[:-1], way) / np.maximum(length, 1e-6) ** 2
        place = np.where(length > 1e-6, np.clip(along, 0.0, 1.0), share)
        on_way = Rotation.from_rotvec(place[:, None] * turns).as_matrix() @ R_d[:-1]
        between.append(value(R, on_way))
    return (
        float(np.maximum(low - at, at - high).max()),
        float(np.maximum(low - np.array(between), np.array(between) - high).max()),
    )


def check_kept(
    plan: qt.Plan, value: Callable[[Array, Array], Array], low: float, high: float
) -> None:
    """All that a banded plan promises, from MuJoCo's kinematics and the formulas above."""
    task, q = plan.path_task, plan.motion()
    ranges = qt.JointRanges.of(task.model)
    R, p = poses(task, q)
    for k, (waypoint, projector) in enumerate(zip(task.waypoints, task.in_force, strict=True)):
        error = qt.geometry.twist_error(
            R[k], p[k], waypoint.rotation().as_matrix(), waypoint.translation(), projector
        )
        assert np.abs(error).max() < 1e-8
    assert ranges.inside(q).all()
    at, between = outside(task, q, value, low, high)
    assert at <= 1e-9
    assert between <= BETWEEN["rad"]


# ---------------------------------------------------------------- the promise


def test_the_rolls_of_the_shipped_task_stay_within_their_band() -> None:
    plan = qt.plan(BANDS)
    check_kept(plan, roll_of, -math.radians(45.0), math.radians(45.0))
    assert plan.bound <= plan.value
    assert "all limits and hard bands" in str(plan.certificate)
    run = qt.follow(BANDS, "qp_planned", plan=plan)
    assert run.position_error.max() < 1e-8 and run.axis_error.max() < 1e-8
    assert run.band_excess.max() <= 1e-9


# ---------------------------------------------------------------- against brute force


def rolls_inside(task: qt.PathTask, inside: Callable[[Array, Array], Array]) -> list[Array]:
    """All in-limit joint positions of each waypoint at rolls 1° apart that are inside."""
    rolls = np.radians(np.arange(0.0, 360.0, 1.0))
    turned = Rotation.from_rotvec(rolls[:, None] * Z).as_matrix()
    found = []
    for waypoint in task.waypoints:
        R_d = waypoint.rotation().as_matrix()
        some = rolls[inside(R_d @ turned, np.broadcast_to(R_d, turned.shape))]
        found.append(ARM.inside_with_turns(ARM.branches(waypoint, some)))
    return found


@pytest.mark.parametrize("index", [0, 3])
def test_a_plan_within_a_range_of_rolls_is_as_central_as_brute_force(index: int) -> None:
    task = every(somewhere(index), 2)
    largest = math.radians(10.0)
    plan = qt.plan(task, max_step_deg=10.0)
    check_kept(plan, roll_of, -HALF, HALF)
    layers = rolls_inside(task, lambda R, R_d: np.abs(roll_of(R, R_d)) <= HALF)
    assert plan.value <= 1.02 * least_mean_z(task, layers, largest)


def test_a_prescribed_axis_and_a_cone_about_the_world_are_kept_as_brute_force_keeps_them() -> None:
    """T holds the tool's z; the band keeps its x within 60° of the world's."""
    most = math.radians(60.0)
    task = every(BANDS, 2, bands=(qt.ConeBand(X, X, most, frame="world"),))
    plan = qt.plan(task, max_step_deg=10.0)
    check_kept(plan, lean_of, 0.0, most)
    layers = rolls_inside(task, lambda R, R_d: lean_of(R, R_d) <= most)
    assert plan.value <= 1.02 * least_mean_z(task, layers, math.radians(10.0))


def test_a_cone_without_a_prescribed_axis_is_kept_as_brute_force_keeps_it() -> None:
    """Only the position is held; the tool may tilt by 10° any way, and roll as it likes."""
    tilt, step = math.radians(10.0), 20.0
    task = every(BANDS, 5, projector=FREE, bands=(qt.ConeBand(Z, Z, tilt),))
    plan = qt.plan(task, max_step_deg=step)
    check_kept(plan, tilt_of, 0.0, tilt)
    run = qt.follow(task, "qp_planned", plan=plan)
    assert run.position_error.max() < 1e-8 and run.band_excess.max() <= 1e-9
    around = [0.0 * X]
    for ring, count in ((0.5, 6), (0.999, 12)):
        angles = 2.0 * np.pi * np.arange(count) / count
        around += [ring * tilt * np.array([np.cos(a), np.sin(a), 0.0]) for a in angles]
    rolls = np.radians(np.arange(0.0, 360.0, 10.0))
    layers = []
    for waypoint in task.waypoints:
        tilted = [
            mink.SE3.from_rotation_and_translation(
                waypoint.rotation() @ mink.SO3.exp(lean), waypoint.translation()
            )
            for lean in around
        ]
        q = np.concatenate([ARM.inside_with_turns(ARM.branches(p, rolls)) for p in tilted])
        layers.append(q[qt.JointRanges.of(task.model).centering(q) < 0.2])
    assert plan.value <= 1.02 * least_mean_z(task, layers, math.radians(step))


# ---------------------------------------------------------------- distances


def test_a_slab_is_kept_by_an_arm_without_a_closed_form() -> None:
    """The planar arm may leave its line by 5 cm to one side, its last link has a range."""
    line = qt.load_task("planar_line")
    along = qt.TwistProjector(linear=qt.Projector.line(X), angular=qt.Projector.none())
    slab = qt.SlabBand(Y, 0.0, 0.05, frame="world")
    turn = qt.RollBand(Z, -0.2, 0.3, frame="world")
    task = every(line, 5, projector=along, bands=(slab, turn))
    plan = qt.plan(task)
    q = plan.motion()
    for share in np.linspace(0.0, 1.0, 21)[:-1]:
        R, p = poses(task, q[:-1] + share * np.diff(q, axis=0))
        height, allowed = p[:, 1] - 2.0, (1e-9, 1e-9) if share == 0.0 else (1e-4, 1e-3)
        assert height.min() >= -allowed[0] and height.max() <= 0.05 + allowed[0]
        rolls = roll_of(R, targets(task)[:-1])
        assert rolls.min() >= -0.2 - allowed[1] and rolls.max() <= 0.3 + allowed[1]
    free = qt.plan(every(line, 5, projector=along))
    assert np.isfinite(free.value) and free.value <= plan.value


# ---------------------------------------------------------------- narrow bands


@pytest.mark.parametrize("middle_deg", [0.4, 33.3])
def test_a_band_between_two_rolls_of_the_grid_is_found(middle_deg: float) -> None:
    middle, half = math.radians(middle_deg), math.radians(0.02)
    task = every(BANDS, 20, bands=(qt.RollBand(Z, middle - half, middle + half),))
    arm = closed_form_arm(task)
    assert arm is not None
    grid = RollGrid(task, arm, math.radians(4.0), np.full(6, np.inf))
    layer = grid.layer(0)
    assert grid.settled(0) and len(layer.q)
    R, _ = poses(task, layer.q)
    rolls = roll_of(R, targets(task)[:1])
    assert np.abs(rolls - middle).max() <= half + 1e-6
    assert rolls.max() - rolls.min() > half  # both of its ends


# ---------------------------------------------------------------- why there is none


def locked(task: qt.PathTask, joint: int, low: float, high: float) -> qt.PathTask:
    model = copy.copy(task.model)
    model.jnt_range[joint] = low, high
    return dataclasses.replace(task, model=model)


def narrow_wrist() -> qt.PathTask:
    """The last joint hardly turns, so that some rolls are inside the limits and others are not."""
    task = every(BANDS, 20, bands=())
    q = qt.plan(task, max_step_deg=60.0).motion()
    some = roll_of(poses(task, q)[0], targets(task))[0]
    held = locked(task, 5, q[0, 5] - 0.03, q[0, 5] + 0.03)
    held = locked(held, 3, q[0, 3] - 0.03, q[0, 3] + 0.03)
    band = qt.RollBand(Z, some + 2.0, some + 2.1)
    return dataclasses.replace(held, waypoints=held.waypoints[:1] * 2, bands=(band,))


def test_the_band_that_forbids_a_waypoint_is_named() -> None:
    task = narrow_wrist()
    plan = qt.plan(task)
    assert plan.q is None
    assert plan.certificate.kind == "band"
    assert plan.certificate.covered  # of rolls it is proved
    assert plan.certificate.waypoints[:1] == (1,)
    [name] = plan.certificate.bands
    assert name.startswith("bands[0], RollBand([0.0, 0.0, 1.0]")
    said = str(plan.certificate)
    assert "is inside both the joint limits and bands[0], RollBand" in said
    assert "no proof" not in said
    assert what_forbids(task).startswith("no configuration at waypoint 1 is inside both the joint")
    with pytest.raises(NoStart, match=r"and bands\[0\], RollBand"):
        find_starts(task)
    assert least_z_start(task) is None
    assert random_start(task, np.random.default_rng(0)) is None


def test_a_start_outside_a_band_is_refused() -> None:
    task = every(BANDS, 20)
    free = dataclasses.replace(task, bands=())
    turned = qt.plan(free, max_step_deg=60.0).motion()  # which is outside at some waypoint
    roll = roll_of(poses(task, turned)[0], targets(task))
    k = int(np.argmax(np.abs(roll)))
    assert abs(roll[k]) > math.radians(46.0)
    from_there = dataclasses.replace(task, waypoints=task.waypoints[k:] + task.waypoints[:k])
    by = f"{math.degrees(abs(roll[k])) - 45.0:.3g}°"
    with pytest.raises(qt.InvalidInput, match=rf"start .* is outside bands\[0\], .* by {by}; give"):
        qt.plan(from_there, start=turned[k])


def test_a_band_that_a_later_segment_contradicts_is_refused() -> None:
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    task = every(BANDS, 20, bands=(qt.RollBand(Z, 0.2, 0.4),),
                 segments=(qt.paths.Segment(3, whole),))  # fmt: skip
    with pytest.raises(qt.InvalidInput, match="holds the value at 0°"):
        qt.plan(task)


def test_a_soft_band_is_no_constraint_of_a_plan() -> None:
    soft = qt.RollBand(Z, -0.1, 0.1, weight=5.0)
    hard = qt.RollBand(Z, -0.5, 0.5)
    task = every(BANDS, 10)
    plans = [
        qt.plan(dataclasses.replace(task, bands=bands), max_step_deg=30.0)
        for bands in ((hard,), (soft, hard))
    ]
    # To what programs settle at: the runs that a plan begins with, too, know of the soft band.
    assert plans[0].value == pytest.approx(plans[1].value, rel=1e-6)


def test_no_configuration_has_no_rows_of_bands() -> None:
    """As where no point between waypoints strays far from the path."""
    cone = qt.ConeBand(Z, Z, math.radians(20.0))
    task = dataclasses.replace(every(BANDS, 40), projector=FREE, bands=(cone,))
    none = np.zeros(0, dtype=np.intp)
    rows, rooms, of = PathRows(task).hard.rows(np.zeros((0, 6)), none)
    assert rows.shape == (0, len(of), 6) and rooms.shape == (0, len(of))

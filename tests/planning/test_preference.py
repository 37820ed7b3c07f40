"""Lean and roll that a task prefers: their values, their cost, and plans that weigh them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.paths.preference import curve_numbers
from qp_twist.planning.preferred import PreferredPoses

LENGTHS = np.array([2.0, 1.5, 1.0])
ANGLE = st.floats(-1.2, 1.2)
WELD = """
title = "A weld"

[robot]
scene = "m16ib_deburring.xml"
frame = "tool"

[projector]
linear = "full"
angular = "none"

[[bands]]
kind = "cone"
axis = [0, 0, 1]
reference = [0, 0, 1]
upper_deg = 20

[path]
kind = "polyline"
points = [[0.15, 1.0, 0.6], [-0.15, 1.0, 0.6]]
steps_per_segment = 12
tool_axis = [0, 0, -1]

[roll]
plane_normal = [0, 1, 0]

[start]
best = true
"""


def line(preference: qt.Preference | None = None, step: int = 5) -> qt.PathTask:
    """The planar line; its tip's roll is the sum of the joint angles, from that of the start."""
    return dataclasses.replace(
        qt.load_task("planar_line").part(slice(None, None, step)), preference=preference
    )


def rolled(q: Array) -> Array:
    """The roll of configurations of the planar arm, from the waypoints', rad."""
    rest = np.radians([70.7, 69.1, 99.2])
    difference = q.sum(axis=-1) - rest.sum()
    away: Array = (difference + np.pi) % (2.0 * np.pi) - np.pi
    return away


def by_hand(q: Array, preference: qt.Preference) -> float:
    """Mean z of a planar path, and the cost of its preference, from their definitions."""
    middle, width = np.array([np.pi / 4, np.pi / 4, np.pi / 2]), np.array([0.5, 0.5, 1.0]) * np.pi
    value = 0.5 * (((q - middle) / width) ** 2).sum(axis=1).mean()
    roll = rolled(q)
    if preference.roll is not None:
        beyond = np.maximum(np.abs(roll - preference.roll) - preference.within, 0.0)
        value += 0.5 * preference.weight * (beyond**2).mean()
    changes = np.diff(q.sum(axis=1))
    smooth = (len(q) - 1) * (changes**2).sum()
    return float(value + 0.5 * preference.roll_smoothness * smooth)


def brute_force(task: qt.PathTask, preference: qt.Preference, spacing: float) -> float:
    """The best value by dynamic programming over all inverse kinematics of a fine grid of rolls."""
    turns = np.arange(-np.pi, np.pi, spacing)
    layers = []
    for x, y in task.poses[1][:, :2]:
        wrist = np.stack([x - np.cos(turns), y - np.sin(turns)], axis=1)
        cosine = ((wrist**2).sum(axis=1) - LENGTHS[0] ** 2 - LENGTHS[1] ** 2) / 6.0
        reached, both = np.abs(cosine) <= 1.0, []
        for sign in (1.0, -1.0):
            second = sign * np.arccos(np.clip(cosine, -1.0, 1.0))
            first = np.arctan2(wrist[:, 1], wrist[:, 0]) - np.arctan2(
                1.5 * np.sin(second), 2.0 + 1.5 * np.cos(second)
            )
            third = (turns - first - second + np.pi) % (2.0 * np.pi) - np.pi
            both.append(np.stack([first, second, third], axis=1)[reached])
        q = np.vstack(both)
        upper = np.array([np.pi / 2, np.pi / 2, np.pi])
        layers.append(q[((q >= -1e-9) & (q <= upper + 1e-9)).all(axis=1)])

    alone = dataclasses.replace(preference, roll=preference.roll or 0.0, roll_smoothness=0.0)
    alone = alone if preference.roll is not None else dataclasses.replace(alone, weight=0.0)

    def node(q: Array) -> Array:
        return np.array([by_hand(one[None], alone) for one in q]) / len(layers)

    best = node(layers[0])
    for before, after in itertools.pairwise(layers):
        apart = after[None] - before[:, None]
        step = 0.5 * preference.roll_smoothness * (len(layers) - 1) * apart.sum(axis=2) ** 2
        step[(np.abs(apart) > np.radians(15.0)).any(axis=2)] = np.inf
        best = (best[:, None] + step).min(axis=0) + node(after)
    return float(best.min())


@pytest.mark.parametrize(
    "preference",
    [
        qt.Preference(roll=-0.4),
        qt.Preference(roll=0.3, within=0.1, weight=5.0),
        qt.Preference(roll_smoothness=0.2),
        qt.Preference(roll=-0.2, weight=0.3, roll_smoothness=0.05),
    ],
)
def test_a_plan_is_as_good_as_a_fine_grid(preference: qt.Preference) -> None:
    task = line(preference)
    plan = qt.plan(task)
    assert plan.value == pytest.approx(by_hand(plan.motion(), preference), rel=1e-9)
    fine = brute_force(task, preference, 0.01)
    assert plan.value <= 1.001 * fine
    assert plan.value >= 0.98 * fine  # the grid is no worse than its spacing
    assert plan.bound <= plan.value
    # Few waypoints are far apart: straight joint motion between them leaves the line.
    assert all(found.passes for found in plan.examined() if "between" not in found.name)


def test_a_heavier_preference_is_followed_more_closely_and_costs_centering() -> None:
    runs = [qt.plan(line(qt.Preference(roll=-0.6, weight=w))).motion() for w in (0.0, 0.3, 30.0)]
    away = [float(np.abs(rolled(q) + 0.6).mean()) for q in runs]
    z = [by_hand(q, qt.Preference(roll_smoothness=0.0, roll=0.0, weight=0.0)) for q in runs]
    assert away[0] > away[1] > away[2]
    assert z[0] < z[1] < z[2]


@functools.cache
def leaning() -> tuple[PreferredPoses, Array]:
    """Nine waypoints on a sphere, at which a tool may lean."""
    task = qt.load_task("deburring").part(slice(0, 9))
    task = dataclasses.replace(
        task, projector=qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none()),
        preference=qt.Preference(lead=0.1, tilt=0.0, roll=0.0),
    )  # fmt: skip
    poses = PreferredPoses.of(task)
    assert poses is not None
    return poses, task.poses[1]


@settings(max_examples=30, deadline=None)
@given(lead=ANGLE, tilt=ANGLE, roll=ANGLE, seed=st.integers(0, 1000))
def test_values_are_those_of_the_rotation_that_they_describe(
    lead: float, tilt: float, roll: float, seed: int
) -> None:
    """The frame is turned by the roll about z, then leans; gradients by central differences."""
    poses, positions = leaning()
    at = np.array([seed % 9])
    target, t = poses.rotations[at[0]], poses.along[at[0]]
    z = target[:, 2]
    tangent = np.gradient(positions, axis=0)[at[0]]
    tangent -= (tangent @ z) * z
    np.testing.assert_allclose(t, tangent / np.linalg.norm(tangent), atol=1e-12)
    lean = Rotation.from_rotvec(lead * np.cross(z, t) + tilt * t)
    frame = (lean * Rotation.from_rotvec(roll * z)).as_matrix() @ target

    def values(turn: Array) -> Array:
        R = Rotation.from_rotvec(turn).as_matrix() @ frame
        return poses._values(poses._pair(R[None], positions[at], at), at)[0]

    np.testing.assert_allclose(values(np.zeros(3)), [lead, tilt, roll], atol=1e-9)
    slopes = poses._gradients(poses._pair(frame[None], positions[at], at), at)[0]
    h = 1e-6 * np.eye(3)
    differences = np.stack([(values(e) - values(-e)) / 2e-6 for e in h], axis=1)
    np.testing.assert_allclose(slopes, differences, atol=1e-6)


def test_a_weld_leans_as_preferred_and_no_more_than_is_soft(tmp_path: Path) -> None:
    """10° lead, ±5° of it without cost: the heavier, the nearer to 5° and 15°."""
    leads = []
    for weight in (1.0, 100.0):
        file = tmp_path / "weld.toml"
        file.write_text(
            WELD + f"[preference]\nlead_deg = 10\ntilt_deg = 0\nwithin_deg = 5\nweight = {weight}\n"
        )
        task = qt.load_task(file)
        q = qt.plan(task).motion()
        at = np.arange(len(q))
        poses = PreferredPoses.of(task)
        assert poses is not None
        rotations, _ = poses.chain.poses(q)
        axes = rotations[:, :, 2]
        # Along −x with the tool downwards: the lead is in the xz-plane, the tilt in the yz-plane.
        swing = np.arccos(np.clip(-axes[:, 2], -1.0, 1.0))
        sideways = axes[:, :2] / np.linalg.norm(axes[:, :2], axis=1)[:, None]
        np.testing.assert_allclose(poses.values(q, at)[:, 0], -swing * sideways[:, 0], atol=1e-9)
        leads.append(np.degrees(poses.values(q, at)[:, :2]))
    away = [np.abs(values - [10.0, 0.0]).max() for values in leads]
    assert 5.5 < away[0] < 7.0
    assert away[1] < 5.1


def test_no_plan_for_another_weight_is_better(tmp_path: Path) -> None:
    """Measured from the definition; layers alone are too coarse for a heavy preference."""
    file, found = tmp_path / "weld.toml", {}
    soft = "[preference]\nlead_deg = 10\ntilt_deg = 0\nwithin_deg = 5\nweight = {}\n"
    for weight in (1.0, 3.0, 10.0):
        file.write_text(WELD + soft.format(weight))
        task = qt.load_task(file)
        q = qt.plan(task).motion()
        poses = PreferredPoses.of(task)
        assert poses is not None
        leans = np.degrees(poses.values(q, np.arange(len(q)))[:, :2])
        beyond = np.radians(np.maximum(np.abs(leans - [10.0, 0.0]) - 5.0, 0.0))
        z = qt.JointRanges.of(task.model).centering(q).mean()
        found[weight] = float(z), 0.5 * float((beyond**2).sum(axis=1).mean())
    for weight, (z, cost) in found.items():
        assert z + weight * cost <= 1.01 * min(z + weight * cost for z, cost in found.values())


def test_angles_of_curves_go_to_their_waypoints() -> None:
    parts = ["approach", "contact", "contact", "retreat", "approach", "contact", "contact"]
    np.testing.assert_array_equal(curve_numbers(parts, [4], 7), [-1, 0, 0, -1, -1, 1, 1])
    np.testing.assert_array_equal(curve_numbers([], [2], 4), [0, 0, 1, 1])


def test_a_part_of_a_task_has_the_preference_of_its_waypoints() -> None:
    task = line(qt.Preference(roll=np.linspace(0.0, 0.5, 21)))
    part = task.part(slice(3, 7))
    assert part.preference is not None
    np.testing.assert_allclose(part.preference.at(4)[:, 2], np.linspace(0.0, 0.5, 21)[3:7])


def ranges_of(q: Array, task: qt.PathTask) -> str:
    preferred = PreferredPoses.of(task)
    assert preferred is not None
    return preferred.described(q)


def test_ranges_are_told_of_each_curve_that_prefers_something_else() -> None:
    """The planar line as curves; the roll is the sum of the joints, from that of the start."""
    turned = np.radians([10.0, 12.0, 11.0, -20.0, -21.0])  # of rolls, besides the start's
    task = line(qt.Preference(roll=0.0)).part(slice(5))
    start = task.start
    assert start is not None
    q = start + np.outer(turned, [0.0, 0.0, 1.0])
    curves, roll = np.array([0, 0, 0, 1, 1]), np.radians([10.0, 10.0, 10.0, -20.0, -20.0])
    each = qt.Preference(roll=roll, curves=curves)
    assert ranges_of(q, dataclasses.replace(task, preference=each)) == (
        "roll on curve 1 10.0° to 12.0° (preferred 10°), on curve 2 -21.0° to -20.0° "
        "(preferred -20°)"
    )
    # A path that begins within a curve counts its curves as the whole one does.
    later = dataclasses.replace(task, preference=each).part(slice(3, None))
    assert ranges_of(q[3:], later) == "roll -21.0° to -20.0° (preferred -20°)"
    same = qt.Preference(roll=np.zeros(5), curves=curves)
    assert ranges_of(q, dataclasses.replace(task, preference=same)) == (
        "roll -21.0° to 12.0° (preferred 0°)"
    )
    # Of many curves the farthest off are stated, and a bound of the others.
    many = qt.Preference(roll=np.radians([9.5, 11.0, 9.0, -20.2, -24.0]), curves=np.arange(5))
    assert ranges_of(q, dataclasses.replace(task, preference=many)) == (
        "roll on curve 1 10.0° to 10.0° (preferred 9.5°), on curve 2 12.0° to 12.0° "
        "(preferred 11°), on curve 3 11.0° to 11.0° (preferred 9°), on curve 5 -21.0° to -21.0° "
        "(preferred -24°), on 1 more within 0.2° of what is preferred there"
    )


def test_curves_are_one_for_each_waypoint() -> None:
    with pytest.raises(qt.InvalidInput, match=r"curves=….*each of the 21 waypoints, got \(2,\)"):
        line(qt.Preference(roll=0.0, curves=np.array([0, 1])))


@pytest.mark.parametrize(
    ("preference", "said"),
    [
        ("lead_deg = [1, 2]", "one for each of the path's 1 curves, got 2"),
        ('roll_deg = "a"', "valid"),
        ("weigth = 2\nroll_deg = 0", "did you mean 'weight'"),
        ("weight = -1\nroll_deg = 0", "greater than or equal to 0"),
        ("weight = 2", "nothing is preferred"),
        ("lead_deg = []", "at least 1"),
        ("roll_deg = 1e9", "within a whole turn"),
    ],
)
def test_what_cannot_be_preferred_is_refused_with_the_line(
    tmp_path: Path, preference: str, said: str
) -> None:
    file = tmp_path / "weld.toml"
    file.write_text(WELD + "[preference]\n" + preference + "\n")
    with pytest.raises(qt.TaskFileError, match=r"line \d\d: preference") as refused:
        qt.load_task(file)
    assert said in str(refused.value)


def test_what_the_task_fixes_and_the_margin_are_refused() -> None:
    task = qt.load_task("deburring").part(slice(0, 3))
    with pytest.raises(qt.InvalidInput, match="the projector holds the lead"):
        qt.plan(dataclasses.replace(task, preference=qt.Preference(lead=0.1)))
    with pytest.raises(qt.InvalidInput, match="within a whole turn"):
        qt.Preference(roll=7.0)
    with pytest.raises(qt.InvalidInput, match="margin"):
        qt.plan(line(qt.Preference(roll=0.0)), "margin")
    with pytest.raises(qt.InvalidInput, match="each of the 3 waypoints, got 2"):
        dataclasses.replace(task, preference=qt.Preference(roll=[0.1, 0.2]))

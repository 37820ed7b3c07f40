"""Waypoints along a curve: within what was allowed, and turned as little as possible."""

import dataclasses
import itertools
import math

import mink
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths import Curve, Sampling, resampled, transported
from qp_twist.paths.turning import least_turns

SEEDS = st.integers(0, 2**32 - 1)


def units(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def smooth_curve(seed: int, count: int, *, rotations: bool = False) -> Curve:
    """A random curve of a few decimetres, with directions that turn along it."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, count)
    waves = np.array([np.sin(np.outer(t, k * np.arange(1, 4))) for k in rng.uniform(1, 4, 3)])
    positions = np.einsum("cnk,kc->nc", waves, rng.normal(scale=0.1, size=(3, 3)))
    positions[:, 0] += 0.3 * t
    vectors = units(
        np.column_stack([0.6 * np.sin(3 * t), 0.5 * np.cos(rng.uniform(1, 5) * t), np.ones(count)])
    )
    matrices = None
    if rotations:
        matrices = Rotation.from_rotvec(np.outer(np.sin(2 * t), rng.normal(size=3))).as_matrix()
    return Curve("c", positions, None if rotations else vectors, matrices, np.arange(1, count + 1))


def dense(points: Array, per_segment: int = 40) -> Array:
    shares = np.arange(per_segment) / per_segment
    parts = [a + shares[:, None] * (b - a) for a, b in itertools.pairwise(points)]
    return np.vstack([*parts, points[-1:]])


def farthest(points: Array, polyline: Array) -> float:
    """Largest distance of points from a polyline, segment by segment."""
    a, b = polyline[:-1], polyline[1:]
    chord = b - a
    offsets = points[:, None] - a
    along = (offsets * chord).sum(-1) / np.maximum((chord**2).sum(-1), 1e-300)
    feet = np.clip(along, 0.0, 1.0)[..., None] * chord
    return float(np.linalg.norm(offsets - feet, axis=-1).min(axis=1).max())


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.floats(-5.5, -2.5), st.booleans())
def test_the_new_path_is_as_near_as_allowed_both_ways_round(
    seed: int, exponent: float, rotations: bool
) -> None:
    curve = smooth_curve(seed, 80, rotations=rotations)
    error = 10.0**exponent
    sampling = Sampling(error, axis_error=math.radians(2), max_turn=0.3, max_spacing=0.05)
    found = resampled(curve, sampling)
    assert farthest(dense(curve.positions, 4), found.positions) <= error * (1 + 1e-9)
    assert farthest(dense(found.positions, 4), curve.positions) <= error * (1 + 1e-9)
    steps = np.linalg.norm(np.diff(found.positions, axis=0), axis=1)
    assert steps.max() <= 0.05 * (1 + 1e-6)
    assert steps.min() > 0.0
    assert found.positions[[0, -1]] == pytest.approx(curve.positions[[0, -1]], abs=0)


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.booleans())
def test_directions_left_out_are_interpolated_as_well_as_allowed(
    seed: int, rotations: bool
) -> None:
    """Against scipy's interpolation of rotations, or that of arcs, at the points left out."""
    curve = smooth_curve(seed, 100, rotations=rotations)
    allowed = math.radians(0.5)
    found = resampled(curve, Sampling(1.0, allowed, math.radians(90), max_spacing=10.0))
    assert len(found) < 100
    kept = [int(line) - 1 for line in found.lines]
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve.positions, axis=0), axis=1))])
    for a, b in itertools.pairwise(kept):
        for i in range(a + 1, b):
            share = (arc[i] - arc[a]) / (arc[b] - arc[a])
            if rotations:
                assert curve.rotations is not None
                first, last = (Rotation.from_matrix(curve.rotations[k]) for k in (a, b))
                between = Rotation.from_rotvec(share * (last * first.inv()).as_rotvec()) * first
                off = (between * Rotation.from_matrix(curve.rotations[i]).inv()).magnitude()
            else:
                assert curve.vectors is not None
                u, v, w = curve.vectors[[a, b, i]]
                axis = np.cross(u, v)
                angle = math.atan2(np.linalg.norm(axis), u @ v)
                turn = share * angle * axis / max(np.linalg.norm(axis), 1e-300)
                off = math.acos(min(1.0, float(mink.SO3.exp(turn).apply(u) @ w)))
            assert off <= allowed * (1 + 1e-6) + 1e-7


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.floats(0.5, 30.0), st.booleans())
def test_the_tool_turns_no_more_than_allowed_from_a_waypoint_to_the_next(
    seed: int, degrees: float, rotations: bool
) -> None:
    curve = smooth_curve(seed, 12, rotations=rotations)
    found = resampled(curve, Sampling(None, 1.0, math.radians(degrees), 1.0))
    if rotations:
        assert found.rotations is not None
        assert np.linalg.det(found.rotations) == pytest.approx(1.0)
        pairs = zip(found.rotations[:-1], found.rotations[1:], strict=True)
        turns = np.array([Rotation.from_matrix(a.T @ b).magnitude() for a, b in pairs])
    else:
        assert found.vectors is not None
        assert np.linalg.norm(found.vectors, axis=1) == pytest.approx(1.0, abs=1e-12)
        cross = np.linalg.norm(np.cross(found.vectors[:-1], found.vectors[1:]), axis=1)
        turns = np.arctan2(cross, (found.vectors[:-1] * found.vectors[1:]).sum(axis=1))
    assert turns.max() <= math.radians(degrees) * (1 + 1e-6)
    # Without chord_error every given point is there, as it was given.
    at = [int(np.argmin(np.linalg.norm(found.positions - p, axis=1))) for p in curve.positions]
    assert found.positions[at] == pytest.approx(curve.positions, abs=0)
    assert at == sorted(at)


def test_a_straight_line_is_thinned_to_its_ends_and_a_corner_stays() -> None:
    x = np.linspace(0, 0.1, 50)
    points = np.vstack(
        [np.column_stack([x, 0 * x, 0 * x]), np.column_stack([0 * x[1:] + 0.1, x[1:], 0 * x[1:]])]
    )
    curve = Curve("c", points, None, None, np.arange(len(points)))
    found = resampled(curve, Sampling(0.02, max_spacing=1.0))
    # 20 mm would allow to cut the corner of 70 mm; it stays all the same.
    assert found.positions == pytest.approx(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]]))
    assert found.lines.tolist() == [0, 49, 98]


def test_a_circle_gets_as_many_chords_as_its_sagitta_asks_for() -> None:
    """Of a fine circle of radius r about π/acos(1 − e/r) chords stay within e."""
    angle = np.linspace(0, 2 * np.pi, 4001)
    curve = Curve(
        "c", 0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]), None, None,
        np.arange(4001),
    )  # fmt: skip
    found = resampled(curve, Sampling(1e-5, max_spacing=1.0))
    fewest = math.pi / math.acos(1 - 1e-5 / 0.1)
    assert fewest <= len(found) - 1 <= 2 * fewest
    radii = np.linalg.norm(dense(found.positions)[:, :2], axis=1)
    assert 0.1 - radii.min() <= 1e-5 * 1.01


def test_a_turn_in_place_stays_and_is_divided() -> None:
    points = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0, 0], [0.02, 0, 0]], dtype=float)
    vectors = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]], dtype=float)
    curve = Curve("c", points, vectors, None, np.arange(4))
    found = resampled(curve, Sampling(0.001, max_turn=math.radians(10), max_spacing=1.0))
    assert len(found) == 12
    assert found.vectors is not None
    angles = np.degrees(np.arctan2(found.vectors[1:11, 0], found.vectors[1:11, 2]))
    assert angles == pytest.approx(np.arange(0, 91, 10), abs=1e-9)


def test_opposite_neighbours_and_too_many_waypoints_are_refused() -> None:
    points = np.array([[0, 0, 0], [0.01, 0, 0]])
    flipped = Curve("c", points, np.array([[0, 0, 1.0], [0, 0, -1.0]]), None, np.array([7, 9]))
    with pytest.raises(InvalidInput, match="turned round from line 7 to line 9"):
        resampled(flipped, Sampling())
    plain = dataclasses.replace(flipped, vectors=None)
    with pytest.raises(InvalidInput, match=r"max_spacing = 1e-09 m .* 1e\+07 waypoints"):
        resampled(plain, Sampling(max_spacing=1e-9))


# ---------------------------------------------------------------- the roll with least turning


@settings(max_examples=10, deadline=None)
@given(SEEDS)
def test_from_a_waypoint_to_the_next_there_is_no_roll(seed: int) -> None:
    """The rotation vector between neighbours is perpendicular to both axes: that is no twist."""
    rng = np.random.default_rng(seed)
    axes = units(np.cumsum(rng.normal(scale=0.3, size=(60, 3)), axis=0) + np.array([0, 0, 1.0]))
    first = Rotation.random(random_state=seed % 1000).as_matrix()
    found = transported(first, axes)
    assert found[:, :, 2] == pytest.approx(axes, abs=1e-12)
    assert found @ found.transpose(0, 2, 1) == pytest.approx(
        np.broadcast_to(np.eye(3), found.shape), abs=1e-12
    )
    for a, b in itertools.pairwise(found):
        turn = Rotation.from_matrix(b @ a.T).as_rotvec()
        assert abs(turn @ a[:, 2]) < 1e-9
        assert abs(turn @ b[:, 2]) < 1e-9


def test_around_a_closed_cone_the_roll_is_the_area_on_the_sphere() -> None:
    """Parallel transport around the circle of latitude of a cone turns by its solid angle."""
    half = math.radians(20)
    t = np.linspace(0, 2 * np.pi, 801)
    axes = np.column_stack(
        [math.sin(half) * np.cos(t), math.sin(half) * np.sin(t), 0 * t + math.cos(half)]
    )
    found = transported(np.eye(3), axes)
    turn = Rotation.from_matrix(found[-1] @ found[0].T).as_rotvec() @ axes[0]
    assert turn == pytest.approx(2 * np.pi * (1 - math.cos(half)), abs=1e-4)


def test_the_least_turn_of_opposite_vectors_turns_by_half_a_turn() -> None:
    a = units(np.array([1.0, -2.0, 0.5]))
    [turn] = least_turns(a[None], -a[None])
    assert turn @ a == pytest.approx(-a)
    assert Rotation.from_matrix(turn).magnitude() == pytest.approx(np.pi)

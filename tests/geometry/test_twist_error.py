"""The task error against scipy's rotations, brute force, and the step that it promises."""

import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from oracles.arms import random_direction, random_rotation
from oracles.twists import FRAMES, KINDS, Z, close, turn, twists
from scipy.spatial.transform import Rotation

from qp_twist.geometry import (
    Projector,
    ProjectorKind,
    TwistProjector,
    angular_error,
    clamp_twist,
    geodesic,
    resolved_twist_error,
    rotation_matrix,
    rotation_vector,
    twist_angle,
    twist_error,
)

Array = npt.NDArray[np.float64]

ORIGIN = np.zeros(3)
# Misalignments short of (or beyond) a half turn, where naive formulas divide by nothing.
NEARLY = [0.0, *(10.0**power for power in range(-16, -1))]


def across(e: Array, hint: Array) -> Array:
    """Return a unit vector perpendicular to e; ``hint`` chooses which."""
    if abs(hint @ e) > 0.99:
        hint = np.roll(e, 1) + np.array([0.0, 0.0, 0.1])
    u = np.cross(e, hint)
    return u / np.linalg.norm(u)


def angular_task(kind: str, frame: str, e: Array, R: Array, R_d: Array) -> TwistProjector:
    """Return an angular projector whose axis is now ``e`` in the world, fixed to ``frame``."""
    own = {"world": e, "body": R.T @ e, "target": R_d.T @ e}[frame]
    return twists("none", kind, frame, (Z, own))


class Case(NamedTuple):
    """A frame, its target, and a projector of any kind in any frame."""

    R: Array
    p: Array
    R_d: Array
    p_d: Array
    linear: str
    angular: str
    frame: str
    linear_axis: Array
    angular_axis: Array

    @property
    def T(self) -> TwistProjector:
        axes = self.linear_axis, self.angular_axis
        return twists(self.linear, self.angular, self.frame, axes)

    @property
    def frame_rotation(self) -> Array:
        return {"world": np.eye(3), "body": self.R, "target": self.R_d}[self.frame]

    def error(self) -> Array:
        return twist_error(self.R, self.p, self.R_d, self.p_d, self.T)


def angle_between(a: Array, b: Array) -> float:
    """Return the angle of two unit vectors by Kahan's formula, sharp at 0 and at π."""
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def trace_along(R: Array, e: Array) -> tuple[float, float]:
    """Return the φ that maximises tr(R Rot(e, −φ)), leaving the least rotation, and how sharply.

    The trace is a + b cos φ + c sin φ: three samples give its maximum, without quaternions.
    """
    at_0, at_90, at_180 = (np.trace(R @ turn(-phi * e)) for phi in (0.0, np.pi / 2, np.pi))
    b, c = (at_0 - at_180) / 2, at_90 - (at_0 + at_180) / 2
    return math.atan2(c, b), math.hypot(b, c)


def wrapped(angle: float) -> float:
    """Return an angle modulo a full turn, by its distance from 0."""
    return abs(math.remainder(angle, 2.0 * math.pi))


# A vector from one drawn seed, not from three drawn floats, makes hypothesis many times faster.
# The directions where a formula might choose a branch are named.
seeds = st.integers(0, 2**32 - 1)
BRANCHING = [
    *np.eye(3), *-np.eye(3), np.ones(3) / math.sqrt(3.0), np.array([0.6, -0.8, 0.0]),
    np.array([1.0, 1e-9, 0.0]), np.array([0.0, 1e-200, -1.0]),
]  # fmt: skip
directions = st.one_of(
    st.sampled_from(BRANCHING),
    seeds.map(lambda seed: random_direction(np.random.default_rng(seed))),
)
points = seeds.map(lambda seed: np.random.default_rng(seed).uniform(-10.0, 10.0, size=3))
angles = st.one_of(
    st.floats(-math.pi, math.pi),
    st.sampled_from([0.0, 1e-9, 1e-4, math.pi / 2, math.pi - 1e-4, math.pi - 1e-9, math.pi]),
)
rotations = st.builds(lambda axis, angle: turn(angle * axis), directions, angles)
kinds = st.sampled_from(KINDS)
frames = st.sampled_from(FRAMES)
cases = st.builds(
    Case, R=rotations, p=points, R_d=rotations, p_d=points,
    linear=kinds, angular=kinds, frame=frames, linear_axis=directions, angular_axis=directions,
)  # fmt: skip


# -------------------------------------------------------------------------------- against oracles


@given(rotations, rotations, frames)
def test_the_full_error_is_scipys_rotation_vector(R: Array, R_d: Array, frame: str) -> None:
    T = TwistProjector(linear=Projector.none(), angular=Projector.full(), frame=frame)
    error = twist_error(R, ORIGIN, R_d, ORIGIN, T)[3:]
    expected = Rotation.from_matrix(R_d @ R.T).as_rotvec()
    if np.linalg.norm(expected) > math.pi - 1e-6:  # both signs are the same rotation
        expected = math.copysign(1.0, error @ expected) * expected
    close(error, expected, atol=1e-9)


@given(directions, directions, st.floats(-math.pi, math.pi), st.floats(0.0, math.pi - 1e-3))
def test_the_line_error_is_the_twist_that_a_swing_and_twist_were_made_of(
    e: Array, hint: Array, twist: float, swing: float
) -> None:
    R_e = turn(swing * across(e, hint)) @ turn(twist * e)
    assert wrapped(twist_angle(R_e, e) - twist) < 1e-9
    R_e = turn(twist * e) @ turn(swing * across(e, hint))  # the other order has the same twist
    assert wrapped(twist_angle(R_e, e) - twist) < 1e-9


@given(rotations, directions, frames, seeds)
def test_the_plane_error_is_the_shortest_rotation_that_aligns_the_axis(
    R_e: Array, e: Array, frame: str, seed: int
) -> None:
    # Fixed to the body, e itself is to reach R_e e. Fixed in space, what is to reach e is the
    # direction of the body that lies along e once the body is at its target: now R_eᵀ e.
    start, end = (e, R_e @ e) if frame == "body" else (R_e.T @ e, e)
    assume(angle_between(start, end) < math.pi - 1e-3)  # opposite: no shortest one
    R = random_rotation(np.random.default_rng(seed))
    R_d = R_e @ R
    error = twist_error(R, ORIGIN, R_d, ORIGIN, angular_task("plane", frame, e, R, R_d))[3:]
    expected = Rotation.align_vectors(end, start)[0].as_rotvec()
    close(error, expected, atol=1e-9)
    assert np.linalg.norm(error) == pytest.approx(angle_between(e, R_e @ e), abs=1e-11)


@given(st.lists(cases, min_size=1, max_size=5), st.booleans(), st.sampled_from([1.0, -1.0]))
def test_errors_of_many_poses_are_those_of_each(
    found: list[Case], one_target: bool, side: float
) -> None:
    T, (R_d, p_d) = found[0].T, (found[0].R_d, found[0].p_d)
    # Among them one that is at the target, or turned by an exact half turn from it.
    half = 2.0 * np.outer(Z, Z) - np.eye(3) if side < 0.0 else np.eye(3)
    R = np.array([R_d @ half, *(case.R for case in found)])
    p = np.array([p_d, *(case.p for case in found)])
    if one_target:
        assert resolved_twist_error(R[:0], p[:0], R_d, p_d, T)[1].shape == (0, 6)
    else:
        R_d = np.array([R_d, *(case.R_d for case in found)])
        p_d = np.array([p_d, *(case.p_d for case in found)])
    world, errors = resolved_twist_error(R, p, R_d, p_d, T)
    U = np.broadcast_to(world.basis, (len(R), 6, T.rank))
    targets = list(zip(np.broadcast_to(R_d, R.shape), np.broadcast_to(p_d, p.shape), strict=True))
    for k, target in enumerate(targets):
        expected = twist_error(R[k], p[k], *target, T)
        if T.angular.kind is ProjectorKind.FULL and np.linalg.norm(expected[3:]) > math.pi - 1e-6:
            expected[3:] *= math.copysign(1.0, expected[3:] @ errors[k, 3:])  # the same rotation
        close(errors[k], expected, atol=1e-11)
        close(U[k] @ U[k].T, T.resolved(body=R[k], target=target[0]).matrix)


# ------------------------------------------------------------------------ what a full step does


@given(rotations, directions, kinds, frames, seeds)
def test_one_full_step_annihilates_the_angular_error_at_any_misalignment(
    R_e: Array, e: Array, kind: str, frame: str, seed: int
) -> None:
    if kind == "line":
        assume(trace_along(R_e, e)[1] > 1e-3)  # at a swing by π there is no twist to remove
    R = random_rotation(np.random.default_rng(seed))
    R_d = R_e @ R
    T = angular_task(kind, frame, e, R, R_d)
    step = twist_error(R, ORIGIN, R_d, ORIGIN, T)[3:]
    moved = Rotation.from_rotvec(step).as_matrix() @ R
    close(twist_error(moved, ORIGIN, R_d, ORIGIN, T), np.zeros(6), atol=1e-10)


@given(cases, points)
def test_the_error_lies_in_the_range_of_the_projector_and_is_zero_at_the_target(
    case: Case, shift: Array
) -> None:
    """And does not change when the world moves its origin."""
    error = case.error()
    close(case.T.resolved(body=case.R, target=case.R_d).matrix @ error, error)
    close(case._replace(p=case.p + shift, p_d=case.p_d + shift).error(), error)
    close(case._replace(R=case.R_d.copy(), p=case.p_d.copy()).error(), np.zeros(6))


@given(cases, rotations)
def test_the_error_turns_with_the_world(case: Case, Q: Array) -> None:
    before = case.error()
    # At a half turn the sign, and for a plane the axis, is a convention of the world's axes.
    assume(np.linalg.norm(before[3:]) < math.pi - 1e-6)
    if case.angular == "line":
        assume(trace_along(case.R_d @ case.R.T, case.frame_rotation @ case.angular_axis)[1] > 1e-3)
    turned = case._replace(R=Q @ case.R, p=Q @ case.p, R_d=Q @ case.R_d, p_d=Q @ case.p_d)
    if case.frame == "world":
        turned = turned._replace(
            linear_axis=Q @ case.linear_axis, angular_axis=Q @ case.angular_axis
        )
    close(turned.error(), np.concatenate([Q @ before[:3], Q @ before[3:]]), atol=1e-8)


# ------------------------------------------------------------------------- half turns and nearly


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("short", NEARLY[::3])
def test_nearly_opposite_axes_still_give_an_exact_step_inside_the_range(
    frame: str, short: float
) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        e, R = random_direction(rng), random_rotation(rng)
        roll = turn(rng.uniform(-np.pi, np.pi) * e)
        R_d = turn((np.pi - short) * across(e, random_direction(rng))) @ roll @ R
        T = angular_task("plane", frame, e, R, R_d)
        error = twist_error(R, ORIGIN, R_d, ORIGIN, T)[3:]
        assert np.isfinite(error).all()
        # An error of 1e-12 about nearly opposite axes must not tilt the axis of the half turn.
        assert abs(error @ e) < 1e-11
        assert np.linalg.norm(error) == pytest.approx(np.pi - short, abs=1e-11)
        moved = turn(error) @ R
        close(twist_error(moved, ORIGIN, R_d, ORIGIN, T), np.zeros(6), atol=1e-11)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", KINDS)
def test_nearly_half_turns_about_any_axis_are_never_nan(kind: str, frame: str) -> None:
    rng = np.random.default_rng(2)
    for e, short in itertools.product([Z, -Z, random_direction(rng)], NEARLY[::3]):
        for about in [*np.eye(3), e, across(e, random_direction(rng)), random_direction(rng)]:
            for R in (np.eye(3), random_rotation(rng)):
                R_d = turn((np.pi - short) * about) @ R
                T = angular_task(kind, frame, e, R, R_d)
                error = twist_error(R, ORIGIN, R_d, ORIGIN, T)[3:]
                assert np.isfinite(error).all()
                assert np.linalg.norm(error) <= np.pi + 1e-12


@pytest.mark.parametrize("axis", [*np.eye(3), np.ones(3) / np.sqrt(3), np.array([0.6, -0.8, 0])])
def test_exact_half_turns_have_an_error_of_pi(axis: Array) -> None:
    half = 2.0 * np.outer(axis, axis) - np.eye(3)  # no sine of π, which floats do not have
    full = rotation_vector(half)
    assert np.linalg.norm(full) == pytest.approx(np.pi, abs=1e-12)
    close(np.cross(full, axis), ORIGIN)

    assert twist_angle(half, axis) == pytest.approx(np.pi, abs=1e-12)
    e = across(axis, np.array([0.3, 0.1, 0.9]))
    for body in (True, False):
        swing = angular_error(np.eye(3), half, Projector.plane(e), moves_with_body=body)
        assert np.linalg.norm(swing) == pytest.approx(np.pi, abs=1e-12)
        assert abs(swing @ e) < 1e-12
    # A swing by π leaves nothing to measure the twist about e against.
    assert twist_angle(half, e) == 0.0


@given(directions, directions)
def test_the_geodesic_takes_one_direction_to_the_other_by_the_angle_between(
    start: Array, end: Array
) -> None:
    vector = geodesic(start, end)
    close(Rotation.from_rotvec(vector).apply(start), end)
    assert np.linalg.norm(vector) == pytest.approx(angle_between(start, end), abs=1e-12)


@given(directions, st.floats(-math.pi, math.pi))
@example(np.array([0.0, 0.0, 1.0]), 1e-13)
@example(np.array([0.0, 0.0, 1.0]), 1e-200)
@example(np.array([0.0, 0.0, 1.0]), -math.pi)
def test_the_rotation_vector_inverts_scipys_exponential(axis: Array, angle: float) -> None:
    R = turn(angle * axis)
    vector = rotation_vector(R)
    assert np.linalg.norm(vector) <= np.pi + 1e-12
    close(Rotation.from_rotvec(vector).as_matrix(), R)
    if abs(angle) < 3.1:
        close(vector, angle * axis)
    close(rotation_matrix(angle * axis), R)
    many = np.array([R, np.eye(3), np.diag([1.0, -1.0, -1.0])])  # the last is a half turn
    close(rotation_matrix(rotation_vector(many)), many)


def test_the_rotation_vector_of_a_small_rotation_is_not_rounded_to_nothing() -> None:
    R = np.array([[1.0, -3e-14, 2e-14], [3e-14, 1.0, -1e-14], [-2e-14, 1e-14, 1.0]])
    np.testing.assert_allclose(rotation_vector(R), [1e-14, 2e-14, 3e-14], rtol=1e-9)


# ------------------------------------------------------------------------------------ line angle


@given(directions, directions, st.floats(0.0, 3.0))
def test_the_line_angle_follows_a_turning_frame_through_every_half_turn(
    e: Array, hint: Array, swing: float
) -> None:
    fixed = turn(swing * across(e, hint))
    for angle in np.linspace(-4 * np.pi, 4 * np.pi, 25):
        found = twist_angle(turn(angle * e) @ fixed, e)
        assert -np.pi < found <= np.pi
        assert wrapped(found - angle) < 1e-9


def test_the_line_angle_ends_at_plus_pi_and_not_at_minus_pi() -> None:
    half = np.diag([-1.0, -1.0, 1.0])
    assert twist_angle(half, Z) == np.pi
    assert twist_angle(half, -Z) == np.pi
    assert twist_angle(turn((np.pi - 1e-6) * Z), Z) == pytest.approx(np.pi - 1e-6, abs=1e-12)
    assert twist_angle(turn((1e-6 - np.pi) * Z), Z) == pytest.approx(1e-6 - np.pi, abs=1e-12)


# ----------------------------------------------------------------------------------------- clamp


six_numbers = st.lists(
    st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-9), min_size=6, max_size=6
).map(np.array)
limits = st.floats(1e-3, 1e3)


@given(six_numbers, limits, limits)
def test_a_clamped_twist_keeps_directions_and_is_no_longer_than_allowed(
    twist: Array, longest: float, widest: float
) -> None:
    before = twist.copy()
    clamped = clamp_twist(twist, longest, widest)
    np.testing.assert_array_equal(twist, before)
    for part, limit in ((slice(3), longest), (slice(3, 6), widest)):
        length = np.linalg.norm(twist[part])
        if length <= limit:
            np.testing.assert_array_equal(clamped[part], twist[part])
        else:
            assert np.linalg.norm(clamped[part]) == pytest.approx(limit, rel=1e-12)
            np.testing.assert_allclose(clamped[part] / limit, twist[part] / length, atol=1e-12)

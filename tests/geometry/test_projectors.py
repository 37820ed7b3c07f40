"""Projectors and twist projectors: their axioms, their frames, and the redundancy they leave."""

import itertools

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.arms import planar_arm, random_configuration, random_direction, random_rotation
from oracles.twists import FRAMES, PLANE, ROLL_FREE, SPATIAL, Z, close, twists
from scipy.linalg import block_diag

from qp_twist.errors import InvalidInput, QpTwistError
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, task_redundancy
from qp_twist.kinematics import frame_jacobian

Array = npt.NDArray[np.float64]

PLANAR = twists("plane", "line")
"""The operational space of a planar arm."""


# A direction from one drawn seed, not from three drawn floats, makes hypothesis many times faster.
# The directions where a formula might choose a branch are named.
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
BRANCHING = [
    *np.eye(3), *-np.eye(3), np.ones(3) / np.sqrt(3.0), np.array([0.6, -0.8, 0.0]),
    np.array([1.0, 1e-9, 0.0]), np.array([0.0, 1e-200, -1.0]),
]  # fmt: skip
directions = st.one_of(st.sampled_from(BRANCHING), seeds.map(random_direction))
lengths = st.one_of(st.just(1.0), st.integers(-11, 307).map(lambda power: 10.0**power))
rotations = seeds.map(random_rotation)


@st.composite
def projectors_with_matrices(draw: st.DrawFn) -> tuple[Projector, Array]:
    """Draw a projector from an axis of any length, and its matrix written out from the paper."""
    kind = draw(st.sampled_from(("full", "plane", "line", "none")))
    if kind == "full":
        return Projector.full(), np.eye(3)
    if kind == "none":
        return Projector.none(), np.zeros((3, 3))
    e, length = draw(directions), draw(lengths)
    if kind == "plane":
        return Projector.plane(length * e), np.eye(3) - np.outer(e, e)
    return Projector.line(length * e), np.outer(e, e)


projectors = projectors_with_matrices().map(lambda drawn: drawn[0])
twist_projectors = st.builds(
    TwistProjector, linear=projectors, angular=projectors, frame=st.sampled_from(FRAMES)
)


# ----------------------------------------------------------------------------------- projectors


@given(projectors_with_matrices())
def test_a_projector_is_the_papers_matrix_and_satisfies_the_axioms(
    drawn: tuple[Projector, Array],
) -> None:
    """Of an axis of any length: idempotent, symmetric, and split by its complement."""
    projector, expected = drawn
    M, other, U = projector.matrix, projector.complement, projector.basis
    close(M, expected)
    close(M @ M, M)
    close(M.T, M)
    close(M + other.matrix, np.eye(3))
    close(M @ other.matrix, np.zeros((3, 3)))
    close(other.complement.matrix, M)
    assert other.complement.kind is projector.kind
    assert projector.rank == np.linalg.matrix_rank(M, tol=1e-9) == 3 - other.rank
    assert U.shape == (3, projector.rank)
    close(U.T @ U, np.eye(projector.rank))
    close(U @ U.T, M)


@given(projectors, rotations)
def test_a_rotated_projector_is_the_similar_matrix(projector: Projector, R: Array) -> None:
    rotated = projector.rotated(R)
    assert rotated.kind is projector.kind
    close(rotated.matrix, R @ projector.matrix @ R.T)
    close(rotated.complement.matrix, R @ projector.complement.matrix @ R.T)


@given(st.sampled_from((Projector.plane, Projector.line)), directions, rotations)
def test_the_basis_turns_with_the_axis_so_that_task_rows_stay_continuous(
    build: type[Projector], e: Array, R: Array
) -> None:
    projector = build(e)
    close(projector.rotated(R).basis, R @ projector.basis)
    close(projector.rotated(R).axis, R @ e)


@given(projectors)
def test_the_text_of_a_projector_builds_it_again(projector: Projector) -> None:
    again = eval(repr(projector), {"Projector": Projector})
    close(again.matrix, projector.matrix, atol=1e-5)  # the text rounds the axis


@pytest.mark.parametrize("build", [Projector.plane, Projector.line])
@pytest.mark.parametrize(
    ("axis", "sentence"),
    [
        ([0.0, 0.0, 0.0], "has no direction"),
        ([1e-13, 0.0, -1e-13], "has no direction"),
        ([0.0, np.nan, 1.0], "entry 1 is nan"),
        ([np.inf, 0.0, 1.0], "entry 0 is inf"),
        ([0.0, 1.0], r"shape \(3\), got \(2,\)"),
        (np.eye(3), r"shape \(3\), got \(3, 3\)"),
        (1.0, r"shape \(3\), got \(\)"),
        ("up", "expected numbers, got 'up'"),
        ([[1.0], [2.0, 3.0]], "expected numbers"),
        (None, "normal|direction"),
    ],
)
def test_an_axis_without_a_direction_is_refused(
    build: type[Projector], axis: object, sentence: str
) -> None:
    with pytest.raises(InvalidInput, match=sentence) as refusal:
        build(axis)
    name = "normal" if build == Projector.plane else "direction"
    assert str(refusal.value).startswith(f"{name}: ")


def test_a_refusal_is_a_value_error_and_a_mink_error() -> None:
    with pytest.raises(ValueError, match="no direction"):
        Projector.plane([0, 0, 0])
    with pytest.raises(mink.MinkError, match="no direction"):
        Projector.plane([0, 0, 0])
    assert issubclass(InvalidInput, QpTwistError)


# ----------------------------------------------------------------------------- twist projectors


@given(projectors_with_matrices(), projectors_with_matrices(), st.sampled_from(FRAMES))
def test_a_twist_projector_is_block_diagonal_and_satisfies_the_axioms(
    linear: tuple[Projector, Array], angular: tuple[Projector, Array], frame: str
) -> None:
    """The linear block first; a minimal orthonormal basis of its range."""
    projector = TwistProjector(linear=linear[0], angular=angular[0], frame=frame)
    T, other, U = projector.matrix, projector.complement, projector.basis
    close(T, block_diag(linear[1], angular[1]))
    close(T + other.matrix, np.eye(6))
    close(T @ other.matrix, np.zeros((6, 6)))
    close(other.complement.matrix, T)
    assert U.shape == (6, projector.rank) and projector.rank == np.linalg.matrix_rank(T, tol=1e-9)
    close(U.T @ U, np.eye(projector.rank))
    close(U @ U.T, T)


@given(twist_projectors, rotations, rotations)
def test_a_twist_projector_is_resolved_with_the_rotation_of_its_own_frame(
    projector: TwistProjector, body: Array, target: Array
) -> None:
    R = {"world": np.eye(3), "body": body, "target": target}[projector.frame]
    turn = np.kron(np.eye(2), R)
    world = projector.resolved(body=body, target=target)
    assert world.frame == "world"
    close(world.matrix, turn @ projector.matrix @ turn.T)
    # Its complement lives in the same frame, else 1 − T would not complete T in the world.
    close(world.matrix + projector.complement.resolved(body=body, target=target).matrix, np.eye(6))


@pytest.mark.parametrize(("frame", "other"), [("body", "target"), ("target", "body")])
def test_a_missing_rotation_is_refused_in_a_sentence_that_says_what_to_pass(
    frame: str, other: str
) -> None:
    projector = TwistProjector(linear=Projector.full(), angular=Projector.plane(Z), frame=frame)
    for given_rotations in ({}, {other: np.eye(3)}):
        with pytest.raises(InvalidInput, match=f"fixed to the {frame} frame; pass {frame}=R"):
            projector.resolved(**given_rotations)


@pytest.mark.parametrize("frame", ["body", "target"])
@pytest.mark.parametrize(
    ("rotation", "sentence"),
    [(np.eye(4), r"shape \(3, 3\), got \(4, 4\)"), (np.full((3, 3), np.nan), "entry .* is nan")],
)
def test_a_broken_rotation_is_refused(frame: str, rotation: Array, sentence: str) -> None:
    projector = TwistProjector(linear=Projector.full(), angular=Projector.plane(Z), frame=frame)
    with pytest.raises(InvalidInput, match=f"^{frame}: .*{sentence}"):
        projector.resolved(**{frame: rotation})


@pytest.mark.parametrize("block", ["linear", "angular"])
@pytest.mark.parametrize("wrong", [np.eye(3), "full", None, Projector.full, ProjectorKind.FULL])
def test_a_block_that_is_no_projector_is_refused(block: str, wrong: object) -> None:
    blocks = {"linear": Projector.full(), "angular": Projector.full(), block: wrong}
    with pytest.raises(InvalidInput, match=rf"TwistProjector\({block}=…\): expected a Projector"):
        TwistProjector(**blocks)


@pytest.mark.parametrize("frame", ["tool", "World", "", None])
def test_an_unknown_frame_is_refused_with_the_known_ones(frame: object) -> None:
    with pytest.raises(InvalidInput, match="expected one of world, body, target; got"):
        TwistProjector(linear=Projector.full(), angular=Projector.full(), frame=frame)


def test_the_blocks_must_be_named() -> None:
    with pytest.raises(TypeError):
        TwistProjector(Projector.full(), Projector.full())


# ------------------------------------------------------------------------ redundancy of the task


def test_both_examples_of_the_paper_have_one_redundant_direction() -> None:
    positioning = PLANE
    assert task_redundancy(operational=PLANAR, task=positioning) == 1

    spatial = SPATIAL
    deburring = ROLL_FREE
    assert task_redundancy(operational=spatial, task=deburring) == 1


@given(twist_projectors)
def test_a_spatial_arm_has_what_the_task_does_not_need(task: TwistProjector) -> None:
    spatial = SPATIAL
    expected = 6 - np.linalg.matrix_rank(task.matrix, tol=1e-9)
    assert task_redundancy(operational=spatial, task=task) == expected


@given(directions)
def test_a_task_of_the_whole_operational_space_has_no_redundancy(e: Array) -> None:
    planar = TwistProjector(linear=Projector.plane(e), angular=Projector.line(e))
    assert task_redundancy(operational=planar, task=planar) == 0


def test_a_task_outside_the_operational_space_is_refused() -> None:
    for linear, angular in itertools.product(
        (Projector.plane(Z), Projector.line([1, 0, 0])),
        (Projector.plane(Z), Projector.line([0, 1, 0])),
    ):
        tilting = TwistProjector(linear=linear, angular=angular)
        with pytest.raises(InvalidInput, match="direction outside the operational space"):
            task_redundancy(operational=PLANAR, task=tilting)


# ----------------------------------------------------------------- the paper's planar examples


def planar_rows(model: mujoco.MjModel, q: Array, projector: TwistProjector) -> Array:
    """Return UᵀJ of the tip."""
    return projector.basis.T @ frame_jacobian(mink.Configuration(model, q), "tip", "site")


def textbook_jacobian(links: list[float], q: Array) -> Array:
    """Return the planar Jacobian, rows (v_x, v_y, ω_z), from the formula."""
    angles = np.cumsum(q)
    joints = np.concatenate([[0.0], np.cumsum(links * np.exp(1j * angles))])
    arms = 1j * (joints[-1] - joints[:-1])  # ω_z × (tip − joint)
    return np.vstack([arms.real, arms.imag, np.ones(len(links))])


@pytest.mark.parametrize("links", [[2.0, 1.5], [2.0, 1.5, 1.0], [1.0, 0.8, 0.6, 0.4]])
def test_the_planar_arms_move_by_the_textbook_jacobian(links: list[float]) -> None:
    model = planar_arm(links)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = random_configuration(model, rng)
        J = frame_jacobian(mink.Configuration(model, q), "tip", "site")
        close(J[[0, 1, 5]], textbook_jacobian(links, q), atol=1e-12)
        close(J[[2, 3, 4]], np.zeros((3, len(links))), atol=1e-12)


def test_example_2_1_the_planar_2r_is_overconstrained() -> None:
    model = planar_arm([2.0, 1.5])
    rng = np.random.default_rng(1)
    for _ in range(20):
        rows = planar_rows(model, random_configuration(model, rng), PLANAR)
        assert rows.shape == (3, 2)  # n_o = 3 > n = 2
        assert np.linalg.matrix_rank(rows, tol=1e-9) <= 2
        twist = rng.normal(size=3)
        best = np.linalg.lstsq(rows, twist, rcond=None)[0]
        assert np.linalg.norm(rows @ best - twist) > 1e-3
        # The paper's J† = Jᵀ(J Jᵀ)⁻¹ does not exist: J Jᵀ is 3×3 of rank 2.
        assert np.linalg.matrix_rank(rows @ rows.T, tol=1e-9) <= 2


def test_example_2_2_the_planar_4r_has_a_self_motion_of_dimension_one() -> None:
    links = [1.0, 0.8, 0.6, 0.4]
    model = planar_arm(links)
    rng = np.random.default_rng(2)
    n, n_o = model.nv, PLANAR.rank
    assert n - n_o == 1  # r_m
    for _ in range(20):
        q = random_configuration(model, rng, margin=0.1)
        rows = planar_rows(model, q, PLANAR)
        assert np.linalg.matrix_rank(rows, tol=1e-6) == 3
        twist = rng.normal(size=3)
        best = np.linalg.lstsq(rows, twist, rcond=None)[0]
        close(rows @ best, twist, atol=1e-9)
        # The one direction of self-motion keeps the tip where it is, by the textbook formula.
        self_motion = np.linalg.svd(rows)[2][3:]
        assert self_motion.shape == (1, 4)
        close(textbook_jacobian(links, q) @ self_motion[0], np.zeros(3), atol=1e-12)


def test_example_2_3_positioning_with_the_planar_3r_leaves_one_direction() -> None:
    model = planar_arm([2.0, 1.5, 1.0])
    positioning = PLANE
    assert task_redundancy(operational=PLANAR, task=positioning) == 1
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = random_configuration(model, rng, margin=0.1)
        rows = planar_rows(model, q, positioning)
        assert rows.shape == (2, 3)
        assert np.linalg.matrix_rank(rows, tol=1e-6) == 2
        # What is free turns the tip without moving it.
        free = np.linalg.svd(rows)[2][2]
        textbook = textbook_jacobian([2.0, 1.5, 1.0], q)
        close(textbook[:2] @ free, np.zeros(2), atol=1e-12)
        assert abs(textbook[2] @ free) > 1e-3

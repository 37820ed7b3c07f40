"""Clearance: distances and derivatives held against another library, bounds, pairs, refusals."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.cells import among_others, random_tree
from oracles.distances import Distances
from oracles.twists import ALONG_X, PLANE, POINT, at, twists

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.control.posing import EVERYTHING

pytestmark = pytest.mark.any_blas  # distances are the kernel's own

seeds = st.integers(0, 2**32 - 1)
ACCURATE = 1e-6
"""By how much a distance may be off, m."""
SMOOTH = 1e-3
"""A derivative exists where those to both sides differ by less."""


def named(clearance: qt.Clearance) -> set[frozenset[str]]:
    """The pairs, by the names of their geoms."""
    return {frozenset(name.split(" to ")) for name in clearance.names}


def pairs_of(xml: str, *ignore: tuple[str, str]) -> set[frozenset[str]]:
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{xml}</mujoco>")
    return named(qt.Clearance(model, ignore=list(ignore)))


def both(*names: str) -> set[frozenset[str]]:
    """Pairs written as 'a-b'."""
    return {frozenset(name.split("-")) for name in names}


# ---------------------------------------------------------------------------------- distances


def configurations(
    rng: np.random.Generator, oracle: Distances, pairs: Array, count: int, right_angles: bool
) -> Array:
    """Random configurations of ``among_others``; at every other one some pair nearly touches."""
    q = np.zeros((count, 6))
    q[:, :3] = rng.normal(size=(count, 3)) * rng.choice([0.02, 0.1, 0.2], size=(count, 1))
    if right_angles:
        q[:, :3] = np.round(q[:, :3], 1)
        return q
    q[:, 3:] = rng.uniform(-np.pi, np.pi, size=(count, 3))
    for row in q[::2]:
        first, second = pairs[rng.integers(len(pairs))]
        found = oracle.at(row)(int(first), int(second))
        moves_first = oracle.model.geom_bodyid[first] > 0
        away = found.normal if moves_first else -found.normal
        row[:3] += (found.value - rng.choice([1e-2, 1e-4, 1e-7, -1e-6, -1e-3])) * away
    return q


@pytest.mark.parametrize("right_angles", [False, True])
def test_distances_and_depths_are_those_of_another_library(right_angles: bool) -> None:
    """The 42 pairs of random models, of each two kinds of geoms."""
    apart = inside = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        model = among_others(rng, right_angles=right_angles)
        clearance, oracle = qt.Clearance(model, distance=0.0), Distances(model)
        assert len(clearance.pairs) == 42
        q = configurations(rng, oracle, clearance.pairs, 3, right_angles)
        true, found = oracle.along(q, clearance.pairs), clearance.margins(q)
        worst = np.abs(found - true).max(axis=0)
        wrong = [f"{clearance.names[k]}: {worst[k]:.1e}" for k in np.flatnonzero(worst > ACCURATE)]
        assert not wrong, (seed, wrong)
        apart, inside = apart + int((true > 0.0).sum()), inside + int((true <= 0.0).sum())
    assert apart > 450
    assert inside > 100


@pytest.mark.parametrize("seed", range(4))
def test_moving_out_along_the_gradient_by_the_depth_separates(seed: int) -> None:
    """The slides carry the first geom, so that the gradient has the direction of the least way."""
    rng = np.random.default_rng(seed)
    model = among_others(rng)
    clearance, oracle = qt.Clearance(model, distance=0.0), Distances(model)
    q = configurations(rng, oracle, clearance.pairs, 3, False)
    margins, gradients = clearance.margins(q), clearance.gradients(q)[:, :, :3]
    tested = 0
    for row, depths, ways in zip(q, margins, gradients, strict=True):
        for pair, depth, way in zip(clearance.pairs, depths, ways, strict=True):
            first, second = map(int, pair)
            if abs(depth) < 1e-5:  # the direction is that of rounding
                continue
            assert np.linalg.norm(way) == pytest.approx(1.0, abs=1e-6)
            # From the first to the second: the gap along it is the distance, or the depth.
            n = -way if model.geom_bodyid[first] > 0 else way
            gap = float(oracle.at(row).gap(first, second, n)) if np.isfinite(n).all() else np.nan
            if model.geom(first).name != "b_plane" and model.geom(second).name != "b_plane":
                assert gap == pytest.approx(depth, abs=1e-5), clearance.names
            if depth < 0.0:
                out = row.copy()
                out[:3] += (-depth + 1e-5) * way
                assert oracle.at(out)(first, second).value > 0.0
                tested += 1
    assert tested > 10


def test_the_deepest_overlap_on_a_motion_is_found_between_its_rows() -> None:
    """Two cubes of 0.2 m, one passing the other: depth min(0.2 − |x|, 0.2 − |y|), in closed form.

    On the line from (−0.3, 0.18) to (0.3, 0.10), y = 0.14 − 2/15 x, it is largest where both are
    equal, at x = 0.14 / (17/15).
    """
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="still" type="box" size="0.1 0.1 0.1"/>
        <body><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
        <geom name="moving" type="box" size="0.1 0.1 0.1"/></body></worldbody></mujoco>"""
    )
    clearance = qt.Clearance(model, 0.0)
    q = np.array([[-0.3, 0.18], [0.3, 0.10]])
    near = clearance.nearest(q)
    assert near is not None
    x = 0.14 / (17.0 / 15.0)
    assert near.distance == pytest.approx(-(0.2 - x), abs=2e-5)
    assert near.at == pytest.approx((x + 0.3) / 0.6, abs=1e-3)
    # An overlap of 76 mm is more than a tolerance of 0.1 mm lets through.
    deepest = np.array([[x, 0.14 - 2.0 / 15.0 * x]])
    assert clearance.first_violated(deepest, tolerance=1e-4).tolist() == [0]
    assert clearance.first_violated(deepest, tolerance=0.08).tolist() == [-1]
    assert clearance.first_violated(q, tolerance=1e-4).tolist() == [-1, -1]


# ---------------------------------------------------------------------------------- derivatives


@settings(max_examples=15)
@given(seed=seeds)
def test_distances_on_random_trees(seed: int) -> None:
    """Of hinges and slides, whose zero may be elsewhere, with bodies fixed to others."""
    rng = np.random.default_rng(seed)
    model = random_tree(rng)
    clearance = qt.Clearance(model, distance=0.01)
    q = rng.uniform(-2.0, 2.0, size=(2, model.nq))
    true = Distances(model).along(q, clearance.pairs) - 0.01
    np.testing.assert_allclose(clearance.margins(q), true, rtol=0, atol=ACCURATE)


def test_gradients_are_finite_differences_on_random_trees() -> None:
    rng, h = np.random.default_rng(0), 1e-5
    errors, skipped = [], 0
    for _ in range(6):
        model = random_tree(rng)
        clearance = qt.Clearance(model)
        q = rng.uniform(-2.0, 2.0, size=(3, model.nq))
        here, gradients = clearance.margins(q), clearance.gradients(q)
        assert gradients.shape == (3, len(clearance.pairs), model.nv)
        for joint in range(model.nv):
            step = h * np.eye(model.nq)[joint]
            after = (clearance.margins(q + step) - here) / h
            before = (here - clearance.margins(q - step)) / h
            smooth = (np.abs(after - before) < SMOOTH) & (here > 0.001)
            skipped += int((~smooth & (here > 0.001)).sum())
            error = np.abs(gradients[:, :, joint] - 0.5 * (after + before))
            errors += error[smooth].tolist()
    assert len(errors) > 1000
    assert skipped < 0.05 * len(errors)
    assert np.quantile(errors, 0.99) < 1e-4
    assert max(errors) < SMOOTH


# ---------------------------------------------------------------------------------- bounds


def wandering(rng: np.random.Generator, q: Array, travel: Array, count: int = 120) -> Array:
    """A random motion from q (nq,) in which each joint's path is as long as its travel, (T, nq)."""
    turns = rng.normal(size=(int(rng.integers(1, 5)), len(q)))
    pieces = turns / np.abs(turns).sum(axis=0) * travel
    ends = q + np.vstack([np.zeros(len(q)), np.cumsum(pieces, axis=0)])
    at = np.linspace(0.0, len(pieces), count)
    return np.column_stack([np.interp(at, np.arange(len(ends)), column) for column in ends.T])


@settings(max_examples=15)
@given(seed=seeds)
def test_no_motion_within_the_travel_varies_a_margin_by_more_than_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng)
    clearance = qt.Clearance(model)
    q = rng.uniform(-2.0, 2.0, size=model.nq)
    travel = rng.uniform(0.0, 1.0, size=model.nv) * rng.choice([0.0, 0.05, 0.5, 3.0], size=model.nv)
    if not travel.any():
        travel[rng.integers(model.nv)] = 1.0
    bound = clearance.change(q[None], travel[None])[0]
    assert bound.shape == (len(clearance.pairs),)
    assert (bound >= 0.0).all()
    for _ in range(3):
        motion = wandering(rng, q, travel)
        margins = clearance.margins(motion)
        assert (np.abs(np.diff(margins, axis=0)).sum(axis=0) <= bound + 1e-6).all()
        # The least margin on the way, by what is known at its ends.
        least = clearance.least(motion[:1], motion[-1:], travel[None])[0]
        assert (margins.min(axis=0) >= least - 1e-6).all()


@settings(max_examples=15)
@given(seed=seeds)
def test_no_motion_with_bounded_second_derivatives_comes_nearer_than_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng)
    # A bound above the distance may be less sharp: so large that none is.
    clearance = qt.Clearance(model, distance=10.0)
    some = rng.uniform(-2.0, 2.0, size=(50, model.nq))
    clear = some[clearance.inside(some, 10.0)]
    for q in clear[:5]:
        size = rng.choice([0.01, 0.05, 0.2, 0.5])
        rate, curve = size * rng.uniform(-1.0, 1.0, size=(2, model.nv))
        curve *= rng.choice([0.0, 1.0])
        s = np.linspace(0.0, 1.0, 101)[:, None]
        motion = q + s * rate + 0.5 * s**2 * curve
        travel = np.maximum(np.abs(rate), np.abs(rate + curve))
        ends = motion[:1], motion[-1:], travel[None]
        margins = clearance.margins(motion).min(axis=0)
        least = clearance.least(*ends, np.abs(curve)[None])[0]
        assert (margins >= least - ACCURATE).all()
        assert (least >= clearance.least(*ends)[0]).all()


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_what_is_known_of_a_configuration_is_no_more_than_holds_at_the_next(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng)
    clearance = qt.Clearance(model, distance=0.05)
    steps = rng.choice([1e-3, 0.03, 0.5], size=(40, 1)) * rng.normal(size=(40, model.nq))
    q = np.cumsum(steps, axis=0)
    alone = np.concatenate([clearance.margins(row[None]) for row in q])
    enough = float(rng.choice([0.0, 0.1, 0.5]))
    together = clearance.bounded(q, enough)
    near = (alone < enough - ACCURATE) | (together < enough - ACCURATE)
    np.testing.assert_allclose(together[near], alone[near], rtol=0, atol=ACCURATE)
    assert (together <= alone + ACCURATE).all()
    first = [clearance.first_violated(row[None])[0] for row in q]
    assert clearance.first_violated(q).tolist() == first
    deep = 0.05 + float(rng.choice([1e-4, 5e-3, 0.03]))  # of overlaps
    below = alone < -deep
    expected = np.where(below.any(axis=1), below.argmax(axis=1), -1)
    assert clearance.first_violated(q, deep).tolist() == expected.tolist()
    middle = 0.5 * (q[:-1] + q[1:])
    least = clearance.least(q[:-1], q[1:], np.abs(np.diff(q, axis=0)))
    assert (least <= clearance.margins(middle) + ACCURATE).all()


def test_the_bound_is_not_idle() -> None:
    """A pair that a joint does not move has the bound 0; that of a lever is at most twice it."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><compiler angle="radian"/><worldbody>
      <geom name="wall" type="box" size="0.1 1 1" pos="2 0 0"/>
      <body name="one"><joint axis="0 0 1"/><geom name="one" type="sphere" size="0.05"/>
        <body name="two" pos="1 0 0"><joint axis="0 0 1"/>
          <geom name="two" type="sphere" size="0.05" pos="0.5 0 0"/>
          <body name="three" pos="0.6 0 0"><joint type="slide" axis="1 0 0"/>
            <geom name="three" type="sphere" size="0.05"/></body></body></body>
    </worldbody></mujoco>""")
    clearance = qt.Clearance(model)
    column = {frozenset(n.split(" to ")): k for k, n in enumerate(clearance.names)}
    q, travel = np.zeros((3, 3)), 0.1 * np.eye(3)
    bound = clearance.change(q, travel)
    assert set(column) == both("wall-one", "wall-two", "wall-three", "one-three")
    wall_two, one_three = column[frozenset(("wall", "two"))], column[frozenset(("one", "three"))]
    assert bound[2, wall_two] == 0.0  # the slide is behind it
    assert bound[0, one_three] == 0.0  # the first joint carries both
    assert 0.1 * 1.5 <= bound[0, wall_two] <= 2.0 * 0.1 * 1.5
    assert bound[2, one_three] == pytest.approx(0.1)
    assert (clearance.change(q, 2.0 * travel) >= bound).all()


# ---------------------------------------------------------------------------------- pairs

ARM = """
  <geom name="floor" type="plane" size="1 1 1" pos="0 0 -1"/>
  <body name="post" pos="3 0 0"><geom name="post_a" size="0.1"/><geom name="post_b" size="0.2"/>
  </body>
  <body name="base"><geom name="base" size="0.1"/>
    <body name="shoulder" pos="0 0 0.3"><joint axis="0 0 1"/><geom name="shoulder" size="0.1"/>
      <body name="cover"><geom name="cover" size="0.1"/></body>
      <body name="elbow" pos="0.5 0 0"><joint axis="0 1 0"/><geom name="elbow" size="0.1"/>
        <body name="hand" pos="0.5 0 0"><joint axis="0 1 0"/>{hand}
          <body name="tool"><geom name="tool" size="0.05" {tool}/></body>
        </body></body></body></body></worldbody>"""
HAND = '<geom name="hand" size="0.1"/>'
ALL = both(
    "floor-shoulder", "floor-cover", "floor-elbow", "floor-hand", "floor-tool",
    "post_a-shoulder", "post_a-cover", "post_a-elbow", "post_a-hand", "post_a-tool",
    "post_b-shoulder", "post_b-cover", "post_b-elbow", "post_b-hand", "post_b-tool",
    "base-elbow", "base-hand", "base-tool",
    "shoulder-hand", "shoulder-tool", "cover-hand", "cover-tool",
)  # fmt: skip


def arm(tool: str = "", rest: str = "", hand: str = HAND) -> str:
    return ARM.format(tool=tool, hand=hand) + rest


def arm_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{arm()}</mujoco>")


def touching(*names: str) -> set[frozenset[str]]:
    """The pairs of ``ALL`` in which all of some names are."""
    return {pair for pair in ALL if set(names) <= pair}


EXCLUDED = '<contact><exclude body1="hand" body2="shoulder"/></contact>'
STATED = '<contact><pair geom1="floor" geom2="tool"/></contact>'
SILENT = 'contype="0" conaffinity="0"'


@pytest.mark.parametrize(
    ("xml", "expected"),
    [
        # Not those of a body, of bodies fixed to each other or jointed, or that nothing moves.
        (arm(), ALL),
        (arm(SILENT), ALL - touching("tool")),
        (arm('contype="2" conaffinity="4"'), ALL - touching("tool")),
        (arm('contype="0" conaffinity="1"'), ALL),  # the others' contype is 1
        (arm('contype="3" conaffinity="0"'), ALL),
        (arm(rest=EXCLUDED), ALL - both("shoulder-hand")),
        # As in MuJoCo a <pair> does not ask for contype.
        (arm(SILENT, STATED), (ALL - touching("tool")) | both("floor-tool")),
        (arm(hand='<geom size="0.1"/>'), ALL),  # called by its body, whose only geom it is
    ],
)
def test_which_pairs_there_are(xml: str, expected: set[frozenset[str]]) -> None:
    assert pairs_of(xml) == expected


@pytest.mark.parametrize(
    ("ignore", "without"),
    [
        ([("floor", "tool")], both("floor-tool")),
        ([("tool", "floor")], both("floor-tool")),
        ([("post", "tool")], both("post_a-tool", "post_b-tool")),
        ([("post_a", "tool")], both("post_a-tool")),
        ([("base", "base")], set()),
        ([("floor", "tool"), ("base", "elbow")], both("floor-tool", "base-elbow")),
    ],
)
def test_ignored_pairs_by_geoms_and_bodies(
    ignore: list[tuple[str, str]], without: set[frozenset[str]]
) -> None:
    """A body stands for its geoms. Of two things that share a name, neither is forgotten."""
    assert pairs_of(arm(), *ignore) == ALL - without


def test_pairs_may_be_given_and_names_follow_them() -> None:
    """Those that are given have the margins that they have among all."""
    model = arm_model()
    every = qt.Clearance(model, distance=0.03)
    assert every.pairs.shape == (len(ALL), 2)
    assert every.kind == "clearance"
    assert every.units == ("m",) * len(ALL)
    for (a, b), name in zip(every.pairs, every.names, strict=True):
        assert name == f"{model.geom(a).name} to {model.geom(b).name}"
    some = qt.Clearance(model, distance=0.03, pairs=every.pairs[1::2])
    assert some.names == every.names[1::2] and len(some.names) > 1
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, model.nq))
    assert some.margins(q) == pytest.approx(every.margins(q)[:, 1::2], abs=1e-12)
    assert every.without_pairs().margins(q).shape == (5, 0)


def test_unnamed_geoms_are_called_by_their_body_and_ignored_by_that_name() -> None:
    text = arm(hand='<geom size="0.1"/><geom size="0.2" pos="0 0 0.1"/>')
    every = pairs_of(text)
    assert both("floor-hand geom 1", "floor-hand geom 2", "base-hand geom 2") <= every
    assert both("floor-hand").isdisjoint(every)
    assert len(every) == len(ALL) + len(touching("hand"))
    for number in (1, 2):
        name = f"hand geom {number}"
        assert pairs_of(text, ("floor", name)) == every - both(f"floor-{name}")
    with pytest.raises(qt.InvalidInput, match="no geom or body is called 'hand geom 3'"):
        pairs_of(text, ("floor", "hand geom 3"))


def test_geoms_of_one_robot_that_touch_no_other_are_no_pair() -> None:
    """A model without colliding geoms has no pairs, and everything has width 0."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="1"/><body><joint/><geom size="1" contype="0" '
        'conaffinity="0"/></body></worldbody></mujoco>'
    )
    clearance = qt.Clearance(model)
    assert clearance.pairs.shape == (0, 2)
    assert clearance.names == clearance.units == ()
    q = np.zeros((4, 1))
    assert clearance.margins(q).shape == (4, 0)
    assert clearance.gradients(q).shape == (4, 0, 1)
    assert clearance.change(q, q).shape == (4, 0)
    assert clearance.least(q, q, q).shape == (4, 0)
    assert clearance.excess(q).tolist() == [0.0] * 4
    assert clearance.compute_qp_inequalities(mink.Configuration(model), 0.01).G.shape[0] == 0


def test_mocap_bodies_are_obstacles() -> None:
    """One that has moved is seen where it is; the pairs with what stands are none."""
    model = world("""<geom name="floor" type="plane" size="1 1 1" pos="0 0 -1"/>
      <body name="ball" mocap="true" pos="2 0 0"><geom name="ball" size="0.1"/></body>
      <body name="link"><joint axis="0 0 1"/><geom name="tip" size="0.05" pos="1 0 0"/></body>""")
    clearance = qt.Clearance(model, distance=0.0)
    assert both("ball-tip") <= named(clearance)
    configuration = mink.Configuration(model, np.zeros(1))
    configuration.data.mocap_pos[0] = [1.0, 0.3, 0.0]
    mujoco.mj_forward(model, configuration.data)
    rows = clearance.compute_qp_inequalities(configuration, 1.0)
    # 0.3 − 0.15 m ahead of the tip, which turns towards it with a lever of 1 m.
    ahead = rows.G[:, 0] > 0.5
    assert ahead.sum() == 1
    assert rows.G[ahead][0, 0] == pytest.approx(1.0, abs=1e-9)
    assert rows.h[ahead][0] == pytest.approx(0.15, abs=1e-9)


# ---------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("place", "turn"), [([np.nan, 0, 0], [1, 0, 0, 0]), ([1, 0, 0], [0, 0, 0, 0])]
)
def test_an_obstacle_without_a_pose_is_refused(place: list[float], turn: list[float]) -> None:
    """No distance from it would be too small."""
    model = world("""<body name="ball" mocap="true" pos="2 0 0"><geom size="0.1"/></body>
      <body><joint axis="0 0 1"/><geom size="0.05" pos="1 0 0"/><site name="tip" pos="1 0 0"/>
      </body>""")
    task = qt.TwistTask("tip", "site", POINT)
    controller = qt.Controller(model, [task], limits=[qt.Clearance(model)])
    configuration = mink.Configuration(model)
    task.set_target_from_configuration(configuration)
    configuration.data.mocap_pos[0], configuration.data.mocap_quat[0] = place, turn
    with pytest.raises(qt.InvalidInput, match="mocap body 'ball'"):
        controller.step(configuration, 0.01)
    configuration.data.mocap_pos[0], configuration.data.mocap_quat[0] = [2, 0, 0], [1, 0, 0, 0]
    assert np.isfinite(controller.step(configuration, 0.01).velocity).all()


@pytest.mark.parametrize(
    "q",
    [np.zeros(2), np.zeros((3, 1)), np.zeros((3, 3)), [[np.nan, 0.0]], [[0.0, np.inf]], None,
     "arm.csv", [["0", "1"]], [[0.0, 1.0], [0.0]], [[True, False]]],
)  # fmt: skip
def test_configurations_that_are_none_are_refused(q: Any) -> None:
    """NaN is neither near nor clear, and the kernel would read behind short rows."""
    clearance = qt.Clearance(mujoco.MjModel.from_xml_string(PLANAR))
    for ask in (
        clearance.margins, clearance.first_violated, clearance.gradients, clearance.closest,
        clearance.nearest,
    ):  # fmt: skip
        with pytest.raises(qt.InvalidInput, match="q: expected"):
            ask(q)


def test_what_is_no_model_or_another_one_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string(PLANAR)
    for wrong in ("arm.xml", mujoco.MjData(model)):
        with pytest.raises(qt.InvalidInput, match="expected a MjModel"):
            qt.Clearance(wrong)  # type: ignore[arg-type]
    elsewhere = mujoco.MjModel.from_xml_string(PLANAR.replace("0.9 0 0", "1.9 0 0"))
    task = qt.TwistTask("tool", "site", POINT)
    task.set_target(mink.SE3.identity())
    again = qt.Clearance(mujoco.MjModel.from_xml_string(PLANAR))  # of the same model, read anew
    controller = qt.Controller(model, [task], limits=[again])
    with pytest.raises(qt.InvalidInput, match="step: bodies or geoms of the Clearance's model"):
        controller.step(mink.Configuration(elsewhere), 0.01)
    with pytest.raises(qt.InvalidInput, match="of the same model"):
        qt.Controller(model, [task], limits=[qt.Clearance(elsewhere)])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"ignore": [("flor", "tool")]}, r"'flor'.*floor"),
        *[
            ({"ignore": wrong}, "ignore")
            for wrong in ([("floor",)], ["floor"], [("floor", "tool", "hand")], [(1, 2)], [None])
        ],
        *[({"distance": d}, "distance") for d in (-0.001, np.nan, np.inf, "near", None, [0.1])],
        *[
            ({"pairs": wrong}, "pairs")
            for wrong in ([[0, 999]], [[0, -1]], [[0.0, 1.0]], [0, 1], 3, [[0, 1, 2]], [[1, 1]])
        ],
    ],
)
def test_arguments_that_are_none_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(qt.InvalidInput, match=said):
        qt.Clearance(arm_model(), **options)


HILLS = """<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>
    <worldbody><geom name="hills" type="hfield" hfield="h"/>
      <body pos="0 0 3"><joint/><geom size="0.1"/></body></worldbody></mujoco>"""
ABOVE = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
    <body pos="0 0 3">{joint}<geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (HILLS, "hills"),
        (ABOVE.format(joint='<joint type="ball" name="wrist"/>'), "wrist"),
        (ABOVE.format(joint='<freejoint name="wrist"/>'), "wrist"),
    ],
)
def test_what_is_not_convex_or_moves_freely_is_refused_by_its_name(xml: str, said: str) -> None:
    with pytest.raises(qt.InvalidInput, match=said):
        qt.Clearance(mujoco.MjModel.from_xml_string(xml))


# ---------------------------------------------------------------------------------- steps


def world(bodies: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}</worldbody>'
        "</mujoco>"
    )


PLANAR = """
    <mujoco><compiler angle="radian" autolimits="true"/><worldbody>
      <geom name="wall" type="box" size="0.1 2 1" pos="0.9 0 0" quat="0.98 0 0 0.2"/>
      <body><joint axis="0 0 1" range="-3 3"/>
        <geom type="capsule" size="0.04" fromto="0 0 0 0.5 0 0"/>
        <body pos="0.5 0 0"><joint axis="0 0 1" range="-2.8 2.8"/>
          <geom name="hand" type="box" size="0.2 0.05 0.03" pos="0.2 0 0"/>
          <site name="tool" pos="0.4 0 0"/></body></body>
    </worldbody></mujoco>"""
BLOCK = '<body name="block" mocap="true"><geom name="block" type="box" size="{}" pos="{}"/></body>'
CART = """<body><joint type="slide" axis="1 0 0" range="-5 5"/>
    <geom name="cart" size="0.05"/><site name="tool"/></body>"""
TURN = twists("none", "line")
Place = Callable[[mujoco.MjData, float], object]


class Cell:
    """A robot with a task that keeps 20 mm from everything, and the oracle beside it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        projector: qt.TwistProjector,
        target: mink.SE3,
        *,
        velocity: float = 1.0,
        acceleration: Any = "default",
        mode: Any = "scale",
    ) -> None:
        self.model, self.clearance = model, qt.Clearance(model, distance=0.02)
        self.motion = qt.MotionLimit(model, velocity=velocity, acceleration=acceleration)
        self.task = qt.TwistTask("tool", "site", projector)
        self.task.set_target(target)
        limits = [self.clearance, self.motion]
        self.controller = qt.Controller(model, [self.task], limits=limits, on_infeasible=mode)
        self.oracle = Distances(model)

    def least(
        self,
        q: Array,
        steps: int,
        dt: float,
        place: Place = lambda data, t: None,
        feed: Callable[[float], object] = lambda t: None,
    ) -> tuple[float, Array]:
        """The least distance at the ends of the steps, by the oracle, and the last configuration.

        ``place(data, t)`` puts obstacles where they are at time t, ``feed(t)`` sets the target.
        """
        configuration, least = mink.Configuration(self.model, q), np.inf
        for k in range(steps):
            place(configuration.data, k * dt)
            configuration.update()
            feed(k * dt)
            configuration.integrate_inplace(self.controller.step(configuration, dt).velocity, dt)
            place(self.oracle.data, (k + 1) * dt)
            now = self.oracle.at(configuration.q).of(self.clearance.pairs).min()
            least = min(least, float(now))
        return least, configuration.q


@pytest.mark.parametrize("acceleration", [None, 10.0])
@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_steps_keep_the_distance_where_they_lead(mode: str, acceleration: float | None) -> None:
    """A tool drawn along and through a wall, at up to 3 rad/s: the oracle looks after each step."""
    model = mujoco.MjModel.from_xml_string(PLANAR)
    cell = Cell(model, PLANE, at(1, 0.5, 0), velocity=3.0, acceleration=acceleration, mode=mode)
    least, _ = cell.least(
        np.array([2.0, -1.0]), 300, 0.01,
        feed=lambda t: cell.task.set_target(at(1.0, 0.5 * np.cos(3.0 * t), 0.0)),
    )  # fmt: skip
    assert 0.02 - 1e-6 <= least <= 0.021  # it does get there


FOUR_JOINTS = """
    <mujoco><compiler angle="radian" autolimits="true"/><worldbody>
      <geom name="wall" type="box" size="0.1 2 1" pos="0.9 0 0" quat="0.98 0 0 0.2"/>
      <body name="ball" mocap="true" pos="0.1 1.3 0"><geom size="0.1"/></body>
      <body><joint axis="0 0 1" range="-3 3"/>
        <geom type="capsule" size="0.04" fromto="0 0 0 0.4 0 0"/>
        <body pos="0.4 0 0"><joint axis="0 0 1" range="-2.8 2.8"/>
          <geom type="capsule" size="0.04" fromto="0 0 0 0.3 0 0"/>
          <body pos="0.3 0 0"><joint axis="0 0 1" range="-2.8 2.8"/>
            <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0"/>
            <body pos="0.2 0 0"><joint axis="0 0 1" range="-2.8 2.8"/>
              <geom name="hand" type="box" size="0.1 0.05 0.03" pos="0.1 0 0"/>
              <site name="tool" pos="0.2 0 0"/></body></body></body></body>
    </worldbody></mujoco>"""


@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_before_a_wall_and_an_obstacle_kernel_and_reference_agree(mode: str) -> None:
    """One call of the kernel, and the readable step on the same rows."""
    model = mujoco.MjModel.from_xml_string(FOUR_JOINTS)
    motion, clearance = qt.MotionLimit(model, velocity=2.0), qt.Clearance(model, distance=0.01)
    task, start = qt.TwistTask("tool", "site", PLANE), np.array([1.2, 0.6, -0.9, -0.4])
    controller = qt.Controller(
        model, [task], limits=[clearance, motion], on_infeasible=mode,  # type: ignore[arg-type]
        secondary=[qt.PostureReference(model, start, gain=0.01)],
    )  # fmt: skip
    configuration = mink.Configuration(model, start)
    seen: Counter[str] = Counter()
    for k in range(600):
        configuration.data.mocap_pos[0] = [0.1, 1.3 - 0.0005 * k, 0.0]
        configuration.update()
        away = min(0.01 * k, 1.0)
        task.set_target(at(0.3 + 0.9 * away, 0.5 + 0.6 * np.sin(0.01 * k), 0.0))
        velocity = motion.velocity
        step = controller.step(configuration, 0.005)
        if k % 4 == 0:
            motion.velocity = velocity
            compiled, controller._prepared = controller._prepared, None
            clearance.in_step.has_begun = True  # with the rows of the step
            expected = controller._solved(configuration, 0.005, EVERYTHING)
            clearance.in_step.has_begun, controller._prepared = False, compiled
            motion.velocity = step.velocity
            assert step.status is expected.status
            np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-7)
            seen[step.status.name] += 1
        configuration.integrate_inplace(step.velocity, 0.005)
    assert controller.reference_steps == 150
    assert "RELAXED" in seen
    assert mode == "relax" or "SCALED" in seen


def test_the_distance_may_be_changed_between_two_steps() -> None:
    """A tool in front of a wall moves away from it, and says why."""
    cell = Cell(mujoco.MjModel.from_xml_string(PLANAR), PLANE, at(1.0, 0.0, 0.0), velocity=3.0)
    clearance = cell.clearance
    _, q = cell.least(np.array([2.0, -1.0]), 200, 0.01)
    assert cell.oracle.at(q).of(clearance.pairs).min() == pytest.approx(0.02, abs=1e-3)
    clearance.distance = 0.05
    step = cell.controller.step(mink.Configuration(cell.model, q), 0.01)
    assert "recovering: wall to hand is 0.0" in step.message
    _, q = cell.least(q, 100, 0.01)
    assert cell.oracle.at(q).of(clearance.pairs).min() == pytest.approx(0.05, abs=1e-3)
    for wrong in (-0.1, np.nan, "5 mm"):
        with pytest.raises(qt.InvalidInput, match=r"Clearance\(distance="):
            clearance.distance = wrong  # type: ignore[assignment]
    with pytest.raises(qt.InvalidInput, match=r"Clearance\(recovery_speed="):
        clearance.recovery_speed = 0.0


@pytest.mark.parametrize("turns", [False, True])
def test_what_comes_faster_and_faster_is_given_way_to(turns: bool) -> None:
    """A block that is pushed, and a paddle that turns, with a constant acceleration."""
    model = world(BLOCK.format("0.3 0.02 0.5", "0.3 0 0") + CART)
    cell = Cell(model, ALONG_X, at(0, 0, 0), velocity=3.0, acceleration=None)

    def place(data: mujoco.MjData, t: float) -> None:
        angle = 0.5 * t**2 if turns else 0.0
        data.mocap_pos[0] = [-0.3, -0.3, 0.0] if turns else [-0.9 + 0.5 * t**2, 0.0, 0.0]
        data.mocap_quat[0] = [np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)]

    least, q = cell.least(np.zeros(1), 300, 0.005, place)
    assert abs(q[0]) > 0.1
    assert 0.02 - 1e-6 <= least <= 0.02 + 2e-5


@pytest.mark.parametrize("acceleration", [None, 10.0])
def test_a_lever_gives_way_in_corrected_steps_too(acceleration: float | None) -> None:
    """Its distance is curved, so that steps are corrected: the block still moves in them."""
    model = world(
        BLOCK.format("0.1 0.1 0.5", "0 0 0")
        + """<body><joint axis="0 0 1" range="-3 3"/><geom name="lever" type="box"
        size="0.25 0.02 0.02" pos="0.25 0 0"/><site name="tool" pos="0.5 0 0"/></body>"""
    )
    cell = Cell(model, TURN, at(0, 0, 0), velocity=3.0, acceleration=acceleration)

    def place(data: mujoco.MjData, t: float) -> None:
        data.mocap_pos[0] = [0.4, -0.3 + 0.3 * t, 0.0]

    least, q = cell.least(np.zeros(1), 400, 0.005, place)
    assert q[0] > 0.5
    assert least >= 0.02 - 1e-6


def test_a_robot_on_a_mocap_body_gives_way_to_what_stands() -> None:
    """All that its carrier carries moves, on joints too: so does its distance from a wall."""
    model = world(
        '<geom name="wall" type="box" size="0.1 1 1" pos="1 0 0"/>'
        f'<body name="cart" mocap="true">{CART}</body>'
    )

    def place(data: mujoco.MjData, t: float) -> None:
        data.mocap_pos[0] = [0.2 * t, 0.0, 0.0]

    least, _ = Cell(model, ALONG_X, at(1, 0, 0)).least(np.zeros(1), 400, 0.01, place)
    assert 0.02 - 1e-6 <= least <= 0.021


@pytest.mark.parametrize("mode", ["scale", "relax"])
def test_a_bar_along_a_wall_turns_and_moves_away(mode: str) -> None:
    """Each end comes nearer as the other goes away; the slide gives way, the bar does not stop."""
    model = world("""<geom name="wall" type="box" size="0.1 3 1" pos="-0.1 0 0"/>
      <body><joint type="slide" axis="1 0 0" range="0 5"/>
        <geom size="0.01" contype="0" conaffinity="0"/>
        <body><joint axis="0 0 1" range="-1 1"/><geom name="bar" type="capsule" size="0.05"
          fromto="0 -1.5 0 0 1.5 0"/><site name="tool"/></body></body>""")
    target = mink.SE3.from_rotation(mink.SO3.from_z_radians(-0.3))
    cell = Cell(model, TURN, target, mode=mode)
    least, q = cell.least(np.array([0.07 + 1.5e-6, 1e-6]), 400, 0.005)
    assert least >= 0.02 - 1e-6
    assert q[1] == pytest.approx(-0.3, abs=1e-3)


def test_a_joint_near_the_end_of_its_range_lets_a_slower_one_take_over_in_time() -> None:
    """Two slides give way to a block; the first ends, the second accelerates a tenth as fast."""
    model = world(
        BLOCK.format("0.1 1 1", "-0.1 0 0")
        + """<body><joint name="first" type="slide" axis="1 0 0" range="-1 0.3"/>
        <geom size="0.01" contype="0" conaffinity="0"/>
        <body><joint name="second" type="slide" axis="1 0 0" range="-5 5"/>
          <geom name="cart" size="0.05"/><site name="tool"/></body></body>"""
    )
    cell = Cell(model, ALONG_X, at(0, 0, 0), acceleration={"first": 10.0, "second": 1.0})

    def place(data: mujoco.MjData, t: float) -> None:
        data.mocap_pos[0] = [-0.4 + 0.4 * t, 0.0, 0.0]

    least, q = cell.least(np.zeros(2), 600, 0.005, place)
    assert least >= 0.02 - 1e-6
    assert q[0] > 0.29


def cart_before_a_thin_wall(wall: float) -> tuple[mujoco.MjModel, qt.TwistTask]:
    """A wall so far ahead of a cart, m, and a task that draws the cart 0.4 m forwards."""
    model = world(
        f'<geom name="wall" type="box" size="0.001 1 1" pos="{wall + 0.051} 0 0"/>'
        + CART.replace('range="-5 5"', "")
    )
    task = qt.TwistTask("tool", "site", ALONG_X)
    task.set_target(at(0.4, 0.0, 0.0))
    return model, task


def test_a_long_step_does_not_pass_through_what_is_beyond_the_horizon() -> None:
    """0.4 m in one step, and a thin wall 0.3 m ahead of the cart."""
    model, task = cart_before_a_thin_wall(0.3)
    controller = qt.Controller(model, [task], limits=[qt.Clearance(model, distance=0.02)])
    velocity = controller.step(mink.Configuration(model, np.zeros(1)), 1.0).velocity
    assert 0.27 <= velocity[0] <= 0.28 + 1e-6


# ---------------------------------------------------------------------------------- in a task


def test_a_path_in_a_scene_with_colliding_geoms_must_not_touch_them() -> None:
    """Without a clearance of its own; the margin of another model is not taken along."""
    path_task = qt.load_task("deburring")
    kinds = [constraint.kind for constraint in path_task.constraints]
    assert ("clearance" in kinds) is (len(qt.Clearance(path_task.model).pairs) > 0)

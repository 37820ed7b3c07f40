"""Models seen from one of their bodies, against MuJoCo's kinematics of the model as it stands."""

import re
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import qp_twist as qt
from qp_twist.constraints.colliding_pairs import colliding_pairs, geom_name
from qp_twist.paths.rerooted import OLD_WORLD, rerooted

Array = npt.NDArray[np.float64]
TETRAHEDRON = "0 0 0  0.11 0 0  0 0.09 0  0.02 0.01 0.13"
SHAPES = ("sphere", "capsule", "box", "cylinder", "ellipsoid", "mesh")


def text(values: npt.ArrayLike) -> str:
    return " ".join(repr(float(x)) for x in np.asarray(values))


def random_tree(seed: int) -> mujoco.MjModel:
    """Some bodies at random poses, each on zero to three hinges and slides, some without names.

    Geoms stand in the world too, one of them a plane; masks of collision are random, and
    a pair is stated, another one excluded.
    """
    rng = np.random.default_rng(seed)
    root = ET.Element("mujoco", model="random")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(ET.SubElement(root, "asset"), "mesh", name="tetrahedron", vertex=TETRAHEDRON)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "geom", name="floor", type="plane", size="0 0 1", pos="0 0 -2")
    bodies = [world]

    def add_shapes(body: ET.Element, count: int) -> None:
        for _ in range(count):
            shape = str(rng.choice(SHAPES))
            of_mesh = {"mesh": "tetrahedron"} if shape == "mesh" else {}
            geom = ET.SubElement(
                body, "geom", type=shape, pos=text(rng.normal(0, 0.3, 3)), mass="0.1",
                quat=text(rng.normal(size=4)), size=text(rng.uniform(0.02, 0.1, 3)),
                contype=str(rng.integers(0, 4)), conaffinity=str(rng.integers(0, 4)), **of_mesh,
            )  # fmt: skip
            if rng.random() < 0.5:
                geom.set("name", f"geom {rng.integers(1 << 40)}")
        ET.SubElement(body, "site", name=f"site {len(bodies)}", pos=text(rng.normal(size=3)),
                      quat=text(rng.normal(size=4)))  # fmt: skip

    add_shapes(world, 2)
    for k in range(int(rng.integers(2, 9))):
        parent = bodies[int(rng.integers(len(bodies)))]
        body = ET.SubElement(parent, "body", pos=text(rng.normal(0, 0.5, 3)),
                             quat=text(rng.normal(size=4)))  # fmt: skip
        if k < 2 or rng.random() < 0.8:
            body.set("name", f"body {100 + k}")
        for _ in range(int(rng.integers(0, 4))):
            joint = ET.SubElement(
                body, "joint", type=str(rng.choice(["hinge", "slide"])),
                axis=text(rng.normal(size=3)), pos=text(rng.normal(0, 0.3, 3)),
                ref=repr(float(rng.normal(0, 0.3))),
            )  # fmt: skip
            if rng.random() < 0.8:
                joint.set("name", f"joint {rng.integers(1 << 40)}")
            if rng.random() < 0.5:
                joint.set("range", text(np.sort(rng.normal(size=2)) + np.array([0.0, 0.1])))
        ET.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        bodies.append(body)
        add_shapes(body, int(rng.integers(0, 3)))
    contact = ET.SubElement(root, "contact")
    ET.SubElement(contact, "exclude", body1="body 100", body2="body 101")
    named = [g.get("name", "") for g in root.iter("geom") if g.get("name")]
    if len(named) > 1:
        ET.SubElement(contact, "pair", geom1=named[0], geom2=named[-1])
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def at(model: mujoco.MjModel, q: Array) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return data


def named_pairs(model: mujoco.MjModel) -> dict[tuple[str, str], tuple[int, int]]:
    """Pairs of geoms that may collide, by the names that messages have for them."""
    return {
        (min(names), max(names)): (int(a), int(b))
        for a, b in colliding_pairs(model)
        for names in [(geom_name(model, a), geom_name(model, b))]
    }


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), which=st.integers(0, 7))
@example(seed=0, which=0)
def test_everything_is_where_it_was_as_seen_from_the_body(seed: int, which: int) -> None:
    """Poses relative to the body, distances, names and ranges, at random joint values."""
    model = random_tree(seed)
    named = [b for b in range(1, model.nbody) if model.body(b).name]
    name = model.body(named[which % len(named)]).name
    seen, order = rerooted(model, name)
    assert sorted(order) == list(range(model.nq))
    pairs, same = named_pairs(model), named_pairs(seen)
    assert set(pairs) == set(same)
    labels, ours = qt.JointRanges.of(model).names, qt.JointRanges.of(seen).names
    for k in range(model.njnt):
        assert ours[order[k]] == labels[k]
        assert (seen.jnt_range[order[k]] == model.jnt_range[k]).all()
        assert seen.jnt_limited[order[k]] == model.jnt_limited[k]
        assert seen.qpos0[order[k]] == model.qpos0[k]
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = rng.uniform(-3.0, 3.0, model.nq)
        there = np.empty(model.nq)
        there[order] = q
        data, found = at(model, q), at(seen, there)
        R, p = data.body(name).xmat.reshape(3, 3), data.body(name).xpos
        frames = [(data.body(model.body(b).name), found.body(model.body(b).name)) for b in named]
        frames += [(data.body(0), found.body(OLD_WORLD))]
        frames += [(data.site(s), found.site(model.site(s).name)) for s in range(model.nsite)]
        for one, other in frames:
            np.testing.assert_allclose(R.T @ (one.xpos - p), other.xpos, rtol=0, atol=1e-12)
            turned = R.T @ one.xmat.reshape(3, 3)
            np.testing.assert_allclose(turned, other.xmat.reshape(3, 3), rtol=0, atol=1e-12)
        for label, (a, b) in pairs.items():
            before = mujoco.mj_geomDistance(model, data, a, b, 50.0, None)
            after = mujoco.mj_geomDistance(seen, found, *same[label], 50.0, None)
            if before > 1e-3:  # MuJoCo's depths of overlaps depend on its iteration
                assert abs(before - after) < 1e-6


CELL = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="arm"><joint name="lift" type="slide" axis="0 0 1" range="-1 1"/>
      <geom name="arm" size="0.1" pos="0 0 1"/><site name="tool" pos="0 0 1"/></body>
    <body name="table" pos="1 0 0.5">
      <geom name="table" type="box" size="0.2 0.2 0.1"/>
      <body name="plate"><joint name="turn" axis="0 0 1"/><geom name="plate" size="0.1"/>
        <site name="mark"/></body></body>
    <body name="ball"><joint name="socket" type="ball"/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_what_may_collide_does_not_depend_on_the_body_that_is_at_rest() -> None:
    """Of the base of a joint only the neighbours are left out; the floor stays an obstacle."""
    model = mujoco.MjModel.from_xml_string(CELL)
    seen = rerooted(model, "plate").model
    assert set(named_pairs(seen)) == set(named_pairs(model))
    assert ("arm", "floor") in named_pairs(seen)
    assert ("floor", "plate") in named_pairs(seen)
    assert ("plate", "table") not in named_pairs(seen)
    floor = seen.geom("floor")
    assert floor.type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    clearance = qt.Clearance(seen, 0.0, [("ball", OLD_WORLD), ("ball", "arm"), ("ball", "plate")])
    pair = clearance.names.index("arm to floor") if "arm to floor" in clearance.names else (
        clearance.names.index("floor to arm"))  # fmt: skip
    q = np.array(seen.qpos0)
    q[seen.joint("lift").qposadr[0]] = 0.3
    q[seen.joint("turn").qposadr[0]] = 1.0
    assert abs(clearance.margins(q[None])[0, pair] - 1.2) < 1e-12


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("plates", "the scene has no body 'plates'; did you mean 'plate'?"),
        ("mark", "'mark' is a site; name the body that carries it, 'plate'."),
        ("floor", "'floor' is a geom; name the body that carries it, 'world'."),
        ("ball", "joint 'socket', which moves 'ball', is a ball or free joint"),
        ("", "expected the name of a body of the scene, got ''."),
        (7, "expected the name of a body of the scene, got 7."),
    ],
)
def test_a_body_that_cannot_be_at_rest_is_refused(body: str, words: str) -> None:
    with pytest.raises(qt.InvalidInput, match=re.escape(words)):
        rerooted(mujoco.MjModel.from_xml_string(CELL), body)

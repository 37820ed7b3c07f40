"""Random models whose geoms may collide: a body among others, and trees of hinges and slides."""

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from oracles.arms import random_direction

Array = npt.NDArray[np.float64]
Kind = mujoco.mjtGeom
ROUND = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
KINDS = ("plane", *ROUND)


def random_geom(
    spec: mujoco.MjSpec, body: Any, kind: str, rng: np.random.Generator, **options: Any
) -> None:
    """Add a geom of a kind to a body of a model: sizes of 10 to 150 mm, now and then very flat."""
    if kind == "mesh":
        points = rng.normal(size=(int(rng.integers(4, 40)), 3)) * rng.uniform(0.2, 1.0, 3)
        mesh = spec.add_mesh()
        mesh.name = f"mesh_{len(spec.meshes)}"
        mesh.uservert = (0.15 * points / np.abs(points).max()).ravel().tolist()
        body.add_geom(type=Kind.mjGEOM_MESH, meshname=mesh.name, **options)
        return
    size = np.exp(rng.uniform(np.log(0.01), np.log(0.15), size=3))
    body.add_geom(type=getattr(Kind, f"mjGEOM_{kind.upper()}"), size=size, **options)


def random_quaternion(rng: np.random.Generator, *, right_angles: bool) -> Array:
    """Unit quaternion, (4,), w first: any rotation, or one of the 24 of a cube."""
    turn = Rotation.random(rng=rng)
    if right_angles:
        turn = Rotation.create_group("O")[int(rng.integers(24))]
    return turn.as_quat(scalar_first=True)


def among_others(rng: np.random.Generator, *, right_angles: bool = False) -> mujoco.MjModel:
    """A body on three slides and three hinges with a geom of each kind, among fixed geoms.

    The moving geoms ``a_KIND`` collide with the fixed ones ``b_KIND`` only, of which one is a
    plane: 42 pairs. With ``right_angles`` all axes are parallel to those of the world at q = 0, and
    all positions on a grid of 0.1 m, so that faces and edges are parallel and often touch.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="moving")
    for k in range(6):
        kind = mujoco.mjtJoint.mjJNT_SLIDE if k < 3 else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=f"q{k}", type=kind, axis=np.eye(3)[k % 3])

    def place() -> dict[str, Any]:
        position = rng.normal(size=3) * rng.choice([0.02, 0.1, 0.2])
        position = np.round(position, 1) if right_angles else position
        return {"pos": position, "quat": random_quaternion(rng, right_angles=right_angles)}

    for kind in ROUND:
        random_geom(
            spec, body, kind, rng, name=f"a_{kind}", contype=1, conaffinity=0, mass=1.0,
            quat=random_quaternion(rng, right_angles=right_angles),
        )  # fmt: skip
    for kind in KINDS:
        random_geom(
            spec, spec.worldbody, kind, rng, name=f"b_{kind}", contype=0, conaffinity=1, **place()
        )
    return spec.compile()


def random_tree(rng: np.random.Generator, bodies: int = 7) -> mujoco.MjModel:
    """A tree of bodies with up to two hinges or slides each, and a geom of any kind on each.

    Bodies are ``body_1`` …, every third or so fixed to its parent; geoms ``geom_1`` … collide by
    MuJoCo's defaults. Two geoms, ``still_1`` and ``still_2``, stand in the world.
    """
    spec = mujoco.MjSpec()
    made = [spec.worldbody]
    for i in range(bodies):
        parent = made[int(rng.integers(max(0, len(made) - 3), len(made)))]
        body = parent.add_body(
            name=f"body_{i + 1}",
            pos=rng.uniform(0.1, 0.4) * random_direction(rng),
            quat=random_quaternion(rng, right_angles=False),
        )
        for j in range(int(rng.choice([0, 1, 1, 2])) if i else 1):
            slides = rng.random() < 0.3
            body.add_joint(
                name=f"joint_{i + 1}_{j + 1}",
                type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
                axis=random_direction(rng),
                pos=0.1 * rng.normal(size=3),
                ref=rng.normal() if rng.random() < 0.2 else 0.0,
            )
        random_geom(
            spec, body, str(rng.choice(ROUND)), rng, name=f"geom_{i + 1}", mass=1.0,
            pos=0.1 * rng.normal(size=3), quat=random_quaternion(rng, right_angles=False),
        )  # fmt: skip
        made.append(body)
    for i, kind in enumerate(rng.choice(KINDS, size=2, replace=False)):
        where = np.array([0.0, 0.0, -0.6]) if kind == "plane" else 0.6 * random_direction(rng)
        random_geom(spec, spec.worldbody, str(kind), rng, name=f"still_{i + 1}", pos=where)
    return spec.compile()

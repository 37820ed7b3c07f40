"""Which pairs of geoms of a model may collide, and what they are called."""

from __future__ import annotations

import difflib

import mujoco
import numpy as np

from qp_twist.checks import Indices, Mask
from qp_twist.errors import InvalidInput

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_SUPPORTED = tuple(
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"))
    for kind in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)


def colliding_pairs(model: mujoco.MjModel) -> Indices:
    """Ids (P, 2) of the pairs of geoms that may collide and of which a joint moves one.

    As MuJoCo filters them: ``contype`` and ``conaffinity``, without ``<exclude>``, and all
    ``<pair>``. Bodies that a joint connects are left out: a body that moves and the one it is
    jointed to, with all bodies fixed to the latter; where that is fixed to the world, only it and
    the bodies between it and the world, so that what stands beside a robot's base remains.
    """
    types, affinities = model.geom_contype, model.geom_conaffinity
    able = np.flatnonzero((types != 0) | (affinities != 0))
    a, b = able[np.array(np.triu_indices(len(able), 1))]
    meets = (types[a] & affinities[b] | types[b] & affinities[a]) != 0
    meets &= ~_left_out(model)[model.geom_bodyid[a], model.geom_bodyid[b]]
    stated = np.sort(np.column_stack([model.pair_geom1, model.pair_geom2]), axis=1)
    found = np.unique(np.vstack([np.column_stack([a, b])[meets], stated]), axis=0)
    moving = [any(relative_joints(model, int(a), int(b))) for a, b in found]
    return np.asarray(found[np.array(moving, dtype=bool)], dtype=np.intp)


def check_shapes(model: mujoco.MjModel, pairs: Indices) -> None:
    """Refuse a geom of the pairs that is not convex, or that a ball or free joint moves."""
    for geom in np.unique(pairs):
        if int(model.geom_type[geom]) not in _SUPPORTED:
            kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
            raise InvalidInput(
                f"Clearance: {geom_name(model, int(geom))} is a {kind.lower()}; only planes, "
                "spheres, capsules, cylinders, ellipsoids, boxes and meshes are supported. Replace "
                "it, or take it out of the collisions (contype and conaffinity 0)."
            )
        for joint in joints_above(model, int(model.geom_bodyid[geom])):
            if int(model.jnt_type[joint]) in _SCALAR:
                continue
            name = model.joint(joint).name or f"joint {joint}"
            raise InvalidInput(
                f"Clearance: {name} is a ball or free joint that moves "
                f"{geom_name(model, int(geom))}; only hinges and slides are supported. Use "
                "mink.CollisionAvoidanceLimit for such a robot, or take its geoms out of the "
                "collisions (contype and conaffinity 0)."
            )


def joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints that move a body, from it inwards."""
    found: list[int] = []
    while body > 0:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        found += range(first + count - 1, first - 1, -1)
        body = int(model.body_parentid[body])
    return found


def relative_joints(model: mujoco.MjModel, one: int, other: int) -> tuple[list[int], list[int]]:
    """The joints that move a geom but not the other, from the geom inwards, and vice versa."""
    chains = [joints_above(model, int(model.geom_bodyid[geom])) for geom in (one, other)]
    common = set(chains[0]) & set(chains[1])
    first, second = ([j for j in chain if j not in common] for chain in chains)
    return first, second


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Its name; if it has none that of its body, with a number if that has several geoms."""
    name, body = str(model.geom(geom).name), int(model.geom_bodyid[geom])
    alone = model.body_geomnum[body] == 1
    return name or (body_name(model, body) if alone else _numbered(model, geom))


def _numbered(model: mujoco.MjModel, geom: int) -> str:
    body = int(model.geom_bodyid[geom])
    return f"{body_name(model, body)} geom {geom - int(model.body_geomadr[body]) + 1}"


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Its name, or its number."""
    return str(model.body(body).name) or f"body {body}"


def geoms_of(model: mujoco.MjModel, name: str) -> set[int]:
    """The geoms of a name: a geom, or a body with all geoms on it and on bodies fixed to it.

    ``"BODY geom 2"`` is the second geom on that body. Other names are refused.
    """
    geoms = range(model.ngeom)
    found = {g for g in geoms if name in (geom_name(model, g), _numbered(model, g))}
    groups, fixed = _groups(model), set[int]()
    for body in range(model.nbody):  # parents come before their children
        parent = int(model.body_parentid[body])
        if model.body(body).name == name or (parent in fixed and groups[body] == groups[parent]):
            fixed.add(body)
    found |= {g for g in geoms if int(model.geom_bodyid[g]) in fixed}
    if not found and not fixed:
        known = [str(model.geom(g).name) for g in geoms]
        known += [str(model.body(b).name) for b in range(model.nbody)]
        known = [name for name in dict.fromkeys(known) if name]  # a body may be called as a geom
        near = difflib.get_close_matches(name, known, n=3)
        hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {known}."
        raise InvalidInput(f"ignore: no geom or body is called {name!r}; {hint}"[:600])
    return found


def _groups(model: mujoco.MjModel) -> Indices:
    """Number of the group of bodies fixed to each other that each body belongs to, (nbody,).

    ``body_weldid``, but for bodies on a mocap body, which MuJoCo before 4 welds to the world.
    """
    groups = np.arange(model.nbody)
    for body in range(1, model.nbody):
        if model.body_jntnum[body] == 0 and model.body_mocapid[body] < 0:
            groups[body] = groups[model.body_parentid[body]]
    return groups


def _left_out(model: mujoco.MjModel) -> Mask:
    """Which bodies a joint connects, with those fixed to them, or are excluded, (nbody, nbody)."""
    groups = _groups(model)
    found = np.zeros((model.nbody, model.nbody), dtype=bool)
    for signature in model.exclude_signature:
        found[divmod(int(signature), 1 << 16)] = True
    for body in np.flatnonzero(model.body_jntnum):
        parent = int(model.body_parentid[body])
        base = groups == groups[parent]
        if groups[parent] == groups[0]:
            base[:] = False
            while parent > 0:
                base[parent] = True
                parent = int(model.body_parentid[parent])
        found[np.ix_(base, groups == body)] = True
    return found | found.T

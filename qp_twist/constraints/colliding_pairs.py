"""Which pairs of geoms of a model may collide, and what they are called."""

from __future__ import annotations

import difflib
import re

import mujoco
import numpy as np

from qp_twist.checks import Indices
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
    groups = _groups(model)
    jointed = _jointed(model, groups)
    excluded = {tuple(divmod(int(signature), 1 << 16)) for signature in model.exclude_signature}
    stated = {
        tuple(sorted((int(a), int(b))))
        for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    able = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    found = set(stated)
    for i, a in enumerate(able):
        for b in able[i + 1 :]:
            one, other = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            if (one, other) in excluded or (other, one) in excluded:
                continue
            if (one, other) in jointed or (other, one) in jointed:
                continue
            meets = model.geom_contype[a] & model.geom_conaffinity[b]
            if meets or model.geom_contype[b] & model.geom_conaffinity[a]:
                found.add((int(a), int(b)))
    moving = sorted((a, b) for a, b in found if any(relative_joints(model, a, b)))
    return np.array(moving, dtype=np.intp).reshape(-1, 2)


def check_shapes(model: mujoco.MjModel, pairs: Indices) -> None:
    """Refuse what clearance cannot be computed for.

    Raises:
        InvalidInput: If a geom of the pairs is not convex, or a ball or free joint moves one.
    """
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
    name = str(model.geom(geom).name)
    if name:
        return name
    body = int(model.geom_bodyid[geom])
    label, count = body_name(model, body), int(model.body_geomnum[body])
    return label if count == 1 else f"{label} geom {geom - int(model.body_geomadr[body]) + 1}"


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Its name, or its number."""
    return str(model.body(body).name) or f"body {body}"


def geoms_of(model: mujoco.MjModel, name: str) -> set[int]:
    """The geoms of a name: a geom, or a body with all geoms on it and on bodies fixed to it.

    ``"BODY geom 2"`` is the second geom on that body, as :func:`geom_name` calls it.

    Raises:
        InvalidInput: If neither has that name.
    """
    found = {g for g in range(model.ngeom) if model.geom(g).name == name}
    groups = _groups(model)
    for body in range(model.nbody):
        if model.body(body).name != name:
            continue
        fixed = {body}
        for other in range(body + 1, model.nbody):  # parents come before their children
            if int(model.body_parentid[other]) in fixed and groups[other] == groups[body]:
                fixed.add(other)
        found |= {g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in fixed}
        return found
    if found:
        return found
    counted = re.fullmatch(r"(.+) geom ([1-9]\d*)", name)
    for body in range(model.nbody) if counted else ():
        number = int(counted[2]) if counted else 0
        if counted and body_name(model, body) == counted[1] and number <= model.body_geomnum[body]:
            return {int(model.body_geomadr[body]) + number - 1}
    known = [str(model.geom(g).name) for g in range(model.ngeom)]
    known += [str(model.body(b).name) for b in range(model.nbody)]
    known = [name for name in dict.fromkeys(known) if name]  # a body may be called like its geom
    near = difflib.get_close_matches(name, known, n=3)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {known}."
    raise InvalidInput(f"ignore: no geom or body is called {name!r}; {hint}"[:600])


def _groups(model: mujoco.MjModel) -> Indices:
    """Number of the group of bodies fixed to each other that each body belongs to, (nbody,)."""
    groups = np.arange(model.nbody)
    for body in range(1, model.nbody):
        if model.body_jntnum[body] == 0 and model.body_mocapid[body] < 0:
            groups[body] = groups[model.body_parentid[body]]
    return groups


def _jointed(model: mujoco.MjModel, groups: Indices) -> set[tuple[int, int]]:
    """Pairs of bodies that a joint connects, with those fixed to them."""
    found: set[tuple[int, int]] = set()
    for body in range(1, model.nbody):
        if model.body_jntnum[body] == 0:
            continue
        parent = int(model.body_parentid[body])
        if groups[parent] != groups[0]:
            base = [int(b) for b in np.flatnonzero(groups == groups[parent])]
        else:
            base, above = [], parent
            while above > 0:
                base.append(above)
                above = int(model.body_parentid[above])
        moved = [int(b) for b in np.flatnonzero(groups == body)]
        found |= {(a, b) for a in base for b in moved}
    return found

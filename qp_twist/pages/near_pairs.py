"""Which pairs of geoms are near each other, and the shapes by which a scene shows it."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.paths import PathTask

NEAR = 0.015
"""Margin below which a pair counts as near, m."""
_OVER = 0.002
"""How far shapes stand over the geoms that they cover, m."""


class NearPair(NamedTuple):
    """The pair with the least margin."""

    distance: float
    """Its distance, m; negative by the depth of penetration."""
    asked: float
    """The distance that the task asks for, m."""
    name: str
    """Its name, as in ``Clearance.names``."""
    too_near: bool
    """Whether a check does not let the distance pass."""


def nearest_pair(path_task: PathTask, q: Array) -> NearPair | None:
    """The pair with the least margin at a configuration q (nq,); ``None`` without pairs."""
    found = []
    for clearance in path_task.clearances:
        (distance,), (pair,) = clearance.closest(q[None])
        kept = path_task.tolerances.keeps_clear(distance, clearance.distance)
        found.append(NearPair(float(distance), clearance.distance, clearance.names[pair], not kept))
    return min(found, key=lambda pair: pair.distance - pair.asked, default=None)


def near_geoms(path_task: PathTask, q: Array) -> dict[int, bool]:
    """Ids of the geoms of near pairs at any of q (N, nq), and whether one is too near."""
    found: dict[int, bool] = {}
    for clearance in path_task.clearances:
        least = clearance.bounded(q, NEAR).min(axis=0)
        for pair in np.flatnonzero(least < NEAR):
            for geom in clearance.pairs[pair].tolist():
                too_near = bool(least[pair] < -path_task.tolerances.position)
                found[geom] = found.get(geom, False) or too_near
    return found


def shape_over(model: mujoco.MjModel, geom: int) -> tuple[Array, Array] | None:
    """Vertices, slightly outside, and faces of a geom in its frame; ``None`` for a plane.

    A mesh counts as its convex hull, since that is the shape whose distance is computed.
    """
    import trimesh
    from mjviser.conversions import create_primitive_mesh

    kind = int(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return None
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        first = model.mesh_vertadr[model.geom_dataid[geom]]
        count = model.mesh_vertnum[model.geom_dataid[geom]]
        mesh = trimesh.Trimesh(model.mesh_vert[first : first + count]).convex_hull
    else:
        mesh = create_primitive_mesh(model, geom)
    return mesh.vertices + _OVER * mesh.vertex_normals, mesh.faces

"""What a picture adds to a scene: colours of plain links, and a floor."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from qp_twist.drawing.sight import Drawn, bounds, sight

_PLAIN = (0.5, 0.5, 0.5, 1.0)
"""Colour that MuJoCo gives to a geom that states none."""
_FREE_CAMERA = 1.5
"""Distance of MuJoCo's free camera, in extents of the model."""
_LINKS = ((0.62, 0.66, 0.71, 1.0), (0.80, 0.82, 0.85, 1.0), (0.45, 0.49, 0.55, 1.0))
_ROUGHNESS = 0.7
_FIXED = (0.40, 0.42, 0.45, 1.0)
_FLOOR = {
    "plane_color": (186, 190, 196), "plane_opacity": 1.0,
    "cell_color": (172, 176, 182), "section_color": (158, 162, 168),
}  # fmt: skip
"""Colours of a floor in a viser scene."""


def coloured(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model in which neighbouring links without a colour can be distinguished."""
    found = copy.copy(model)
    plain = (model.geom_matid < 0) & (np.abs(model.geom_rgba - _PLAIN) < 1e-6).all(axis=1)
    joints = np.zeros(model.nbody, dtype=np.intp)  # before each body, from the world on
    for body in range(1, model.nbody):
        joints[body] = joints[model.body_parentid[body]] + model.body_jntnum[body]
    for geom in np.flatnonzero(plain):
        before = joints[model.geom_bodyid[geom]]
        found.geom_rgba[geom] = _LINKS[before % len(_LINKS)] if before else _FIXED
    return found


def framed(path_task: Drawn) -> mujoco.MjModel:
    """:func:`coloured`, with MuJoCo's free camera where :func:`~.sight.sight` looks from."""
    model = coloured(path_task.model)
    seen = sight(path_task)
    model.stat.center[:] = seen.look_at
    model.stat.extent = seen.distance / _FREE_CAMERA
    return model


def make_matte(scene: Any) -> None:
    """Let a viser scene draw floors grey, and meshes of one colour, without a material, matte.

    The player takes what has no material for metal, which is black without surroundings to mirror;
    and floors for white.
    """
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    def matte(mesh: Any) -> Any:
        visual = mesh.visual
        if visual.kind != "vertex" or len(np.unique(visual.vertex_colors, axis=0)) != 1:
            return mesh
        found, colour = mesh.copy(), visual.vertex_colors[0]
        found.visual = textured(
            material=surface(baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=_ROUGHNESS)
        )
        return found

    def with_matte(add: Callable[..., Any]) -> Callable[..., Any]:
        return lambda name, mesh, *args, **options: add(name, matte(mesh), *args, **options)

    surface: Any = PBRMaterial  # trimesh states no types of these
    textured: Any = TextureVisuals
    add_grid = scene.add_grid
    scene.add_mesh_trimesh = with_matte(scene.add_mesh_trimesh)
    scene.add_batched_meshes_trimesh = with_matte(scene.add_batched_meshes_trimesh)
    scene.add_grid = lambda name, **options: add_grid(name, **(options | _FLOOR))


def floor_height(path_task: Drawn) -> float | None:
    """Height of the lowest point of the scene, m, for a floor; ``None`` if it has a plane."""
    model = path_task.model
    if (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any() or not model.ngeom:
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = path_task.start
    mujoco.mj_kinematics(model, data)
    return float(bounds(model, data)[0][:, 2].min())

"""Floor, light and sky for a model that has none."""

from __future__ import annotations

from typing import Any

import mujoco

from qp_twist.robots.wording import free_name

DRAWN, NOT_DRAWN = 2, 3
"""Groups of geoms; viewers draw the first three, 0 to 2."""


def draw_once(spec: Any) -> None:
    """Do not draw what collides on a body that has other geoms to be drawn."""
    for body in spec.bodies:
        drawn = [g for g in body.geoms if g.group < NOT_DRAWN and not (g.contype or g.conaffinity)]
        for geom in body.geoms if drawn else []:
            if geom.contype or geom.conaffinity:
                geom.group = max(geom.group, NOT_DRAWN)


def add_room(spec: Any, height: float, *, collides: bool) -> None:
    """Add a floor at a height, m, unless there is one, and light and a sky likewise.

    A floor that collides with nothing is replaced if the new one does.
    """
    planes = [g for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if collides:
        for plane in [p for p in planes if not (p.contype or p.conaffinity)]:
            plane.contype = plane.conaffinity = 1
            plane.pos = [plane.pos[0], plane.pos[1], height]
    if not planes:
        spec.worldbody.add_geom(
            name=free_name("floor", {geom.name for geom in spec.geoms}),
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.1],
            pos=[0.0, 0.0, height], rgba=(0.60, 0.61, 0.63, 1.0), group=DRAWN, mass=0.0,
            contype=int(collides), conaffinity=int(collides),
        )  # fmt: skip
    if not list(spec.lights):
        spec.visual.headlight.ambient = [0.45, 0.45, 0.46]
        spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
        spec.visual.quality.shadowsize = 4096
        spec.visual.map.shadowclip = 3.0  # with less the floor shades itself where it is far
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[2.0, -1.0, 4.0],
            dir=[-0.5, 0.2, -0.8], diffuse=[0.6, 0.6, 0.6], castshadow=True,
        )  # fmt: skip
    if not any(t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in spec.textures):
        spec.add_texture(
            name=free_name("sky", {texture.name for texture in spec.textures}),
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.74, 0.82, 0.90], rgb2=[0.97, 0.98, 0.99], width=64, height=384,
        )  # fmt: skip

"""Shapes for a robot without any: rods from joint to joint, for pictures."""

from __future__ import annotations

import mujoco
import numpy as np

_THICKNESS = 0.03
"""Radius of a rod, as a share of the length of all rods together up to the tip."""
_COLOUR = (0.68, 0.73, 0.80, 1.0)


def add_rods(spec: mujoco.MjSpec) -> None:
    """Add a capsule from each link's origin to those of its children, without collisions."""
    links = [(body, child) for body in spec.bodies for child in body.bodies]
    lengths = [float(np.linalg.norm(child.pos)) for _, child in links]
    radius = max(_THICKNESS * sum(lengths) / 2.0, 1e-4)
    for (body, child), length in zip(links, lengths, strict=True):
        if length > radius:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=[0.0, 0.0, 0.0, *child.pos],
                size=[radius, 0.0, 0.0],
                mass=0.0,
                contype=0,
                conaffinity=0,
                rgba=_COLOUR,
            )

"""Shapes for pictures: of a robot without any, rods from joint to joint; of a tool, a pen."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.robots.room import DRAWN

_THICKNESS = 0.03
"""Radius of a rod, as a share of the length of all rods together up to the tip."""
_HANDLE, _POINT = 0.12, 0.03
"""Radii of a tool of which only the tip is known, as shares of its length."""
_COLOUR = (0.68, 0.73, 0.80, 1.0)


def add_rods(spec: mujoco.MjSpec) -> None:
    """Add a capsule from each link's origin to those of its children, without collisions."""
    links = [(body, child) for body in spec.bodies for child in body.bodies]
    lengths = [float(np.linalg.norm(child.pos)) for _, child in links]
    radius = max(_THICKNESS * sum(lengths) / 2.0, 1e-4)
    for (body, child), length in zip(links, lengths, strict=True):
        if length > radius:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, *child.pos],
                size=[radius, 0.0, 0.0], mass=0.0, contype=0, conaffinity=0, rgba=_COLOUR,
            )  # fmt: skip


def add_pen(body: Any, tip: Array, rgba: tuple[float, float, float, float]) -> None:
    """Add a handle and a thin point from a tool's origin to its tip (3,), m, without collisions."""
    length = float(np.linalg.norm(tip))
    if length == 0.0:
        return
    handle, point = _HANDLE * length, _POINT * length
    end = tip * (1.0 - point / length)
    for kind, start, stop, radius in (
        (mujoco.mjtGeom.mjGEOM_CYLINDER, np.zeros(3), 0.7 * tip, handle),
        (mujoco.mjtGeom.mjGEOM_CAPSULE, 0.7 * tip, end, point),
    ):
        body.add_geom(
            type=kind, fromto=[*start, *stop], size=[radius, 0.0, 0.0], mass=0.0, contype=0,
            conaffinity=0, rgba=rgba, group=DRAWN,
        )  # fmt: skip

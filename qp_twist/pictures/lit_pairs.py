"""Near pairs in the browser's scene: their geoms in colour, the nearest one with its distance."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.paths import PathTask
from qp_twist.pictures.carrier import CARRIER
from qp_twist.pictures.near_pairs import TOO_NEAR, NearPair, NearPairs

NEAR_RGB, TOO_NEAR_RGB = (230, 159, 0), (208, 0, 0)
_OPACITY, _OVER = 0.55, 0.002
"""Opacity of the shapes, and by how much they are larger than the geoms that they cover, m."""


class LitPairs:
    """Shapes of geoms that are near each other, over the scene: orange, and red if too near.

    They are the shapes whose distance is computed, which a scene may not draw: meshes as their
    convex hulls. A plane is not lit.

    Attributes:
        shapes: The shapes that there are so far by the id of their geom; ``None`` for a plane.
        label: The text at the nearest pair; ``None`` if the task has no clearance.
    """

    def __init__(self, server: Any, path_task: PathTask) -> None:
        """Light nothing yet.

        Args:
            server: A viser server.
            path_task: The task.
        """
        self._server = server
        self._pairs = NearPairs(path_task)
        self.shapes: dict[int, Any] = {}
        # Hidden from the beginning: a recording that starts again knows only what it has changed.
        self.label: Any = None
        if path_task.clearances:
            self.label = server.scene.add_label(
                f"{CARRIER}/near/label", "", font_size_mode="screen", depth_test=False,
                anchor="bottom-left", visible=False,
            )  # fmt: skip

    @property
    def path_task(self) -> PathTask:
        """The task, whose surroundings may be moved by replacing it; its geoms stay the same."""
        return self._pairs.path_task

    @path_task.setter
    def path_task(self, path_task: PathTask) -> None:
        self._pairs = NearPairs(path_task)

    def prepare(self, q: Array) -> None:
        """Add the shapes that will be lit at some of q (N, nq), none of them visible yet."""
        for geom in self._pairs.geoms(q):
            self._shape(geom)
        for shape in filter(None, self.shapes.values()):
            shape.visible = False
        self._write(None)

    def show(self, q: Array) -> NearPair | None:
        """Light the near pairs at a configuration q (nq,), and return the nearest pair."""
        lit = self._pairs.geoms(q[None])
        positions, rotations = self._pairs.poses(q)
        for geom in {*lit, *self.shapes}:
            shape = self._shape(geom)
            if shape is None:
                continue
            _set(shape, "visible", geom in lit)
            if geom in lit:
                _set(shape, "color", TOO_NEAR_RGB if lit[geom] else NEAR_RGB)
                wxyz = np.empty(4)
                mujoco.mju_mat2Quat(wxyz, rotations[geom].ravel())
                shape.position, shape.wxyz = positions[geom], wxyz
        near = self._pairs.nearest(q)
        self._write(near if lit else None)
        return near

    def _shape(self, geom: int) -> Any:
        if geom not in self.shapes:
            vertices, faces = shape_over(self.path_task.model, geom)
            self.shapes[geom] = self._server.scene.add_mesh_simple(
                f"{CARRIER}/near/{geom}", vertices, faces, color=NEAR_RGB, opacity=_OPACITY,
                cast_shadow=False, receive_shadow=False, visible=False,
            ) if len(faces) else None  # fmt: skip
        return self.shapes[geom]

    def _write(self, near: NearPair | None) -> None:
        if self.label is None:
            return
        _set(self.label, "visible", near is not None)
        if near is not None:
            _set(self.label, "text", f"{distance_text(near.distance)}: {near.name}")
            self.label.position = near.middle


def distance_text(distance: float) -> str:
    """A distance in mm, or the depth of an overlap."""
    mm = f"{abs(1e3 * distance):.1f} mm"
    return f"overlap by {mm}" if distance < -TOO_NEAR else mm


def shape_over(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Vertices, slightly outside, and faces of a geom in its frame; empty for a plane."""
    import trimesh
    from mjviser.conversions import create_primitive_mesh

    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return np.zeros((0, 3)), np.zeros((0, 3))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        first = model.mesh_vertadr[model.geom_dataid[geom]]
        count = model.mesh_vertnum[model.geom_dataid[geom]]
        mesh = trimesh.Trimesh(model.mesh_vert[first : first + count]).convex_hull
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        radii = model.geom_size[geom]
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        mesh.apply_scale(radii[:1].repeat(3) if kind == mujoco.mjtGeom.mjGEOM_SPHERE else radii)
    else:
        mesh = create_primitive_mesh(model, geom)
    low, high = mesh.bounds
    half = np.maximum(0.5 * (high - low), 1e-6)
    middle = 0.5 * (low + high)
    return middle + (mesh.vertices - middle) * (half + _OVER) / half, mesh.faces


def _set(handle: Any, name: str, value: object) -> None:
    """Set a property only if it changes: each one is a message."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)

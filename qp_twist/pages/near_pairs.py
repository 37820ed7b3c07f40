"""Which pairs of geoms are near each other, and their light in the browser's scene."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.drawing.palette import ORANGE, RED, rgb
from qp_twist.paths import PathTask

NEAR = 0.015
"""Margin below which a pair counts as near, m."""
CARRIER = "/carrier"
"""Name of the scene's frame that moves with the body that carries the path, its children in it."""
_FARTHEST = 10.0
"""Largest distance for which there is a point between, m."""
_OPACITY, _OVER = 0.55, 0.002
"""Opacity of the shapes, and by how much they are larger than the geoms that they cover, m."""


class NearPair(NamedTuple):
    """The pair with the least margin."""

    distance: float
    """Its distance, m; negative by the depth of penetration."""
    asked: float
    """The distance that the task asks for, m."""
    name: str
    """Its name, as in ``Clearance.names``."""
    middle: Array
    """Point between the two geoms where they are nearest, m, in the world, (3,)."""
    too_near: bool
    """Whether a check lets the distance pass no more."""


class NearPairs:
    """The clearances of a task, evaluated for pictures."""

    def __init__(self, path_task: PathTask) -> None:
        self.path_task = path_task
        self._data = mujoco.MjData(path_task.model)

    def nearest(self, q: Array) -> NearPair | None:
        """The pair with the least margin at a configuration q (nq,); ``None`` without pairs."""
        best: NearPair | None = None
        for clearance in self.path_task.clearances:
            distance, pair = (found[0] for found in clearance.closest(q[None]))
            if best is None or distance - clearance.distance < best.distance - best.asked:
                asked, middle = clearance.distance, self._between(q, *clearance.pairs[pair])
                kept = self.path_task.tolerances.keeps_clear(distance, asked)
                best = NearPair(float(distance), asked, clearance.names[pair], middle, not kept)
        return best

    def geoms(self, q: Array) -> dict[int, bool]:
        """Ids of the geoms of near pairs at any of q (N, nq), and whether one is too near."""
        found: dict[int, bool] = {}
        within = self.path_task.tolerances.position
        for clearance in self.path_task.clearances:
            least = clearance.bounded(q, NEAR).min(axis=0)
            for pair in np.flatnonzero(least < NEAR):
                for geom in clearance.pairs[pair].tolist():
                    found[geom] = found.get(geom, False) or bool(least[pair] < -within)
        return found

    def poses(self, q: Array) -> tuple[Array, Array]:
        """Positions (G, 3), m, and rotations (G, 3, 3) of all geoms at a configuration q (nq,)."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self.path_task.model, self._data)
        return self._data.geom_xpos, self._data.geom_xmat.reshape(-1, 3, 3)

    def _between(self, q: Array, one: int, other: int) -> Array:
        """Point between two geoms where they are nearest, by MuJoCo, m, (3,)."""
        self.poses(q)
        ends = np.zeros(6)
        model = self.path_task.model
        mujoco.mj_geomDistance(model, self._data, one, other, _FARTHEST, ends)
        middle: Array = 0.5 * (ends[:3] + ends[3:])
        return middle


class LitPairs:
    """Shapes of geoms that are near each other, over the scene: orange, and red if too near.

    They are the shapes whose distance is computed, which a scene may not draw: meshes as their
    convex hulls. A plane is not lit.

    Attributes:
        pairs: The pairs; their surroundings may be moved by replacing it by those of another task
            with the same geoms.
        shapes: The shapes that there are so far by the id of their geom; ``None`` for a plane.
        label: The text at the nearest pair; ``None`` if the task has no clearance.
    """

    def __init__(self, server: Any, path_task: PathTask) -> None:
        """Light nothing yet, in the scene of a viser server."""
        self._server = server
        self.pairs = NearPairs(path_task)
        self.shapes: dict[int, Any] = {}
        # Hidden from the beginning: a recording that starts again knows only what it has changed.
        self.label: Any = None
        if path_task.clearances:
            self.label = server.scene.add_label(
                f"{CARRIER}/near/label", "", font_size_mode="screen", depth_test=False,
                anchor="bottom-left", visible=False,
            )  # fmt: skip

    def prepare(self, q: Array) -> None:
        """Add the shapes that will be lit at some of q (N, nq), none of them visible yet."""
        for geom in self.pairs.geoms(q):
            self._shape(geom)
        for shape in filter(None, self.shapes.values()):
            shape.visible = False
        self._write(None)

    def show(self, q: Array) -> NearPair | None:
        """Light the near pairs at a configuration q (nq,), and return the nearest pair."""
        lit = self.pairs.geoms(q[None])
        positions, rotations = self.pairs.poses(q)
        for geom in {*lit, *self.shapes}:
            shape = self._shape(geom)
            if shape is None:
                continue
            _set(shape, "visible", geom in lit)
            if geom in lit:
                _set(shape, "color", rgb(RED if lit[geom] else ORANGE))
                wxyz = np.empty(4)
                mujoco.mju_mat2Quat(wxyz, rotations[geom].ravel())
                shape.position, shape.wxyz = positions[geom], wxyz
        near = self.pairs.nearest(q)
        self._write(near if lit else None)
        return near

    def _shape(self, geom: int) -> Any:
        if geom not in self.shapes:
            vertices, faces = shape_over(self.pairs.path_task.model, geom)
            self.shapes[geom] = self._server.scene.add_mesh_simple(
                f"{CARRIER}/near/{geom}", vertices, faces, color=rgb(ORANGE), opacity=_OPACITY,
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
    return f"overlap by {mm}" if distance < 0.0 else mm


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

"""Distances of pairs of geoms at many configurations: a model's geoms as the kernel takes them."""

from __future__ import annotations

import contextlib
import math

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from qp_twist.checks import Array, Indices, float_array
from qp_twist.constraints.colliding_pairs import joints_above, relative_joints
from qp_twist.errors import InvalidInput
from qp_twist.kernel.clearance_kernel import (
    CELL,
    Cell,
    changes,
    distances,
    first_below,
    gradients,
    least_distances,
    move_obstacles,
)
from qp_twist.kernel.convex import MESH, PLANE, CellSizes


class MovingShapes:
    """Geoms of some pairs, on the bodies of a model with hinges and slides.

    Distances and depths are those of :mod:`qp_twist.kernel.convex`.

    Attributes:
        has_moved: Whether mocap bodies were taken from MuJoCo's data.
    """

    def __init__(self, model: mujoco.MjModel, pairs: Indices) -> None:
        """Lay out the arrays for pairs that :func:`check_shapes` has accepted."""
        self._model, self._pairs = model, pairs
        self._geoms = np.unique(pairs)
        self._number = {int(geom): k for k, geom in enumerate(self._geoms)}
        vertices = [self._vertices(int(geom)) for geom in self._geoms]
        chains = [_chains(model, int(a), int(b)) for a, b in pairs]
        moving = self._moving()
        size = CellSizes(
            model.nbody, len(moving), model.njnt, len(self._geoms), sum(map(len, vertices)),
            len(pairs), sum(len(one) + len(other) for one, other in chains),
        )  # fmt: skip
        self.has_moved = False
        self._data: mujoco.MjData | None = None  # from which obstacles are taken
        self._of_mocap: tuple[Array | Indices, ...] = ()
        self._floats, self._integers = CELL.allocate(size)
        self._write(moving, vertices, chains)

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self._pairs)

    @property
    def arrays(self) -> tuple[Array, Array, Indices]:
        """Floats of the cell, those with mocap bodies where they are expected, and integers."""
        return self._floats, self._ahead, self._integers

    # ------------------------------------------------------------------ questions

    def distances(self, q: Array, enough: float) -> Array:
        """Signed distances (N, P) at q (N, nq), m; above ``enough`` lower bounds of them.

        Depths are always exact: the kernel takes touching shapes for farther than a negative
        ``enough``.
        """
        q = self.configurations(q)
        found = np.zeros((len(q), len(self._pairs)))
        distances(self._floats.copy(), self._integers, q, max(enough, 0.0), found)
        return found

    def first_below(self, q: Array, distance: float) -> Indices:
        """Index of the first pair nearer than ``distance`` at each configuration, or −1, (N,)."""
        if distance < 0.0:  # by depths
            below = self.distances(q, 0.0) < distance
            return np.where(below.any(axis=1), below.argmax(axis=1), -1)
        q = self.configurations(q)
        found = np.zeros(len(q), dtype=np.int64)
        first_below(self._floats.copy(), self._integers, q, distance, found)
        return found

    def gradients(self, q: Array, which: Indices) -> Array:
        """Derivatives (N, k, nv) of the distances of pairs ``which`` (N, k); 0 for the index −1."""
        q, which = self.configurations(q), np.ascontiguousarray(which, dtype=np.int64)
        found = np.zeros((*which.shape, self._model.nv))
        gradients(self._floats.copy(), self._integers, q, which, found)
        return found

    def changes(self, q: Array, travel: Array) -> Array:
        """Bounds of the distances' variation on motions from q, m, (N, P)."""
        q, travel = self.configurations(q), _rows("travel", travel, self._model.nv)
        found = np.zeros((len(q), len(self._pairs)))
        changes(self._floats.copy(), self._integers, q, travel, found)
        return found

    def least(
        self, before: Array, after: Array, travel: Array, curve: Array | None, distance: float
    ) -> Array:
        """Lower bounds of the distances between two configurations, sharp below ``distance``."""
        before, after = self.configurations(before), self.configurations(after)
        travel = _rows("travel", travel, self._model.nv)
        unknown = np.full_like(travel, np.inf)
        curve = unknown if curve is None else _rows("curve", curve, self._model.nv)
        found = np.zeros((len(before), len(self._pairs)))
        sharp = max(distance, 0.0)
        least_distances(
            self._floats.copy(), self._integers, before, after, travel, curve, sharp, found
        )
        return found

    def take_mocap(self, data: mujoco.MjData) -> None:
        """Take the poses of mocap bodies, obstacles that move, from MuJoCo's data.

        They are expected to move on as they did since this was last called; how far they are from
        where they were expected now may be missing again.
        """
        if not len(self._on_mocap):
            return
        if data is not self._data:
            places = data.mocap_pos, data.mocap_quat
            self._data, self._of_mocap = data, (
                *self.arrays, *self._on_mocap, *places, *self._scratch
            )  # fmt: skip
        refused = move_obstacles(*self._of_mocap, self.has_moved)
        if refused >= 0:  # nothing would be clear of it, nor near
            body = int(np.flatnonzero(self._model.body_mocapid == refused)[0])
            raise InvalidInput(
                f"mocap body {self._model.body(body).name!r}: expected a finite position and a "
                f"quaternion that is not 0, got {data.mocap_pos[refused].tolist()} and "
                f"{data.mocap_quat[refused].tolist()}; set data.mocap_pos and mocap_quat before "
                "the step."
            )
        self.has_moved = True

    # ------------------------------------------------------------------ layout

    def configurations(self, q: Array) -> Array:
        """Configurations (N, nq) as the kernel takes them.

        Raises:
            InvalidInput: If they are no numbers, have another shape, or are not finite: NaN is
                neither near nor clear.
        """
        rows = _rows("q", q, self._model.nq)
        if not math.isfinite(rows.sum()):
            raise InvalidInput("q: expected finite joint positions; it has NaN or infinite ones.")
        return rows

    def _vertices(self, geom: int) -> Array:
        """The vertices of a mesh's convex hull in the geom's frame, m, (V, 3); none of others."""
        model = self._model
        if int(model.geom_type[geom]) != MESH:
            return np.zeros((0, 3))
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        vertices: Array = np.unique(model.mesh_vert[first : first + count].astype(float), axis=0)
        with contextlib.suppress(QhullError):  # flat
            vertices = vertices[ConvexHull(vertices).vertices]
        return vertices

    def _moving(self) -> list[int]:
        """Bodies on the way to the geoms that a joint moves, parents first."""
        found: set[int] = set()
        for geom in self._geoms:
            body = int(self._model.geom_bodyid[geom])
            while body > 0:
                if joints_above(self._model, body):
                    found.add(body)
                body = int(self._model.body_parentid[body])
        return sorted(found)

    def _write(
        self,
        moving: list[int],
        vertices: list[Array],
        chains: list[tuple[list[int], list[int]]],
    ) -> None:
        model, data = self._model, mujoco.MjData(self._model)
        cell: Cell = CELL.arrays(self._floats, self._integers, self._integers)
        mujoco.mj_kinematics(model, data)
        tree, shapes, pairs, places = cell.tree, cell.shapes, cell.pairs, cell.places
        tree.moving[:] = moving
        tree.parent[:] = model.body_parentid
        tree.offset[:] = model.body_pos
        tree.joint_first[:], tree.joint_count[:] = model.body_jntadr, model.body_jntnum
        places.pose[:], places.turn[:] = data.xpos, data.xmat
        for body in range(model.nbody):
            mujoco.mju_quat2Mat(tree.turned[body], model.body_quat[body])
        tree.slides[:] = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        tree.axis[:], tree.anchor[:] = model.jnt_axis, model.jnt_pos
        tree.address[:] = model.jnt_qposadr
        tree.reference[:] = model.qpos0[model.jnt_qposadr]
        pairs.dof[:] = model.jnt_dofadr
        first = 0
        for k, (geom, of_mesh) in enumerate(zip(self._geoms, vertices, strict=True)):
            tree.body[k], tree.at[k] = model.geom_bodyid[geom], model.geom_pos[geom]
            mujoco.mju_quat2Mat(tree.about[k], model.geom_quat[geom])
            shapes.kind[k], shapes.size[k] = model.geom_type[geom], model.geom_size[geom]
            shapes.center[k], shapes.half[k] = np.split(model.geom_aabb[geom], 2)
            shapes.ball[k] = model.geom_rbound[geom]
            if shapes.kind[k] == PLANE:
                shapes.ball[k] = np.inf
            if len(of_mesh):
                shapes.first[k], shapes.last[k] = first, first + len(of_mesh)
                shapes.vertices[first : first + len(of_mesh)] = of_mesh
                first += len(of_mesh)
                ends = of_mesh.min(axis=0), of_mesh.max(axis=0)
                shapes.center[k] = 0.5 * (ends[0] + ends[1])
                shapes.half[k] = 0.5 * (ends[1] - ends[0])
                shapes.ball[k] = np.linalg.norm(of_mesh - shapes.center[k], axis=1).max()
        begin = 0
        for k, ((a, b), (one, other)) in enumerate(zip(self._pairs, chains, strict=True)):
            pairs.one[k], pairs.other[k] = self._number[int(a)], self._number[int(b)]
            end = begin + len(one) + len(other)
            pairs.first[k], pairs.middle[k], pairs.last[k] = begin, begin + len(one), end
            pairs.joints[begin:end] = one + other
            begin = end
        on_mocap: list[int] = []
        for body in range(1, model.nbody):
            still = model.body_jntnum[body] == 0
            if model.body_mocapid[body] >= 0 or (
                still and int(model.body_parentid[body]) in on_mocap
            ):
                on_mocap.append(body)
        numbers = model.body_mocapid[on_mocap].astype(np.int64)
        self._on_mocap = (np.array(on_mocap), numbers) if on_mocap else ()
        carried = np.array([_is_carried(model, int(body)) for body in tree.body], dtype=bool)
        pairs.obstacle[:] = carried[pairs.one] | carried[pairs.other]
        self._scratch = np.zeros((model.nbody, 2)), np.zeros(12)
        #: The same with mocap bodies where they are expected at the next step.
        self._ahead = self._floats.copy()


def _is_carried(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is a mocap body or carried by one, on joints too."""
    while body > 0:
        if model.body_mocapid[body] >= 0:
            return True
        body = int(model.body_parentid[body])
    return False


def _chains(model: mujoco.MjModel, one: int, other: int) -> tuple[list[int], list[int]]:
    """The joints that move a geom, and those that move the other, each from the geom inwards.

    Only the motion of one against the other matters. A plane, which has no end and so no longest
    lever, is taken to stand still: all joints between the two move the other geom.
    """
    chains = relative_joints(model, one, other)
    planes = [int(model.geom_type[geom]) == PLANE for geom in (one, other)]
    if planes == [True, False]:
        return [], chains[1] + chains[0][::-1]
    if planes == [False, True]:
        return chains[0] + chains[1][::-1], []
    return chains


def _rows(name: str, array: Array, width: int) -> Array:
    """As the kernel takes it, which would read memory behind rows that are too short."""
    rows = np.ascontiguousarray(float_array(name, array))
    if rows.ndim != 2 or rows.shape[1] != width:
        raise InvalidInput(
            f"{name}: expected a row for each configuration, shape (N, {width}), got {rows.shape}."
        )
    return rows

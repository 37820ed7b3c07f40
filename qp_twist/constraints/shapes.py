"""A model's geoms as the kernel takes them: distances at many configurations, rows of a step."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import mink
import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from qp_twist.checks import Array, Indices, float_array
from qp_twist.constraints.colliding_pairs import joints_above, relative_joints
from qp_twist.errors import InvalidInput
from qp_twist.kernel.clearance_kernel import (
    FIXED_TO_MOCAP,
    NO_MOCAP,
    Cell,
    changes,
    distances,
    first_below,
    gradients,
    least_distances,
    move_obstacles,
)
from qp_twist.kernel.clearance_rows import Braking, correct, lack_of, write_rows
from qp_twist.kernel.compiling import bound
from qp_twist.kernel.convex import MESH, PLANE
from qp_twist.kinematics import JointRanges

HORIZON = 0.2
"""Margin below which a pair has a row in a step, m."""
_EXACT = 1e-10
"""Room of the rows that hold a velocity, rad or m."""


class MovingShapes:
    """Geoms of some pairs, on the bodies of a model with hinges and slides.

    Distances and depths are those of :mod:`qp_twist.kernel.convex`.

    Attributes:
        cell: Them, as the kernel takes them in a step; queries work on copies, which are kept.
        has_moved: Whether mocap bodies were taken from MuJoCo's data.
    """

    def __init__(self, model: mujoco.MjModel, pairs: Indices) -> None:
        """Write the cell of pairs that :func:`check_shapes` has accepted."""
        self._model, self._pairs = model, pairs
        self._data: mujoco.MjData | None = None  # from which obstacles are taken
        self.has_moved = False
        geoms = np.unique(pairs)
        vertices = [_vertices(model, int(geom)) for geom in geoms]
        chains = [_chains(model, int(a), int(b)) for a, b in pairs]
        links = [joint for one, other in chains for joint in one + other]
        self.cell = Cell.empty(
            model.nbody, model.njnt, len(geoms), sum(map(len, vertices)), len(pairs), len(links)
        )
        self.cell.links[:] = links
        self._write_tree(geoms)
        self._write_shapes(geoms, vertices)
        self._write_pairs(geoms, chains)
        self._copies: list[Cell] = []  # with the obstacles where they are now
        self._codes: dict[Any, Any] = {}
        self._mocap = np.zeros((model.nmocap, 3)), np.zeros((model.nmocap, 4))
        self._move_obstacles = bound(move_obstacles, self.cell, *self._mocap, False)

    # ------------------------------------------------------------------ questions

    def distances(self, q: Array, enough: float) -> Array:
        """Signed distances (N, P) at q (N, nq), m; above ``enough`` lower bounds of them.

        Depths are always exact: the kernel takes touching shapes for farther than a negative
        ``enough``.
        """
        q = self.configurations(q)
        return self._of_pairs(distances, q, max(float(enough), 0.0))

    def first_below(self, q: Array, distance: float) -> Indices:
        """Index of the first pair nearer than ``distance`` at each configuration, or −1, (N,)."""
        q = self.configurations(q)
        found = np.zeros(len(q), dtype=np.int64)
        self._ask(first_below, q, float(distance), found)
        return found

    def gradients(self, q: Array, which: Indices) -> Array:
        """Derivatives (N, k, nv) of the distances of pairs ``which`` (N, k); 0 for the index −1."""
        q, which = self.configurations(q), np.ascontiguousarray(which, dtype=np.int64)
        found = np.zeros((*which.shape, self._model.nv))
        self._ask(gradients, q, which, found)
        return found

    def changes(self, q: Array, travel: Array) -> Array:
        """Bounds of the distances' variation on motions from q, m, (N, P)."""
        return self._of_pairs(changes, self.configurations(q), self._per_joint("travel", travel))

    def least(
        self, before: Array, after: Array, travel: Array, curve: Array | None, distance: float
    ) -> Array:
        """Lower bounds of the distances between two configurations, sharp below ``distance``."""
        before, after = self.configurations(before), self.configurations(after)
        travel = self._per_joint("travel", travel)
        curve = np.full_like(travel, np.inf) if curve is None else self._per_joint("curve", curve)
        return self._of_pairs(
            least_distances, before, after, travel, curve, max(float(distance), 0.0)
        )

    def take_mocap(self, data: mujoco.MjData) -> None:
        """Take the poses of mocap bodies, obstacles that move, from MuJoCo's data.

        They are expected to move on as they did since this was last called; how far they are from
        where they were expected now may be missing again.
        """
        if not self._model.nmocap:
            return
        if data is not self._data:
            self._data, self._mocap = data, (data.mocap_pos, data.mocap_quat)
        refused = self._move_obstacles(self.cell, *self._mocap, self.has_moved)
        if refused >= 0:  # nothing would be clear of it, nor near
            body = int(np.flatnonzero(self._model.body_mocapid == refused)[0])
            raise InvalidInput(
                f"mocap body {self._model.body(body).name!r}: expected a finite position and a "
                f"quaternion that is not 0, got {data.mocap_pos[refused].tolist()} and "
                f"{data.mocap_quat[refused].tolist()}; set data.mocap_pos and mocap_quat before "
                "the step."
            )
        self.has_moved, self._copies = True, []

    def configurations(self, q: Array) -> Array:
        """Configurations (N, nq) as the kernel takes them; NaN would be neither near nor clear."""
        rows = _rows("q", q, self._model.nq)
        if not math.isfinite(rows.sum()):
            raise InvalidInput("q: expected finite joint positions; it has NaN or infinite ones.")
        return rows

    def _per_joint(self, name: str, array: Array) -> Array:
        return _rows(name, array, self._model.nv)

    def _of_pairs(self, question: Any, q: Array, *arguments: Any) -> Array:
        """The answer of a kernel for each configuration and pair, (N, P)."""
        found = np.zeros((len(q), len(self._pairs)))
        self._ask(question, q, *arguments, found)
        return found

    def _ask(self, question: Any, *arguments: Any) -> None:
        """Call a kernel of the clearance on a copy of the cell that no other thread uses."""
        copies = self._copies
        try:
            cell = copies.pop()
        except IndexError:
            cell = self.cell.copy()
        code = self._codes.get(question)
        if code is None:
            code = self._codes[question] = bound(question, cell, *arguments)
        code(cell, *arguments)
        copies.append(cell)

    # ------------------------------------------------------------------ layout

    def _write_tree(self, geoms: Indices) -> None:
        """Write bodies and joints."""
        model, (bodies, joints, *_) = self._model, self.cell
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        bodies["parent"], bodies["offset"] = model.body_parentid, model.body_pos
        bodies["first"], bodies["joints"] = model.body_jntadr, model.body_jntnum
        bodies["mocap"] = np.where(model.body_mocapid >= 0, model.body_mocapid, NO_MOCAP)
        for body in range(1, model.nbody):  # parents come before their children
            mujoco.mju_quat2Mat(bodies["turned"][body], model.body_quat[body])
            on = bodies["mocap"][model.body_parentid[body]]
            if on != NO_MOCAP and model.body_jntnum[body] == 0:
                bodies["mocap"][body] = FIXED_TO_MOCAP
        for when in ("", "_now", "_then"):
            bodies[f"x{when}"], bodies[f"R{when}"] = data.xpos, data.xmat
        for geom in geoms:
            body = int(model.geom_bodyid[geom])
            while body > 0:
                bodies["moves"][body] = bool(joints_above(model, body))
                body = int(model.body_parentid[body])
        joints["slides"] = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        joints["own_axis"], joints["own_anchor"] = model.jnt_axis, model.jnt_pos
        joints["address"], joints["dof"] = model.jnt_qposadr, model.jnt_dofadr
        joints["reference"] = model.qpos0[model.jnt_qposadr]

    def _write_shapes(self, geoms: Indices, vertices: list[Array]) -> None:
        """Write the shapes, with balls and boxes around them."""
        model, shapes, first = self._model, self.cell.shapes, 0
        shapes["kind"], shapes["size"] = model.geom_type[geoms], model.geom_size[geoms]
        shapes["body"], shapes["at"] = model.geom_bodyid[geoms], model.geom_pos[geoms]
        shapes["center"], shapes["half"] = np.split(model.geom_aabb[geoms], 2, axis=1)
        shapes["ball"] = np.where(shapes["kind"] == PLANE, np.inf, model.geom_rbound[geoms])
        for k, (geom, of_mesh) in enumerate(zip(geoms, vertices, strict=True)):
            mujoco.mju_quat2Mat(shapes["about"][k], model.geom_quat[geom])
            if len(of_mesh):
                shapes["first"][k], shapes["last"][k] = first, first + len(of_mesh)
                self.cell.vertices[first : first + len(of_mesh)] = of_mesh
                first += len(of_mesh)
                lower, upper = of_mesh.min(axis=0), of_mesh.max(axis=0)
                center = 0.5 * (lower + upper)
                shapes["center"][k], shapes["half"][k] = center, 0.5 * (upper - lower)
                shapes["ball"][k] = np.linalg.norm(of_mesh - center, axis=1).max()

    def _write_pairs(self, geoms: Indices, chains: list[tuple[list[int], list[int]]]) -> None:
        """Write the pairs, with the joints that move A but not B, and vice versa."""
        pairs = self.cell.pairs
        pairs["one"], pairs["other"] = np.searchsorted(geoms, self._pairs).T
        lengths = np.array([(len(a), len(b)) for a, b in chains], dtype=int).reshape(-1, 2)
        pairs["last"] = np.cumsum(lengths.sum(axis=1))
        pairs["middle"] = pairs["last"] - lengths[:, 1]
        pairs["first"] = pairs["middle"] - lengths[:, 0]
        # Mocap bodies are children of the world.
        roots = self._model.body_rootid[self._model.geom_bodyid[geoms]]
        carried = self._model.body_mocapid[roots] >= 0
        pairs["obstacle"] = carried[pairs["one"]] | carried[pairs["other"]]


class ClearanceStep:
    """One clearance from step to step: its rows, and what a velocity lacks.

    Attributes:
        least: The least margin left if the joints brake and no obstacle moves, m.
        has_begun: Whether a step is being computed, possibly several times.
    """

    def __init__(self, shapes: MovingShapes, ranges: JointRanges) -> None:
        """Allocate the rows for ``shapes``."""
        nv, pairs = len(ranges.lower), len(shapes.cell.pairs)
        # Pairs and joints have rows; then come corrections, and those that hold a velocity.
        rows = 2 * pairs + 200 + 4 * nv
        self._shapes, self._state = shapes, Braking.empty(ranges.nq, nv, rows)
        self._state.lower[:], self._state.upper[:] = ranges.lower, ranges.upper
        self._state.hardest[:] = self._state.fastest[:] = np.inf
        self._limits: tuple[Array | None, Array | None] = None, None
        self._count, self.least, self.has_begun = 0, np.inf, False
        self._known = known = shapes.cell, self._state
        self._write_rows = bound(write_rows, *known, 1.0, 1.0, 1.0, 1.0, False)
        self._lack_of = bound(lack_of, *known, self._state.before, 1.0)
        self._correct = bound(correct, *known, self._state.before, 1.0, 0)

    def begin(
        self,
        configuration: mink.Configuration,
        velocity: Array | None = None,
        hardest: Array | None = None,
        fastest: Array | None = None,
    ) -> None:
        """Begin a step: its rows may be evaluated several times, its obstacles move once.

        ``velocity`` is that of the joints before it, rad/s or m/s, (nv,); ``hardest`` and
        ``fastest`` are their limits, rad/s² and rad/s or m/s² and m/s, (nv,), ∞ without, which are
        read when other arrays are passed. What the joints cannot come near has no row.
        """
        self._shapes.take_mocap(configuration.data)
        s, self._count, self.has_begun = self._state, -1, True
        if hardest is not self._limits[0] or fastest is not self._limits[1]:
            self._limits, s.before[:] = (hardest, fastest), 0.0
            s.hardest[:] = np.inf if hardest is None else hardest
            s.fastest[:] = np.inf if fastest is None else fastest
        if velocity is not None:
            s.before[:] = velocity

    def rows(
        self, q: Array, dt: float, distance: float, recovery_speed: float
    ) -> tuple[Array, Array, Indices]:
        """The rows G q̇ ≤ g at a configuration q (nq,), and corrections that have been added.

        They keep a distance, m, and let a pair that is too near return at a speed, m/s. Returned
        are G (k, nv) and g (k,), views that the next step overwrites, and the pair of each row.
        """
        s = self._state
        if self._count < 0:
            s.q[:] = q
            self._count, self.least = self._write_rows(
                *self._known, dt, distance, HORIZON, recovery_speed, self._shapes.has_moved
            )
        k = self._count
        return s.G[:k], s.g[:k], self.pairs

    @property
    def pairs(self) -> Indices:
        """The pair of each row, (k,)."""
        return self._state.pair[: self._count].copy()

    def lacks(self, velocity: Array, dt: float) -> float:
        """By how much a velocity (nv,) leads below what it may leave of the margins, m.

        With acceleration limits also how far it would, if the joints braked from then on.
        """
        lack: float = self._lack_of(*self._known, np.ascontiguousarray(velocity, float), dt)
        return lack

    def correct(self, velocity: Array, dt: float) -> bool:
        """Add rows of where a velocity leads that lacks something; whether there are any."""
        before, velocity = self._count, np.ascontiguousarray(velocity, float)
        self._count = self._correct(*self._known, velocity, dt, before)
        return self._count > before

    @property
    def braked(self) -> Array:
        """The hardest braking from the last velocity, rad/s or m/s, (nv,)."""
        return self._state.braked.copy()

    def hold(self, velocity: Array, dt: float) -> None:
        """Replace all rows by those that hold a velocity (nv,).

        It need not satisfy the others, which are linear, and with both there might be no step.
        """
        s, nv = self._state, len(velocity)
        self._count = count = 2 * nv
        s.G[:count] = np.vstack([np.eye(nv), -np.eye(nv)])
        s.g[:count] = np.concatenate([velocity, -velocity]) + _EXACT / dt
        s.pair[:count] = np.argmin(self._shapes.cell.pairs["worst"])


def _vertices(model: mujoco.MjModel, geom: int) -> Array:
    """The vertices of a mesh's convex hull in the geom's frame, m, (V, 3); none of others."""
    if int(model.geom_type[geom]) != MESH:
        return np.zeros((0, 3))
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices: Array = np.unique(model.mesh_vert[first : first + count].astype(float), axis=0)
    with contextlib.suppress(QhullError):  # flat
        vertices = vertices[ConvexHull(vertices).vertices]
    return vertices


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

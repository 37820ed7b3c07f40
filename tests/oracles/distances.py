"""Distances of the geoms of a MuJoCo model by coal, and by support functions.

The signed distance of two convex bodies A and B is the largest gap over all directions n,

    d = max over unit n of  min over b of n·b − max over a of n·a,

positive when they are apart, minus the depth of penetration when they are not. Every direction
therefore proves a lower bound of d, whoever found it, and where two points of the bodies are as
close as a direction's gap, both are exact. coal finds the direction of separated bodies. The
support functions, written here in one line per shape, referee it; where bodies penetrate they
search from many directions, since coal often returns a depth of round shapes that is not the least.
(python-fcl 0.7 is off by up to 1e-4 m for separated round shapes, and crashes on half-spaces.)
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import coal
import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

Array = npt.NDArray[np.float64]
Kind = mujoco.mjtGeom
TOLERANCE = 1e-9
"""Of coal's iterations, m."""
DIRECTIONS = 600
"""How many directions are tried where two geoms penetrate."""
STARTS, NEAR = 5, np.cos(0.2)
"""How many of the best directions are improved, and the cosine between two of them at most."""
ROUNDS, APART = 100, 0.02
"""Rounds of an improvement at most, and how far apart the shifted geoms are in it, m."""


def evenly(count: int) -> Array:
    """So many unit vectors, nearly evenly spread: a spiral, (count, 3)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


SPREAD = evenly(DIRECTIONS)


class Distance(NamedTuple):
    """A signed distance.

    Attributes:
        value: Negative by the depth of penetration, m.
        normal: Direction from the first geom to the second with this gap, (3,).
        points: Nearest points of the two, (2, 3), where they are apart; meaningless otherwise.
    """

    value: float
    normal: Array
    points: Array


def hull(model: mujoco.MjModel, geom: int) -> Array:
    """Vertices of a mesh geom's convex hull in the frame of the geom, (n, 3), by Qhull."""
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    return vertices[ConvexHull(vertices).vertices]


def coal_shape(model: mujoco.MjModel, geom: int) -> coal.CollisionGeometry:
    """A geom as a shape of coal, in the frame of the geom."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    match kind:
        case Kind.mjGEOM_PLANE:
            return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        case Kind.mjGEOM_SPHERE:
            return coal.Sphere(size[0])
        case Kind.mjGEOM_CAPSULE:
            return coal.Capsule(size[0], 2.0 * size[1])
        case Kind.mjGEOM_ELLIPSOID:
            return coal.Ellipsoid(*size)
        case Kind.mjGEOM_CYLINDER:
            return coal.Cylinder(size[0], 2.0 * size[1])
        case Kind.mjGEOM_BOX:
            return coal.Box(*(2.0 * size))
        case Kind.mjGEOM_MESH:
            vertices = hull(model, geom)
            points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
            points.extend(vertices)
            centre = vertices.mean(axis=0)
            for i, j, k in ConvexHull(vertices).simplices:
                a, b, c = vertices[[i, j, k]]
                outwards = np.cross(b - a, c - a) @ (a - centre) > 0.0
                triangles.append(coal.Triangle(*map(int, (i, j, k) if outwards else (i, k, j))))
            return coal.Convex(points, triangles)
    raise NotImplementedError(f"geom {geom} is of kind {kind}")


class Distances:
    """Distances of a model's geoms by coal, refereed by support functions."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self.shapes: dict[int, coal.CollisionGeometry] = {}
        self.vertices: dict[int, Array] = {}
        self.request = coal.DistanceRequest()
        self.request.gjk_tolerance = self.request.epa_tolerance = TOLERANCE
        self.request.gjk_max_iterations = self.request.epa_max_iterations = 1000
        self.request.enable_signed_distance = True

    def at(self, q: npt.ArrayLike) -> Distances:
        """The same, with the robot at q (nq,)."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        return self

    def pose(self, geom: int) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of a geom, m."""
        return self.data.geom_xmat[geom].reshape(3, 3), self.data.geom_xpos[geom]

    def support(self, geom: int, n: Array) -> Array:
        """Largest n·x of the points x of a geom, for directions n (..., 3).

        A plane is the half-space below it.
        """
        rotation, position = self.pose(geom)
        u = n @ rotation
        size = self.model.geom_size[geom]
        match self.model.geom_type[geom]:
            case Kind.mjGEOM_PLANE:
                up = (np.hypot(u[..., 0], u[..., 1]) < 1e-9) & (u[..., 2] > 0.0)
                reach = np.where(up, 0.0, np.inf)
            case Kind.mjGEOM_SPHERE:
                reach = size[0] * np.linalg.norm(u, axis=-1)
            case Kind.mjGEOM_CAPSULE:
                reach = size[0] * np.linalg.norm(u, axis=-1) + size[1] * abs(u[..., 2])
            case Kind.mjGEOM_ELLIPSOID:
                reach = np.linalg.norm(size * u, axis=-1)
            case Kind.mjGEOM_CYLINDER:
                reach = size[0] * np.hypot(u[..., 0], u[..., 1]) + size[1] * abs(u[..., 2])
            case Kind.mjGEOM_BOX:
                reach = abs(u) @ size
            case _:
                if geom not in self.vertices:
                    self.vertices[geom] = hull(self.model, geom)
                reach = (u @ self.vertices[geom].T).max(axis=-1)
        return np.asarray(reach + n @ position)

    def gap(self, first: int, second: int, n: Array) -> Array:
        """Gaps of two geoms along directions n (..., 3), from the first to the second, m.

        Lower bounds of their signed distance, whatever the direction.
        """
        n = n / np.linalg.norm(n, axis=-1, keepdims=True)
        return -self.support(first, n) - self.support(second, -n)

    def __call__(self, first: int, second: int) -> Distance:
        """Signed distance of two geoms where they are now."""
        for geom, other, sign in ((first, second, 1.0), (second, first, -1.0)):
            if self.model.geom_type[geom] == Kind.mjGEOM_PLANE:
                n = self.pose(geom)[0][:, 2]
                return Distance(float(self.gap(geom, other, n)), sign * n, np.full((2, 3), np.nan))
        found = self.by_coal(first, second)
        return found if found.value > 0.0 else self.deepest(first, second, found.normal)

    def by_coal(self, first: int, second: int, shift: Array | None = None) -> Distance:
        """What coal finds, with the second geom shifted (3,), m."""
        places = []
        for geom in (first, second):
            if geom not in self.shapes:
                self.shapes[geom] = coal_shape(self.model, geom)
            rotation, position = self.pose(geom)
            if shift is not None and geom == second:
                position = position + shift
            places += [self.shapes[geom], coal.Transform3s(rotation, position)]
        result = coal.DistanceResult()
        value = coal.distance(*places, self.request, result)
        points = np.array([result.getNearestPoint1(), result.getNearestPoint2()])
        return Distance(value, np.array(result.normal), points)

    def deepest(self, first: int, second: int, *more: Array) -> Distance:
        """Signed distance of two geoms that penetrate: the best direction of many, improved.

        With the second geom shifted apart by t n, the direction n' of its distance is the largest
        of gap(n') + t n·n'. Its gap is therefore at least that of n: repeated, it climbs.

        Args:
            first: The geom that the normal leaves.
            second: The geom that it enters.
            more: Directions to try besides, (3,).
        """
        axes = [a for geom in (first, second) for a in self.pose(geom)[0].T]
        given = [n for n in (*more, *axes, *np.negative(axes)) if np.isfinite(n).all() and n.any()]
        directions = np.vstack([SPREAD, given])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        gaps = self.gap(first, second, directions)
        best, normal = gaps.max(), directions[gaps.argmax()]
        starts: list[Array] = []
        for start in directions[np.argsort(-gaps)]:
            if len(starts) < STARTS and all(start @ other < NEAR for other in starts):
                starts.append(start)
        for n in starts:
            gap, climbed = float(self.gap(first, second, n)), n
            for _ in range(ROUNDS):
                found = self.by_coal(first, second, (APART - gap) * climbed)
                after = float(self.gap(first, second, found.normal))
                if not after > gap + 1e-12:
                    break
                gap, climbed = after, found.normal
            if gap > best:
                best, normal = gap, climbed
        return Distance(float(best), normal, np.full((2, 3), np.nan))

    def of(self, pairs: Iterable[tuple[int, int]]) -> Array:
        """Signed distances of pairs of geoms where they are now, (P,), m."""
        return np.array([self(int(a), int(b)).value for a, b in pairs])

    def along(self, q: Array, pairs: Array) -> Array:
        """Signed distances of pairs (P, 2) at configurations q (N, nq), (N, P), m."""
        return np.array([self.at(row).of(pairs) for row in q]).reshape(len(q), len(pairs))

"""Search placements of a workpiece at which a robot reaches the whole path."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import mink
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, placed
from qp_twist.paths.orientation import poses
from qp_twist.planning.path_rows import PathRows

_DRAWN = 6000
"""Number of random configurations, whose poses are candidates for the middle of the path."""
_PER_KIND = 240
"""Number of candidates of each kind of orientation that are followed along the path; half of them
are the most central ones."""
_LOOKED_AT = 13
"""Number of evenly spaced waypoints that have to be reachable."""
_LEANING = np.radians(30.0)
"""Largest orientation error of a random configuration that is corrected."""
_NEAR = 1.0
"""Largest motion of the configuration in the null space, rad or m."""
_UPRIGHT = 0.1
"""Smallest horizontal share of the directions' lengths for which a rotation about the vertical
matters."""
_PARALLEL = 1e-9
"""Sine of the angle below which directions count as parallel or opposite."""
_ROUND = 2
"""Number of decimals of a placement, m; its angles are whole degrees."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Pose of a toolpath's frame in the robot's world.

    Attributes:
        position: Position of its origin, m, (3,).
        rpy_deg: Its orientation, R = Rz Ry Rx, degrees, (3,).
        start: A configuration on the first waypoint from which Newton's method follows the path,
            (nv,).
    """

    position: Array
    rpy_deg: Array
    start: Array

    def of(self, path_task: PathTask) -> PathTask:
        """The task with its toolpath, so far in the world's origin and axes, at this placement."""
        rotation = mink.SO3.from_rpy_radians(*np.radians(self.rpy_deg))
        return placed(path_task, rotation, np.zeros(3), self.position)

    def __str__(self) -> str:
        """The placement in words."""
        to = ", ".join(f"{value:.4g}" for value in self.position)
        turned = ", ".join(f"{value:.4g}" for value in self.rpy_deg)
        return f"({to}) m" + (f", turned by rpy ({turned})°" if self.rpy_deg.any() else "")


@dataclass(frozen=True, eq=False)
class Placements:
    """Result of a search for placements.

    Attributes:
        found: Placements at which evenly spaced waypoints are reached one after the other, the most
            promising first.
        region: What was searched, in words.
    """

    found: tuple[Placement, ...]
    region: str


def placements(path_task: PathTask, progress: Callable[[], None]) -> Placements:
    """Placements of a path at which the robot reaches evenly spaced waypoints.

    Random configurations inside the limits are candidates for the middle waypoint: with the
    orientation of the file, with that rotated about the vertical, and with any other. From there
    Newton's method reaches the other waypoints one after the other, and centres the configuration
    in the null space. Placements above the floor, z = 0, come first; among them those with the
    file's orientation alternate with those rotated about the vertical. The toolpath of the task is
    in the world's origin and axes. ``progress`` is called from time to time.
    """
    ranges, rng = JointRanges.of(path_task.model), np.random.default_rng(0)
    drawn = ranges.random(_DRAWN, rng)
    q, R, kinds = _candidates(path_task, drawn, rng)
    if not len(q):
        return Placements((), "no place was found to be tried")
    rpy_deg = np.round(Rotation.from_matrix(R).as_euler("xyz", degrees=True)) + 0.0
    R = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()
    middle = len(path_task.waypoints) // 2
    _, positions = PathRows(path_task).chain.poses(q)
    at_middle = path_task.positions[middle]
    p = np.round(positions - R @ at_middle, _ROUND) + 0.0
    start, margin = _followed(path_task, ranges, q, R, p, progress)
    sunk = (R[:, 2] @ path_task.positions.T).min(axis=1) + p[:, 2] < 0.0
    # Above the floor first, then two of each kind in turn, the largest margins first.
    seen = Counter[tuple[bool, int]]()
    ranked = []
    for k in np.argsort(-margin, kind="stable")[: np.isfinite(margin).sum()]:
        group = bool(sunk[k]), int(kinds[k])
        ranked.append((group[0], seen[group] // 2, group[1], seen[group], k))
        seen[group] += 1
    found = [Placement(p[k], rpy_deg[k], start[k]) for *_, k in sorted(ranked)]
    centre = R @ at_middle + p
    tilt = float(np.degrees(np.arccos(np.clip(R[:, 2, 2], -1.0, 1.0)).max()))
    box = ", ".join(
        f"{axis} {low:.2g} … {high:.2g}"
        for axis, low, high in zip("xyz", centre.min(axis=0), centre.max(axis=0), strict=True)
    )
    region = (
        f"{len(q)} places tried, with the middle of the path within {box} m, turned about the "
        f"vertical by any angle and tilted by up to {tilt:.0f}°"
    )
    return Placements(tuple(found), region)


def _candidates(
    path_task: PathTask, drawn: Array, rng: np.random.Generator
) -> tuple[Array, Array, Indices]:
    """Configurations (K, nv) with rotations of the workpiece (K, 3, 3) and their kinds (K,).

    Kind 0: no rotation; 1: about the vertical; 2: any.
    """
    ranges, middle = JointRanges.of(path_task.model), len(path_task.waypoints) // 2
    chain = PathRows(path_task).chain
    rotations, positions = chain.poses(drawn)
    axes = _seen(path_task, middle)
    file = path_task.waypoints[middle].rotation().as_matrix() @ axes  # (3, s)
    robot = rotations @ axes  # (K, 3, s)
    upright = _about_vertical(file, robot, rng)
    turned = upright @ file
    tilted = _onto(turned, robot) @ upright
    none = np.broadcast_to(np.eye(3), upright.shape)
    off = [_apart(file[None], robot), _apart(turned, robot), np.zeros(len(drawn))]
    central = np.argsort(ranges.centering(drawn), kind="stable")
    # Most robots stand on the floor of their world, like their workpieces.
    offsets = path_task.positions - path_task.positions[middle]
    found: list[tuple[Array, Array, Indices]] = []
    for kind, (R, leaning) in enumerate(zip((none, upright, tilted), off, strict=True)):
        sunk = (R[:, 2] @ offsets.T).min(axis=1) + positions[:, 2] < 0.0
        for below, most in ((False, _PER_KIND), (True, _PER_KIND // 4)):
            fits = central[(leaning <= _LEANING)[central] & (sunk == below)[central]]
            rest = fits[most // 2 :]
            chosen = np.concatenate([fits[: most // 2], rng.permutation(rest)[: most // 2]])
            found.append((drawn[chosen], R[chosen], np.full(len(chosen), kind)))
    q, R, kinds = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return q, R, kinds


def _seen(path_task: PathTask, index: int) -> Array:
    """The axes of the frame whose directions the task fixes at a waypoint, columns (3, s)."""
    angular = path_task.in_force[index].angular
    if angular.kind is ProjectorKind.NONE:
        return np.zeros((3, 0))
    if angular.kind is ProjectorKind.PLANE and path_task.in_force[index].frame == "body":
        assert angular.axis is not None
        return angular.axis[:, None]
    return np.eye(3)


def _about_vertical(file: Array, robot: Array, rng: np.random.Generator) -> Array:
    """Rotations about the vertical (K, 3, 3) that bring directions (3, s) closest to (K, 3, s).

    Random if the directions do not depend on such a rotation.
    """
    sine = (file[0] * robot[:, 1] - file[1] * robot[:, 0]).sum(axis=-1)
    cosine = (file[0] * robot[:, 0] + file[1] * robot[:, 1]).sum(axis=-1)
    angle = np.arctan2(sine, cosine)
    blind = np.hypot(sine, cosine) <= _UPRIGHT
    angle[blind] = rng.uniform(-np.pi, np.pi, int(blind.sum()))
    return np.asarray(Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).as_matrix())


def _onto(a: Array, b: Array) -> Array:
    """Rotations (K, 3, 3) that map directions (K, 3, s) onto others with the same angles.

    For one direction the shortest rotation; none for opposite directions, where it is ambiguous.
    """
    if a.shape[2] > 1:
        return b @ a.transpose(0, 2, 1)
    if not a.shape[2]:
        return np.broadcast_to(np.eye(3), (len(b), 3, 3))
    normal = np.cross(a[:, :, 0], b[:, :, 0])
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, (a * b).sum(axis=(1, 2)))
    size = np.where(sine > _PARALLEL, angle / np.maximum(sine, _PARALLEL), 0.0)
    return np.asarray(Rotation.from_rotvec(size[:, None] * normal).as_matrix())


def _apart(a: Array, b: Array) -> Array:
    """Largest angle between directions (K, 3, s) and (K, 3, s), rad, (K,)."""
    cosines = np.clip((a * b).sum(axis=1), -1.0, 1.0)
    return np.asarray(np.arccos(cosines).max(axis=1, initial=0.0))


def _followed(
    path_task: PathTask,
    ranges: JointRanges,
    q: Array,
    R: Array,
    p: Array,
    progress: Callable[[], None],
) -> tuple[Array, Array]:
    """Newton's method from the middle to both ends of paths placed by R (K, 3, 3) and p (K, 3).

    All places at once: they are the waypoints of one path.

    Returns:
        Configurations on the first waypoints (K, nv), and the least margin along the path (K,), NaN
        if a waypoint was not reached inside the limits.
    """
    count = len(path_task.waypoints)
    spread = np.unique(np.linspace(0, count - 1, min(count, _LOOKED_AT)).round().astype(int))
    middle = int(np.searchsorted(spread, count // 2))
    spread[middle] = count // 2
    own = np.array([path_task.waypoints[k].rotation().as_matrix() for k in spread])
    rotations = (R[:, None] @ own).reshape(-1, 3, 3)
    positions = (path_task.positions[spread] @ R.transpose(0, 2, 1) + p[:, None]).reshape(-1, 3)
    held = path_task.in_force[count // 2]
    rows = PathRows(
        dataclasses.replace(
            path_task,
            waypoints=poses(positions, rotations),
            flipped_waypoints=None,
            projector=held,
            segments=(),
            durations=None,
            lines=None,
        )
    )
    first = np.arange(len(q)) * len(spread)
    begin, margin = _settled(rows, ranges, q, first + middle)
    start = begin
    for way in (range(middle + 1, len(spread)), range(middle - 1, -1, -1)):
        here = begin
        for index in way:
            progress()
            here, kept = _settled(rows, ranges, here, first + index)
            margin = np.minimum(margin, kept)
        start = here
    return start, margin


def _settled(rows: PathRows, ranges: JointRanges, q: Array, at: Indices) -> tuple[Array, Array]:
    """Correct onto waypoints and to the local minimum of z; margins (K,), NaN on failure."""
    corrected, arrived = rows.correct(q, at, iterations=20)
    margin = np.where(arrived, ranges.margins(corrected).min(axis=1, initial=np.inf), np.nan)
    central = rows.descend(corrected, at, ranges)
    better = ranges.margins(central).min(axis=1, initial=np.inf)
    # Without whole turns of a joint: the robot has to follow from one waypoint to the next.
    near = np.abs(central - corrected).max(axis=1) <= _NEAR
    take = arrived & near & (better > margin)
    found = np.where(take[:, None], central, corrected)
    margin = np.where(take, better, margin)
    return np.where(np.isfinite(found), found, q), np.where(margin >= 0.0, margin, np.nan)

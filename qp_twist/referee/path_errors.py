"""Errors of a joint motion along a path: at the waypoints, and proven bounds between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Constraint
from qp_twist.geometry import TwistProjector, resolved_twist_error
from qp_twist.kinematics import FramePair
from qp_twist.kinematics.frame import frame_id
from qp_twist.paths import PathTask, Tolerances
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.measures import Poses
from qp_twist.referee.subdivision import PROVEN, WORK, Proof, Track, columns_of

SAMPLES = 8
"""Points at which every motion is evaluated between consecutive rows or waypoints."""


class Deviation(NamedTuple):
    """A task error, or the violation of a band or constraint, m or rad."""

    unit: str
    """``"m"`` or ``"rad"``."""
    at: Array
    """At the waypoints, (N,)."""
    between: Array
    """Largest value found in each interval between two, (N − 1,)."""
    bound: Array
    """Proven bound for every instant of the interval, (N − 1,)."""

    def kept(self, tolerance: float) -> Mask:
        """Intervals in which a tolerance is proven to be kept, (N − 1,)."""
        return self.bound <= (1.0 + PROVEN) * tolerance


@dataclass(frozen=True, eq=False)
class PathErrors:
    """Errors of a motion in the rows of the task, and its violation of bands and constraints.

    Attributes:
        position: Task error, m.
        axis: Task error, rad.
        bands: Violation of each of the task's hard bands, then of each of its constraints.
        rate: Fastest progress found in each interval, less the progress that errors within the
            tolerances can explain, in shares of the interval per second, 1/s, (N − 1,).
        rate_kept: Whether the rate is proven not to exceed ``fastest``, (N − 1,).
    """

    position: Deviation
    axis: Deviation
    bands: tuple[Deviation, ...]
    rate: Array
    rate_kept: Mask

    def kept(self, position: float, axis: float) -> Mask:
        """Intervals in which the tolerances, m and rad, are proven to be kept, (N − 1,).

        Violations of bands and constraints are compared with the tolerance of their unit, since the
        path itself is not known better.
        """
        limits = {"m": position, "rad": axis}
        every = (self.position, self.axis, *self.bands)
        return np.asarray(np.all([of.kept(limits[of.unit]) for of in every], axis=0))


def path_errors(
    path_task: PathTask,
    motion: JointMotion,
    times: Array | None = None,
    *,
    s: Array | None = None,
    tolerances: tuple[float, float] | None = None,
    fastest: Array | None = None,
    samples: int = SAMPLES,
    work: int = WORK,
) -> PathErrors:
    r"""Measure a motion against the waypoints and against the path between them.

    Between two waypoints the path is the straight line of their positions and the shortest rotation
    of their orientations, both in the same proportion λ ∈ [0, 1]. The error is the distance from
    this path, not from the nominal pose at that time: a pose is compared with the path at the λ of
    least linear task error (angular if the positions do not differ). Only if the rows do not see
    the interval, λ is proportional to time.

    The bounds hold between the evaluated points: from one to the next the error is a vector that
    stays within max‖x″‖/8 of its chord (:class:`~qp_twist.referee.LeverArms`). Where that exceeds
    the tolerance, the stretch is halved, until it is decided or the work is used up.

    The rows are those of the projector in force at both waypoints; where it changes, those of the
    projector with fewer rows. On a joint move no path holds: errors and violations of bands, which
    refer to a path, count as 0 there and at its via points. Constraints hold there as well.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom of the task's robot, hinges and slides.
        times: Time of the motion at each waypoint, s, (N,), non-decreasing; if ``None`` the times
            of its rows, one per waypoint.
        s: Parameters of the path (``PathTask.at``) that stand for the waypoints, (N,); if
            ``None`` its first N waypoints.
        tolerances: Errors to be proven between the waypoints, m and rad; errors along the path
            within them do not count as progress. Without it the largest values are bounded to a
            tenth.
        fastest: Rate of progress to be proven, in shares of the interval per second, (N − 1,).
        samples: Points that are always evaluated between consecutive rows or waypoints.
        work: Largest number of further points.
    """
    when = motion.times if times is None else times
    path = path_task.at(np.arange(len(when), dtype=np.float64) if s is None else s)
    track = Track(path_task, motion, when, path, tolerances)
    q = motion.at(when).q
    R, p = poses_of(path_task, q)
    targets, moves = (path.rotations, path.positions), path.moves
    errors = task_errors(R, p, *targets, path.projectors)
    poses = Poses(q, FramePair(R, p, *targets))
    at = columns_of(
        [np.linalg.norm(errors.reshape(-1, 2, 3), axis=2), *(m.at(poses) for m in track.kept)],
        len(q),
    )
    at[np.ix_(~path.on_path, track.of_path)] = 0.0
    proof = Proof(track, work, moves[:, None] & track.of_path)
    left, right = proof.start(samples)
    if fastest is not None:
        fastest = np.where(moves, np.inf, fastest)
    rate, kept = proof.rates(left, right, fastest)
    rate[moves], kept[moves] = 0.0, fastest is not None
    # One column for each of position, axis, and the bands and constraints.
    parts = [
        np.hstack([values[:, :2], track.by_measure(values[:, 2:])]).T
        for values in (at, proof.found, proof.bound)
    ]
    units = ("m", "rad", *(measure.unit for measure in track.kept))
    position, axis, *bands = map(Deviation, units, *parts)
    return PathErrors(position, axis, tuple(bands), rate, kept)


def straight_errors(path_task: PathTask, q: Array, s: Array | None = None) -> PathErrors:
    """Errors of a motion that goes straight in the joints, from row to row of q (N, nv).

    The rows are at the first waypoints of the path, or at parameters s (N,) of it.

    Raises:
        InvalidInput: If there are fewer than two rows, one is not finite, or a joint that moves the
            frame is neither hinge nor slide.
    """
    return path_errors(path_task, JointMotion(np.arange(len(q), dtype=np.float64), q), s=s)


def sampled_errors(
    path_task: PathTask,
    motion: JointMotion,
    s: Array,
    pieces: Indices | None = None,
    samples: int = SAMPLES,
) -> tuple[Array, tuple[str, ...]]:
    """The errors of :func:`path_errors` at points of a motion, without a proof for the others.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom, with a row at each of the parameters.
        s: Parameters of the path, (N,).
        pieces: Index of the row before each interval that is evaluated, (K,); ``None``: all.
        samples: Points between two rows.

    Returns:
        Position error, axis error, and the violation of each hard band and each constraint, m or
        rad, (K, samples + 2, 2 + B), the first and the last at the rows; and the unit of each.
    """
    which = np.arange(len(s) - 1) if pieces is None else pieces
    shares, parts = np.linspace(0.0, 1.0, samples + 2), samples + 2
    begin, end = motion.times[which, None], motion.times[which + 1, None]
    times = ((1.0 - shares) * begin + shares * end).ravel()
    found, units = errors_at(path_task, motion, motion.times, s, np.repeat(which, parts), times)
    return found.reshape(len(which), parts, len(units)), units


def errors_at(
    path_task: PathTask, motion: JointMotion, when: Array, s: Array, piece: Indices, times: Array,
    row: Indices | None = None,
) -> tuple[Array, tuple[str, ...]]:  # fmt: skip
    """The same at given times of a motion that is ``when`` (N,) at the parameters s (N,).

    ``piece`` (K,) is the index of the parameter before each of the ``times`` (K,), s, ``row`` that
    of the row; ``None``: there is a row at each parameter.

    Returns:
        The errors, (K, 2 + B), and the unit of each.
    """
    path = path_task.at(s)
    track = Track(path_task, motion, when, path, None)
    values = track.points(piece, piece if row is None else row, times).values
    values = np.where(path.moves[piece, None] & track.of_path, 0.0, values)
    units = ("m", "rad", *(measure.unit for measure in track.kept))
    return np.hstack([values[:, :2], track.by_measure(values[:, 2:])]), units


class Outside(NamedTuple):
    """Violation of hard bands and constraints between consecutive waypoints."""

    found: Array
    """Largest violation found of each band's values and each margin, rad or m, (N − 1, k)."""
    bound: Array
    """Proven bound of the violation, (N − 1, k)."""
    share: Array
    """Share of each interval at which the largest was found, from 0 to 1, (N − 1,)."""


def constraints_left(path_task: PathTask, q: Array, tolerances: tuple[float, float]) -> Outside:
    """Proven violation of hard bands and constraints by straight motions of the joints.

    From row to row of q (N, nv), at the waypoints; tolerances are to be proven, m and rad, by the
    subdivision of :func:`path_errors`.
    """
    motion = JointMotion(np.arange(len(q), dtype=np.float64), q)
    path = path_task.at(motion.times)  # one row for each waypoint
    proof = Proof(Track(path_task, motion, motion.times, path, tolerances, task_errors=False))
    proof.start(0)
    return Outside(proof.found, proof.bound, proof.time - motion.times[:-1])


class Left(NamedTuple):
    """Violation of one constraint by a part of a motion."""

    found: float
    """Largest violation found, rad or m; 0 inside."""
    bound: float
    """Proven bound of the violation."""
    time: float
    """Time at which the largest was found, s."""
    name: str
    """Name of the margin that is violated most, or nearest to it then."""


def constraint_left(
    path_task: PathTask,
    constraint: Constraint,
    motion: JointMotion,
    begin: float,
    end: float,
    tolerances: Tolerances,
) -> Left:
    """Proven violation of a constraint between two times of a motion, s, where no path holds.

    The subdivision is that of :func:`path_errors`.
    """
    when, path = np.array([begin, end]), path_task.at(np.zeros(2))
    proven = tolerances.position, tolerances.axis
    proof = Proof(Track(path_task, motion, when, path, proven, task_errors=False, only=constraint))
    proof.start(0)
    time = float(proof.time[0])
    name = constraint.names[int(np.argmin(constraint.margins(motion.at([time]).q)[0]))]
    return Left(float(proof.found.max()), float(proof.bound.max()), time, name)


def poses_of(path_task: PathTask, q: Array) -> tuple[Array, Array]:
    """Rotations (K, 3, 3) and positions (K, 3) of the task's frame for joints q (K, nv)."""
    model = path_task.model
    data = mujoco.MjData(model)
    index = frame_id(model, path_task.frame_name, path_task.frame_type)
    rotation = getattr(data, mink.FRAME_TO_XMAT_ATTR[path_task.frame_type])[index]
    origin = getattr(data, mink.FRAME_TO_POS_ATTR[path_task.frame_type])[index]
    R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        R[k], p[k] = rotation.reshape(3, 3), origin
    return R, p


def task_errors(
    R: Array, p: Array, R_d: Array, p_d: Array, rows: Sequence[TwistProjector]
) -> Array:
    """Δt (K, 6) from K poses to K targets, each in the rows of its own projector."""
    errors = np.zeros((len(p), 6))
    ids = np.array([id(projector) for projector in rows])
    for projector in {id(t): t for t in rows}.values():
        here = ids == id(projector)
        errors[here] = resolved_twist_error(R[here], p[here], R_d[here], p_d[here], projector)[1]
    return errors

"""Starts that are found: the most central ones of every branch, each tried with a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, instance, whole_number
from qp_twist.errors import InvalidInput
from qp_twist.following.walk import walk
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, PathTask, check_method
from qp_twist.planning import CentralConfiguration, central_starts
from qp_twist.planning.path_rows import PathRows

_KEPT_M, _KEPT_RAD = 1e-5, 1e-5
"""A run ends where it is further off the path."""


@dataclass(frozen=True, eq=False)
class FoundStart:
    """A configuration on the first waypoint, inside the limits, and how far it leads.

    Attributes:
        q: The configuration, rad or m, (nq,).
        branch: Number of its branch of the closed-form inverse kinematics; ``None`` where the arm
            has none.
        margin: 1 − |θ − θ̄|/half-range of the joint that is nearest to a limit; ∞ without limits.
        z: ½‖W(θ̄ − θ)‖², the least nearby.
        sigma_min: Smallest singular value of the task rows UᵀJ; small near a singularity.
        reached: Waypoints that a run from it kept to the path, the first one counted; 0 where no
            run was run.
        waypoints: Of the path.
        stopped_by: What a run that was not completed was held by, where it is known.
    """

    q: Array
    branch: int | None
    margin: float
    z: float
    sigma_min: float
    reached: int
    waypoints: int
    stopped_by: str = ""

    @property
    def completed(self) -> bool:
        """Whether the run reached the last waypoint."""
        return self.reached == self.waypoints

    def __repr__(self) -> str:
        branch = "" if self.branch is None else f"branch {self.branch}, "
        return (
            f"FoundStart({branch}z {self.z:.4f}, margin {self.margin:.3g}, reaches {self.reached} "
            f"of {self.waypoints} waypoints)"
        )


def find_starts(
    path_task: PathTask,
    count: int = 8,
    *,
    method: str = DEFAULT_METHOD,
    runs: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> list[FoundStart]:
    """Where the robot may start: candidates on the first waypoint, the best first.

    Each candidate is inside the limits and hard bands and has less z than all configurations near
    it; they come from every branch of the closed-form inverse kinematics of an industrial arm, or
    from many random seeds on any other one (hinges and slides, with and without limits). A run from
    each of them says how far it leads: what is best at the first waypoint may end at a limit or a
    singularity later. Where joint speeds ask for it, it passes the path more slowly than the feed,
    as ``follow(…, slow_down=True)`` does. Those whose run is completed come first, by z; the others
    by how far they come.

    Args:
        path_task: The task, from :func:`~qp_twist.load_task`.
        count: Most candidates. The best of every branch come before second ones of a branch.
        method: Of the runs; one that holds the limits.
        runs: Whether to run them. Without, candidates are in the order of z.
        progress: Called with the number of candidates done and their number.

    Raises:
        InvalidInput: If an argument is wrong.
        NoStart: If no start is inside the limits; the message says which joint forbids it, or how
            far the waypoint is out of reach.

    Example:
        >>> import qp_twist as qt
        >>> best, *others = qt.find_starts(qt.load_task("planar_line"))
        >>> best.completed, round(best.z, 4)
        (True, 0.0778)
    """
    instance("find_starts(path_task, …)", path_task, PathTask)
    whole_number("find_starts(count=…)", count, at_least=1)
    found: list[FoundStart] = []
    candidates = _chosen(central_starts(path_task), count)
    for number, start in enumerate(_tried(path_task, candidates, check_method(method), runs)):
        found.append(start)
        if progress is not None:
            progress(number + 1, len(candidates))
    if not runs:
        return sorted(found, key=lambda start: start.z)
    return sorted(found, key=lambda start: (-start.reached, start.z))


def _chosen(found: Sequence[CentralConfiguration], count: int) -> list[CentralConfiguration]:
    """The best of every branch, then the second of every branch, and so on."""
    seen: dict[int | None, int] = {}
    places = []
    for candidate in found:  # in the order of z
        places.append(seen.get(candidate.branch, 0))
        seen[candidate.branch] = places[-1] + 1
    return [found[number] for number in np.argsort(places, kind="stable")[:count]]


def _tried(
    path_task: PathTask, candidates: Sequence[CentralConfiguration], method: str, runs: bool
) -> Iterator[FoundStart]:
    ranges, rows = JointRanges.of(path_task.model), PathRows(path_task)
    for candidate in candidates:
        reached, stopped_by = _run(path_task, candidate.q, method) if runs else (0, "")
        yield FoundStart(
            candidate.q,
            candidate.branch,
            float(ranges.margins(candidate.q).min(initial=np.inf)),
            candidate.z,
            float(rows.sigma_min(candidate.q[None], np.zeros(1, dtype=np.intp))[0]),
            reached,
            len(path_task.waypoints),
            stopped_by,
        )


def _run(path_task: PathTask, q: Array, method: str) -> tuple[int, str]:
    """How many waypoints a run from q keeps to the path, slowed down, and what ended it."""
    task = path_task.started_at(q)

    def lost(q: Array, position_error: float, axis_error: float) -> bool:
        return position_error > _KEPT_M or axis_error > _KEPT_RAD

    try:
        run = walk(task, method, task.settings(method), solver=COMPILED, slow_down=True, stop=lost)
    except InvalidInput as error:  # what T leaves free may still be outside a limit of the method
        return 0, str(error)
    off = (run.position_error > _KEPT_M) | (run.axis_error > _KEPT_RAD)
    if not off.any():
        return len(run.q), ""
    last = int(np.argmax(off))
    return last, run.failure or ", ".join(run.binding[last])

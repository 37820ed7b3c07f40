"""Search starts: the most central ones of every branch, each tested by a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, clause, instance, whole_number
from qp_twist.errors import InvalidInput
from qp_twist.following.stretches import follow_stretches
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, PathTask, check_method, without_via_points
from qp_twist.planning import central_starts
from qp_twist.planning.central import best_of_each_branch
from qp_twist.planning.path_rows import PathRows


@dataclass(frozen=True, eq=False)
class FoundStart:
    """A configuration on the first waypoint, inside the limits, and how far a run from it comes.

    Attributes:
        q: The configuration, rad or m, (nq,).
        branch: Index of its branch of the closed-form inverse kinematics; ``None`` without one.
        margin: 1 − |θ − θ̄|/half-range of the joint that is nearest to a limit; ∞ without limits.
        z: ½‖W(θ̄ − θ)‖², a local minimum.
        sigma_min: Smallest singular value of the task rows UᵀJ; small near a singularity.
        reached: Number of waypoints, the first included, that a run from it kept to the path; 0
            without a run.
        waypoints: Number of waypoints of the path.
        stopped_by: Active limits at the end of an incomplete run, or why it had no step, where
            known.
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
    """Search candidate starts on the first waypoint, the best first.

    Each candidate is a local minimum of z inside the limits and hard bands, from every branch of
    the closed-form inverse kinematics of an industrial arm, or from many random seeds on any other
    arm of hinges and slides. A run from each, slowed down where joint speeds require it, tests how
    far it comes. Candidates with a completed run come first, by z; then the others, by the length
    of their runs.

    Args:
        path_task: The task, from :func:`~qp_twist.load_task`.
        count: Largest number of candidates. The best of every branch precede second ones of a
            branch.
        method: Method of the runs; one with limits.
        runs: Whether to run them; if not, candidates are ordered by z.
        progress: Called with the number of candidates done and their number.

    Raises:
        InvalidInput: If an argument is wrong.
        NoStart: If no start is inside the limits; the message names the joint, or the distance by
            which the waypoint is out of reach.

    Example:
        >>> import qp_twist as qt
        >>> best, *others = qt.find_starts(qt.load_task("planar_line"))
        >>> best.completed, round(best.z, 4)
        (True, 0.0778)
    """
    instance("find_starts(path_task, …)", path_task, PathTask)
    whole_number("find_starts(count=…)", count, at_least=1)
    check_method(method)
    ranges, rows = JointRanges.of(path_task.model), PathRows(path_task)
    candidates = best_of_each_branch(central_starts(path_task), count)
    found: list[FoundStart] = []
    for number, one in enumerate(candidates, start=1):
        reached, stopped_by = _run(path_task, one.q, method) if runs else (0, "")
        margin = float(ranges.margins(one.q).min(initial=np.inf))
        sigma = float(rows.sigma_min(one.q[None], np.zeros(1, dtype=np.intp))[0])
        count_of = len(path_task.waypoints)
        found.append(
            FoundStart(one.q, one.branch, margin, one.z, sigma, reached, count_of, stopped_by)
        )
        if progress is not None:
            progress(number, len(candidates))
    return sorted(found, key=lambda start: (-start.reached, start.z))


def _run(path_task: PathTask, q: Array, method: str) -> tuple[int, str]:
    """Number of waypoints that a slowed-down run from q keeps to the path, and what ended it."""
    task = without_via_points(path_task).started_at(q)

    def lost(q: Array, position_error: float, axis_error: float) -> bool:
        return not task.tolerances.met(position_error, axis_error)

    try:
        run = follow_stretches(
            task, method, task.settings(method), solver=COMPILED, slow_down=True, stop=lost
        )
    except InvalidInput as error:  # directions free in T may still violate a limit of the method
        return 0, clause(error)
    return run.kept, run.held_by

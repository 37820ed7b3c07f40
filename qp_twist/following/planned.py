"""Plan a path: search over all branches, seeded also by step-by-step methods."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance
from qp_twist.errors import InvalidInput
from qp_twist.following.lift_offs import plan_with_fewest_cuts
from qp_twist.following.stretches import plan_stretches
from qp_twist.following.walk import walk
from qp_twist.kernel import COMPILED
from qp_twist.paths import DEFAULT_METHOD, PathTask, check_method, without_via_points
from qp_twist.planning import Plan, central_starts, make_plan, motion_limits
from qp_twist.planning.fewest_cuts import FewestCuts
from qp_twist.planning.levels import Progress
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.plan import stated_objective
from qp_twist.planning.problem import Problem
from qp_twist.planning.search import Trials
from qp_twist.planning.starts import corrected_start

SEED_METHODS = (DEFAULT_METHOD, "qp_minimum_norm")
"""Methods whose trajectories are further initial paths of the search."""
_ON_PATH_M, _ON_PATH_RAD = 1e-2, 1e-1
"""Trajectories with larger errors are not used."""


def plan(
    path_task: PathTask,
    objective: str | Mapping[str, float] = "centering",
    start: npt.ArrayLike | None = None,
    max_step_deg: float | None = None,
    *,
    joint_weights: Mapping[str, float] | None = None,
    cuts: Literal["fewest"] | None = None,
    slow_down: bool = False,
    seeds: Sequence[str] = SEED_METHODS,
    progress: Callable[[str, float], None] | None = None,
) -> Plan:
    r"""Plan the whole joint motion along a path, over all branches, turns and rolls.

    A step-by-step method may end at a limit that a global choice avoids. A plan considers the whole
    path: layers of all configurations at its waypoints, the best path through them, from coarse to
    fine, and quadratic programs over all waypoints at once that move this path off the grid:

    .. math::

        \min_{\mathbf q_1 \dots \mathbf q_N} f(\mathbf q_1 \dots \mathbf q_N) \quad\text{s.t.}\quad
        \mathbf U^T\Delta\mathbf t(\mathbf q_k) = 0,\quad
        \boldsymbol\theta_{min} \le \mathbf q_k \le \boldsymbol\theta_{max},\quad
        |\mathbf q_{k+1} - \mathbf q_k| \le \mathbf s_k,

    with **s** from the task's speed limits and feed and from ``max_step_deg``; 15° without either.
    Acceleration limits hold between the waypoints, too. Hard tolerance bands hold to 1e-9 at the
    waypoints and, with linearly interpolated joints, provably to 0.05° and 0.1 mm between them;
    soft bands are ignored. What a :class:`~qp_twist.Preference` of the task costs is added to f.
    Where the task has joint moves, each stretch between them is planned by
    itself, from another start if no joint move leads to its best plan; the plan has the rows of the
    joint moves, too (``plan.s``). Mean z is that of the waypoints, travel and margin count joint
    moves.

    Args:
        path_task: The task, from :func:`~qp_twist.load_task`.
        objective: ``"centering"``: the least mean z; ``"travel"``: the least sum of all joint
            displacements; ``"margin"``: the largest distance from the limits, in the worst joint at
            the worst waypoint; ``"time"``: the least time inside the speed limits, the feed a cap,
            so that it is slower where the joints cannot keep it; or weights of all but the margin,
            e.g. ``{"centering": 1.0, "travel": 0.001}``.
        start: The first configuration, (nq,), corrected onto the first waypoint; free if ``None``.
        max_step_deg: Largest displacement of a joint between two waypoints, degrees; a metre of a
            slide counts as a radian.
        joint_weights: Weights w of joints by name, e.g. ``{"rail": 0.1}``; 1 for the others:
            z = ½ Σ w ((θ − θ̄)/(θ_max − θ_min))², travel Σ w ‖Δθ‖.
        cuts: ``"fewest"``, which a task file may state, too: where no motion follows the whole path
            inside all limits and constraints, the tool lifts off, as rarely as possible, and a
            joint move leads to where it goes on. ``plan.cuts`` are the waypoints after which it
            does; ``plan.path_task`` has the retreats, joint moves and approaches.
        slow_down: Whether to plan a motion that is as little slower as possible where none keeps
            the feed; ``plan.certificate`` says where, and why there is none at the feed. With
            ``cuts="fewest"`` the tool lifts off instead, and the feed is kept.
        seeds: Methods whose trajectories are improved as well. They find passages near a
            singularity that are narrower than the grid.
        progress: Called with the current phase and its share done.

    Returns:
        A plan with its motion, value, bound and certificate. If there is no motion, nothing is
        raised; the certificate has the reason. After Ctrl-C the best one so far, with its bound,
        ``interrupted`` (Ctrl-C once more leaves the bound out).

    Raises:
        InvalidInput: If an argument is wrong, the start cannot be corrected or is outside a hard
            band, or a band has no width or contradicts a projector of the path.
        KeyboardInterrupt: On Ctrl-C before a motion is found.

    Example:
        >>> import qp_twist as qt
        >>> plan = qt.plan(qt.load_task("planar_line"))
        >>> print(f"mean z {plan.value:.4f}, bound {plan.bound:.4f}")
        mean z 0.0522, bound 0.0522
    """
    instance("plan(path_task, …)", path_task, PathTask)
    instance("plan(slow_down=…)", slow_down, bool)
    paced = _paced(path_task, cuts)
    path_task, first = _started(path_task, start)
    runs = _seed_runs(seeds, progress)

    def planned(task: PathTask, start: Array | None) -> Plan:
        return make_plan(
            task, objective, start, max_step_deg, runs, progress, joint_weights,
            paced=paced, slow_down=slow_down and paced,
        )  # fmt: skip

    goal = stated_objective(path_task, objective, joint_weights)
    if paced:
        return plan_stretches(path_task, goal, first, planned)
    search = _lift_off_search(path_task, goal, first, max_step_deg, progress)
    return plan_with_fewest_cuts(search, goal, planned)


def whole_plan(
    path_task: PathTask,
    objective: str | Mapping[str, float] = "centering",
    start: npt.ArrayLike | None = None,
    *,
    slow_down: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Plan:
    """As :func:`plan`, for searches of which the plan is a part: Ctrl-C ends them.

    Raises:
        InvalidInput: As :func:`plan`.
        KeyboardInterrupt: On Ctrl-C.
    """
    found = plan(path_task, objective, start, slow_down=slow_down, progress=progress)
    if found.interrupted:
        raise KeyboardInterrupt
    return found


def _paced(path_task: PathTask, cuts: str | None) -> bool:
    """Whether the speed may give way, since the tool may not lift off; ``cuts`` is checked."""
    if cuts not in (None, "fewest"):
        raise InvalidInput(f'plan(cuts=…): expected "fewest" or None, got {cuts!r}.')
    if cuts is None:
        return path_task.cuts != "fewest"
    if path_task.cuts not in ((), "fewest"):
        raise InvalidInput(
            f"plan(cuts={cuts!r}): {path_task.name} already lifts the tool off after waypoints "
            f"{', '.join(map(str, path_task.cuts))}; leave out its cuts, or the argument."
        )
    return False


def _started(path_task: PathTask, start: npt.ArrayLike | None) -> tuple[PathTask, Array | None]:
    """The task from a start, without via points, and the start corrected onto the path."""
    first: Array | None = None
    if start is not None:
        first = finite_array("start", start, (path_task.model.nq,))
        path_task = dataclasses.replace(path_task, start=first)
        first = corrected_start(path_task, path_task.waypoints[0], holds_limits=True)
    if path_task.preference is not None:
        path_task.preference.refuse_fixed(path_task.projectors)
    return without_via_points(path_task), first


def _lift_off_search(
    path_task: PathTask, goal: Objective, start: Array | None, max_step_deg: float | None,
    progress: Progress | None,
) -> FewestCuts:  # fmt: skip
    """The search of where the tool lifts off; it begins at a start (nv,) or at any."""
    rows, slow = PathRows(path_task), bool(goal.time)
    limits = motion_limits(path_task, goal.ranges, max_step_deg, rows.hard, slow_down=slow)
    problem = Problem(path_task, rows, limits, goal.along(path_task), start)
    return FewestCuts(problem, progress or (lambda what, share: None))


def _seed_runs(seeds: Sequence[str], progress: Progress | None) -> Trials:
    """The joint paths of methods on a task, from its own start or a given one (nv,)."""
    names = [check_method(name) for name in seeds]

    def runs(task: PathTask, start: Array | None) -> list[Array]:
        task = task if start is None else dataclasses.replace(task, start=start)
        found = [run for name in names if (run := _run(task, name, progress)) is not None]
        return found if start is None else [np.vstack([start[None], run[1:]]) for run in found]

    return runs


def _run(path_task: PathTask, method: str, progress: Progress | None) -> Array | None:
    """A method's joint path; ``None`` if it fails on the path."""

    def lost(q: Array, position_error: float, axis_error: float) -> bool:
        return position_error > _ON_PATH_M or axis_error > _ON_PATH_RAD

    def report(done: int) -> None:
        if progress is not None:
            progress(f"run of {method}", done / (len(path_task.waypoints) - 1))

    settings = path_task.settings(method)
    try:
        trajectory = walk(path_task, method, settings, solver=COMPILED, progress=report, stop=lost)
    except InvalidInput:  # the start cannot be corrected
        return None
    errors = trajectory.position_error[-1], trajectory.axis_error[-1]
    arrived = trajectory.diverged_at is None and not trajectory.failure
    return trajectory.q if arrived and not lost(trajectory.q[-1], *errors) else None


def with_start(
    path_task: PathTask,
    progress: Callable[[str, float], None] | None = None,
    *,
    slow_down: bool = False,
) -> PathTask:
    """The task with its start searched, if it leaves the start open.

    With ``start = "best"`` that of the best plan, which may ``slow_down``; with
    ``start = "central"`` the configuration of least z on the first waypoint.

    Raises:
        InvalidInput: If there is no plan, or no configuration inside the limits; with the reason.
    """
    if not path_task.best_start:
        return path_task
    if path_task.best_start == "central":
        start = central_starts(path_task)[0].q
    else:
        start = whole_plan(path_task, slow_down=slow_down, progress=progress).start
    return path_task.started_at(start)

"""Starts of a path: searched on the first waypoint, corrected onto it, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist import closed_form
from qp_twist.checks import Array, clause
from qp_twist.constraints import BindingLimit, Clearance, PositionLimit, refuse_never_apart
from qp_twist.control import Controller
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.paths import PathTask, twist_task
from qp_twist.planning.central import (
    CentralConfiguration,
    central_configurations,
    central_roadmap,
)
from qp_twist.planning.certificate import amount_of, empty_layers
from qp_twist.planning.levels import Level
from qp_twist.planning.path_rows import REACHED, PathRows

START_ITERATIONS = 200
"""Largest number of steps for the correction of a start onto the first waypoint."""
_AT_A_TIME = 300
"""Number of random configurations that are corrected onto the first waypoint."""
_TIMES = 10
_STALLED = 20
"""Number of steps after which a correction that comes no nearer is given up."""


class NoStart(InvalidInput):
    """No configuration on the first waypoint is inside the limits.

    Attributes:
        why: The reason.
    """

    def __init__(self, task: str, why: str) -> None:
        super().__init__(
            f"{task}: no start: {why}; move or turn the workpiece, or free more of the orientation."
        )
        self.why = why


# ---------------------------------------------------------------- found


def least_z_start(path_task: PathTask) -> Array | None:
    """The configuration (nv,) of least z on the first waypoint; ``None`` if none is inside limits.

    Over all branches, whole turns, and free coordinates of the task inside its hard bands.
    """
    found = central_configurations(path_task)
    return found[0].q if found else None


def central_starts(path_task: PathTask) -> list[CentralConfiguration]:
    """The most central configurations of the first waypoint, the best first.

    Raises:
        NoStart: If none is inside the limits; the message says why.
    """
    found = central_configurations(path_task)
    if not found:
        raise NoStart(path_task.name, what_forbids(path_task))
    return found


def random_start(path_task: PathTask, rng: np.random.Generator) -> Array | None:
    """A random configuration (nv,) on the first waypoint; ``None`` if none inside limits is found.

    Configurations drawn uniformly between the limits (hinges without: over a turn) are moved onto
    the waypoint and into its hard bands by Newton's method; the first that ends inside the limits,
    too, is returned.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    for _ in range(_TIMES):
        drawn = ranges.random(_AT_A_TIME, rng)
        q, arrived = rows.correct_inside(drawn, np.zeros(_AT_A_TIME, dtype=np.intp))
        q = q[arrived & ranges.inside(q)]
        if len(q):
            start: Array = q[0]
            return start
    return None


# ---------------------------------------------------------------- corrected


def corrected_start(
    path_task: PathTask,
    waypoint: mink.SE3,
    *,
    holds_limits: bool,
    task: TwistTask | None = None,
    start: Array | None = None,
) -> Array:
    """The start, corrected onto the first waypoint by minimum-norm steps in the rows of ``task``.

    The rows are the path's if ``task`` is ``None``, the start the task's if ``start`` is. A method
    that holds the limits also holds them here, and moves the start inside the constraints if
    possible; other methods ignore both.
    """
    task = twist_task(path_task, path_task.in_force[0]) if task is None else task
    start = path_task.start if start is None else start
    configuration = mink.Configuration(path_task.model, start)
    task.set_target(waypoint)
    controller: Controller | None = None
    if holds_limits:
        _refuse_never_apart(path_task, configuration.q)
        limits = [PositionLimit(path_task.model), *path_task.constraints]
        controller = Controller(path_task.model, [task], limits=limits)
        controller.smooth = False
    binding: Sequence[BindingLimit] = ()
    on_waypoint: Array | None = None
    least, nearest_at = np.inf, 0
    for iteration in range(START_ITERATIONS):
        left = missed_by(path_task, task, configuration)
        q: Array = configuration.q.copy()
        if on_waypoint is None and left <= 1.0:
            on_waypoint = q
        if holds_limits:
            left = max(left, _outside(path_task, configuration))
        if left <= 1.0:
            return q
        if left < 0.99 * least:
            least, nearest_at = left, iteration
        elif iteration - nearest_at >= _STALLED:
            break
        if controller is not None:
            step = controller.step(configuration, 1.0)
            dq, binding = step.velocity, step.binding
        else:
            state = task.state(configuration)
            twist = task.clamped(state.error)
            dq = closed_form.minimum_norm(state.jacobian, state.projector, twist)
        configuration.integrate_inplace(dq, 1.0)
    if on_waypoint is not None:  # outside a constraint; the run that follows reports it
        return on_waypoint
    linear, angular = np.linalg.norm(task.state(configuration).error.reshape(2, 3), axis=1)
    if linear <= REACHED.position and angular <= REACHED.axis:
        nearest_one: Array = configuration.q.copy()
        return nearest_one
    raise InvalidInput(
        f"follow: the start cannot be corrected onto the first waypoint; after "
        f"{iteration + 1} steps it is {linear:.3g} m and {np.degrees(angular):.3g} degrees away. "
        "Give a start nearer to it, or move the path into the robot's reach."
        + (f" In the way: {', '.join(map(str, binding))}." if binding else "")
        + (
            " A pair that may touch belongs into ignore of the clearance."
            if any(limit.kind == Clearance.kind for limit in binding)
            else ""
        )
    )


def _refuse_never_apart(path_task: PathTask, q: Array) -> None:
    """Refuse a clearance that no motion could keep; it is asked only if a start q violates it."""
    for clearance in path_task.clearances:
        if clearance.margins(q[None]).min() < 0.0:
            refuse_never_apart(path_task.name, clearance)


def reached(
    path_task: PathTask, task: TwistTask, configuration: mink.Configuration, *, held: bool
) -> bool:
    """Whether the task is met and, for methods that hold them (``held``), all constraints are kept.

    A constraint's rows are linear: curvature may violate it; the next iteration corrects that.
    """
    if missed_by(path_task, task, configuration) > 1.0:
        return False
    return not held or _outside(path_task, configuration) <= 1.0


def missed_by(path_task: PathTask, task: TwistTask, configuration: mink.Configuration) -> float:
    """The task error relative to its tolerance, the larger of the linear and the angular one."""
    errors = np.linalg.norm(task.state(configuration).error.reshape(2, 3), axis=1)
    return float((errors / path_task.iteration.tolerances).max())


def _outside(path_task: PathTask, configuration: mink.Configuration) -> float:
    """The largest violation of a constraint relative to its tolerance."""
    if not path_task.stated_constraints:
        return 0.0
    excess = float(path_task.constraint_excess(configuration.q[None]).max())
    return excess / path_task.tolerances.band


# ---------------------------------------------------------------- none


def what_forbids(path_task: PathTask, index: int = 0) -> str:
    """Why a waypoint, from 0, has no configuration, as the certificate of a plan says it."""
    roadmap = central_roadmap(path_task, PathRows(path_task))
    [layer] = roadmap.layers([index])
    level, ranges = Level(roadmap, [index], [layer]), roadmap.ranges
    if not level.has_gaps:
        return (
            f"waypoint {index + 1} has configurations inside the limits, but the search for the "
            "most central ones found none"
        )
    certificate = empty_layers(level, level.covers)
    text = clause(certificate)
    if certificate.kind == "limits":
        exceeded = " and ".join(
            f"{ranges.names[j]} by {amount_of(layer.beyond[j], ranges.units[j])}"
            for j in np.flatnonzero(layer.beyond > 0.0)
        )
        text += f"; the nearest one to fit exceeds {exceeded}"
    if any(name.startswith("clearance, ") for name in certificate.bands):
        text += " (a pair that may touch belongs into ignore of [clearance])"
    return text

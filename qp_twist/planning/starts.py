"""Starts of a path: searched on the first waypoint, corrected onto it, or why there is none.

:func:`qp_twist.find_starts` runs the whole path from each start.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mink
import numpy as np

from qp_twist import closed_form
from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, Clearance, PositionLimit, refuse_never_apart
from qp_twist.control import Controller
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.paths import PathTask, twist_task
from qp_twist.planning.central import CentralConfiguration, central_configurations
from qp_twist.planning.certificate import amount_of
from qp_twist.planning.layer import centred, forbidding_bands
from qp_twist.planning.path_rows import REACHED, PathRows

START_ITERATIONS = 200
"""Largest number of steps for the correction of a start onto the first waypoint."""
_AT_A_TIME = 300
"""Number of random configurations that are corrected onto the first waypoint."""
_TIMES = 10
_SEEDS = 300
_CLIPPED = 8
"""How often configurations are moved into the limits and corrected onto the waypoint again."""
_NAMED = 4
"""Largest number of constraints that a message names."""
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
    if task is None:
        task = twist_task(path_task, path_task.in_force[0])
    start = path_task.start if start is None else start
    configuration = mink.Configuration(path_task.model, start)
    task.set_target(waypoint)
    controller: Controller | None = None
    if holds_limits:
        _refuse_pairs_never_apart(path_task, configuration.q)
        limits = [PositionLimit(path_task.model), *path_task.constraints]
        controller = Controller(path_task.model, [task], limits=limits)
        controller.smooth = False
    binding: Sequence[BindingLimit] = ()
    on_waypoint: Array | None = None
    least, nearest_at = np.inf, 0
    for iteration in range(START_ITERATIONS):
        if on_waypoint is None and reached(path_task, task, configuration, held=False):
            on_waypoint = configuration.q.copy()
        if reached(path_task, task, configuration, held=holds_limits):
            q: Array = configuration.q.copy()
            return q
        left = _left_to_correct(path_task, task, configuration, held=holds_limits)
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
    error = task.state(configuration).error
    off = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    if off[0] <= REACHED.position and off[1] <= REACHED.axis:
        nearest_one: Array = configuration.q.copy()
        return nearest_one
    raise InvalidInput(
        f"follow: the start cannot be corrected onto the first waypoint; after "
        f"{iteration + 1} steps it is {off[0]:.3g} m and {np.degrees(off[1]):.3g} degrees away. "
        "Give a start nearer to it, or move the path into the robot's reach."
        + (f" In the way: {', '.join(map(str, binding))}." if binding else "")
        + (
            " A pair that may touch belongs into ignore of the clearance."
            if any(limit.kind == Clearance.kind for limit in binding)
            else ""
        )
    )


def reached(
    path_task: PathTask, task: TwistTask, configuration: mink.Configuration, *, held: bool
) -> bool:
    """Whether the task is met and, for methods that hold them (``held``), all constraints are kept.

    A constraint's rows are linear: curvature may violate it; the next iteration corrects that.
    """
    if missed_by(path_task, task, configuration) > 1.0:
        return False
    if not held or not path_task.stated_constraints:
        return True
    most = path_task.tolerances.band
    return bool(path_task.constraint_excess(configuration.q[None]).max() <= most)


def _left_to_correct(
    path_task: PathTask, task: TwistTask, configuration: mink.Configuration, *, held: bool
) -> float:
    """Task error, and with ``held`` violation of constraints, relative to their tolerances."""
    left = missed_by(path_task, task, configuration)
    if held and path_task.stated_constraints:
        excess = float(path_task.constraint_excess(configuration.q[None]).max())
        left = max(left, excess / path_task.tolerances.band)
    return left


def _refuse_pairs_never_apart(path_task: PathTask, q: Array) -> None:
    """Refuse a clearance that no motion could keep; it is asked only if a start q violates it.

    Raises:
        InvalidInput: If pairs are nearer than its distance in every random configuration.
    """
    for clearance in path_task.constraints:
        if not isinstance(clearance, Clearance) or not len(clearance.pairs):
            continue
        if clearance.margins(q[None]).min() >= 0.0:
            continue
        refuse_never_apart(path_task.name, clearance)


def missed_by(path_task: PathTask, task: TwistTask, configuration: mink.Configuration) -> float:
    """The task error relative to its tolerance, the larger of the linear and the angular one."""
    error = task.state(configuration).error
    errors = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    return float((np.array(errors) / path_task.iteration.tolerances).max())


# ---------------------------------------------------------------- none


def what_forbids(path_task: PathTask, index: int = 0) -> str:
    """Why a waypoint has no configuration: its distance, its orientation, limits, or bands.

    Based on random configurations, so distances are upper bounds.

    Args:
        path_task: The task; no configuration of the waypoint was found inside the limits.
        index: The waypoint, from 0.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    seeds = ranges.random(_SEEDS, np.random.default_rng(0))
    at = np.full(_SEEDS, index)
    q, arrived = rows.correct(seeds, at)
    where = f"waypoint {index + 1}"
    if not arrived.any():
        return _out_of_reach(path_task, q, index)
    q = _towards_limits(rows, ranges, centred(q[arrived], ranges), index)
    beyond = -ranges.room(q)
    nearest = int(np.argmin(beyond.max(axis=1)))
    over = np.flatnonzero(beyond[nearest] > 0.0)
    if not len(over):
        return _outside_bands(rows, q[ranges.inside(q)], index)
    always = np.flatnonzero((beyond > 0.0).all(axis=0))
    violations = " and ".join(
        f"{ranges.names[dof]} by {amount_of(beyond[nearest, dof], ranges.units[dof])}"
        for dof in over
    )
    text = (
        f"the arm reaches {where}, but in no configuration inside its limits; in the one that is "
        f"nearest to fit they are exceeded by {violations}"
    )
    if len(always):
        names = " and ".join(ranges.names[dof] for dof in always)
        text += f", and in every one that was found by {names}"
    return text


def _towards_limits(rows: PathRows, ranges: JointRanges, q: Array, index: int) -> Array:
    """Configurations q (K, nv) on a waypoint, and others nearer to the limits if none is inside."""
    last = q
    for _ in range(_CLIPPED):
        if not len(last) or ranges.inside(q).any():
            break
        clipped = np.clip(last, ranges.lower, ranges.upper)
        last, arrived = rows.correct(clipped, np.full(len(clipped), index))
        last = centred(last[arrived], ranges)
        q = np.vstack([q, last])
    return q


def _outside_bands(rows: PathRows, q: Array, index: int) -> str:
    """The sentence for a waypoint with configurations q (K, nv) inside the limits."""
    forbidding, margins = forbidding_bands(q, rows.hard, index) if rows.hard else ((), None)
    if margins is None or not forbidding:
        return (
            f"waypoint {index + 1} has configurations inside the limits, but the search for the "
            "most central ones found none"
        )
    outside = sorted(
        (margin, name, unit)
        for name, unit, margin in zip(rows.hard.names, rows.hard.units, margins, strict=True)
        if name in forbidding
    )
    violations = " and ".join(
        f"{name} by {amount_of(-margin, unit)}" for margin, name, unit in outside[:_NAMED]
    )
    if len(outside) > _NAMED:
        violations += f" and {len(outside) - _NAMED} more"
    what = "the hard tolerance bands" if rows.hard.bands else "the constraints"
    if rows.hard.bands and rows.hard.constraints:
        what += " and constraints"
    touching = any(name.startswith("clearance, ") for name in forbidding)
    hint = " (a pair that may touch belongs into ignore of [clearance])" if touching else ""
    return (
        f"no configuration that was found at waypoint {index + 1} is inside both the joint limits "
        f"and {what}; the nearest one inside the limits is outside {violations}{hint}"
    )


def _out_of_reach(path_task: PathTask, q: Array, index: int) -> str:
    """The sentence for a waypoint that no seed reached, from where the seeds ended.

    The distance ignores joint limits.
    """
    where = f"waypoint {index + 1}"
    position = path_task.waypoints[index].translation()
    shown = ", ".join(f"{value:.3g}" for value in position)
    if path_task.in_force[index].linear.kind is ProjectorKind.FULL:
        linear = TwistProjector(
            linear=path_task.operational.linear, angular=Projector.none(),
            frame=path_task.operational.frame,
        )  # fmt: skip
        alone = dataclasses.replace(path_task, projector=linear, segments=(), bands=())
        distance = PathRows(alone).nearest(index, q).linear
        if distance > REACHED.position:
            return (
                f"{where} at ({shown}) m is out of the arm's reach by {1e3 * distance:.3g} mm, "
                "joint limits not counted"
            )
    rows = PathRows(path_task)
    coupled = rows.couplings.names
    also = f" and {', '.join(coupled)} coupled" if coupled else ""
    return (
        f"the arm reaches the position ({shown}) m of {where}, but not with the orientation that "
        f"the task asks for{also}: the nearest configuration misses it by "
        f"{rows.nearest(index, q)}, joint limits not counted"
    )

"""Why no configuration of a waypoint is inside the limits, in a sentence with numbers."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.path import PathTask
from qp_twist.planning.drawn import random_configurations
from qp_twist.planning.layer import centred, forbidding_bands
from qp_twist.planning.path_rows import PathRows

_SEEDS = 300
_NEAR = 40
"""Seeds that are led on towards a waypoint that is out of reach."""
_STEPS = 200
_LONGEST = 0.3
"""Largest of these steps in any joint, rad or m."""
_REACHED = 1e-4
"""m."""
_DAMPING = 0.05
"""Of the steps towards what is out of reach, against a lever arm of a metre."""


def what_forbids(path_task: PathTask, index: int = 0) -> str:
    """What forbids a waypoint: its distance from the reach, its orientation, limits, or bands.

    Looked for from random configurations, so that distances are upper bounds.

    Args:
        path_task: The task, of whose waypoint no configuration was found inside the limits.
        index: The waypoint, from 0.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    seeds = random_configurations(ranges, _SEEDS, np.random.default_rng(0))
    at = np.full(_SEEDS, index)
    q, arrived = rows.correct(seeds, at)
    where = f"waypoint {index + 1}"
    if not arrived.any():
        return _out_of_reach(path_task, q, index)
    q = centred(q[arrived], ranges)
    beyond = -ranges.room(q)
    nearest = int(np.argmin(beyond.max(axis=1)))
    over = np.flatnonzero(beyond[nearest] > 0.0)
    if not len(over):
        return _outside_bands(rows, q[ranges.inside(q)], index)
    always = np.flatnonzero((beyond > 0.0).all(axis=0))
    said = " and ".join(
        f"{ranges.names[dof]} by {_amount(beyond[nearest, dof], bool(ranges.hinge[dof]))}"
        for dof in over
    )
    text = (
        f"the arm reaches {where}, but in no configuration inside its limits; in the one that is "
        f"nearest to fit they are exceeded by {said}"
    )
    if len(always):
        names = " and ".join(ranges.names[dof] for dof in always)
        text += f", and in every one that was found by {names}"
    return text


def _outside_bands(rows: PathRows, q: Array, index: int) -> str:
    """The sentence for a waypoint some of whose configurations q (K, nv) are inside the limits."""
    forbidding, margins = forbidding_bands(q, rows.hard, index)
    said = " and ".join(
        f"{name} by {_amount(-margin, unit == 'rad')}"
        for name, unit, margin in zip(rows.hard.names, rows.hard.units, margins, strict=True)
        if name in forbidding
    )
    what = "the hard tolerance bands" if rows.hard.bands else "the constraints"
    if rows.hard.bands and rows.hard.constraints:
        what += " and constraints"
    return (
        f"no configuration that was found at waypoint {index + 1} is inside both the joint limits "
        f"and {what}; the nearest one inside the limits is outside {said}"
    )


def _amount(beyond: float, hinge: bool) -> str:
    return f"{np.degrees(beyond):.3g}°" if hinge else f"{1e3 * beyond:.3g} mm"


def _out_of_reach(path_task: PathTask, q: Array, index: int) -> str:
    """The sentence for a waypoint that no seed arrived at, from where the seeds ended.

    The distance is that of the arm with every joint free.
    """
    where = f"waypoint {index + 1}"
    position = path_task.waypoints[index].translation()
    shown = ", ".join(f"{value:.3g}" for value in position)
    if path_task.in_force[index].linear.kind is ProjectorKind.FULL:
        chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        distance = _nearest(chain, q, position)
        if distance > _REACHED:
            return (
                f"{where} at ({shown}) m is out of the arm's reach by {1e3 * distance:.3g} mm, "
                "joint limits not counted"
            )
    coupled = PathRows(path_task).couplings.names
    also = f" and {', '.join(coupled)} coupled" if coupled else ""
    return (
        f"the arm reaches the position ({shown}) m of {where}, but not with the orientation that "
        f"the task asks for{also}, joint limits not counted"
    )


def _nearest(chain: SerialChain, q: Array, position: Array) -> float:
    """Smallest distance, m, of the frame's origin from a position, by damped steps from q."""
    apart = np.linalg.norm(position - chain.poses(q)[1], axis=1)
    q = q[np.argsort(apart, kind="stable")[:_NEAR]]
    for _ in range(_STEPS):
        _, origins, jacobians = chain.poses_and_jacobians(q)
        rows, errors = jacobians[:, :3], position - origins
        gram = rows @ rows.transpose(0, 2, 1) + _DAMPING**2 * np.eye(3)
        step = (rows.transpose(0, 2, 1) @ np.linalg.solve(gram, errors[:, :, None]))[:, :, 0]
        q = q + step * np.minimum(1.0, _LONGEST / np.abs(step).max(axis=1, initial=1e-12))[:, None]
    return float(np.linalg.norm(position - chain.poses(q)[1], axis=1).min())

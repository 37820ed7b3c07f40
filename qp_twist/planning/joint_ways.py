"""What each joint can reach along a path by itself: none winds about the base beyond its range."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import ProjectorKind, rotation_matrix
from qp_twist.kinematics import ParametrisedArm
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.layer import TURN, wound
from qp_twist.planning.levels import Grid, Levels
from qp_twist.planning.problem import Problem
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm, roll_axis
from qp_twist.planning.sentence import Sentence

_SPACING = np.radians(15.0)
"""Spacing of rolls, and of the path's samples by the motion that it asks of the joints at least.
Both only widen what counts as reached: by how far joints move from one sample to the next."""
_CELLS = 360
"""Cells of a joint's turn."""


def leaves_range(problem: Problem, levels: Levels) -> Certificate | None:
    """Why there is no motion, if a joint has no way along the path that stays in its range.

    On a path around its base an arm may have to turn a joint further and further. At each of some
    samples of the path the values of a joint, over all rolls and branches, are bands on its circle,
    and a continuous motion only goes on in a band that touches the one it comes from. Bands are
    followed with all whole turns inside the range. Speeds, other joints and constraints, which
    exclude more, are left out. Of joints whose range is less than a turn layers alone say as much.
    """
    task, ranges = problem.path_task, problem.limits.ranges
    width = np.where(ranges.hinge, ranges.upper - ranges.lower, 0.0)
    wide = np.flatnonzero(np.isfinite(width) & (width > TURN))
    arm = closed_form_arm(task) if len(wide) else None
    every = range(len(task.waypoints))
    if arm is None or not arm.labelled or not all(RollGrid.applies(task, k) for k in every):
        return None
    moved = levels.moved
    count = 2 + int(moved[-1] / _SPACING)
    s = np.interp(np.linspace(0.0, moved[-1], count), moved, np.arange(len(moved)))
    q = _solutions(problem, arm, s)
    if not np.isfinite(q).any(axis=(1, 2, 3)).all():  # out of reach, which layers tell
        return None
    for joint in wide.tolist():
        start = None if problem.start is None else problem.start[joint]
        ended = _ended(q[..., joint], ranges.lower[joint], ranges.upper[joint], start)
        if ended:
            at, name = int(np.ceil(s[ended])) + 1, ranges.names[joint]
            detail = Sentence(
                f"{name} is outside its range at waypoint ", at, ", wherever the motion starts"
            )
            grid = Grid(_SPACING, np.full(task.model.nv, TURN / _CELLS))
            return Certificate("limits", grid, (at,), (name,), detail=detail)
    return None


def _solutions(problem: Problem, arm: ParametrisedArm, s: Array) -> Array:
    """All branches at samples of the path and rolls, rad, (S, R, B, nv)."""
    path = problem.path_task.at(s)
    rolls = np.arange(0.0, TURN, _SPACING)
    axes = np.zeros((len(s), 3))
    for k, projector in enumerate(path.projectors):
        if projector.angular.kind is ProjectorKind.PLANE:
            axes[k] = roll_axis(projector, path.rotations[k])
    turned = path.rotations[:, None] @ rotation_matrix(rolls[:, None] * axes[:, None])
    places = np.repeat(path.positions, len(rolls), axis=0)
    found = arm.branches(turned.reshape(-1, 3, 3), places)
    return found.reshape(len(s), len(rolls), *found.shape[1:])


def _ended(q: Array, lower: float, upper: float, start: float | None) -> int:
    """The sample at which no value of a joint is left of q (S, R, B), NaN out of reach; 0: none."""
    cell = TURN / _CELLS
    turns = np.arange(int(np.floor(lower / cell)), int(np.ceil(upper / cell)) + 1)
    beside = np.abs(wound(np.roll(q, -1, axis=1) - q))
    after = np.abs(wound(q[1:] - q[:-1]))
    # Where a branch ends, its values run to those of another one in between.
    reached = np.isfinite(q)
    ends = np.isin(reached.mean(axis=1), (0.0, 1.0), invert=True).sum(axis=1) > 0
    changes = (reached[1:] ^ reached[:-1]).sum(axis=(1, 2)) > 0
    left: Mask | None = None if start is None else np.abs(turns * cell - start) <= cell
    for k in range(len(q)):
        circle = np.zeros(_CELLS, dtype=bool)
        circle[np.floor(q[k][reached[k]] / cell).astype(int) % _CELLS] = True
        widened = _widened(np.tile(circle, 3), np.nanmax(beside[k], initial=0.0) / cell)
        here = (widened[_CELLS : 2 * _CELLS] | ends[k])[turns % _CELLS]
        if left is None:
            left = here
        elif k:
            by = np.nanmax(after[k - 1], initial=0.0) / cell
            left = here & (changes[k - 1] | _widened(left, by))
        left = _connected(here, left)
        if not left.any():
            return k
    return 0


def _widened(cells: Mask, by: float) -> Mask:
    """Cells (C,) and all no further than some cells from them, one for rounding."""
    near = int(np.ceil(min(by, len(cells)))) + 1
    count = np.cumsum(np.concatenate([np.zeros(near + 1), cells, np.zeros(near)]))
    wide: Mask = count[2 * near + 1 :] > count[: -2 * near - 1]
    return wide


def _connected(cells: Mask, seeds: Mask) -> Mask:
    """Of runs of cells (C,) those with a seed."""
    run: Indices = np.cumsum(np.diff(cells, prepend=False))
    kept: Mask = cells & np.isin(run, run[cells & seeds])
    return kept

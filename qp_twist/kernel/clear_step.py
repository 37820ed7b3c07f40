"""A step whose only inequality rows are those of one clearance, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.clearance_kernel import read_cell
from qp_twist.kernel.clearance_rows import lack_of, read_apart, write_rows
from qp_twist.kernel.compiling import entry, plain
from qp_twist.kernel.edge_rows import EDGE
from qp_twist.kernel.live_step import at_the_edge, take_poses
from qp_twist.kernel.record import at_address, integers_at
from qp_twist.kernel.step_kernel import STEP, read_step, step
from qp_twist.kernel.verified_program import AT_THE_EDGE, INFEASIBLE, REFUSED

_OF_STEP, _OF_EDGE = 8 * STEP.head, 8 * EDGE.head
"""Bytes of a layout."""
NO_TABLE = -1
"""Status if the layout of the step is not known for its number of rows: nothing is computed."""


@plain
def _take_rows(g, w, s, dt):
    """Copy the rows G Δq ≤ h as G q̇ ≤ g."""
    for row in range(len(w.g)):
        for dof in range(len(w.x)):
            w.G[row, dof] = s.G[row, dof]
        w.g[row], g.rooms[row] = s.h[row] / dt, s.room[row] / dt


@entry
def clear_step(
    places, last, count, dt, asked, horizon, recovery, moves, use_secondary, twist_space,
    passed_over,
):  # fmt: skip
    """Compute the rows, a step, at the edge of the reach too, and how far it leads below margins.

    Args:
        places: Addresses of arrays, which are read faster than eleven arguments. Of the clearance
            (``ClearanceStep.arrays``): floats of the cell; the same with obstacles where they are
            expected after the step; its integers; floats of ``clearance_rows.Apart``; its integers.
            Of the step: floats and integers as of ``live_step``; its layouts by number of rows,
            which begin with 0 where they are not known. Of ``edge_rows.EdgeArrays``: floats,
            integers, layouts by number of rows. Then the largest number of rows with a layout.
        last: Number of rows of the last step.
        count: Number of rows if they are known already, else −1.
        dt: Length of the step, s.
        asked: The distance to keep, m.
        horizon: Margin from which on a pair has no row, m.
        recovery: Speed at which a pair that is too near is moved apart, m/s.
        moves: Whether an obstacle moves.
        use_secondary: Whether the secondary acts.
        twist_space: ``None`` for the joint-space cost.
        passed_over: ψ of the last step.

    Returns:
        The status of ``step_kernel.step`` or ``edge_step``, or ``NO_TABLE``; whether it is of the
        latter; ψ of this step; whether less than b is asked of a direction; the number of rows;
        and what the velocity lacks, m, NaN if there is none.
    """
    cell, table = integers_at(places[2], 1), integers_at(places[4], 1)
    before = read_cell(at_address(places[0], 1), cell, cell)
    after = read_cell(at_address(places[1], 1), cell, cell)
    s = read_apart(at_address(places[3], 1), table, table)
    floats, integers = at_address(places[5], 1), integers_at(places[6], 1)
    # Inputs other than the rows are in the same place for any number of rows.
    qpos = at_address(read_step(floats, integers, integers).inputs.sources[0], len(s.q))
    if count < 0:
        for i in range(len(s.q)):
            s.q[i] = qpos[i]
        count = write_rows(before, after, s, dt, asked, horizon, recovery, moves)
    if count > places[11]:
        return NO_TABLE, False, 0.0, False, count, math.nan
    layout = integers_at(places[7] + count * _OF_STEP, 1)
    if layout[0] == 0:
        return NO_TABLE, False, 0.0, False, count, math.nan
    made = read_step(floats, integers, layout)
    g, w = made.inputs, made.program
    if count != last:
        w.active_count[0] = 0
    _take_rows(g, w, s, dt)
    take_poses(g)
    status, passed, fades = step(g, w, qpos, dt, use_secondary, twist_space), 0.0, False
    unsolved = status in (AT_THE_EDGE, INFEASIBLE)
    at_edge = unsolved and g.settings.smooth > 0.0 and len(g.ends) == 1
    if at_edge:
        status, passed, fades = at_the_edge(
            made, at_address(places[8], 1), integers_at(places[9], 1),
            integers_at(places[10] + count * _OF_EDGE, 1), qpos, dt, use_secondary, twist_space,
            status == INFEASIBLE, passed_over,
        )  # fmt: skip
    lack = math.nan
    if status != REFUSED and (at_edge or not unsolved):
        lack = lack_of(after, s, w.x, dt, asked)
    return status, at_edge, passed, fades, count, lack

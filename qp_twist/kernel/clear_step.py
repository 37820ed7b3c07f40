"""A step whose only inequality rows are those of one clearance, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.clearance_kernel import read_cell
from qp_twist.kernel.clearance_rows import lack_of, read_apart, write_rows
from qp_twist.kernel.compiling import entry, plain
from qp_twist.kernel.live_step import at_the_edge, take_poses
from qp_twist.kernel.record import at_address
from qp_twist.kernel.step_kernel import read_step, step
from qp_twist.kernel.verified_program import AT_THE_EDGE, INFEASIBLE, REFUSED

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
    now, then, cell, apart, apart_table, floats, integers, tables, edge, edge_integers, edge_tables,
    last, count, dt, asked, horizon, recovery, moves, use_secondary, twist_space, passed_over,
):  # fmt: skip
    """Compute the rows, a step, at the edge of the reach too, and how far it leads below margins.

    Args:
        now: Floats of the cell, as of ``clearance_rows.rows_apart``.
        then: The same, with obstacles where they are expected after the step.
        cell: Its integers.
        apart: Floats of ``clearance_rows.Apart``.
        apart_table: Its integers.
        floats: Floats of the step, as of ``live_step``.
        integers: Its integers.
        tables: Layouts of the step by number of rows; they begin with 0 where they are not known.
        edge: Floats of ``edge_rows.EdgeArrays``.
        edge_integers: Its integers.
        edge_tables: Its layouts by number of rows.
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
    s = read_apart(apart, apart_table, apart_table)
    before, after = read_cell(now, cell, cell), read_cell(then, cell, cell)
    # Inputs other than the rows are in the same place for any number of rows.
    qpos = at_address(read_step(floats, integers, integers).inputs.sources[0], len(s.q))
    if count < 0:
        for i in range(len(s.q)):
            s.q[i] = qpos[i]
        count = write_rows(before, after, s, dt, asked, horizon, recovery, moves)
    if count >= len(tables) or tables[count, 0] == 0:
        return NO_TABLE, False, 0.0, False, count, math.nan
    made = read_step(floats, integers, tables[count])
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
            made, edge, edge_integers, edge_tables[count], qpos, dt, use_secondary, twist_space,
            status == INFEASIBLE, passed_over,
        )  # fmt: skip
    lack = math.nan
    if status != REFUSED and (at_edge or not unsolved):
        lack = lack_of(after, s, w.x, dt, asked)
    return status, at_edge, passed, fades, count, lack

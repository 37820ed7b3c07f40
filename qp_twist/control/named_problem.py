"""A step's program for any solver of qpsolvers, with the names of its rows."""

from __future__ import annotations

import qpsolvers

from qp_twist.control.mink_costs import name_of
from qp_twist.control.posing import Posed


class NamedProblem(qpsolvers.Problem):
    r"""min ½ xᵀP x + qᵀx  subject to  A x = b,  G x ≤ h,  lb ≤ x ≤ ub,  as qpsolvers has it.

    Attributes:
        unknowns: Names of x: the joints, whose velocities they are, then slacks of soft bands.
        equalities: Names of the rows of A.
        inequalities: Names of the rows of G.
    """

    def __init__(self, posed: Posed) -> None:
        """Take the arrays of a step, and name them."""
        p, bands = posed.problem, posed.problem.n - len(posed.limits.lower)
        super().__init__(p.H, p.c, p.G, p.g, p.A, p.b, p.lower, p.upper)
        rows = [rows for level in posed.levels for rows in level.tasks]
        self.unknowns = (*posed.limits.names, *(f"slack {i + 1}" for i in range(bands)))
        self.equalities = tuple(
            f"{name_of(task)} row {i + 1}"
            for task, (A, _) in zip(posed.tasks, rows, strict=True)
            for i in range(len(A))
        )
        self.inequalities = tuple(
            f"{name} ({kind})" for source in posed.sources for name, kind in source.names
        )

"""A step from a program that others have stated to a verified joint velocity, compiled."""

from __future__ import annotations

from qp_twist.fast.compiling import plain
from qp_twist.fast.dual_active_set import cholesky_inverse
from qp_twist.fast.reduced_program import reduced_program
from qp_twist.fast.step_arrays import program_at
from qp_twist.fast.step_kernel import (
    DONE,
    REFUSED,
    _excess_of_dense,
    _into_the_box,
    _well_conditioned,
)
from qp_twist.fast.step_layout import header


@plain
def program_step(floats, integers, ends, active, threshold, tolerances):
    """Solve and verify the program that lies in ``floats`` as ``step_arrays.Program`` says.

    H is dense, and positive definite.

    Args:
        floats: The program, then the workspace.
        integers: ``step_layout.Sizes``, then the active set from ``active`` on.
        ends: Where the rows of each level end, (1,): there is one.
        active: First entry of the active set.
        threshold: Singular value of the equality rows below which they are left to the reference.
        tolerances: Of the verification, (6,).

    Returns:
        ``DONE``, or ``REFUSED`` for whatever is not a plain step inside all limits.
    """
    w = program_at(floats, 0, integers, active, header(integers))
    for i in range(len(w.x)):
        if not w.lower[i] <= w.upper[i]:
            return REFUSED
    if not (_well_conditioned(w.A, ends, threshold, w.R, w.J) and cholesky_inverse(w.dense, w.J)):
        return REFUSED
    if not (reduced_program(w) and _into_the_box(w.x, w.lower, w.upper)):
        return REFUSED
    return DONE if _excess_of_dense(w, tolerances, w.root, w.line) <= 1.0 else REFUSED

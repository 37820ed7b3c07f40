"""A step from a program that others have stated to a verified joint velocity, compiled."""

from __future__ import annotations

from qp_twist.fast.compiling import plain
from qp_twist.fast.dual_active_set import cholesky_inverse
from qp_twist.fast.step_record import HEADER, read_program, read_sizes
from qp_twist.fast.verified_program import REFUSED, solved_program, well_conditioned


@plain
def program_step(floats, integers, ends, threshold, tolerances):
    """Solve and verify the program that lies in ``floats`` as ``step_record.Program`` says.

    H is dense, and positive definite.

    Args:
        floats: The program and its workspace.
        integers: The sizes, then the program's integers.
        ends: Where the rows of each level end, (1,): there is one.
        threshold: Singular value of the equality rows below which they are left to the reference.
        tolerances: Of the verification.

    Returns:
        As ``step_kernel.verified_velocity``.
    """
    w, _, _ = read_program(floats, 0, integers, HEADER, read_sizes(integers))
    for i in range(len(w.x)):
        if not w.lower[i] <= w.upper[i]:
            return REFUSED
    if not (well_conditioned(w.A, ends, threshold, w.R, w.J) and cholesky_inverse(w.dense, w.J)):
        return REFUSED
    return solved_program(w, False, tolerances)

"""Numbers from one array to another, compiled.

With a slice on the left of =, numba compiles the sentences that name its shape, too: one to two
seconds for each kind of array.
"""

from __future__ import annotations

from qp_twist.kernel.compiling import plain


@plain
def put(values, into):
    """Write (n,) to the first entries of an array."""
    for i in range(len(values)):
        into[i] = values[i]


@plain
def put_rows(values, into):
    """Write (m, n) to the first rows and columns of an array."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            into[i, k] = values[i, k]

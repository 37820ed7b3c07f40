"""How the kernels are compiled.

Machine code is kept beside the sources, or where numba may; where it may nowhere, it is made anew
in every process. It is made anew where the file of a kernel has changed, not
where only that of a kernel which it calls has: whoever works on them removes ``__pycache__``.
"""

from __future__ import annotations

from typing import Any

_REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order, by as many lanes as there are. NaN and infinity stay what they
are: comparisons rely on them."""


def _by_numba(**options: Any) -> Any:
    from numba import njit

    def compiled(function: Any) -> Any:
        settings: Any = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED} | options
        try:
            return njit(cache=True, **settings)(function)
        except RuntimeError:  # there is no folder to keep machine code in
            return njit(**settings)(function)

    return compiled


kernel: Any = _by_numba(_nrt=True)
"""For what makes arrays."""
plain: Any = _by_numba(_nrt=False)
"""For all other kernels. They make no arrays, and what they return are views without an owner
(``views``), so that nothing has to be counted: counting the references to ten small arrays takes
longer than a matrix product of theirs."""
part: Any = _by_numba(_nrt=False, inline="always")
"""For a piece of a long kernel, compiled as if it were written there. A kernel is optimised again
within every kernel that calls it, so that a long chain of calls takes long to compile."""

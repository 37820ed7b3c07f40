"""How the kernels are compiled.

Machine code is kept on disk and belongs to the contents of all files of this folder
(:mod:`~qp_twist.fast.code_cache`); where it can be kept nowhere, every process compiles for itself.
"""

from __future__ import annotations

import contextlib
from typing import Any

_REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order, by as many lanes as there are. NaN and infinity stay what they
are: comparisons rely on them."""


def _by_numba(**options: Any) -> Any:
    from numba import njit

    from qp_twist.fast.code_cache import KernelCache

    def compiled(function: Any) -> Any:
        settings: Any = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED} | options
        dispatcher = njit(**settings)(function)
        # No folder to keep machine code in, or no sources to tell which code it is: none is kept.
        with contextlib.suppress(RuntimeError):
            dispatcher._cache = KernelCache(function)  # what njit(cache=True) does with its own
        return dispatcher

    return compiled


kernel: Any = _by_numba(_nrt=True)
"""For what makes arrays."""
entry: Any = _by_numba(_nrt=False)
"""For what is called from Python and makes no arrays."""
plain: Any = _by_numba(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""For what only kernels call. They make no arrays, and what they return are views without an owner
(``views``), so that nothing has to be counted: counting the references to ten small arrays takes
longer than a matrix product of theirs. To make each of them callable from Python, too, would take a
third of the time to compile a step."""
part: Any = _by_numba(_nrt=False, inline="always")
"""For a piece of a long kernel, compiled as if it were written there. A kernel is optimised again
within every kernel that calls it, so that a long chain of calls takes long to compile."""

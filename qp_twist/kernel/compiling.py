"""How the kernels are compiled.

Machine code is kept on disk and belongs to the contents of all files of this folder
(:mod:`~qp_twist.kernel.code_cache`); where it can be kept nowhere, every process compiles for
itself.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable
from typing import Any

from numba import njit

from qp_twist.kernel.code_cache import KernelCache

_REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be taken in any order, by as many lanes as there are. NaN and infinity stay what they
are: comparisons rely on them."""
_RARELY = 1_000_000
"""Objects between two looks for garbage. numba makes millions that stay; with Python's 700 a
quarter of the time to compile a step goes into looking at them."""


def _by_numba(*, apart: bool = False, **options: Any) -> Any:
    def compiled(function: Any) -> Any:
        settings: Any = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED} | options
        dispatcher: Any = njit(**settings)(function)
        dispatcher._compiler.compile = _without_looking_for_garbage(dispatcher._compiler.compile)
        # No folder to keep machine code in, or no sources to tell which code it is: none is kept.
        with contextlib.suppress(RuntimeError):
            # What njit(cache=True) does with its own.
            dispatcher._cache = KernelCache(function, apart=apart)
        return dispatcher

    return compiled


def _without_looking_for_garbage(compile_: Callable[..., Any]) -> Callable[..., Any]:
    def calm(*arguments: Any) -> Any:
        usual = gc.get_threshold()
        gc.set_threshold(max(usual[0], _RARELY) if usual[0] else 0, *usual[1:])
        try:
            return compile_(*arguments)
        finally:
            gc.set_threshold(*usual)

    return calm


kernel: Any = _by_numba(_nrt=True)
"""For what makes arrays."""
entry: Any = _by_numba(_nrt=False)
"""For what is called from Python and makes no arrays."""
plain: Any = _by_numba(
    apart=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)  # fmt: skip
"""For what only kernels call. They make no arrays, and what they return are views without an owner
(``record``), so that nothing has to be counted: counting the references to ten small arrays takes
longer than a matrix product of theirs. To make each of them callable from Python, too, would take a
third of the time to compile a step. Each is compiled once, by itself: see ``code_cache``."""
part: Any = _by_numba(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""For what is small and called in a loop: it is compiled, and optimised, within every kernel that
calls it."""

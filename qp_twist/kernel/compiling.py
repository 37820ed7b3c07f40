"""How the kernels are compiled.

Machine code is cached on disk, keyed by the contents of all files of this folder
(:mod:`~qp_twist.kernel.code_cache`). If no cache folder is writable, every process compiles anew.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable
from typing import Any

from numba import njit, typeof
from numba.core import types

from qp_twist.kernel.code_cache import KernelCache

_REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be reordered and vectorised. NaN and infinity keep their meaning: comparisons rely on
them. But ``math.isfinite`` of a sum is true even for NaN: it subtracts the sum from itself."""
_RARELY = 1_000_000
"""Threshold of the garbage collector while compiling. numba allocates millions of objects that stay
alive; with Python's default of 700, a quarter of the compilation time is garbage collection."""


def _by_numba(*, apart: bool = False, **options: Any) -> Any:
    def compiled(function: Any) -> Any:
        settings: Any = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED} | options
        dispatcher: Any = njit(**settings)(function)
        dispatcher._compiler.compile = _without_looking_for_garbage(dispatcher._compiler.compile)
        dispatcher.get_call_template = _of_any_number(dispatcher.get_call_template)
        # No writable folder, or no sources to compute the key from: machine code is not cached.
        with contextlib.suppress(RuntimeError):
            # As njit(cache=True) does with its own cache.
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


def _of_any_number(template: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that another one calls: one for all constants, not one for 0 and one for 1."""

    def called(arguments: Any, names: Any) -> Any:
        return template(tuple(map(types.unliteral, arguments)), names)

    return called


kernel: Any = _by_numba(_nrt=True)
"""Decorator of functions that allocate arrays."""
entry: Any = _by_numba(_nrt=False)
"""Decorator of functions that are called from Python and allocate no arrays."""
plain: Any = _by_numba(
    apart=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)  # fmt: skip
"""Decorator of functions that only kernels call. They allocate no arrays and return views without
an owner (``record``), so numba does not count references: for ten small arrays that takes longer
than a matrix product. They cannot be called from Python, which saves a third of the compilation
time. Each is compiled once, separately: see ``code_cache``."""
part: Any = _by_numba(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of small functions called in loops: they are inlined in every kernel that calls
them."""


def bound(kernel_: Any, *arguments: Any) -> Callable[..., Any]:
    """The machine code of a kernel for arguments of these types.

    It does not look at the types again, which takes longer than the call: of two tuples of arrays
    0.7 instead of 8 µs. Arrays of another type would be read as if they had these.
    """
    signature = tuple(map(typeof, arguments))
    kernel_.compile(signature)
    code: Callable[..., Any] = kernel_.overloads[signature].entry_point
    return code

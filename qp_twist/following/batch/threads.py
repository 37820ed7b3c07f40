"""Distribute rows over threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from qp_twist.checks import whole_number

_MOST = 1024
_AT_A_TIME = 4
"""Number of parts per thread: a thread with easy rows processes more of them."""


def shared(rows: int, do: Callable[[slice], None], threads: int | None) -> None:
    """Call ``do`` for slices that cover all rows, on some threads; by default on all cores.

    The kernels release the interpreter lock.
    """
    workers = os.cpu_count() or 1
    if threads is not None:
        workers = min(whole_number("threads", threads, at_least=1), _MOST)
    size = max(1, -(-rows // (_AT_A_TIME * workers)))
    parts = [slice(first, first + size) for first in range(0, rows, size)]
    if workers == 1 or len(parts) < 2:
        for part in parts:
            do(part)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(do, parts))

"""The step as machine code, by numba: extra ``fast``. Nothing here is imported without it."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

COMPILED = "compiled"
"""Name of the solver."""


@cache
def installed() -> bool:
    """Whether numba is there."""
    return find_spec("numba") is not None

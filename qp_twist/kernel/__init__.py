"""The step as machine code, by numba."""

COMPILED = "compiled"
"""Name of the solver."""

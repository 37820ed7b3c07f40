"""The step as machine code, by numba."""

COMPILED = "compiled"
"""Name of the solver."""
MACHINE_CODE = "machine code is made, once on a machine: one to two minutes"
"""What a command says while kernels are compiled."""

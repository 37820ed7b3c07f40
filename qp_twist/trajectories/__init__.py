"""Trajectories: timing of joint paths, trajectory files, and their check against a task."""

import lazy_loader

# The names are those of __init__.pyi: who reads and checks a file loads no planner.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

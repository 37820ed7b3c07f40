"""Paths: task files, waypoints, and toolpaths of CAM systems."""

import lazy_loader

# The names are those of __init__.pyi: a task without a toolpath file loads no reader.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

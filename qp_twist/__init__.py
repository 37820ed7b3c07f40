"""QP-based task-priority control for tasks that need fewer than six degrees of freedom."""

import lazy_loader

__version__ = "0.1.0"

# The names are those of __init__.pyi; each loads its part of the package when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

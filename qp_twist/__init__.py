"""QP-based task-priority control for tasks that need fewer than six degrees of freedom."""

import pkgutil

import lazy_loader

__version__ = "0.2.0"

# The names are those of __init__.pyi; each loads its part of the package when it is first used.
__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
# Modules are attributes, qt.closed_form and qt.batch, and not listed: plan stands beside planning.
_modules = {"batch", *(module.name for module in pkgutil.iter_modules(__path__))}
__all__ = [name for name in __all__ if name not in _modules]


def __dir__() -> list[str]:
    return __all__

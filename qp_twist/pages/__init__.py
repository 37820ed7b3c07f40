"""Pages: the reports of a motion and of a comparison, their charts, and the recorder of scenes."""

import lazy_loader

# The names are those of __init__.pyi: who needs a table loads no server of pages.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

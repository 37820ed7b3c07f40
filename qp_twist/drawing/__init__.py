"""How a scene and a curve are drawn: palette, figures, charts, still pictures; no task needed."""

from .picture import NoPicture as NoPicture
from .picture import Picture as Picture
from .picture import picture_of as picture_of

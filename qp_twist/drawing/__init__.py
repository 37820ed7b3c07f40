"""Still pictures of a scene: by MuJoCo, without a screen."""

from .picture import Picture as Picture
from .picture import picture_of as picture_of

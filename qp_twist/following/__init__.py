"""A method along a path."""

from .follow import follow as follow
from .planned import plan as plan
from .planned import with_start as with_start
from .trajectory import Trajectory as Trajectory
from .trajectory import write_atomically as write_atomically

"""A method along a path."""

from .follow import follow as follow
from .found_starts import FoundStart as FoundStart
from .found_starts import NoStart as NoStart
from .found_starts import find_starts as find_starts
from .planned import plan as plan
from .planned import with_start as with_start
from .trajectory import Trajectory as Trajectory

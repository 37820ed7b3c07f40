"""Follow a path with a method."""

from qp_twist.planning import NoStart as NoStart

from . import batch as batch
from .follow import follow as follow
from .follow import with_options as with_options
from .found_starts import FoundStart as FoundStart
from .found_starts import find_starts as find_starts
from .planned import plan as plan
from .planned import whole_plan as whole_plan
from .planned import with_start as with_start
from .trajectory import RowSteps as RowSteps
from .trajectory import Trajectory as Trajectory

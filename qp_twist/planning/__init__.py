"""Plans of a whole path: what is possible at every waypoint, and the best way through it."""

from .certificate import Certificate as Certificate
from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .roadmap import Grid as Grid
from .roadmap import Roadmap as Roadmap
from .roll_map import RollMap as RollMap
from .roll_map import roll_arm as roll_arm

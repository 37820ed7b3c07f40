"""Plans of a whole path: the configurations of every waypoint, and the best motion through them."""

from .central import CentralConfiguration as CentralConfiguration
from .central import central_configurations as central_configurations
from .central import least_mean_z as least_mean_z
from .certificate import Certificate as Certificate
from .joint_move import EFFORT as EFFORT
from .joint_move import JointMoveSearch as JointMoveSearch
from .joint_move import NoJointMove as NoJointMove
from .levels import Grid as Grid
from .levels import Roadmap as Roadmap
from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .problem import motion_limits as motion_limits
from .roll_map import RollMap as RollMap
from .roll_map import roll_arm as roll_arm
from .sentence import Sentence as Sentence
from .starts import NoStart as NoStart
from .starts import central_starts as central_starts
from .starts import least_z_start as least_z_start
from .starts import random_start as random_start
from .starts import what_forbids as what_forbids

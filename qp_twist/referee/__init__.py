"""The referee: errors and violations of a joint motion, at and (proven) between waypoints."""

from .displacement import Displacement as Displacement
from .displacement import LeverArms as LeverArms
from .findings import AXIS_TOLERANCE_DEG as AXIS_TOLERANCE_DEG
from .findings import BAND as BAND
from .findings import POSITION_TOLERANCE as POSITION_TOLERANCE
from .findings import Finding as Finding
from .findings import Passing as Passing
from .findings import Tolerances as Tolerances
from .findings import errors_of as errors_of
from .findings import examine as examine
from .joint_motion import JointMotion as JointMotion
from .joint_motion import State as State
from .motion_limits import RAMP_S as RAMP_S
from .motion_limits import MotionLimits as MotionLimits
from .motion_limits import motion_limits as motion_limits
from .motion_limits import with_default_accelerations as with_default_accelerations
from .motion_limits import with_stated_accelerations as with_stated_accelerations
from .path_errors import PROVEN as PROVEN
from .path_errors import Outside as Outside
from .path_errors import PathErrors as PathErrors
from .path_errors import constraints_left as constraints_left
from .path_errors import path_errors as path_errors
from .path_errors import poses_of as poses_of
from .path_errors import straight_errors as straight_errors
from .path_errors import task_errors as task_errors

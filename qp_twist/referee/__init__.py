"""The referee: errors and violations of a joint motion, at and (proven) between waypoints."""

from qp_twist.paths import Tolerances as Tolerances

from .astray import Astray as Astray
from .astray import astray_parts as astray_parts
from .displacement import LeverArms as LeverArms
from .findings import AFTER as AFTER
from .findings import BEFORE as BEFORE
from .findings import EXCEEDED as EXCEEDED
from .findings import OFF as OFF
from .findings import Finding as Finding
from .findings import Passing as Passing
from .findings import acceleration_use as acceleration_use
from .findings import errors_of as errors_of
from .findings import examine as examine
from .findings import joint_margins as joint_margins
from .findings import velocity_use as velocity_use
from .intervals import Intervals as Intervals
from .intervals import fewer_rows as fewer_rows
from .joint_motion import JointMotion as JointMotion
from .joint_motion import State as State
from .motion_limits import RAMP_S as RAMP_S
from .motion_limits import MotionLimits as MotionLimits
from .motion_limits import motion_limits as motion_limits
from .motion_limits import speeds_or_default as speeds_or_default
from .motion_limits import with_default_accelerations as with_default_accelerations
from .path_errors import Deviation as Deviation
from .path_errors import Outside as Outside
from .path_errors import PathErrors as PathErrors
from .path_errors import constraints_left as constraints_left
from .path_errors import path_errors as path_errors
from .path_errors import poses_of as poses_of
from .path_errors import sampled_errors as sampled_errors
from .path_errors import straight_errors as straight_errors
from .path_errors import task_errors as task_errors
from .row_verdict import RowVerdict as RowVerdict
from .subdivision import PROVEN as PROVEN

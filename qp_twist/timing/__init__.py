"""When a joint path is where: speeds, accelerations, and the way between the waypoints."""

from .joint_motion import JointMotion as JointMotion
from .path_errors import PathErrors as PathErrors
from .path_errors import path_errors as path_errors
from .path_errors import poses_of as poses_of
from .path_errors import task_errors as task_errors
from .refine_trajectory import refine_trajectory as refine_trajectory
from .speed_profile import SpeedProfile as SpeedProfile
from .speed_profile import speed_profile as speed_profile
from .time_trajectory import Slowed as Slowed
from .time_trajectory import TimedTrajectory as TimedTrajectory
from .time_trajectory import time_trajectory as time_trajectory

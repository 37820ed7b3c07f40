"""When a joint path is where: its times, speeds and accelerations, and rows between waypoints."""

from qp_twist.referee import JointMotion as JointMotion
from qp_twist.referee import PathErrors as PathErrors
from qp_twist.referee import path_errors as path_errors

from .refine_trajectory import refine_trajectory as refine_trajectory
from .speed_profile import SpeedProfile as SpeedProfile
from .speed_profile import speed_profile as speed_profile
from .time_trajectory import Slowed as Slowed
from .time_trajectory import TimedTrajectory as TimedTrajectory
from .time_trajectory import time_trajectory as time_trajectory

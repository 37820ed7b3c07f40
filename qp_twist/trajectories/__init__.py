"""Trajectories: timing of joint paths, trajectory files, and their check against a task."""

from qp_twist.referee import Finding as Finding
from qp_twist.referee import JointMotion as JointMotion
from qp_twist.referee import PathErrors as PathErrors
from qp_twist.referee import path_errors as path_errors

from .check import Check as Check
from .check import check_trajectory as check_trajectory
from .joint_rows import JointRows as JointRows
from .program_trajectory import check_program as check_program
from .program_trajectory import joints_of as joints_of
from .refine_trajectory import refine_trajectory as refine_trajectory
from .speed_profile import SpeedProfile as SpeedProfile
from .speed_profile import speed_profile as speed_profile
from .task_run import TaskRun as TaskRun
from .task_run import run_task as run_task
from .time_trajectory import Slowed as Slowed
from .time_trajectory import TimedTrajectory as TimedTrajectory
from .time_trajectory import time_trajectory as time_trajectory
from .trajectory_file import ENDINGS as ENDINGS
from .trajectory_file import CheckedFile as CheckedFile
from .trajectory_file import read_trajectory as read_trajectory
from .trajectory_file import write_checked as write_checked
from .trajectory_file import write_trajectory as write_trajectory

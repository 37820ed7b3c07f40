"""Joint trajectories as files, and whether one of them does a task."""

from qp_twist.referee import Finding as Finding

from .check import Check as Check
from .check import check_trajectory as check_trajectory
from .files import ENDINGS as ENDINGS
from .files import read_trajectory as read_trajectory
from .files import write_trajectory as write_trajectory
from .joint_rows import JointRows as JointRows
from .task_run import TaskRun as TaskRun
from .task_run import run_task as run_task

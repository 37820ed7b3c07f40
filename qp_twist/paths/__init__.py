"""Paths: task files, waypoints, and toolpaths of CAM systems."""

from qp_twist.files import AngleUnit as AngleUnit
from qp_twist.files import FeedUnit as FeedUnit
from qp_twist.files import LengthUnit as LengthUnit

from .assemble import SAME_DIRECTION as SAME_DIRECTION
from .assemble import SAME_POINT as SAME_POINT
from .assemble import unit_question as unit_question
from .methods import DEFAULT_METHOD as DEFAULT_METHOD
from .methods import METHODS as METHODS
from .methods import Method as Method
from .methods import MethodSettings as MethodSettings
from .path_task import PathTask as PathTask
from .path_task import check_method as check_method
from .path_task import twist_task as twist_task
from .placement import leaned as leaned
from .placement import placed as placed
from .read_toolpath import Format as Format
from .read_toolpath import read_toolpath as read_toolpath
from .resample import MOST as MOST
from .resample import Sampling as Sampling
from .resample import resampled as resampled
from .resources import shipped_folder as shipped_folder
from .segment import Segment as Segment
from .task_file import load_scene as load_scene
from .task_file import load_task as load_task
from .task_file import shipped_tasks as shipped_tasks
from .task_file import task_title as task_title
from .toolpath import Curve as Curve
from .toolpath import Lines as Lines
from .toolpath import Toolpath as Toolpath
from .toolpath_columns import ColumnChoice as ColumnChoice
from .toolpath_columns import Orientation as Orientation
from .toolpath_columns import UnclearColumns as UnclearColumns
from .turning import angles_between as angles_between
from .turning import transported as transported
from .turning import turns_between as turns_between

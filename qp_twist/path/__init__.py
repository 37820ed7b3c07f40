"""Paths and task files."""

from .methods import DEFAULT_METHOD as DEFAULT_METHOD
from .methods import METHODS as METHODS
from .methods import Method as Method
from .methods import MethodSettings as MethodSettings
from .path_task import PathTask as PathTask
from .path_task import check_method as check_method
from .path_task import twist_task as twist_task
from .placement import leaned as leaned
from .placement import placed as placed
from .resources import shipped_folder as shipped_folder
from .segment import Segment as Segment
from .task_file import load_scene as load_scene
from .task_file import load_task as load_task
from .task_file import shipped_tasks as shipped_tasks
from .task_file import task_title as task_title

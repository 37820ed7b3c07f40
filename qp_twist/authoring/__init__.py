"""Write task files for a robot and a toolpath."""

from .new_task import NewTask as NewTask
from .new_task import new_task as new_task
from .request import Request as Request

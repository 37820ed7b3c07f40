"""Robots from MJCF and URDF files; known robots, and how their controllers count the joints."""

from .controller_arm import ControllerArm as ControllerArm
from .controller_joints import ControllerJoints as ControllerJoints
from .controller_joints import controller_joints as controller_joints
from .external_axes import ExternalAxis as ExternalAxis
from .external_axes import as_stated as as_stated
from .known_robots import KNOWN_ROBOTS as KNOWN_ROBOTS
from .known_robots import KnownRobot as KnownRobot
from .known_robots import hinges_of as hinges_of
from .known_robots import known_limits as known_limits
from .known_robots import known_robot as known_robot
from .known_robots import named_robot as named_robot
from .known_robots import read_robots as read_robots
from .known_robots import stated_robot as stated_robot
from .mesh_files import read_parts as read_parts
from .robot import Robot as Robot
from .robot import load_robot as load_robot
from .tool_chain import ToolChain as ToolChain

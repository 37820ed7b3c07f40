"""Robots from MJCF and URDF files."""

from .known_robots import KNOWN_ROBOTS as KNOWN_ROBOTS
from .known_robots import KnownRobot as KnownRobot
from .known_robots import known_robot as known_robot
from .known_robots import known_speeds as known_speeds
from .robot import Robot as Robot
from .robot import load_robot as load_robot

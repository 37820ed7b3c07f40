"""Robots from files: MJCF as MuJoCo loads it, URDF as it comes."""

from .robot import Robot as Robot
from .robot import load_robot as load_robot

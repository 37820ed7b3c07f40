"""The controller: one verified step."""

from .controller import Controller as Controller
from .posing import NamedProblem as NamedProblem
from .servo import Servo as Servo
from .solve_ik import ik_step as ik_step
from .solve_ik import solve_ik as solve_ik
from .solve_levels import Solution as Solution
from .solve_levels import solve_levels as solve_levels
from .step import Status as Status
from .step import Step as Step
from .tick import ServoState as ServoState
from .tick import Tick as Tick
from .tick import TickTimes as TickTimes

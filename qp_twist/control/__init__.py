"""The controller: one verified step."""

from .controller import Controller as Controller
from .servo import Servo as Servo
from .servo import ServoState as ServoState
from .servo import Tick as Tick
from .solve_ik import ik_step as ik_step
from .solve_ik import solve_ik as solve_ik
from .step import Status as Status
from .step import Step as Step
from .tick_times import TickTimes as TickTimes

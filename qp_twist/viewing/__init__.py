"""The live page: robot, workpiece and path in a browser, played, dragged and varied."""

from .lap import Lap as Lap
from .lap import Moment as Moment
from .lap import run_lap as run_lap
from .live_arm import LiveArm as LiveArm
from .port import free_port as free_port
from .projectors import projector_choices as projector_choices
from .session import Session as Session
from .settings import Settings as Settings

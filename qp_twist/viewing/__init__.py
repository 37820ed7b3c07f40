"""The live page: robot, workpiece and path in a browser, played, dragged and varied."""

from .live_arm import LiveArm as LiveArm
from .one_run import Moment as Moment
from .one_run import Run as Run
from .one_run import run_once as run_once
from .projectors import projector_choices as projector_choices
from .session import Session as Session
from .settings import PageSettings as PageSettings

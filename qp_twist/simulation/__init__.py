"""The controller closed around a simulated robot: servos, lag, noise, and a record of the run."""

from .closed_loop import ClosedLoop as ClosedLoop
from .model_servos import ModelServos as ModelServos
from .plant import Plant as Plant
from .push import Push as Push
from .record import Record as Record
from .servos import Servos as Servos
from .timed_path import TimedPath as TimedPath

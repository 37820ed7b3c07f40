"""Times of steps, ours and others', beside how right they are."""

from .record import Run as Run
from .record import read_run as read_run
from .record import write_run as write_run
from .run import PARTS as PARTS
from .run import bench as bench

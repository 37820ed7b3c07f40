"""Times of steps of this package and of others, with their accuracy."""

from .record import BenchRun as BenchRun
from .record import read_run as read_run
from .record import write_run as write_run
from .run import PARTS as PARTS
from .run import bench as bench

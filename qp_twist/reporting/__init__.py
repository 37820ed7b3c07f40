"""The report of one motion: a page for whoever ordered it."""

from .motion_report import MotionReport as MotionReport
from .motion_report import report as report

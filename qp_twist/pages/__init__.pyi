from .motion_report import MotionReport as MotionReport
from .motion_report import report as report
from .motion_report import write_report as write_report

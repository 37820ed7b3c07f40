"""Toolpaths from files: reading, resampling, orientations along them. Pure functions of arrays."""

from qp_twist.tables import AngleUnit as AngleUnit
from qp_twist.tables import FeedUnit as FeedUnit
from qp_twist.tables import LengthUnit as LengthUnit

from .assemble import SAME_DIRECTION as SAME_DIRECTION
from .assemble import SAME_POINT as SAME_POINT
from .assemble import unit_question as unit_question
from .columns import ColumnChoice as ColumnChoice
from .columns import Orientation as Orientation
from .columns import UnclearColumns as UnclearColumns
from .read import Format as Format
from .read import read_toolpath as read_toolpath
from .resample import MOST as MOST
from .resample import Sampling as Sampling
from .resample import resampled as resampled
from .toolpath import Curve as Curve
from .toolpath import Lines as Lines
from .toolpath import Toolpath as Toolpath
from .turning import angles_between as angles_between
from .turning import transported as transported
from .turning import turns_between as turns_between

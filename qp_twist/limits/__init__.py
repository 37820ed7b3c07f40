"""Limits: box bounds on joint velocities; mink's limits are accepted as they are."""

from .band_limit import BandLimit as BandLimit
from .binding import DUST as DUST
from .binding import BindingLimit as BindingLimit
from .binding import binding_bounds as binding_bounds
from .box_limit import Box as Box
from .box_limit import BoxLimit as BoxLimit
from .check_model import check_model as check_model
from .couplings import share_limits as share_limits
from .displacement_window import DisplacementWindow as DisplacementWindow
from .gather import GatheredLimits as GatheredLimits
from .gather import gather_limits as gather_limits
from .intersection import intersect as intersect
from .mink_box import default_limit as default_limit
from .mink_box import is_mink_box as is_mink_box
from .mink_box import mink_box as mink_box
from .mink_box import qpos_of as qpos_of
from .motion_limit import MotionLimit as MotionLimit
from .per_joint import per_joint as per_joint
from .position_limit import PositionLimit as PositionLimit
from .stated_limit import Named as Named
from .stated_limit import RowName as RowName
from .stated_limit import StatedLimit as StatedLimit
from .stated_limit import kind_of as kind_of
from .stopping_speed import stopping_speed as stopping_speed

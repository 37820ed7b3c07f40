"""Limits: box bounds on joint velocities; mink's limits are accepted as they are."""

from .band_limit import BandLimit as BandLimit
from .binding import BindingLimit as BindingLimit
from .box_limit import BoxLimit as BoxLimit
from .displacement_window import DisplacementWindow as DisplacementWindow
from .gather import GatheredLimits as GatheredLimits
from .gather import gather_limits as gather_limits
from .position_limit import PositionLimit as PositionLimit

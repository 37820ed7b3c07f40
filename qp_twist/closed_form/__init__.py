"""Closed-form resolutions of a step, as plain functions of arrays."""

from .resolutions import gradient_projection as gradient_projection
from .resolutions import minimum_norm as minimum_norm
from .resolutions import resolved_motion_rate as resolved_motion_rate
from .resolutions import twa as twa

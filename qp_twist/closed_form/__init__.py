"""Closed-form resolutions of a step, as plain functions of arrays."""

from .resolutions import gradient_projection as gradient_projection
from .resolutions import minimum_norm as minimum_norm
from .resolutions import resolved_motion_rate as resolved_motion_rate
from .resolutions import twa as twa
from .saturation import Saturation as Saturation
from .saturation import saturation_in_null_space as saturation_in_null_space
from .weighted_least_norm import joint_limit_gradient as joint_limit_gradient
from .weighted_least_norm import joint_limit_weights as joint_limit_weights
from .weighted_least_norm import weighted_least_norm as weighted_least_norm

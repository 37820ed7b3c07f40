"""Projectors and twist errors: pure functions of arrays."""

from .projector import Projector as Projector
from .projector import ProjectorKind as ProjectorKind
from .rotations import cross as cross
from .rotations import geodesic as geodesic
from .rotations import perpendicular as perpendicular
from .rotations import rotate as rotate
from .rotations import rotation_matrix as rotation_matrix
from .rotations import rotation_vector as rotation_vector
from .rotations import twist_angle as twist_angle
from .twist_error import angular_error as angular_error
from .twist_error import clamp_twist as clamp_twist
from .twist_error import resolved_twist_error as resolved_twist_error
from .twist_error import twist_error as twist_error
from .twist_projector import ProjectorFrame as ProjectorFrame
from .twist_projector import TwistProjector as TwistProjector
from .twist_projector import distinct_projectors as distinct_projectors
from .twist_projector import task_redundancy as task_redundancy
from .twist_projector import with_fewer_rows as with_fewer_rows

"""Tasks and secondary objectives: plain mink tasks."""

from .frame import frame_jacobian as frame_jacobian
from .frame import frame_pose as frame_pose
from .free_twist_cost import FreeTwistCost as FreeTwistCost
from .joint_centering import JointCentering as JointCentering
from .joint_ranges import JointRanges as JointRanges
from .manipulability import Manipulability as Manipulability
from .posture_reference import PostureReference as PostureReference
from .secondary import SecondaryObjective as SecondaryObjective
from .secondary import total_displacement as total_displacement
from .twist_task import TaskState as TaskState
from .twist_task import TwistTask as TwistTask

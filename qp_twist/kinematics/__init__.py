"""Tasks and secondary objectives: plain mink tasks."""

from .cone_band import ConeBand as ConeBand
from .frame import frame_jacobian as frame_jacobian
from .frame import frame_pose as frame_pose
from .frame import relative_jacobian as relative_jacobian
from .frame import same_structure as same_structure
from .free_twist_cost import FreeTwistCost as FreeTwistCost
from .gaze_task import GazeTask as GazeTask
from .joint_centering import JointCentering as JointCentering
from .joint_ranges import JointRanges as JointRanges
from .manipulability import Manipulability as Manipulability
from .ortho_parallel import OrthoParallelArm as OrthoParallelArm
from .posture_reference import PostureReference as PostureReference
from .roll_band import RollBand as RollBand
from .secondary import SecondaryObjective as SecondaryObjective
from .secondary import checked_displacement as checked_displacement
from .secondary import total_displacement as total_displacement
from .serial_chain import SerialChain as SerialChain
from .slab_band import BoxBand as BoxBand
from .slab_band import SlabBand as SlabBand
from .target_twist import target_twist as target_twist
from .tolerance_band import BandRows as BandRows
from .tolerance_band import FramePair as FramePair
from .tolerance_band import ToleranceBand as ToleranceBand
from .tolerance_band import check_bands as check_bands
from .twist_task import TaskState as TaskState
from .twist_task import TwistTask as TwistTask

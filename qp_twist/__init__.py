"""QP-based task-priority control for tasks that need fewer than six degrees of freedom."""

__version__ = "0.1.0"

from qp_twist import closed_form as closed_form

from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .controller import Controller as Controller
from .controller import Status as Status
from .controller import Step as Step
from .errors import InvalidInput as InvalidInput
from .errors import InvalidTarget as InvalidTarget
from .errors import QpTwistError as QpTwistError
from .errors import TaskFileError as TaskFileError
from .errors import UnknownSolver as UnknownSolver
from .following import Trajectory as Trajectory
from .following import follow as follow
from .following import plan as plan
from .geometry import Projector as Projector
from .geometry import TwistProjector as TwistProjector
from .geometry import task_redundancy as task_redundancy
from .geometry import twist_error as twist_error
from .kinematics import BandRows as BandRows
from .kinematics import BoxBand as BoxBand
from .kinematics import ConeBand as ConeBand
from .kinematics import FreeTwistCost as FreeTwistCost
from .kinematics import GazeTask as GazeTask
from .kinematics import JointCentering as JointCentering
from .kinematics import JointRanges as JointRanges
from .kinematics import Manipulability as Manipulability
from .kinematics import PostureReference as PostureReference
from .kinematics import RollBand as RollBand
from .kinematics import SecondaryObjective as SecondaryObjective
from .kinematics import SlabBand as SlabBand
from .kinematics import ToleranceBand as ToleranceBand
from .kinematics import TwistTask as TwistTask
from .kinematics import target_twist as target_twist
from .limits import BandLimit as BandLimit
from .limits import BindingLimit as BindingLimit
from .limits import DisplacementWindow as DisplacementWindow
from .limits import MotionLimit as MotionLimit
from .limits import PositionLimit as PositionLimit
from .path import METHODS as METHODS
from .path import PathTask as PathTask
from .path import Segment as Segment
from .path import load_task as load_task
from .planning import Certificate as Certificate
from .planning import Plan as Plan
from .qp import InfeasibleStep as InfeasibleStep
from .qp import LostDirection as LostDirection
from .qp import NoSolutionFound as NoSolutionFound
from .qp import QuadraticProgram as QuadraticProgram
from .qp import Solution as Solution
from .qp import SolverInaccurate as SolverInaccurate
from .qp import solve_levels as solve_levels
from .studies import Study as Study
from .studies import study as study

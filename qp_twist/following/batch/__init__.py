"""Many configurations, placements or runs at once, as machine code.

Arrays in, arrays out; a failure in one row does not stop the others.
"""

from .kinematics import Kinematics as Kinematics
from .kinematics import kinematics as kinematics
from .steps import Steps as Steps
from .steps import step as step
from .trajectories import Trajectories as Trajectories
from .trajectories import follow as follow

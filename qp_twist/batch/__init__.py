"""Many configurations, placements or laps at once, as machine code; extra ``fast``.

Arrays in, arrays out; what fails in one row does not stop the others.
"""

from .kinematics import Kinematics as Kinematics
from .kinematics import kinematics as kinematics
from .laps import Laps as Laps
from .laps import follow as follow

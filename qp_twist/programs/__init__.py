"""Robot programs: joint moves in the languages of controllers, written and read."""

from .dialects import DIALECTS as DIALECTS
from .dialects import EXECUTE as EXECUTE
from .dialects import SUFFIXES as SUFFIXES
from .dialects import dialect_of as dialect_of
from .dialects import files_beside as files_beside
from .dialects import joint_moves as joint_moves
from .header import AS_MODELLED as AS_MODELLED
from .header import DOES_NOT_PASS as DOES_NOT_PASS
from .header import WRITTEN_AS_MODELLED as WRITTEN_AS_MODELLED
from .header import check_header as check_header
from .header import header_lines as header_lines
from .joint_moves import AXES as AXES
from .joint_moves import Around as Around
from .joint_moves import Circle as Circle
from .joint_moves import Dialect as Dialect
from .joint_moves import ExternalColumn as ExternalColumn
from .joint_moves import JointMoves as JointMoves
from .joint_moves import ProgramFrame as ProgramFrame
from .joint_moves import Speed as Speed
from .joint_moves import Target as Target
from .joint_moves import Turning as Turning
from .joint_moves import Zone as Zone
from .joint_moves import printed as printed
from .moves import JointMove as JointMove
from .moves import Moves as Moves

"""The quadratic program of a step: its arrays, backends, verification and scaling."""

from .backend import check_solver as check_solver
from .backend import installed_solvers as installed_solvers
from .directions import Directions as Directions
from .directions import LostDirection as LostDirection
from .directions import lost_directions as lost_directions
from .failures import InfeasibleStep as InfeasibleStep
from .failures import NoSolutionFound as NoSolutionFound
from .failures import SolverInaccurate as SolverInaccurate
from .levels import Cascade as Cascade
from .levels import Level as Level
from .one_program import Found as Found
from .one_program import costs_along as costs_along
from .one_program import first_level as first_level
from .problem import QuadraticProgram as QuadraticProgram
from .problem import widened as widened
from .solve import Refused as Refused
from .solve import Verified as Verified
from .solve import solve as solve
from .solve import solve_within as solve_within
from .verification import Multipliers as Multipliers

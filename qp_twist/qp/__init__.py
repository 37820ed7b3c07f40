"""The quadratic program of a step: its arrays, backends, verification and scaling."""

from .backend import check_solver as check_solver
from .failures import InfeasibleStep as InfeasibleStep
from .failures import NoSolutionFound as NoSolutionFound
from .failures import SolverInaccurate as SolverInaccurate
from .problem import QuadraticProgram as QuadraticProgram
from .scaling import LargestScale as LargestScale
from .scaling import largest_scale as largest_scale
from .solve import Refused as Refused
from .solve import Verified as Verified
from .solve import closest_rows as closest_rows
from .solve import solve as solve

"""Constraints: what a motion has to keep, with one interface for everyone who asks."""

from .constraint import Constraint as Constraint
from .constraint import check_constraint as check_constraint
from .constraint import check_constraints as check_constraints
from .constraint import margins_of as margins_of

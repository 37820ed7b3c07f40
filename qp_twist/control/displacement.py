"""h of one step: a share of the secondary objectives' displacement, and what is added to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy.typing as npt

from qp_twist.checks import Array, finite_array, number


class Displacement(NamedTuple):
    """The joint displacement reference h of one step."""

    share: float
    """Share of the secondary objectives' displacement, from 0 to 1."""
    added: Array | None
    """What is added to it, rad or m, (nv,); ``None`` for nothing."""
    acts: bool
    """Whether h is not zero by these two."""

    @classmethod
    def of(cls, share: bool | float, added: npt.ArrayLike | None, nv: int) -> Displacement:
        """Check the arguments of :meth:`Controller.step <qp_twist.Controller.step>`."""
        share = number("use_secondary", float(share), at_least=0.0, at_most=1.0)
        if added is None:
            return EVERYTHING if share == 1.0 else cls(share, None, share > 0.0)
        return cls(share, finite_array("displacement", added, (nv,)), True)


EVERYTHING = Displacement(1.0, None, True)
"""h as the secondary objectives state it."""

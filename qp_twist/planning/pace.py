"""How much slower a path has a motion where its speed alone prevents one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from qp_twist.planning.certificate import Certificate
from qp_twist.planning.problem import JudgedPath, PathConstraints

_SLOWER = (3.0, 30.0)
"""How many times slower a path is tried that has no motion in its time."""
_HALVINGS = 2
"""How often the range between the two is halved, in which the least such factor lies."""


def with_pace(
    certificate: Certificate, limits: PathConstraints, find: Callable[[float], JudgedPath | None]
) -> Certificate:
    """The certificate of a path that is too fast, with how much slower it has a motion.

    Args:
        certificate: Why there is none.
        limits: The path's constraints.
        find: Searches a motion of the path that takes so many times as long.
    """
    without, path = 1.0, None
    for times in _SLOWER:
        path = find(times)
        if path is not None:
            break
        without = times
    if path is None:
        note = f"nor was one found for the path {without:g} times slower"
        return replace(certificate, note=note)
    needed, number, joint = limits.pace(path.q)
    for _ in range(_HALVINGS):
        times = float(np.sqrt(without * needed))
        path = find(times)
        if path is None:
            without = times
        else:
            needed, number, joint = limits.pace(path.q)
    note = (
        f"only its speed prevents one: {needed:.3g} times slower the path has a motion, which "
        f"needs that after waypoint {number + 1}, for {joint}"
    )
    if without > 1.0:
        note += f"; {without:.3g} times slower none was found"
    return replace(certificate, slower=needed, note=note)

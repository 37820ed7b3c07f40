"""Random configurations."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges


def random_configurations(ranges: JointRanges, count: int, rng: np.random.Generator) -> Array:
    """Uniform between the limits; hinges without: over a turn, slides: ±1 m; (count, nv)."""
    half = np.where(ranges.hinge, np.pi, 1.0)
    lower = np.where(np.isfinite(ranges.lower), ranges.lower, -half)
    upper = np.where(np.isfinite(ranges.upper), ranges.upper, half)
    drawn: Array = rng.uniform(lower, upper, size=(count, len(lower)))
    return drawn

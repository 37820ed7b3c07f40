"""Upper bound of the reach of a serial chain."""

from __future__ import annotations

import itertools

import numpy as np

from qp_twist.kinematics.joint_ranges import JointRanges
from qp_twist.kinematics.serial_chain import SerialChain


def largest_reach(chain: SerialChain, ranges: JointRanges) -> float:
    r"""An upper bound on the distance of a chain's frame from its first joint, m.

    .. math:: \sum_k \lVert \mathbf a_{k+1} - \mathbf a_k \rVert + \sum_{\text{slides}} \max_q
        \lvert q - q^0 \rvert

    Two neighbouring anchors :math:`\mathbf a` (the last one is the frame's origin) are fixed to the
    link between them, so their distance is that of the reference configuration, except for a
    slide's travel. Infinite for a slide without a range, 0 if no joint moves the frame.
    """
    if not chain.screws:
        return 0.0
    points = [*(screw.anchor for screw in chain.screws), chain.position]
    reach = sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(points))
    for screw in chain.screws:
        if screw.slides:
            ends = ranges.lower[screw.dof], ranges.upper[screw.dof]
            reach += float(np.abs(np.array(ends) - screw.reference).max())
    return reach

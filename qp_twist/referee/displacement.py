"""Bounds of a frame's displacement, and of its deviation from the chord, while its joints move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import SerialChain
from qp_twist.referee.joint_motion import JointMotion


@dataclass(frozen=True, eq=False)
class LeverArms:
    r"""Bounds of a frame's first and second derivatives with respect to the joints of its chain.

    For a hinge j the frame's origin is never further from its axis than r_j, the sum of the lengths
    of the links from j on and of the travels of the slides among them. With i before j in the chain

    .. math::

        \Big\|\frac{\partial^2\mathbf p}{\partial q_i\,\partial q_j}\Big\|
        = \|\mathbf z_i \times (\mathbf z_j \times (\mathbf p - \mathbf a_j))\| \le r_j,

    1 in place of r_j where j is a slide, and 0 where i is one.

    Attributes:
        dofs: Degrees of freedom of the chain, from the world on, (n,).
        hinge: Which of them are hinges, (n,).
        lever: r of the hinges, m; 1 for slides, (n,).
    """

    dofs: np.ndarray[tuple[int], np.dtype[np.intp]]
    hinge: np.ndarray[tuple[int], np.dtype[np.bool_]]
    lever: Array

    @classmethod
    def of(cls, chain: SerialChain, motion: JointMotion) -> LeverArms:
        """Lever arms of a frame, given the travels of the slides in a motion."""
        screws = chain.screws
        dofs = np.array([screw.dof for screw in screws], dtype=np.intp)
        hinge = np.array([not screw.slides for screw in screws], dtype=bool)
        extremes = np.array(motion.extremes())[:, :, dofs]
        reference = np.array([screw.reference for screw in screws])
        lever = chain.levers(np.abs(extremes - reference).max(axis=(0, 1)))
        return cls(dofs, hinge, lever)

    def displacement(
        self, speeds: Array, accelerations: Array, took: Array
    ) -> tuple[Array, Array, Array]:
        """Bounds for joints no faster than ``speeds`` (K, nv), which take ``took`` (K,), s.

        With s from 0 to 1 over each motion: largest ‖ω‖ of the frame, rad; largest Σ|q̈| of the
        hinges, rad, which with ω² bounds the second derivative of R; and largest ‖p″‖ of the
        frame's origin, m, (K,) each.
        """
        dq = speeds[:, self.dofs] * took[:, None]
        ddq = accelerations[:, self.dofs] * (took**2)[:, None]
        turns = np.where(self.hinge, dq, 0.0)
        before = np.cumsum(turns, axis=1) - turns
        bend = (self.lever * (ddq + dq * (turns + 2.0 * before))).sum(axis=1)
        return turns.sum(axis=1), np.where(self.hinge, ddq, 0.0).sum(axis=1), bend

"""Objectives of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array, did_you_mean, number, read_only
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges

OBJECTIVES = ("centering", "travel", "margin")


@dataclass(frozen=True, eq=False)
class Objective:
    r"""A measure of a joint path :math:`\mathbf q_1 \dots \mathbf q_N`.

    .. math::

        \text{centering: } \frac1N\sum_k z(\mathbf q_k), \quad
        z = \tfrac12\sum_j w_j \left(\frac{\theta_j - \bar\theta_j}{\theta_{max,j} -
        \theta_{min,j}}\right)^2, \quad
        \text{travel: } \sum_k\sum_j w_j |\theta_{k+1,j} - \theta_{k,j}|, \quad
        \text{margin: } \min_k\min_j \min(\theta_{k,j} - \theta_{min,j},
        \theta_{max,j} - \theta_{k,j})

    Centering and travel, or a weighted sum of them, are minimised; the margin is maximised. Travel
    and margin are in degrees; a metre of a slide counts as a radian. The joints' weights w are 1
    unless they are given.

    Attributes:
        ranges: The joint ranges, with the joints' weights in W.
        joints: The joints' weights w, (nv,).
        centering: Weight of the mean z.
        travel: Weight of the travel, 1/degree.
        margin: Whether the objective is the margin.
    """

    ranges: JointRanges
    joints: Array
    centering: float = 0.0
    travel: float = 0.0
    margin: bool = False

    @classmethod
    def of(
        cls,
        ranges: JointRanges,
        objective: str | Mapping[str, float],
        joint_weights: Mapping[str, float] | None = None,
    ) -> Objective:
        """Read an objective: its name, or weights of centering and travel; and weights of joints.

        Raises:
            InvalidInput: If it is neither; if there is no such joint, its weight is negative, or
                the margin is to be weighted.
        """
        joints = np.ones(len(ranges.names))
        for name, weight in (joint_weights or {}).items():
            if name not in ranges.names:
                raise InvalidInput(
                    f"joint_weights: no joint is called {name!r}"
                    f"{did_you_mean(name, ranges.names)} The joints are "
                    f"{', '.join(ranges.names)}."
                )
            dof = ranges.names.index(name)
            joints[dof] = number(f"joint_weights[{name!r}]", weight, at_least=0.0)
        if joint_weights:
            if objective == "margin":
                raise InvalidInput(
                    "joint_weights: the margin is that of the worst joint and takes no weights; "
                    "use objective='centering' or 'travel', or leave the weights out."
                )
            of_joints = read_only(np.sqrt(joints) * ranges.weight)
            ranges = replace(ranges)
            vars(ranges)["weight"] = of_joints  # in place of the cached diagonal of W
        if objective == "margin":
            return cls(ranges, joints, margin=True)
        weights = {objective: 1.0} if isinstance(objective, str) else objective
        if isinstance(weights, Mapping) and set(weights) <= {"centering", "travel"}:
            checked = {
                name: number(f"objective[{name!r}]", weight, at_least=0.0)
                for name, weight in weights.items()
            }
            if any(checked.values()):
                return cls(
                    ranges, joints, checked.get("centering", 0.0), checked.get("travel", 0.0)
                )
        raise InvalidInput(
            f"objective: expected one of {', '.join(OBJECTIVES)}, or positive weights such as "
            f"{{'centering': 1.0, 'travel': 0.001}}; got {objective!r}."
        )

    def value(self, q: Array) -> float:
        """Value of a joint path q (N, nv): mean z, degrees, or their weighted sum."""
        if self.margin:
            return float(self.margins(q).min())
        way = np.degrees((self.joints * np.abs(np.diff(q, axis=0))).sum())
        return self.centering * float(self.ranges.centring(q).mean()) + self.travel * float(way)

    @property
    def penalty(self) -> float:
        """Penalty of a violation of a radian that exceeds any gain, in the value's unit."""
        largest = max(float(self.joints.max(initial=0.0)), 1.0)
        return largest * (10.0 * self.centering + 1e5 * self.travel) + 1e4 * self.margin

    def better(self, a: float, b: float) -> bool:
        """Whether value ``a`` is better than ``b``."""
        return a > b if self.margin else a < b

    def margins(self, q: Array) -> Array:
        """Distance of each configuration (…, nv) from the nearest limit, degrees, (…,)."""
        margins: Array = np.degrees(self.ranges.room(q).min(axis=-1, initial=np.inf))
        return margins

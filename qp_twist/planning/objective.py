"""Objectives of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array, did_you_mean, number, read_only
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.pace import Pace
from qp_twist.planning.preferred import PreferredPoses

OBJECTIVES = ("centering", "travel", "margin", "time")
_WEIGHED = ("centering", "travel", "time")


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

    and the time, :math:`\sum_k t_k` with the least times of a :class:`Pace`. Centering, travel and
    time, or a weighted sum of them, are minimised; the margin is maximised. Travel and margin are
    in degrees; a metre of a slide counts as a radian. The joints' weights w are 1 unless they are
    given.

    Attributes:
        ranges: The joint ranges, with the joints' weights in W.
        joints: The joints' weights w, (nv,).
        centering: Weight of the mean z.
        travel: Weight of the travel, 1/degree.
        margin: Whether the objective is the margin.
        time: Weight of the time, 1/s.
        pace: The times of a path, if they count.
        preferred: The task's preference, whose cost is added, if it has one.
    """

    ranges: JointRanges
    joints: Array
    centering: float = 0.0
    travel: float = 0.0
    margin: bool = False
    time: float = 0.0
    pace: Pace | None = None
    preferred: PreferredPoses | None = None

    @classmethod
    def of(
        cls,
        ranges: JointRanges,
        objective: str | Mapping[str, float],
        joint_weights: Mapping[str, float] | None = None,
    ) -> Objective:
        """Read an objective: its name, or weights of centering, travel and time; and of joints.

        Raises:
            InvalidInput: If it is neither; if there is no such joint, its weight is negative, or
                margin or time are to be weighted.
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
            if objective in ("margin", "time"):
                raise InvalidInput(
                    f"joint_weights: the {objective} is that of the worst joint and takes no "
                    "weights; use objective='centering' or 'travel', or leave the weights out."
                )
            of_joints = read_only(np.sqrt(joints) * ranges.weight)
            ranges = replace(ranges)
            vars(ranges)["weight"] = of_joints  # in place of the cached diagonal of W
        if objective == "margin":
            return cls(ranges, joints, margin=True)
        weights = {objective: 1.0} if isinstance(objective, str) else objective
        if isinstance(weights, Mapping) and set(weights) <= set(_WEIGHED):
            checked = {
                name: number(f"objective[{name!r}]", weight, at_least=0.0)
                for name, weight in weights.items()
            }
            if any(checked.values()):
                centering, travel, time = (checked.get(name, 0.0) for name in _WEIGHED)
                return cls(ranges, joints, centering, travel, time=time)
        raise InvalidInput(
            f"objective: expected one of {', '.join(OBJECTIVES)}, or positive weights such as "
            f"{{'centering': 1.0, 'travel': 0.001}}; got {objective!r}."
        )

    def along(self, path_task: PathTask) -> Objective:
        """The objective with a task's preference, and the times of its motions, if these count.

        Raises:
            InvalidInput: If nothing limits the speed, or nothing can be preferred.
        """
        if self.margin and path_task.preference is not None:
            raise InvalidInput(
                "the margin is that of the worst waypoint, and not traded against a preference; "
                "use objective='centering', 'travel' or 'time', or leave [preference] out.",
                key="preference",
            )
        goal = replace(self, preferred=PreferredPoses.of(path_task))
        if not self.time:
            return goal
        pace = Pace.of_run(path_task)
        endless = np.flatnonzero(~np.isfinite(pace.velocity))
        if path_task.durations is None and len(endless):
            names = ", ".join(self.ranges.names[k] for k in endless)
            raise InvalidInput(
                f"plan: {path_task.name} has no feed, and no speed limit of {names}, so that "
                "nothing says how long a motion takes; add [feed] to the task file, or "
                "[limits.velocity]."
            )
        return replace(goal, pace=pace)

    def slowed(self, path_task: PathTask) -> Objective:
        """The objective of a motion that cannot keep the feed: as little slower as possible.

        The share of the path's time, with what is optimised as far as it does not cost time: a mean
        z of 0.1 less counts as much as a thousandth of the time, as do 100° of travel.
        """
        less = replace(self, margin=False, centering=1e-2, travel=0.0)
        if self.preferred is not None:
            less = replace(less, preferred=self.preferred.scaled(1e-2))
        if self.travel:
            less = replace(self, centering=1e-2 * bool(self.centering), travel=1e-5)
        pace = Pace.of_run(path_task)
        return replace(less, time=1.0 / float(pace.feed.sum()), pace=pace)

    def times(self, q: Array) -> Array:
        """Times of the steps of a path q (N, nv), s, (N − 1,), if they count; otherwise empty."""
        return np.zeros(0) if self.pace is None else self.pace.seconds(q)

    def value(self, q: Array, times: Array | None = None) -> float:
        """Value of a joint path q (N, nv): mean z, degrees, seconds, or their weighted sum.

        ``times`` are those of its steps, if they are known.
        """
        if self.margin:
            return float(self.margins(q).min())
        way = np.degrees((self.joints * np.abs(np.diff(q, axis=0))).sum())
        value = self.centering * float(self.ranges.centering(q).mean()) + self.travel * float(way)
        if self.preferred is not None:
            value += self.preferred.cost(q)
        return value + self.time * float((self.times(q) if times is None else times).sum())

    @property
    def penalty(self) -> float:
        """Penalty of a violation of a radian that exceeds any gain, in the value's unit."""
        largest = max(float(self.joints.max(initial=0.0)), 1.0)
        weighted = largest * (10.0 * self.centering + 1e5 * self.travel)
        slowest = 1.0 if self.pace is None else float(self.pace.velocity.min(initial=1.0))
        preferred = 0.0 if self.preferred is None else 10.0 * self.preferred.largest
        return weighted + preferred + 1e4 * self.margin + 1e3 * self.time / slowest

    def better(self, a: float, b: float) -> bool:
        """Whether value ``a`` is better than ``b``."""
        return a > b if self.margin else a < b

    def margins(self, q: Array) -> Array:
        """Distance of each configuration (…, nv) from the nearest limit, degrees, (…,)."""
        margins: Array = np.degrees(self.ranges.room(q).min(axis=-1, initial=np.inf))
        return margins

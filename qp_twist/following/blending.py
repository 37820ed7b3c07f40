"""The resolver of each row of a path; where the projector changes, a blend of two."""

from __future__ import annotations

import itertools
from functools import lru_cache

import mink
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.following.mink_step import MinkResolver
from qp_twist.following.resolver import (
    ClosedFormResolver,
    Iteration,
    Job,
    QpResolver,
    Resolver,
    SaturationResolver,
)
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector, twist_error


def resolvers_along(job: Job) -> list[Resolver]:
    """The resolvers of the rows of a path: that of the projector in force, or a blend of two.

    A method that fixes the whole twist has a single one: it meets every projector. A run that may
    slow down leaves acceleration limits to the timing.
    """
    task, path = job.path_task, job.path
    limits = WaypointLimits(task, accelerations=not job.slow_down)

    @lru_cache(None)
    def of(projector: TwistProjector) -> Resolver:
        if job.method.peer:
            return MinkResolver(job, projector, limits)
        if job.method.constrained:
            return QpResolver(job, projector, limits)
        if job.method.name != "sns":
            return ClosedFormResolver(job, projector, limits)
        if task.stated_constraints:
            raise InvalidInput(
                "follow('sns'): saturation in the null space takes bounds on single joints only, "
                f"and {task.name} has constraints ({task.stated_constraints[0].kind}); "
                "use one of the QPs of this package."
            )
        return SaturationResolver(job, projector, limits)

    if job.method.whole_twist:
        return [of(task.operational)] * len(path.s)
    resolvers = [of(projector) for projector in path.projectors]
    for segment, before in zip(task.segments, task.projectors, strict=False):
        steps = path.s - segment.first + 1.0
        for k in np.flatnonzero(segment.blended(path.s)).tolist():
            resolvers[k] = BlendingResolver(
                of(before), of(segment.projector), resolvers[k], path.target(k - 1),
                (float(steps[k - 1]), float(steps[k])), segment.blend,
            )  # fmt: skip
    return resolvers


class BlendingResolver(Resolver):
    r"""A row between two projectors, at step k of n + 1; step 0 is the waypoint before the blend.

    The first iteration is the convex combination

    .. math:: \Delta\mathbf q = (1-\alpha)\,\Delta\mathbf q_{old} + \alpha\,\Delta\mathbf q_{new}
        ,\qquad \alpha = 3x^2 - 2x^3,\; x = k/(n+1)

    of the method's displacements with either projector; α begins and ends at slope 0. Bounds and
    rows G q̇ ≤ g are convex, and the common rows hold in both, so they hold in the combination. The
    other iterations correct the common rows only: otherwise they would undo the blend.

    Rows of only one projector are not corrected to the waypoint, since the other one moves them
    away. In the rows being released the old projector keeps the present error to the target; in the
    rows being acquired the new one removes the share :math:`1 - (m/m_0)^3` of it, with
    m = n + 1 − k and m₀ before the step: at weight 1 the error would fall with m³, to zero without
    a jump of speed or acceleration.
    """

    def __init__(
        self,
        old: Resolver,
        new: Resolver,
        common: Resolver,
        previous: mink.SE3,
        steps: tuple[float, float],
        blend: int,
    ) -> None:
        """Blend ``old`` and ``new``, of the row before at steps[0] and of this one at steps[1].

        ``previous`` is the pose of the row before, ``blend`` is n.
        """
        self.old, self.new, self.common, self.previous = old, new, common, previous
        self.task, self.limits = common.task, common.limits
        last, x = blend + 1.0, steps[1] / (blend + 1.0)
        self._weight = x * x * (3.0 - 2.0 * x)
        self._share = 1.0 - ((last - steps[1]) / (last - steps[0])) ** 3

    def aim(self, index: int) -> None:
        """Set it for all three resolvers."""
        for resolver in (self.old, self.new, self.common):
            resolver.aim(index)

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The combination, or a correction of the common rows."""
        if not first:
            return self.common.displacement(configuration, first=False)
        target, task, weight = self.task.target, self.task, self._weight
        assert target is not None
        pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        held = _towards(target @ self.previous.inverse() @ pose, target, task.projector, 1.0)
        self.old.task.set_target(held)
        self.new.task.set_target(_towards(held, target, self.new.task.projector, self._share))
        old = self.old.displacement(configuration, first=True)
        new = self.new.displacement(configuration, first=True)
        return Iteration(
            (1.0 - weight) * old.dq + weight * new.dq,
            (1.0 - weight) * old.scale + weight * new.scale,
            tuple(dict.fromkeys(itertools.chain(old.binding, new.binding))),
            max(old.status, new.status, key=lambda status: status.severity),
        )


def _towards(pose: mink.SE3, target: mink.SE3, projector: TwistProjector, share: float) -> mink.SE3:
    """``pose`` moved by a share of its task error."""
    rotation, goal = pose.rotation(), target.rotation()
    error = share * twist_error(
        rotation.as_matrix(), pose.translation(), goal.as_matrix(), target.translation(), projector
    )
    return mink.SE3.from_rotation_and_translation(
        (mink.SO3.exp(error[3:]) @ rotation).normalize(), pose.translation() + error[:3]
    )

"""Change of the projector along a path, at once or blended over several waypoints."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.following.mink_step import MinkLimits, MinkResolver
from qp_twist.following.resolver import Iteration, Resolver, make_resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector, twist_error
from qp_twist.paths import METHODS, MethodSettings, PathTask, Waypoints


def resolvers_along(
    path_task: PathTask,
    path: Waypoints,
    method: str,
    settings: MethodSettings,
    solver: str,
    *,
    accelerations: bool = True,
) -> list[Resolver]:
    """The resolvers of the rows of a path: that of the projector in force, or a blend of two.

    A method that fixes the whole twist has a single one: it meets every projector. Without
    ``accelerations`` their limits are left out.
    """
    peer = METHODS[method].peer
    limits = (MinkLimits if peer else WaypointLimits)(path_task, accelerations=accelerations)
    made = dict[int, Resolver]()

    def of(projector: TwistProjector) -> Resolver:
        if id(projector) not in made:
            given = path_task, method, settings, projector, solver
            made[id(projector)] = (
                MinkResolver(*given, limits)
                if isinstance(limits, MinkLimits)
                else make_resolver(*given, limits)
            )
        return made[id(projector)]

    if METHODS[method].whole_twist:
        return [of(path_task.operational)] * len(path.s)
    resolvers = [of(projector) for projector in path.projectors]
    for segment, before in zip(path_task.segments, path_task.projectors, strict=False):
        steps = path.s - segment.first + 1.0
        for k in np.flatnonzero(segment.blended(path.s)).tolist():
            ramp = Ramp(float(steps[k - 1]), float(steps[k]), segment.blend)
            pair = of(before), of(segment.projector)
            resolvers[k] = BlendingResolver(*pair, resolvers[k], path.target(k - 1), ramp)
    return resolvers


@dataclass(frozen=True)
class Ramp:
    r"""Progress of a blend over ``length`` waypoints, from one row of the path to the next.

    With n = length, the waypoint before the blend is step 0, the first one after it step n + 1.
    """

    before: float
    step: float
    length: int

    @property
    def weight(self) -> float:
        r"""α, the weight of the new projector's displacement.

        :math:`3s^2 - 2s^3` with :math:`s = step/(n+1)`: its slope is zero at both ends and at most
        1.5.
        """
        s = self.step / (self.length + 1)
        return s * s * (3.0 - 2.0 * s)

    @property
    def share(self) -> float:
        r"""Share of the error in the acquired rows that the new projector's step removes.

        :math:`1 - (m/m_0)^3` with m = n + 1 − step remaining waypoints, and m₀ before the step. At
        weight 1 the error would fall with m³, to zero at step n + 1 without a jump of speed or
        acceleration.
        """
        last = self.length + 1
        return 1.0 - ((last - self.step) / (last - self.before)) ** 3


class BlendingResolver(Resolver):
    r"""A waypoint between two projectors.

    The first iteration is the convex combination

    .. math:: \Delta\mathbf q = (1-\alpha)\,\Delta\mathbf q_{old} + \alpha\,\Delta\mathbf q_{new}

    of the method's displacements with either projector. Bounds and rows G q̇ ≤ g are convex, and
    the common rows hold in both, so they hold in the combination. The other iterations correct the
    common rows only: otherwise they would undo the blend.

    Rows of only one projector are not corrected to the waypoint, since the other one moves them
    away. In the rows being released the old projector keeps the present error to the target; in the
    rows being acquired the new one removes the share of :class:`Ramp` of the error. So the
    correction starts and ends at rest.

    Attributes:
        task: The common rows.
    """

    def __init__(
        self, old: Resolver, new: Resolver, common: Resolver, previous: mink.SE3, ramp: Ramp
    ) -> None:
        """Wrap the resolvers of both projectors and of their common rows.

        Args:
            old: Resolver of the segment before.
            new: Resolver of the segment that begins.
            common: Resolver of the common rows; its limits are those of the other two.
            previous: The previous waypoint.
            ramp: Progress of the blend.
        """
        self.old, self.new, self.common = old, new, common
        self.task = common.task
        self.limits = common.limits
        self.previous = previous
        self.ramp = ramp

    def aim(self, plan: Array, index: int) -> None:
        """Set it for all three resolvers."""
        for resolver in (self.old, self.new, self.common):
            resolver.aim(plan, index)

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The combination, or a correction of the common rows."""
        if not first:
            return self.common.displacement(configuration, first=False)
        target, task = self.task.target, self.task
        assert target is not None
        pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        carried = target @ self.previous.inverse() @ pose
        held = towards(carried, target, task.projector, 1.0)
        self.old.task.set_target(held)
        self.new.task.set_target(towards(held, target, self.new.task.projector, self.ramp.share))
        old = self.old.displacement(configuration, first=True)
        new = self.new.displacement(configuration, first=True)
        weight = self.ramp.weight
        return Iteration(
            (1.0 - weight) * old.dq + weight * new.dq,
            (1.0 - weight) * old.scale + weight * new.scale,
            tuple(dict.fromkeys(itertools.chain(old.binding, new.binding))),
            max(old.status, new.status, key=lambda status: status.severity),
        )


def towards(pose: mink.SE3, target: mink.SE3, projector: TwistProjector, share: float) -> mink.SE3:
    """``pose`` moved by a share of its task error."""
    rotation = pose.rotation()
    error = twist_error(
        rotation.as_matrix(),
        pose.translation(),
        target.rotation().as_matrix(),
        target.translation(),
        projector,
    )
    return mink.SE3.from_rotation_and_translation(
        (mink.SO3.exp(share * error[3:]) @ rotation).normalize(),
        pose.translation() + share * error[:3],
    )

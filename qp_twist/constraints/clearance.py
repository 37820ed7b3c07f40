"""Clearance: what must not touch, as a constraint like any other."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask, number
from qp_twist.constraints.colliding_pairs import (
    check_shapes,
    colliding_pairs,
    geom_name,
    geoms_of,
)
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput

if TYPE_CHECKING:
    from qp_twist.constraints.shapes import MovingShapes

HORIZON = 0.2
"""Distance beyond the asked one from which on a step has a row for a pair, m."""
RESOLUTION = 1e-5
"""How much nearer a pair may be than the least distance that is found on a motion, m."""
_NEAR, _HALVINGS = 0.1, 30
"""Distance above which only bounds are computed at first, m; largest number of halvings."""
_PARTS = 8
"""Parts of a step in which the place is looked for where it comes too near."""
PLANNED = 8
"""Largest number of rows for a configuration of a plan, or one to which a step leads: those of the
nearest pairs."""
PLANNED_WITHIN = 0.3
"""Margin below which a plan has a row for a pair, m."""


class NearestPair(NamedTuple):
    """Where a motion is nearest to what it must not touch."""

    distance: float
    """Distance of the pair, m; negative by the depth of penetration."""
    at: float
    """Row of the motion, from 0; 3.5 is half way between the fourth and the fifth."""
    pair: str
    """Name of the pair."""


class Clearance(Constraint):
    r"""Keep every pair of geoms that may collide at a distance.

    .. math:: m_{ab}(\mathbf q) = d_{ab}(\mathbf q) - d_{min} \ge 0

    with the distance :math:`d_{ab}` of two convex geoms, negative by the depth of penetration where
    they overlap. Its derivative is that of the nearest points along the line that joins them,

    .. math:: \nabla d_{ab} = \mathbf n^T (\mathbf J_a - \mathbf J_b), \qquad
        \mathbf n = (\mathbf p_a - \mathbf p_b) / d_{ab}.

    Pairs are those that MuJoCo would test for contact (``contype`` and ``conaffinity``, without
    ``<exclude>``), without bodies that a joint connects, and without pairs of which no joint moves
    one against the other. Meshes count as their convex hulls, as in MuJoCo.

    A step keeps a margin after integration, too: where it would lead too near,
    :class:`~qp_twist.Controller` adds rows of the distances there. With acceleration limits a step
    is one from which the joints can stop in time, braking in proportion: with the time T in which
    they then come to rest, the margin is kept on the whole way to
    :math:`\mathbf q + \dot{\mathbf q}\,(dt + T/2)`. The next step may brake so, and so may all that
    follow. A mocap body is expected to go on as it moved between the last two steps; one that comes
    faster than the joints can give way is not avoided.

    Attributes:
        model: The robot and what is around it.
        distance: d_min, m.
        pairs: Ids of the two geoms of each pair, (P, 2).
        ignored: The pairs of names that may touch.
        has_begun: Whether a step is being computed, possibly several times.
        velocity: Velocity of the joints before the next step, rad/s or m/s, (nv,).
        hardest: Acceleration limits of the joints, rad/s² or m/s², (nv,); ∞ where there are none.
    """

    kind = "clearance"

    def __init__(
        self,
        model: mujoco.MjModel,
        distance: float = 0.005,
        ignore: Iterable[Sequence[str]] = (),
        *,
        recovery_speed: float = 0.1,
    ) -> None:
        """Find the pairs.

        Args:
            model: The robot and what is around it.
            distance: d_min, m.
            ignore: Pairs of names of geoms or bodies that may touch; a body stands for its geoms
                and those of bodies fixed to it.
            recovery_speed: Speed at which a pair that is too near is moved apart, m/s.

        Raises:
            InvalidInput: If the distance is negative, a name is unknown, a geom that may collide
                is a height field, or a ball or free joint moves one.
        """
        self.model = model
        self.distance = number("Clearance(distance=…)", distance, at_least=0.0)
        self.recovery_speed = number("recovery_speed", recovery_speed, above=0.0)
        self.ignored = tuple(_two_names(pair) for pair in ignore)
        pairs = colliding_pairs(model)
        for names in self.ignored:
            one, other = (np.isin(pairs, list(geoms_of(model, name))) for name in names)
            pairs = pairs[~(one & other[:, ::-1]).any(axis=1)]
        check_shapes(model, pairs)
        self.pairs: Indices = pairs
        self.names = tuple(f"{geom_name(model, a)} to {geom_name(model, b)}" for a, b in pairs)
        self.units = ("m",) * len(pairs)
        self.has_begun = False
        self.velocity, self.hardest = np.zeros(model.nv), np.full(model.nv, np.inf)
        #: The pairs near enough for a row in the step, and those of all its rows, (k,).
        self._shown: Indices = np.zeros(0, dtype=np.intp)
        self._named: Indices = self._shown
        #: The margins that pairs may have after the step: 0, or less for those that return, (P,).
        self._floor: Array = np.zeros(len(pairs))
        #: The derivatives of their margins at its beginning, 0 of those that have no row, (P, nv).
        self._gradients: Array = np.zeros((len(pairs), model.nv))
        #: Rows of where solutions of the step that is being computed led too near: the pairs (k,),
        #: and G and h.
        self._corrections: tuple[Indices, Array, Array] = self._none()

    @cached_property
    def _shapes(self) -> MovingShapes:
        from qp_twist.constraints.shapes import MovingShapes  # numba takes half a second

        return MovingShapes(self.model, self.pairs)

    # ------------------------------------------------------------------ as every constraint

    def margins(self, q: Array) -> Array:
        """Distances less :attr:`distance`, m, (N, P); negative by the depth of penetration."""
        return self.bounded(q, np.inf)

    def bounded(self, q: Array, enough: float) -> Array:
        """Margins (N, P), m; above ``enough`` lower bounds of them, which take less time."""
        margins: Array = self._shapes.distances(q, enough + self.distance) - self.distance
        return margins

    def inside(self, q: Array, tolerance: float) -> Mask:
        """Which configurations q (N, nq) violate no margin by more than the tolerance, m, (N,)."""
        return self.first_violated(q, tolerance) < 0

    def gradients(self, q: Array) -> Array:
        """Derivatives of the margins, (N, P, nv), 1 or m/rad."""
        every = np.arange(len(self.pairs))
        return self._shapes.gradients(q, np.broadcast_to(every, (len(q), len(every))))

    def gradients_of(self, q: Array, which: Mask) -> Array:
        """Those of the pairs ``which`` (N, P), and 0 for the others."""
        return self._shapes.gradients(q, np.where(which, np.arange(len(self.pairs)), -1))

    def change(self, q: Array, travel: Array) -> Array:
        r"""Sum over the joints that move one geom against the other, (N, P), m.

        A hinge that travels by at most θ moves a point at the distance r from its axis by at most
        r θ; r is that of the ball around the geom at q, and what the joints behind it may add.
        """
        return self._shapes.changes(q, travel)

    def least(self, before: Array, after: Array, travel: Array) -> Array:
        """As for every constraint, with distances only where bounds of them do not suffice."""
        least: Array = self._shapes.least(before, after, travel, self.distance) - self.distance
        return least

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """Rows of the nearest pairs of each configuration, up to ``PLANNED``."""
        which, rooms = _nearest(self.bounded(q, PLANNED_WITHIN), PLANNED_WITHIN)
        rows = -self._shapes.gradients(q, which)
        none = np.zeros(which.shape[1], dtype=np.intp)
        return rows, np.where(which < 0, np.inf, rooms), none

    def begin(self, configuration: mink.Configuration, velocity: Array, hardest: Array) -> None:
        """Begin a step: its rows may be evaluated several times, its obstacles move once.

        Args:
            configuration: That of the step.
            velocity: Speed of the joints before it, rad/s or m/s, (nv,).
            hardest: Their acceleration limits, rad/s² or m/s², (nv,); ∞ where there are none.
        """
        self._shapes.take_mocap(configuration.data)
        self.velocity, self.hardest, self.has_begun = velocity, hardest, True
        self._corrections = self._none()

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The rows of one step, G Δq ≤ h, for pairs nearer than ``HORIZON``."""
        if not self.has_begun:
            self._shapes.take_mocap(configuration.data)
            self._corrections = self._none()
        q = configuration.q[None]
        now = self.bounded(q, HORIZON)[0]
        then = self._ahead(q)[0] if self._shapes.has_moved else now
        self._shown = np.flatnonzero(np.minimum(now, then) < HORIZON)
        margins = now[self._shown]
        # What an obstacle that moves takes of the margin during the step.
        taken = np.minimum(then[self._shown] - margins, 0.0)
        gradients = self._shapes.gradients(q, self._shown[None])[0]
        recovering = np.maximum(margins, -self.recovery_speed * dt)
        # Slower by dt than now, so that braking is among the steps that the rows allow.
        slower = np.maximum(np.abs(self.velocity) - self.hardest * dt, 0.0)
        time = self._spans(slower, dt)[-1] + np.zeros(len(margins))
        if np.isfinite(self.hardest).any():
            # First the joints come to rest, then they are as fast as the obstacle.
            harder = np.abs(gradients) @ np.minimum(self.hardest, 1e6)
            time += np.divide(-taken / dt, harder, out=np.zeros(len(taken)), where=harder > 0.0)
        rooms = np.where(margins > 0.0, margins * (dt / time), recovering)
        self._floor = np.zeros(len(self.pairs))
        self._floor[self._shown] = np.minimum(margins - recovering, 0.0)
        self._gradients = np.zeros((len(self.pairs), self.model.nv))
        self._gradients[self._shown] = gradients
        pairs, G, h = self._corrections
        self._named = np.concatenate([self._shown, pairs])
        return mink.Constraint(
            G=np.concatenate([-gradients, G]), h=np.concatenate([rooms + taken, h])
        )

    def _spans(self, velocity: Array, dt: float) -> Array:
        """Times for which a velocity may go on: this step; with braking after it, half, all; s."""
        braking = float((np.abs(velocity) / self.hardest).max(initial=0.0))
        whole = dt + 0.5 * braking
        return np.array([dt, max(dt, 0.5 * whole), whole])

    def row_name(self, row: int) -> str:
        """Name of the pair of a row of the last step."""
        return self.names[int(self._named[row])]

    def falls_short(self, configuration: mink.Configuration, velocity: Array, dt: float) -> float:
        """How far the last step's velocity leads below its margins, m, 0 if it does not.

        With acceleration limits also how far it would, if the joints braked in proportion from then
        on: they then move on straight, by half of what they move in the time until they are at
        rest. Where it does, further rows of this step are those of the distances there: linear in
        the difference from this solution.

        Args:
            configuration: That of the step.
            velocity: Its result, (nv,), rad/s or m/s.
            dt: Its length, s.
        """
        spans = self._spans(velocity, dt)
        spans = spans if spans[-1] > dt else spans[:1]
        there = self._there(configuration, velocity, spans)
        left = self._ahead(there) - self._floor
        short = float(np.maximum(-left, 0.0).max(initial=0.0))
        if short > 0.0:
            self._correct(there, left, spans, velocity, dt)
            # Where it leads through the middle of something, the way out is not ahead: the row is
            # that of where it comes too near.
            spans = spans[-1] * np.arange(1, _PARTS + 1) / _PARTS
            there = self._there(configuration, velocity, spans)
            left = self._ahead(there) - self._floor
            before = np.minimum.accumulate(left, axis=0)
            left[1:][before[:-1] < 0.0] = 0.0  # later ones
            self._correct(there, left, spans, velocity, dt)
        return short

    def _there(self, configuration: mink.Configuration, velocity: Array, spans: Array) -> Array:
        """Configurations (K, nq) to which a velocity leads in times ``spans`` (K,), s."""
        there = np.tile(configuration.q, (len(spans), 1))
        for row, span in zip(there, spans, strict=True):
            mujoco.mj_integratePos(self.model, row, velocity, span)
        return there

    def _correct(self, there: Array, left: Array, spans: Array, velocity: Array, dt: float) -> None:
        """Add rows for what is ``left`` of margins (K, P) at ``there`` (K, nq), after spans."""
        which, margins = _nearest(left, 0.0)
        gradients = self._shapes.gradients(there, which, ahead=True)
        rates = gradients @ velocity
        # On the far side of something the way out would be ahead.
        begin = self._gradients[which]
        turned = np.einsum("sin,sin->si", gradients, begin) < 0.0
        far = np.where(begin.any(axis=2), turned, rates >= 0.0)
        taken = (which >= 0) & ~far
        rooms = (margins / spans[:, None] - rates) * dt
        pairs, G, h = self._corrections
        self._corrections = (
            np.concatenate([pairs, which[taken]]),
            np.concatenate([G, -gradients[taken]]),
            np.concatenate([h, rooms[taken]]),
        )

    def _none(self) -> tuple[Indices, Array, Array]:
        """No corrections."""
        return np.zeros(0, dtype=np.intp), np.zeros((0, self.model.nv)), np.zeros(0)

    def _ahead(self, q: Array) -> Array:
        """Margins as :meth:`bounded`, with mocap bodies where they are expected after a step."""
        return self._shapes.distances(q, HORIZON + self.distance, ahead=True) - self.distance

    def nearest(self, q: Array) -> NearestPair | None:
        """The least distance on a motion whose joints go straight from row to row of q (N, nq).

        Between the rows it is searched by subdivision, until no part can be nearer by
        10 µm; ``None`` if there are no pairs.
        """
        if not len(self.pairs):
            return None
        q = np.asarray(q, dtype=np.float64)
        begin, share, step = np.arange(len(q) - 1), np.zeros(len(q) - 1), 1.0
        best = NearestPair(np.inf, 0.0, "")
        at = np.arange(len(q), dtype=np.float64)
        points = q
        for _ in range(_HALVINGS):
            best = self._nearer(best, points, at)
            left = q[begin] + share[:, None] * (q[begin + 1] - q[begin])
            right = left + step * (q[begin + 1] - q[begin])
            least = self._shapes.least(left, right, np.abs(right - left), best.distance)
            open_ = least.min(axis=1) < best.distance - RESOLUTION
            begin, share, step = begin[open_], share[open_], 0.5 * step
            if not len(begin):
                break
            points = 0.5 * (left[open_] + right[open_])
            at = begin + share + step
            begin, share = np.tile(begin, 2), np.concatenate([share, share + step])
        return best

    def _nearer(self, best: NearestPair, q: Array, at: Array) -> NearestPair:
        """The nearest of the best so far and configurations q (K, nq) at places ``at`` (K,)."""
        enough = min(best.distance, _NEAR)
        found = self._shapes.distances(q, enough)
        if found.min() > enough and best.distance > enough:  # only bounds are known so far
            found = self._shapes.distances(q, np.inf)
        row, pair = np.unravel_index(int(np.argmin(found)), found.shape)
        if found[row, pair] >= best.distance:
            return best
        return NearestPair(float(found[row, pair]), float(at[row]), self.names[pair])

    def closest(self, q: Array) -> tuple[Array, Indices]:
        """Distance of the nearest pair at configurations q (N, nq), m, (N,), and its index, (N,).

        Without pairs infinite distances, and the index −1.
        """
        q = np.asarray(q, dtype=np.float64)
        if not len(self.pairs):
            return np.full(len(q), np.inf), np.full(len(q), -1)
        found = self._shapes.distances(q, _NEAR)
        far = found.min(axis=1) > _NEAR
        found[far] = self._shapes.distances(q[far], np.inf)
        pair = found.argmin(axis=1)
        return found[np.arange(len(q)), pair], pair

    def first_violated(self, q: Array, tolerance: float = 0.0) -> Indices:
        """Index of the first pair that is nearer than asked by more than the tolerance, m, (N,).

        At configurations q (N, nq), in the order of ``pairs``; −1 where none is.
        """
        return self._shapes.first_below(q, self.distance - tolerance)

    def without_pairs(self) -> Clearance:
        """A clearance of the same model that asks for nothing."""
        empty = copy.copy(self)
        empty.pairs, empty.names, empty.units = self.pairs[:0], (), ()
        empty._floor = self._floor[:0]
        return empty

    def __getstate__(self) -> dict[str, Any]:
        """State without the shapes, whose views would no longer share memory."""
        return {name: value for name, value in self.__dict__.items() if name != "_shapes"}

    def __repr__(self) -> str:
        return f"Clearance({len(self.pairs)} pairs, {1e3 * self.distance:g} mm)"


def _nearest(margins: Array, below: float) -> tuple[Indices, Array]:
    """Indices and margins of the nearest pairs (N, k) of margins (N, P), −1 for those not below."""
    which = np.argsort(margins, axis=1)[:, :PLANNED]
    found = np.take_along_axis(margins, which, axis=1)
    return np.where(found < below, which, -1), found


def _two_names(pair: Any) -> tuple[str, str]:
    if (
        isinstance(pair, (tuple, list))
        and len(pair) == 2
        and all(isinstance(name, str) for name in pair)
    ):
        return pair[0], pair[1]
    raise InvalidInput(
        f"Clearance(ignore=…): expected pairs of names of geoms or bodies, got {pair!r}."
    )

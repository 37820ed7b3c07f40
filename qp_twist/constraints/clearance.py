"""Clearance: what must not touch, as a constraint like any other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, Mask, checked, instance, number
from qp_twist.constraints.colliding_pairs import (
    check_shapes,
    colliding_pairs,
    geom_name,
    geoms_of,
)
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.kinematics.frame import same_structure

if TYPE_CHECKING:
    from qp_twist.constraints.clearance_step import ClearanceStep, PairRows
    from qp_twist.constraints.shapes import MovingShapes

RESOLUTION = 1e-5
"""How much nearer a pair may be than the least distance that is found on a motion, m."""
_NEAR, _HALVINGS = 0.1, 30
"""Distance above which only bounds are computed at first, m; largest number of halvings."""
PLANNED = 8
"""Largest number of rows for a configuration of a plan: those of the nearest pairs."""
PLANNED_WITHIN = 0.3
"""Margin below which a plan has a row for a pair, m."""
_MOSTLY_WITHIN = 0.15
"""Margin within which there are mostly so many pairs: these are looked for first, m."""


def _length(clearance: Clearance, name: str, value: float) -> float:
    return number(f"Clearance({name}=…)", value, at_least=0.0)


def _speed(clearance: Clearance, name: str, value: float) -> float:
    return number(f"Clearance({name}=…)", value, above=0.0)


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
    is one after which the margin is kept while all joints brake to rest, each as hard as it may
    (``qp_twist/kernel/clearance_rows.py``). The next step may brake so, and so may all that follow.
    A mocap body is expected to go on as it moved between the last two steps, and kept clear of by
    as much more as it was not where it was expected: what changes its speed may do so again. One
    that comes faster than the joints can give way is not avoided.

    Attributes:
        model: The robot and what is around it.
        distance: d_min, m; it may be changed between two steps.
        recovery_speed: Speed at which a pair that is too near is moved apart, m/s; likewise.
        pairs: Ids of the two geoms of each pair, (P, 2).
        ignored: The pairs of names that may touch.
        has_begun: Whether a step is being computed, possibly several times.
    """

    kind = "clearance"
    distance: float = checked(_length)
    recovery_speed: float = checked(_speed)

    def __init__(
        self,
        model: mujoco.MjModel,
        distance: float = 0.005,
        ignore: Iterable[Sequence[str]] = (),
        *,
        recovery_speed: float = 0.1,
        pairs: npt.ArrayLike | None = None,
    ) -> None:
        """Find the pairs, or take those that are given.

        Args:
            model: The robot and what is around it.
            distance: d_min, m.
            ignore: Pairs of names of geoms or bodies that may touch; a body stands for its geoms
                and those of bodies fixed to it.
            recovery_speed: Speed at which a pair that is too near is moved apart, m/s.
            pairs: Ids of the two geoms of each pair, (P, 2); all that may collide if ``None``.

        Raises:
            InvalidInput: If the distance is negative, a name or an id is unknown, a geom that may
                collide is a height field, or a ball or free joint moves one.
        """
        instance("Clearance(model, …)", model, mujoco.MjModel)
        self.model = model
        self.distance, self.recovery_speed = distance, recovery_speed
        if not isinstance(ignore, Iterable):
            raise InvalidInput(f"Clearance(ignore=…): expected pairs of names, got {ignore!r}.")
        self.ignored = tuple(_two_names(pair) for pair in ignore)
        found = colliding_pairs(model) if pairs is None else _ids(pairs, model.ngeom)
        for names in self.ignored:
            one, other = (np.isin(found, list(geoms_of(model, name))) for name in names)
            found = found[~(one & other[:, ::-1]).any(axis=1)]
        check_shapes(model, found)
        self.pairs: Indices = found
        self.names = tuple(f"{geom_name(model, a)} to {geom_name(model, b)}" for a, b in found)
        self.units = ("m",) * len(found)
        self.has_begun = False

    @cached_property
    def _shapes(self) -> MovingShapes:
        from qp_twist.constraints.shapes import MovingShapes  # numba takes half a second

        return MovingShapes(self.model, self.pairs)

    @cached_property
    def in_step(self) -> ClearanceStep:
        """What it is in the present step of a controller.

        :meta private:
        """
        from qp_twist.constraints.clearance_step import ClearanceStep

        ranges = JointRanges.of(self.model)
        return ClearanceStep(self._shapes, ranges)

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
        q, every = self._shapes.configurations(q), np.arange(len(self.pairs))
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

    def least(
        self, before: Array, after: Array, travel: Array, curve: Array | None = None
    ) -> Array:
        """As for every constraint, with distances only where bounds of them do not suffice.

        Where ``curve`` is known, the bound comes closer with the square of the travel: see
        ``qp_twist/kernel/clearance_kernel.py``.
        """
        shapes, asked = self._shapes, self.distance
        least: Array = shapes.least(before, after, travel, curve, asked) - asked
        return least

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """Rows of the nearest pairs of each configuration, up to ``PLANNED``."""
        margins = self.bounded(q, _MOSTLY_WITHIN)
        few = (margins < _MOSTLY_WITHIN).sum(axis=1) < PLANNED
        margins[few] = self.bounded(q[few], PLANNED_WITHIN)
        which, rooms = _nearest(margins, PLANNED_WITHIN)
        rows = -self._shapes.gradients(q, which)
        none = np.zeros(which.shape[1], dtype=np.intp)
        return rows, np.where(which < 0, np.inf, rooms), none

    def check_model(self, label: str, model: mujoco.MjModel) -> None:
        """Refuse a model whose distances are not those of this clearance's."""
        places = ("body_pos", "body_quat", "jnt_pos", "jnt_axis")
        shapes = ("geom_type", "geom_pos", "geom_quat", "geom_size", "geom_dataid")
        own = self.model
        if own is not model and not (
            same_structure(own, model)
            and all(np.array_equal(getattr(own, a), getattr(model, a)) for a in places + shapes)
        ):
            raise InvalidInput(
                f"{label}: bodies or geoms of the Clearance's model differ from those of the robot "
                "here; make the Clearance of the same model."
            )

    def begin(
        self,
        configuration: mink.Configuration,
        velocity: Array | None = None,
        hardest: Array | None = None,
        fastest: Array | None = None,
    ) -> None:
        """Begin a step: its rows may be evaluated several times, its obstacles move once.

        Args:
            configuration: That of the step.
            velocity: Velocity of the joints before it, rad/s or m/s, (nv,).
            hardest: Their acceleration limits, rad/s² or m/s², (nv,); ∞ where there are none.
            fastest: Their velocity limits, rad/s or m/s, (nv,), likewise; an array whose numbers
                do not change. What the joints cannot come near has no row.
        """
        self._shapes.take_mocap(configuration.data)
        self.in_step.distance, self.in_step.recovery = self.distance, self.recovery_speed
        self.in_step.begin(velocity, hardest, fastest)
        self.has_begun = True

    def step_rows(self, configuration: mink.Configuration, dt: float) -> PairRows:
        """The rows of one step, G q̇ ≤ g, for pairs nearer than ``HORIZON``."""
        if not self.has_begun:
            self.begin(configuration)
            self.has_begun = False
        return self.in_step.rows(configuration.data.qpos, dt)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The same as G Δq ≤ h."""
        rows = self.step_rows(configuration, dt)
        return mink.Constraint(G=rows.rows.copy(), h=rows.bounds * dt)

    def row_name(self, row: int) -> str:
        """Name of the pair of a row of the last step."""
        return self.names[int(self.in_step.pairs[row])]

    def falls_short(self, velocity: Array, dt: float) -> float:
        """How far the last step's velocity leads below its margins, m, 0 if it does not.

        With acceleration limits also how far it would, if the joints braked from then on.

        Args:
            velocity: Result of the step, (nv,), rad/s or m/s.
            dt: Its length, s.
        """
        return self.in_step.lacks(velocity, dt)

    def correct(self, velocity: Array, dt: float) -> bool:
        """Add rows of where the last step's velocity leads, after :meth:`falls_short`.

        They are linear in the difference from this velocity.

        Returns:
            Whether there are any.
        """
        return self.in_step.correct(velocity, dt)

    def nearest(self, q: Array) -> NearestPair | None:
        """The least distance on a motion whose joints go straight from row to row of q (N, nq).

        Between the rows it is searched by subdivision, until no part can be nearer by
        10 µm; ``None`` if there are no pairs or no rows.
        """
        q = self._shapes.configurations(q)
        if not len(self.pairs) or not len(q):
            return None
        begin, share, step = np.arange(len(q) - 1), np.zeros(len(q) - 1), 1.0
        best = NearestPair(np.inf, 0.0, "")
        at = np.arange(len(q), dtype=np.float64)
        points = q
        for _ in range(_HALVINGS):
            best = self._nearer(best, points, at)
            left = q[begin] + share[:, None] * (q[begin + 1] - q[begin])
            right = left + step * (q[begin + 1] - q[begin])
            travel, straight = np.abs(right - left), np.zeros_like(left)
            least = self._shapes.least(left, right, travel, straight, best.distance)
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
        q = self._shapes.configurations(q)
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
        tolerance = number("tolerance", tolerance)
        return self._shapes.first_below(q, self.distance - tolerance)

    def of_ignored(self, q: Array) -> Clearance:
        """The pairs that this one ignores, as far as they keep its distance at all of q (N, nq).

        A tool that works on a part may touch it there; where it is moved from one place of work to
        the next it must not.
        """
        every = Clearance(self.model, self.distance, recovery_speed=self.recovery_speed)
        own = set(map(tuple, self.pairs.tolist()))
        kept = (every.margins(np.asarray(q, dtype=np.float64)) >= 0.0).all(axis=0)
        kept &= np.array([tuple(pair) not in own for pair in every.pairs.tolist()], dtype=bool)
        return every._of(every.pairs[kept])

    def without_pairs(self) -> Clearance:
        """A clearance of the same model that asks for nothing."""
        return self._of(self.pairs[:0])

    def _of(self, pairs: Indices) -> Clearance:
        """The same for other pairs (P, 2)."""
        return Clearance(
            self.model, self.distance, self.ignored, recovery_speed=self.recovery_speed, pairs=pairs
        )

    def __getstate__(self) -> dict[str, Any]:
        """State without the arrays of the kernel, whose views would no longer share memory."""
        return {k: value for k, value in self.__dict__.items() if k not in ("_shapes", "in_step")}

    def __repr__(self) -> str:
        return f"Clearance({len(self.pairs)} pairs, {1e3 * self.distance:g} mm)"


def _nearest(margins: Array, below: float) -> tuple[Indices, Array]:
    """Indices and margins of the nearest pairs (N, k) of margins (N, P), −1 for those not below."""
    which: Indices = np.tile(np.arange(margins.shape[1]), (len(margins), 1))
    if margins.shape[1] > PLANNED:  # to sort all of them takes longer than to compute distances
        which = np.argpartition(margins, PLANNED, axis=1)[:, :PLANNED]
    order = np.argsort(np.take_along_axis(margins, which, axis=1), axis=1)
    which = np.take_along_axis(which, order, axis=1)
    found: Array = np.take_along_axis(margins, which, axis=1)
    return np.where(found < below, which, -1), found


def _ids(pairs: npt.ArrayLike, geoms: int) -> Indices:
    """Pairs of ids of a model with so many geoms, (P, 2)."""
    ids = np.asarray(pairs)
    if not ids.size:
        return np.zeros((0, 2), dtype=np.intp)
    fits = ids.dtype.kind in "iu" and ids.ndim == 2 and ids.shape[1] == 2
    if not fits or ((ids < 0) | (ids >= geoms)).any() or (ids[:, 0] == ids[:, 1]).any():
        raise InvalidInput(
            f"Clearance(pairs=…): expected ids of two geoms in each row, from 0 to {geoms - 1}, "
            f"got {pairs!r}."[:400]
        )
    return ids.astype(np.intp)


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

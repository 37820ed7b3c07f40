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
from qp_twist.constraints.colliding_pairs import check_shapes, colliding_pairs, geom_name, geoms_of
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.kinematics.frame import same_structure

if TYPE_CHECKING:
    from qp_twist.constraints.shapes import ClearanceStep, MovingShapes

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

    A step of a :class:`~qp_twist.Controller` keeps a margin after integration, too, and with
    acceleration limits until all joints could have braked to rest
    (``qp_twist/kernel/clearance_rows.py``). A mocap body is expected to go on as it moved between
    the last two steps; one that comes faster than the joints can give way is not avoided.

    Attributes:
        model: The robot and what is around it.
        distance: d_min, m; it may be changed between two steps.
        recovery_speed: Speed at which a pair that is too near is moved apart, m/s; likewise.
        pairs: Ids of the two geoms of each pair, (P, 2).
        ignored: The pairs of names that may touch.
    """

    kind = "clearance"
    distance: float = checked(lambda _, n, v: number(f"Clearance({n}=…)", v, at_least=0.0))
    recovery_speed: float = checked(lambda _, n, v: number(f"Clearance({n}=…)", v, above=0.0))

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

        ``ignore`` has pairs of names of geoms or bodies that may touch; a body stands for its geoms
        and those of bodies fixed to it. Without ``pairs``, ids of two geoms each (P, 2), all that
        may collide are kept apart. The others are as the attributes.

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

    @cached_property
    def _shapes(self) -> MovingShapes:
        from qp_twist.constraints.shapes import MovingShapes  # numba takes half a second

        return MovingShapes(self.model, self.pairs)

    @cached_property
    def in_step(self) -> ClearanceStep:
        """What it is in the present step of a controller.

        :meta private:
        """
        from qp_twist.constraints.shapes import ClearanceStep

        return ClearanceStep(self._shapes, JointRanges.of(self.model))

    def margins(self, q: Array) -> Array:
        """Distances less :attr:`distance`, m, (N, P); negative by the depth of penetration."""
        return self.bounded(q, np.inf)

    def bounded(self, q: Array, enough: float) -> Array:
        """Margins (N, P), m; above ``enough`` lower bounds of them, which take less time."""
        return self._shapes.distances(q, enough + self.distance) - self.distance

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
        """As for every constraint; where ``curve`` is known, sharper with the square of the travel.

        See ``qp_twist/kernel/clearance_kernel.py``.
        """
        least = self._shapes.least(before, after, travel, curve, self.distance)
        return least - self.distance

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """Rows of the nearest pairs of each configuration, up to ``PLANNED``."""
        margins = self.bounded(q, _MOSTLY_WITHIN)
        few = (margins < _MOSTLY_WITHIN).sum(axis=1) < PLANNED
        margins[few] = self.bounded(q[few], PLANNED_WITHIN)
        which = np.argsort(margins, axis=1)[:, :PLANNED]
        rooms = np.take_along_axis(margins, which, axis=1)
        far = rooms >= PLANNED_WITHIN
        rows = -self._shapes.gradients(q, np.where(far, -1, which))
        return rows, np.where(far, np.inf, rooms), np.zeros(which.shape[1], dtype=np.intp)

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

    def step_rows(
        self, configuration: mink.Configuration, dt: float, *, begin: bool = True
    ) -> tuple[Array, Array, Indices]:
        """The rows of one step, G q̇ ≤ g, for pairs that the step can bring too near.

        Without ``begin`` those of the step that was begun last, in which obstacles move once.

        :meta private:
        """
        if begin and not self.in_step.has_begun:
            self.in_step.begin(configuration)
            self.in_step.has_begun = False
        q = configuration.data.qpos
        return self.in_step.rows(q, dt, self.distance, self.recovery_speed)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The rows of one step as G Δq ≤ h."""
        rows, bounds, *_ = self.step_rows(configuration, dt)
        return mink.Constraint(G=rows.copy(), h=bounds * dt)

    def row_name(self, row: int) -> str:
        """Name of the pair of a row of the last step."""
        return self.names[int(self.in_step.pairs[row])]

    def nearest(self, q: Array) -> NearestPair | None:
        """The least distance on a motion whose joints go straight from row to row of q (N, nq).

        Parts are halved until none can be nearer by 10 µm; ``None`` without pairs or rows.
        """
        q = self._shapes.configurations(q)
        if not len(self.pairs) or not len(q):
            return None

        def way(at: Array) -> Array:
            """Configurations at rows that need not be whole."""
            row = np.minimum(at.astype(np.intp), len(q) - 2)
            return np.asarray(q[row] + (at - row)[:, None] * (q[row + 1] - q[row]))

        best = NearestPair(np.inf, 0.0, "")
        points, at = q, np.arange(len(q), dtype=np.float64)
        starts, length = at[:-1], 1.0  # of the parts that may be nearer, in rows
        for _ in range(_HALVINGS):
            distances, pairs = self.closest(points)
            row = int(np.argmin(distances))
            if distances[row] < best.distance:
                best = NearestPair(float(distances[row]), float(at[row]), self.names[pairs[row]])
            left, right = way(starts), way(starts + length)
            travel, straight = np.abs(right - left), np.zeros_like(left)
            least = self._shapes.least(left, right, travel, straight, best.distance)
            starts = starts[least.min(axis=1) < best.distance - RESOLUTION]
            if not len(starts):
                break
            length *= 0.5
            at = starts + length
            points, starts = way(at), np.concatenate([starts, at])
        return best

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
        number_of = np.array([self.model.ngeom, 1])  # a pair, as one number
        ignored = ~np.isin(every.pairs @ number_of, self.pairs @ number_of)
        return every._of(every.pairs[ignored & (every.margins(q) >= 0.0).all(axis=0)])

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
    is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
    if not (is_pair and all(isinstance(name, str) for name in pair)):
        raise InvalidInput(
            f"Clearance(ignore=…): expected pairs of names of geoms or bodies, got {pair!r}."
        )
    return pair[0], pair[1]

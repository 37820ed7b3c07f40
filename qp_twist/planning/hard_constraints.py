"""Hard bands and constraints of a path, for many configurations at many waypoints at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Clearance, JointCouplings
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import FramePair, SerialChain, Stretch, ToleranceBand, check_bands
from qp_twist.paths import PathTask, Waypoints
from qp_twist.referee import PROVEN, Intervals, Tolerances, constraints_left, fewer_rows

Poses = tuple[Array, Array]

WITHIN = 1e-9
"""Violation at a waypoint that counts as rounding, rad or m."""
ROUNDED = {"rad": WITHIN, "m": WITHIN}
BETWEEN = {"rad": Tolerances().axis, "m": Tolerances().position}
"""Largest violation between two waypoints, with linearly interpolated joints: the tolerance of a
check."""
NARROWEST = 1e-6
"""Smallest width of a band, rad or m: Newton's method keeps waypoints to 1e-9."""
SHARES = (0.25, 0.5, 0.75)
"""Shares of an interval at which searches and programs evaluate the margins."""


class HardConstraints:
    r"""The hard bands and the constraints of a path task, one column for each of their margins.

    Soft bands are costs, which a plan ignores. Each value φ of a band has a margin
    :math:`\min(\varphi - lower,\; upper - \varphi)`, rad or m, nonnegative inside, and ∞ where the
    projector in force fixes the value anyway. The constraints' margins follow those of the bands.

    Attributes:
        names: Name of each of the k margins in messages.
        units: ``"rad"`` or ``"m"`` of each.
        halves: Half the width of each range, rad or m, (k,); ∞ for constraints.
    """

    def __init__(
        self, path_task: PathTask, chain: SerialChain, path: Waypoints | None = None
    ) -> None:
        """Read the bands of a task whose frame is moved by ``chain``, at points of its path.

        Raises:
            InvalidInput: If a band contradicts a projector of the path, or has no width.
        """
        self.chain, self._path_task = chain, path_task
        hard = [(k, band) for k, band in enumerate(path_task.bands) if band.weight is None]
        self.bands: tuple[ToleranceBand, ...] = tuple(band for _, band in hard)
        self.constraints = tuple(c for c in path_task.stated_constraints if c.names)
        names, units, widths = [], [], []
        for k, band in hard:
            several = len(band.ranges) > 1
            for axis, range_ in zip("xyz", band.ranges, strict=False):
                names.append(f"bands[{k}], {band!r}" + (f", along {axis}" if several else ""))
                widths.append(0.5 * (range_.upper - range_.lower))
                units.append(band.unit)
        self._values = len(names)
        for k, constraint in enumerate(self.constraints):
            # A clearance is often not stated, but follows from the scene.
            is_clearance = isinstance(constraint, Clearance)
            label = constraint.kind if is_clearance else f"constraints[{k}]"
            names += [f"{label}, {name}" for name in constraint.names]
            units += constraint.units
        self.names, self.units = tuple(names), tuple(units)
        self.halves: Array = np.array(widths + [np.inf] * (len(names) - len(widths)))
        if not self:
            return
        self._path = path = path or path_task.at()
        for projector in {id(T): T for T in path.projectors}.values():
            check_bands(path_task.name, self.bands, projector)
        for name, half in zip(self.names, self.halves, strict=True):
            if 2.0 * half < NARROWEST:
                raise InvalidInput(
                    f"{path_task.name}: {name} is narrower than {NARROWEST:g} rad or m; hold that "
                    "direction by the projector, or widen the band."
                )
        self._intervals = Intervals(path.rotations, path.positions, fewer_rows(path.projectors))
        self._fixed: Mask = np.zeros((len(path.projectors), len(names)), dtype=bool)
        for fixed, T in zip(self._fixed, path.projectors, strict=True):
            fixed[: self._values] = [f for band in self.bands for f in band.fixed(T)]

    def __len__(self) -> int:
        return len(self.bands) + len(self.constraints)

    @property
    def between_allowed(self) -> Array:
        """The violation of each margin that is allowed between waypoints, rad or m, (k,)."""
        return np.array([BETWEEN[unit] for unit in self.units])

    @property
    def cuts(self) -> bool:
        """Whether a constraint may cut a self-motion manifold into pieces: any but couplings.

        A search keeps these as equality rows (:class:`~qp_twist.planning.path_rows.PathRows`).
        """
        return bool(self.bands) or not all(isinstance(c, JointCouplings) for c in self.constraints)

    @property
    def of_bodies(self) -> bool:
        """Whether they depend on where the bodies are alone, not on whole turns of the joints."""
        return all(isinstance(c, Clearance) for c in self.constraints)

    @property
    def lazy(self) -> bool:
        """Whether programs evaluate margins between waypoints only where one was violated."""
        # Only clearances take longer than all else.
        return not self.bands and self.of_bodies

    def margins(self, q: Array, at: Indices) -> Array:
        """Margins (K, k) of configurations q (K, nv) at waypoints (K,), rad or m.

        Those above 0 may be lower bounds (:meth:`~qp_twist.Constraint.bounded`).
        """
        if not self:
            return np.zeros((len(q), 0))
        margins = self._margins(self._pair(*self.chain.poses(q), at), q)
        return np.where(self._fixed[at], np.inf, margins)

    def band_margins(self, rotations: Array, positions: Array, at: Indices) -> Array:
        """Margins of the bands at poses of the frame: rotations (K, 3, 3) and origins (K, 3)."""
        if not self.bands:
            return np.zeros((len(at), 0))
        margins = self._of_bands(self._pair(rotations, positions, at))
        return np.where(self._fixed[at][:, : self._values], np.inf, margins)

    def inside(self, q: Array, at: Indices, violations: dict[str, float] = ROUNDED) -> Mask:
        """Which configurations q (K, nv) are inside all bands and constraints, (K,).

        But for ``violations``, in rad and in m.
        """
        inside = np.ones(len(q), dtype=bool)
        if self.bands:
            margins = self.band_margins(*self.chain.poses(q), at)
            allowed = np.array([violations[unit] for unit in self.units[: self._values]])
            inside = np.asarray((margins >= -allowed).all(axis=1))
        for constraint in self.constraints:
            inside[inside] = constraint.inside(q[inside], violations[constraint.units[0]])
        return inside

    def rows(self, q: Array, at: Indices) -> tuple[Array, Array, Indices]:
        """Linear rows that keep the margins above 0, to first order: rows · Δq ≤ rooms.

        Returns:
            Rows (K, m, nv), rooms (K, m), rad or m, possibly ∞, and the index of each row's margin,
            (m,).
        """
        rotations, positions, J = self.chain.poses_and_jacobians(q)
        return self._rows(self._pair(rotations, positions, at), q, J, self._fixed[at])

    def rows_between(self, q: Array, at: Indices, share: Array) -> tuple[Array, Array, Indices]:
        """The rows of a path q (N, nv) at shares (K,) of intervals between waypoints.

        Moving the frame also moves the place of the path that it is measured against.
        """
        way = q[at] + share[:, None] * (q[at + 1] - q[at])
        rotations, positions, J = self.chain.poses_and_jacobians(way)
        pair = self._on_the_way(rotations, positions, at, share)
        progress = self._intervals.gradient(rotations, positions, at, share) if self.bands else None
        return self._rows(pair, way, J, np.zeros((1, len(self.names)), dtype=bool), progress)

    def _rows(
        self, pair: FramePair, q: Array, J: Array, fixed: Mask, progress: Array | None = None
    ) -> tuple[Array, Array, Indices]:
        """Rows at poses; the target moves by its twist with the ``progress`` on a twist (K, 6)."""
        found, first = [], 0
        for band in self.bands:
            rows, rooms = band.rows(pair)
            values = np.arange(first, first + rows.shape[1])
            rooms = np.where(fixed[:, values, None], np.inf, rooms)
            count = rows.shape[1] * rows.shape[2]  # stated: there may be no pose
            on_twist = rows.reshape(len(J), count, 6)
            if progress is not None:
                carried = on_twist @ band.carried(pair)[:, :, None]
                on_twist = on_twist - carried * progress[:, None, :]
            on_q = on_twist @ J
            found.append((on_q, rooms.reshape(len(J), count), np.repeat(values, rows.shape[2])))
            first += rows.shape[1]
        for constraint in self.constraints:
            rows, rooms, of = constraint.rows(q)
            found.append((rows, rooms, first + of))
            first += len(constraint.names)
        blocks, rooms_of, numbers = zip(*found, strict=True)
        return (
            np.concatenate(blocks, axis=1),
            np.concatenate(rooms_of, axis=1),
            np.concatenate(numbers),
        )

    def returns(self, q: Array, at: Indices, inset: float) -> tuple[Array, Array]:
        """Rows that bring negative margins back to ``inset``: rows · Δq = sides.

        Returns:
            Rows (K, m, nv) and sides (K, m), rad or m, with the most negative margins m of any
            configuration; zeros where there are fewer.
        """
        rotations, positions, J = self.chain.poses_and_jacobians(q)
        pair = self._pair(rotations, positions, at)
        margins = np.where(self._fixed[at], np.inf, self._margins(pair, q))
        rising = []
        for band in self.bands:
            middle = np.array([0.5 * (range_.lower + range_.upper) for range_ in band.ranges])
            sign = np.where(band.values(pair) < middle, 1.0, -1.0)
            rising.append(sign[:, :, None] * band.gradients(pair) @ J)
        outside = margins < -WITHIN
        first = self._values
        for constraint in self.constraints:
            last = first + len(constraint.names)
            rising.append(constraint.gradients_of(q, outside[:, first:last]))
            first = last
        # Of a hundred pairs of geoms a few touch: only these take part in the equations.
        negative = np.argsort(~outside, axis=1, kind="stable")[:, : outside.sum(axis=1).max()]
        outside = np.take_along_axis(outside, negative, axis=1)
        margins = np.take_along_axis(margins, negative, axis=1)
        rows = np.take_along_axis(np.concatenate(rising, axis=1), negative[:, :, None], axis=1)
        depth = np.minimum(inset, 0.5 * self.halves)[negative]
        sides = np.where(outside, depth - np.where(outside, margins, 0.0), 0.0)
        return np.where(outside[:, :, None], rows, 0.0), sides

    def may_keep_bands(self, ends: tuple[Poses, Poses], at: Indices, turn: float) -> Mask:
        """Whether a frame that turns in place by an angle may be inside all bands meanwhile, (K,).

        ``ends`` are its rotations (K, 3, 3) and origins (K, 3) before and after, at waypoints (K,).
        """
        none = np.zeros(len(at))
        stretch = Stretch(none + turn, none, none, none, none, none)
        before, after = (self._pair(*poses, at) for poses in ends)
        held = [band.may_hold(before, after, stretch) for band in self.bands]
        fixed = self._fixed[at][:, : self._values]
        return np.asarray((np.concatenate(held, axis=1) | fixed).all(axis=1))

    def margins_between(self, begin: Array, end: Array, at: Indices, share: Array) -> Array:
        """Margins (K, k) at shares (K,) of intervals between waypoints, rad or m.

        The joints go straight from ``begin`` to ``end`` (K, nv) between waypoints of indices ``at``
        and the next ones; each pose is compared with the place of the path that is nearest to it
        (:class:`~qp_twist.referee.Intervals`).
        """
        q = begin + share[:, None] * (end - begin)
        return self._margins(self._on_the_way(*self.chain.poses(q), at, share), q)

    def kept_between(
        self,
        begin: Array,
        end: Array,
        at: Indices,
        violations: dict[str, float],
        shares: Sequence[float] = SHARES,
    ) -> Mask:
        """Which motions of :meth:`margins_between` keep all margins at some shares, (K,).

        But for ``violations``: the largest ones that are allowed, in rad and in m.
        """
        kept = np.ones(len(begin), dtype=bool)
        allowed = np.array([violations[unit] for unit in self.units])
        for share in shares:
            left = np.flatnonzero(kept)
            q = begin[left] + share * (end[left] - begin[left])
            if self.bands:
                of_bands = self._of_bands(
                    self._on_the_way(*self.chain.poses(q), at[left], np.full(len(left), share))
                )
                kept[left] = (of_bands >= -allowed[: self._values]).all(axis=1)
                q, left = q[kept[left]], left[kept[left]]
            for constraint in self.constraints:
                inside = constraint.inside(q, violations[constraint.units[0]])
                kept[left] = inside
                q, left = q[inside], left[inside]
        return kept

    def between(self, q: Array) -> tuple[Array, Array]:
        """Proven violation of a joint path (N, nv) between its waypoints, rad or m.

        Joints go straight; measure and proof are those of a check
        (:func:`~qp_twist.referee.constraints_left`).

        Returns:
            For each interval and margin an upper bound of the violation, (N − 1, k), at most
            :data:`BETWEEN` if the tolerance is proved; and the share of each interval at which the
            largest violation was found, (N − 1,).
        """
        if not self:
            return np.zeros((len(q) - 1, 0)), np.zeros(len(q) - 1)
        within = tuple(BETWEEN[unit] / (1.0 + PROVEN) for unit in ("m", "rad"))
        left = constraints_left(self._path_task, q, (within[0], within[1]))
        return left.bound, left.share

    def _on_the_way(
        self, rotations: Array, positions: Array, at: Indices, share: Array
    ) -> FramePair:
        """Frames at shares of intervals between waypoints, and their targets.

        A target is the path's pose at the frame's progress, which is the share itself only where
        the task's rows do not see the interval; its twist is that with the progress.
        """
        progress = self._intervals.progress(rotations, positions, at, share)[1]
        targets = self._intervals.at(at, progress)
        return FramePair(rotations, positions, *targets, self._intervals.velocity(at))

    def _margins(self, pair: FramePair, q: Array) -> Array:
        of_constraints = [constraint.bounded(q, 0.0) for constraint in self.constraints]
        return np.concatenate([self._of_bands(pair), *of_constraints], axis=1)

    def _of_bands(self, pair: FramePair) -> Array:
        margins = [band.margins(pair) for band in self.bands]
        return np.concatenate([np.zeros((len(pair.position), 0)), *margins], axis=1)

    def _pair(self, rotations: Array, positions: Array, at: Indices) -> FramePair:
        """Frames and their waypoints, at rest."""
        return FramePair(rotations, positions, self._path.rotations[at], self._path.positions[at])

"""Layers of any arm of hinges and slides: configurations that cover its self-motion manifolds."""

from __future__ import annotations

import itertools

import numpy as np
import scipy  # which loads its parts when they are first used

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.layer import Layer, centred, empty_layer, inside_limits
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.seeds import Seeds

SEEDS = 300
"""Number of random seeds for a waypoint's manifolds."""
_AGAIN, _CLIPPED, _INSET = 12, 1000, 0.1
"""Number of redraws if no seed ends inside the limits; the largest number of those that are moved
into them; and how far, as a share of each range, but at most 0.01 rad or m."""
COVERED = 2
"""Largest number of free degrees for which manifolds are covered; beyond, only the previous layer
is carried over."""
_SCATTERED = 2000
"""Number of random seeds with more than two free degrees, where no net grows from them."""
BOUNDED = 3
"""Largest number of free degrees for which the layers have a configuration near each local optimum
of z and of the margin, which the bound starts from."""
_THIN = 0.6
"""Nodes closer than this share of the spacing count as one."""
_MOST = 20_000
"""Largest number of nodes of a waypoint."""
_SAMPLED, _CORRECTED = 3000, 500
"""The same with more than two free degrees; with hard bands, too, into which each is corrected."""
_ENOUGH, _DRAWS = 500, 20
"""Number of configurations of such a layer that keep the clearance, if so many are found; and
largest number of draws for it, which take 3 ms each."""


class ManifoldNet:
    """Self-motion manifolds inside the limits, as nets of configurations.

    :class:`~qp_twist.planning.seeds.Seeds` are corrected onto the task and into its bands, with
    those of the previous layer. Where they do not cover the manifolds, a net grows from them in
    steps along the null space until it meets itself or a limit; with more than two free degrees,
    for which it would be too large, the layer has the most central of them. With ``kept``, the rows
    with a clearance, some of these keep that: what a table leaves of its own tilt may not be near
    the middle of its range, and so narrow that Newton's method alone leads out of it.

    ``spacing`` (nv,) is the distance between neighbours that differ in one joint only, rad or m: in
    joints divided by it neighbours are one apart.
    """

    def __init__(
        self,
        path_task: PathTask,
        rows: PathRows,
        spacing: float | Array,
        *,
        seeds: int = SEEDS,
        kept: PathRows | None = None,
    ) -> None:
        self.rows, self._count, self._kept = rows, seeds, kept
        self.spacing: Array = np.broadcast_to(spacing, path_task.model.nv).astype(np.float64)
        self.ranges = JointRanges.of(path_task.model)
        self.seeds = Seeds(path_task, rows, self.spacing, np.random.default_rng(0))

    def layer(self, index: int, before: Layer | None = None, *, grow: bool = True) -> Layer:
        """The configurations at a waypoint, seeded also by those of the previous layer.

        Without ``grow`` only those of the seeds: whether there are any, and why not.
        """
        freedom = int(self.rows.freedom[index])
        carried = self._carried(before if freedom > COVERED else None, index)
        seeds = self._begun(index, freedom, before, len(carried))
        covered = self.seeds.cover(index)
        lower, upper = self.ranges.lower, self.ranges.upper
        inset = np.minimum(_INSET * (upper - lower), 0.01)
        for _ in range(1 + _AGAIN):
            q, arrived = self.rows.correct(seeds, np.full(len(seeds), index))
            q = centred(q[arrived], self.ranges)
            nodes = np.vstack([carried, self._brought_inside(q, index)[0]])
            if len(nodes):
                break
            # The next seeds are those at the nearest place inside the limits, and others.
            covered = False
            clipped = np.clip(q, lower + inset, upper - inset)[:_CLIPPED]
            seeds = np.vstack([clipped, self.seeds.random(self._count)])
        else:
            return empty_layer(q, self.ranges, self.rows.hard, index)
        nodes = self._thinned(centred(nodes, self.ranges))
        if grow and not covered and 0 < freedom <= COVERED:
            nodes = self._grown(nodes, index, freedom)
        elif freedom > COVERED:
            # The same order in every layer, so that a configuration that is carried over stays.
            most = _CORRECTED if self.rows.hard else _SAMPLED
            nodes = nodes[np.argsort(self.ranges.centering(nodes), kind="stable")]
            if len(nodes) > most:
                first = self._keeping(nodes, index)[: most // 2]
                others = np.delete(np.arange(len(nodes)), first)
                nodes = nodes[np.append(first, others)[:most]]
        return inside_limits(nodes, self.pieces(nodes), self.ranges)

    def _begun(self, index: int, freedom: int, before: Layer | None, known: int) -> Array:
        """Where a layer begins, (K, nv); so many configurations are ``known`` that are clear."""
        solved = centred(self.seeds.solved(index), self.ranges)
        inside = self.ranges.inside(solved)
        if freedom > COVERED and self.seeds.arms and self._kept is not None:
            for _ in range(_DRAWS):
                if known + len(self._keeping(solved[inside], index)) >= _ENOUGH:
                    break
                solved = np.vstack([solved, centred(self.seeds.solved(index), self.ranges)])
                inside = self.ranges.inside(solved)
        if inside.any():
            solved = solved[inside]
        # What a narrow passage, or speed limits, leave of one layer goes on in the next.
        begun = [] if before is None else [centred(before.q[before.copies[0]], self.ranges)]
        if self.seeds.cover(index):
            return solved if freedom > 1 else np.vstack([*begun, solved])
        if self.rows.hard:  # many corrections into narrow bands would take long
            within = self.rows.hard.inside(solved, np.full(len(solved), index))
            solved = np.vstack([solved[within], solved[~within][:: 1 + len(solved) // self._count]])
        few = freedom <= COVERED or self.rows.hard
        count = self._count if few else _SCATTERED if not self.seeds.arms else 0
        return np.concatenate([*begun, solved, self.seeds.random(count)])

    def _keeping(self, q: Array, index: int) -> Indices:
        """Indices of the first of q (K, nv) that keep the clearance at a waypoint: enough."""
        found = np.zeros(0, dtype=np.intp)
        if self._kept is None:
            return found
        for part in np.array_split(np.arange(len(q)), 1 + len(q) // _ENOUGH):
            keeps = self._kept.hard.inside(q[part], np.full(len(part), index))
            found = np.append(found, part[keeps])
            if len(found) >= _ENOUGH:
                break
        return found

    def _carried(self, before: Layer | None, index: int) -> Array:
        """Configurations of the layer before that keep the clearance, led on inside it."""
        if before is None or self._kept is None:
            return np.zeros((0, len(self.spacing)))
        q = before.q[(before.q == centred(before.q, self.ranges)).all(axis=1)]  # without turns
        q = q[self._keeping(q, index)]
        box = (np.broadcast_to(end, q.shape) for end in (self.ranges.lower, self.ranges.upper))
        q, arrived = self._kept.correct_within(q, np.full(len(q), index), *box)
        return q[arrived]

    def _grown(self, nodes: Array, index: int, freedom: int) -> Array:
        directions = _directions(freedom)
        frontier = nodes
        while len(frontier) and len(nodes) < _MOST:
            at, net = np.full(len(frontier), index), self.seeds.tree(nodes)
            basis = self.rows.motions(frontier, at)[:, :, :freedom]
            basis = np.linalg.qr(basis / self.spacing[:, None]).Q
            ahead = frontier[:, None] + self.spacing * (directions @ basis.transpose(0, 2, 1))
            ahead = ahead.reshape(-1, nodes.shape[1])
            start = np.repeat(frontier, len(directions), axis=0)
            # Most lead to where the net is already: they are not worth a correction.
            new = ~self._covered(ahead, net)
            ahead, start = ahead[new], start[new]
            found, arrived = self.rows.correct(ahead, np.full(len(ahead), index), iterations=8)
            near = np.linalg.norm((found - start) / self.spacing, axis=1) < 2.0
            found, which = self._brought_inside(found[arrived & near], index)
            if self.rows.hard:
                start = start[arrived & near][which]
                found = found[np.linalg.norm((found - start) / self.spacing, axis=1) < 2.0]
            found = centred(found, self.ranges)
            frontier = self._thinned(found[~self._covered(found, net)])
            nodes = np.vstack([nodes, frontier])
        return nodes

    def _thinned(self, q: Array) -> Array:
        """Those of q (K, nv) that are not too close to each other."""
        if not len(q):
            return q
        close = self.seeds.tree(q).query_pairs(_THIN, output_type="ndarray")  # each once, i < j
        close = close[np.argsort(close[:, 0], kind="stable")]
        begin = np.searchsorted(close[:, 0], np.arange(len(q) + 1)).tolist()
        taken = np.zeros(len(q), dtype=bool)
        for number, (first, last) in enumerate(itertools.pairwise(begin)):
            if not taken[number]:
                taken[close[first:last, 1]] = True
        return q[~taken]

    def _covered(self, q: Array, net: scipy.spatial.KDTree) -> Mask:
        """Which of q (K, nv) are too close to a node of the net, (K,)."""
        if not len(q):
            return np.zeros(0, dtype=bool)
        distance, _ = net.query(self.seeds.scaled(q), distance_upper_bound=_THIN)
        return np.asarray(np.isfinite(distance))

    def pieces(self, q: Array) -> Indices:
        """Index of the manifold of each of q (K, nv), by the connected components of neighbours."""
        pairs = self.seeds.tree(q).query_pairs(2.0, output_type="ndarray")
        entries = np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])
        graph = scipy.sparse.coo_matrix(entries, (len(q), len(q)))
        _, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
        return np.asarray(labels, dtype=np.intp)

    def _brought_inside(self, q: Array, index: int) -> tuple[Array, Indices]:
        """Those of q (K, nv), on the waypoint, that are inside the limits up to whole turns.

        Configurations outside a hard band are corrected into it, if possible.

        Returns:
            The configurations, and which of q they come from.
        """
        within = np.ones(len(q), dtype=bool)
        if self.rows.hard:
            q, within = self.rows.correct_inside(q, np.full(len(q), index), iterations=8)
        at = centred(q, self.ranges)
        which = np.flatnonzero(self.ranges.inside(at) & within)
        return q[which], which


def _directions(freedom: int) -> Array:
    """Directions in which a net grows: unit vectors in the null space, (M, freedom)."""
    if freedom == 1:
        return np.array([[1.0], [-1.0]])
    around = np.radians(60.0) * np.arange(6)
    return np.column_stack([np.cos(around), np.sin(around)])

"""Joint moves: from one configuration to another where no path holds, touching nothing."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.constraints import Clearance, Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.certificate import amount_of
from qp_twist.referee import Tolerances, motion_limits, speeds_or_default

_INSIDE = Tolerances().band
"""Violation of a constraint that a check lets pass at a waypoint, m or rad."""
EFFORT = 3000
"""Number of random configurations after which the search ends."""
_ROOM = 0.005
"""Distance from obstacles beyond the clearance that is kept where it is possible, m: smooth motions
deviate from the straight lines that are searched."""
_STEP = 0.15
"""Longest edge of the search trees, s."""
_AROUND = 0.3
"""Every second configuration is drawn from the box around both ends, wider by this, rad or m."""
_SHORTCUTS = 150
_PIECE = np.radians(3.0)
"""Largest displacement of a joint from row to row, rad or m."""
_SHORTEST = 1e-3
"""Displacement below which an edge that is not proven free counts as blocked, rad or m."""
_CORNER, _SMALLEST_CORNER = 0.5, 0.05
"""Share of the shorter edge beside a corner that is rounded: at first, and at least."""


class NoJointMove(InvalidInput):
    """No joint move was found; ``why`` says what is in the way."""

    def __init__(self, task: str, why: str) -> None:
        super().__init__(f"{task}: no joint move was found: {why}.")
        self.why = why


class JointMoveSearch:
    r"""Searches joint moves inside the joint ranges and the constraints of a task.

    The straight line of the joints comes first. If something is in the way, two trees of random
    configurations grow from both ends until they meet (J. J. Kuffner and S. M. LaValle,
    *RRT-Connect: An efficient approach to single-query path planning*, ICRA 2000); shortcuts and
    rounded corners follow. The measure of all of them is the least time at the joints' speeds,

    .. math:: \max_j |\Delta q_j| / v_j .

    Every edge is proven by subdivision: lower bounds of the margins
    (:meth:`~qp_twist.Constraint.least`) hold for the whole of it, or it is halved. The random
    numbers are the same in every search, so that its results can be repeated.
    """

    def __init__(self, path_task: PathTask) -> None:
        self.path_task = path_task
        self.ranges = JointRanges.of(path_task.model)
        if not self.ranges.only_hinges_and_slides:
            raise InvalidInput(
                f"{path_task.name}: the robot has ball or free joints; joint moves are found for "
                "hinges and slides only."
            )
        self.speeds = speeds_or_default(motion_limits(path_task), self.ranges)
        self._constraints: Sequence[Constraint] = path_task.stated_constraints

    def seconds(self, q: Array) -> Array:
        """Least time between consecutive rows of q (N, nv) at the joints' speeds, s, (N − 1,)."""
        times: Array = (np.abs(np.diff(q, axis=0)) / self.speeds).max(axis=1, initial=0.0)
        return times

    def nearest_turn(self, q: Array, to: Array) -> Array:
        """q (N, nv), its joints without a range turned as a whole to begin nearest to ``to``."""
        endless = self.ranges.hinge & ~np.isfinite(self.ranges.upper - self.ranges.lower)
        moved: Array = q + 2.0 * np.pi * np.round((to - q[0]) / (2.0 * np.pi)) * endless
        return moved

    def found(self, begin: Array, end: Array, effort: int = EFFORT) -> Array:
        """Rows from ``begin`` to ``end``, (nv,) each, both included, (N, nv).

        The straight motion of the joints from row to row keeps ranges and constraints, proven. It
        also keeps the distance of pairs that a clearance ignores, such as tool and part, if they
        have it at both ends. ``effort`` is the largest number of random configurations.

        Raises:
            NoJointMove: If there is none, with what is in the way.
        """
        straight, task = np.array([begin, end]), self.path_task
        clearances = [c for c in task.constraints if isinstance(c, Clearance)]
        ignored = [clearance.of_ignored(straight) for clearance in clearances]
        kept = [*task.stated_constraints, *(c for c in ignored if len(c.pairs))]
        self._constraints = kept
        if self.free(straight).all():
            return _divided(straight)
        for q, which in ((begin, "begins"), (end, "ends")):
            violated = self._violated(q[None])
            if violated:
                raise NoJointMove(task.name, f"where it {which}, {violated}")
        for room in (_ROOM, 0.0) if kept else (0.0,):
            self._constraints = [_roomier(c, room) for c in kept]
            if not self.free(np.array([begin, begin, end, end]))[[0, 2]].all():
                continue  # the ends themselves have no more room
            corners = self._connected(begin, end, effort)
            if corners is not None:
                return _divided(self._rounded(self._shortened(corners)))
        raise NoJointMove(
            task.name,
            f"on the straight motion of the joints, {self._violated(_divided(straight))}, and "
            f"{effort} random configurations do not lead around it",
        )

    def free(self, q: Array) -> Mask:
        """Which straight pieces between consecutive rows of q (N, nv) are proven free, (N − 1,)."""
        within = self._within(q)
        free: Mask = within[:-1] & within[1:]
        for constraint in self._constraints:
            of = np.flatnonzero(free)
            free[of] = _kept(constraint, q[of], q[of + 1])
        return free

    def _within(self, q: Array) -> Mask:
        return np.asarray((self.ranges.room(q) >= -1e-9).all(axis=1))

    def _violated(self, q: Array) -> str:
        """What the configurations q (N, nv) violate most, in words; empty if nothing."""
        worst, text = -_INSIDE, ""
        for constraint in self._constraints:
            margins = constraint.margins(q).min(axis=0)
            k = int(np.argmin(margins))
            if margins[k] < worst:
                worst = float(margins[k])
                name, amount = constraint.names[k], amount_of(-worst, constraint.units[k])
                text = f"{name} would be outside {constraint.kind} by {amount}"
        if not text and not self._within(q).all():
            joint = int(np.argmin(self.ranges.room(q).min(axis=0)))
            text = f"{self.ranges.names[joint]} would be outside its range"
        return text

    # ------------------------------------------------------------------ search

    def _connected(self, begin: Array, end: Array, effort: int) -> Array | None:
        """Corners of a free motion, (N, nv), by two trees; ``None`` if they do not meet."""
        rng = np.random.default_rng(0)
        trees = [_Tree(begin), _Tree(end)]
        high = np.minimum(np.maximum(begin, end) + _AROUND, self.ranges.upper)
        low = np.maximum(np.minimum(begin, end) - _AROUND, self.ranges.lower)
        for count in range(effort):
            if count % 2:
                target = self.ranges.random(1, rng)[0]
                target = np.where(self.ranges.limited, target, 0.5 * (begin + end) + target)
            else:
                target = rng.uniform(np.minimum(low, high), high)
            reached = self._grown(trees[0], target, once=True)
            if reached is not None:
                met = self._grown(trees[1], trees[0].q[reached], once=False)
                if met is not None and (trees[1].q[met] == trees[0].q[reached]).all():
                    ways = [trees[0].way(reached), trees[1].way(met)]
                    if trees[0].q[0] is not begin:
                        ways.reverse()
                    return np.array([*ways[0], *ways[1][::-1][1:]])
            trees.reverse()
        return None

    def _grown(self, tree: _Tree, target: Array, *, once: bool) -> int | None:
        """Grow a tree towards a target by one edge, or until it is reached or blocked.

        Returns the last node added, or that at the target; ``None`` without any.
        """
        here = int(np.argmin((np.abs(np.array(tree.q) - target) / self.speeds).max(axis=1)))
        last = None
        while True:
            apart = float(self.seconds(np.array([tree.q[here], target]))[0])
            if apart == 0.0:
                return here
            step = min(1.0, _STEP / apart)
            q = target if step == 1.0 else tree.q[here] + step * (target - tree.q[here])
            if not self.free(np.array([tree.q[here], q]))[0]:
                return last
            here = last = tree.add(q, here)
            if once or step == 1.0:
                return last

    def _shortened(self, corners: Array) -> Array:
        """The motion with free shortcuts, (N, nv)."""
        rng = np.random.default_rng(1)
        for _ in range(_SHORTCUTS):
            if len(corners) < 3:
                break
            times = np.append(0.0, np.cumsum(self.seconds(corners)))
            ends = np.sort(rng.uniform(0.0, times[-1], 2))
            at = np.searchsorted(times, ends, side="right") - 1
            if at[0] == at[1] or at[1] >= len(corners) - 1:
                continue
            shares = (ends - times[at]) / (times[at + 1] - times[at])
            cut = corners[at] + shares[:, None] * (corners[at + 1] - corners[at])
            if self.seconds(cut)[0] < ends[1] - ends[0] and self.free(cut).all():
                corners = np.concatenate([corners[: at[0] + 1], cut, corners[at[1] + 1 :]])
        k = 1
        while k < len(corners) - 1:  # without needless corners
            if self.free(corners[[k - 1, k + 1]])[0]:
                corners = np.delete(corners, k, axis=0)
            else:
                k += 1
        return corners

    def _rounded(self, corners: Array) -> Array:
        """The motion with parabolas in place of its corners, as wide as they are free, (N, nv)."""
        rows = [corners[:1]]
        for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
            share, curve = _CORNER, corner[None]
            while share >= _SMALLEST_CORNER:
                begin, end = corner + share * (before - corner), corner + share * (after - corner)
                size = np.abs([before - corner, after - corner]).max() * 2.0 * share
                u = np.linspace(0.0, 1.0, 2 + int(np.ceil(size / _PIECE)))[:, None]
                tried = (1.0 - u) ** 2 * begin + 2.0 * u * (1.0 - u) * corner + u**2 * end
                if self.free(tried).all():
                    curve = tried
                    break
                share *= 0.5
            rows.append(curve)
        found = np.concatenate([*rows, corners[-1:]])
        moves = np.abs(np.diff(found, axis=0)).max(axis=1) > 1e-9
        rounded: Array = found[np.append(True, moves)]
        return rounded


class _Tree:
    """Configurations, each connected with one before it."""

    def __init__(self, root: Array) -> None:
        self.q, self._before = [root], [-1]

    def add(self, q: Array, before: int) -> int:
        self.q.append(q)
        self._before.append(before)
        return len(self.q) - 1

    def way(self, node: int) -> list[Array]:
        """The configurations from the root to a node."""
        found = []
        while node >= 0:
            found.append(self.q[node])
            node = self._before[node]
        return found[::-1]


def _kept(constraint: Constraint, begin: Array, end: Array) -> Mask:
    """Whether the straight motions from ``begin`` to ``end``, (K, nv), keep it, proven, (K,)."""
    kept = np.ones(len(begin), dtype=bool)
    owner = np.arange(len(begin))
    while len(owner):
        travel, straight = np.abs(end - begin), np.zeros_like(begin)
        least = constraint.least(begin, end, travel, straight).min(axis=1, initial=np.inf)
        undecided = ~(least >= -_INSIDE)
        owner, begin, end = owner[undecided], begin[undecided], end[undecided]
        middle = 0.5 * (begin + end)
        outside = travel[undecided].max(axis=1, initial=0.0) < _SHORTEST
        if len(owner):
            outside |= ~constraint.inside(middle, _INSIDE)
        kept[owner[outside]] = False
        on = kept[owner]
        owner, begin, middle, end = owner[on], begin[on], middle[on], end[on]
        owner = np.concatenate([owner, owner])
        begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
    return kept


def _roomier(constraint: Constraint, room: float) -> Constraint:
    """A clearance with so much more distance, m; other constraints as they are."""
    if not isinstance(constraint, Clearance) or not room:
        return constraint
    found = copy.copy(constraint)
    found.distance = constraint.distance + room
    return found


def _divided(q: Array) -> Array:
    """Rows q (N, nv) with more between them, so that no joint moves further than ``_PIECE``."""
    steps = np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) / _PIECE).astype(int)
    found = [
        a + (b - a) * np.arange(n)[:, None] / n
        for a, b, n in zip(q, q[1:], np.maximum(steps, 1), strict=False)
    ]
    rows: Array = np.concatenate([*found, q[-1:]])
    return rows

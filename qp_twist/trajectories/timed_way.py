"""The fastest motion along a curve from rest to rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.kernel.speed_kernel import reachable, with_jerk_limits
from qp_twist.referee import FASTER, JointMotion, Tolerances
from qp_twist.trajectories.joint_curve import JointCurve
from qp_twist.trajectories.rest_ramps import RestRamps

_COARSE = 200
"""Least number of cells, of equal length, for a first look at the speeds."""
_STEP = 0.008
"""Largest duration of a cell, s: six cells for a default ramp of the acceleration (50 ms)."""
_CELLS = 100, 20_000
"""Least and largest number of cells of a way from rest to rest, about."""
_RAMP = 0.1
"""Duration from a rest on in which cells become shorter towards it, s: two default ramps of the
acceleration."""
_FINE = 4
"""Places for each cell at which its ends are looked up."""
_GAP = 2e-5
"""Share of the duration that the least duration may lie below the computed one."""
_WARM, _START = 0.05, 0.9
"""The gap from which a corrected solution begins, and the share of the limits that it uses then."""
_CORRECTIONS = 10
"""Largest number of solutions with corrected limits: up to 5 were needed on the shipped tasks."""
_MORE = 1.001
"""Times the excess by which exceeded limits are tightened, so that it comes to an end."""
_ROUNDING = 5e-10
"""Share by which rounding may exceed a limit."""
_SAME = 0.5 * Tolerances().joint_range
"""Largest change of a joint where a row is left out, rad or m: a curve may lie on a joint's end."""
_BETWEEN = np.array([[0.25], [0.5], [0.75]])
"""Where in a cell the tool's speed is looked at again, as shares of its time."""
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


class JointLimits(NamedTuple):
    """Largest speeds, accelerations and jerks of the joints, (nv,), SI; ∞ without a limit."""

    velocity: Array
    acceleration: Array
    jerk: Array

    def uses(self, motion: JointMotion) -> dict[str, Array]:
        """The share of each that each piece of a motion uses, exactly, (N − 1, nv)."""
        largest = motion.largest_speeds, motion.largest_accelerations, motion.largest_jerks
        return {
            name: of() / limit if np.isfinite(limit).any() else np.zeros_like(motion.q[1:])
            for name, limit, of in zip(self._fields, self, largest, strict=True)
        }


class _Cells(NamedTuple):
    """Parts of a curve: x at their ends, (C + 1,), and the index of the cubic of each, (C,)."""

    x: Array
    cubic: Indices


FeedShares = Callable[[Array, Array, Indices], Array]
"""Of q and q′ (K, nv) on pieces (K,) from row to row: the share of the programmed speed that the
tool has at the pace 1, (K,); 0 without one."""


class TimedWay:
    """A curve from rest to rest, the largest pace on each of its cubics, the limits of the joints.

    Args:
        curve: The curve.
        most: Largest pace between its rows, (N − 1,); ∞ where limits alone count.
        limits: Of the joints.
        feed: What the tool has of its programmed speed at the pace 1.
    """

    def __init__(
        self, curve: JointCurve, most: Array, limits: JointLimits, feed: FeedShares | None = None
    ) -> None:
        self.curve, self.limits = curve, limits
        self.smooth = bool(np.isfinite(limits.jerk).any())
        # From rest, d(q̇²) = 2q̈ dq: what accelerations permit, at most. Twice the way, since a curve
        # may bulge between its rows.
        way = 2.0 * np.abs(np.diff(curve.q, axis=0)).sum(axis=0)
        moves, gained = way > 0.0, np.full(len(way), np.inf)
        gained[moves] = np.sqrt(2.0 * limits.acceleration[moves] * way[moves])
        self._within_reach = np.minimum(limits.velocity, gained)
        piece = np.searchsorted(curve.rows, np.arange(len(curve.x) - 1), side="right") - 1
        still = ~np.diff(curve.q[curve.rows], axis=0).any(axis=1)
        # Where nothing moves there is no other pace than the feed's.
        self.most = np.where(still, np.minimum(most, 1.0), most)[piece]
        self.piece, self.feed = piece, feed

    def motion(self) -> tuple[JointMotion, Indices]:
        """The fastest motion, and which of its rows are those of the curve, (N,)."""
        cells, ramps = self._cells()
        solution = self._smooth(cells, ramps) if self.smooth else self._plain(cells)
        tight = np.ones((3, len(cells.cubic)))
        most = _GAP if self.smooth else _ROUNDING
        for _ in range(_CORRECTIONS):
            motion = solution(tight)
            # What is exceeded between the places looked at is taken off the limits there.
            use = np.array([of.max(axis=1, initial=0.0) for of in self._uses(motion)])
            use[0] = np.maximum(use[0], self._over_feed(motion, cells.cubic))
            if use.max() <= 1.0 + most:
                break
            if self.smooth:  # by y″ a cell counts in its neighbours
                near = np.pad(use, ((0, 0), (1, 1)))
                use = np.maximum(use, np.maximum(near[:, :-2], near[:, 2:]))
            tight *= 1.0 + _MORE * np.maximum(use - 1.0, 0.0)
        motion, kept = self._fewer(motion, np.isin(cells.x, self.curve.x[self.curve.rows]))
        worst = (of.max(initial=0.0) ** (1.0 / (k + 1)) for k, of in enumerate(self._uses(motion)))
        slower = float(max(worst))
        if slower > 1.0:
            v, a = motion.velocities, motion.accelerations
            rates = (v if v is None else v / slower, a if a is None else a / slower**2)
            motion = JointMotion(slower * motion.times, motion.q, *rates)
        rows = np.searchsorted(cells.x[kept], self.curve.x[self.curve.rows])
        motion.q[rows] = self.curve.q[self.curve.rows]  # but for rounding they are there
        return motion, rows

    # ------------------------------------------------------------ cells

    def _cells(self) -> tuple[_Cells, RestRamps]:
        """Cells of equal durations at the speeds without jerk limits, shorter ones beside rests."""
        ends = self.curve.x
        counts = np.ceil(_COARSE * np.diff(ends) / (ends[-1] - ends[0])).astype(int)
        cubic, share = _divided(counts)
        coarse = _Cells(np.append(ends[cubic] + share * np.diff(ends)[cubic], ends[-1]), cubic)
        y = self._reachable(coarse, np.ones((3, len(cubic))))
        t = _times(coarse.x, y)
        self._refuse_rest(t, cubic)
        T = float(t[-1])
        ramp = min(_RAMP, 0.49 * T)  # so that there is always something between both
        step = max(min(_STEP, T / _CELLS[0]), T / _CELLS[1])
        # After the duration τ from a rest on, x ∝ τ² at constant acceleration. In equal steps of
        # g ∝ τ^(2/3), x grows with g³, as with the time at constant jerk.
        whole = T + ramp
        g = np.linspace(0.0, whole, _FINE * int(np.ceil(whole / step)) + 1)
        near = np.minimum(g, whole - g)
        tau = np.where(near < 1.5 * ramp, ramp * (near / (1.5 * ramp)) ** 1.5, near - 0.5 * ramp)
        x = _ways(coarse.x, y, t, np.where(g <= 0.5 * whole, tau, T - tau))
        borders = _ways(coarse.x, y, t, np.array([ramp, T - ramp]))
        # Where a cubic ends almost there, the ramp does: no cell is much shorter than others.
        off = np.abs(np.interp(ends, x, g) - np.interp(borders, x, g)[:, None])
        borders = np.where(off.min(axis=1) < 0.5 * step, ends[off.argmin(axis=1)], borders)
        marks = np.unique(np.concatenate([ends, borders]))
        at = np.interp(marks, x, g)
        which, share = _divided(np.ceil(np.diff(at) / step).astype(int))
        nodes = np.interp(at[which] + share * np.diff(at)[which], g, x)
        nodes = np.append(np.where(share == 0.0, marks[which], nodes), ends[-1])
        nodes = nodes[np.append(True, np.diff(np.maximum.accumulate(nodes)) > 0.0)]
        cubic = np.searchsorted(ends, 0.5 * (nodes[1:] + nodes[:-1]), side="right") - 1
        ramps = RestRamps(ends[0], ends[-1], borders[0] - ends[0], ends[-1] - borders[1])
        return _Cells(nodes, cubic), ramps

    def _refuse_rest(self, t: Array, cubic: Indices) -> None:
        """Refuse a curve on which the joints rest for ever (times of cells (C + 1,), their cubics).

        Raises:
            InvalidInput: With the rows between which that is.
        """
        endless = np.flatnonzero(~np.isfinite(t))
        if len(endless):
            row = int(self.piece[cubic[endless[0] - 1]]) + 1
            raise InvalidInput(
                f"no speed is slow enough between rows {row} and {row + 1} of the trajectory: the "
                "joints jump or turn back there. Take another motion (another --method, or start), "
                "or more rows beside them."
            )

    # ------------------------------------------------------------ speeds

    def _over_feed(self, motion: JointMotion, cubic: Indices) -> Array:
        """The tool's largest share of its programmed speed between the ends of cells, (C,)."""
        if self.feed is None:
            return np.zeros(len(cubic))
        state = motion.at((motion.times[:-1] + _BETWEEN * np.diff(motion.times)).ravel())
        piece = np.tile(self.piece[cubic], len(_BETWEEN))
        shares = self.feed(state.q, state.velocities, piece).reshape(len(_BETWEEN), -1)
        over: Array = shares.max(axis=0) / (1.0 + FASTER)
        return over

    def _caps(self, q: Array, first: Array, cubic: Indices) -> Array:
        """Largest squares of the pace for q and q′ at places of each cell (C, P, nv), (C, P)."""
        with np.errstate(divide="ignore"):
            pace = (self._within_reach / np.abs(first)).min(axis=2)
            if self.feed is not None:
                count, places, nv = q.shape
                piece = np.repeat(self.piece[cubic], places)
                share = self.feed(q.reshape(-1, nv), first.reshape(-1, nv), piece)
                pace = np.minimum(pace, (1.0 + FASTER) / share.reshape(count, places))
        caps: Array = np.minimum(pace, self.most[cubic, None]) ** 2
        return caps

    def _ends(self, cells: _Cells) -> Array:
        """q, q′, q″, q‴ at the begin and the end of each cell, (C, 2, 4, nv)."""
        x, cubic = cells
        return np.stack([self.curve.at(x[:-1], cubic), self.curve.at(x[1:], cubic)], axis=1)

    def _reachable(self, cells: _Cells, tight: Array) -> Array:
        """Largest squares of the pace at the ends of the cells without jerk limits, (C + 1,)."""
        ends = self._ends(cells)
        caps = self._caps(ends[:, :, 0], ends[:, :, 1], cells.cubic) / tight[0, :, None] ** 2
        cap = np.minimum(np.append(caps[:, 0], np.inf), np.append(np.inf, caps[:, 1]))
        rows = tight[1, :, None, None, None] * ends[:, :, 1:3]
        return np.asarray(reachable(rows, np.diff(cells.x), self.limits.acceleration, cap))

    def _plain(self, cells: _Cells) -> Callable[[Array], JointMotion]:
        """The motion without jerk limits, for limits divided by factors (3, C)."""
        ends = self._ends(cells)
        q, first = (np.vstack([ends[:, 0, k], ends[-1:, 1, k]]) for k in (0, 1))

        def motion(tight: Array) -> JointMotion:
            y = self._reachable(cells, tight)
            return JointMotion(_times(cells.x, y), q, np.sqrt(y)[:, None] * first)

        return motion

    def _smooth(self, cells: _Cells, ramps: RestRamps) -> Callable[[Array], JointMotion]:
        """The motion with jerk limits, for limits divided by factors (3, C)."""
        xi, at, X = ramps.cells(cells.x)
        h, cubic = np.diff(xi), cells.cubic
        of_x = self.curve.at(at.ravel(), np.repeat(cubic, 3)).reshape(len(h), 3, 4, -1)
        X1, X2, X3 = (X[:, :, k, None] for k in range(3))
        q, first, second, third = (of_x[:, :, k] for k in range(4))
        # Derivatives with respect to ξ.
        f1 = first * X1
        f2 = second * X1**2 + first * X2
        f3 = third * X1**3 + 3.0 * second * X1 * X2 + first * X3
        with np.errstate(divide="ignore"):
            caps = np.ascontiguousarray((self._caps(q, first, cubic) / X[:, :, 0] ** 2).T)
        a, j = self.limits.acceleration, self.limits.jerk
        uses = 0.5 * f1 / a, f2 / a, 0.5 * f1 / j, 1.5 * f2 / j, f3 / j
        rows = np.ascontiguousarray(np.transpose(uses, (2, 3, 0, 1)))  # place, joint, use, cell
        found = np.zeros(len(h) + 2)

        def motion(tight: Array) -> JointMotion:
            limits = rows * np.repeat(tight[1:], (2, 3), axis=0), caps / tight[0] ** 2
            # A constant pace that keeps all limits, or the last solution, as slow as that.
            y = np.full(len(h) + 2, _steady(*limits) ** 2)
            gap = 1.0
            if found.any():
                slower = max(tight[0].max() ** 2, tight[1].max(), tight[2].max() ** (2.0 / 3.0))
                y, gap = found * _START / slower, _WARM
            with_jerk_limits(y, h, *limits, gap, _GAP)
            found[:] = y
            return _passed(y, h, q, f1, f2)

        return motion

    # ------------------------------------------------------------ rows

    def _uses(self, motion: JointMotion) -> tuple[Array, Array, Array]:
        """Shares of the limits, also if a program writes the motion as cubics, (N − 1, nv) each."""
        speed, acceleration, jerk = self.limits.uses(motion).values()
        cubic = JointMotion(motion.times, motion.q, motion.velocities).largest_accelerations()
        return speed, np.maximum(acceleration, cubic / self.limits.acceleration), jerk

    def _fewer(self, motion: JointMotion, needed: Mask) -> tuple[JointMotion, Indices]:
        """The motion without rows that change nothing, and the index of those that are left."""
        kept, needed = np.arange(len(needed)), needed.copy()
        while True:
            inner = np.flatnonzero(~needed[kept])
            # Of rows side by side every other one.
            inner = inner[(inner % 2 == inner[0] % 2)] if len(inner) else inner
            if not len(inner):
                return _part(motion, kept), kept
            left = np.delete(kept, inner)
            trial, gone = _part(motion, left), np.setdiff1d(np.arange(len(needed)), left)
            off = np.abs(trial.at(motion.times[gone]).q - motion.q[gone]).max(axis=1) > _SAME
            changed = self._may_exceed(trial)
            np.logical_or.at(changed, np.searchsorted(left, gone) - 1, off)
            needed[kept[inner]] = changed[np.searchsorted(left, kept[inner]) - 1]
            kept = np.delete(kept, inner[~needed[kept[inner]]])

    def _may_exceed(self, motion: JointMotion) -> Mask:
        """Which pieces may exceed a limit, also if a program writes them as cubics, (N − 1,)."""
        cubic = JointMotion(motion.times, motion.q, motion.velocities)
        bounds = (*motion.bounds(), cubic.bounds()[1])
        limits = (*self.limits, self.limits.acceleration)
        found = [
            (of > (1.0 + _ROUNDING) * limit).any(axis=1)
            for of, limit in zip(bounds, limits, strict=True)
        ]
        return np.asarray(np.any(found, axis=0))


def _divided(counts: Indices) -> tuple[Indices, Array]:
    """Intervals divided equally: of each part the interval, and the share at which it begins."""
    counts = np.maximum(counts, 1)
    which = np.repeat(np.arange(len(counts)), counts)
    return which, (np.arange(len(which)) - (np.cumsum(counts) - counts)[which]) / counts[which]


def _times(x: Array, y: Array) -> Array:
    """Times at the ends of cells, s: from √y to √y at constant acceleration."""
    pace = np.sqrt(y)
    with np.errstate(divide="ignore"):
        took = 2.0 * np.diff(x) / (pace[:-1] + pace[1:])
    return np.concatenate([[0.0], np.cumsum(took)])


def _ways(x: Array, y: Array, t: Array, when: Array) -> Array:
    """x at times within cells of constant acceleration."""
    k = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    tau = when - t[k]
    way = tau * (np.sqrt(y[k]) + 0.25 * tau * (y[k + 1] - y[k]) / (x[k + 1] - x[k]))
    return np.clip(x[k] + way, x[k], x[k + 1])


def _steady(rows: Array, caps: Array) -> float:
    """A constant pace that keeps all limits, with some room."""
    bend, third = (float(np.abs(rows[:, :, k]).max()) for k in (1, 4))
    return _START / max(1.0 / math.sqrt(caps.min()), math.sqrt(bend), math.cbrt(third))


def _passed(c: Array, h: Array, q: Array, f1: Array, f2: Array) -> JointMotion:
    """The motion for the coefficients of y, with q, q′ and q″ in the cells, (C, 3, nv) each."""
    share = h[1:] / (h[:-1] + h[1:])
    y = np.concatenate([c[:1], share * c[1:-2] + (1.0 - share) * c[2:-1], c[-1:]])
    begin, middle, end = y[:-1], c[1:-1], y[1:]
    u = 0.5 * (1.0 + _PLACES[:, None])
    inner = (1.0 - u) ** 2 * begin + 2.0 * u * (1.0 - u) * middle + u**2 * end
    took = 0.5 * h * (_WEIGHTS[:, None] / np.sqrt(inner)).sum(axis=0)
    half_slope = np.append((middle - begin) / h, (end[-1] - middle[-1]) / h[-1])[:, None]
    q, f1, f2 = (np.vstack([f[:, 0], f[-1:, -1]]) for f in (q, f1, f2))
    rates = f1 * np.sqrt(y)[:, None], f1 * half_slope + f2 * y[:, None]
    for rate in rates:  # but for rounding
        rate[[0, -1]] = 0.0
    return JointMotion(np.concatenate([[0.0], np.cumsum(took)]), q, *rates)


def _part(motion: JointMotion, kept: Indices) -> JointMotion:
    """The motion through some of the rows."""
    velocities, accelerations = (
        None if r is None else r[kept] for r in (motion.velocities, motion.accelerations)
    )
    return JointMotion(motion.times[kept], motion.q[kept], velocities, accelerations)

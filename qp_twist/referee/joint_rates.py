r"""Largest speeds and accelerations of a motion over any interval, less what rounding explains.

The numbers of a file are rounded: times by up to δt, positions by δq, velocities by δv. Over an
interval of length W the mean speed D is uncertain by

.. math:: \delta D = \frac{2\,\delta q + 2\,\delta t\,|D|}{W - 2\,\delta t},

so that a motion within its limits v and a, when rounded, keeps

.. math::

    |D| \le v + \delta D,\qquad |\dot q_1 - \dot q_0| \le a\,(W + 2\,\delta t) + 2\,\delta v,\qquad
    |D - \dot q_{0,1}| \le \tfrac12 a\,(W + 2\,\delta t) + \delta D + \delta v.

These hold for every interval. They are judged from each row over 1, 2, 4, 8 … pieces, and within
each piece for the polynomial itself. There, too, rounding explains a part, which grows as the
pieces become short: :math:`c\,(\delta D + \delta v)/W` of an acceleration, c = 6 for cubics and 20
for quintics. But it does not grow with the interval: as every interval is a sum of at most
log₂ N of these, a speed may change by no more than log₂ N times 2 δv beyond the limits, however
close together the rows are.

Only digits that a file writes count as rounding. δ is half the coarsest power of ten of which all
its numbers are multiples: half a nanosecond for the times of ROS. Numbers on a coarser grid than
:data:`CLOCK` and :data:`DIGIT` are not excused by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.referee.joint_motion import JointMotion

CLOCK = 1e-9
"""Coarsest rounding of times in files that counts as such, s."""
DIGIT = 2e-6
"""The same of positions and rates, rad, m, rad/s …: six decimals, or four of degrees."""
_FINEST = 15
"""Decimals beyond which numbers count as not rounded."""
_PER_ROUNDING = {1: 0.0, 3: 6.0, 5: 20.0}
"""c of cubics and quintics: the factors of D in their accelerations."""


class Rounding(NamedTuple):
    """Largest errors of the numbers of a motion."""

    time: float
    """s."""
    position: float
    """rad or m."""
    velocity: float
    """rad/s or m/s."""
    acceleration: float
    """rad/s² or m/s²."""

    @classmethod
    def of(cls, motion: JointMotion) -> Rounding:
        """What the digits of a motion's numbers say."""
        rates = [0.0 if x is None else _rounding(x, DIGIT) for x in (motion.velocities,
                 motion.accelerations)]  # fmt: skip
        # A controller's zero positions are other numbers: differences have the digits of its file.
        q = _rounding(motion.q - motion.q[0], DIGIT, np.abs(motion.q).max(initial=0.0))
        times = motion.times - motion.times[0]
        return cls(_rounding(times, CLOCK, np.abs(motion.times).max()), q, *rates)


def _rounding(values: Array, coarsest: float, size: float | None = None) -> float:
    """Half the coarsest power of ten, also of a degree, of which all values are multiples."""
    size = float(np.abs(values).max(initial=0.0)) if size is None else size
    noise = float(np.spacing(size))
    for decimals in range(-3, _FINEST):
        for unit in (10.0**-decimals, np.radians(10.0**-decimals)):
            if 0.5 * unit <= noise:
                return noise
            off = np.abs(values - unit * np.round(values / unit))
            if (off <= 4.0 * noise).all():
                return float(0.5 * unit) if unit <= (1.0 + 1e-9) * coarsest else noise
    return noise


class _Window(NamedTuple):
    """Intervals over the same number of pieces, from each row on, K = N − pieces."""

    pieces: int
    length: Array
    """W, s, (K, 1)."""
    mean: Array
    """D, rad/s or m/s, (K, nv)."""
    off: Array
    """δD; ∞ where rounding explains everything, (K, nv)."""


def _windows(motion: JointMotion, rounding: Rounding) -> Iterator[_Window]:
    count, pieces = len(motion.times), 1
    while pieces < count:
        length = (motion.times[pieces:] - motion.times[:-pieces])[:, None]
        moved = motion.q[pieces:] - motion.q[:-pieces]
        mean = moved / length
        sure = length - 2.0 * rounding.time
        doubt = 2.0 * rounding.position + 2.0 * rounding.time * np.abs(mean)
        off = np.divide(doubt, sure, out=np.full_like(mean, np.inf), where=sure > 0.0)
        yield _Window(pieces, length, mean, off)
        pieces *= 2


def largest_speeds(motion: JointMotion) -> Array:
    """Largest |q̇| at each piece, of the piece or an interval around it, (N − 1, nv)."""
    rounding = Rounding.of(motion)
    found = np.zeros((len(motion.times) - 1, motion.q.shape[1]))
    for window in _windows(motion, rounding):
        moved = np.abs(window.mean) * window.length - 2.0 * rounding.position
        _raise(found, window.pieces, moved / (window.length + 2.0 * rounding.time))
        if window.pieces == 1:
            degree = motion.degree
            explained = (
                degree * window.off
                + (degree - 1) * rounding.velocity
                + 0.5 * rounding.acceleration * window.length
            )
            _raise(found, 1, motion.largest_speeds() - explained)
    if motion.velocities is not None:
        stated = np.abs(motion.velocities) - rounding.velocity
        _raise(found, 1, np.maximum(stated[:-1], stated[1:]))
    return found


def largest_accelerations(motion: JointMotion) -> tuple[Array, Array]:
    """Largest |q̈|, of the polynomials and over intervals.

    Returns:
        Times, s, (K,), and the accelerations, rad/s² or m/s², (K, nv). With velocities K = N − 1
        pieces. Without, the joints move straight and K = N − 2 rows: the acceleration is the change
        of the mean speed between the middles of the intervals before and after.
    """
    rounding = Rounding.of(motion)
    times, clock = motion.times, 2.0 * rounding.time
    v = motion.velocities
    if v is None:
        found = np.zeros((len(times) - 2, motion.q.shape[1]))
        for window in _windows(motion, rounding):
            n = window.pieces
            changed = np.abs(window.mean[n:] - window.mean[:-n])
            over = 0.5 * (window.length[n:] + window.length[:-n]) + clock
            _raise(found, 2 * n - 1, (changed - window.off[n:] - window.off[:-n]) / over)
        return times[1:-1], found
    found = np.zeros((len(times) - 1, motion.q.shape[1]))
    for window in _windows(motion, rounding):
        n, over = window.pieces, window.length + clock
        doubt = window.off + rounding.velocity
        if n == 1:
            explained = _PER_ROUNDING[motion.degree] * doubt / window.length
            exact = motion.largest_accelerations()
            _raise(found, 1, exact - explained - 3.0 * rounding.acceleration)
        _raise(found, n, (np.abs(v[n:] - v[:-n]) - 2.0 * rounding.velocity) / over)
        for end in (v[:-n], v[n:]):
            _raise(found, n, 2.0 * (np.abs(window.mean - end) - doubt) / over)
    if motion.accelerations is not None:
        stated = np.abs(motion.accelerations) - rounding.acceleration
        _raise(found, 1, np.maximum(stated[:-1], stated[1:]))
    return motion.middles, found


def _raise(found: Array, pieces: int, values: Array) -> None:
    """Raise ``found`` (K, nv) in the middle of intervals over some entries to values."""
    if len(values):
        first = (pieces - 1) // 2
        here = found[first : first + len(values)]
        np.maximum(here, values, out=here)

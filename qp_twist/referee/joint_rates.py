"""Largest speeds, accelerations and jerks of a motion over any interval, less rounding.

Only digits that a file writes count as rounding (docs/proofs.md, *Rounding in files*, has the
equations).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.referee.joint_motion import JointMotion

CLOCK = 1e-9
"""Coarsest rounding of times in files that counts as such, s."""
DIGIT = 2e-6
"""The same of positions and rates, rad, m, rad/s …: six decimals, or four of degrees."""
_FINEST = 15
"""Decimals beyond which numbers count as not rounded."""
_PER_ROUNDING = {1: 0.0, 3: 6.0, 5: 20.0}
"""c of cubics and quintics: the factors of D in their accelerations."""

_PER_JERK, _PER_CHANGE = 60.0, 12.0
"""Sums of the factors in the jerk of a quintic at its begin, (60 D − 36 v₀ − 24 v₁)/W² −
(9 a₀ − 3 a₁)/W: of D, as of v, and of a."""


def _roundings(motion: JointMotion) -> tuple[float, float, float, float]:
    """Largest errors of times, positions, velocities and accelerations that their digits explain.

    s, rad or m, and so on.
    """
    # A controller's zero positions are other numbers: differences have the digits of its file.
    q = _rounding(motion.q - motion.q[0], DIGIT, np.abs(motion.q).max(initial=0.0))
    time = _rounding(motion.times - motion.times[0], CLOCK, np.abs(motion.times).max())
    of_rates = (motion.velocities, motion.accelerations)
    velocity, acceleration = (0.0 if x is None else _rounding(x, DIGIT) for x in of_rates)
    return time, q, velocity, acceleration


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


def _windows(
    motion: JointMotion, time: float, position: float
) -> Iterator[tuple[int, Array, Array, Array]]:
    """Intervals over 1, 2, 4 … pieces, from each row on, K = N − pieces.

    Number of pieces, W (K, 1), s, D (K, nv), rad/s or m/s, and δD, ∞ where rounding explains all.
    """
    pieces = 1
    while pieces < len(motion.times):
        length = (motion.times[pieces:] - motion.times[:-pieces])[:, None]
        mean = (motion.q[pieces:] - motion.q[:-pieces]) / length
        sure = length - 2.0 * time
        doubt = 2.0 * position + 2.0 * time * np.abs(mean)
        off = np.divide(doubt, sure, out=np.full_like(mean, np.inf), where=sure > 0.0)
        yield pieces, length, mean, off
        pieces *= 2


def largest_speeds(motion: JointMotion) -> Array:
    """Largest |q̇| at each piece, of the piece or an interval around it, (N − 1, nv)."""
    time, position, velocity, acceleration = _roundings(motion)
    found = np.zeros((len(motion.times) - 1, motion.q.shape[1]))
    for pieces, length, mean, off in _windows(motion, time, position):
        moved = np.abs(mean) * length - 2.0 * position
        _raise(found, pieces, moved / (length + 2.0 * time))
        if pieces == 1:
            degree = motion.degree
            explained = degree * off + (degree - 1) * velocity + 0.5 * acceleration * length
            _raise(found, 1, motion.largest_speeds() - explained)
    if motion.velocities is not None:
        stated = np.abs(motion.velocities) - velocity
        _raise(found, 1, np.maximum(stated[:-1], stated[1:]))
    return found


def largest_accelerations(motion: JointMotion) -> tuple[Array, Array]:
    """Largest |q̈|, of the polynomials and over intervals.

    Returns:
        Times, s, (K,), and the accelerations, rad/s² or m/s², (K, nv). With velocities K = N − 1
        pieces. Without, the joints move straight and K = N − 2 rows: the acceleration is the change
        of the mean speed between the middles of the intervals before and after; at ``points``
        between the middles of the moves.
    """
    if motion.points is not None:
        return motion.times[1:-1], _of_moves(motion, motion.points)
    time, position, velocity, acceleration = _roundings(motion)
    times, v = motion.times, motion.velocities
    if v is None:
        found = np.zeros((len(times) - 2, motion.q.shape[1]))
        for n, length, mean, off in _windows(motion, time, position):
            changed = np.abs(mean[n:] - mean[:-n])
            over = 0.5 * (length[n:] + length[:-n]) + 2.0 * time
            _raise(found, 2 * n - 1, (changed - off[n:] - off[:-n]) / over)
        return times[1:-1], found
    found = np.zeros((len(times) - 1, motion.q.shape[1]))
    for n, length, mean, off in _windows(motion, time, position):
        over, doubt = length + 2.0 * time, off + velocity
        if n == 1:
            explained = _PER_ROUNDING[motion.degree] * doubt / length
            exact = motion.largest_accelerations()
            _raise(found, 1, exact - explained - 3.0 * acceleration)
        _raise(found, n, (np.abs(v[n:] - v[:-n]) - 2.0 * velocity) / over)
        for end in (v[:-n], v[n:]):
            _raise(found, n, 2.0 * (np.abs(mean - end) - doubt) / over)
    if motion.accelerations is not None:
        stated = np.abs(motion.accelerations) - acceleration
        _raise(found, 1, np.maximum(stated[:-1], stated[1:]))
    return motion.middles, found


def _of_moves(motion: JointMotion, points: Indices) -> Array:
    """Largest |q̈| at rows of straight pieces, (N − 2, nv), of which some are points of a program.

    Within a move its own rows say it. At a point the controller changes its speed by a ramp of its
    own, for which it has half of each of both moves.
    """
    ends = JointMotion(motion.times[points], motion.q[points])
    length = np.diff(ends.times)[:, None]
    found = np.zeros((len(motion.times) - 2, motion.q.shape[1]))
    for first, last in itertools.pairwise(points.tolist()):
        if last - first > 1:
            rows = slice(first, last + 1)
            inside = JointMotion(motion.times[rows], motion.q[rows])
            found[first : last - 1] = largest_accelerations(inside)[1]
    at, speeds = points[1:-1], np.diff(motion.q, axis=0) / np.diff(motion.times)[:, None]
    changed = np.abs(speeds[at] - speeds[at - 1])
    doubt = 2.0 * _roundings(ends)[1] / length
    over = 0.5 * (length[:-1] + length[1:])
    found[at - 1] = np.maximum(changed - doubt[:-1] - doubt[1:], 0.0) / over
    return found


def largest_jerks(motion: JointMotion) -> Array:
    """Largest |q⃛| at each piece of quintics, or of an interval around it, (N − 1, nv)."""
    assert motion.accelerations is not None
    time, position, velocity, acceleration = _roundings(motion)
    found = np.zeros((len(motion.times) - 1, motion.q.shape[1]))
    a = motion.accelerations
    for n, length, _, off in _windows(motion, time, position):
        over = length + 2.0 * time
        if n == 1:
            exact = motion.largest_jerks()
            explained = (
                _PER_JERK * (off + velocity) / length**2 + _PER_CHANGE * acceleration / length
            )
            _raise(found, 1, exact - explained)
        _raise(found, n, (np.abs(a[n:] - a[:-n]) - 2.0 * acceleration) / over)
    return found


def _raise(found: Array, pieces: int, values: Array) -> None:
    """Raise ``found`` (K, nv) in the middle of intervals over some entries to values."""
    if len(values):
        first = (pieces - 1) // 2
        here = found[first : first + len(values)]
        np.maximum(here, values, out=here)

"""The fastest paces of a joint path whose velocity is constant from row to row.

Piece k takes t_k = h_k/σ_k and moves the joints at v_k = σ_k D_k; its pace σ_k is at most 1. Where
it meets the next one, the change of velocity is limited by the harmonic mean of both times,

    |v_k − v_{k+1}| ≤ ρ a · 2 t_k t_{k+1}/(t_k + t_{k+1}),

in which a joint that is evenly accelerated from the middle of one piece to the middle of an equally
long one changes from v_k to v_{k+1}; ρ is the share of it that a corner of the path leaves. Where
the joints start or stop, the limit is a t_k/2.
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.copying import put

_SWEEPS = 300
"""Largest number of sweeps that lower paces; on the shipped paths, two do."""
_CLIMBS, _GAINED = 20, 1e-6
"""Sweeps that raise them, and the share by which a pace has to rise to count."""
_PUMPS, _PUMPED = (1.3, 1.2, 1.1, 1.05, 1.02), 1e-4
"""Factors by which all paces are raised together before they are lowered again, and the share of
the time by which that has to shorten a path to be repeated. Of the time that a sparse program finds
for the same rows, paths are 0.1 % longer then, without it 2 % (at worst 30 %)."""
_KEPT = 1e-9
"""Share of a limit by which rounding may exceed it."""


@kernel
def _fastest(k, beside, at_most, h, D, most, room, pace):
    """The largest pace of piece k, up to ``at_most``, with the pace that the one beside it has.

    Each joint limits σ, for s = ±1, by s (σ D − v)(σ/h + 1/t) ≤ 2ρa with the other piece's velocity
    v and time t: up to the larger root if s D > 0, else except between two positive roots.
    """
    x, moving = at_most, 0 <= beside < len(h)
    rate = pace[beside] / h[beside] if moving else 0.0
    share = room[max(k, beside)] if moving else 0.25
    for _ in range(3):  # a joint may lower it into what another one excludes
        before = x
        for j in range(len(most)):
            v = pace[beside] * D[beside, j] if moving else 0.0
            for s in (-1.0, 1.0):
                A = s * D[k, j] / h[k]
                B = s * (D[k, j] * rate - v / h[k])
                C = 2.0 * share * most[j] + s * v * rate
                inner = B * B + 4.0 * A * C
                if inner < 0.0 or A == 0.0:
                    continue
                root = math.sqrt(inner)
                if A > 0.0:
                    x = min(x, max((root - B) / (2.0 * A), 0.0))
                else:
                    low, high = (root - B) / (2.0 * A), (-root - B) / (2.0 * A)
                    if low < x < high:
                        x = max(low, 0.0)
        if x == before:
            break
    return x


@kernel
def _share(k, h, D, most, room, pace):
    """Largest share of an acceleration limit between piece k and the next one."""
    x, y = pace[k], pace[k + 1]
    mean, largest = 2.0 * room[k + 1] / (x / h[k] + y / h[k + 1]), 0.0
    for j in range(len(most)):
        largest = max(largest, abs(x * D[k, j] - y * D[k + 1, j]) / (most[j] * mean))
    return largest


@kernel
def _lower(h, D, most, room, rests, pace):
    """Lower paces until all limits are kept: of two pieces one, or both, whichever costs least.

    Two pieces are looked at again only if the pace of one of them has changed.
    """
    n = len(h)
    stale = np.ones(n + 1, dtype=np.bool_)  # pieces k − 1 and k
    for _ in range(_SWEEPS):
        lowered = False
        for turn in range(2):
            if rests:
                for end, beside in ((0, -1), (n - 1, n)):
                    x = _fastest(end, beside, pace[end], h, D, most, room, pace)
                    lowered = lowered or x < pace[end] * (1.0 - _KEPT)
                    if x < pace[end]:
                        pace[end], stale[end], stale[end + 1] = x, True, True
            for i in range(n - 1):
                k = i if turn == 0 else n - 2 - i
                if not stale[k + 1]:
                    continue
                share = _share(k, h, D, most, room, pace)
                if share <= 1.0 + _KEPT:
                    stale[k + 1] = False
                    continue
                lowered, stale[k], stale[k + 2] = True, True, True
                x = _fastest(k, k + 1, pace[k], h, D, most, room, pace)
                y = _fastest(k + 1, k, pace[k + 1], h, D, most, room, pace)
                less = 1.0 / math.sqrt(share)
                times = h[k] / pace[k], h[k + 1] / pace[k + 1]
                first = times[0] * (pace[k] / max(x, 1e-9) - 1.0)
                second = times[1] * (pace[k + 1] / max(y, 1e-9) - 1.0)
                both = (times[0] + times[1]) * (1.0 / less - 1.0)
                if first <= min(second, both):
                    pace[k] = x
                elif second <= both:
                    pace[k + 1] = y
                else:
                    pace[k], pace[k + 1] = less * pace[k], less * pace[k + 1]
        if not lowered:
            break


@kernel
def _raise(h, D, most, room, rests, pace):
    """Raise each pace as far as those beside it permit, in turn; again if one of them has risen."""
    n = len(h)
    stale = np.ones(n, dtype=np.bool_)
    for _ in range(_CLIMBS):
        raised = False
        for i in range(2 * n):
            k = i if i < n else 2 * n - 1 - i
            if not stale[k] or pace[k] == 1.0:
                continue
            x, stale[k] = 1.0, False
            if rests or k > 0:
                x = _fastest(k, k - 1, x, h, D, most, room, pace)
            if rests or k < n - 1:
                x = _fastest(k, k + 1, x, h, D, most, room, pace)
            if x > pace[k] * (1.0 + _GAINED):
                pace[k], raised = x, True
                stale[max(k - 1, 0)] = stale[min(k + 1, n - 1)] = True
        if not raised:
            break


@kernel
def _seconds(h, pace):
    total = 0.0
    for k in range(len(h)):
        total += h[k] / pace[k]
    return total


@kernel
def fastest_paces(h, D, most, room, rests, pace):
    """Write the paces (N,), at most 1, for times h (N,), velocities D (N, nv), limits (nv,).

    ``room`` (N,) has the share ρ at the begin of each piece.

    Not the optimum, which is not a convex problem: lowered where a limit is violated, then raised
    one by one and all together as long as that shortens the path.
    """
    pace[:] = 1.0
    _lower(h, D, most, room, rests, pace)
    _raise(h, D, most, room, rests, pace)
    trial = pace.copy()
    for factor in _PUMPS:
        for _ in range(_CLIMBS):
            for k in range(len(h)):
                trial[k] = min(1.0, factor * pace[k])
            _lower(h, D, most, room, rests, trial)
            _raise(h, D, most, room, rests, trial)
            if _seconds(h, trial) > (1.0 - _PUMPED) * _seconds(h, pace):
                break
            put(trial, pace)

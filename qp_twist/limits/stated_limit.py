"""What a mink limit of anybody's class states: bounds of single joints, and rows."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import mink
import numpy as np

from qp_twist.checks import Array, finite_array, float_array, within
from qp_twist.constraints import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.limits.band_limit import BandLimit
from qp_twist.limits.box_limit import Box

RowName = tuple[str, str]
"""Name and kind of an inequality row, as in :class:`~qp_twist.BindingLimit`."""


class Named(Protocol):
    """What inequality rows come from: names are looked up only where a message needs them."""

    @property
    def names(self) -> list[RowName]:
        """Name and kind of each of the rows."""


UNLIMITED = 1e12
"""A velocity bound beyond this is none, rad/s or m/s."""
_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}


@dataclass(eq=False)
class StatedLimit:
    """What a limit of anybody's class states at a configuration.

    Attributes:
        limit: It.
        box: Its rows of a single entry, which are bounds.
        rows: The others that say something, (k, nv).
        bounds: Their right-hand side, (k,), rad/s or m/s.
        which: Their numbers among all that it states, (k,).
    """

    limit: mink.Limit
    box: Box
    rows: Array
    bounds: Array
    which: np.ndarray[tuple[int], np.dtype[np.intp]]

    @classmethod
    def of(
        cls, limit: mink.Limit, configuration: mink.Configuration, dt: float
    ) -> StatedLimit | None:
        """Of a limit; ``None`` where it states nothing.

        Raises:
            InvalidInput: If what it states are no rows, or no numbers.
        """
        constraint = limit.compute_qp_inequalities(configuration, dt)
        if not isinstance(constraint, mink.Constraint):
            raise InvalidInput(
                f"{type(limit).__name__}: compute_qp_inequalities has to return a mink.Constraint, "
                f"it returned {constraint!r}."[:300]
            )
        if constraint.inactive:
            return None
        nv = configuration.model.nv
        G, g = _stated(type(limit).__name__, constraint, nv, dt)
        entries = (G != 0.0).sum(axis=1)
        single = entries == 1
        box = _no_box(kind_of(limit), nv)
        if single.any():
            box = _box(kind_of(limit), G[single], g[single])
        which = ((entries > 1) & (g < np.inf) | (entries == 0) & (g < 0.0)).nonzero()[0]
        return cls(limit, box, G[which], g[which], which)

    @property
    def names(self) -> list[RowName]:
        """Of the rows."""
        return [_row_name(self.limit, int(row)) for row in self.which]


def kind_of(limit: mink.Limit) -> str:
    """How messages call a limit that is none of ours."""
    name = type(limit).__name__
    return limit.kind if isinstance(limit, Constraint) else _MINK_KINDS.get(name, name)


def _stated(name: str, constraint: mink.Constraint, nv: int, dt: float) -> tuple[Array, Array]:
    """G and h/dt of a limit of anybody's class, checked; bounds too far away are none."""
    stated: tuple[Any, Any] = constraint.G, constraint.h
    G, h = stated if _in_order(*stated, nv) else _checked(name, *stated, nv)
    g: Array = h / dt
    g[g > UNLIMITED] = np.inf
    return G, g


def _in_order(G: Any, h: Any, nv: int) -> bool:
    """Whether these are arrays as they should be, at a glance: a tenth of what checking takes."""
    return bool(
        type(G) is type(h) is np.ndarray
        and G.dtype == h.dtype == np.float64
        and h.ndim == 1
        and G.shape == (len(h), nv)
        # Written so that NaN is not in order.
        and np.abs(G).max(initial=0.0) <= UNLIMITED
        and h.min(initial=0.0) > -np.inf
    )


def _checked(name: str, G: Any, h: Any, nv: int) -> tuple[Array, Array]:
    rows = finite_array(f"{name}: G of G Δq ≤ h", G, (None, nv))
    within(f"{name}: G", rows, UNLIMITED)
    ends = float_array(f"{name}: h of G Δq ≤ h", h)
    if ends.shape != (len(rows),) or np.isnan(ends).any() or (ends == -np.inf).any():
        raise InvalidInput(
            f"{name}: its rows G Δq ≤ h need h of shape {(len(rows),)} without NaN or −∞; it has "
            f"shape {ends.shape}, {ends!r}."[:300]
        )
    return rows, ends


def _row_name(limit: mink.Limit, row: int) -> RowName:
    if isinstance(limit, mink.CollisionAvoidanceLimit):
        geoms = [limit.model.geom(g).name or f"geom {g}" for g in limit.geom_id_pairs[row]]
        return " – ".join(geoms), "collision"
    if isinstance(limit, BandLimit):
        return f"{limit.task.name} band row {row}", "band"
    if isinstance(limit, Constraint):
        return limit.row_name(row), limit.kind
    name = type(limit).__name__
    return f"{name} row {row}", name


@functools.lru_cache
def _no_box(kind: str, nv: int) -> Box:
    return Box(kind, np.full(nv, -np.inf), np.full(nv, np.inf))


def _box(kind: str, rows: Array, bounds: Array) -> Box:
    """Rows (m, nv) of a single entry each, and their bounds (m,), as a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = bounds[:, None] / rows
    lower = np.where(rows < 0.0, bound, -np.inf).max(axis=0, initial=-np.inf)
    upper = np.where(rows > 0.0, bound, np.inf).min(axis=0, initial=np.inf)
    return Box(kind, lower, upper)

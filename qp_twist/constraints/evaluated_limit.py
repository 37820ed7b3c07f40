"""Bounds and inequality rows of any mink limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import mink
import numpy as np

from qp_twist.checks import Array, Indices, are_rows, float_array, within
from qp_twist.constraints.band_limit import BandLimit
from qp_twist.constraints.box import Box, no_box
from qp_twist.constraints.clearance import Clearance
from qp_twist.constraints.constraint import Constraint, margins_of
from qp_twist.constraints.position_limit import NOTICEABLE
from qp_twist.errors import InvalidInput

RowName = tuple[str, str]
"""Name and kind of an inequality row, as in :class:`~qp_twist.constraints.BindingLimit`."""


class Named(Protocol):
    """The source of inequality rows; names are looked up only when a message needs them."""

    @property
    def names(self) -> list[RowName]:
        """Name and kind of each of the rows."""


UNLIMITED = 1e12
"""A velocity bound beyond this counts as infinite, rad/s or m/s."""
_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}


@dataclass(eq=False)
class EvaluatedLimit:
    """Bounds and rows of any mink limit at a configuration.

    Attributes:
        limit: The limit.
        box: Its rows with a single entry, as bounds.
        rows: The other rows, without those that always hold, (k, nv).
        bounds: Their right-hand side, (k,), rad/s or m/s.
        rooms: The part of it that is what is left of a clearance, over dt; else 0, (k,).
        which: Their indices among all rows of the limit, (k,); of a clearance those of the pairs.
        recovering: A sentence for each violated margin, if the limit is a constraint.
    """

    limit: mink.Limit
    box: Box
    rows: Array
    bounds: Array
    rooms: Array
    which: Indices
    recovering: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        limit: mink.Limit,
        configuration: mink.Configuration,
        dt: float,
        known: LimitRows | None = None,
    ) -> EvaluatedLimit | None:
        """Evaluate a limit, or sort its known rows; ``None`` if no row restricts the step.

        Raises:
            InvalidInput: If the limit returns no rows, or they are not numbers.
        """
        nv = configuration.model.nv
        if known is None and isinstance(limit, Clearance):
            # Its rows stay rows, so that they have the names of their pairs; they are numbers.
            rows = limit.step_rows(configuration, dt)
            if not len(rows.bounds):
                return None
            too_near = limit.in_step.least < 0.0
            recovering = _recovering(limit, configuration) if too_near else ()
            return cls(limit, no_box(limit.kind, nv), *rows, recovering)
        kind = kind_of(limit)
        known = known or LimitRows.of(limit, configuration, dt)
        G, h = known.G, known.h
        if not len(h):
            return None
        name = type(limit).__name__
        within(f"{name}: G", G, UNLIMITED)
        if not h.min() > -np.inf:  # false for NaN
            raise InvalidInput(
                f"{name}: its rows G Δq ≤ h need h without NaN or −∞, it is {h!r}."[:300]
            )
        g: Array = np.where(h > UNLIMITED * dt, np.inf, h / dt)
        entries = (G != 0.0).sum(axis=1)
        single = entries == 1
        box = _box(kind, G[single], g[single]) if single.any() else no_box(kind, nv)
        which = ((entries > 1) & (g < np.inf) | (entries == 0) & (g < 0.0)).nonzero()[0]
        names = limit.in_step.pairs[which] if isinstance(limit, Clearance) else which
        return cls(
            limit, box, G[which], g[which], np.zeros(len(which)), names,
            known.recovering(configuration),
        )  # fmt: skip

    @property
    def names(self) -> list[RowName]:
        """Of the rows."""
        if isinstance(self.limit, Clearance):
            return [(self.limit.names[pair], self.limit.kind) for pair in self.which.tolist()]
        return RowsOf(self.limit, self.which).names


class RowsOf(NamedTuple):
    """Some rows of a limit, by their indices, (k,)."""

    limit: mink.Limit
    which: Indices

    @property
    def names(self) -> list[RowName]:
        """Of the rows."""
        return [_row_name(self.limit, int(row)) for row in self.which]


def kind_of(limit: mink.Limit) -> str:
    """Name of a limit of another package in messages."""
    name = type(limit).__name__
    return limit.kind if isinstance(limit, Constraint) else _MINK_KINDS.get(name, name)


class LimitRows(NamedTuple):
    """Rows G Δq ≤ h as a limit returned them: arrays of the right shape, not yet checked."""

    limit: mink.Limit
    G: Array
    """(k, nv)."""
    h: Array
    """(k,)."""

    @classmethod
    def of(cls, limit: mink.Limit, configuration: mink.Configuration, dt: float) -> LimitRows:
        """Evaluate a limit; an inactive one has no rows.

        As in mink the result may be any object with ``inactive``, ``G`` and ``h``; these may be
        lists or a single row.

        Raises:
            InvalidInput: If it returns anything else.
        """
        nv, name = configuration.model.nv, type(limit).__name__
        returned: Any = limit.compute_qp_inequalities(configuration, dt)
        try:
            inactive, G, h = returned.inactive, returned.G, returned.h
        except AttributeError:
            raise InvalidInput(
                f"{name}: compute_qp_inequalities has to return a mink.Constraint, it returned "
                f"{returned!r}."[:300]
            ) from None
        if inactive:
            return cls(limit, np.zeros((0, nv)), np.zeros(0))
        if are_rows(G, h, nv):
            return cls(limit, G, h)
        rows = np.atleast_2d(float_array(f"{name}: G of G Δq ≤ h", G))
        ends = np.atleast_1d(float_array(f"{name}: h of G Δq ≤ h", h))
        if rows.ndim != 2 or rows.shape[1] != nv:
            raise InvalidInput(
                f"{name}: G of G Δq ≤ h: expected shape (rows, {nv}), got {np.shape(G)}."
            )
        if ends.shape != (len(rows),):
            raise InvalidInput(
                f"{name}: its rows G Δq ≤ h need h of shape {(len(rows),)}, it has {np.shape(h)}."
            )
        return cls(limit, rows, ends)

    def recovering(self, configuration: mink.Configuration) -> tuple[str, ...]:
        """A sentence for each violated margin of a constraint."""
        limit = self.limit
        if not np.count_nonzero(self.h < 0.0) or not isinstance(limit, Constraint):
            return ()
        return _recovering(limit, configuration)


def _recovering(limit: Constraint, configuration: mink.Configuration) -> tuple[str, ...]:
    margins = margins_of(limit, configuration.q[None])[0]
    return tuple(
        f"{limit.names[k]} is {-margins[k]:.3g} {limit.units[k]} outside its {limit.kind} limit"
        for k in np.flatnonzero(margins < -NOTICEABLE)
    )


def _row_name(limit: mink.Limit, row: int) -> RowName:
    if isinstance(limit, mink.CollisionAvoidanceLimit):
        geoms = [limit.model.geom(g).name or f"geom {g}" for g in limit.geom_id_pairs[row]]
        return " – ".join(geoms), "collision"
    if isinstance(limit, BandLimit):
        return f"{limit.task.name} band row {row}", "band"
    if isinstance(limit, Constraint):
        return limit.row_name(row), limit.kind
    if type(limit) is mink.ConfigurationLimit and row >= 2 * len(limit.indices):
        dof = int(limit._ball_dofadr[row - 2 * len(limit.indices)])
        return limit.model.joint(int(limit.model.dof_jntid[dof])).name, "position"
    name = type(limit).__name__
    return f"{name} row {row}", name


def _box(kind: str, rows: Array, bounds: Array) -> Box:
    """Convert rows (m, nv) with a single entry, and their bounds (m,), to a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = bounds[:, None] / rows
    lower = np.where(rows < 0.0, bound, -np.inf).max(axis=0, initial=-np.inf)
    upper = np.where(rows > 0.0, bound, np.inf).min(axis=0, initial=np.inf)
    return Box(kind, lower, upper)

"""Collect all limits of a step: box bounds with their origin, and general rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.limits.band_limit import BandLimit
from qp_twist.limits.box_limit import BoxLimit

_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}


@dataclass(eq=False)
class GatheredLimits:
    """lower ≤ q̇ ≤ upper and G q̇ ≤ g, with the kind of limit each bound comes from.

    Attributes:
        lower: Lower velocity bounds, rad/s or m/s, shape (nv,).
        upper: Upper velocity bounds, shape (nv,).
        lower_kind: Kind of the limit that set each lower bound.
        upper_kind: Kind of the limit that set each upper bound.
        rows: G, shape (m, nv).
        bounds: g, shape (m,).
        row_labels: What each row is called in messages.
    """

    lower: Array
    upper: Array
    lower_kind: list[str]
    upper_kind: list[str]
    rows: Array
    bounds: Array
    row_labels: list[str]

    def tighten(self, dof: int, kind: str, lower: float, upper: float) -> None:
        """Intersect one degree of freedom's bounds with another limit's."""
        if lower > self.lower[dof]:
            self.lower[dof], self.lower_kind[dof] = lower, kind
        if upper < self.upper[dof]:
            self.upper[dof], self.upper_kind[dof] = upper, kind


def gather_limits(
    limits: Sequence[mink.Limit], configuration: mink.Configuration, dt: float
) -> GatheredLimits:
    """Evaluate limits at a configuration.

    mink's limits are accepted as they are: a row with a single entry becomes a bound, other rows
    (collision avoidance) stay rows. Where a position limit asks for more speed than a velocity
    limit allows (a start outside the range) the velocity limit wins.

    Raises:
        InvalidInput: If a limit returns NaN, or two limits of one kind contradict each other.
    """
    nv = configuration.model.nv
    names = JointRanges.of(configuration.model).names
    gathered = GatheredLimits(
        np.full(nv, -np.inf), np.full(nv, np.inf), [""] * nv, [""] * nv,
        np.zeros((0, nv)), np.zeros(0), [],
    )  # fmt: skip
    for limit in limits:
        if isinstance(limit, BoxLimit):
            lower, upper = limit.bounds(configuration, dt)
            for dof in range(nv):
                gathered.tighten(dof, limit.kind, lower[dof], upper[dof])
        else:
            _add_rows(gathered, limit, configuration, dt)
    for crossed in np.flatnonzero(gathered.lower > gathered.upper):
        _settle(gathered, int(crossed), names[crossed])
    return gathered


def _add_rows(
    gathered: GatheredLimits, limit: mink.Limit, configuration: mink.Configuration, dt: float
) -> None:
    constraint = limit.compute_qp_inequalities(configuration, dt)
    if constraint.inactive:
        return
    assert constraint.G is not None and constraint.h is not None
    name = limit.kind if isinstance(limit, BandLimit) else type(limit).__name__
    if not np.isfinite(constraint.G).all() or np.isnan(constraint.h).any():
        raise InvalidInput(f"{name}: its rows G Δq ≤ h contain a value that is not a number.")
    kept_rows, kept_bounds = [], []
    for index, (row, bound) in enumerate(zip(constraint.G, constraint.h / dt, strict=True)):
        entries = np.flatnonzero(row)
        if bound == np.inf or (len(entries) == 0 and bound >= 0.0):
            continue
        if len(entries) == 1:
            dof, kind = int(entries[0]), _MINK_KINDS.get(name, name)
            ratio = bound / row[dof]
            if row[dof] > 0.0:
                gathered.tighten(dof, kind, -np.inf, ratio)
            else:
                gathered.tighten(dof, kind, ratio, np.inf)
        else:
            kept_rows.append(row)
            kept_bounds.append(bound)
            gathered.row_labels.append(f"{name} row {index}")
    if kept_rows:
        gathered.rows = np.vstack([gathered.rows, *kept_rows])
        gathered.bounds = np.concatenate([gathered.bounds, kept_bounds])


def _settle(gathered: GatheredLimits, dof: int, joint: str) -> None:
    """Resolve lower > upper on one degree of freedom in favour of what is not a position limit."""
    lower, upper = float(gathered.lower[dof]), float(gathered.upper[dof])
    if gathered.lower_kind[dof] == "position" and gathered.upper_kind[dof] != "position":
        gathered.lower[dof], gathered.lower_kind[dof] = upper, gathered.upper_kind[dof]
    elif gathered.upper_kind[dof] == "position" and gathered.lower_kind[dof] != "position":
        gathered.upper[dof], gathered.upper_kind[dof] = lower, gathered.lower_kind[dof]
    elif lower - upper < 1e-9:
        gathered.lower[dof] = gathered.upper[dof]
    else:
        raise InvalidInput(
            f"limits: joint {joint!r} has a lower velocity bound of {lower:.6g} "
            f"({gathered.lower_kind[dof]}) above its upper bound of {upper:.6g} "
            f"({gathered.upper_kind[dof]}); check the ranges and limits given."
        )

"""Bounds and inequality rows of any limit: of this package, of mink, or of the user."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol
from weakref import WeakKeyDictionary

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, are_floats, are_rows, float_array, within
from qp_twist.constraints.band_limit import BandLimit
from qp_twist.constraints.box import Box, BoxLimit, no_box
from qp_twist.constraints.clearance import Clearance
from qp_twist.constraints.constraint import Constraint, margins_of
from qp_twist.constraints.position_limit import NOTICEABLE
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges

RowName = tuple[str, str]
"""Name and kind of an inequality row, as in :class:`~qp_twist.constraints.BindingLimit`."""
UNLIMITED = 1e12
"""A velocity bound beyond this counts as infinite, rad/s or m/s."""
_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}
_KNOWN: dict[type, str] = {
    mink.ConfigurationLimit: "model gain lower upper indices projection_matrix",
    mink.VelocityLimit: "limit indices projection_matrix",
    mink.FreeJointVelocityLimit: "base_body_id linear_max angular_max",
    mink.CollisionAvoidanceLimit: "model gain geom_id_pairs max_num_contacts bound_relaxation "
    "minimum_distance_from_collisions collision_detection_distance broadphase broadphase_min_pairs",
}
"""Attributes of mink's limits."""
_of_models: WeakKeyDictionary[mujoco.MjModel, tuple[bytes, MinkRange | None]] = WeakKeyDictionary()
_joints: WeakKeyDictionary[mink.Limit, tuple[object, object, tuple[Indices, Indices]]] = (
    WeakKeyDictionary()
)


class Named(Protocol):
    """The source of inequality rows; names are looked up only when a message needs them."""

    @property
    def names(self) -> list[RowName]:
        """Name and kind of each of the rows."""


def kind_of(limit: mink.Limit) -> str:
    """Name of a limit of another package in messages."""
    name = type(limit).__name__
    return limit.kind if isinstance(limit, Constraint) else _MINK_KINDS.get(name, name)


def bounds_of(
    limit: Any, configuration: mink.Configuration, dt: float
) -> MinkRange | LimitRows | tuple[Box, ...]:
    """Bounds and rows of a limit, in the most compact form known for its class.

    A class that is not known, and so every subclass of mink's, states its own rows.
    """
    kind = type(limit)
    if kind is mink.ConfigurationLimit:
        joint_range = range_of(limit, configuration.model)
        if joint_range is not None:
            return joint_range
    elif kind is mink.VelocityLimit:
        speeds = speeds_of(limit, configuration.model.nv)
        if speeds is not None:
            return (speeds,)
    elif BoxLimit in kind.__mro__:  # ``isinstance`` takes three times as long
        boxes: tuple[Box, ...] = limit.boxes(configuration, dt)
        return boxes
    return LimitRows.of(limit, configuration, dt)


def refuse_unknown_attributes(limit: Any) -> None:
    """Refuse a limit of a newer mink that has what is not known here and would be ignored.

    Raises:
        InvalidInput: If one of mink's own classes has such an attribute.
    """
    kind: Any = type(limit)
    unknown = _unknown_names(kind, tuple(limit.__dict__)) if kind in _KNOWN else ()
    if unknown:
        raise InvalidInput(
            f"{kind.__name__} has {' and '.join(map(repr, unknown))}, which qp_twist does not "
            "know and would ignore. Install mink 1.3, for which it is tested, or derive a "
            "class: the rows of its compute_qp_inequalities are taken as they are."
        )


@functools.lru_cache
def _unknown_names(kind: Any, own: tuple[str, ...]) -> list[str]:
    """Public attributes of a class of mink's, and of its objects, that are not known."""
    names = {*own, *dir(kind)} - {"compute_qp_inequalities", *_KNOWN[kind].split()}
    return sorted(name for name in names if not name.startswith("_"))


def check_model(name: str, item: Any, nv: int) -> None:
    """Refuse an item of a model with another number of joints, or with unknown attributes."""
    refuse_unknown_attributes(item)
    given: int | None = None
    if isinstance(getattr(item, "ranges", None), JointRanges):
        given = len(item.ranges.names)
    elif isinstance(item, mink.PostureTask):  # a DampingTask, too
        given = len(item.cost)
    elif isinstance(item, mink.VelocityLimit) and item.projection_matrix is not None:
        given = int(np.shape(item.projection_matrix)[1])
    elif isinstance(getattr(item, "model", None), mujoco.MjModel):
        given = int(item.model.nv)
    if given is not None and given != nv:
        raise InvalidInput(
            f"{name}: {type(item).__name__} is for a model of {given} degrees of freedom, this one "
            f"has {nv}; make it from the same model."
        )


# ---------------------------------------------------------------- mink's limits on single joints


class MinkRange(NamedTuple):
    """Bounds of a :class:`mink.ConfigurationLimit` without its rows."""

    lower: Array
    """θ_min, (nq,)."""
    upper: Array
    """θ_max, (nq,)."""
    gain: float
    addresses: Indices
    """Indices in q of the joints that have a range, (k,)."""
    dofs: Indices
    """Their degrees of freedom, (k,)."""

    def box(self, q: Array, dt: float, nv: int) -> Box:
        """Bounds k (θ_min − θ)/dt and k (θ_max − θ)/dt with mink's gain k, each (nv,)."""
        lower, upper = np.full(nv, -np.inf), np.full(nv, np.inf)
        share, at = self.gain / dt, self.addresses
        lower[self.dofs] = share * (self.lower[at] - q[at])
        upper[self.dofs] = share * (self.upper[at] - q[at])
        return Box("position", lower, upper)


def is_mink_box(limit: Any) -> bool:
    """Whether a limit is one of mink's on single joints.

    A limited ball joint does not count: its row turns with the joint.
    """
    if type(limit) is mink.ConfigurationLimit:
        return len(limit._ball_qposadr) == 0
    return type(limit) is mink.VelocityLimit


def qpos_of(limit: mink.ConfigurationLimit) -> Indices:
    """Index in q of each joint of the limit."""
    return _joints_of(limit)[0]


def _joints_of(limit: mink.ConfigurationLimit) -> tuple[Indices, Indices]:
    """Addresses and dofs of a limit's joints, as in MinkRange; read again if it has others."""
    kept, model = _joints.get(limit), limit.model
    if kept is None or kept[0] is not limit.indices or kept[1] is not model:
        dofs = np.array(limit.indices, dtype=np.intp)
        addresses = model.jnt_qposadr[model.dof_jntid[dofs]].astype(np.intp)
        kept = _joints[limit] = limit.indices, model, (addresses, dofs)
    return kept[2]


def range_of(limit: mink.ConfigurationLimit, model: mujoco.MjModel) -> MinkRange | None:
    """The range of a limit; ``None`` if it limits a ball joint, or is not for this model.

    The bounds are read in each call.
    """
    refuse_unknown_attributes(limit)
    joints, own, nq = _joints_of(limit), limit.model, model.nq
    lower, upper = limit.lower, limit.upper
    if not (
        is_mink_box(limit)
        and own.nq == nq
        and own.nv == model.nv
        and (limit.projection_matrix is None) == (len(joints[1]) == 0)
        and are_floats(lower, nq)
        and are_floats(upper, nq)
    ):
        return None
    return MinkRange(lower, upper, float(limit.gain), *joints)


def default_range(model: mujoco.MjModel) -> MinkRange | None:
    """The range of ``mink.ConfigurationLimit(model)``, cached while the model's ranges stay.

    mink builds one in each call, which takes longer than the rest of a step. Joints and their order
    cannot change in a model that is in use.
    """
    ranges = model.jnt_range.tobytes() + model.jnt_limited.tobytes()
    kept = _of_models.get(model)
    if kept is None or kept[0] != ranges:
        # Only arrays: a reference to the model would keep it alive for ever.
        kept = _of_models[model] = ranges, range_of(mink.ConfigurationLimit(model), model)
    return kept[1]


def speeds_of(limit: mink.VelocityLimit, nv: int) -> Box | None:
    """The bounds of a velocity limit; ``None`` if it is for another model."""
    refuse_unknown_attributes(limit)
    if limit.projection_matrix is None:
        return no_box("velocity", nv)
    if limit.projection_matrix.shape[1] != nv:
        return None
    upper = np.full(nv, np.inf)
    upper[limit.indices] = limit.limit
    return Box("velocity", -upper, upper)


# ------------------------------------------------------------------------------- rows of any limit


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
        lists or a single row. Anything else is refused.
        """
        refuse_unknown_attributes(limit)
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
        if rows.shape != (len(ends), nv) or ends.ndim != 1:
            raise InvalidInput(
                f"{name}: G of G Δq ≤ h: expected shape (rows, {nv}), and h of shape (rows,), got "
                f"{np.shape(G)} and {np.shape(h)}."
            )
        return cls(limit, rows, ends)

    def recovering(self, configuration: mink.Configuration) -> tuple[str, ...]:
        """A sentence for each violated margin of a constraint."""
        if isinstance(self.limit, Constraint) and np.count_nonzero(self.h < 0.0):
            return _recovering(self.limit, configuration)
        return ()


@dataclass(eq=False)
class RowsOf:
    """Some rows of a limit.

    Attributes:
        limit: The limit.
        which: Their indices among all rows of the limit, (k,); of a clearance those of the pairs.
    """

    limit: mink.Limit
    which: Indices

    @classmethod
    def at(cls, limit: mink.Limit, rows: Indices) -> RowsOf:
        """The rows of some indices, (k,), among those that the limit has just stated."""
        return cls(limit, limit.in_step.pairs[rows] if isinstance(limit, Clearance) else rows)

    @property
    def names(self) -> list[RowName]:
        """Of the rows."""
        return [_row_name(self.limit, row) for row in self.which.tolist()]


@dataclass(eq=False)
class EvaluatedLimit(RowsOf):
    """Bounds and rows of any mink limit at a configuration.

    Attributes:
        box: Its rows with a single entry, as bounds.
        rows: The other rows, without those that always hold, (k, nv).
        bounds: Their right-hand side, (k,), rad/s or m/s.
        rooms: The part of it that is what is left of a clearance, over dt; else 0, (k,).
        recovering: A sentence for each violated margin, if the limit is a constraint.
    """

    box: Box
    rows: Array
    bounds: Array
    rooms: Array
    recovering: tuple[str, ...]

    @classmethod
    def of(
        cls, limit: mink.Limit | LimitRows, configuration: mink.Configuration, dt: float
    ) -> EvaluatedLimit | None:
        """Evaluate a limit, or sort rows that it has stated; ``None`` if none restricts the step.

        Raises:
            InvalidInput: If a row is not a number, or cannot hold.
        """
        if isinstance(limit, Clearance):
            # Its rows stay rows, so that they have the names of their pairs; they are numbers.
            rows, bounds, rooms, pairs = limit.step_rows(configuration, dt)
            if not len(bounds):
                return None
            too_near = _recovering(limit, configuration) if limit.in_step.least < 0.0 else ()
            box = no_box(limit.kind, configuration.model.nv)
            return cls(limit, pairs, box, rows, bounds, rooms, too_near)
        known = limit if isinstance(limit, LimitRows) else LimitRows.of(limit, configuration, dt)
        stating, G, h = known
        name = type(stating).__name__
        if not len(h):
            return None
        within(f"{name}: G", G, UNLIMITED)
        if not h.min() > -np.inf:  # false for NaN
            raise InvalidInput(
                f"{name}: its rows G Δq ≤ h need h without NaN or −∞, it is {h!r}."[:300]
            )
        g: Array = np.where(h > UNLIMITED * dt, np.inf, h / dt)
        entries = (G != 0.0).sum(axis=1)
        box = _box(kind_of(stating), G[entries == 1], g[entries == 1])
        rest = ((entries > 1) & (g < np.inf) | (entries == 0) & (g < 0.0)).nonzero()[0]
        which = RowsOf.at(stating, rest).which
        recovering = known.recovering(configuration)
        return cls(stating, which, box, G[rest], g[rest], np.zeros(len(rest)), recovering)


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
    if isinstance(limit, Clearance):
        return limit.names[row], limit.kind
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

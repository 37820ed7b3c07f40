"""Bounds and inequality rows of any limit: of this package, of mink, or of the user."""

from __future__ import annotations

import functools
import weakref
from dataclasses import dataclass
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, are_rows, float_array, within
from qp_twist.constraints.band_limit import BandLimit
from qp_twist.constraints.box import Box, no_box
from qp_twist.constraints.clearance import Clearance
from qp_twist.constraints.constraint import Constraint, margins_of
from qp_twist.errors import InvalidInput
from qp_twist.kernel.constants import NOTICEABLE, UNLIMITED
from qp_twist.kinematics import JointRanges

RowName = tuple[str, str]
"""Name and kind of an inequality row, as in :class:`~qp_twist.constraints.BindingLimit`."""
_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}
_KNOWN: dict[type, str] = {
    mink.ConfigurationLimit: "model gain lower upper indices projection_matrix",
    mink.VelocityLimit: "limit indices projection_matrix",
    mink.FreeJointVelocityLimit: "base_body_id linear_max angular_max",
    mink.CollisionAvoidanceLimit: "model gain geom_id_pairs max_num_contacts bound_relaxation "
    "minimum_distance_from_collisions collision_detection_distance broadphase broadphase_min_pairs",
}
"""Attributes of mink's limits."""
_of_models: WeakKeyDictionary[mujoco.MjModel, tuple[bytes, mink.ConfigurationLimit]] = (
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


def refuse_unknown_attributes(limit: Any) -> None:
    """Refuse a limit of a newer mink that has what is not known here and would be ignored."""
    kind: Any = type(limit)
    if kind in _KNOWN and (unknown := _unknown_names(kind, tuple(limit.__dict__))):
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


def is_mink_box(limit: Any) -> bool:
    """Whether a limit is one of mink's on single joints.

    A limited ball joint does not count: its row turns with the joint.
    """
    if type(limit) is mink.ConfigurationLimit:
        return len(limit._ball_qposadr) == 0
    return type(limit) is mink.VelocityLimit


def qpos_of(limit: mink.ConfigurationLimit) -> Indices:
    """Index in q of each joint of the limit."""
    return np.asarray(limit.model.jnt_qposadr[limit.model.dof_jntid[limit.indices.astype(np.intp)]])


def has_plain_rows(limit: Any, configuration: mink.Configuration) -> bool:
    """Whether a limit is one of mink's on single joints, of this model, with rows ±Δqᵢ ≤ h."""
    if not is_mink_box(limit) or limit.projection_matrix is None:
        return False
    own, model = getattr(limit, "model", configuration.model), configuration.model
    if own is model:
        return bool(limit.projection_matrix.shape[1] == model.nv)
    return bool(own.nq == model.nq and own.nv == model.nv)


def box_of_mink(limit: Any, configuration: mink.Configuration, dt: float) -> Box | None:
    """The bounds of one of mink's limits on single joints; ``None`` of any other."""
    if not has_plain_rows(limit, configuration):
        return None
    refuse_unknown_attributes(limit)
    G, h = limit.compute_qp_inequalities(configuration, dt)
    lower, upper = np.full((2, G.shape[1]), [[-np.inf], [np.inf]])
    upper[limit.indices], lower[limit.indices] = np.split(h / dt, 2) * np.array([[1.0], [-1.0]])
    return Box(kind_of(limit), lower, upper)


def default_limit(model: mujoco.MjModel) -> mink.ConfigurationLimit:
    """``mink.ConfigurationLimit(model)``, kept while the model's ranges stay; without balls.

    mink makes it in each call, which takes longer than the rest of a step.
    """
    ranges = model.jnt_range.tobytes() + model.jnt_limited.tobytes()
    kept = _of_models.get(model)
    if kept is None or kept[0] != ranges:
        limit = mink.ConfigurationLimit(model)
        if not is_mink_box(limit):
            return limit
        # A reference from the value to the model, its key, would keep it alive for ever.
        limit.model = weakref.proxy(model)
        kept = _of_models[model] = ranges, limit
    return kept[1]


def stated_rows(
    limit: mink.Limit, configuration: mink.Configuration, dt: float
) -> tuple[Array, Array]:
    """G (k, nv) and h (k,) of a limit's rows G Δq ≤ h, without rows where it is inactive.

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
        return np.zeros((0, nv)), np.zeros(0)
    if are_rows(G, h, nv):
        return G, h
    rows = np.atleast_2d(float_array(f"{name}: G of G Δq ≤ h", G))
    ends = np.atleast_1d(float_array(f"{name}: h of G Δq ≤ h", h))
    if rows.shape != (len(ends), nv) or ends.ndim != 1:
        raise InvalidInput(
            f"{name}: G of G Δq ≤ h: expected shape (rows, {nv}), and h of shape (rows,), got "
            f"{np.shape(G)} and {np.shape(h)}."
        )
    return rows, ends


@dataclass(eq=False)
class LimitRows:
    """Bounds and rows of any mink limit at a configuration.

    Attributes:
        limit: The limit.
        which: Indices of the rows among all of the limit, (k,); of a clearance those of the pairs.
        box: Its rows with a single entry, as bounds.
        rows: The other rows, without those that always hold, (k, nv).
        bounds: Their right-hand side, (k,), rad/s or m/s.
        recovering: A sentence for each violated margin, if the limit is a constraint.
    """

    limit: mink.Limit
    which: Indices
    box: Box
    rows: Array
    bounds: Array
    recovering: tuple[str, ...]

    @property
    def names(self) -> list[RowName]:
        """Of the rows."""
        return [_row_name(self.limit, row) for row in self.which.tolist()]

    @classmethod
    def of(
        cls,
        limit: mink.Limit,
        configuration: mink.Configuration,
        dt: float,
        stated: tuple[Array, Array] | None = None,
    ) -> LimitRows | None:
        """Evaluate a limit, or sort rows G Δq ≤ h that it has stated; ``None`` without any.

        Rows that are no numbers, or cannot hold, are refused.
        """
        if isinstance(limit, Clearance):
            # Its rows stay rows, so that they have the names of their pairs; they are numbers.
            rows, bounds, pairs = limit.step_rows(configuration, dt, begin=stated is None)
            if not len(bounds):
                return None
            too_near = _recovering(limit, configuration) if limit.in_step.least < 0.0 else ()
            box = no_box(limit.kind, configuration.model.nv)
            return cls(limit, pairs, box, rows, bounds, too_near)
        G, h = stated_rows(limit, configuration, dt) if stated is None else stated
        name = type(limit).__name__
        if not len(h):
            return None
        within(f"{name}: G", G, UNLIMITED)
        if not h.min() > -np.inf:  # false for NaN
            raise InvalidInput(
                f"{name}: its rows G Δq ≤ h need h without NaN or −∞, it is {h!r}."[:300]
            )
        g: Array = np.where(h > UNLIMITED * dt, np.inf, h / dt)
        entries = np.count_nonzero(G, axis=1)
        box = _box(kind_of(limit), G[entries == 1], g[entries == 1])
        rest = ((entries > 1) & (g < np.inf) | (entries == 0) & (g < 0.0)).nonzero()[0]
        recovering: tuple[str, ...] = ()
        if isinstance(limit, Constraint) and np.count_nonzero(h < 0.0):
            recovering = _recovering(limit, configuration)
        return cls(limit, rest, box, G[rest], g[rest], recovering)


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
        name = limit.names[row] if isinstance(limit, Clearance) else limit.row_name(row)
        return name, limit.kind
    if type(limit) is mink.ConfigurationLimit and row >= 2 * len(limit.indices):
        dof = int(limit._ball_dofadr[row - 2 * len(limit.indices)])
        return limit.model.joint(int(limit.model.dof_jntid[dof])).name, "position"
    name = type(limit).__name__
    return f"{name} row {row}", name


def _box(kind: str, rows: Array, bounds: Array) -> Box:
    """Convert rows (m, nv) with a single entry, and their bounds (m,), to a box."""
    if not len(bounds):
        return no_box(kind, rows.shape[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = bounds[:, None] / rows
    lower = np.where(rows < 0.0, bound, -np.inf).max(axis=0, initial=-np.inf)
    upper = np.where(rows > 0.0, bound, np.inf).min(axis=0, initial=np.inf)
    return Box(kind, lower, upper)

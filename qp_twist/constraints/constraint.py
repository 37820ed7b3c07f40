"""Base class of constraints on configurations, used by steps, plans and checks alike."""

from __future__ import annotations

import abc
from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask, clause, float_array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges


class Constraint(mink.Limit):
    r"""Base of constraints on configurations, m(q) ≥ 0, with margins m.

    A subclass states :meth:`margins`, :meth:`gradients`, a bound on their :meth:`change`, ``names``
    and ``units``. A step uses the rows

    .. math::

        -\nabla m(\mathbf q)^T \Delta\mathbf q \le \max(m(\mathbf q),\; -v\,dt)

    with the ``recovery_speed`` v, at which a violated margin returns; :func:`mink.solve_ik` takes
    them, too. A plan uses the rows along the whole path. A check proves from the bound that the
    constraint holds between two waypoints. Add it to a path by
    ``dataclasses.replace(path_task, constraints=(…,))``, to a controller by ``limits``.

    Attributes:
        kind: Its name in messages and in :class:`~qp_twist.constraints.BindingLimit`.
        names: Name of each of the k margins.
        units: Unit of each margin, ``"m"`` or ``"rad"``.
        recovery_speed: Largest speed at which a step returns from outside, m/s or rad/s.
        only_configurations: Whether it constrains configurations only. A limit that also constrains
            velocities cannot be a constraint of a path.
    """

    kind: str = "constraint"
    names: tuple[str, ...]
    units: tuple[str, ...]
    recovery_speed: float = 0.1
    only_configurations: bool = True

    @abc.abstractmethod
    def margins(self, q: Array) -> Array:
        """Margins (N, k) of configurations q (N, nq), m or rad; at least 0 inside."""

    @abc.abstractmethod
    def gradients(self, q: Array) -> Array:
        """Derivatives of the margins with respect to each degree of freedom, (N, k, nv)."""

    def gradients_of(self, q: Array, which: Mask) -> Array:
        """The gradients (N, k, nv) of some margins (N, k); others may be 0."""
        return self.gradients(q)

    @abc.abstractmethod
    def change(self, q: Array, travel: Array) -> Array:
        """Bound of each margin's total variation on motions that start at q, (N, k).

        Args:
            q: Start of the motions, (N, nq).
            travel: Largest path length of each degree of freedom, rad or m, (N, nv).
        """

    def bounded(self, q: Array, enough: float) -> Array:
        """Margins (N, k) of which those above ``enough`` may be lower bounds above it.

        A subclass overrides it where that takes less time than :meth:`margins`.
        """
        return margins_of(self, q)

    def inside(self, q: Array, tolerance: float) -> Mask:
        """Which configurations q (N, nq) violate no margin by more than a tolerance, (N,)."""
        return np.asarray((self.bounded(q, -tolerance) >= -tolerance).all(axis=1))

    def least(
        self, before: Array, after: Array, travel: Array, curve: Array | None = None
    ) -> Array:
        r"""Lower bound of each margin on motions from one configuration to another, (N, k).

        With margins :math:`m_0` at the start and :math:`m_1` at the end, and a total variation of
        at most c, the margin stays above :math:`(m_0 + m_1 - c)/2`. A subclass may return a tighter
        bound; it has to hold for every motion within the bounds of travel and curve.

        Args:
            before: Start of the motions, (N, nq).
            after: Their end, (N, nq).
            travel: As in :meth:`change`; with ``curve`` the largest :math:`|dq/ds|`, too.
            curve: Largest :math:`|d^2q/ds^2|` of each degree of freedom, with s from 0 at the start
                to 1 at the end, rad or m, (N, nv): 0 where the joints move straight. ``None`` where
                it is not known.
        """
        change = self.change(before, travel)
        if not (np.asarray(change) >= 0.0).all():  # false for NaN
            raise InvalidInput(
                f"{type(self).__name__}: change(q, travel): expected by how much margins vary at "
                "most, at least 0, got a negative number or none."
            )
        return 0.5 * (margins_of(self, before) + margins_of(self, after) - change)

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """Linear rows that keep the margins above 0, to first order: rows · Δq ≤ rooms.

        Rows (N, m, nv), rooms (N, m), and the index of each row's margin, (m,); by default one row
        for each margin.
        """
        return -self.gradients(q), self.margins(q), np.arange(len(self.names))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The rows of one step, G Δq ≤ h, shapes (m, nv) and (m,)."""
        rows, rooms, _ = self.rows(configuration.q[None])
        return mink.Constraint(G=rows[0], h=np.maximum(rooms[0], -self.recovery_speed * dt))

    def row_name(self, row: int) -> str:
        """Name of a row of the step; override it if there is not one row for each margin."""
        return self.names[row]

    def check_model(self, label: str, model: mujoco.MjModel) -> None:
        """Raise InvalidInput, the message beginning with ``label``, for another robot's model."""

    def excess(self, q: Array) -> Array:
        """Largest violation at configurations q (N, nq), 0 inside, m or rad, (N,)."""
        return np.asarray(np.maximum(-self.bounded(q, 0.0).min(axis=1, initial=np.inf), 0.0))


def margins_of(constraint: Constraint, q: Array) -> Array:
    """The margins (N, k) of a constraint at configurations q (N, nq), checked."""
    margins = constraint.margins(q)
    name, shape = type(constraint).__name__, (len(q), len(constraint.names))
    if not isinstance(margins, np.ndarray) or margins.shape != shape:
        raise InvalidInput(
            f"{name}: margins(q) of {len(q)} configurations: expected an array of shape {shape}, "
            f"got {type(margins).__name__} of {np.shape(margins)}."
        )
    if np.isnan(margins).any():
        first = int(np.argmax(np.isnan(margins).any(axis=1)))
        raise InvalidInput(
            f"{name}: margins(q) is NaN at q = {q[first].round(4).tolist()}; state a number for "
            "every configuration."
        )
    return margins


def check_constraint(label: str, constraint: Constraint, model: mujoco.MjModel) -> None:
    """Refuse a constraint whose kind, names, units and arrays do not fit each other or the robot.

    Messages begin with ``label``.
    """
    constraint.check_model(label, model)
    kind, names = constraint.kind, constraint.names
    if not isinstance(kind, str) or not kind:
        raise InvalidInput(f"{label}: expected its kind as a name for messages, got {kind!r}.")
    count = len(names)
    if not all(isinstance(name, str) for name in names) or len(constraint.units) != count:
        raise InvalidInput(
            f"{label}: expected names, texts, and as many units; got {names!r} and "
            f"{constraint.units!r}."[:300]
        )
    q, travel = np.tile(model.qpos0, (2, 1)), np.ones((2, model.nv))
    still = np.zeros_like(travel)
    for what, arguments in (
        ("margins(q)", (q,)),
        ("gradients(q)", (q,)),
        ("change(q, travel)", (q, travel)),
        ("least(before, after, travel, curve)", (q, q, travel, still)),
    ):
        method = what.partition("(")[0]
        shape = (2, count, model.nv) if method == "gradients" else (2, count)
        call = f"{label}: {what} of two configurations (2, {model.nq})"
        try:
            found = float_array(call, getattr(constraint, method)(*arguments))
        except InvalidInput:
            raise
        except Exception as error:  # may be a class of the user
            raise InvalidInput(
                f"{call} raises {type(error).__name__}: {clause(error)}. It has to be a constraint "
                f"of this robot, which has {model.nv} degrees of freedom."
            ) from error
        if found.shape != shape or np.isnan(found).any():
            raise InvalidInput(f"{call}: expected numbers of shape {shape}, got {found!r}."[:300])


def check_constraints(
    name: str, constraints: Sequence[Constraint], model: mujoco.MjModel
) -> tuple[Constraint, ...]:
    """The constraints of the path ``name``; what is none of this robot's is refused."""
    if not isinstance(constraints, (list, tuple)):
        raise InvalidInput(f"{name}: constraints: expected a list, got {constraints!r}.")
    if constraints and not JointRanges.of(model).only_hinges_and_slides:
        raise InvalidInput(
            f"{name}: constraints: the robot has ball or free joints, for which nothing can be "
            "proven between waypoints; give its controller the limits instead."
        )
    for k, constraint in enumerate(constraints):
        label, kind = f"{name}: constraints[{k}]", type(constraint).__name__
        if not isinstance(constraint, Constraint):
            raise InvalidInput(
                f"{label}: expected a qp_twist.Constraint, got {kind}: it has no margins that "
                "plans and checks could evaluate. Write a subclass of Constraint, or pass it to a "
                "Controller as a limit, which needs its rows only."
            )
        if not constraint.only_configurations:
            raise InvalidInput(
                f"{label}: {kind} limits velocities, too, which are no constraint on "
                "configurations; give those to the path as velocity_limits and acceleration_limits."
            )
        if set(constraint.units) not in (set(), {"m"}, {"rad"}):
            raise InvalidInput(
                f"{label}: expected a unit for each of its {len(constraint.names)} names, all 'm' "
                f"or all 'rad', got {constraint.units!r}."
            )
        check_constraint(label, constraint, model)
    return tuple(constraints)

"""What a motion has to keep, stated once: a class per constraint, which everyone asks."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from functools import partial

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, float_array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges


class Constraint(mink.Limit):
    r"""Base of the constraints on configurations: margins m(q) that have to stay at 0 or above.

    A constraint states for itself its :meth:`margins`, their :meth:`gradients`, a bound on their
    :meth:`change`, and its ``names`` and ``units``. That is enough for everyone who asks: a step
    keeps its rows

    .. math::

        -\nabla m(\mathbf q)^T \Delta\mathbf q \le \max(m(\mathbf q),\; -v\,dt)

    (it is a :class:`mink.Limit`, also for :func:`mink.solve_ik`; v is ``recovery_speed``, by which
    what is outside comes back), a plan its rows along the whole path, and the referee proves from
    the bound that it is kept between two waypoints. It is given to a path by
    ``dataclasses.replace(path_task, constraints=(…,))``, to a controller among its ``limits``.

    Attributes:
        kind: How messages and :class:`~qp_twist.BindingLimit` call it.
        names: What each of the k margins is of.
        units: ``"m"`` or ``"rad"`` of each margin.
        recovery_speed: Largest speed of return that a step demands outside, m/s or rad/s.
        only_configurations: Whether the margins say all that the rows keep; where a limit keeps
            velocities, too, it is no constraint of a path.
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
        """How the margins change with each degree of freedom, (N, k, nv)."""

    @abc.abstractmethod
    def change(self, q: Array, travel: Array) -> Array:
        """By how much each margin varies at most, in sum, on motions that begin at q, (N, k).

        Args:
            q: Where they begin, (N, nq).
            travel: How far each degree of freedom moves on them, forth and back counted, at most,
                rad or m, (N, nv).
        """

    def least(self, before: Array, after: Array, travel: Array) -> Array:
        r"""What no margin falls below on motions from one configuration to another, (N, k).

        Of margins :math:`m_0` at the begin and :math:`m_1` at the end, and a change of at most c
        in sum, none on the way is below :math:`(m_0 + m_1 - c)/2`. A constraint that knows more
        about its margins may say more, of every motion within that travel, be it straight or not.

        Args:
            before: Where the motions begin, (N, nq).
            after: Where they end, (N, nq).
            travel: As in :meth:`change`.
        """
        change = self.change(before, travel)
        if not (np.asarray(change) >= 0.0).all():  # false for NaN
            raise InvalidInput(
                f"{type(self).__name__}: change(q, travel): expected by how much margins vary at "
                "most, at least 0, got a negative number or none."
            )
        least: Array = 0.5 * (margins_of(self, before) + margins_of(self, after) - change)
        return least

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """What keeps the margins above 0, to first order: rows · Δq ≤ rooms.

        Returns:
            Rows (N, m, nv), rooms (N, m), and which margin each of them is of, (m,); here one row a
            margin.
        """
        return -self.gradients(q), self.margins(q), np.arange(len(self.names))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The rows of one step, G Δq ≤ h, shapes (m, nv) and (m,)."""
        rows, rooms, _ = self.rows(configuration.q[None])
        return mink.Constraint(G=rows[0], h=np.maximum(rooms[0], -self.recovery_speed * dt))

    def row_name(self, row: int) -> str:
        """What a row of the step is of; to be overridden where it has others than one a margin."""
        return self.names[row]

    def excess(self, q: Array) -> Array:
        """How far configurations q (N, nq) are outside, 0 inside, m or rad, (N,)."""
        worst: Array = np.maximum(-self.margins(q).min(axis=1, initial=np.inf), 0.0)
        return worst


def margins_of(constraint: Constraint, q: Array) -> Array:
    """The margins (N, k) that a constraint states at configurations q (N, nq), which are numbers.

    Raises:
        InvalidInput: If they have another shape, or one is NaN: nothing can be proven by that.
    """
    margins = constraint.margins(q)
    shape = len(q), len(constraint.names)
    if not isinstance(margins, np.ndarray) or margins.shape != shape:
        raise InvalidInput(
            f"{type(constraint).__name__}: margins(q) of {len(q)} configurations: expected an "
            f"array of shape {shape}, got {type(margins).__name__} of {np.shape(margins)}."
        )
    if np.isnan(margins).any():
        first = int(np.argmax(np.isnan(margins).any(axis=1)))
        raise InvalidInput(
            f"{type(constraint).__name__}: margins(q) is NaN at q = {q[first].round(4).tolist()}; "
            "state a number for every configuration."
        )
    return margins


def check_constraint(said: str, constraint: Constraint, model: mujoco.MjModel) -> None:
    """Refuse a constraint that does not fit itself or the robot; ``said``: how messages call it.

    Raises:
        InvalidInput: If its kind is no name, or its names, units, margins, gradients or change are
            not of one number of margins, for this robot.
    """
    kind, names = constraint.kind, constraint.names
    if not isinstance(kind, str) or not kind:
        raise InvalidInput(f"{said}: expected its kind as a name for messages, got {kind!r}.")
    count = len(names)
    if not all(isinstance(name, str) for name in names) or len(constraint.units) != count:
        raise InvalidInput(
            f"{said}: expected names, texts, and as many units; got {names!r} and "
            f"{constraint.units!r}."[:300]
        )
    q, travel = np.tile(model.qpos0, (2, 1)), np.ones((2, model.nv))
    for what, ask, shape in (
        ("margins(q)", partial(constraint.margins, q), (2, count)),
        ("gradients(q)", partial(constraint.gradients, q), (2, count, model.nv)),
        ("change(q, travel)", partial(constraint.change, q, travel), (2, count)),
    ):
        asked = f"{said}: {what} of two configurations (2, {model.nq})"
        try:
            found = float_array(asked, ask())
        except InvalidInput:
            raise
        except Exception as error:  # of anybody's class
            raise InvalidInput(
                f"{asked} raises {type(error).__name__}: {error}. It has to be a constraint of "
                f"this robot, which has {model.nv} degrees of freedom."
            ) from error
        if found.shape != shape or np.isnan(found).any():
            raise InvalidInput(f"{asked}: expected numbers of shape {shape}, got {found!r}."[:300])


def check_constraints(
    name: str, constraints: Sequence[Constraint], model: mujoco.MjModel
) -> tuple[Constraint, ...]:
    """The constraints of a path called ``name``.

    Raises:
        InvalidInput: If one is no :class:`Constraint`, keeps more than configurations, or its
            margins, names and units do not fit each other or the robot.
    """
    if not isinstance(constraints, (list, tuple)):
        raise InvalidInput(f"{name}: constraints: expected a list, got {constraints!r}.")
    if constraints and not JointRanges.of(model).only_hinges_and_slides:
        raise InvalidInput(
            f"{name}: constraints: the robot has ball or free joints, of which nothing is proven "
            "between waypoints; give its controller the limits instead."
        )
    for k, constraint in enumerate(constraints):
        said = f"{name}: constraints[{k}]"
        if not isinstance(constraint, Constraint):
            raise InvalidInput(
                f"{said}: expected a qp_twist.Constraint, got {type(constraint).__name__}: it has "
                "no margins that plans and checks could ask. State it as a subclass of Constraint, "
                "or give it to a Controller's limits, where steps keep its rows."
            )
        if not constraint.only_configurations:
            raise InvalidInput(
                f"{said}: {type(constraint).__name__} limits velocities, too, which are no "
                "constraint on configurations; give those to the path as velocity_limits and "
                "acceleration_limits."
            )
        count, units = len(constraint.names), set(constraint.units)
        if len(constraint.units) != count or len(units) != 1 or not units <= {"m", "rad"}:
            raise InvalidInput(
                f"{said}: expected a unit for each of its {count} names, all 'm' or all 'rad', got "
                f"{constraint.units!r}."
            )
        check_constraint(said, constraint, model)
    return tuple(constraints)

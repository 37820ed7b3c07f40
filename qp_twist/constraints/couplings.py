"""Joints that MJCF couples (``<equality><joint …/></equality>``): grippers, linkages."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from qp_twist.checks import Array, Indices, Mask, number, one_of
from qp_twist.constraints.colliding_pairs import body_name
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges

COUPLED_WITHIN = 1e-5
"""Largest deviation of a coupled joint from its coupling, rad or m: at a reach of 2 m 0.02 mm, a
fifth of the tolerance of a check, and ten times the rounding of files."""


class JointCouplings(Constraint):
    r"""Keep the joint couplings of a model (equality constraints of joints).

    .. math::

        |\theta_1 - p(\theta_2)| \le \epsilon, \qquad
        p(\theta_2) = \theta_1^0 + \sum_{k=0}^{4} c_k\,(\theta_2 - \theta_2^0)^k

    with the positions at the reference configuration ``qpos0`` and the coefficients ``polycoef``
    (MuJoCo's documentation, *XML Reference*, equality/joint). Without a second joint the first one
    stays at :math:`\theta_1^0 + c_0`. Only couplings that are initially active (``eq_active0``)
    count.

    A path whose model couples joints always has this constraint, with the default tolerance unless
    another is passed; so has a :class:`~qp_twist.Controller` without ``limits``.

    Attributes:
        tolerance: ε, rad or m.
        first: Degree of freedom of the first joint of each coupling, (C,).
        second: That of the second one, (C,); the first again if there is none.
        start: Their positions at ``qpos0``, rad or m, (C, 2).
        coefficients: :math:`c_0 \dots c_4`, (C, 5).
    """

    kind = "coupling"

    def __init__(
        self,
        model: mujoco.MjModel,
        tolerance: float = COUPLED_WITHIN,
        *,
        unit: str | None = None,
        recovery_speed: float = 0.1,
    ) -> None:
        """Read the couplings of a model.

        Of those whose first joint is a hinge, ``unit="rad"``, or a slide, ``"m"``, or of all.
        ``recovery_speed`` is that at which a step corrects a violated coupling, rad/s or m/s.
        """
        ranges = JointRanges.of(model)
        self.tolerance = number("tolerance", tolerance, above=0.0)
        self.recovery_speed = number("recovery_speed", recovery_speed, above=0.0)
        if unit is not None:
            one_of("unit", unit, ("rad", "m"))
        rows = np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 != 0))
        dofs = model.jnt_dofadr[model.eq_obj1id[rows]].astype(np.intp)
        if unit is not None:
            of_unit = np.array(ranges.units)[dofs] == unit
            rows, dofs = rows[of_unit], dofs[of_unit]
        alone = model.eq_obj2id[rows] < 0
        self.first: Indices = dofs
        self.second: Indices = np.where(alone, dofs, model.jnt_dofadr[model.eq_obj2id[rows]])
        self.start: Array = model.qpos0[ranges.qpos[np.column_stack([self.first, self.second])]]
        self.coefficients: Array = model.eq_data[rows, :5].copy()
        self.coefficients[alone, 1:] = 0.0
        self.names = tuple(
            ranges.names[one] if by_itself else f"{ranges.names[one]} to {ranges.names[two]}"
            for one, two, by_itself in zip(self.first, self.second, alone, strict=True)
        )
        self.units = tuple(ranges.units[dof] for dof in self.first)
        self._ranges, self._reference = ranges, model.qpos0.copy()
        self._each = np.arange(len(self.names))
        # Coefficients of p and its derivatives, without powers that no coupling has.
        degree = int(np.flatnonzero(self.coefficients.any(axis=0)).max(initial=0))
        powers = self.coefficients[:, : degree + 1].T
        self._derivatives = [polyder(powers, order) for order in range(5)]
        if not np.isfinite(self.coefficients).all():
            broken = self.names[int(np.argmin(np.isfinite(self.coefficients).all(axis=1)))]
            raise InvalidInput(
                f"model: the coupling of {broken} has coefficients that are no numbers; check "
                "polycoef in the scene's <equality>."
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Name of the joint of each degree of freedom."""
        return self._ranges.names

    @property
    def curved(self) -> Mask:
        """Which of them are not linear, (C,)."""
        return np.asarray(self.coefficients[:, 2:].any(axis=1))

    def residuals(self, q: Array) -> Array:
        """θ₁ − p(θ₂) of configurations q (N, nq), rad or m, (N, C)."""
        positions = self._ranges.positions(q)
        return positions[:, self.first] - self.start[:, 0] - self._p(0, positions)

    def slopes(self, q: Array) -> Array:
        """Derivatives of the residuals with respect to each degree of freedom, (N, C, nv)."""
        slopes = np.zeros((len(q), len(self.names), len(self.joints)))
        slopes[:, self._each, self.first] = 1.0
        slopes[:, self._each, self.second] -= self._p(1, self._ranges.positions(q))
        return slopes

    def margins(self, q: Array) -> Array:
        """ε − |θ₁ − p(θ₂)|, rad or m, (N, C)."""
        return self.tolerance - np.abs(self.residuals(q))

    def gradients(self, q: Array) -> Array:
        """Derivatives of the margins, (N, C, nv)."""
        signs = np.where(self.residuals(q) < 0.0, 1.0, -1.0)
        return signs[:, :, None] * self.slopes(q)

    def change(self, q: Array, travel: Array) -> Array:
        r"""Travel of the first joint plus that of the second times the largest |p'|, (N, C).

        θ₂ stays within its travel t of its start, where the slope of a polynomial of degree four is
        at most :math:`|p'| + |p''|\,t + |p'''|\,t^2/2 + |p''''|\,t^3/6` (Taylor).
        """
        t = travel[:, self.second]
        positions = self._ranges.positions(q)
        first, second, third, fourth = (np.abs(self._p(k, positions)) for k in range(1, 5))
        steepest = first + t * (second + t * (third / 2.0 + t * fourth / 6.0))
        return travel[:, self.first] + steepest * t

    def rows(self, q: Array) -> tuple[Array, Array, Indices]:
        """Both sides of each coupling: rows (N, 2 C, nv), rooms (N, 2 C), and its index."""
        slopes, residuals = self.slopes(q), self.residuals(q)
        return (
            np.concatenate([slopes, -slopes], axis=1),
            np.concatenate([self.tolerance - residuals, self.tolerance + residuals], axis=1),
            np.concatenate([self._each, self._each]),
        )

    def row_name(self, row: int) -> str:
        """Name of the coupling, the same for both sides."""
        return self.names[row % len(self.names)]

    def independent(self) -> Indices:
        """Indices of the linearly independent couplings, at ``qpos0``."""
        slopes, kept = self.slopes(self._reference[None])[0], list[int]()
        for row in range(len(slopes)):
            if np.linalg.matrix_rank(slopes[[*kept, row]]) > len(kept):
                kept.append(row)
        return np.array(kept, dtype=np.intp)

    def __repr__(self) -> str:
        return f"JointCouplings({list(self.names)}, tolerance {self.tolerance:g})"

    def _p(self, order: int, positions: Array) -> Array:
        """p − θ₁⁰ or its derivative of some order at joint positions (N, nv), (N, C)."""
        x = positions[:, self.second] - self.start[:, 1]
        return np.asarray(polyval(x, self._derivatives[order], tensor=False), dtype=np.float64)


def couplings_of(
    model: mujoco.MjModel, templates: Sequence[JointCouplings] = ()
) -> tuple[JointCouplings, ...]:
    """The couplings of a model, one constraint for each unit, as a path needs them.

    Tolerances and recovery speeds are by unit those of ``templates``, even of another model.
    """
    numbers = dict.fromkeys(("rad", "m"), (COUPLED_WITHIN, JointCouplings.recovery_speed))
    for template in templates:
        for unit in template.units:
            numbers[unit] = template.tolerance, template.recovery_speed
    made = (
        JointCouplings(model, tolerance, unit=unit, recovery_speed=speed)
        for unit, (tolerance, speed) in numbers.items()
    )
    return tuple(couplings for couplings in made if couplings.names)


def refuse_other_equalities(label: str, model: mujoco.MjModel) -> None:
    """Refuse a scene with active equality constraints that nothing on a path keeps.

    Those are all but couplings of joints. The message begins with ``label``.
    """
    others = (model.eq_type != mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 != 0)
    for row in np.flatnonzero(others):
        kind, between = mujoco.mjtEq(int(model.eq_type[row])), ""
        ends = [int(model.eq_obj1id[row]), int(model.eq_obj2id[row])]
        if kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            if int(model.eq_objtype[row]) == mujoco.mjtObj.mjOBJ_SITE:
                ends = [int(model.site_bodyid[site]) for site in ends]
            if model.body_weldid[ends[0]] == model.body_weldid[ends[1]]:
                continue  # no joint moves one against the other
            between = " between " + " and ".join(repr(body_name(model, body)) for body in ends)
        called = str(model.equality(int(row)).name)
        raise InvalidInput(
            f"{label}: there is the equality constraint "
            f"<{kind.name.removeprefix('mjEQ_').lower()}>{f' {called!r}' if called else ''}"
            f"{between}, and a path keeps couplings of joints only: the robot would be torn apart "
            "there. Couple the joints by <equality><joint .../></equality> instead, or, if what it "
            'ties may come apart, leave it out or write active="false".'
        )


def share_limits(
    model: mujoco.MjModel, lower: Array, upper: Array, acceleration: Array, *speeds: Array
) -> None:
    r"""Tighten limits in place until those of coupled joints are images of one another.

    With :math:`\theta_1 = o + r\,\theta_2` the first joint brakes \|r\| times as hard as the
    second. With limits in that ratio, a velocity allowed for one joint is allowed for the other.
    Otherwise one joint may move at a speed at which the other cannot stop in time. Arguments are
    θ_min, θ_max, rad or m, the largest acceleration, rad/s² or m/s², and other limits in the ratio
    \|r\|, each (nv,); ``inf`` without a limit.

    Couplings that are curved, with an acceleration limit, or leave no position are refused.
    """
    couplings = JointCouplings(model)
    curved, pairs = couplings.curved, np.column_stack([couplings.first, couplings.second])
    bent = np.flatnonzero(curved & np.isfinite(acceleration[pairs]).any(axis=1))
    if len(bent):
        raise InvalidInput(
            f"acceleration: {_names(couplings, int(bent[0]))} are coupled by a polynomial that is "
            "not linear, so that no fixed limits let both brake together; give them no "
            "acceleration limits."
        )
    ratios = couplings.coefficients[:, 1]
    offsets = couplings.start[:, 0] + couplings.coefficients[:, 0] - ratios * couplings.start[:, 1]
    paired = np.flatnonzero(~curved & (ratios != 0.0))
    for _ in paired:  # enough passes for any chain of couplings
        for k in paired:
            one, other = pairs[k]
            o, r = float(offsets[k]), float(ratios[k])
            for a, b, offset, ratio in ((one, other, o, r), (other, one, -o / r, 1.0 / r)):
                image = sorted((offset + ratio * lower[b], offset + ratio * upper[b]))
                lower[a], upper[a] = max(lower[a], image[0]), min(upper[a], image[1])
                for limit in (acceleration, *speeds):
                    limit[a] = min(limit[a], abs(ratio) * limit[b])
            if lower[one] > upper[one]:
                raise InvalidInput(
                    f"{_names(couplings, int(k))} are coupled, but their ranges have no position "
                    "in common; check the scene's <equality>."
                )


def _names(couplings: JointCouplings, number: int) -> str:
    pair = couplings.first[number], couplings.second[number]
    return f"joints {' and '.join(repr(couplings.joints[dof]) for dof in pair)}"

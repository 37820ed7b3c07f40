"""The joint ranges of a model by degree of freedom, and the paper's centering measure z."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask, float_array, instance, read_only
from qp_twist.errors import InvalidInput

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True, eq=False)
class JointRanges:
    r"""Lower and upper limits by degree of freedom (hinges and slides), rad or m.

    Unlimited joints, and ball and free joints, have limits of ±∞ and weight 0 in

    .. math::

        z = \tfrac12 (\bar\theta - \theta)^T \mathbf W^T \mathbf W (\bar\theta - \theta), \qquad
        \mathbf W = \mathrm{diag}\, 1/(\theta_{max} - \theta_{min})
        \qquad\text{(paper, eq. z).}

    Attributes:
        lower: θ_min, shape (nv,).
        upper: θ_max, shape (nv,).
        qpos: Index in q of each scalar joint's coordinate, −1 for ball and free joints, (nv,).
        hinge: Which degrees of freedom are hinges, whose unit is rad, (nv,).
        names: Name of the joint that owns each degree of freedom.
        nq: Length of q.
    """

    lower: Array
    upper: Array
    qpos: Indices
    hinge: Mask
    names: tuple[str, ...]
    nq: int

    @classmethod
    def of(cls, model: mujoco.MjModel) -> JointRanges:
        """Read the ranges of a model."""
        instance("model", model, mujoco.MjModel)
        joints = model.dof_jntid
        names = tuple(model.joint(int(j)).name or f"joint {j}" for j in joints)
        scalar = np.isin(model.jnt_type[joints], _SCALAR)
        ranges = model.jnt_range[joints]
        # MuJoCo treats a range with NaN as no range.
        for dof in np.flatnonzero(scalar & np.isnan(ranges).any(axis=1)):
            raise InvalidInput(
                f"model: the range of {names[dof]} is not a number; check the scene."
            )
        limited = scalar & (model.jnt_limited[joints] != 0)
        lower, upper = np.where(limited, ranges.T, [[-np.inf], [np.inf]])
        qpos = np.where(scalar, model.jnt_qposadr[joints], -1).astype(np.intp)
        hinge = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
        return cls(lower, upper, qpos, hinge, names, int(model.nq))

    def __repr__(self) -> str:
        limited = int(self.limited.sum())
        return f"JointRanges({list(self.names)}, {limited} of {len(self.names)} limited)"

    @cached_property
    def limited(self) -> Mask:
        """Which degrees of freedom have a range of finite, non-zero width, shape (nv,)."""
        width = self.upper - self.lower
        limited: Mask = np.isfinite(width) & (width > 0.0)
        limited.setflags(write=False)
        return limited

    @cached_property
    def middle(self) -> Array:
        """θ̄, the middle of each range; 0 without a range, shape (nv,)."""
        lower, upper = np.where(self.limited, (self.lower, self.upper), 0.0)
        return read_only(0.5 * (lower + upper))

    @cached_property
    def weight(self) -> Array:
        """Diagonal of W, that is 1/(θ_max − θ_min), or 0 without a range; 1/rad or 1/m, (nv,)."""
        width = np.where(self.limited, self.upper - self.lower, np.inf)
        return read_only(1.0 / width)

    @property
    def metric(self) -> Array:
        """Diagonal of WᵀW as a metric M, without zeros, 1/rad² or 1/m², (nv,).

        A joint without a range has a hundredth of the smallest weight of the others, squared.
        """
        weight = self.weight
        smallest = weight[weight > 0.0].min(initial=1.0)
        return np.where(weight > 0.0, weight, 1e-2 * smallest) ** 2

    def positions(self, q: Array) -> Array:
        """Joint positions by degree of freedom, from q of shape (…, nq); 0 for ball and free."""
        plain = isinstance(q, np.ndarray) and q.dtype == np.float64
        values = q if plain else float_array("q", q)
        if values.ndim == 0 or values.shape[-1] != self.nq:
            raise InvalidInput(f"q: expected an array of shape (…, {self.nq}), got {values.shape}.")
        positions: Array = values[..., self.qpos]  # a copy
        if not self.only_hinges_and_slides:
            positions[..., self.qpos < 0] = 0.0
        return positions

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Unit of each degree of freedom's position: ``"rad"`` for hinges, ``"m"`` for slides."""
        return tuple("rad" if hinge else "m" for hinge in self.hinge)

    @cached_property
    def only_hinges_and_slides(self) -> bool:
        """Whether every joint has one coordinate of q, unlike ball and free joints."""
        return bool((self.qpos >= 0).all())

    def inside(self, positions: Array) -> Mask:
        """Whether all of the positions (…, nv) are in their ranges, (…)."""
        return np.asarray((self.room(positions) >= 0.0).all(axis=-1))

    def room(self, positions: Array) -> Array:
        """Distance of the positions (…, nv) from the nearer end, rad or m; negative outside."""
        return np.minimum(positions - self.lower, self.upper - positions)

    def random(self, count: int, rng: np.random.Generator) -> Array:
        """Uniform between the limits, else over a turn (hinges) or ±1 m (slides); (count, nv)."""
        half = np.where(self.hinge, np.pi, 1.0)
        lower = np.where(np.isfinite(self.lower), self.lower, -half)
        upper = np.where(np.isfinite(self.upper), self.upper, half)
        return rng.uniform(lower, upper, size=(count, len(lower)))

    def centering(self, q: Array) -> Array:
        """z for each configuration of q (…, nq); dimensionless, 1/8 per joint at its limit."""
        offset = self.weight * (self.middle - self.positions(q))
        z: Array = 0.5 * np.sum(offset**2, axis=-1)
        return z

    def margins(self, q: Array) -> Array:
        """``1 − |θ − θ̄| / half-range`` for each joint, (…, nv); negative outside, +∞ unlimited."""
        offset = np.abs(self.positions(q) - self.middle) * 2.0 * self.weight
        return np.where(self.limited, 1.0 - offset, np.inf)


_names: WeakKeyDictionary[mujoco.MjModel, tuple[str, ...]] = WeakKeyDictionary()


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Name of the joint of each degree of freedom, cached by model."""
    if model not in _names:
        _names[model] = JointRanges.of(model).names
    return _names[model]

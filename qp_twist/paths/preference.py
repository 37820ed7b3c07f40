"""How the tool should lean and turn where a task leaves that free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices, float_array, number, read_only
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector
from qp_twist.kinematics import ConeBand, RollBand

VALUES = ("lead", "tilt", "roll")
"""What may be preferred, in the order of arrays."""
HEAVIEST = 1e6
"""Largest weight: programs are solved to 1e-8 of their largest cost, z beside it."""
_Z = np.array([0.0, 0.0, 1.0])
ROLL = RollBand(_Z, -1.0, 1.0, frame="target")
"""Measures the roll; its range is not used."""
_LEAN = ConeBand(_Z, _Z, 1.0)


@dataclass(frozen=True, eq=False)
class Preference:
    r"""Lean and roll of the tool that a plan prefers where the task leaves them free.

    Relative to the waypoint, whose z is :math:`\mathbf z_d`, the frame's z leans by the rotation
    vector :math:`\text{lead}\;\mathbf z_d\times\mathbf t + \text{tilt}\;\mathbf t`, t being the
    direction of the path perpendicular to :math:`\mathbf z_d`: the lead is towards the direction of
    the path, the tilt to the left of it as seen from the tip of z. The roll is the twist angle
    about :math:`\mathbf z_d`. To the objective of a plan,

    .. math::

        \frac1N \sum_k \frac w2 \sum_\varphi
        \max(|\varphi_k - \varphi_{d,k}| - \delta,\; 0)^2
        + (N - 1)\,\frac{w_s}2 \sum_k (\text{roll}_{k+1} - \text{roll}_k)^2

    is added, over the values φ that are preferred. The second sum does not depend on how finely
    the path is sampled: a roll that turns evenly by φ along the path costs w_s φ²/2.

    Attributes:
        lead: Preferred lead, rad, or one for each waypoint, (N,), NaN where any is as good;
            ``None``: any.
        tilt: Preferred tilt, likewise.
        roll: Preferred roll, likewise.
        within: δ: a smaller difference costs nothing, rad.
        weight: w, in the objective's unit per rad².
        roll_smoothness: w_s, likewise.
        curves: The curve, from 0, that each waypoint belongs to, −1 beside the curves, (N,); a plan
            states its ranges for each. ``None``: the path is one.

    Raises:
        InvalidInput: If nothing is preferred, or a value has the wrong type or range: angles are
            within a whole turn.
    """

    lead: npt.ArrayLike | None = None
    tilt: npt.ArrayLike | None = None
    roll: npt.ArrayLike | None = None
    within: float = 0.0
    weight: float = 1.0
    roll_smoothness: float = 0.0
    curves: Indices | None = None

    def __post_init__(self) -> None:
        for name in VALUES:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _angles(name, getattr(self, name)))
        for name in ("within", "weight", "roll_smoothness"):
            number(f"Preference({name}=…)", getattr(self, name), at_least=0.0, at_most=HEAVIEST)
        if all(getattr(self, name) is None for name in VALUES) and not self.roll_smoothness:
            raise InvalidInput(
                "nothing is preferred; give a lead, tilt or roll, or a roll_smoothness.",
                key="preference",
            )

    def at(self, count: int) -> Array:
        """Preferred lead, tilt and roll at each of N waypoints, rad, (N, 3); NaN: any.

        Raises:
            InvalidInput: If an array has another length.
        """
        if self.curves is not None and np.shape(self.curves) != (count,):
            raise InvalidInput(
                f"Preference(curves=…): expected one for each of the {count} waypoints, got "
                f"{np.shape(self.curves)}.",
                key="preference",
            )
        found = np.full((count, len(VALUES)), np.nan)
        for column, name in enumerate(VALUES):
            value = getattr(self, name)
            if value is None:
                continue
            if np.shape(value) not in ((), (count,)):
                raise InvalidInput(
                    f"Preference({name}=…): expected one angle, or one for each of the {count} "
                    f"waypoints, got {len(value)}.",
                    key="preference",
                )
            found[:, column] = value
        return found

    def refuse_fixed(self, projectors: Sequence[TwistProjector]) -> None:
        """Refuse a value that all these projectors of a path hold."""
        lean = all(_LEAN.fixed(T)[0] for T in projectors)
        fixed = {"lead": lean, "tilt": lean, "roll": all(ROLL.fixed(T)[0] for T in projectors)}
        for name in VALUES:
            if fixed[name] and getattr(self, name) is not None:
                raise InvalidInput(
                    f"the projector holds the {name}, so that no other can be preferred; free it "
                    f"there, or leave it out.",
                    key=f"preference.{name}_deg",
                )

    def part(self, source: Indices) -> Preference:
        """Those of waypoints at indices (M,)."""
        return replace(self, **{
            name: value[source] for name in (*VALUES, "curves")
            if (value := getattr(self, name)) is not None and np.ndim(value)
        })  # fmt: skip


def on_curves(name: str, degrees: Sequence[float], curves: Indices) -> Array:
    """Angles of curves at the waypoints (N,) that belong to them, rad; NaN at others.

    One for all curves, or one for each.

    Raises:
        InvalidInput: If there are neither as many nor one.
    """
    count = int(curves.max(initial=-1)) + 1
    if len(degrees) not in (1, count):
        raise InvalidInput(
            f"expected one angle, or one for each of the path's {count} curves, got "
            f"{len(degrees)}.",
            key=f"preference.{name}_deg",
        )
    angles = np.broadcast_to(np.radians(degrees), count)
    return np.append(angles, np.nan)[curves]  # of no curve: the last


def curve_numbers(parts: Sequence[str], joint_moves: Sequence[int], count: int) -> Indices:
    """The curve, from 0, that each of N waypoints belongs to; −1 beside the curves, (N,)."""
    contact = np.array([part == "contact" for part in parts] or [True] * count)
    begins = contact & ~np.append(False, contact[:-1])
    begins[list(joint_moves)] |= contact[list(joint_moves)]
    return np.where(contact, np.cumsum(begins) - 1, -1)


def _angles(name: str, value: npt.ArrayLike) -> Array:
    """Angles, rad, () or (N,), within a whole turn; NaN in an array stands for any."""
    if np.ndim(value) == 0:
        value = number(f"Preference({name}=…)", value)  # type: ignore[arg-type]
    angles = float_array(f"Preference({name}=…)", value)
    if angles.ndim > 1 or (np.abs(angles) > 2.0 * np.pi).any():
        raise InvalidInput(
            f"expected an angle, or one for each waypoint, within a whole turn; got {value!r:.80}.",
            key=f"preference.{name}_deg",
        )
    return read_only(angles)

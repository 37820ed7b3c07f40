"""Limits that are bounds on single joint velocities."""

from __future__ import annotations

import abc
import functools
from typing import NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array


class Box(NamedTuple):
    """lower ≤ q̇ ≤ upper, each (nv,), rad/s or m/s, and the kind of limit."""

    kind: str
    lower: Array
    upper: Array


@functools.lru_cache
def no_box(kind: str, nv: int) -> Box:
    """A box without bounds."""
    return Box(kind, np.full(nv, -np.inf), np.full(nv, np.inf))


class BoxLimit(mink.Limit):
    """Base of the limits lower ≤ q̇ ≤ upper; also a plain :class:`mink.Limit`.

    Attributes:
        kind: Its name in messages and in :class:`~qp_twist.BindingLimit`.
    """

    kind: str = "box"

    @abc.abstractmethod
    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """Lower and upper joint velocity, rad/s or m/s, each (nv,); ±∞ without a bound."""

    def boxes(self, configuration: mink.Configuration, dt: float) -> tuple[Box, ...]:
        """The bounds, one box for each kind of limit."""
        return (Box(self.kind, *self.bounds(configuration, dt)),)

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint that is outside the limit and returning."""
        return ()

    def note(self, velocity: Array) -> None:
        """Store the joint velocity (nv,) of the last step; called by the controller."""

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The bounds as mink's rows G Δq ≤ h."""
        lower, upper = self.bounds(configuration, dt)
        below, above = np.isfinite(lower), np.isfinite(upper)
        if not (below.any() or above.any()):
            return mink.Constraint()
        identity = np.eye(configuration.model.nv)
        return mink.Constraint(
            G=np.vstack([identity[above], -identity[below]]),
            h=np.hstack([upper[above], -lower[below]]) * dt,
        )


def one_by_one(signs: Array) -> Array:
    """Gradients (N, nv, nv) of one margin for each joint, with slopes ``signs`` (N, nv)."""
    gradients: Array = signs[:, :, None] * np.eye(signs.shape[1])
    return gradients

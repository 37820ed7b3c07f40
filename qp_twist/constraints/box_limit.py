"""Limits that are bounds on single joint velocities."""

from __future__ import annotations

import abc
import functools
from typing import NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array


class Box(NamedTuple):
    """lower ≤ q̇ ≤ upper, each (nv,), rad/s or m/s, and the kind of limit that says so."""

    kind: str
    lower: Array
    upper: Array


@functools.lru_cache
def no_box(kind: str, nv: int) -> Box:
    """A box without an end."""
    return Box(kind, np.full(nv, -np.inf), np.full(nv, np.inf))


class BoxLimit(mink.Limit):
    """Base of the limits lower ≤ q̇ ≤ upper; also a plain :class:`mink.Limit`.

    Attributes:
        kind: How messages and :class:`~qp_twist.BindingLimit` call it.
    """

    kind: str = "box"

    @abc.abstractmethod
    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """Lower and upper joint velocity, rad/s or m/s, each (nv,); ±∞ where there is none."""

    def boxes(self, configuration: mink.Configuration, dt: float) -> tuple[Box, ...]:
        """The bounds by their kind: one box, unless a limit is of several kinds."""
        return (Box(self.kind, *self.bounds(configuration, dt)),)

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint that breaks the limit already and is on its way back."""
        return ()

    def note(self, velocity: Array) -> None:
        """Told by the controller which joint velocity (nv,) is running after a step."""

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """The same bounds as mink's rows G Δq ≤ h."""
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
    """Gradients (N, nv, nv) of margins of the joints themselves, that rise by ``signs`` (N, nv)."""
    gradients: Array = signs[:, :, None] * np.eye(signs.shape[1])
    return gradients

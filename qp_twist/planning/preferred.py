"""The cost of a path's lean and roll, where a task prefers some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import cross, geodesic
from qp_twist.kinematics import FramePair, SerialChain
from qp_twist.paths import PathTask
from qp_twist.paths.orientation import tangents
from qp_twist.paths.preference import ROLL, VALUES, Preference
from qp_twist.planning.layer import Layer, wound

_Z = np.array([0.0, 0.0, 1.0])
_LISTED = 4
"""Most preferred angles, and curves, that are listed."""
_NO_SWING = 1e-9
"""Angle below which the frame's z has no direction in which it leans, rad."""


@dataclass(frozen=True, eq=False)
class PreferredPoses:
    """The preference of a path, evaluated at configurations on its waypoints.

    ``rotations`` and ``positions`` are those of the waypoints, (N, 3, 3) and (N, 3), ``along`` the
    directions of the path there, (N, 3), ``held`` the preferred values, rad, (N, 3), NaN for any;
    ``smooth`` the intervals in which the roll is to change little, (N − 1,).
    """

    preference: Preference
    chain: SerialChain
    rotations: Array
    positions: Array
    along: Array
    held: Array
    smooth: Mask

    @classmethod
    def of(cls, path_task: PathTask) -> PreferredPoses | None:
        """That of a task; ``None`` if it prefers nothing.

        Raises:
            InvalidInput: If T fixes a value that is preferred, along the whole path.
        """
        preference = path_task.preference
        if preference is None:
            return None
        rotations, positions = path_task.poses
        held = preference.at(len(positions))
        along = np.zeros_like(positions)
        leans = np.isfinite(held[:, :2]).any(axis=1)
        ends = np.flatnonzero(np.diff(leans, prepend=False, append=False)).reshape(-1, 2)
        for first, last in ends.tolist():
            run = slice(first, last)
            along[run] = tangents(path_task.name, positions[run], rotations[run, :, 2])
        smooth = np.ones(len(positions) - 1, dtype=bool)
        smooth[np.array(path_task.joint_moves, dtype=np.intp) - 1] = False
        chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        return cls(preference, chain, rotations, positions, along, held, smooth)

    def scaled(self, factor: float) -> PreferredPoses:
        """The same at a share of its cost."""
        weight, smooth = self.preference.weight, self.preference.roll_smoothness
        less = replace(self.preference, weight=factor * weight, roll_smoothness=factor * smooth)
        return replace(self, preference=less)

    def values(self, q: Array, at: Indices) -> Array:
        """Lead, tilt and roll of configurations q (K, nv) at waypoints (K,), rad, (K, 3)."""
        return self._values(self._pair(*self.chain.poses(q), at), at)

    def of_layer(self, layer: Layer, waypoint: int) -> Array:
        """The same of a layer's configurations (K, nv), asked once for copies by whole turns."""
        first, which = layer.copies
        return self.values(layer.q[first], np.full(len(first), waypoint))[which]

    def costs(self, values: Array, at: Indices) -> Array:
        """Cost of values (K, 3) at waypoints (K,), without that of the roll's changes, (K,)."""
        cost: Array = 0.5 * self.preference.weight * (self._beyond(values, at) ** 2).sum(axis=1)
        return cost

    def change_costs(self, change: Array, first: int, last: int) -> Array:
        """Cost of changes (K,) of the roll, rad, from one waypoint to another."""
        if not self.preference.roll_smoothness or not self.smooth[first:last].all():
            return np.zeros(len(change))
        share = (last - first) / (len(self.held) - 1)
        cost: Array = 0.5 * self.preference.roll_smoothness / share * wound(change) ** 2
        return cost

    def cost(self, q: Array) -> float:
        """Cost of a path q (N, nv)."""
        at = np.arange(len(q))
        values = self.values(q, at)
        changes = wound(np.diff(values[:, 2])[self.smooth])
        smooth = 0.5 * self.preference.roll_smoothness * (len(q) - 1) * float(changes @ changes)
        return float(self.costs(values, at).mean()) + smooth

    def slopes(self, q: Array, at: Indices) -> tuple[Array, Array]:
        """A (K, 3, nv) and b (K, 3) of the cost ½‖A Δq + b‖² near configurations at waypoints."""
        return self._weighed(*self._linear(q, at), at)

    def linear(self, q: Array) -> tuple[sparse.csr_matrix, Array]:
        """A and b of the cost ½‖A Δq + b‖² near a path q (N, nv), Δq (N·nv,)."""
        count = len(q)
        values, slopes = self._linear(q, np.arange(count))
        own, beyond = self._weighed(values, slopes, np.arange(count))
        A, b = [sparse.block_diag(own / np.sqrt(count))], [beyond.ravel() / np.sqrt(count)]
        if self.preference.roll_smoothness:
            much = np.sqrt(self.preference.roll_smoothness * (count - 1)) * self.smooth
            turn = sparse.block_diag(slopes[:, 2:], format="csr")
            A.append(sparse.diags(much) @ (turn[1:] - turn[:-1]))
            b.append(much * wound(np.diff(values[:, 2])))
        return sparse.vstack(A, format="csr"), np.concatenate(b)

    @property
    def largest(self) -> float:
        """Bound of the gain by a radian in all joints' rolls and leans."""
        steps = self.preference.roll_smoothness * (len(self.held) - 1)
        return 2.0 * np.pi * (len(VALUES) * self.preference.weight + steps)

    def described(self, q: Array) -> str:
        """Ranges of the preferred values along a path q (N, nv), in words."""
        values, found = np.degrees(self.values(q, np.arange(len(q)))), []
        for column, name in enumerate(VALUES):
            held = np.degrees(self.held[:, column])
            away = np.degrees(wound(np.radians(values[:, column] - held)))
            parts = self._alike(held)
            if parts:
                found.append(f"{name} {_ranges(parts, held, away)}")
        if self.preference.roll_smoothness:
            turns = np.abs(np.degrees(wound(np.radians(np.diff(values[:, 2])[self.smooth]))))
            found.append(f"the roll turns by {turns.sum():.1f}° in all")
        return ", ".join(found)

    def _alike(self, held: Array) -> list[tuple[str, Mask]]:
        """The parts of a path in which preferred values (N,) are stated together, with their names.

        Those are the curves, if they differ in what they prefer.
        """
        preferred, curves = np.isfinite(held), self.preference.curves
        if curves is not None and len(np.unique(held[preferred])) > 1:
            numbers = np.unique(curves[preferred]).tolist()
            return [(f"on curve {k + 1} ", preferred & (curves == k)) for k in numbers]
        return [("", preferred)] if preferred.any() else []

    def _linear(self, q: Array, at: Indices) -> tuple[Array, Array]:
        """Lead, tilt and roll, (K, 3), and their derivatives, (K, 3, nv)."""
        rotations, positions, jacobians = self.chain.poses_and_jacobians(q)
        pair = self._pair(rotations, positions, at)
        return self._values(pair, at), self._gradients(pair, at) @ jacobians[:, 3:]

    def _weighed(self, values: Array, slopes: Array, at: Indices) -> tuple[Array, Array]:
        """A and b from values (K, 3) and their derivatives (K, 3, nv); 0 where they are free."""
        beyond, weight = self._beyond(values, at), np.sqrt(self.preference.weight)
        return weight * (beyond != 0.0)[:, :, None] * slopes, weight * beyond

    def _pair(self, rotations: Array, positions: Array, at: Indices) -> FramePair:
        return FramePair(rotations, positions, self.rotations[at], self.positions[at])

    def _values(self, pair: FramePair, at: Indices) -> Array:
        z, t = pair.target_rotation[:, :, 2], self.along[at]
        swing = geodesic(z, pair.rotation[:, :, 2])
        lead, tilt = (swing * cross(z, t)).sum(axis=1), (swing * t).sum(axis=1)
        return np.column_stack([lead, tilt, ROLL.values(pair)[:, 0]])

    def _gradients(self, pair: FramePair, at: Indices) -> Array:
        """Gradients of lead, tilt and roll on the frame's angular velocity, (K, 3, 3).

        The swing θ k of u from n, with e = k × n, changes with k·ω along k, and sideways with
        θ(n − cot θ e)·ω along e × … as :class:`~qp_twist.kinematics.ConeBand` states it.
        """
        n, t = pair.target_rotation[:, :, 2], self.along[at]
        swing = geodesic(n, pair.rotation[:, :, 2])
        angle = np.linalg.norm(swing, axis=1, keepdims=True)
        leans = angle > _NO_SWING
        k = np.where(leans, swing / np.where(leans, angle, 1.0), t)
        e = cross(k, n)
        cotangent = np.where(leans, angle / np.tan(np.where(leans, angle, 1.0)), 1.0)
        sideways = angle * n - cotangent * e
        found = []
        for direction in (t, -cross(n, t)):  # of lead and tilt in the plane of x = θ e
            along = (direction * e).sum(axis=1, keepdims=True)
            across = (direction * k).sum(axis=1, keepdims=True)
            found.append(along * k + across * sideways)
        return np.stack([*found, ROLL.gradients(pair)[:, 0, 3:]], axis=1)

    def _beyond(self, values: Array, at: Indices) -> Array:
        """By how much values (K, 3) differ from the preferred ones by more than δ, with sign."""
        away = np.nan_to_num(wound(values - self.held[at]))
        beyond: Array = np.sign(away) * np.maximum(np.abs(away) - self.preference.within, 0.0)
        return beyond


def _ranges(parts: Sequence[tuple[str, Mask]], held: Array, away: Array) -> str:
    """Ranges of values (N,) on parts of a path, degrees, in words, of many the farthest off.

    ``held`` are the preferred ones, ``away`` by how much values differ from them.
    """
    off = np.array([np.abs(away[of]).max() for _, of in parts])
    listed, found = np.sort(np.argsort(-off, kind="stable")[:_LISTED]), list[str]()
    for where, of in (parts[k] for k in listed.tolist()):
        seen = held[of] + away[of]
        wanted = "/".join(dict.fromkeys(f"{angle:.4g}°" for angle in held[of]))
        if len(np.unique(held[of])) > _LISTED:
            wanted = f"{held[of].min():.4g}° to {held[of].max():.4g}°"
        found.append(f"{where}{seen.min():.1f}° to {seen.max():.1f}° (preferred {wanted})")
    if more := len(parts) - len(listed):
        rest = np.delete(off, listed).max()
        found.append(f"on {more} more within {rest:.1f}° of what is preferred there")
    return ", ".join(found)

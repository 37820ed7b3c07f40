"""The methods that are other libraries' steps."""

from __future__ import annotations

from qp_twist.following.mink_peer import MinkResolver
from qp_twist.following.peer import PeerLimits, PeerResolver
from qp_twist.following.pink_peer import PinkResolver
from qp_twist.following.placo_peer import PlacoResolver
from qp_twist.geometry import TwistProjector
from qp_twist.path import METHODS, MethodSettings, PathTask

_RESOLVERS: dict[str, type[PeerResolver]] = {
    "mink": MinkResolver,
    "pink": PinkResolver,
    "placo": PlacoResolver,
}


def make_peer(
    path_task: PathTask,
    method: str,
    settings: MethodSettings,
    projector: TwistProjector,
    solver: str,
    limits: PeerLimits,
) -> PeerResolver:
    """The resolver of a peer's method, for one projector.

    Raises:
        InvalidInput: If the peer has no words for the task or the settings, or is not installed.
    """
    resolver = _RESOLVERS[METHODS[method].peer]
    return resolver(path_task, method, settings, projector, solver, limits)

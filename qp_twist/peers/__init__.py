"""Steps of other libraries: one description of a step, and its conversion for each library."""

from .mink_peer import MinkPeer as MinkPeer
from .peer import Peer as Peer
from .peer import PeerFrame as PeerFrame
from .peer import PeerProblem as PeerProblem
from .peer import PeerStep as PeerStep
from .peer import peer_module as peer_module
from .pink_peer import PinkPeer as PinkPeer
from .placo_peer import PlacoPeer as PlacoPeer

PEERS: dict[str, type[Peer]] = {"mink": MinkPeer, "pink": PinkPeer, "placo": PlacoPeer}
"""The peers by name of the library."""

"""The flange of Universal Robots' arms by the maker's parameters of Denavit and Hartenberg."""

import numpy as np

from oracles.data_sheets import about

Array = np.ndarray
# Lengths, m: d1, a2, a3, d4, d5, d6.
LENGTHS = {
    "Universal Robots UR5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "Universal Robots UR10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
}


def flange_of(name: str, theta: Array) -> Array:
    """The flange in the controller's base, at θ, degrees."""
    d1, a2, a3, d4, d5, d6 = LENGTHS[name]
    at = np.eye(4)
    rows = [(d1, 0, 90), (0, a2, 0), (0, a3, 0), (d4, 0, 90), (d5, 0, -90), (d6, 0, 0)]
    for angle, (d, a, twist) in zip(theta, rows, strict=True):
        move = np.eye(4)
        move[:3, 3] = a, 0.0, d
        at = at @ about("z", angle) @ move @ about("x", twist)
    return at

"""The frame of a path in the browser's scene, which moves with the body that carries the path."""

from __future__ import annotations

from typing import Any

from qp_twist.checks import Array
from qp_twist.paths import Shown

CARRIER = "/carrier"
"""Name of the frame; what is stated in the path's frame is drawn below it."""


def put(frame: Any, shown: Shown, q: Array) -> None:
    """Put the frame where the body is at a configuration q (nq,) of the task."""
    if shown.carrier is not None:
        pose = shown.carrier_pose(q)
        # Tuples of floats: a recording takes no scalars of numpy.
        frame.position = tuple(pose.translation().tolist())
        frame.wxyz = tuple(pose.rotation().wxyz.tolist())

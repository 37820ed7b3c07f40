"""What a task file is asked to be made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from qp_twist.paths import AngleUnit, FeedUnit, LengthUnit, Orientation
from qp_twist.paths.file_path_schema import ColumnsTable


@dataclass(frozen=True)
class Request:
    """A robot, a toolpath, and whatever is not to be decided for the user.

    Attributes:
        robot: MJCF or URDF file, or the name of a shipped scene.
        toolpath: CSV or APT-CL file.
        frame: Controlled frame; ``None``: the only one there is.
        frame_type: ``"site"``, ``"body"`` or ``"geom"``; ``None``: what has that name.
        length_unit: Of a file that does not say it.
        angle_unit: Of roll, pitch and yaw in such a file.
        orientation: Which columns of direction count.
        feed_unit: Of a column of feeds, where its header does not say it.
        columns: Columns without usual names.
        tool: Whether the frame's z points into the part.
        place: Where the origin of the toolpath's frame stands in the world, m; ``None``: in the
            world's origin, or elsewhere if the robot does not reach it there.
        place_rpy_deg: How that frame is turned, R = Rz Ry Rx, degrees; with ``place`` only.
        speed: Along the path where the toolpath states no feed, m/s.
        search_seconds: Time that the search for a start and a placement may take, s.
    """

    robot: Path
    toolpath: Path
    frame: str | None = None
    frame_type: Literal["site", "body", "geom"] | None = None
    length_unit: LengthUnit | None = None
    angle_unit: AngleUnit | None = None
    orientation: Orientation | None = None
    feed_unit: FeedUnit | None = None
    columns: ColumnsTable | None = None
    tool: Literal["into", "out"] = "into"
    place: tuple[float, float, float] | None = None
    place_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.05
    search_seconds: float = 60.0

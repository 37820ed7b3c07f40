"""Request for a new task file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from qp_twist.authoring.solids import MeshUnit
from qp_twist.paths import AngleUnit, ArcAxis, FeedUnit, LengthUnit, Orientation, Rollover, Rotary
from qp_twist.paths.file_path_schema import ColumnsTable

ANGULAR_SPEED = 90.0
"""Speed at which a tool turns in place, unless another is given, degrees/s."""


@dataclass(frozen=True)
class Request:
    """A robot, a toolpath, and the options that the user chose.

    Attributes:
        robot: MJCF, URDF or xacro file, or the name of a shipped scene.
        toolpath: CSV, APT-CL or G-code file.
        packages: Folders of the ROS packages of a URDF or xacro file, by name.
        arguments: Values of the arguments of a xacro file, by name.
        frame: Controlled frame; ``None`` for the only one.
        frame_type: ``"site"``, ``"body"`` or ``"geom"``; ``None`` for any with that name.
        length_unit: Unit of a file without one.
        angle_unit: Unit of roll, pitch and yaw in such a file.
        orientation: Which direction columns to use.
        feed_unit: Unit of a feed column without one.
        columns: Columns without usual names.
        rapids: Whether rapid motions of the file are part of the path; ``None``: if they lead the
            tool away from each curve and to the next.
        transfer: From one curve to the next in straight lines, or by joint moves.
        arc_axis: Sense of rotation of circles about their axes, if the file leaves it open.
        rotary: How the rotary axes of a G-code file turn the tool.
        rollover: Whether they turn over 360 degrees the short way.
        tool: Whether the frame's z points into the part.
        place: Origin of the toolpath's frame in the world, m; ``None`` for the world's origin, or
            elsewhere if the robot does not reach it there.
        place_rpy_deg: Orientation of that frame, R = Rz Ry Rx, degrees; only with ``place``.
        speed: Speed along the path where the toolpath has no feed, m/s.
        angular_speed_deg: Largest speed at which the tool turns, degrees/s; ``None`` for
            ``ANGULAR_SPEED`` where the tool turns in place, and no bound elsewhere.
        search_seconds: Limit of the search for a start and a placement, s of processor time;
            compiling kernels does not count.
        tool_mesh: Mesh file of a tool, in the axes of the robot's frame.
        tcp: Pose of its tip in the robot's frame: position, m, roll, pitch and yaw, R = Rz Ry Rx,
            degrees; with it the task's frame is the tip.
        part_mesh: Mesh file of the part, in the toolpath's frame.
        fixture_meshes: Mesh files of what stands around the part, in the toolpath's frame.
        mesh_unit: Unit of all mesh files.
        relative_to: Body of the robot file that carries the part, such as the plate of a turn
            table; ``place`` is then in its frame.
        tool_at: Pose of a tool that is fixed in the cell, in the robot's world, as ``tcp``. The
            robot then holds the part: ``place`` is in its frame, ``tcp`` in that of the tool, and
            fixtures are in the robot's world.
        controller: How the controller counts the joints: name of a known robot, a file with a table
            of its own (``.toml``), or ``"as modelled"``; ``None``: recognised.
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
    rapids: Literal["keep", "drop"] | None = None
    transfer: Literal["straight", "joint"] = "straight"
    arc_axis: ArcAxis | None = None
    rotary: Rotary | None = None
    rollover: Rollover | None = None
    tool: Literal["into", "out"] = "into"
    place: tuple[float, float, float] | None = None
    place_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.05
    angular_speed_deg: float | None = None
    search_seconds: float = 60.0
    tool_mesh: Path | None = None
    tcp: tuple[float, float, float, float, float, float] | None = None
    part_mesh: Path | None = None
    fixture_meshes: tuple[Path, ...] = ()
    mesh_unit: MeshUnit | None = None
    relative_to: str | None = None
    tool_at: tuple[float, float, float, float, float, float] | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)
    arguments: Mapping[str, str] = field(default_factory=dict)
    controller: str | None = None

    @property
    def has_cell(self) -> bool:
        """Whether something is added to the robot, so that a scene is written."""
        meshes = (self.tool_mesh, self.tcp, self.part_mesh, self.tool_at)
        return bool(self.fixture_meshes) or any(mesh is not None for mesh in meshes)

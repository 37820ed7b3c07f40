"""Request for a new task file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field, ValidationError

from qp_twist.authoring.solids import MeshUnit
from qp_twist.paths import ToolpathOptions
from qp_twist.paths.section import Positive, Vector, problems

ANGULAR_SPEED = 90.0
"""Speed at which a tool turns in place, unless another is given, degrees/s."""

Pose = tuple[float, float, float, float, float, float]
"""Position, m, and roll, pitch and yaw, R = Rz Ry Rx, degrees."""


class Request(ToolpathOptions):
    """A robot, a toolpath, the options of the toolpath, and the others that the user chose.

    Attributes:
        robot: MJCF, URDF or xacro file, or the name of a shipped scene.
        toolpath: CSV, APT-CL, G-code, or a program of a robot.
        packages: Folders of the ROS packages of a URDF or xacro file, by name.
        arguments: Values of the arguments of a xacro file, by name.
        frame: Controlled frame; ``None`` for the only one.
        frame_type: ``"site"``, ``"body"`` or ``"geom"``; ``None`` for any with that name.
        roll: Whether the roll about the tool's axis is fixed to the one that the toolpath states,
            or free and drawn to it; ``None``: fixed if it states whole orientations, free if it
            states a second axis beside the first.
        transfer: From one curve to the next in straight lines, or by joint moves.
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
        tcp: Pose of its tip in the robot's frame; with it the task's frame is the tip.
        part_mesh: Mesh file of the part, in the toolpath's frame.
        fixture_meshes: Mesh files of what stands around the part, in the toolpath's frame.
        mesh_unit: Unit of all mesh files.
        relative_to: Body of the robot file that carries the part, such as the plate of a turn
            table; ``place`` is then in its frame.
        tool_at: Pose of a tool that is fixed in the cell, in the robot's world. The robot then
            holds the part: ``place`` is in its frame, ``tcp`` in that of the tool, and fixtures are
            in the robot's world.
        controller: How the controller counts the joints: name of a known robot, a file with a table
            of its own (``.toml``), or ``"as modelled"``; ``None``: recognised.
    """

    renamed: ClassVar[dict[str, str]] = {
        **ToolpathOptions.renamed,
        "toolpath": "--path",
        "angular_speed_deg": "--angular-speed",
        "search_seconds": "--search-time",
        "tool_mesh": "--tool",
        "part_mesh": "--part",
        "fixture_meshes": "--fixture",
        "mesh_unit": "--mesh-units",
        "packages": "--package",
        "arguments": "--arg",
    }

    robot: Path
    toolpath: Path
    frame: str | None = None
    frame_type: Literal["site", "body", "geom"] | None = None
    roll: Literal["fixed", "free"] | None = None
    transfer: Literal["straight", "joint"] = "straight"
    tool: Literal["into", "out"] = "into"
    place: Vector | None = None
    place_rpy_deg: Vector = (0.0, 0.0, 0.0)
    speed: Positive = 0.05
    angular_speed_deg: Positive | None = None
    search_seconds: Positive = 60.0
    tool_mesh: Path | None = None
    tcp: Pose | None = None
    part_mesh: Path | None = None
    fixture_meshes: tuple[Path, ...] = ()
    mesh_unit: MeshUnit | None = None
    relative_to: str | None = None
    tool_at: Pose | None = None
    packages: Mapping[str, Path] = Field(default_factory=dict)
    arguments: Mapping[str, str] = Field(default_factory=dict)
    controller: str | None = None

    def __init__(self, robot: Path, toolpath: Path, **options: Any) -> None:
        """Check all of them.

        Raises:
            InvalidInput: With the option.
        """
        try:
            super().__init__(**{"robot": robot, "toolpath": toolpath, **options})
        except ValidationError as error:
            raise problems(error)[0] from None

    def changed(self, **options: Any) -> Request:
        """The same with other values of some options."""
        return Request(**{**dict(self), **options})

    @property
    def has_cell(self) -> bool:
        """Whether something is added to the robot, so that a scene is written."""
        meshes = (self.tool_mesh, self.tcp, self.part_mesh, self.tool_at)
        return bool(self.fixture_meshes) or any(mesh is not None for mesh in meshes)

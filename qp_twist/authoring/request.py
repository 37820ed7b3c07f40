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
    """The arguments of ``qp-twist new``, whose help says what each of them means.

    Lengths are in m, speeds in m/s, angles in degrees with R = Rz Ry Rx, the time of the search in
    s of processor time. ``place`` and ``place_rpy_deg`` are the pose of the toolpath's frame in the
    robot's world, in the frame of ``relative_to``, or, with ``tool_at``, in the robot's frame;
    ``tcp`` is that of the tool's tip in the robot's frame, with ``tool_at`` in that of the tool.
    ``None`` leaves a choice to what is decided from the files.
    """

    renamed: ClassVar[dict[str, str]] = {
        **ToolpathOptions.renamed, "toolpath": "--path", "angular_speed_deg": "--angular-speed",
        "search_seconds": "--search-time", "tool_mesh": "--tool", "part_mesh": "--part",
        "fixture_meshes": "--fixture", "mesh_unit": "--mesh-units", "packages": "--package",
        "arguments": "--arg",
    }  # fmt: skip

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

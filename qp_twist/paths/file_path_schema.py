"""Keys of a path that is read from a toolpath file."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, PlainValidator, model_validator

from qp_twist.files import AngleUnit, FeedUnit, LengthUnit
from qp_twist.paths.apt_toolpath import ArcAxis
from qp_twist.paths.arcs import ARC_ERROR
from qp_twist.paths.projector_schema import OwnProjector
from qp_twist.paths.read_toolpath import Format
from qp_twist.paths.resample import Sampling
from qp_twist.paths.rotary_axes import Rollover, Rotary
from qp_twist.paths.section import Number, Positive, Section, Vector
from qp_twist.paths.toolpath_columns import ColumnChoice, Orientation

LeanAngle = Annotated[float, Field(gt=-90.0, lt=90.0)]


def _parse_column(value: object) -> str | int:
    """A column or a curve: a name, or a number from 1."""
    if isinstance(value, str) and value:
        return value
    if type(value) is int and value >= 1:
        return value
    raise ValueError(f"expected a name, or a number counted from 1, got {value!r}")


Name = Annotated[str | int, PlainValidator(_parse_column)]
Triple = tuple[Name, Name, Name]
Quadruple = tuple[Name, Name, Name, Name]


class ColumnsTable(Section):
    """Columns of a table without usual names."""

    position: Triple | None = None
    axis: Triple | None = Field(default=None, description="of the tool, from its tip to its holder")
    normal: Triple | None = Field(default=None, description="of the surface, away from the part")
    quaternion_wxyz: Quadruple | None = None
    quaternion_xyzw: Quadruple | None = None
    rpy: Triple | None = None
    rotation_vector: Triple | None = Field(default=None, description="axis times angle")
    curve: Name | None = Field(default=None, description="where its entry changes a curve begins")
    feed: Name | None = Field(default=None, description="of the motion to each point")

    def choice(self) -> ColumnChoice:
        """The choice as the reader takes it."""
        return ColumnChoice(**{key: getattr(self, key) for key in type(self).model_fields})


class WorkpieceTable(Section):
    """Pose of the file's frame in the world."""

    position: Vector = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[Number, Number, Number, Number] | None = None
    rpy_deg: Vector | None = None

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        if self.quaternion_wxyz is not None and self.rpy_deg is not None:
            raise ValueError("give either quaternion_wxyz or rpy_deg")
        if self.quaternion_wxyz is not None and not any(self.quaternion_wxyz):
            raise ValueError("quaternion_wxyz is zero")
        return self


class LeadTable(OwnProjector):
    """A straight approach to a curve, or retreat from it."""

    distance: Positive = Field(description="m")
    steps: Annotated[int, Field(ge=1, le=100_000)]
    blend: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=0, description="waypoints over which the change of the projector is spread"
    )

    @model_validator(mode="after")
    def _blend_fits(self) -> Self:
        if self.blend and self.linear is None:
            raise ValueError("blend needs a projector of its own: add linear and angular")
        if self.blend >= self.steps:
            raise ValueError(
                f"blend has to be less than steps = {self.steps}, so that the projector holds at "
                "one waypoint at least"
            )
        return self


class TransferTable(OwnProjector):
    """The transfer from one curve to the next."""

    motion: Literal["straight", "joint"] = Field(
        default="straight",
        description="straight lines of the tool, or a motion of the joints that touches nothing",
    )
    blend: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=0, description="its last waypoints, over which the projector changes to the next"
    )

    @model_validator(mode="after")
    def _no_path_between(self) -> Self:
        if self.motion == "joint" and (self.linear is not None or self.blend):
            raise ValueError(
                'motion = "joint" follows no path, so that no projector holds on it; leave out '
                "linear, angular and blend"
            )
        return self


class FilePath(Section):
    """A toolpath file."""

    kind: Literal["file"]
    file: str = Field(description="relative to the task file", min_length=1)
    format: Format | None = None
    length_unit: LengthUnit | None = None
    angle_unit: AngleUnit | None = None
    orientation: Orientation | None = None
    feed_unit: FeedUnit | None = None
    feeds: Literal["file", "task"] = Field(
        default="file", description="whose feeds count: the file's where it states one, or [feed]"
    )
    rapids: Literal["keep", "drop"] = Field(
        default="drop", description="whether rapid motions of the file are part of the path"
    )
    arc_error: Positive = Field(default=ARC_ERROR, description="m, of the chords of an arc")
    arc_axis: ArcAxis | None = None
    rotary: Rotary | None = None
    rollover: Rollover | None = Field(
        default=None, description="of rotary axes over 360 degrees; shortest unless stated"
    )
    tool: Literal["into", "out"] = "into"
    lead_deg: LeanAngle = 0.0
    tilt_deg: LeanAngle = 0.0
    curves: Annotated[tuple[Name, ...], Field(min_length=1)] | None = None
    chord_error: Positive | None = None
    axis_error_deg: Positive = 0.1
    max_turn_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 3.0
    max_spacing: Positive = 0.01
    columns: ColumnsTable | None = None
    placement: WorkpieceTable | None = None
    approach: LeadTable | None = None
    retreat: LeadTable | None = None
    transfer: TransferTable | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.rapids == "keep" and (self.approach or self.retreat):
            raise ValueError(
                'rapids = "keep" has the tool come and go as in the file; leave out [path.approach]'
                ' and [path.retreat], or say rapids = "drop"'
            )
        return self

    @model_validator(mode="after")
    def _joint_moves_have_ends(self) -> Self:
        if self.rapids == "drop" and self.joint_moves and not (self.approach and self.retreat):
            raise ValueError(
                'motion = "joint" in [path.transfer] begins and ends away from the part; add '
                '[path.retreat] and [path.approach], or say rapids = "keep"'
            )
        return self

    @property
    def joint_moves(self) -> bool:
        """Whether the tool gets from one curve to the next by joint moves."""
        return self.transfer is not None and self.transfer.motion == "joint"

    def sampling(self) -> Sampling:
        """How waypoints are placed."""
        return Sampling(
            chord_error=self.chord_error,
            axis_error=math.radians(self.axis_error_deg),
            max_turn=math.radians(self.max_turn_deg),
            max_spacing=self.max_spacing,
        )

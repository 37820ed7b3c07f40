"""Keys of a path that is read from a toolpath file."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from qp_twist.checks import Array
from qp_twist.paths.projector_schema import OwnProjector
from qp_twist.paths.resample import Sampling
from qp_twist.paths.section import Number, Positive, Section, Vector
from qp_twist.paths.toolpath_columns import Name
from qp_twist.paths.toolpath_options import ToolpathOptions

LeanAngle = Annotated[float, Field(gt=-90.0, lt=90.0)]


class WorkpieceTable(Section):
    """A pose: that of the file's frame in the world."""

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

    def rotation(self) -> Array:
        """The orientation, (3, 3)."""
        from scipy.spatial.transform import Rotation  # imported on demand: 0.1 s

        if self.quaternion_wxyz is None:
            rpy = np.radians(self.rpy_deg or (0.0, 0.0, 0.0))
            rotation = Rotation.from_euler("xyz", rpy)
        else:
            wxyz = np.array(self.quaternion_wxyz)
            wxyz /= np.abs(wxyz).max()  # the norm of huge or tiny numbers over- or underflows
            rotation = Rotation.from_quat(wxyz, scalar_first=True)
        return np.asarray(rotation.as_matrix())


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


class FilePath(ToolpathOptions):
    """A toolpath file."""

    kind: Literal["file"]
    file: str = Field(description="relative to the task file", min_length=1)
    feeds: Literal["file", "task"] = Field(
        default="file", description="whose feeds count: the file's where it states one, or [feed]"
    )
    tool: Literal["into", "out"] = "into"
    lead_deg: LeanAngle = 0.0
    tilt_deg: LeanAngle = 0.0
    curves: Annotated[tuple[Name, ...], Field(min_length=1)] | None = None
    chord_error: Positive | None = None
    axis_error_deg: Positive = 0.1
    max_turn_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 3.0
    max_spacing: Positive = 0.01
    placement: WorkpieceTable | None = None
    approach: LeadTable | None = None
    retreat: LeadTable | None = None
    transfer: TransferTable | None = None

    @model_validator(mode="after")
    def _comes_and_goes(self) -> Self:
        if self.rapids == "keep" and (self.approach or self.retreat):
            raise ValueError(
                'rapids = "keep" has the tool come and go as in the file; leave out [path.approach]'
                ' and [path.retreat], or say rapids = "drop"'
            )
        if self.rapids != "keep" and self.joint_moves and not (self.approach and self.retreat):
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

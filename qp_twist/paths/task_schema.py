"""The task file's sections: every key, its type and its default."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from qp_twist.checks import Array, Indices
from qp_twist.geometry import Projector, ProjectorFrame
from qp_twist.kinematics import BoxBand, ConeBand, RollBand, SlabBand, ToleranceBand
from qp_twist.paths.file_path_schema import FilePath, WorkpieceTable
from qp_twist.paths.methods import MethodName, MethodSettings
from qp_twist.paths.preference import HEAVIEST, VALUES, Preference, on_curves
from qp_twist.paths.projector_schema import ProjectorSection
from qp_twist.paths.section import Number, Positive, Section, Vector

Name = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class RobotSection(Section):
    """The robot and its controlled frame."""

    scene: str = Field(description="MJCF file, relative to the task file or one that is shipped")
    frame: str = Field(description="name of the controlled frame in the scene")
    frame_type: Literal["site", "body", "geom"] = "site"
    relative_to: str | None = Field(
        default=None,
        description="body of the scene that carries the path: its frame takes the world's place",
    )
    packages: dict[str, str] = Field(
        default_factory=dict,
        description="folders of the ROS packages with a URDF's meshes, relative to the task file",
    )
    arguments: dict[str, str | bool | int | float] = Field(
        default_factory=dict, description="values of the arguments of a xacro file"
    )
    controller: Name | None = Field(
        default=None,
        description="how the controller counts the joints in programs: a known robot's name, a "
        'file with a table of its own (.toml, relative to the task file), or "as modelled"',
    )
    external: tuple[Name, ...] = Field(
        default=(),
        description="what external axes show in programs, for each joint besides those of the arm "
        'that the path needs: AXIS = JOINT, such as "E1 = rail" or "E2 = -tilt + 90 deg"',
    )


class SegmentSection(ProjectorSection):
    """Another projector, from a waypoint on."""

    first: Annotated[int, Field(ge=2, le=1_000_000)] = Field(
        description="waypoint, counted from 1; [projector] holds before"
    )
    blend: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=0, description="waypoints over which the change into it is spread"
    )


class BandTable(Section):
    """Base of the tolerance bands: the keys are the arguments of the band, angles in degrees."""

    made: ClassVar[Callable[..., ToleranceBand]]
    frame: ProjectorFrame = "target"
    weight: Positive | None = None

    def band(self) -> ToleranceBand:
        """The band of this table."""
        values = {key: getattr(self, key) for key in type(self).model_fields if key != "kind"}
        return type(self).made(**{
            key.removesuffix("_deg"): math.radians(value) if key.endswith("_deg") else value
            for key, value in values.items()
        })  # fmt: skip

    @model_validator(mode="after")
    def _is_a_band(self) -> Self:
        self.band()
        return self


class RollBandTable(BandTable):
    """A range for the roll."""

    made = RollBand
    kind: Literal["roll"]
    axis: Vector
    lower_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    upper_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    frame: ProjectorFrame = "body"


class ConeBandTable(BandTable):
    """A range for the angle between an axis of the frame and a direction."""

    made = ConeBand
    kind: Literal["cone"]
    axis: Vector
    reference: Vector
    upper_deg: Annotated[float, Field(gt=0.0, le=180.0)]
    lower_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    frame: Literal["target", "world"] = "target"


class SlabBandTable(BandTable):
    """A range for the distance along a normal."""

    made = SlabBand
    kind: Literal["slab"]
    normal: Vector
    lower: Number
    upper: Number


class BoxBandTable(BandTable):
    """A box for the position."""

    made = BoxBand
    kind: Literal["box"]
    lower: Vector
    upper: Vector


BandSection = Annotated[
    RollBandTable | ConeBandTable | SlabBandTable | BoxBandTable, Field(discriminator="kind")
]


class PolylinePath(Section):
    """Straight segments through points."""

    kind: Literal["polyline"]
    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    steps_per_segment: Count
    tool_axis: Vector | None = Field(
        default=None, description="direction of the tool's z; held from the start if missing"
    )


class SphericalPatchPath(Section):
    """The four edges of a patch on top of a sphere."""

    kind: Literal["spherical_patch"]
    center: Vector
    radius: Positive
    half_width: tuple[Positive, Positive]
    steps_per_edge: Count
    tool: Literal["into", "out"] = "into"
    lead: Positive | None = Field(
        default=None, description="straight way along the normal, before and after the edges, m"
    )
    steps_per_lead: Count | None = None

    @model_validator(mode="after")
    def _whole_lead(self) -> SphericalPatchPath:
        if (self.lead is None) != (self.steps_per_lead is None):
            raise ValueError("give both lead (m) and steps_per_lead, or neither")
        return self


class Pose(WorkpieceTable):
    """One waypoint."""

    position: Vector

    @model_validator(mode="after")
    def _has_orientation(self) -> Self:
        if self.quaternion_wxyz is None and self.rpy_deg is None:
            raise ValueError("give either quaternion_wxyz or rpy_deg")
        return self


class PosesPath(Section):
    """A list of poses."""

    kind: Literal["poses"]
    poses: Annotated[tuple[Pose, ...], Field(min_length=2)]


PathSection = Annotated[
    PolylinePath | SphericalPatchPath | PosesPath | FilePath, Field(discriminator="kind")
]


class RollSection(Section):
    """How `rmr` and `qp_rmr` fix the roll which the task leaves free."""

    plane_normal: Vector = Field(description="y of the tool lies in the plane with this normal")


class StartSection(Section):
    """Start of the robot; it is corrected onto the first waypoint."""

    q_deg: tuple[Number, ...] | None = None
    q: tuple[Number, ...] | None = None
    best: Literal[True] | None = None
    central: Literal[True] | None = None

    @property
    def found(self) -> bool | Literal["central"]:
        """Whether to search the start: that of the best plan, or the central one."""
        return "central" if self.central else bool(self.best)

    @model_validator(mode="after")
    def _one_of_them(self) -> StartSection:
        if [self.q_deg, self.q, self.best, self.central].count(None) != 3:
            raise ValueError(
                'give either q_deg (degrees) or q (rad, m), or start = "central" or "best"'
            )
        return self


class FeedSection(Section):
    """Time for each waypoint; required for limits of velocity, acceleration and jerk."""

    speed: Positive | None = Field(default=None, description="along the path, m/s")
    angular_speed_deg: Positive | None = Field(default=None, description="of the tool, deg/s")
    rapid: Positive | None = Field(
        default=None, description="from one curve to the next, m/s; as speed if missing"
    )
    dt: Positive | None = Field(default=None, description="for every waypoint, s")
    mode: Literal["fastest", "constant"] = Field(
        default="fastest",
        description="constant: the tool has this speed but on ramps; the free motion is spent on "
        "it, and each dip is reported",
    )
    max_dip: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        default=None, description="with constant: largest dip that passes, as a share of the speed"
    )

    @model_validator(mode="after")
    def _one_clock(self) -> FeedSection:
        if self.dt is not None and (self.speed, self.angular_speed_deg, self.rapid) != (None,) * 3:
            raise ValueError("give either dt or speed, angular_speed_deg and rapid")
        if self.dt is None and self.speed is None and self.mode == "fastest":
            raise ValueError("give speed (m/s) or dt (s)")
        return self


class PlanSection(Section):
    """What a plan of the whole path may do."""

    cuts: Literal["fewest"] | tuple[Count, ...] = Field(
        default=(),
        description='"fewest": lift the tool off where no motion follows the whole path, as rarely '
        "as possible; or the waypoints after which it does, from 1; each piece has two at least",
    )

    @field_validator("cuts", mode="before")
    @classmethod
    def _in_order(cls, value: Any) -> Any:
        whole = isinstance(value, list) and all(type(k) is int and k > 0 for k in value)
        if value == "fewest" or (whole and value == sorted(set(value))):
            return value if value == "fewest" else tuple(value)
        expected = 'expected "fewest", or waypoints in their order from 1, such as [12, 40]'
        raise ValueError(f"{expected}; got {json.dumps(value, default=str)}")


def _several(value: object) -> object:
    """A number as the only one of a list, and a list as the tuple that strict checks expect."""
    return tuple(value) if isinstance(value, list) else (value,)


Angles = Annotated[tuple[Number, ...], BeforeValidator(_several), Field(min_length=1)]
"""One angle, or one for each curve of the path, degrees."""
Weight = Annotated[float, Field(ge=0.0, le=HEAVIEST)]


class PreferenceSection(Section):
    """Lean and roll of the tool that a plan prefers where the task leaves them free."""

    lead_deg: Angles | None = Field(
        default=None,
        description="lean of the frame's z from the waypoint's towards the direction of the path; "
        "one angle, or one for each curve",
    )
    tilt_deg: Angles | None = Field(
        default=None, description="lean to the left of it as seen from the tip of z, likewise"
    )
    roll_deg: Angles | None = Field(
        default=None, description="turn about the waypoint's z, from its roll, likewise"
    )
    within_deg: Annotated[float, Field(ge=0.0, le=180.0)] = Field(
        default=0.0, description="a smaller difference costs nothing"
    )
    weight: Weight = Field(
        default=1.0, description="cost of a radian: half of it, in the objective's unit"
    )
    roll_smoothness: Weight = Field(
        default=0.0, description="cost of a roll that turns evenly by a radian: half of it"
    )

    def on_curves(self, curves: Indices) -> Preference:
        """The preference at waypoints (N,) of curves, −1 for none."""
        given = {name: getattr(self, f"{name}_deg") for name in VALUES}
        return Preference(
            **{
                name: on_curves(name, angles, curves)
                for name, angles in given.items()
                if angles is not None
            },
            within=math.radians(self.within_deg),
            weight=self.weight,
            roll_smoothness=self.roll_smoothness,
            curves=curves,
        )


class ProgramSection(Section):
    """What robot programs of this path have around it."""

    calls: dict[Name, Name] = Field(
        default_factory=dict,
        description="procedures of the controller by words of the toolpath that switch the "
        'process, such as "SPINDL ON" = "SpindleOn"; other such words are comments',
    )


class LimitsSection(Section):
    """Limits that MJCF does not have. Position limits are the scene's."""

    velocity: dict[str, Positive] = Field(
        default_factory=dict, description="joint name: largest speed, rad/s or m/s"
    )
    acceleration: dict[str, Positive] = Field(
        default_factory=dict, description="joint name: largest acceleration, rad/s² or m/s²"
    )
    jerk: dict[str, Positive] = Field(
        default_factory=dict, description="joint name: largest jerk, rad/s³ or m/s³"
    )


class ClearanceSection(Section):
    """Distance between geoms of the scene that must not touch."""

    distance: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=0.005, description="smallest distance of every pair, m"
    )
    ignore: tuple[tuple[Name, Name], ...] = Field(
        default=(), description="pairs of geoms or bodies that may touch"
    )


class IterationSection(Section):
    """Iteration to a waypoint."""

    position_tolerance: Positive = 1e-9
    angle_tolerance_deg: Positive = 1e-7
    max_linear_step: Positive = 0.05
    max_angular_step_deg: Positive = 5.0

    @property
    def angle_tolerance(self) -> float:
        """Angular tolerance, rad."""
        return math.radians(self.angle_tolerance_deg)

    @property
    def tolerances(self) -> Array:
        """Linear and angular tolerance, m and rad, (2,)."""
        return np.array([self.position_tolerance, self.angle_tolerance])

    @property
    def max_angular_step(self) -> float:
        """Largest angular step, rad."""
        return math.radians(self.max_angular_step_deg)


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"expected [lowest, highest], got {list(interval)}")
    return interval


Interval = Annotated[tuple[Number, Number], AfterValidator(_ordered)]


class PlacementTable(Section):
    """Range of placements of the workpiece."""

    point: Vector = Field(description="of the workpiece where the file has it, m")
    body: str | None = Field(default=None, description="of the scene that moves along")
    lower: Vector = Field(description="lowest position that the point is put to, m")
    upper: Vector = Field(description="highest position that the point is put to, m")
    yaw_deg: Interval = Field(default=(0.0, 0.0), description="turn about the vertical")
    tilt_deg: Interval = Field(
        default=(0.0, 0.0), description="then a tilt about a horizontal axis of any direction"
    )

    @model_validator(mode="after")
    def _is_a_box(self) -> PlacementTable:
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError("no entry of lower may be above that of upper")
        return self


class ToolTable(Section):
    """Range of tilts of the tool."""

    lead_deg: Interval = Field(default=(0.0, 0.0), description="towards the way it goes")
    tilt_deg: Interval = Field(default=(0.0, 0.0), description="to the left of it")


class SolverTable(Section):
    """Backends to choose from."""

    names: Annotated[tuple[str, ...], Field(min_length=1)]


class RobotTable(Section):
    """Robots to choose from."""

    scenes: Annotated[tuple[str, ...], Field(min_length=1)]


PositiveInterval = Annotated[tuple[Positive, Positive], AfterValidator(_ordered)]


class StudySection(Section):
    """What a study varies, and its criterion of success."""

    seed: Annotated[int, Field(ge=0)] = 0
    position_error: Positive = Field(default=1e-4, description="largest that is a success, m")
    axis_error_deg: Positive = 0.05
    max_step_deg: Positive | None = Field(
        default=None,
        description="largest step of a joint from a waypoint to the next, instead of the task's "
        "clock and speed limits",
    )
    placement: PlacementTable | None = None
    tool: ToolTable | None = None
    gain: Annotated[dict[MethodName, PositiveInterval], Field(min_length=1)] | None = None
    solver: SolverTable | None = None
    robot: RobotTable | None = None


class TaskFile(Section):
    """A whole task file."""

    title: str
    robot: RobotSection
    projector: ProjectorSection
    operational: ProjectorSection = ProjectorSection(
        linear=Projector.full(), angular=Projector.full()
    )
    segments: tuple[SegmentSection, ...] = ()
    bands: tuple[BandSection, ...] = ()
    path: PathSection
    roll: RollSection | None = None
    start: StartSection
    feed: FeedSection | None = None
    limits: LimitsSection = LimitsSection()
    program: ProgramSection = ProgramSection()
    plan: PlanSection = PlanSection()
    preference: PreferenceSection | None = None
    clearance: ClearanceSection | None = None
    iteration: IterationSection = IterationSection()
    methods: dict[MethodName, MethodSettings] = Field(default_factory=dict)
    study: StudySection | None = None

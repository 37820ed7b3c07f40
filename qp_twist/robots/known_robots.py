"""Known robots: speed limits, and how the controllers count the axes, from public data sheets.

MJCF has no joint speed limits, and many URDFs omit them. ``known_robots.toml`` has those of some
robots, and their axes where the controller shows zero for each. A robot is recognised by its
geometry *and* its name, so that neither another arm of the same name nor another one of the same
shape is mistaken for it. Where the table says that no other robot has that geometry (``by_shape``),
the geometry suffices, as long as the name is not that of another robot: the maker's own description
of a UR10e calls it ``ur``. The limits are used in checks (:func:`~qp_twist.check_trajectory`),
which name them; steps and plans use the task's limits only. What the controller shows for a
configuration of a model is computed by :mod:`~qp_twist.robots.controller_joints`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from qp_twist.checks import Array, clause, did_you_mean
from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular, of_file, read_text
from qp_twist.kinematics import SerialChain
from qp_twist.kinematics.serial_chain import Screw
from qp_twist.robots.axis_geometry import AxisGeometry, Line, axis_geometry

_TABLE = Path(__file__).with_name("known_robots.toml")
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class KnownRobot(BaseModel):
    """A robot whose axes and joint speed limits are public: one table of the file.

    Attributes:
        name: Maker and model.
        pattern: What a name of the model, its file or its bodies contains, lower case.
        by_shape: Whether its axes alone tell it.
        program: Language of its controller; ``None`` where it has none of those that are written.
        axes: Directions of its axes where the controller shows zero for each; positive rotations.
        points_mm: A point of each axis.
        coupling: (i, j, factor): the controller shows for axis i, from 1, its angle to the link
            before plus factor times axis j; ``None`` without.
        speeds_deg: Largest joint speeds from the base on, degrees/s.
        accelerations_deg: Largest joint accelerations, degrees/s²; ``None`` where none are public.
        range_deg: Range of each axis before the coupling, degrees; ``None`` where unknown.
        source: Source of the figures.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1)]
    pattern: str = ""
    by_shape: bool = False
    program: Literal["urscript", "rapid", "krl", "ls"] | None = None
    axes: Annotated[tuple[Vector, ...], Field(min_length=2)]
    points_mm: tuple[Vector, ...]
    coupling: tuple[int, int, Finite] | None = None
    speeds_deg: tuple[Positive, ...]
    accelerations_deg: tuple[Positive, ...] | None = None
    range_deg: tuple[tuple[Finite, Finite], ...] | None = None
    source: Annotated[str, Field(min_length=1)]

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        count = len(self.axes)
        for key in ("points_mm", "speeds_deg", "accelerations_deg", "range_deg"):
            value = getattr(self, key)
            if value is not None and len(value) != count:
                raise ValueError(f"{key}: {len(value)} entries, but there are {count} axes")
        if any(np.linalg.norm(axis) < 1e-6 for axis in self.axes):
            raise ValueError("axes: a direction of length zero")
        if self.coupling is not None and not (
            {*self.coupling[:2]} <= {*range(1, count + 1)} and self.coupling[0] > self.coupling[1]
        ):
            raise ValueError(f"coupling: expected [i, j, factor], axes 1 to {count}, j before i")
        return self

    @cached_property
    def lines(self) -> tuple[Line, ...]:
        """Its axes as lines, m."""
        return tuple(
            Line(np.array(axis) / np.linalg.norm(axis), 1e-3 * np.array(point))
            for axis, point in zip(self.axes, self.points_mm, strict=True)
        )

    @property
    def speeds(self) -> Array:
        """Largest joint speeds from the base on, rad/s."""
        return np.radians(self.speeds_deg)

    @property
    def accelerations(self) -> Array | None:
        """Largest joint accelerations from the base on, rad/s²; ``None`` where none are public."""
        return None if self.accelerations_deg is None else np.radians(self.accelerations_deg)

    @cached_property
    def geometry(self) -> AxisGeometry:
        """The invariants of its axes, by which an arm is recognised."""
        return axis_geometry(self.lines)

    def __repr__(self) -> str:
        return f"KnownRobot({self.name!r}, {self.program or 'no program'})"


def read_robots(path: Path) -> tuple[KnownRobot, ...]:
    """The robots of a file in the form of the package's ``known_robots.toml``.

    Raises:
        InvalidInput: If the file cannot be read; with the key.
    """
    text = read_text(path, "table of robots")
    with of_file(path):
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InvalidInput(f"this is no TOML: {clause(error)}.") from None
        tables = document.get("robot")
        if not isinstance(tables, list) or not tables or set(document) != {"robot"}:
            raise InvalidInput("expected one or more tables [[robot]], and nothing else.")
        robots = []
        for number, table in enumerate(tables, start=1):
            try:
                robots.append(KnownRobot.model_validate(table))
            except ValidationError as error:
                first = error.errors()[0]
                key = ".".join(str(part) for part in first["loc"])
                text = str(first["msg"]).removeprefix("Value error, ")
                raise InvalidInput(
                    f"[[robot]] {number}{f', {key}' if key else ''}: {text}."
                ) from None
        return tuple(robots)


KNOWN_ROBOTS: tuple[KnownRobot, ...] = read_robots(_TABLE)
"""The known robots."""


def stated_robot(robot: str | Path) -> KnownRobot:
    """A robot by its name in the table, or from a file (``.toml``) with a table of its own.

    Raises:
        InvalidInput: If there is no such robot or file, or the file has not exactly one.
    """
    if not str(robot).lower().endswith(".toml"):
        return named_robot(str(robot))
    path = Path(robot)
    check_regular(path, "table of robots")
    found = read_robots(path)
    if len(found) != 1:
        raise InvalidInput(f"{path}: expected one [[robot]], got {len(found)}.")
    return found[0]


def named_robot(name: str) -> KnownRobot:
    """The robot of the table with this name, or with this model's name.

    Raises:
        InvalidInput: If there is none; with the names.
    """
    wanted = name.strip().lower()
    for robot in KNOWN_ROBOTS:  # also UR5e, without its maker's two words
        if wanted and f" {robot.name.lower()}".endswith(f" {wanted}"):
            return robot
    names = [robot.name for robot in KNOWN_ROBOTS]
    raise InvalidInput(
        f"there is no robot {name!r} in the table{did_you_mean(name, names)} It has "
        f"{', '.join(names)}. Another one needs a file of its own (.toml); see the documentation, "
        "Export."
    )


def known_robot(
    model: mujoco.MjModel, frame_name: str | int, frame_type: str, names: Iterable[str] = ()
) -> KnownRobot | None:
    """The robot of the table whose arm carries a frame; ``None`` if it is none of them.

    Args:
        model: The scene.
        frame_name: A frame at the end of the arm, or on a tool.
        frame_type: ``"body"``, ``"site"`` or ``"geom"``.
        names: Further names, such as that of its file.

    Raises:
        mink.InvalidFrame: If the model has no such frame.
    """
    screws = hinges_of(model, frame_name, frame_type)
    if not screws:
        return None
    bodies = (model.body(i).name for i in range(1, model.nbody))
    title = model.names.split(b"\0", 1)[0].decode(errors="replace")
    words = " ".join([title, *bodies, *names]).lower()
    alike = _shaped_like(screws)
    named = [robot for robot in KNOWN_ROBOTS if re.search(robot.pattern, words)]
    both = [robot for robot in alike if robot in named]
    if both:
        return both[0]
    return alike[0] if len(alike) == 1 and alike[0].by_shape and not named else None


def known_limits(
    model: mujoco.MjModel, frame_name: str | int, frame_type: str, names: Iterable[str] = ()
) -> tuple[KnownRobot, list[int]] | None:
    """The recognised robot, and the degree of freedom of each of its joints from the base on.

    Arguments as for :func:`known_robot`; ``None`` if it is not in the table.
    """
    robot = known_robot(model, frame_name, frame_type, names)
    if robot is None:
        return None
    screws = hinges_of(model, frame_name, frame_type)[-len(robot.lines) :]
    return robot, [screw.dof for screw in screws]


def hinges_of(model: mujoco.MjModel, frame_name: str | int, frame_type: str) -> tuple[Screw, ...]:
    """The last hinges of a frame's chain, from the base on: an arm, behind its rail or column."""
    try:
        screws = SerialChain.of(model, frame_name, frame_type).screws
    except InvalidInput:  # ball and free joints
        return ()
    first = max((k + 1 for k, screw in enumerate(screws) if screw.slides), default=0)
    return screws[first:]


def _shaped_like(screws: Sequence[Screw]) -> list[KnownRobot]:
    """The robots whose axes are the last of these, up to pose and directions counted positive."""
    lines = [Line(screw.axis, screw.anchor) for screw in screws]
    shapes = {
        count: [shape for _, shape in axis_geometry(lines[-count:]).orientations()]
        for count in {len(robot.lines) for robot in KNOWN_ROBOTS}
        if count <= len(lines)
    }
    return [
        robot for robot in KNOWN_ROBOTS
        if any(robot.geometry.is_like(shape) for shape in shapes.get(len(robot.lines), ()))
    ]  # fmt: skip

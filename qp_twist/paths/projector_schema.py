"""Projectors as written in task files."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import PlainValidator, model_validator

from qp_twist.geometry import Projector, ProjectorFrame, TwistProjector
from qp_twist.paths.section import Section


def _parse_block(value: object) -> Projector:
    """A projector from ``"full"``, ``"none"``, ``{plane = […]}`` or ``{line = […]}``."""
    if value == "full":
        return Projector.full()
    if value == "none":
        return Projector.none()
    if isinstance(value, Projector):
        return value
    if isinstance(value, dict) and len(value) == 1:
        [(kind, vector)] = value.items()
        if not isinstance(vector, list) or any(type(x) not in (int, float) for x in vector):
            raise ValueError(f"{kind}: expected three numbers, got {vector!r}")
        if kind == "plane":
            return Projector.plane(vector)
        if kind == "line":
            return Projector.line(vector)
    raise ValueError(
        f'expected "full", "none", {{plane = [x, y, z]}} or {{line = [x, y, z]}}, got {value!r}'
    )


Block = Annotated[Projector, PlainValidator(_parse_block)]


class ProjectorSection(Section):
    """A twist projector."""

    linear: Block
    angular: Block
    frame: ProjectorFrame = "world"

    def projector(self) -> TwistProjector:
        """The projector of the section."""
        return TwistProjector(linear=self.linear, angular=self.angular, frame=self.frame)


class OwnProjector(Section):
    """A twist projector, or the default one."""

    linear: Block | None = None
    angular: Block | None = None
    frame: ProjectorFrame = "world"

    def projector(self) -> TwistProjector | None:
        """The projector of the section; ``None`` if it has none."""
        if self.linear is None or self.angular is None:
            return None
        return TwistProjector(linear=self.linear, angular=self.angular, frame=self.frame)

    @model_validator(mode="after")
    def _both_blocks(self) -> Self:
        if (self.linear is None) != (self.angular is None):
            raise ValueError("give both linear and angular, or neither")
        return self

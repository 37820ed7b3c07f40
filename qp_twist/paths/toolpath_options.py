"""The options of a toolpath, stated once.

A field here is an argument of Python, a key of ``[path]`` in a task file, an option of
``qp-twist new``, and is written into the files that it makes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import AfterValidator, Field

from qp_twist.files import AngleUnit, FeedUnit, LengthUnit
from qp_twist.paths.arcs import ARC_ERROR, ArcAxis
from qp_twist.paths.column_names import Orientation
from qp_twist.paths.rotary_axes import Machine, Rollover, Rotary
from qp_twist.paths.section import Positive, Section
from qp_twist.paths.toolpath_columns import ColumnChoice

_NUMBER = r"\s*[+-]?([0-9]+\.?[0-9]{0,9}|\.[0-9]{1,9})\s*"
_PIVOT = re.compile(rf"{_NUMBER}(,{_NUMBER}){{2}}((,{_NUMBER}){{3}})?")
Format = Literal["csv", "apt", "gcode", "heidenhain", "rapid", "krl", "ls", "urscript", "jbi"]


def _three_or_six(pivot: str) -> str:
    if _PIVOT.fullmatch(pivot) is None:
        raise ValueError(
            f"expected X,Y,Z, such as 0,0,-50, or six numbers for two axes; got {pivot!r}"
        )
    return pivot


class ReadingOptions(Section):
    """How a toolpath file is read. What the file states itself need not be given."""

    renamed: ClassVar[dict[str, str]] = {"length_unit": "--unit"}
    """Options of ``qp-twist new`` that are not called like their field."""

    format: Format | None = Field(
        default=None,
        description="of the file; if omitted, APT-CL with GOTO lines, Klartext with BEGIN PGM, "
        "G-code by its suffix or its blocks, robot programs by their first lines, else a table; "
        "point clouds, bags and poses in YAML or JSON need none",
    )
    length_unit: LengthUnit | None = Field(
        default=None, description="unit of positions, if the toolpath does not contain it"
    )
    angle_unit: AngleUnit | None = Field(
        default=None, description="unit of angles and rotation vectors, likewise"
    )
    orientation: Orientation | None = Field(
        default=None, description="columns of direction to use, if there are several"
    )
    axes_point: Literal["out", "into"] | None = Field(
        default=None,
        description="whether tool axes and normals of the file point out of the part, to the "
        "tool's holder (the default), or into it",
    )
    feed_unit: FeedUnit | None = Field(
        default=None, description="unit of a column of feeds, likewise"
    )
    columns: ColumnChoice | None = Field(
        default=None, description='columns with unusual names, e.g. "position=1,2,3;normal=4,5,6"'
    )
    arc_error: Positive = Field(
        default=ARC_ERROR, description="largest distance of an arc from its chords, m"
    )
    arc_axis: ArcAxis | None = Field(
        default=None, description="sense of CIRCLE about its axis, if the file leaves it open"
    )
    rotary: Rotary | None = Field(
        default=None,
        description="how the rotary axes A, B, C of a G-code file turn the tool or the part; or "
        "vector, the tool axis is I, J, K of straight motions; reversed, a table that turns "
        "right-handed, against ISO 841",
    )
    machine: Machine | None = Field(
        default=None,
        description="machine whose axes X, Y, Z, A, B, C of a G-code file are without control of "
        "the tool's tip; as rotary",
    )
    pivot: Annotated[str, AfterValidator(_three_or_six)] | None = Field(
        default=None,
        description="where the rotary axes of that machine are with all at zero, as X,Y,Z, or six "
        "numbers for both, in the unit of the file: on a table in its frame, the origin if "
        "omitted; on a head from the tool's tip",
    )
    rollover: Rollover | None = Field(
        default=None,
        description="whether rotary axes that turn by more than 180 degrees in a cut take the "
        "short way, as where they roll over from 360 to 0 (the default), or the way as written",
    )

    def stated_options(self) -> list[tuple[str, object, str]]:
        """The options of a toolpath that are not at their default: key, value, and what it is."""
        return [
            (key, getattr(self, key), (field.description or "").partition(";")[0])
            for key, field in ToolpathOptions.model_fields.items()
            if getattr(self, key) != field.default
        ]

    @classmethod
    def option(cls, key: str) -> str:
        """The option of ``qp-twist new`` for a field."""
        return cls.renamed.get(key, f"--{key.replace('_', '-')}")

    @classmethod
    def answer(cls, key: str, value: str | None) -> str:
        """The option with a value, or with all that there are."""
        if value is None:
            *others, last = choices(cls.model_fields[key].annotation)
            value = f"{', '.join(others)} or {last}"
        return f"{cls.option(key)} {value}"

    @classmethod
    def hint(cls, options: Mapping[str, str | None], command: str) -> str:
        """What answers a message about a toolpath on the command line; empty without options."""
        answers = [cls.answer(key, value) for key, value in options.items()]
        return f" For {command}: {' or '.join(answers)}" if answers else ""


class ToolpathOptions(ReadingOptions):
    """How a toolpath file is read, and what of it is the path."""

    rapids: Annotated[
        Literal["keep", "drop"] | None,
        Field(
            description="whether rapid motions of the file are part of the path; if omitted in "
            "qp-twist new, if the file leads the tool away from each curve and to the next"
        ),
    ] = None


def choices(annotation: object) -> list[str]:
    """The values of a ``Literal``, or of one of the types of a union."""
    found = get_args(annotation)
    if found and all(isinstance(value, str) for value in found):
        return list(found)
    return [value for part in found for value in choices(part)]

"""``qp-twist new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import ValidationError

from qp_twist.authoring import Request, new_task
from qp_twist.checks import number
from qp_twist.cli.app import app, check_file, say
from qp_twist.cli.progress import working
from qp_twist.errors import InvalidInput
from qp_twist.path.file_path_schema import ColumnsTable

Text = Annotated[str | None, tyro.conf.arg(metavar="NAME")]


@app.command
def new(
    robot: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="ROBOT")],
    path: Annotated[Path, tyro.conf.arg(metavar="FILE")],
    frame: Text = None,
    frame_type: Literal["auto", "site", "body", "geom"] = "auto",
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("task.toml"),
    unit: Literal["auto", "mm", "m", "inch"] = "auto",
    angle_unit: Literal["auto", "deg", "rad"] = "auto",
    orientation: Literal["auto", "axis", "normal", "quaternion", "rpy", "none"] = "auto",
    columns: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None,
    tool: Literal["into", "out"] = "into",
    place: Annotated[str | None, tyro.conf.arg(metavar="X,Y,Z")] = None,
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.05,
    force: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Write a commented task file for a robot and a toolpath; it runs as it is.

    Args:
        robot: MJCF or URDF file, or a shipped scene.
        path: Toolpath, CSV or APT-CL.
        frame: The robot's frame that follows it; without it the only one that can.
        frame_type: What the frame is, where names are used twice.
        out: Task file to write.
        unit: Of positions, where the toolpath does not say it.
        angle_unit: Of roll, pitch and yaw, likewise.
        orientation: Which columns of direction count, where there are several.
        columns: Columns without usual names, e.g. "position=1,2,3;normal=4,5,6".
        tool: Whether the frame's z points into the part or out of it.
        place: Where the toolpath's origin stands in the robot's world, m, e.g. 0.5,0,0.2; without
            it in the world's origin, or elsewhere if it is out of reach there.
        speed: Along the path, m/s.
        force: Overwrite the task file.
    """
    request = Request(
        robot=robot,
        toolpath=path,
        frame=frame,
        frame_type=None if frame_type == "auto" else frame_type,
        length_unit=None if unit == "auto" else unit,
        angle_unit=None if angle_unit == "auto" else angle_unit,
        orientation=None if orientation == "auto" else orientation,
        columns=None if columns is None else _columns(columns),
        tool=tool,
        place=None if place is None else _place(place),
        speed=number("--speed", speed, above=0.0),
    )
    check_file(out)
    with working("reading the robot") as say_so:
        task = new_task(request, out, force=force, progress=say_so)
    say(f"wrote {out}: {task.path_task.title}", *(f"  {note}" for note in task.notes))
    if not task.runs:
        say("  the robot does not come to the end of the path; the notes above say why.")
        raise SystemExit(1)
    shown = str(out) if len(out.parts) > 1 else f"./{out}"
    say(f"next: qp-twist compare {shown}")


def _place(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            f"--place {text!r}: expected three numbers in metres, e.g. --place 0.5,0,0.2 (with a "
            "negative first one --place=-0.5,0,0.2)."
        ) from None
    return x, y, z


def _columns(text: str) -> ColumnsTable:
    expected = (
        'expected for example "position=1,2,3;normal=4,5,6"; keys are '
        f"{', '.join(ColumnsTable.model_fields)}"
    )
    table: dict[str, object] = {}
    for part in text.split(";"):
        key, equals, names = part.partition("=")
        if not equals or key.strip() not in ColumnsTable.model_fields:
            raise InvalidInput(f"--columns {text!r}: {part!r} has no known key; {expected}.")
        values = [
            int(name) if name.strip().isdecimal() else name.strip() for name in names.split(",")
        ]
        table[key.strip()] = values[0] if key.strip() == "curve" else tuple(values)
    try:
        return ColumnsTable.model_validate(table)
    except ValidationError as error:
        item = error.errors()[0]
        said = item["msg"].removeprefix("Value error, ")
        if item["type"] in ("missing", "too_short", "too_long"):
            said = "a position needs three columns, and a direction as many as it has numbers"
        raise InvalidInput(
            f"--columns {text!r}: {item['loc'][0] if item['loc'] else 'columns'}: {said}; "
            f"{expected}."
        ) from None

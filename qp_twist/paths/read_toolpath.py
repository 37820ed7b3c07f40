"""Read a toolpath file of any format."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import file_path, of_file, read_bytes, text_lines
from qp_twist.paths.apt_toolpath import APT
from qp_twist.paths.bag_poses import bag_table, is_bag
from qp_twist.paths.csv_toolpath import CSV, table_toolpath
from qp_twist.paths.gcode_toolpath import GCODE
from qp_twist.paths.heidenhain_toolpath import HEIDENHAIN
from qp_twist.paths.point_cloud import cloud_table, is_cloud, order_note
from qp_twist.paths.pose_records import pose_table
from qp_twist.paths.robot_path import ROBOTS
from qp_twist.paths.section import validated
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import ToolpathFormat
from qp_twist.paths.toolpath_options import Format, ReadingOptions

FORMATS: dict[Format, ToolpathFormat] = {
    "apt": APT, "heidenhain": HEIDENHAIN, "gcode": GCODE, "rapid": ROBOTS["rapid"],
    "urscript": ROBOTS["urscript"], "krl": ROBOTS["krl"], "ls": ROBOTS["ls"], "jbi": ROBOTS["jbi"],
    "csv": CSV,
}  # fmt: skip
"""The formats; a file is of the first one that it matches."""
_OTHER_PROGRAMS = {
    "an AS program (Kawasaki)": r"\s*\.PROGRAM\b",
    "a VAL3 program (Stäubli)": r"\s*<(?:Database|Programs?)\b.*(?:staubli|ProgramNameSpace)",
}
"""Programs that are no toolpaths, by a line with which they begin."""
_DOWN = -0.5
"""Largest z of axes that all point down."""
_BEGIN = 50
"""Number of lines in which the line of ``_OTHER_PROGRAMS`` stands."""


def read_toolpath(
    file: str | Path, options: ReadingOptions | None = None, **given: object
) -> Toolpath:
    """Read a toolpath: APT-CL, G-code, Klartext, a robot program, table, point cloud, poses, bag.

    Information in the file (names and units in its header, ``UNITS/MM``) need not be passed.

    Args:
        file: The file.
        options: How to read it; or its fields as keywords, e.g. ``length_unit="mm"``
            (:class:`~qp_twist.paths.ReadingOptions`).
        given: These fields.

    Returns:
        The curves, in metres, with unit vectors or rotations, and the feeds of the file.

    Raises:
        InvalidInput: If the file cannot be read, is ambiguous, or has invalid rows; with line and
            column of the first twenty.

    Example:
        >>> from qp_twist.paths import shipped_folder
        >>> read_toolpath(shipped_folder("tasks") / "dome_seams.csv")
        Toolpath('dome_seams.csv', 2 curves, 122 points, normal)
    """
    path = file_path("file", file)
    options = validated(ReadingOptions, given) if options is None else options
    content = read_bytes(path, "toolpath file")
    with of_file(path):
        return _facing(_any_format(path, content, options), options)


def _any_format(path: Path, content: bytes, options: ReadingOptions) -> Toolpath:
    if is_bag(content):
        table, notes = bag_table(content)
        return table_toolpath(path, table, options, notes=notes)
    if is_cloud(content):
        header = content[:4000].partition(b"end_header")[0].decode("latin-1").splitlines()
        toolpath = table_toolpath(path, cloud_table(content), options, header)
        points = np.concatenate([curve.positions for curve in toolpath.curves])
        return replace(toolpath, assumptions=(order_note(points), *toolpath.assumptions))
    lines = text_lines(content)
    poses = pose_table(path.suffix.lower(), lines)
    if poses is not None:
        return table_toolpath(path, poses[0], options, lines, poses[1])
    return _read(path, lines, options)


def _facing(toolpath: Toolpath, options: ReadingOptions) -> Toolpath:
    """The toolpath with axes that point out of the part, and a note if they may be turned round.

    Raises:
        InvalidInput: If a sense of axes is stated, and the file has none by themselves.
    """
    if toolpath.meaning not in ("axis", "normal"):
        if options.axes_point is not None:
            raise InvalidInput(
                "there are no tool axes or normals by themselves; leave it out.", key="axes_point"
            )
        return toolpath
    if options.axes_point == "into":
        return replace(toolpath, curves=tuple(curve.facing(-1.0) for curve in toolpath.curves))
    if options.axes_point is None and max(c.axes[:, 2].max() for c in toolpath.curves) < _DOWN:
        what = "tool axes" if toolpath.meaning == "axis" else "normals"
        answer = options.answer("axes_point", "into")
        note = f"all {what} point down, and are read as out of the part; {answer} turns them round."
        return replace(toolpath, assumptions=(*toolpath.assumptions, note))
    return toolpath


def _read(path: Path, lines: list[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a file in its format."""
    formats = (each for each in FORMATS.values() if each.matches(path.suffix.lower(), lines))
    found = FORMATS[options.format] if options.format else next(formats)
    for names, why in found.refused.items():
        if any(getattr(options, name) is not None for name in names):
            raise InvalidInput(why)
    try:
        return found.read(path, lines, options)
    except InvalidInput:
        if found is CSV:
            _refuse_other_programs(lines)
        raise


def _refuse_other_programs(lines: Sequence[str]) -> None:
    """Refuse programs of robots and of other machine tools by their names.

    Raises:
        InvalidInput: If a line is one with which such a program begins.
    """
    for number, line in enumerate(lines[:_BEGIN], start=1):
        for name, begin in _OTHER_PROGRAMS.items():
            if re.match(begin, line, re.IGNORECASE):
                raise InvalidInput(
                    f"this is {name}, which is not read as a toolpath; have the CAM "
                    "system write APT-CL or G-code (ISO), or a table of points. A program of a "
                    "robot is checked against a task by qp-twist check PROGRAM TASK.",
                    line=number,
                )

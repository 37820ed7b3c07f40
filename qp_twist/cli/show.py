"""``qp-twist show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qp_twist.cli import app as cli
from qp_twist.cli.toolpath import given, options_of
from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath, read_toolpath
from qp_twist.paths.section import validated
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.toolpath_summary import Largest, ToolpathSummary, summarize

_Options: Any = options_of(ReadingOptions)
_AS_THE_FILE_SAYS = _Options()
Reading = Annotated[Any, tyro.conf.arg(constructor=_Options, name=""), tyro.conf.OmitArgPrefixes]


@cli.command
def show(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")],
    out: cli.Folder = None,
    png: cli.OptionalFile = None,
    reading: Reading = _AS_THE_FILE_SAYS,
    json_: cli.Json = False,
) -> None:
    """Show a toolpath without a robot: what is in the file, what was assumed, a page to look at.

    The page, toolpath.html, is one file that opens without a network: curves coloured by their
    feed, tool axes, rapid motions.

    Args:
        path: Toolpath: CSV, APT-CL or G-code.
        out: Folder for the page; if omitted, out/NAME_toolpath with the file's name.
        png: A still picture to write, too.
        reading: How the file is read.
    """
    folder = out or Path("out") / f"{path.stem}_toolpath"
    cli.check_folder(folder)
    if png is not None:
        if png.suffix.lower() != ".png":
            raise InvalidInput(f"--png {png}: expected a file that ends in .png.")
        cli.check_file(png, "--png")
    toolpath = _read(path, given(reading))
    from qp_twist.pages.toolpath_page import (  # with what draws
        lead,
        save_toolpath_figure,
        show_toolpath,
        toolpath_facts,
    )

    summary = summarize(toolpath)
    cli.only_json(json_)
    page = show_toolpath(toolpath, folder).path
    if png is not None:
        save_toolpath_figure(toolpath, png)
    if json_:
        cli.show_json(_facts(toolpath, summary, page))
    cli.say(f"{path}: {lead(toolpath, summary)}")
    for name, value in toolpath_facts(toolpath, summary).items():
        cli.say(f"  {name}: {value}")
    for note in toolpath.notes:
        cli.say(f"  note: {note}")
    cli.say(f"wrote {page}", *([] if png is None else [f"wrote {png}"]))


def _read(path: Path, options: dict[str, object]) -> Toolpath:
    """The toolpath; what is refused names the options of the command line."""
    try:
        return read_toolpath(path, validated(ReadingOptions, options))
    except InvalidInput as error:
        key, _, inside = error.key.partition(".")
        if key in ReadingOptions.model_fields:
            error.key = " ".join(filter(None, (ReadingOptions.option(key), inside)))
        if error.options:
            answers = [ReadingOptions.answer(*answer) for answer in error.options.items()]
            error.sentence += f" For qp-twist show: {' or '.join(answers)}"
        raise


def _facts(toolpath: Toolpath, summary: ToolpathSummary, page: Path) -> dict[str, Any]:
    """What the file says, ready for JSON: m, m/s, s, degrees."""

    def largest(found: Largest | None, scale: float = 1.0) -> dict[str, float | int] | None:
        return None if found is None else {"value": scale * found.value, "line": found.line}

    degrees = float(np.degrees(1.0))
    return {
        "file": str(toolpath.source),
        "page": str(page),
        "meaning": toolpath.meaning,
        "unit": toolpath.unit,
        "unit_in_file": toolpath.unit_in_file,
        "curves": summary.curves,
        "points": summary.points,
        "low": summary.low.tolist(),
        "high": summary.high.tolist(),
        "length": summary.cut,
        "rapid_length": summary.rapids,
        "feeds": None if summary.feeds is None else list(summary.feeds),
        "time": summary.time,
        "longest_step": largest(summary.longest_step),
        "largest_turn_deg": largest(summary.largest_turn, degrees),
        "tilt_deg": None if summary.tilt is None else [degrees * tilt for tilt in summary.tilt],
        "notes": list(toolpath.notes),
    }

"""``qp-twist show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qp_twist.cli import app as cli
from qp_twist.cli.toolpath import given, name_option, options_of
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
    out: cli.OptionalFile = None,
    reading: Reading = _AS_THE_FILE_SAYS,
    json_: cli.Json = False,
) -> None:
    """Show a toolpath without a robot: what is in the file, what was assumed, a page to look at.

    The page is one file that opens without a network: curves coloured by their feed, tool axes,
    rapid motions.

    Args:
        path: Toolpath: table, point cloud, poses, APT-CL, G-code, Klartext or program of a robot.
        out: Page (.html) or still picture (.png) to write; if omitted, the page
            out/NAME_toolpath.html with the file's name.
        reading: How the file is read.
    """
    file = out or Path("out") / f"{path.stem}_toolpath.html"
    if file.suffix.lower() not in (".html", ".png"):
        raise InvalidInput(f"--out {file}: expected a file that ends in .html or .png.")
    toolpath = _read(path, given(reading))
    cli.check_file(file)
    from qp_twist.pages.toolpath_page import (  # with what draws
        lead,
        save_toolpath_figure,
        show_toolpath,
        toolpath_facts,
    )

    summary = summarize(toolpath)
    cli.only_json(json_)
    write = show_toolpath if file.suffix.lower() == ".html" else save_toolpath_figure
    write(toolpath, file)
    if json_:
        cli.show_json(_facts(toolpath, summary, file))
    cli.say(f"{path}: {lead(toolpath, summary)}")
    for name, value in toolpath_facts(toolpath, summary).items():
        cli.say(f"  {name}: {value}")
    cli.say(*(f"  assumed: {sentence}" for sentence in toolpath.assumptions))
    cli.say(*(f"  left out: {sentence}" for sentence in toolpath.passed_over))
    cli.say(f"wrote {file}")


def _read(path: Path, options: dict[str, object]) -> Toolpath:
    """The toolpath; what is refused names the options of the command line."""
    try:
        return read_toolpath(path, validated(ReadingOptions, options))
    except InvalidInput as error:
        name_option(error, ReadingOptions)
        error.sentence += ReadingOptions.hint(error.options, "qp-twist show")
        raise


def _facts(toolpath: Toolpath, summary: ToolpathSummary, written: Path) -> dict[str, Any]:
    """What the file says, ready for JSON."""

    def largest(found: Largest | None, scale: float = 1.0) -> dict[str, float | int] | None:
        return None if found is None else {"value": scale * found.value, "line": found.line}

    degrees = float(np.degrees(1.0))
    return {
        "file": str(toolpath.source),
        "written": str(written),
        "points": summary.points,
        "curves": summary.curves,
        "length_m": summary.cut,
        "rapids_m": summary.rapids,
        "lower_m": summary.low.tolist(),
        "upper_m": summary.high.tolist(),
        "unit": toolpath.unit,
        "unit_in_file": toolpath.unit_in_file,
        "axis": toolpath.meaning != "none",
        "meaning": toolpath.meaning,
        "feeds_m_per_s": None if summary.feeds is None else list(summary.feeds),
        "time_s": summary.time,
        "longest_step_m": largest(summary.longest_step),
        "largest_turn_deg": largest(summary.largest_turn, degrees),
        "tilt_deg": None if summary.tilt is None else [degrees * tilt for tilt in summary.tilt],
        "assumptions": list(toolpath.assumptions),
        "passed_over": list(toolpath.passed_over),
    }

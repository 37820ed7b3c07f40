"""``qp-twist place``."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Annotated, Literal, Optional

import mink
import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load
from qp_twist.cli.progress import note_compiling, progress_bar
from qp_twist.errors import InvalidInput
from qp_twist.files import whole_file
from qp_twist.paths import PathTask
from qp_twist.paths.file_path_schema import WorkpieceTable
from qp_twist.studies import BestPlacement, best_placement

_AROUND = 0.2
"""Half-width of the box around the present placement, if neither is stated, m."""

Corner = Annotated[Optional[str], tyro.conf.arg(metavar="X,Y,Z[,RX,RY,RZ]")]


@cli.command
def place(
    task: cli.Task,
    lower: Corner = None,
    upper: Corner = None,
    objective: Literal["centering", "travel", "margin", "time", "clearance"] = "centering",
    moves: Literal["part", "base"] = "part",
    body: Annotated[Optional[str], tyro.conf.arg(metavar="NAME")] = None,
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0,
    out: cli.Folder = None,
    jobs: cli.Count = 1,
    scheduler: Annotated[Optional[str], tyro.conf.arg(metavar="ADDRESS")] = None,
    json_: cli.Json = False,
) -> None:
    """Search where the part, or the robot's base, should stand; draw a map of the box.

    The best plan of the whole path decides. Printed are the values here and there, and what to
    change in the task file.

    Args:
        lower: Lower bounds of the shift in world axes, m, and of a rotation vector, degrees, added
            to where it is (with a negative first number --lower=-0.3,0,0); without the last three
            it is not turned. If omitted, the box of [study.placement], else 0.2 m around it.
        upper: Upper bounds, likewise.
        objective: centering: least mean z; travel: least sum of joint displacements; margin:
            largest distance from the joint limits; time: least time; clearance: largest distance
            from what must not be touched.
        moves: What is moved: the part with its path, or the robot's base.
        body: Body of the scene that moves with the part; if omitted, that of [study.placement].
        seconds: Time for the search, s.
        out: Folder for map.png and placement.json; if omitted, out/TASK_place.
        jobs: Number of processes for the places all over the box.
        scheduler: Address of a Dask scheduler, whose workers are used instead.
    """
    from qp_twist.drawing.figures import save_figure  # with matplotlib

    path_task = load(task)
    box = _box(path_task, lower, upper)
    folder = out or Path("out") / f"{path_task.name}_place"
    files = [folder / "map.png", folder / "placement.json"]
    cli.check_folder(folder)
    note_compiling()
    with progress_bar(1.0) as report:
        found = best_placement(
            path_task, *box, objective, moves=moves, body=body, seconds=seconds, jobs=jobs,
            scheduler=scheduler,
            progress=lambda what, share: report(
                min(share, 1.0), f"{what}; Ctrl-C ends the search with the best so far"
            ),
        )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    save_figure(found.figure(), files[0])
    facts = {"task": path_task.name, **found.to_dict()}
    with whole_file(files[1]) as unfinished:
        tried = np.column_stack([found.offsets, found.values]).tolist()
        shown = [[None if np.isnan(number) else number for number in row] for row in tried]
        text = json.dumps({**facts, "tried_offsets_and_values": shown}, indent=1)
        unfinished.write_text(text, encoding="utf-8")
    cli.only_json(json_)
    cli.say(*_lines(path_task, found))
    for file in files:
        cli.say(f"wrote {file}")
    if json_:
        cli.show_json({"files": [str(file) for file in files], **facts})
    if found.plan is None:
        where = "In the middle of the box" if found.here is None else "Here"
        cli.fail(
            f"{path_task.name}: none of {len(found.values)} placements has a plan. {where}: "
            f"{found.reason.rstrip('.')}."
        )


def _box(path_task: PathTask, lower: str | None, upper: str | None) -> tuple[Array, Array]:
    """Both corners, m and rad."""
    if lower is None and upper is None:
        table = None if path_task.study is None else path_task.study.placement
        if table is None:
            return np.full(3, -_AROUND), np.full(3, _AROUND)
        return np.array(table.lower) - table.point, np.array(table.upper) - table.point
    if lower is None or upper is None:
        raise InvalidInput("give both --lower and --upper, or neither.")
    return corner("--lower", lower), corner("--upper", upper)


def corner(option: str, text: str) -> Array:
    """Three or six numbers in m and degrees, as m and rad."""
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all():
        raise InvalidInput(
            f"{option} {text!r}: expected three numbers in metres, e.g. {option} 0.3,0.1,0, or "
            "six, the last three a rotation vector in degrees (with a negative first one "
            f"{option}=-0.3,0.1,0)."
        )
    numbers[3:] = np.radians(numbers[3:])
    return numbers


def _lines(path_task: PathTask, found: BestPlacement) -> list[str]:
    """What was found, and what to change in the task."""
    text = f"{len(found.values)} placements compared; {found.reachable:.0%} of {found.spread} all "
    lines = [text + "over the box have a plan" + "; interrupted" * found.interrupted]
    if found.here is not None:
        lines.append(f"here: {found.here.result}{_distance(found, found.value_here)}")
    if found.plan is None or found.offset is None:
        return lines
    shift, turn = found.offset[:3], np.degrees(found.offset[3:])
    turned = f", turned by the rotation vector {listed(turn, 2)}°" if turn.any() else ""
    lines.append(f"best: {found.plan.result}{_distance(found, found.value)}")
    if found.moves == "base":
        return [*lines, f"move the robot's base body in the scene by {listed(shift)} m{turned}"]
    lines.append(f"the part moved by {listed(shift)} m{turned}:")
    lines += _placement_keys(path_task, found)
    if found.body is not None:
        lines.append(f"and the body {found.body!r} of the scene, likewise")
    return lines


def _distance(found: BestPlacement, value: float) -> str:
    """The least distance, if it is what placements are compared by."""
    if found.objective != "clearance" or np.isnan(value):
        return ""
    return f"; least distance {1e3 * value:.2f} mm"


def _placement_keys(path_task: PathTask, found: BestPlacement) -> list[str]:
    """The lines of the task file that put the path there."""
    assert found.offset is not None
    shift, turn = found.offset[:3], mink.SO3.exp(found.offset[3:])
    about = f"about {listed(found.about)} m" if found.offset[3:].any() else ""
    source = path_task.source
    path = {} if source is None else tomllib.loads(source.read_text("utf-8")).get("path", {})
    if path.get("kind") == "file":
        table = WorkpieceTable.model_validate_json(json.dumps(path.get("placement", {})))
        position = found.about + shift + turn.apply(np.array(table.position) - found.about)
        rotation = Rotation.from_matrix(turn.as_matrix() @ table.rotation())
        return [
            "[path.placement]",
            f"position = {listed(position)}",
            f"rpy_deg = {listed(rotation.as_euler('xyz', degrees=True), 4)}",
        ]
    if path.get("kind") == "spherical_patch" and not about:
        return ["[path]", f"center = {listed(np.array(path['center']) + shift)}"]
    return [f"in [path] its points, turned {about} and then shifted" if about else
            "in [path] its points, shifted"]  # fmt: skip


def listed(values: Array, digits: int = 5) -> str:
    """Numbers as an array of TOML."""
    return f"[{', '.join(f'{round(value, digits) + 0.0:.10g}' for value in values)}]"

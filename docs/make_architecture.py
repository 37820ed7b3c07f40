"""Draw docs/figures/architecture.svg: floors of rooms, and where a target passes on its way.

python docs/make_architecture.py
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from qp_twist.files import write_atomically

ROOT = Path(__file__).parent.parent

ROOMS = {
    "cli": "the command",
    "authoring": "new task files",
    "studies": "thousands of samples",
    "viewing": "the live page",
    "comparison": "metrics, table, findings",
    "pages": "reports of a motion, of a comparison",
    "trajectories": "timing, files, check",
    "following": "a method along a path; many runs at once",
    "planning": "the whole path, all branches",
    "closed_form": "the paper's formulas",
    "control": "one step",
    "drawing": "scenes, charts",
    "referee": "what a motion keeps",
    "paths": "task files, toolpaths, methods",
    "qp": "programs, backends",
    "constraints": "joint limits, bands",
    "programs": "robot programs",
    "robots": "models; known robots",
    "kinematics": "twist task, bands, objectives, chains",
    "geometry": "projectors, twist errors",
    "kernel": "steps and runs as machine code",
    "checks": "of arguments",
    "errors": "of refused input",
    "files": "written whole; tables",
    "notebook": "reprs",
    "shipped": "tasks, scenes",
}
# The numbers are those of the table in docs/architecture.md.
STEPS = {
    "paths": "1",
    "following": "2 8",
    "control": "3 7",
    "kinematics": "4",
    "constraints": "5",
    "qp": "6",
}
WIDTH, PITCH, HIGH, GAP = 760, 58, 50, 6

STYLE = """<style>
.architecture { width: 100%; height: auto; font-family: var(--font-stack, system-ui, sans-serif); font-size: 12px; }
.architecture .room { fill: var(--color-background-secondary, #f6f7f8); stroke: var(--color-background-border, #c9cdd2); }
.architecture .name { fill: var(--color-foreground-primary, #111); font-family: var(--font-stack--monospace, monospace); font-size: 14px; font-weight: 600; }
.architecture .text { fill: var(--color-foreground-secondary, #555); }
.architecture .badge { fill: var(--color-brand-primary, #0a4bff); }
.architecture .number { fill: var(--color-background-primary, #fff); font-size: 12px; font-weight: 700; text-anchor: middle; }
</style>"""  # noqa: E501


def rooms_of(floor: str) -> list[str]:
    """The rooms of one line of the linter's list."""
    return re.findall(r"\w+", floor)


def badge(number: str, x: float, y: float) -> str:
    """A number in a circle."""
    return (
        f'<circle class="badge" cx="{x:g}" cy="{y:g}" r="9"/>'
        f'<text class="number" x="{x:g}" y="{y + 4:g}">{number}</text>'
    )


def room(name: str, x: float, y: float, width: float) -> str:
    """A room with its name, what it is for, and the numbers of a target's steps through it."""
    lines = [
        f'<rect class="room" x="{x:g}" y="{y:g}" width="{width:g}" height="{HIGH}" rx="6"/>',
        f'<text class="name" x="{x + 10:g}" y="{y + 20:g}">{name}</text>',
        f'<text class="text" x="{x + 10:g}" y="{y + 39:g}">{ROOMS[name]}</text>',
    ]
    for place, number in enumerate(reversed(STEPS.get(name, "").split())):
        lines.append(badge(number, x + width - 14 - 22 * place, y + 14))
    return "\n".join(lines)


def architecture(floors: list[str]) -> str:
    """The picture, from the highest floor to the lowest."""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {PITCH * len(floors)}" '
        'role="img" aria-labelledby="architecture-title" class="architecture">',
        f'<title id="architecture-title">The {len(floors)} floors of qp_twist, from {floors[0]} '
        f"down to {floors[-1]}; numbers: a target's steps through them</title>",
        STYLE,
    ]
    for row, floor in enumerate(floors):
        names = rooms_of(floor)
        width = (WIDTH - 2 - GAP * (len(names) - 1)) / len(names)
        for column, name in enumerate(names):
            lines.append(room(name, 1 + column * (width + GAP), 4 + PITCH * row, width))
    return "\n".join([*lines, "</svg>"]) + "\n"


def main() -> None:
    """Draw it."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    [contract] = table["tool"]["importlinter"]["contracts"]
    file = ROOT / "docs" / "figures" / "architecture.svg"
    write_atomically(file, architecture(contract["layers"]))


if __name__ == "__main__":
    main()
